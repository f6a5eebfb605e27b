"""Image to view, view to input vector s_k. The input vector is a pure function of the view."""

from __future__ import annotations

from functools import lru_cache
from math import sqrt

import numpy as np

from . import kernel
from ..config import ViewConfig
from ..errors import ImageError

# The paper's parameters are stated for this many pixels. The learning dynamics depend on
# ||s_k|| and ||phi_m||, not on N as such: scaling both by sqrt(N_PAPER / N) keeps eta_c, eta_d
# and lambda_1 in force at every size of view.
N_PAPER = 346 * 260

# Deviation of a standardised view at the paper's size, that of an ordinary image in [0, 1].
DEVIATION = 0.25

# A view flatter than this many grey levels is treated as noise around a plain surface.
MIN_CONTRAST = 4.0


def input_scale(n_inputs: int) -> float:
    """Return the factor by which views and initial atoms of `n_inputs` pixels are scaled."""
    return sqrt(N_PAPER / n_inputs)


def make_view(grey: np.ndarray, config: ViewConfig) -> np.ndarray:
    """
    Crop and resize a grey image by exact area averaging.

    Parameters
    ----------
    grey : ndarray of shape (rows, columns), uint8
        The image.
    config : ViewConfig
        Size of the view, and the shares of the image that are cut off.

    Returns
    -------
    ndarray of shape (config.height, config.width), uint8

    Raises
    ------
    ImageError
        When the image is not two-dimensional uint8, or nothing is left of it.

    """
    if grey.ndim != 2 or grey.dtype != np.uint8:
        raise ImageError(f'expected a grey uint8 image, got {grey.dtype} of shape {grey.shape}')
    rows, columns = grey.shape
    top, bottom = int(rows * config.crop_top), rows - int(rows * config.crop_bottom)
    left, right = int(columns * config.crop_left), columns - int(columns * config.crop_right)
    kept = grey[top:bottom, left:right]
    if kept.size == 0:
        raise ImageError(f'nothing is left of an image of {columns}x{rows} after the crop')
    if kept.shape == (config.height, config.width):
        return kept.copy()
    vertical = _area_weights(kept.shape[0], config.height)
    horizontal = _area_weights(kept.shape[1], config.width)
    resized = vertical @ kept.astype(np.float32) @ horizontal.T
    return np.rint(resized).astype(np.uint8)


@lru_cache(maxsize=8)
def _area_weights(n_in: int, n_out: int) -> np.ndarray:
    """Return the (n_out, n_in) matrix whose row i averages the input pixels under output i."""
    edges = np.arange(n_out + 1) * (n_in / n_out)
    pixel = np.arange(n_in)
    overlap = (np.minimum(edges[1:, None], pixel + 1) - np.maximum(edges[:-1, None], pixel))
    weights = np.clip(overlap, 0.0, None)
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)


class PixelInput:
    """
    The input vector s_k of a view, affine in its pixels: factor (pixel - mean).

    `numpy.asarray` makes it: (n_pixels,), float32.

    Attributes
    ----------
    pixels : ndarray of shape (n_pixels,), uint8
    affine : tuple of three floats
        Factor, mean, and the sum of the pixels.
    squared_norm : float

    """

    def __init__(self, view: np.ndarray, standardise: bool):
        """
        Take a view (height, width), uint8.

        It gets zero mean and the deviation `DEVIATION`, which undoes changes of lighting; or
        else, as in the paper, its pixels are brought into [0, 1].
        """
        self.pixels = np.ascontiguousarray(view).reshape(-1)
        n, (total, deviations) = len(self.pixels), self._moments()
        mean, contrast = total / n, max(sqrt(deviations / n), MIN_CONTRAST) / DEVIATION
        if not standardise:
            deviations += n * mean * mean
            mean, contrast, self._values = 0.0, 255.0, None
        factor = input_scale(n) / contrast
        if self._values is not None:
            self._values *= np.float32(factor)
        self.affine = factor, mean, total
        self.squared_norm = factor * factor * deviations

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        if self._values is None:
            factor, mean, _ = self.affine
            self._values = centred(self.pixels, mean)
            self._values *= np.float32(factor)
        return self._values

    def _moments(self) -> tuple[float, float]:
        """Return the sum of the pixels and that of their squared deviations from the mean."""
        n, self._values = len(self.pixels), None
        if kernel.LIBRARY is not None:
            total, squares = kernel.sum_pixels(self.pixels)
            return total, max(squares - total * total / n, 0.0)
        total = int(self.pixels.sum(dtype=np.uint32))
        self._values = centred(self.pixels, total / n)
        return total, float(self._values @ self._values)


def centred(pixels: np.ndarray, mean: float) -> np.ndarray:
    """Return pixels - mean, float32."""
    values = pixels.astype(np.float32)
    values -= np.float32(mean)  # of one type: with pixels it would take twice as long
    return values
