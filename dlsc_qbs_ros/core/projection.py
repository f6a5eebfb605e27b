"""Products of inputs with atoms, and with earlier inputs: all that touches N numbers per row."""

from __future__ import annotations

from typing import Iterator

import numpy as np

from .preprocessing import PixelInput

# Terms of a sum in 32 bits; such sums are added in 64.
TERMS = 32768
# Columns that are combined at a time: those of all rows stay in the second-level cache.
COLUMNS = 512


class Projection:
    """
    A fixed matrix of rows: the atoms of a snapshot, then inputs kept since.

    The atoms are shared, never copied nor written to.

    Attributes
    ----------
    n_inputs : int
        Length of a row.
    n_kept : int
        The inputs kept.

    """

    def __init__(self, atoms: np.ndarray, room: int):
        self.n_inputs, self.n_kept = atoms.shape[1], 0
        self._atoms = atoms
        self._kept = np.empty((room, atoms.shape[1]), np.float32)

    @property
    def atoms(self) -> np.ndarray:
        """Return the rows that are atoms, (n_atoms, n_inputs), float32."""
        return self._atoms

    @property
    def room(self) -> int:
        """Return how many more inputs can be kept."""
        return self._kept.shape[-2] - self.n_kept

    def forget(self) -> None:
        """Forget all inputs kept."""
        self.n_kept = 0

    def keep(self, vector: PixelInput) -> int:
        """Keep an input vector; return its slot, the first that was not in use."""
        slot, self.n_kept = self.n_kept, self.n_kept + 1
        self._store(slot, vector)
        return slot

    def new_atoms(self) -> np.ndarray:
        """Return memory for other atoms, to be written in such columns as `combine` yields."""
        return np.empty_like(self._atoms)

    def replace(self, atoms: np.ndarray, n_forgotten: int) -> slice:
        """
        Go on with other atoms, without the inputs that were kept first.

        Return the slots of those that stay; they move to the first ones.
        """
        staying = slice(n_forgotten, self.n_kept)
        self._atoms, self.n_kept = atoms, self.n_kept - n_forgotten
        self._move_to_front(staying)
        return staying

    def products(self, vector: PixelInput) -> np.ndarray:
        """Multiply the rows and an input vector; return (n_atoms + n_kept,), float64."""
        values, n_atoms = np.asarray(vector), len(self._atoms)
        products = np.empty(n_atoms + self.n_kept)
        products[:n_atoms] = self._atoms @ values
        products[n_atoms:] = self._kept[:self.n_kept] @ values
        return products

    def combine(self, weights: np.ndarray, start: int, stop: int
                ) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield columns of weights (m, n_atoms + n_kept) @ rows, float32, and which they are."""
        of_atoms, of_inputs = np.split(weights.astype(np.float32), [len(self._atoms)], axis=1)
        for first in range(start, stop, COLUMNS):
            columns = slice(first, min(first + COLUMNS, stop))
            block = of_atoms @ self._atoms[:, columns]
            block += of_inputs @ self._kept[:of_inputs.shape[1], columns]
            yield columns, block

    def _store(self, slot: int, vector: PixelInput) -> None:
        self._kept[slot] = np.asarray(vector)

    def _move_to_front(self, slots: slice) -> None:
        to_front(self._kept, slots)


def to_front(array: np.ndarray, rows: slice) -> None:
    """Move rows of an array to its first ones."""
    array[:rows.stop - rows.start] = array[rows].copy()


def gram_of(rows: np.ndarray) -> np.ndarray:
    """Return rows @ rows.T (n, n), float64, of rows (n, n_inputs), float32."""
    gram = np.zeros((len(rows), len(rows)))
    for start in range(0, rows.shape[1], TERMS):
        block = rows[:, start:start + TERMS]
        gram += block @ block.T
    return gram
