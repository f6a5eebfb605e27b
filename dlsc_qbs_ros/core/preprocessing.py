"""Image to view, view to input vector s_k. The input vector is a pure function of the view."""

from __future__ import annotations

from functools import lru_cache

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
    return float(np.sqrt(N_PAPER / n_inputs))


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


def view_to_inputs(views: np.ndarray, standardise: bool, out: np.ndarray | None = None
                   ) -> np.ndarray:
    """
    Return the input vectors s_k of a batch of views.

    Parameters
    ----------
    views : ndarray of shape (n_views, height, width), uint8
        Views of one size.
    standardise : bool
        True: zero mean and deviation `DEVIATION`, which undoes changes of lighting.
        False: pixels in [0, 1], as in the paper.
    out : ndarray of shape (n_views, height * width), float32, optional
        Where to write them.

    Returns
    -------
    ndarray of shape (n_views, height * width), float32

    """
    views = np.ascontiguousarray(views).reshape(len(views), -1)
    scale = input_scale(views.shape[1])
    inputs = np.empty(views.shape, np.float32) if out is None else out
    if not standardise:
        return np.multiply(views, np.float32(scale / 255.0), out=inputs)
    if kernel.LIBRARY is not None:
        kernel.standardise(views, scale * DEVIATION, MIN_CONTRAST, inputs)
        return inputs
    for view, row in zip(views, inputs):
        np.subtract(view, np.float32(view.sum(dtype=np.uint32) / len(view)), out=row)
        contrast = np.sqrt(np.dot(row, row) / len(row))
        row *= np.float32(scale * DEVIATION / max(contrast, MIN_CONTRAST))
    return inputs
