"""How live atoms relate to those of a snapshot, and how the next snapshot is made of them."""

from __future__ import annotations

import numpy as np

from . import kernel
from .planes import BLOCK
from .projection import Projection

# Columns of a new snapshot that are made per frame: an eighth of all at the paper's size.
COLUMNS_PER_FRAME = 3 * BLOCK


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

    def learn(self, codes: np.ndarray, products: np.ndarray, kept: np.ndarray, rate: float
              ) -> None:
        """
        Take the step live -= rate * codes.T @ (codes @ live - inputs).

        Parameters
        ----------
        codes : ndarray of shape (n, n_atoms), float64
            The codes of the inputs learned from.
        products : ndarray of shape (n, n_atoms), float64
            Products of the inputs with the snapshot's atoms.
        kept : ndarray of shape (n, n_kept), float64
            These inputs in terms of the kept ones.
        rate : float
            The learning rate, over n.

        """
        n_atoms = len(self.mix)
        used = self.mix[:, :n_atoms + kept.shape[1]]
        residuals = codes @ used
        residuals[:, n_atoms:] -= kept
        subtract_product(used, rate * codes, residuals)
        subtract_product(self.cross, rate * codes, codes @ self.cross - products)

    def move_kept(self, kept: slice) -> None:
        """Follow the inputs in these slots, the only ones in use, to the first ones."""
        n_atoms = len(self.mix)
        weights = self.mix[:, n_atoms:][:, kept].copy()
        self.mix[:, n_atoms:] = 0.0
        self.mix[:, n_atoms:n_atoms + weights.shape[1]] = weights


def subtract_product(matrix: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
    """Take x.T @ y from a matrix (m, k), float64; x (n, m) and y (n, k) have few rows."""
    if kernel.LIBRARY is None:
        matrix -= x.T @ y
    else:
        kernel.subtract_product(matrix, x, y)


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
        """Return the products of inputs with its atoms, from those with the rows it is made of."""
        return products[:, :self._mix.shape[1]] @ self._mix.T
