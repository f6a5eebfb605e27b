"""Matching after odometry broke: which old place is met, and how much the robot is moved to it."""

import numpy as np
import pytest

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import IDENTITY, Pose2
from dlsc_qbs_ros.pipeline.journey import Journey
from dlsc_qbs_ros.pipeline.matcher import Matcher

CONFIG = Config().override({'ratslam.sequence_length': 2})
STEP = Pose2(1.0, 0.0, 0.0)
N = 20


def matcher(is_broken):
    """Return a matcher in a map of N old places in a row, and a robot at number 10."""
    made = Journey(CONFIG)
    made.visits.create(IDENTITY)
    for _ in range(N - 1):
        made.move(STEP, 1.0)
        made.visits.create(made.visits.pose())
    made.move(IDENTITY, 20.0)
    made.move(Pose2(4.0, 0.0, 0.0), 0.0)
    if is_broken:
        made.break_off()
    made.put(10, IDENTITY)
    made.drift.anchor(0.1, 0.1)
    found = Matcher(CONFIG, made)
    for cell in range(N):
        found.add_experience(cell)
    return found


def match(matcher, *views):
    """Return what is matched at the end of views that are so much alike places 9, 10 and so on."""
    for cell, likeness in enumerate(views, start=11 - len(views)):
        values = np.zeros(N, np.float32)
        values[cell] = likeness
        score = matcher.score(values)
    return matcher.match(score)


@pytest.mark.parametrize('is_broken', [False, True])
def test_a_run_of_views_that_is_like_that_of_an_old_place_is_matched(is_broken):
    assert match(matcher(is_broken), 0.9, 0.7) == (10, False)


def test_a_run_from_before_odometry_broke_ends_with_the_last_view_that_is_like_it():
    assert match(matcher(is_broken=False), 0.9, 0.5) == (10, False)
    assert match(matcher(is_broken=True), 0.9, 0.5) is None


def test_a_place_of_the_lost_stretch_may_lie_off_by_the_odometry_that_leads_to_it():
    made = Journey(CONFIG)
    made.visits.create(IDENTITY)
    made.break_off()
    made.visits.create(IDENTITY)
    made.move(Pose2(20.0, 0.0, 0.0), 20.0)
    made.meet(0, IDENTITY)
    made.drift.anchor(0.1, 0.1)
    seen = Matcher(CONFIG, made)
    assert seen.trust(0) == (pytest.approx(0.9), pytest.approx(0.5))
    assert max(seen.trust(1)) < 0.5 and np.isfinite(seen.trust(1)).all()
