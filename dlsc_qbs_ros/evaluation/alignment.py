"""The rigid motions that move ground truth into the SLAM frame: of least MAE_L, of least ATE."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from ..core.geometry import wrap_angle

COARSE_ANGLES_RAD = np.radians(np.arange(0.0, 360.0, 2.0))
FINE_OFFSETS_RAD = np.radians(np.linspace(-2.0, 2.0, 41))
N_BASINS = 3
RESOLUTION_RAD = 1e-9
GOLDEN = (sqrt(5.0) - 1.0) / 2.0


@dataclass(frozen=True)
class Alignment:
    """The motion p -> R p + t from the ground-truth frame into the SLAM frame, without scale."""

    rotation_rad: float
    translation_m: np.ndarray

    def apply(self, points_m: np.ndarray) -> np.ndarray:
        """Move points, an ndarray of shape (n, 2), from the ground-truth to the SLAM frame."""
        return _rotated(points_m, np.array([self.rotation_rad]))[0] + self.translation_m


def align(truth_m: np.ndarray, estimate_m: np.ndarray) -> Alignment:
    """
    Return the rotation and translation of the ground truth that minimise MAE_L.

    MAE_L(R, t) = mean(|r_x - t_x| + |r_y - t_y|) with the residuals r_k = p_k - R p_k^gt. For a
    given R the two axes separate, and each is a mean of |r - t| over the frames: convex in t,
    with the slope (frames with r < t, less those with r > t) / n. The slope changes its sign at
    the median, so the best translation is the median of the residuals, axis by axis. What is left
    is a search over one angle: a grid over the whole turn, a finer one around its best minima,
    and golden section between the neighbours of the finest. The paper searches the translation
    on a grid, too; this finds the same minimum, without the grid's rounding.

    Parameters
    ----------
    truth_m, estimate_m : ndarray of shape (n, 2), n > 0
        Positions of the same n frames.

    """
    def cost(angles_rad):
        return _best_translations(truth_m, estimate_m, angles_rad)[0]

    coarse = cost(COARSE_ANGLES_RAD)
    basins = np.flatnonzero((coarse <= np.roll(coarse, 1)) & (coarse <= np.roll(coarse, -1)))
    basins = basins[np.argsort(coarse[basins], kind='stable')][:N_BASINS]
    fine = np.concatenate([COARSE_ANGLES_RAD[k] + FINE_OFFSETS_RAD for k in basins])
    best = fine[np.argmin(cost(fine))]
    step = FINE_OFFSETS_RAD[1] - FINE_OFFSETS_RAD[0]
    angles = np.array([best, _golden_section(cost, best - step, best + step)])
    costs, translations = _best_translations(truth_m, estimate_m, angles)
    winner = int(np.argmin(costs))
    return Alignment(float(wrap_angle(angles[winner])), translations[winner])


def align_least_squares(truth_m: np.ndarray, estimate_m: np.ndarray) -> Alignment:
    """
    Return the rotation and translation of the ground truth that minimise the squared distances.

    Umeyama's alignment without scale (IEEE PAMI 13(4), 1991) in the plane, where its singular
    value decomposition comes down to one angle: with both sets of positions about their means,
    g_k and p_k, it is that of (sum g_k . p_k, sum g_k x p_k). The means lie on each other.

    Parameters
    ----------
    truth_m, estimate_m : ndarray of shape (n, 2), n > 0
        Positions of the same n frames.

    """
    truth_mean, estimate_mean = truth_m.mean(axis=0), estimate_m.mean(axis=0)
    (g_x, g_y), (p_x, p_y) = (truth_m - truth_mean).T, (estimate_m - estimate_mean).T
    rotation_rad = float(np.arctan2(g_x @ p_y - g_y @ p_x, g_x @ p_x + g_y @ p_y))
    turned_mean = _rotated(truth_mean[None], np.array([rotation_rad]))[0, 0]
    return Alignment(rotation_rad, estimate_mean - turned_mean)


def _best_translations(truth_m, estimate_m, angles_rad):
    """Return the costs, shape (a,), and the translations, shape (a, 2), that reach them."""
    residuals = estimate_m - _rotated(truth_m, angles_rad)
    translations = np.median(residuals, axis=1)
    return np.abs(residuals - translations[:, None]).mean(axis=1).sum(axis=1), translations


def _rotated(points_m, angles_rad):
    """Return points of shape (n, 2) turned by each of a angles: an ndarray of (a, n, 2)."""
    c, s = np.cos(angles_rad), np.sin(angles_rad)
    rotations_transposed = np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -2)
    return points_m @ rotations_transposed


def _golden_section(cost, low_rad, high_rad):
    """Return the angle of the minimum of a cost that has one minimum in [low_rad, high_rad]."""
    a, b = high_rad - GOLDEN * (high_rad - low_rad), low_rad + GOLDEN * (high_rad - low_rad)
    cost_a, cost_b = cost(np.array([a, b]))
    while high_rad - low_rad > RESOLUTION_RAD:
        if cost_a <= cost_b:
            high_rad, b, cost_b = b, a, cost_a
            a = high_rad - GOLDEN * (high_rad - low_rad)
            cost_a = cost(np.array([a]))[0]
        else:
            low_rad, a, cost_a = a, b, cost_b
            b = low_rad + GOLDEN * (high_rad - low_rad)
            cost_b = cost(np.array([b]))[0]
    return (low_rad + high_rad) / 2
