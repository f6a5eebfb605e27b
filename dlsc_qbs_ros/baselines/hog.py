"""
Histograms of oriented gradients (Dalal and Triggs, CVPR 2005) of the whole image.

OpenCV has them too, but no longer in the main modules of version 5.
"""

from __future__ import annotations

import numpy as np

from ..config import ViewConfig
from ..core.local_view import Cosine
from ..core.preprocessing import make_view

N_BINS = 9
CELL_PX = 16
CLIP = 0.2
# Added to the energy of a block in grey levels, so that noise on a plain wall stays small.
NOISE = 1.0


class Hog:
    """Unsigned gradients in cells of 16x16 pixels, normalised over blocks of 2x2 cells."""

    def __init__(self, width: int = 80, height: int = 64):
        self.measure = Cosine()
        self._size = ViewConfig(width=width, height=height)

    def describe(self, grey: np.ndarray) -> np.ndarray:
        """Return the blocks (n_values,), float32, of a grey image (rows, columns), uint8."""
        return _blocks(_cells(make_view(grey, self._size).astype(np.float32))).ravel()


def _cells(view: np.ndarray) -> np.ndarray:
    """Return the mean gradient of each cell by orientation, (cell rows, cell columns, bins)."""
    down, right = np.gradient(view)
    place = np.arctan2(down, right) / np.pi * N_BINS - 0.5
    lower = np.floor(place).astype(int)
    share = place - lower
    strength = np.hypot(down, right)
    rows, columns = view.shape[0] // CELL_PX, view.shape[1] // CELL_PX
    cell = (np.arange(rows).repeat(CELL_PX)[:, None] * columns
            + np.arange(columns).repeat(CELL_PX)) * N_BINS
    # A gradient between the middles of two bins counts for both, by nearness; opposite ones
    # are a whole round of bins apart.
    total = sum(
        np.bincount((cell + bins % N_BINS).ravel(), weights.ravel(), rows * columns * N_BINS)
        for bins, weights in ((lower, strength * (1 - share)), (lower + 1, strength * share)))
    return total.reshape(rows, columns, N_BINS) / CELL_PX ** 2


def _blocks(cells: np.ndarray) -> np.ndarray:
    """Return 2x2 neighbours as one, of length 1, clipped and again of length 1 (L2-Hys)."""
    top, bottom = cells[:-1], cells[1:]
    blocks = np.concatenate(
        [top[:, :-1], top[:, 1:], bottom[:, :-1], bottom[:, 1:]], axis=-1)
    blocks /= np.sqrt((blocks ** 2).sum(axis=-1, keepdims=True) + NOISE ** 2)
    blocks = np.minimum(blocks, CLIP)
    return (blocks / np.maximum(np.linalg.norm(blocks, axis=-1, keepdims=True), CLIP)
            ).astype(np.float32)
