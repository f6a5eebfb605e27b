"""Atoms as one picture."""

from __future__ import annotations

from math import ceil, sqrt

import numpy as np

MID_GREY = 128
SEPARATOR = 0


def mosaic(atoms: np.ndarray, height: int, width: int) -> np.ndarray:
    """
    Lay atoms out in rows of a grid as square as can be, one black pixel between them.

    Each atom is scaled by its own largest entry, alike on both sides of zero: zero is mid grey
    (128), the largest entry 1 or 255. An atom that is not finite stays black, as a cell without
    an atom does.

    Parameters
    ----------
    atoms : ndarray of shape (n_atoms, height * width), any float
        The atoms; at least one.
    height, width : int
        Size of an atom in pixels.

    Returns
    -------
    ndarray of shape (rows * (height + 1) - 1, columns * (width + 1) - 1), uint8

    """
    columns = ceil(sqrt(len(atoms)))
    rows = ceil(len(atoms) / columns)
    cells = np.full((rows * columns, height + 1, width + 1), SEPARATOR, np.uint8)
    peaks = np.abs(atoms).max(axis=1)
    drawn = np.flatnonzero(np.isfinite(peaks))
    unit = atoms[drawn] / np.where(peaks > 0.0, peaks, 1.0)[drawn, None]
    levels = np.rint(MID_GREY + 127.0 * unit).reshape(len(drawn), height, width)
    cells[drawn, :-1, :-1] = levels
    grid = cells.reshape(rows, columns, height + 1, width + 1).swapaxes(1, 2)
    return grid.reshape(rows * (height + 1), columns * (width + 1))[:-1, :-1]
