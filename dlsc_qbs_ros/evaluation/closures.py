"""Which loop closures of a map join what does not belong together."""

from __future__ import annotations

from typing import Sequence

import numpy as np

from .association import associate
from .place_recognition import is_same
from ..core.geometry import between_rows
from ..core.types import GroundTruthSample


def false_closures(result, ground_truth: Sequence[GroundTruthSample]) -> int | None:
    """
    Count the closures of the final map that are wrong; None where no experience has truth.

    A closure is wrong when it has its second experience, seen from the first, more than 1 m from
    where that truly was, or more than 0.5 rad otherwise, be it outvoted in the map or not. One of
    an experience without ground truth is not judged.

    Parameters
    ----------
    result : pipeline.runner.RunResult
        Its `stamps_ns`, `births`, `closures` and `closure_motions` are read.
    ground_truth : sequence of GroundTruthSample
        In any order; may be empty.

    """
    truth = associate(result.stamps_ns, ground_truth)[result.births]
    if not np.isfinite(truth).any():
        return None
    first, second = truth[result.closures.T]
    true = between_rows(first, second)
    is_known = np.isfinite(true).all(axis=1)
    return int(np.count_nonzero(is_known & ~is_same(result.closure_motions, true)))
