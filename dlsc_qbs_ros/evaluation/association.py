"""Ground truth at the stamps of the estimate."""

from __future__ import annotations

from typing import Sequence

import numpy as np

from ..core.geometry import wrap_angle
from ..core.types import GroundTruthSample

MAX_GAP_S = 1.0


def associate(stamps_ns: np.ndarray, ground_truth: Sequence[GroundTruthSample],
              max_gap_s: float = MAX_GAP_S) -> np.ndarray:
    """
    Interpolate ground truth linearly at the given stamps, the heading the shorter way round.

    Parameters
    ----------
    stamps_ns : ndarray of shape (n,), int64
        The stamps asked for.
    ground_truth : sequence of GroundTruthSample
        In any order.
    max_gap_s : float
        Two samples further apart than this say nothing about the time between them.

    Returns
    -------
    ndarray of shape (n, 3)
        x, y in metres and yaw in radians; a row of NaN where ground truth is silent: before its
        first sample, after its last one, inside a gap.

    """
    stamps_ns = np.asarray(stamps_ns, dtype=np.int64)
    poses = np.full((len(stamps_ns), 3), np.nan)
    if not ground_truth:
        return poses
    ordered = sorted(ground_truth, key=lambda sample: sample.stamp_ns)
    truth_ns = np.array([sample.stamp_ns for sample in ordered], dtype=np.int64)
    truth = np.array([sample.pose for sample in ordered], dtype=float)

    after = np.searchsorted(truth_ns, stamps_ns)
    inside = after < len(truth)
    after[~inside] = 0
    exact = truth_ns[after] == stamps_ns
    before = np.where(exact, after, after - 1)
    gap_ns = truth_ns[after] - truth_ns[before]
    inside &= exact | ((after > 0) & (gap_ns <= round(max_gap_s * 1e9)))
    fraction = (stamps_ns - truth_ns[before]) / np.maximum(gap_ns, 1)
    step = truth[after] - truth[before]
    step[:, 2] = wrap_angle(step[:, 2])
    poses[inside] = (truth[before] + fraction[:, None] * step)[inside]
    poses[:, 2] = wrap_angle(poses[:, 2])
    return poses
