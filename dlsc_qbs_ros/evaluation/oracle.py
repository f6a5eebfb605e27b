"""The ceiling of the back end: places told by ground truth instead of by an image."""

from __future__ import annotations

from typing import Sequence

import numpy as np

from .association import associate
from .place_recognition import MAX_DISTANCE_M, MAX_TURN_RAD
from ..core.geometry import wrap_angle
from ..core.types import Frame, GroundTruthSample

# Farther apart than this, all poses are as unlike as views of different places are.
FARTHEST_M = MAX_DISTANCE_M
METRES_PER_RAD = MAX_DISTANCE_M / MAX_TURN_RAD


class PoseDistance:
    """
    How far two true poses are apart, in metres: a distance.

    A turn counts for as many metres as make it, too, no longer the same place.
    """

    direction = -1
    worst = FARTHEST_M

    def prepare(self, descriptor: np.ndarray) -> np.ndarray:
        """Return poses (..., 4) as they are."""
        return descriptor

    def compare(self, query: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """Return the distances (n,), in [0, 1] m, of one pose with n others (n, 4)."""
        apart = kept - query
        turn_m = METRES_PER_RAD * np.abs(wrap_angle(apart[:, 2]))
        distance_m = np.hypot(apart[:, 0], apart[:, 1])
        return np.minimum(np.maximum(distance_m, turn_m), FARTHEST_M)


class Oracle:
    """
    Where each frame was truly taken, as its descriptor.

    Parameters
    ----------
    stamps_ns : sequence of int
        Of the frames to come.
    ground_truth : sequence of GroundTruthSample
        In any order.

    """

    def __init__(self, stamps_ns: Sequence[int], ground_truth: Sequence[GroundTruthSample]):
        self.measure = PoseDistance()
        poses = associate(np.array(stamps_ns, np.int64), ground_truth)
        self._poses = dict(zip(stamps_ns, poses))

    def describe(self, frame: Frame) -> np.ndarray:
        """
        Return the true pose of a frame.

        Returns
        -------
        ndarray of shape (4,), float64
            x, y in metres, yaw in radians and 1, which tells a pose from no pose: all zeros
            where ground truth is silent.

        """
        pose = self._poses[frame.stamp_ns]
        return np.append(pose, 1.0) if np.isfinite(pose).all() else np.zeros(4)
