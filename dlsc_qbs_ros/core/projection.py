"""Products of inputs with atoms, and with earlier inputs: all that touches N numbers per row."""

from __future__ import annotations

import numpy as np

from . import kernel

# From this many inputs on, kept ones are worth shortening to 16 bits. Rounding changes a product
# of two views by less than 1e-5 of their lengths, at the paper's size 2e-6: some 5 to 30 times
# what a sum of 32 bits does.
LONG = 16384
# Columns that are combined at a time: those of all rows stay in the second-level cache.
COLUMNS = 512
# Terms of a sum in 32 bits; such sums are added in 64.
TERMS = 32768


class Projection:
    """
    A fixed matrix of rows: the atoms of a snapshot, then inputs kept since.

    The atoms are shared, never copied nor written to.
    """

    def __init__(self, atoms: np.ndarray, room: int, dtype: type = np.float32):
        self.atoms = atoms
        self._kept = np.empty((room, atoms.shape[1]), dtype)

    def keep(self, start: int, inputs: np.ndarray) -> None:
        """Keep inputs (n, n_inputs), float32, in the slots from `start` on."""
        self._kept[start:start + len(inputs)] = inputs

    def replace(self, atoms: np.ndarray, kept: slice) -> None:
        """Go on with other atoms and the inputs in these slots, moved to the first ones."""
        self.atoms = atoms
        _to_front(self._kept, kept)

    def products(self, inputs: np.ndarray, n_kept: int) -> np.ndarray:
        """Multiply inputs (n, n_inputs) and rows; return (n, n_atoms + n_kept), float64."""
        return np.concatenate(
            [inputs @ self.atoms.T, self._kept_products(inputs, n_kept)], axis=1, dtype=float)

    def combine(self, weights: np.ndarray, out: np.ndarray, start: int = 0,
                stop: int | None = None) -> None:
        """Write columns of weights (m, n_atoms + n_kept) @ rows to out (m, n_inputs), float32."""
        of_atoms, of_inputs = np.split(weights.astype(np.float32), [len(self.atoms)], axis=1)
        stop = out.shape[1] if stop is None else stop
        for first in range(start, stop, COLUMNS):
            columns = slice(first, min(first + COLUMNS, stop))
            block = of_atoms @ self.atoms[:, columns]
            block += of_inputs @ self._kept_inputs(of_inputs.shape[1], columns)
            out[:, columns] = block

    def _kept_products(self, inputs: np.ndarray, n_kept: int) -> np.ndarray:
        return inputs @ self._kept[:n_kept].T

    def _kept_inputs(self, n_kept: int, columns: slice) -> np.ndarray:
        return self._kept[:n_kept, columns]


class ShortProjection(Projection):
    """The same with kept inputs of 16 bits, each in a unit of its own, for the kernel."""

    def __init__(self, atoms: np.ndarray, room: int):
        super().__init__(atoms, room, np.int16)
        self._units = np.zeros(room)

    def keep(self, start: int, inputs: np.ndarray) -> None:
        for slot, row in enumerate(np.ascontiguousarray(inputs), start):
            self._units[slot] = kernel.shorten(row, self._kept[slot])

    def replace(self, atoms: np.ndarray, kept: slice) -> None:
        super().replace(atoms, kept)
        _to_front(self._units, kept)

    def _kept_products(self, inputs: np.ndarray, n_kept: int) -> np.ndarray:
        return self._units[:n_kept] * np.array([
            kernel.project(self._kept, n_kept, row) for row in np.ascontiguousarray(inputs)])

    def _kept_inputs(self, n_kept: int, columns: slice) -> np.ndarray:
        return self._kept[:n_kept, columns] * self._units[:n_kept, None].astype(np.float32)


def _to_front(array: np.ndarray, kept: slice) -> None:
    array[:kept.stop - kept.start] = array[kept].copy()


def gram_of(rows: np.ndarray) -> np.ndarray:
    """Return rows @ rows.T (n, n), float64, of rows (n, n_inputs), float32."""
    gram = np.zeros((len(rows), len(rows)))
    for start in range(0, rows.shape[1], TERMS):
        block = rows[:, start:start + TERMS]
        gram += block @ block.T
    return gram


def make_projection(atoms: np.ndarray, room: int) -> Projection:
    """Return the projection that is cheapest here."""
    is_short = kernel.LIBRARY is not None and atoms.shape[1] >= LONG
    return (ShortProjection if is_short else Projection)(atoms, room)
