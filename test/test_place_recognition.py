"""Precision and recall of places, the oracle and false closures, by hand and by law."""

from dlsc_qbs_ros.core.local_view import Cosine, ViewCells
from dlsc_qbs_ros.core.types import (
    Code, Dictionary, Frame, GroundTruthSample, OdometrySample, Pose2, View)
from dlsc_qbs_ros.evaluation.closures import false_closures
from dlsc_qbs_ros.evaluation.oracle import Oracle
from dlsc_qbs_ros.evaluation.place_recognition import MAX_VIEWS, Recognition, recognise
from dlsc_qbs_ros.pipeline.runner import RunResult
import numpy as np
import pytest

SECOND_NS = 10**9
# Two laps of a round of 20 s with a place a second, each 3 m from the last.
PLACES = [*range(20), *range(20)]
ANGLES = np.linspace(0.0, np.pi / 2, 20)


def truth_of(places=PLACES, turn_rad=0.0):
    return [GroundTruthSample(k * SECOND_NS, Pose2(3.0 * place, 0.0, turn_rad * (k >= 20)))
            for k, place in enumerate(places)]


def events_of(codes, dictionaries=()):
    """Return views of one pixel, the place, and codes, with dictionaries before their codes."""
    dictionaries = {dictionary.stamp_ns: dictionary for dictionary in dictionaries}
    name = None
    for k, values in enumerate(codes):
        stamp_ns = k * SECOND_NS
        yield OdometrySample(stamp_ns, Pose2(0.0, 0.0, 0.0))
        if stamp_ns in dictionaries:
            name = stamp_ns
            yield dictionaries[name]
        yield View(stamp_ns, np.full((1, 1), PLACES[k % 40], np.uint8))
        yield Code(stamp_ns, np.asarray(values, np.float32), name)


def directions(places=PLACES):
    """Return a code for each place; those of other places differ."""
    return np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])[list(places)]


def found(codes, truth=None, measure=None):
    return recognise(events_of(codes), truth_of() if truth is None else truth,
                     ViewCells(measure or Cosine()), None)


class TestFigures:
    """Top-1, R99 and R90 of cases that can be counted."""

    def test_codes_that_tell_all_places_apart_find_every_revisit(self):
        result = found(directions())
        assert (result.top_1, result.recall_at(0.99), result.n_revisits) == (1.0, 1.0, 20)

    def test_a_wrong_match_surer_than_all_right_ones_leaves_nothing_at_99_percent(self):
        codes = directions().tolist()
        codes[25] = codes[7]
        result = found(codes)
        assert result.top_1 == pytest.approx(19 / 20)
        # Nineteen right and one wrong are equally sure: 95 % at best.
        assert (result.recall_at(0.99), result.recall_at(0.90)) == (0.0, pytest.approx(19 / 20))

    def test_a_wrong_match_less_sure_than_the_right_ones_costs_only_itself(self):
        codes = directions(PLACES).astype(float)
        codes[25] = -codes[0]
        result = found(codes.tolist())
        assert result.recall_at(0.99) == pytest.approx(19 / 20)
        assert result.precision[-1] < 1.0

    def test_a_match_where_nobody_was_before_counts_against_precision(self):
        places = [*range(20), *range(10), *range(100, 110)]
        result = found(directions(), truth_of(places))
        assert result.n_revisits == 10
        assert result.top_1 == 1.0
        assert result.precision[-1] == pytest.approx(10 / 25)

    def test_a_view_without_ground_truth_is_nobodys_match(self):
        result = found(directions(), truth_of()[1:])
        assert (result.recall_at(0.99), result.n_revisits, result.n_views) == (1.0, 19, 39)

    def test_views_younger_than_15_s_are_no_match(self):
        result = found(directions([0] * 40), truth_of([0] * 40))
        assert result.n_revisits == 25

    def test_a_place_seen_with_another_heading_is_another(self):
        assert found(directions(), truth_of(turn_rad=0.4)).top_1 == 1.0
        assert found(directions(), truth_of(turn_rad=0.6)) is None

    def test_blank_codes_find_nothing_but_stand_among_the_views(self):
        codes = directions() * 1.0
        codes[30:] = 0.0
        result = found(codes)
        assert result.top_1 == pytest.approx(0.5)
        assert result.n_views == 40

    def test_nothing_can_be_told_without_revisits_or_ground_truth(self):
        assert found(directions(), []) is None
        assert found(directions(), truth_of(range(40))) is None

    def test_recall_never_falls_and_ends_at_top_1(self):
        codes = np.random.default_rng(0).normal(size=(40, 3))
        result = found(codes)
        assert (np.diff(result.recall) >= 0.0).all()
        assert result.recall[-1] == result.top_1

    def test_of_a_long_flight_views_are_taken_at_equal_distances(self):
        n = 2 * MAX_VIEWS + 1
        truth = [GroundTruthSample(k * SECOND_NS, Pose2(3.0 * (k % 60), 0.0, 0.0))
                 for k in range(n)]
        result = found([[PLACES[k % 40] + 1.0, 1.0] for k in range(n)], truth)
        assert result.n_views == n // 3

    def test_json_holds_the_figures(self):
        result = Recognition(np.array([1.0, 0.95]), np.array([0.4, 0.8]), 0.8, 5, 9)
        assert result.as_json() == {
            'top_1': 0.8, 'r99': 0.4, 'r90': 0.8, 'revisits': 5, 'views': 9}


