"""Raw RatSLAM: a small grey template and the sum of absolute differences (SAD)."""

from __future__ import annotations

import cv2
import numpy as np

from ..config import ViewConfig
from ..core.preprocessing import make_view


class ShiftedSad:
    """
    The mean absolute difference of pixels at the best of some horizontal shifts: a distance.

    OpenRatSLAM compares the middle of the one template with every window of the other; here all
    the columns that overlap at a shift count, which makes the distance symmetric. Templates are
    kept as bytes, column by column, so that a shift is a slice.
    """

    direction = -1
    worst = 1.0

    def __init__(self, max_shift_px: int):
        self._max_shift_px = max_shift_px

    def prepare(self, descriptor: np.ndarray) -> np.ndarray:
        """Return templates (..., rows, columns), uint8, with their columns as rows."""
        return np.ascontiguousarray(np.swapaxes(descriptor, -1, -2))

    def compare(self, query: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """Return the distances (n,), in [0, 1], of one template with n others."""
        columns, rows = query.shape
        query, kept = query.reshape(1, -1), kept.reshape(len(kept), -1)
        best = np.full(len(kept), np.inf)
        for shift in range(-self._max_shift_px, self._max_shift_px + 1):
            n_pixels = (columns - abs(shift)) * rows
            ours = query[:, max(shift, 0) * rows:][:, :n_pixels]
            theirs = kept[:, max(-shift, 0) * rows:][:, :n_pixels]
            best = np.minimum(best, _total(theirs, ours) / n_pixels)
        return (best / 255.0).astype(np.float32)


def _total(rows: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the L1 norms (n,) of the differences of n rows and one, all uint8."""
    # K asks for the nearest one of those in `other`; without it Python cannot call this.
    total, _ = cv2.batchDistance(rows, other, cv2.CV_32S, normType=cv2.NORM_L1, K=1)
    return total[:, 0]


class RawTemplate:
    """
    The template of OpenRatSLAM: the block means of the whole image, a pixel being in [0, 1].

    Parameters
    ----------
    width, height : int
        Size of the template in pixels.
    max_shift_px : int
        Largest horizontal shift between two templates.

    """

    def __init__(self, width: int = 60, height: int = 20, max_shift_px: int = 4):
        self.measure = ShiftedSad(max_shift_px)
        self._size = ViewConfig(width=width, height=height)

    def describe(self, grey: np.ndarray) -> np.ndarray:
        """Return the template (height, width), uint8, of a grey image (rows, columns), uint8."""
        return make_view(grey, self._size)
