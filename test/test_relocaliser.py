"""Relocalisation: what is believed of views alone, and what is not."""

from math import inf

import numpy as np
import pytest

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import Pose2, Track
from dlsc_qbs_ros.pipeline.relocaliser import Relocaliser

# A corridor of places a metre apart; a run of views is 14 times 0.25 m long.
POSES = np.column_stack([np.arange(40.0), np.zeros(40), np.zeros(40)])
ONE_PIECE = np.zeros(40, int)


def score(place, best=0.9, rival=None, rival_score=0.85):
    """Return scores of one place, and of another that looks like it."""
    scores = np.full(40, 0.3)
    if rival is not None:
        scores[rival] = rival_score
    scores[place] = best
    return scores


def find(relocaliser, place, metres, pieces=ONE_PIECE, **scores):
    """Sight a place after so many metres straight on by odometry, a metre a second."""
    return relocaliser.find(score(place, **scores), POSES, pieces,
                            Track(Pose2(metres, 0.0, 0.0), metres, metres))


def test_a_place_is_believed_at_a_second_run_of_views_that_agrees():
    relocaliser = Relocaliser(Config())
    assert [find(relocaliser, 10 + k, float(k)) for k in range(5)] == [
        None, None, None, None, 14]


def test_two_runs_that_share_a_view_are_one():
    relocaliser = Relocaliser(Config())
    assert find(relocaliser, 10, 0.0) is find(relocaliser, 13, 3.4) is None
    assert find(relocaliser, 14, 3.6) == 14


@pytest.mark.parametrize('place', [3, 20])
def test_runs_that_odometry_cannot_lead_between_confirm_nothing(place):
    relocaliser = Relocaliser(Config())
    assert find(relocaliser, 10, 0.0) is find(relocaliser, place, 4.0) is None


def test_a_place_is_not_believed_while_most_runs_speak_for_another():
    relocaliser = Relocaliser(Config())
    find(relocaliser, 10, 0.0)
    for k in range(3):
        assert find(relocaliser, 30, 1.0 + k) is None
    assert find(relocaliser, 14, 4.0) is None


def test_what_is_less_alike_than_the_threshold_is_no_sighting():
    relocaliser = Relocaliser(Config())
    for k in range(12):
        assert find(relocaliser, 10 + k, float(k), best=0.79) is None


def test_of_two_look_alikes_neither_is_a_sighting():
    relocaliser = Relocaliser(Config())
    for k in range(12):
        assert find(relocaliser, 10 + k, float(k), rival=30 + k % 5) is None


def test_the_neighbours_of_a_place_are_no_rivals_of_it():
    relocaliser = Relocaliser(Config())
    found = [find(relocaliser, 10 + k, float(k), rival=12 + k) for k in range(5)]
    assert found[-1] == 14


def test_a_look_alike_in_another_piece_is_no_rival_as_it_may_be_the_same_place():
    relocaliser = Relocaliser(Config())
    pieces = (np.arange(40) >= 30).astype(int)
    found = [find(relocaliser, 10 + k, float(k), pieces, rival=35) for k in range(5)]
    assert found[-1] == 14


def test_an_old_sighting_confirms_nothing_any_more():
    """Odometry that has drifted for long agrees with anything."""
    relocaliser = Relocaliser(Config())
    find(relocaliser, 10, 0.0)
    assert find(relocaliser, 25, 15.0) is None


def test_what_was_sighted_before_a_break_is_forgotten():
    relocaliser = Relocaliser(Config())
    find(relocaliser, 10, 0.0)
    relocaliser.clear()
    assert find(relocaliser, 14, 4.0) is None


def test_where_everything_is_in_reach_of_odometry_nothing_is_found():
    assert Relocaliser(Config()).find(
        np.full(40, -inf), POSES, ONE_PIECE, Track(Pose2(0.0, 0.0, 0.0), 0.0, 0.0)) is None
