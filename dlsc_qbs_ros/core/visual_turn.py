"""
By how much the camera turned from one view to the next: egomotion from brightness alone.

What the camera sees moves by its turn, the same everywhere, and by its motion, the more the nearer
things are. The motion is known from odometry but for the depth, which each block of pixels has of
its own, and which the vertical part of the flow tells, too: near walls to one side are no turn.
"""

from __future__ import annotations

from functools import lru_cache
from math import sqrt
from typing import NamedTuple

import numpy as np

from .preprocessing import make_view, MIN_CONTRAST
from ..config import ViewConfig

# Views are averaged down to fewer columns than twice as many; smaller ones tell nothing.
COLUMNS = 43
LEAST_COLUMNS, LEAST_ROWS = 16, 12
# The share of the columns, in the middle, that is looked at: at the sides, near things move far.
MIDDLE = 0.49
BLOCK_PX = 4
# Of inverse depths: mean and deviation, in 1/m.
NEARNESS, NEARNESS_SIGMA = 0.3, 0.3
# Of what else changes from view to view: pitch and roll in radians, brightness in grey levels of a
# view whose deviation is CONTRAST, and contrast.
TILT_SIGMA_RAD, OFFSET_SIGMA, GAIN_SIGMA = 0.05, 100.0, 0.1
CONTRAST = 50.0
# Of the guess of the turn, in radians.
GUESS_SIGMA_RAD = 0.1
# A turn of more than this share of the view is no longer told.
LARGEST_TURN = 0.2
N_ITERATIONS = 3
FIRST_NOISE, LEAST_NOISE = 3.0, 0.5
# From so many deviations on, a pixel counts less.
HUBER = 1.5


class _Grid(NamedTuple):
    """
    The pixels that are looked at, block by block.

    Their columns and one more to each side; where each is among them row by row, their places from
    the middle, their blocks, and the first of each block.
    """

    columns: np.ndarray
    order: np.ndarray
    x: np.ndarray
    y: np.ndarray
    block: np.ndarray
    first: np.ndarray


