"""Which view cell a run of views is taken for: likeness, weighed against the odometry."""

import numpy as np
import pytest

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.sequence import Scores
from dlsc_qbs_ros.core.types import IDENTITY, Pose2
from dlsc_qbs_ros.pipeline.journey import Journey
from dlsc_qbs_ros.pipeline.matcher import Match, Matcher

# A view by itself is a run, 3.5 m long; odometry makes up for a likeness of 0.2.
CONFIG = Config().override({
    'ratslam.sequence_length': 1, 'ratslam.keyframe_distance_m': 3.5,
    'ratslam.threshold': 0.8, 'ratslam.tracking_threshold': 0.6})
N = 40
SURE_M, UNSURE_M = 0.2, 5.0


def match(here, sigma_m, likeness, n_recent=0, n_apart=0, config=CONFIG, runs=None):
    """
    Return what is matched of places a metre apart.

    The last `n_recent` of them were just flown by, the first `n_apart` are of another piece of
    the map. The robot is believed to be at the place `here`, which is known by `sigma_m`;
    `likeness` is that of some places, and 0.3 for all others; `runs` are scores besides, of the
    last view or of runs, that are otherwise.
    """
    journey = Journey(config)
    matcher = Matcher(config, journey)
    for k in range(N):
        if k == n_apart:
            journey.break_off()
        if k == N - n_recent:
            journey.move(Pose2(0.0, 100.0, 0.0), 100.0)
        journey.move(IDENTITY, 0.1)
        journey.visits.create(Pose2(float(k), 0.0, 0.0))
        matcher.add_experience(k)
    if not n_recent:
        journey.move(Pose2(0.0, 100.0, 0.0), 100.0)
    journey.put(here, IDENTITY)
    journey.drift.anchor(sigma_m, 0.1)
    score = row(likeness)
    scores = Scores(score, score, score, np.ones(N, bool))
    return matcher.match(scores._replace(**{
        name: row(values) for name, values in (runs or {}).items()}))


def row(likeness):
    values = np.full(N, 0.3)
    values[list(likeness)] = list(likeness.values())
    return values


def test_where_odometry_expects_it_a_place_may_be_less_alike():
    assert match(10, SURE_M, {10: 0.65}) == Match(10, False)
    assert match(10, SURE_M, {10: 0.55}) is None
    assert match(10, UNSURE_M, {10: 0.65}) is None
    assert match(10, UNSURE_M, {10: 0.85}) == Match(10, True)


@pytest.mark.parametrize('elsewhere, expected', [(0.84, Match(11, False)), (0.86, None)])
def test_but_not_by_more_than_odometry_makes_up_for_where_another_is_the_likeliest(
        elsewhere, expected):
    """As one bay of shelves is where the map is wrong about the place that is really seen."""
    assert match(10, SURE_M, {11: 0.65, 30: elsewhere}) == expected


def test_what_was_just_flown_by_outdoes_no_place():
    assert match(10, SURE_M, {11: 0.65, 39: 0.99}, n_recent=3) == Match(11, False)
    assert match(10, SURE_M, {11: 0.65, 35: 0.99}, n_recent=3) is None


def test_nor_does_what_lies_in_another_piece_of_the_map():
    assert match(30, SURE_M, {31: 0.65, 10: 0.99}, n_apart=20) == Match(31, False)
    assert match(30, SURE_M, {31: 0.65, 10: 0.99}) is None


def test_a_place_outdoes_none_by_less_than_it_is_more_alike():
    """Whatever the thresholds: where tracking asks for more, odometry makes up for nothing."""
    config = CONFIG.override({'ratslam.tracking_threshold': 0.9})
    assert match(10, SURE_M, {10: 0.95, 30: 0.94}, config=config) == Match(10, False)


@pytest.mark.parametrize('rival, likeness, expected', [
    (17, 0.79, None), (17, 0.81, None), (17, 0.74, Match(8, True)),
    (11, 0.84, Match(8, True)), (30, 0.84, Match(8, True))],
    ids=['alike', 'more_alike', 'less_alike', 'within_the_run', 'out_of_reach'])
def test_a_place_that_odometry_does_not_expect_must_be_the_only_one_in_reach(
        rival, likeness, expected):
    assert match(10, UNSURE_M, {8: 0.85, rival: likeness}) == expected


def test_a_run_ends_where_the_last_view_is_no_more_of_it():
    """As on the way out of a crossing, where the run as a whole goes on being alike."""
    assert match(10, SURE_M, {10: 0.75}, runs={'last': {10: 0.61}}) == Match(10, False)
    assert match(10, SURE_M, {10: 0.75}, runs={'last': {10: 0.59}}) is None