class TestDictionaries:
    """Codes of two dictionaries are never compared with each other."""

    first = Dictionary(0, np.array([[1.0, 0.0], [0.0, 1.0]], np.float32))
    second = Dictionary(25 * SECOND_NS, np.array([[0.0, 1.0], [-1.0, 0.0]], np.float32))

    def setup_method(self):
        self.encoded = []

    def encode(self, dictionary, views):
        self.encoded.append((dictionary.stamp_ns, len(views)))
        places = [int(view[0, 0]) for view in views]
        return (directions(places) @ dictionary.atoms.T).astype(np.float32).reshape(-1, 2)

    def codes(self):
        before, after = directions()[:25], directions()[25:]
        return np.concatenate([before @ self.first.atoms.T, after @ self.second.atoms.T])

    def events(self):
        return events_of(self.codes(), (self.first, self.second))

    def test_as_it_flew_earlier_views_are_re_encoded_under_the_dictionary_of_the_time(self):
        result = recognise(self.events(), truth_of(), ViewCells(Cosine()), self.encode)
        assert result.top_1 == result.recall_at(0.99) == 1.0
        assert self.encoded == [(0, 0), (25 * SECOND_NS, 25)]

    def test_without_re_encoding_the_same_codes_are_worthless(self):
        assert found(self.codes()).top_1 < 0.5

    def test_under_the_last_dictionary_everything_is_encoded_again(self):
        events = [event if not isinstance(event, Code) else
                  Code(event.stamp_ns, np.zeros(2, np.float32), event.dictionary_ns)
                  for event in self.events()]
        result = recognise(
            events, truth_of(), ViewCells(Cosine()), self.encode, under_last=True)
        assert result.top_1 == 1.0
        assert (25 * SECOND_NS, 40) in self.encoded


class TestOracle:
    """Ground truth as a descriptor: a true revisit is near, whatever the images show."""

    def oracle(self, truth):
        return Oracle([sample.stamp_ns for sample in truth], truth)

    def described(self, oracle, n=40):
        grey = np.zeros((4, 4), np.uint8)
        return [oracle.describe(Frame(k * SECOND_NS, grey)) for k in range(n)]

    def distance(self, a, b):
        measure = Oracle([], []).measure
        value, = measure.compare(measure.prepare(np.array([*a, 1.0])), np.array([[*b, 1.0]]))
        return value

    def test_it_recognises_every_place_with_certainty(self):
        oracle = self.oracle(truth_of())
        result = found(self.described(oracle), measure=oracle.measure)
        assert result.top_1 == result.recall_at(0.99) == 1.0

    def test_distance_by_hand(self):
        assert self.distance((0.0, 0.0, 0.0), (0.3, 0.4, 0.1)) == pytest.approx(0.5)
        assert self.distance((0.0, 0.0, 3.1), (0.0, 0.1, -3.1)) == pytest.approx(
            2 * (2 * np.pi - 6.2))
        assert self.distance((0.0, 0.0, 0.0), (9.0, 0.0, 0.0)) == 1.0

    def test_no_true_pose_is_blank_and_a_frame_without_one_is(self):
        truth = truth_of()[:2]
        oracle = Oracle([k * SECOND_NS for k in range(3)], truth)
        first, second, silent = self.described(oracle, 3)
        assert first.any() and second.any()
        assert first[:3].tolist() == [0.0, 0.0, 0.0]
        assert silent.tolist() == [0.0, 0.0, 0.0, 0.0]


def mapped(closures, motions):
    """Return what is left of a flight of 40 codes, an experience each, with these closures."""
    poses = np.array([sample.pose for sample in truth_of()])
    return RunResult(
        np.arange(40, dtype=np.int64) * SECOND_NS, poses, np.ones((40, 2)), poses, poses, poses,
        np.arange(40), np.zeros((0, 2), np.int64), np.array(closures, np.int64).reshape(-1, 2),
        np.array(motions, float).reshape(-1, 3), {}, 0.0)


class TestFalseClosures:
    """A closure is judged by where its two experiences truly were to each other."""

    def count(self, *motion, truth=None):
        """Join two places to what they truly are, twice, by such a motion."""
        return false_closures(mapped([(3, 23), (5, 25)], [motion, motion]),
                              truth_of() if truth is None else truth)

    @pytest.mark.parametrize('motion', [
        (0.0, 0.0, 0.0), (0.9, 0.0, 0.0), (0.0, -0.9, 0.0), (0.0, 0.0, 2 * np.pi - 0.4)])
    def test_leaves_what_is_near_enough(self, motion):
        assert self.count(*motion) == 0

    @pytest.mark.parametrize('motion', [
        (1.1, 0.0, 0.0), (0.0, -3.0, 0.0), (0.8, 0.8, 0.0), (0.0, 0.0, 0.6)])
    def test_counts_what_the_map_may_have_outvoted(self, motion):
        assert self.count(*motion) == 2

    def test_the_motion_is_in_the_frame_of_the_first(self):
        truth = truth_of()
        truth[3:5] = (GroundTruthSample(k * SECOND_NS, Pose2(5.0, 2.0 * k, np.pi / 2))
                      for k in (3, 4))
        assert false_closures(mapped([(3, 4), (4, 3)], [(2.0, 0.0, 0.0), (-2.0, 0.0, 0.0)]),
                              truth) == 0
        assert false_closures(mapped([(3, 4)], [(0.0, 2.0, 0.0)]), truth) == 1

    def test_nothing_can_be_told_without_ground_truth(self):
        assert self.count(truth=[]) is None
        assert self.count(3.0, 0.0, 0.0, truth=truth_of()[:10]) == 0

    def test_a_map_without_a_closure_has_no_false_one(self):
        assert false_closures(mapped([], []), truth_of()) == 0
