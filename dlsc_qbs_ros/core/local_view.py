"""The local view: which stored view cell, if any, does the current code belong to."""

from __future__ import annotations

from collections import deque
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
        self._kept: Rows | None = None
        self._is_blank = Rows(np.zeros(0, bool))

    kept = property(lambda self: self._kept.values)

    def __len__(self) -> int:
        return len(self._is_blank.values)

    def add(self, descriptor: np.ndarray) -> int:
        """Keep the descriptor of a new view cell and return its index."""
        kept = self._measure.prepare(descriptor)
        if self._kept is None:
            self._kept = Rows(np.zeros((0, *kept.shape), kept.dtype))
        self._kept.append(kept)
        self._is_blank.append(not descriptor.any())
        return len(self) - 1

    def replace(self, codes: np.ndarray) -> None:
        """Swap the whole code book (n_cells, n_values), after re-encoding."""
        self._kept = Rows(self._measure.prepare(codes))
        self._is_blank = Rows(~codes.any(axis=1))

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

    The share `COMMON` of the mean of all view cells is taken from every code. All that takes are
    the cosines, and for each cell the sum of its own with all others.
    """

    def __init__(self):
        super().__init__(Cosine())
        self._sums = Rows(np.zeros(0))

    def add(self, descriptor: np.ndarray) -> int:
        """Keep the code of a new view cell and return its index."""
        cosines = super().likeness(descriptor)
        self._sums.values[:] += cosines
        self._sums.append(cosines.sum() + descriptor.any())
        return super().add(descriptor)

    def replace(self, codes: np.ndarray) -> None:
        """Swap the whole code book (n_cells, n_values), after re-encoding."""
        super().replace(codes)
        self._sums = Rows(self.kept @ self.kept.sum(axis=0, dtype=float))

    def likeness(self, descriptor: np.ndarray) -> np.ndarray:
        """Return the cosine of a code and every view cell about the mean, shape (n_cells,)."""
        cosines = super().likeness(descriptor)
        if not len(self):
            return cosines
        with_query = COMMON * cosines.mean()
        with_cells = COMMON * self._sums.values / len(self)
        of_mean = COMMON ** 2 * self._sums.values.mean() / len(self)
        squares = (1.0 - 2.0 * with_cells + of_mean) * (1.0 - 2.0 * with_query + of_mean)
        centred = cosines - with_query - with_cells + of_mean
        is_blank = cosines == 0.0
        return np.where(is_blank, 0.0, centred / np.sqrt(np.maximum(squares, 1e-12)))


class SequenceScore:
    """
    The mean similarity of the last views to a run of view cells that were made in a row.

    A single view of one shelf looks like one of the next; a run of them less so. View cells
    are made at equal distances, so a second pass meets them at one per view, give or take
    `slack` where the two passes are out of step.
    """

    def __init__(self, length: int, slack: int = 1):
        self._rows: deque[np.ndarray] = deque(maxlen=length)
        self._slack = slack

    def clear(self) -> None:
        """Forget the views so far: the next one does not continue them."""
        self._rows.clear()

    def update(self, similarities: np.ndarray) -> np.ndarray | None:
        """
        Take in the similarities of the next view, shape (n_cells,).

        Returns
        -------
        ndarray of shape (n_cells,) or None
            The score of the run that ends in each view cell; None until `length` views came.

        """
        self._rows.append(similarities)
        if len(self._rows) < self._rows.maxlen:
            return None
        total = similarities.copy()
        for back, row in enumerate(list(self._rows)[-2::-1], start=1):
            total += _best_around(row, back, self._slack, len(similarities))
        return total / len(self._rows)


def _best_around(row: np.ndarray, back: int, slack: int, n_cells: int) -> np.ndarray:
    """Return, for each cell j, the best of row[j - back - slack .. j - back + slack]."""
    padded = np.full(n_cells + back + 2 * slack, -1.0, row.dtype)
    padded[back + slack:back + slack + len(row)] = row
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * slack + 1)
    return windows[:n_cells].max(axis=1)
