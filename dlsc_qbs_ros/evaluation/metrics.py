"""The paper's two figures, the absolute trajectory error, and all of them for one run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

import numpy as np

from .alignment import align, align_least_squares, Alignment
from .association import associate
from ..core.types import GroundTruthSample

CHUNK = 256
# Squared distances, in units of the variance, that 95 % of planar normal errors stay within.
CHI_SQUARE_95 = 5.991


def mae_l(estimate_m: np.ndarray, truth_m: np.ndarray) -> float:
    """
    Return the localisation error in metres: mean over k of |x_k - x_k^gt| + |y_k - y_k^gt|.

    Both are ndarrays of shape (n, 2), n > 0, in the same frame; row k of both is frame k.
    """
    return float(np.abs(estimate_m - truth_m).sum(axis=1).mean())


def mae_m(estimate_m: np.ndarray, truth_m: np.ndarray) -> float:
    """
    Return the mapping error in metres: mean over k of min_j |x_k - x_j^gt| + |y_k - y_j^gt|.

    The estimate has shape (n, 2), the ground truth (m, 2), n, m > 0, in the same frame. Memory
    stays at CHUNK x m distances.
    """
    nearest = [_distances(estimate_m[k:k + CHUNK], truth_m).min(axis=1)
               for k in range(0, len(estimate_m), CHUNK)]
    return float(np.concatenate(nearest).mean())


def ate_rmse_m(estimate_m: np.ndarray, truth_m: np.ndarray) -> float:
    """
    Return the absolute trajectory error: the root of the mean squared distance, in metres.

    Both are ndarrays of shape (n, 2), n > 0; row k of both is frame k. They may be in different
    frames: the ground truth is moved by `align_least_squares` first, as the field does.
    """
    moved_m = align_least_squares(truth_m, estimate_m).apply(truth_m)
    return float(np.sqrt(np.square(estimate_m - moved_m).sum(axis=1).mean()))


def share_within_95(estimate_m: np.ndarray, truth_m: np.ndarray, sigma_m: np.ndarray) -> float:
    """
    Return the share of frames whose error lies within the circle that 95 % ought to lie in.

    Positions are ndarrays of shape (n, 2), n > 0, in the same frame, and sigma_m, (n,), is the
    deviation that was told of the estimate along either axis.
    """
    squared = np.square(estimate_m - truth_m).sum(axis=1)
    return float((squared <= CHI_SQUARE_95 * np.square(sigma_m)).mean())


def _distances(a, b):
    """Return the L1 distances of points (n, 2) and (m, 2) as an ndarray of shape (n, m)."""
    return np.abs(a[:, None, 0] - b[None, :, 0]) + np.abs(a[:, None, 1] - b[None, :, 1])


@dataclass(frozen=True)
class Metrics:
    """
    How far a run was off, and odometry alone on the same frames.

    `frames` were compared, `frames_left_out` had no ground truth. `truth_m` is the ground truth
    in the SLAM frame at each code, shape (n, 2), NaN where a frame was left out; it is also the
    set of points that MAE_M searches. The absolute trajectory error is that of the poses that
    MAE_L compares, under an alignment of its own; `within_95` judges their covariance, under
    that of MAE_L.
    """

    mae_l: float
    mae_m: float
    odometry_mae_l: float
    odometry_mae_m: float
    ate_rmse_m: float
    odometry_ate_rmse_m: float
    within_95: float
    frames: int
    frames_left_out: int
    alignment: Alignment
    truth_m: np.ndarray


def evaluate_run(result, ground_truth: Sequence[GroundTruthSample]) -> Metrics | None:
    """
    Compare a run with ground truth; None when no frame has any.

    Parameters
    ----------
    result : pipeline.runner.RunResult
        Its `stamps_ns`, `poses` (for MAE_L and ATE) with their `sigmas`, `final_poses` (for MAE_M)
        and `odometry` are read.
    ground_truth : sequence of GroundTruthSample
        In any order; may be empty.

    Notes
    -----
    One alignment, the one that minimises MAE_L, serves both figures of the run. Odometry lives in
    a frame of its own and gets its own best alignment, so that it is not blamed for the map's.

    """
    truth = associate(result.stamps_ns, ground_truth)[:, :2]
    used = np.isfinite(truth).all(axis=1)
    if not used.any():
        return None
    poses, final, odometry = (
        np.asarray(p)[used, :2] for p in (result.poses, result.final_poses, result.odometry))
    alignment, odometry_alignment = align(truth[used], poses), align(truth[used], odometry)
    moved, moved_to_odometry = (
        a.apply(truth[used]) for a in (alignment, odometry_alignment))
    frames = int(used.sum())
    return Metrics(
        mae_l(poses, moved), mae_m(final, moved),
        mae_l(odometry, moved_to_odometry), mae_m(odometry, moved_to_odometry),
        ate_rmse_m(poses, truth[used]), ate_rmse_m(odometry, truth[used]),
        share_within_95(poses, moved, np.asarray(result.sigmas)[used, 0]),
        frames, len(used) - frames, alignment, alignment.apply(truth))
