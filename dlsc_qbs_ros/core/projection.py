"""Products of inputs with atoms, and with earlier inputs: all that touches N numbers per row."""

from __future__ import annotations

import numpy as np

from . import kernel

# From this many inputs on, 16-bit rows are as exact as 32-bit ones: what rounding adds to a
# product falls with sqrt(n_inputs), and lies below that of a sum in 32 bits.
LONG = 16384
# Columns that are combined at a time: those of all rows stay in the second-level cache.
COLUMNS = 1024


class Projection:
    """
    A fixed matrix of rows: the atoms of a snapshot, then inputs kept since.

    The atoms are shared, never copied nor written to.
    """

    def __init__(self, atoms: np.ndarray, room: int):
        self.atoms = atoms
        self._kept = np.empty((room, atoms.shape[1]), np.float32)

    def keep(self, start: int, inputs: np.ndarray) -> None:
        """Keep inputs (n, n_inputs), float32, in the slots from `start` on."""
        self._kept[start:start + len(inputs)] = inputs

    def replace(self, atoms: np.ndarray, kept: slice) -> None:
        """Go on with other atoms and the inputs in these slots, moved to the first ones."""
        self.atoms = atoms
        self._kept[:kept.stop - kept.start] = self._kept[kept].copy()

    def products(self, inputs: np.ndarray, n_kept: int) -> np.ndarray:
        """Multiply inputs (n, n_inputs) and rows; return (n, n_atoms + n_kept), float64."""
        parts = (inputs @ self.atoms.T, inputs @ self._kept[:n_kept].T)
        return np.concatenate(parts, axis=1).astype(np.float64)

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

    def _kept_inputs(self, n_kept: int, columns: slice) -> np.ndarray:
        return self._kept[:n_kept, columns]


class ShortProjection(Projection):
    """
    The same with rows of 16-bit numbers, each row in a unit of its own, for the compiled kernel.

    Products read these; new atoms are made of the exact ones, so nothing adds up over time.
    """

    def __init__(self, atoms: np.ndarray, room: int):
        self._rows = np.empty((len(atoms) + room, atoms.shape[1]), np.int16)
        self._units = np.zeros(len(self._rows))
        self.replace(atoms, slice(0, 0))

    def keep(self, start: int, inputs: np.ndarray) -> None:
        self._write(len(self.atoms) + start, inputs)

    def replace(self, atoms: np.ndarray, kept: slice) -> None:
        self.atoms = atoms
        n_atoms, n_kept = len(atoms), kept.stop - kept.start
        self._write(0, atoms)
        for array in (self._rows, self._units):
            array[n_atoms:n_atoms + n_kept] = array[n_atoms:][kept].copy()

    def products(self, inputs: np.ndarray, n_kept: int) -> np.ndarray:
        n_rows = len(self.atoms) + n_kept
        return self._units[:n_rows] * np.array([
            kernel.project(self._rows, n_rows, row) for row in inputs])

    def _kept_inputs(self, n_kept: int, columns: slice) -> np.ndarray:
        kept = slice(len(self.atoms), len(self.atoms) + n_kept)
        return self._rows[kept, columns] * self._units[kept, None].astype(np.float32)

    def _write(self, start: int, values: np.ndarray) -> None:
        written = slice(start, start + len(values))
        kernel.quantise(values, self._rows[written], self._units[written])


def gram_of(atoms: np.ndarray) -> np.ndarray:
    """Return atoms @ atoms.T in float64, of float32 atoms (n_atoms, n_inputs)."""
    gram = np.zeros((len(atoms), len(atoms)))
    for start in range(0, atoms.shape[1], COLUMNS):
        block = atoms[:, start:start + COLUMNS]
        gram += block @ block.T
    return gram


def make_projection(atoms: np.ndarray, room: int) -> Projection:
    """Return the projection that is cheapest here."""
    is_short = kernel.LIBRARY is not None and atoms.shape[1] >= LONG
    return (ShortProjection if is_short else Projection)(atoms, room)
