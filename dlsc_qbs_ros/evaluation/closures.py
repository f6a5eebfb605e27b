"""Which loop closures of a map join what does not belong together."""

from __future__ import annotations

from typing import Sequence

import numpy as np

from .association import associate
from .place_recognition import MAX_DISTANCE_M, MAX_TURN_RAD
from ..core.geometry import between, wrap_angle
from ..core.types import GroundTruthSample, Pose2


def false_closures(result, ground_truth: Sequence[GroundTruthSample]) -> int | None:
    """
    Count the closures of the final map that are wrong; None where no experience has truth.

    A closure is wrong when, seen from its one experience, the other lies more than 1 m from
    where it truly was, or heads more than 0.5 rad otherwise. One of an experience without ground
    truth is not judged.

    Parameters
    ----------
    result : pipeline.runner.RunResult
        Its `stamps_ns`, `experiences`, `births` and `closures` are read.
    ground_truth : sequence of GroundTruthSample
        In any order; may be empty.

    """
    truth = associate(result.stamps_ns, ground_truth)[result.births]
    if not np.isfinite(truth).any():
        return None
    return sum(_is_false(result.experiences[[a, b]], truth[[a, b]]) for a, b in result.closures)


def _is_false(mapped: np.ndarray, truth: np.ndarray) -> bool:
    """Whether two poses (2, 3) of the map are to each other otherwise than in truth."""
    ours, true = (between(Pose2(*a), Pose2(*b)) for a, b in (mapped, truth))
    return bool(np.hypot(ours.x_m - true.x_m, ours.y_m - true.y_m) > MAX_DISTANCE_M
                or abs(wrap_angle(ours.yaw_rad - true.yaw_rad)) > MAX_TURN_RAD)