class TestShortRun:
    """Where paths meet for a moment, a run is too short to be alike as a whole."""

    LONG = {8: 0.5}
    CONFIG = CONFIG.override({
        'ratslam.sequence_length': 14, 'ratslam.keyframe_distance_m': 0.5})

    @pytest.mark.parametrize('likeness, expected', [(0.83, Match(8, True)), (0.81, None)])
    def test_it_shows_a_place_if_it_is_more_alike_than_a_whole_one_must_be(
            self, likeness, expected):
        assert match(10, UNSURE_M, {8: likeness}, runs={'long': self.LONG}) == expected

    def test_and_odometry_allows_that(self):
        assert match(10, SURE_M, {30: 0.9}, runs={'long': self.LONG}) is None

    @pytest.mark.parametrize('rival, likeness, expected', [
        (23, 0.81, None), (23, 0.79, Match(8, True)), (9, 0.85, Match(8, True)),
        (30, 0.89, Match(8, True))], ids=['alike', 'less_alike', 'within_the_run', 'out_of_reach'])
    def test_and_no_other_place_in_reach_is_about_as_alike(self, rival, likeness, expected):
        assert match(10, UNSURE_M, {8: 0.9, rival: likeness}, runs={'long': self.LONG},
                     config=self.CONFIG) == expected

    def test_one_that_is_out_of_reach_is_none_whatever_is_somewhat_alike_in_it(self):
        assert match(10, SURE_M, {10: 0.82, 30: 0.9}, runs={'long': self.LONG}) is None
        assert match(30, SURE_M, {0: 0.9}, runs={'long': self.LONG}) is None

    @pytest.mark.parametrize('long', [{10: 0.7, 30: 0.95}, {10: 0.9, 23: 0.88}],
                             ids=['outdone', 'ambiguous'])
    def test_it_makes_no_doubtful_longer_one_certain(self, long):
        assert match(10, UNSURE_M if 23 in long else SURE_M, {10: 0.9},
                     runs={'long': long, 'last': long}, config=self.CONFIG) is None

    def test_it_shows_nothing_where_odometry_makes_up_for_nothing(self):
        """So that no likeness would be more than enough, and no rival about as alike."""
        config = self.CONFIG.override({'ratslam.tracking_threshold': 0.8})
        assert match(10, UNSURE_M, {8: 0.9}, runs={'long': self.LONG}, config=config) is None

    def test_a_longer_run_comes_first(self):
        assert match(10, SURE_M, {11: 0.9}, runs={'long': {10: 0.7}, 'last': {10: 0.7}}) == Match(
            10, False)


def test_a_place_of_the_lost_stretch_may_lie_off_by_the_odometry_that_leads_to_it():
    made = Journey(Config())
    made.visits.create(IDENTITY)
    made.break_off()
    made.visits.create(IDENTITY)
    made.move(Pose2(20.0, 0.0, 0.0), 20.0)
    made.meet(0, IDENTITY)
    made.drift.anchor(0.1, 0.1)
    seen = Matcher(Config(), made)
    assert seen.trust(0) == (pytest.approx(0.9), pytest.approx(0.5))
    assert max(seen.trust(1)) < 0.5 and np.isfinite(seen.trust(1)).all()


class TestBend:
    """A run of views may be met a view early or late, in a bend on another heading by the turn."""

    # Before each place; odometry breaks before the last one, and that turn is of no path.
    TURNS_RAD = [0.0, 0.0, 0.0, 0.6, -0.24, 0.0, 1.5]

    def journey(self):
        journey = Journey(CONFIG)
        matcher = Matcher(CONFIG, journey)
        for k, turn_rad in enumerate(self.TURNS_RAD):
            if k == len(self.TURNS_RAD) - 1:
                journey.break_off()
            journey.move(Pose2(1.0, 0.0, turn_rad), 1.0)
            journey.visits.create(Pose2(float(k), 0.0, 0.0))
            matcher.add_experience(k)
        return journey, matcher

    @pytest.mark.parametrize('place, turn_rad', [
        (0, 0.0), (1, 0.0), (2, 0.6), (3, 0.6), (4, 0.24), (5, 0.0), (6, 0.0)])
    def test_the_heading_is_known_less_there(self, place, turn_rad):
        _, matcher = self.journey()
        assert matcher.sigmas_at(place) == (
            CONFIG.ratslam.match_position_sigma_m,
            pytest.approx(np.hypot(CONFIG.ratslam.match_yaw_sigma_rad, turn_rad)))

    @pytest.mark.parametrize('place, share', [(0, 0.5), (3, 1 / 38)])
    def test_so_odometry_counts_for_more_beside_it(self, place, share):
        """By variances: here odometry knows the heading as well as a match on the straight."""
        journey, matcher = self.journey()
        journey.put(place, Pose2(0.0, 0.0, 0.3))
        journey.drift.anchor(0.0, CONFIG.ratslam.match_yaw_sigma_rad)
        assert matcher.trust(place)[1] == pytest.approx(1.0 - share)
        assert matcher.offset_from(place).yaw_rad == pytest.approx(0.3 * (1.0 - share))
