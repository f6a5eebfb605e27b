"""The local view: which stored view cell, if any, does the current code belong to."""

from __future__ import annotations

from collections import deque

import numpy as np

from .rows import Rows


class ViewCells:
    """
    The code book: one unit code per view cell, compared by cosine (paper, s_ij).

    Attributes
    ----------
    codes : ndarray of shape (n_cells, n_values), float32

    """

    def __init__(self, n_values: int):
        self._codes = Rows(np.zeros((0, n_values), np.float32))

    codes = property(lambda self: self._codes.values)

    def __len__(self) -> int:
        return len(self.codes)

    def add(self, code: np.ndarray) -> int:
        """Store the code of a new view cell and return its index."""
        self._codes.append(unit(code))
        return len(self) - 1

    def replace(self, codes: np.ndarray) -> None:
        """Swap the whole code book, after re-encoding under another dictionary."""
        self._codes = Rows(unit(codes).astype(np.float32))

    def similarities(self, code: np.ndarray) -> np.ndarray:
        """Return the cosine between a code and every view cell, shape (n_cells,)."""
        return self.codes @ unit(code).astype(np.float32)


def unit(codes: np.ndarray) -> np.ndarray:
    """Return codes of length 1 along the last axis; a zero code stays zero, similar to none."""
    length = np.linalg.norm(codes, axis=-1, keepdims=True)
    return codes / np.where(length > 0, length, 1.0)


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
