"""How live atoms relate to those of a snapshot, and how the next snapshot is made of them."""

from __future__ import annotations

import numpy as np

from .planes import BLOCK
from .projection import Projection

# Columns of a new snapshot that are made per frame: a sixth of all at the paper's size. What is
# learned from meanwhile stays kept beside the new snapshot, at a price on every frame.
COLUMNS_PER_FRAME = 8 * BLOCK


class Relation:
    """
    Live atoms in terms of a snapshot's atoms and of kept inputs.

    Attributes
    ----------
    mix : ndarray of shape (n_atoms, n_atoms + room), float64
        live = mix @ [snapshot; kept inputs]
    cross : ndarray of shape (n_atoms, n_atoms), float64
        live @ snapshot.T

    """

    def __init__(self, gram: np.ndarray, room: int, scale: float = 1.0):
        """Begin with the atoms of the snapshot, whose Gram matrix is given, times a scale."""
        self.mix = scale * np.eye(len(gram), len(gram) + room)
        self.cross = scale * gram

    def used(self, n_kept: int) -> np.ndarray:
        """Return the mix of the rows in use, (n_atoms, n_atoms + n_kept)."""
        return self.mix[:, :len(self.mix) + n_kept]

    def learn(self, code: np.ndarray, products: np.ndarray, slot: int, rate: float) -> None:
        """
        Take the step live -= rate * outer(code, code @ live - input).

        Parameters
        ----------
        code : ndarray of shape (n_atoms,), float64
            The code of the input learned from.
        products : ndarray of shape (n_atoms,), float64
            Products of the input with the snapshot's atoms.
        slot : int
            Where this input is kept, the last one in use.
        rate : float
            The learning rate.

        """
        used = self.used(slot + 1)
        residual = code @ used
        residual[-1] -= 1.0
        step = rate * code[:, None]
        used -= step * residual
        self.cross -= step * (code @ self.cross - products)

    def move_kept(self, kept: slice) -> None:
        """Follow the inputs in these slots, the only ones in use, to the first ones."""
        n_atoms = len(self.mix)
        weights = self.mix[:, n_atoms:][:, kept].copy()
        self.mix[:, n_atoms:] = 0.0
        self.mix[:, n_atoms:n_atoms + weights.shape[1]] = weights


class NextSnapshot:
    """
    A snapshot in the making: the live atoms as they were when it was begun.

    It is made some columns at a time, so that no frame waits for all of it. Meanwhile the live
    atoms learn on; `live` is their relation to this snapshot.
    """

    def __init__(self, rows: Projection, mix: np.ndarray, gram: np.ndarray, room: int):
        """Begin to make `mix` times the rows; `gram` is what their Gram matrix will be."""
        self._rows, self._mix = rows, mix.copy()
        self._n_made = 0
        self.n_kept = rows.n_kept
        self.atoms = rows.new_atoms()
        self.gram = gram.copy()
        self.live = Relation(gram, room)

    @property
    def is_whole(self) -> bool:
        """Whether every column has been made."""
        return self._n_made == self._rows.n_inputs

    def make_columns(self) -> None:
        """Make the next columns."""
        stop = min(self._n_made + COLUMNS_PER_FRAME, self._rows.n_inputs)
        for columns, block in self._rows.combine(self._mix, self._n_made, stop):
            self.atoms[:, columns] = block
        self._n_made = stop

    def products(self, products: np.ndarray) -> np.ndarray:
        """Return the products of an input with its atoms, from those with what it is made of."""
        return self._mix @ products[:self._mix.shape[1]]