def prepare(view: np.ndarray) -> np.ndarray | None:
    """
    Return a view (height, width), uint8, as `shift_between` takes it.

    Of about `COLUMNS` columns, float32, with the mean 0 and the deviation `CONTRAST`; None of a
    view that is too small or hardly more than noise.
    """
    step = max(view.shape[1] // COLUMNS, 1)
    rows, columns = view.shape[0] // step, view.shape[1] // step
    if rows < LEAST_ROWS or columns < LEAST_COLUMNS:
        return None
    small = make_view(view, ViewConfig(width=columns, height=rows)).astype(np.float32)
    deviation = small.std()
    if deviation < MIN_CONTRAST:
        return None
    return (small - small.mean()) * (CONTRAST / deviation)


def shift_between(before: np.ndarray, after: np.ndarray, motion_m: tuple[float, float, float],
                  turn_rad: float, focal_px: float) -> tuple[float, float] | None:
    """
    Return by how many pixels the middle of the view moved to the right by the camera's turn.

    A weighted least squares solution, about the turn that odometry tells, of the brightness
    constancy I_x u + I_y v + I_t = 0 with the flow of a rigid scene (Longuet-Higgins and Prazdny
    1980); the inverse depths of the blocks are eliminated.

    Parameters
    ----------
    before, after : ndarray of shape (rows, columns), float32
        Two views of one size from `prepare`.
    motion_m : tuple of three floats
        Forward, left and up, of the camera, in the frame of the view before, by odometry.
    turn_rad : float
        The same turn by odometry, to the left.
    focal_px : float
        The focal length.

    Returns
    -------
    tuple of two floats or None
        focal_px times the turn to the left, in radians, and its deviation, if the errors of the
        pixels were independent; None where odometry tells of too large a turn.

    """
    guess = focal_px * turn_rad
    if abs(guess) > LARGEST_TURN * before.shape[1]:
        return None
    grid = _grid(*before.shape)
    early, late = _halfway(before, after, guess, grid)
    mean = 0.5 * (early + late)
    i_x = 0.5 * (mean[1:-1, 2:] - mean[1:-1, :-2]).ravel()[grid.order]
    i_y = 0.5 * (mean[2:, 1:-1] - mean[:-2, 1:-1]).ravel()[grid.order]
    i_t = (late - early)[1:-1, 1:-1].ravel()[grid.order]
    x, y = grid.x / focal_px, grid.y / focal_px
    # In the frame of half the turn, in which both views are compared.
    forward, left, up = motion_m
    c, s = np.cos(0.5 * turn_rad), np.sin(0.5 * turn_rad)
    forward, left = c * forward + s * left, c * left - s * forward
    by_nearness = focal_px * (i_x * (x * forward + left) + i_y * (y * forward + up))
    to_sides = i_x * x * x + i_y * x * y
    by_turn = np.stack([
        i_x + to_sides, focal_px * (i_x * x * y + i_y * (1.0 + y * y)),
        focal_px * (i_y * x - i_x * y), by_nearness, np.ones_like(i_x),
        mean[1:-1, 1:-1].ravel()[grid.order]], axis=1)
    sigmas = [focal_px * GUESS_SIGMA_RAD, TILT_SIGMA_RAD, TILT_SIGMA_RAD, NEARNESS_SIGMA,
              OFFSET_SIGMA, GAIN_SIGMA]
    residual = i_t + guess * to_sides + NEARNESS * by_nearness
    shift, variance = _solved(by_turn, np.array(sigmas), by_nearness, residual, grid)
    return guess + shift, sqrt(variance)


def turns_along(before: np.ndarray, after: np.ndarray, shift_px: float) -> bool | None:
    """
    Return whether what two views show moved when the camera turned.

    What stays where it is is no scene, but the shade of the lens, dirt on it or the drone itself.

    Parameters
    ----------
    before, after : ndarray of shape (rows, columns), float32
        Two views of one size from `prepare`.
    shift_px : float
        By how much the turn moves the middle of the view to the right; it may be half of that.

    Returns
    -------
    bool or None
        None where the turn is too large to tell.

    """
    if abs(shift_px) > LARGEST_TURN * before.shape[1]:
        return None
    grid = _grid(*before.shape)

    def alike(px: float) -> float:
        # Only what is left without the mean of each row moves when the camera turns.
        early, late = (view - view.mean(axis=1, keepdims=True)
                       for view in _halfway(before, after, px, grid))
        size = float(np.vdot(early, early)) * float(np.vdot(late, late))
        return float(np.vdot(early, late)) / sqrt(size) if size else 0.0

    return max(alike(0.5 * shift_px), alike(shift_px)) > alike(0.0)


def _solved(by_turn: np.ndarray, sigmas: np.ndarray, by_nearness: np.ndarray,
            residual: np.ndarray, grid: _Grid) -> tuple[float, float]:
    """
    Return the first unknown that all pixels share, by reweighted least squares, and its variance.

    Those of the blocks are eliminated by the Schur complement, as their matrix is diagonal.
    """
    weights, noise = np.ones_like(residual), FIRST_NOISE
    for _ in range(N_ITERATIONS):
        weights /= noise ** 2
        weighted = by_turn * weights[:, None]
        mixed = np.add.reduceat(weighted * by_nearness[:, None], grid.first)
        own, told = np.add.reduceat(
            weights * by_nearness * (by_nearness, -residual), grid.first, axis=1)
        own += NEARNESS_SIGMA ** -2
        information = weighted.T @ by_turn + np.diag(sigmas ** -2)
        covariance = np.linalg.inv(information - mixed.T @ (mixed / own[:, None]))
        shared = covariance @ (-weighted.T @ residual - mixed.T @ (told / own))
        nearness = (told - mixed @ shared) / own
        errors = np.abs(residual + by_turn @ shared + by_nearness * nearness[grid.block])
        middle = len(errors) // 2
        noise = max(1.48 * float(np.partition(errors, middle)[middle]), LEAST_NOISE)
        weights = 1.0 / np.maximum(errors / (HUBER * noise), 1.0)
    return float(shared[0]), float(covariance[0, 0])


@lru_cache(maxsize=8)
def _grid(rows: int, columns: int) -> _Grid:
    half = 0.5 * MIDDLE * columns
    middle_x, middle_y = 0.5 * (columns - 1), 0.5 * (rows - 1)
    kept = np.flatnonzero(np.abs(np.arange(columns) - middle_x) < half)
    y, x = np.mgrid[1:rows - 1, kept[0]:kept[-1] + 1]
    name = ((y - 1) // BLOCK_PX * columns + (x - kept[0]) // BLOCK_PX).ravel()
    order = np.argsort(name, kind='stable')
    _, first, block = np.unique(name[order], return_index=True, return_inverse=True)
    return _Grid(np.arange(kept[0] - 1, kept[-1] + 2), order, (x - middle_x).ravel()[order],
                 (y - middle_y).ravel()[order], block, first)


def _halfway(before: np.ndarray, after: np.ndarray, shift_px: float, grid: _Grid
             ) -> tuple[np.ndarray, np.ndarray]:
    """Return what is looked at of two views as from half-way of a turn that shifts so far."""
    return _shifted(before, -0.5 * shift_px, grid), _shifted(after, 0.5 * shift_px, grid)


def _shifted(view: np.ndarray, by_px: float, grid: _Grid) -> np.ndarray:
    """Return the columns that are looked at, and one more to each side, from so far right."""
    at = np.clip(grid.columns + by_px, 0.0, view.shape[1] - 1.001)
    first = at.astype(int)
    share = (at - first).astype(np.float32)
    return (1.0 - share) * view[:, first] + share * view[:, first + 1]
