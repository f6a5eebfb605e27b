"""Products of inputs with atoms, and with earlier inputs: all that touches N numbers per row."""

from __future__ import annotations

from typing import Iterator

import numpy as np

from .preprocessing import PixelInputs

# Terms of a sum in 32 bits; such sums are added in 64.
TERMS = 32768


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

    # Columns that are combined at a time: those of all rows stay in the second-level cache.
    columns = 512

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
        return len(self._kept) - self.n_kept

    def forget(self) -> None:
        """Forget all inputs kept."""
        self.n_kept = 0

    def keep(self, inputs: np.ndarray) -> np.ndarray:
        """Keep inputs (n, n_inputs), float32; return them in terms of all kept (n, n_kept)."""
        start, self.n_kept = self.n_kept, self.n_kept + len(inputs)
        self._store(slice(start, self.n_kept), inputs)
        return np.eye(len(inputs), self.n_kept, start)

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

    def products(self, inputs: np.ndarray) -> np.ndarray:
        """Multiply inputs (n, n_inputs) and rows; return (n, n_atoms + n_kept), float64."""
        inputs = np.asarray(inputs)
        return np.concatenate(
            [inputs @ self._atoms.T, inputs @ self._kept[:self.n_kept].T], axis=1, dtype=float)

    def gram(self, inputs: np.ndarray) -> np.ndarray:
        """Return the products of inputs with each other (n, n), float64."""
        if isinstance(inputs, PixelInputs) and len(inputs) == 1:
            return inputs.squared_norms[None]  # known from making them
        return gram_of(np.asarray(inputs))

    def combine(self, weights: np.ndarray, start: int, stop: int
                ) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield columns of weights (m, n_atoms + n_kept) @ rows, float32, and which they are."""
        of_atoms, of_inputs = np.split(weights.astype(np.float32), [self._atoms.shape[0]], axis=1)
        for first in range(start, stop, self.columns):
            columns = slice(first, min(first + self.columns, stop))
            block = of_atoms @ self._atoms[:, columns]
            block += of_inputs @ self._kept_inputs(of_inputs.shape[1], columns)
            yield columns, block

    def _store(self, slots: slice, inputs: np.ndarray) -> None:
        self._kept[slots] = np.asarray(inputs)

    def _move_to_front(self, slots: slice) -> None:
        to_front(self._kept, slots)

    def _kept_inputs(self, n: int, columns: slice) -> np.ndarray:
        return self._kept[:n, columns]


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
