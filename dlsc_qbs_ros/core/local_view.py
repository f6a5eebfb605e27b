"""The local view: which stored view cell, if any, does the current code belong to."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from .rows import Rows


# The share of the mean code that is taken off. All of it would leave nothing of the views of a
# drone that stays in one room; none makes any two places half alike.
COMMON = 0.7


class Measure(Protocol):
    """
    How alike two descriptors are.

    Attributes
    ----------
    direction : int
        1 for a similarity, which grows with likeness; -1 for a distance.
    worst : float
        The value of a pair that has nothing in common.

    """

    direction: int
    worst: float

    def prepare(self, descriptor: np.ndarray) -> np.ndarray:
        """Return what is kept of a descriptor; of one shape for all."""

    def compare(self, query: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """Return the values (n,) of what is kept of one descriptor with that of n others."""


class Descriptor(Protocol):
    """An encoder without dictionary or memory: what it makes of a frame, and the measure of it."""

    measure: Measure

    def describe(self, grey: np.ndarray) -> np.ndarray:
        """Return the descriptor of a grey image (rows, columns), uint8; of one shape for all."""


class Cosine:
    """The cosine between codes (paper, s_ij): a similarity."""

    direction = 1
    worst = 0.0

    def prepare(self, descriptor: np.ndarray) -> np.ndarray:
        """Return codes of length 1 along the last axis, float32; a zero code stays zero."""
        length = np.linalg.norm(descriptor, axis=-1, keepdims=True)
        return (descriptor / np.where(length > 0, length, 1.0)).astype(np.float32)

    def compare(self, query: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """Return the cosines (n,) of a unit code with n others (n, n_values)."""
        return kept @ query


class ViewCells:
    """
    The code book: what is kept of the descriptor of every view cell.

    A descriptor without content, all zeros, is like no other. Whatever the measure,
    `likeness` grows with likeness: a distance is taken with a minus sign.

    Attributes
    ----------
    kept : ndarray of shape (n_cells, ...)

    """

    def __init__(self, measure: Measure):
        self._measure = measure
        self._clear()

    def _clear(self) -> None:
        self._kept: Rows | None = None
        self._is_blank = Rows(np.zeros(0, bool))

    kept = property(lambda self: self._kept.values)

    def __len__(self) -> int:
        return len(self._is_blank.values)

    def add(self, descriptor: np.ndarray) -> int:
        """Keep the descriptor of a new view cell and return its index."""
        self._keep(self._measure.prepare(descriptor)[None], np.array([not descriptor.any()]))
        return len(self) - 1

    def extend(self, codes: np.ndarray) -> None:
        """Keep the codes (n, n_values) of new view cells."""
        self._keep(self._measure.prepare(codes), ~codes.any(axis=1))

    def replace(self, codes: np.ndarray) -> None:
        """Keep codes (n_cells, n_values) in place of all."""
        self._clear()
        self.extend(codes)

    def _keep(self, kept: np.ndarray, is_blank: np.ndarray) -> None:
        if self._kept is None:
            self._kept = Rows(np.zeros((0, *kept.shape[1:]), kept.dtype))
        self._kept.extend(kept)
        self._is_blank.extend(is_blank)

    def likeness(self, descriptor: np.ndarray) -> np.ndarray:
        """Return how alike a descriptor and every view cell are, shape (n_cells,)."""
        values = np.full(len(self), self._measure.worst, np.float32)
        if len(self) and descriptor.any():
            values = np.where(
                self._is_blank.values, values,
                self._measure.compare(self._measure.prepare(descriptor), self.kept))
        return self._measure.direction * values


class CentredCells(ViewCells):
    """
    The code book of codes that have much in common, compared by the cosine about their mean.

    The share `COMMON` of the mean of all is taken from every code. A large book is compared in
    two steps: all codes in a random projection to `N_COARSE` values, which keeps cosines within
    about 0.1, then the `N_EXACT` best in full. A run of views averages what error is left.
    """

    LARGE = 1000
    N_COARSE = 64
    N_EXACT = 256

    def __init__(self):
        super().__init__(Cosine())

    def _clear(self) -> None:
        super()._clear()
        self._total: np.ndarray | None = None
        self._projection: np.ndarray | None = None
        # Per view cell, in the projection: its code and the square of its length.
        self._coarse = Rows(np.zeros((0, self.N_COARSE), np.float32))
        self._squares = Rows(np.zeros(0, np.float32))

    def _keep(self, kept: np.ndarray, is_blank: np.ndarray) -> None:
        super()._keep(kept, is_blank)
        if self._total is None:
            self._total = np.zeros(kept.shape[1])
            rows = np.random.default_rng(0).normal(size=(kept.shape[1], self.N_COARSE))
            self._projection = (rows / np.sqrt(self.N_COARSE)).astype(np.float32)
        self._total += kept.sum(axis=0, dtype=float)
        coarse = kept @ self._projection
        self._coarse.extend(coarse)
        self._squares.extend(np.einsum('ij,ij->i', coarse, coarse))

    def likeness(self, descriptor: np.ndarray) -> np.ndarray:
        """Return the cosine of a code and every view cell about the mean, shape (n_cells,)."""
        if not len(self) or not descriptor.any():
            return np.zeros(len(self), np.float32)
        pair = np.column_stack([self._measure.prepare(descriptor),
                                self._total / len(self)]).astype(np.float32)
        if len(self) <= self.LARGE:
            centred = _centred(self.kept @ pair, pair, np.float32(1.0))
        else:
            coarse = self._projection.T @ pair
            centred = _centred(self._coarse.values @ coarse, coarse, self._squares.values)
            best = np.argpartition(centred, -self.N_EXACT)[-self.N_EXACT:]
            centred[best] = _centred(self.kept[best] @ pair, pair, np.float32(1.0))
        return np.where(self._is_blank.values, np.float32(0.0), centred)


def _centred(products: np.ndarray, pair: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """
    Return the cosines of a query and n codes, all less a share of their mean.

    Parameters
    ----------
    products : ndarray of shape (n, 2), float32
        Of each code with the query and with the mean.
    pair : ndarray of shape (n_values, 2), float32
        The query and the mean.
    squares : ndarray of shape (n,) or ()
        Of the lengths of the codes.

    """
    (of_query, with_query), (_, of_mean) = pair.T @ pair
    with_query, with_cells, of_mean = (
        COMMON * with_query, COMMON * products[:, 1], COMMON ** 2 * of_mean)
    energies = (squares - 2.0 * with_cells + of_mean) * (of_query - 2.0 * with_query + of_mean)
    return ((products[:, 0] - with_query - with_cells + of_mean)
            / np.sqrt(np.maximum(energies, np.float32(1e-12))))
