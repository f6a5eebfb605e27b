"""The journey: what visits make of the map, and what remains of those that are taken back."""

from math import inf, pi

import numpy as np
import pytest

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.geometry import between, compose
from dlsc_qbs_ros.core.types import IDENTITY, Pose2
from dlsc_qbs_ros.pipeline.journey import Journey

STEP = Pose2(1.0, 0.0, 0.0)
CORNER = Pose2(1.0, 0.0, pi / 2)
SQUARE = ([STEP] * 9 + [CORNER]) * 4


def journey(motions=(), **changes):
    """Return a journey that created an experience at the start and after each motion."""
    made = Journey(Config().override(changes))
    made.visits.create(IDENTITY)
    create(made, motions)
    return made


def create(made, motions):
    for motion in motions:
        made.move(motion, 1.0)
        made.visits.create(made.visits.pose())


def meet(made, motions, experiences, offset=IDENTITY):
    """Meet experiences, one after each motion."""
    for motion, experience in zip(motions, experiences):
        made.move(motion, 1.0)
        made.meet(experience, offset)


def links(made):
    return {(a, b): motion for (a, b), motion in zip(
        made.visits.map.links.tolist(), made.visits.map.motions.tolist())}


# Visits

def test_each_visit_is_linked_to_the_one_before_by_what_was_flown():
    made = journey([STEP, CORNER])
    meet(made, [STEP], [0], offset=Pose2(0.5, 0.0, 0.0))
    assert made.visits.map.links.tolist() == [[0, 1], [1, 2], [2, 0]]
    assert made.visits.map.motions.tolist() == [
        pytest.approx(STEP), pytest.approx(CORNER), pytest.approx([0.5, 0.0, 0.0])]
    assert made.visits.map.is_closure.tolist() == [False, False, True]


def test_a_place_is_an_experience_and_what_was_flown_since():
    made = journey([STEP])
    made.move(Pose2(0.3, 0.0, 0.1), 1.0)
    place = made.visits.place()
    assert place.experience == 1
    assert place.offset == pytest.approx(Pose2(0.3, 0.0, 0.1))
    assert made.visits.pose() == pytest.approx(Pose2(1.3, 0.0, 0.1))


def test_before_the_first_visit_there_is_no_place():
    assert Journey(Config()).visits.place() is None


def test_no_link_spans_a_break_of_the_odometry():
    made = journey([STEP])
    made.break_off()
    create(made, [STEP])
    assert made.visits.map.links.tolist() == [[0, 1]]
    assert not made.pieces.is_localised


def test_the_age_of_an_experience_is_in_seconds_of_motion_and_in_metres():
    made = journey([STEP, Pose2(2.0, 0.0, 0.0)])
    made.move(Pose2(0.0, 0.0, 0.1), 5.0)
    made.move(IDENTITY, 60.0)
    assert made.visits.ages().tolist() == [[7.0, 3.0], [6.0, 2.0], [5.0, 0.0]]


# What is tested

def test_a_long_run_is_tested_ever_more_rarely():
    made = journey(SQUARE)
    news = []
    for experience in range(30):
        made.move(SQUARE[experience], 1.0)
        news.append(made.meet(experience + 1, IDENTITY))
    assert np.flatnonzero(news).tolist() == [0, 3, 6, 12, 24]


def test_a_gap_or_a_jump_starts_another_run():
    made = journey(SQUARE)
    assert [made.meet(k, IDENTITY) for k in (0, 0, 4)] == [True, False, True]
    create(made, [STEP] * 4)
    made.move(STEP, 1.0)
    assert made.meet(9, IDENTITY)


def test_true_closures_contradict_nothing():
    made = journey(SQUARE)
    for experience, motion in enumerate(SQUARE):
        assert made.contradiction(experience) is None
        if made.meet(experience, IDENTITY):
            assert made.contradiction() is None
        made.move(motion, 1.0)


def test_a_claim_to_be_elsewhere_is_a_contradiction_by_itself():
    made = journey([STEP] * 20)
    assert made.contradiction(0) == 0


def test_a_long_way_without_a_visit_may_lead_anywhere_sideways():
    """Of 20 m in 100 s, half-way a turn of 0.3 rad: 3 m; along the way they would be too much."""
    def claim(gap):
        made = journey()
        made.move(STEP._replace(x_m=10.0), 50.0)
        made.move(compose(Pose2(-10.0, 0.0, 0.0), gap), 50.0)
        return made.contradiction(0)

    changes = Pose2(0.0, 3.0, 0.0), Pose2(3.0, 0.0, 0.0)
    assert [claim(gap) for gap in changes] == [None, 0]


def test_after_a_break_any_claim_may_be_true_until_one_is_believed():
    made = journey(SQUARE)
    made.break_off()
    made.move(Pose2(0.5, 0.0, 0.0), 1.0)
    assert all(made.contradiction(k) is None for k in (5, 25))
    made.meet(5, IDENTITY)
    create(made, [STEP] * 4)
    assert made.contradiction(9) is None
    assert made.contradiction(25) is not None


# How well places are known

LONG = [compose(motion, IDENTITY)._replace(x_m=3.0) for motion in SQUARE]


def test_the_longer_the_way_round_the_less_well_its_places_are_known():
    def place_sigma_m(way):
        made = journey(way)
        meet(made, way[:2], [1, 2])
        made.survey()
        return made.place_sigmas()[0]

    assert 0.0 < place_sigma_m(SQUARE) < 0.3 < place_sigma_m(LONG)


def test_a_run_taken_back_says_nothing_of_where_places_are():
    made = journey(LONG)
    meet(made, LONG[:2], [1, 2])
    made.survey()
    assert made.place_sigmas()[0] > 0.0
    made.undo(1)
    assert made.place_sigmas() == (0.0, 0.0)


def test_a_journey_that_goes_on_knows_places_as_well_as_before():
    made, other = journey(LONG), Journey(Config())
    meet(made, LONG[:2], [1, 2])
    made.survey()
    other.restore(made.state())
    assert other.place_sigmas() == made.place_sigmas()


def test_a_break_that_the_robot_was_put_over_is_as_a_match():
    made = journey(LONG)
    meet(made, LONG[:2], [1, 2])
    made.break_off()
    made.put(0, IDENTITY)
    made.settle()
    create(made, LONG)
    meet(made, LONG[:2], [len(LONG) + 2, len(LONG) + 3])
    made.survey()
    assert 0.4 < made.place_sigmas()[0] < 3.0


# What is taken back

def strayed():
    """Return a journey round a square that then took the second side for the first."""
    made = journey(SQUARE)
    create(made, [STEP] * 4)
    meet(made, [STEP] * 3, [15, 16, 17])
    create(made, [STEP] * 3)
    return made


def test_a_run_taken_back_leaves_the_map_that_odometry_alone_makes():
    made = strayed()
    plain = journey(SQUARE)
    create(plain, [STEP] * 4)
    plain.move(compose(compose(STEP, STEP), STEP), 3.0)
    create(plain, [STEP] * 3)
    made.undo(1)
    np.testing.assert_allclose(
        made.visits.map.poses[:, :2], plain.visits.map.poses[:, :2], atol=1e-9)
    assert links(made).keys() == links(plain).keys()
    for pair, motion in links(plain).items():
        assert links(made)[pair] == pytest.approx(motion)
    assert made.visits.pose() == pytest.approx(plain.visits.pose())
    assert made.undone == 1


def test_a_run_taken_back_while_it_lasts_puts_the_robot_back():
    made = journey(SQUARE)
    create(made, [STEP] * 4)
    before, drift = made.visits.pose(), made.drift.position_sigma_m(inf)
    meet(made, [STEP] * 3, [15, 16, 17])
    made.undo(1)
    assert between(before, made.visits.pose()) == pytest.approx(Pose2(3.0, 0.0, 0.0))
    assert made.drift.position_sigma_m(inf) > drift
    assert not made.visits.map.is_closure.any()


def test_a_place_of_the_past_goes_where_the_robot_truly_was():
    made = journey(SQUARE)
    meet(made, [STEP], [15])
    made.move(STEP, 1.0)
    place = made.visits.place()
    assert place.experience == 15
    made.undo(1)
    assert place.experience == 40
    assert place.offset == pytest.approx(Pose2(2.0, 0.0, 0.0))


def test_what_comes_after_a_run_taken_back_is_another_run():
    made = journey(SQUARE)
    meet(made, [STEP] * 2, [15, 16])
    made.undo(1)
    made.move(STEP, 1.0)
    assert made.meet(3, IDENTITY)


def test_what_was_created_during_and_after_a_wrong_run_moves_along():
    made = journey(SQUARE)
    create(made, [STEP])
    meet(made, [STEP], [15])
    create(made, [STEP])
    meet(made, [STEP], [17])
    create(made, [STEP, CORNER, STEP])
    made.undo(1)
    np.testing.assert_allclose(
        made.visits.map.poses[-5:, :2], [(1, 0), (3, 0), (5, 0), (6, 0), (6, 1)], atol=1e-9)
    assert {(40, 41), (41, 42), (42, 43), (43, 44), (44, 45)} <= links(made).keys()
    assert not made.visits.map.is_closure.any()


def test_other_runs_stay_as_they_are():
    made = strayed()
    meet(made, [STEP], [12])
    create(made, [STEP] * 4)
    made.visits.calibrate(np.zeros((1, 2)))
    after = links(made)
    made.undo(1)
    made.visits.calibrate(np.zeros((1, 2)))  # to see the motions as odometry told them
    kept = {pair: motion for pair, motion in links(made).items() if pair in after}
    assert (47, 12) in kept and (12, 48) in kept
    assert all(after[pair] == pytest.approx(motion) for pair, motion in kept.items())


def entering(askew_m):
    """Return a journey that comes back to the start, at first as if it were farther on."""
    made = journey(SQUARE)
    create(made, [Pose2(0.5, 0.0, 0.0)])
    meet(made, [Pose2(0.5, 0.0, 0.0)], [1], offset=Pose2(askew_m, 0.0, 0.0))
    meet(made, [STEP] * 3, [2, 3, 4])
    return made


def test_the_start_of_a_run_goes_when_the_run_itself_says_it_was_elsewhere():
    made = entering(0.7)
    assert made.undone == 0
    assert (41, 1) not in links(made)
    assert links(made)[41, 4] == pytest.approx(Pose2(3.5, 0.0, 0.0))
    assert made.visits.pose() == pytest.approx(Pose2(4.0, 0.0, 0.0), abs=1e-9)


def test_the_start_of_a_run_stays_when_it_is_off_by_as_much_as_a_match_is():
    made = entering(0.5)
    assert links(made)[41, 1] == pytest.approx(Pose2(0.0, 0.0, 0.0))
    assert (41, 4) not in links(made)


def test_links_that_a_wrong_run_repeats_are_not_lost():
    """The run goes from 15 to 16, which were joined when they were created."""
    made = strayed()
    made.undo(1)
    assert {(15, 16), (16, 17)} <= links(made).keys()


def test_the_wrong_run_is_found_when_the_right_place_is_met():
    """A side taken for another, 3 m off and 30 s old, is no contradiction until a corner comes."""
    made = journey(SQUARE, **{
        'odometry.yaw_bias_rad_s': 0.02, 'ratslam.match_position_sigma_m': 0.1})
    meet(made, [STEP], [3])
    assert made.contradiction() is None
    create(made, [STEP] * 3)
    run = made.contradiction(4)
    assert run == 1
    made.undo(run)
    assert made.contradiction(4) is None
    assert made.visits.pose() == pytest.approx(Pose2(4.0, 0.0, 0.0), abs=1e-9)


def test_where_a_piece_is_is_not_known_once_the_run_that_joined_it_is_taken_back():
    made = journey(SQUARE)
    made.break_off()
    meet(made, [STEP], [15])
    assert made.pieces.is_localised
    made.undo(1)
    assert not made.pieces.is_localised


def test_taking_back_a_run_moves_nothing_from_after_a_break_of_the_odometry():
    made = journey([STEP] * 9)
    meet(made, [STEP], [2])
    made.break_off()
    made.visits.create(made.visits.pose())
    create(made, [STEP] * 3)
    meet(made, [STEP], [5])
    before = made.visits.map.poses.copy()
    made.undo(1)
    assert made.visits.map.poses == pytest.approx(before)


# What closures tell of the odometry

BIAS = 0.01
TURNED = [Pose2(x, y, yaw + BIAS) for x, y, yaw in SQUARE]


def lap_and_a_half(**changes):
    """Return a journey round a square by odometry that turns too far, and over its first half."""
    made = journey(TURNED, **changes)
    meet(made, TURNED[:20], range(1, 21))
    made.take_stock()
    return made


def test_the_yaw_rate_is_corrected_in_every_motion_before_and_after():
    made = lap_and_a_half()
    (error, _), = made.visits.odometry.errors
    assert error == pytest.approx(BIAS, rel=0.15)
    motions = links(made)
    create(made, TURNED[20:22])
    for motion in (*(motions[k, k + 1] for k in (3, 25, 38)), *(
            links(made)[pair] for pair in ((20, 41), (41, 42)))):
        assert motion == pytest.approx((1.0, -0.5 * error, BIAS - error), abs=1e-4)


def test_so_is_the_way_from_the_last_visit_to_here():
    made = lap_and_a_half()
    (error, _), = made.visits.odometry.errors
    made.move(STEP, 1.0)
    assert made.visits.place().offset == pytest.approx((1.0, -0.5 * error, -error), abs=1e-4)


def test_what_is_made_there_agrees_with_its_link():
    made = lap_and_a_half()
    for _ in range(300):
        made.visits.map.relax(100)
    before = made.visits.map.poses.copy()
    for k in range(20, 40):
        for _ in range(3):
            made.move(Pose2(*(np.array(TURNED[k]) / 3)), 1 / 3)
        made.visits.create(made.visits.pose())
        made.visits.map.relax(100)
    np.testing.assert_array_equal(made.visits.map.poses[:len(before)], before)


def test_an_error_that_barely_changes_leaves_the_map_alone():
    made = lap_and_a_half()
    before = made.visits.map.motions.copy()
    made.visits.calibrate(made.visits.odometry.errors + 0.9 * np.array(made.visits.BARELY))
    np.testing.assert_array_equal(made.visits.map.motions, before)
    made.visits.calibrate(made.visits.odometry.errors + 1.1 * np.array(made.visits.BARELY))
    assert (made.visits.map.motions != before).any()


def test_without_an_error_motions_are_those_of_the_odometry():
    made, straight = lap_and_a_half(), journey(TURNED)
    made.visits.calibrate(np.zeros((1, 2)))
    assert all(links(made)[pair] == pytest.approx(motion)
               for pair, motion in links(straight).items())


def test_after_a_break_nothing_is_known_of_the_odometry():
    made = lap_and_a_half()
    made.break_off()
    made.visits.create(made.visits.pose())
    create(made, TURNED[:1])
    assert links(made)[41, 42] == pytest.approx(TURNED[0])
    made.take_stock()
    assert made.visits.odometry.errors[0, 0] == pytest.approx(BIAS, rel=0.15)
    assert not made.visits.odometry.errors[1:, 0].any()


def test_what_is_known_of_the_odometry_moves_the_map_at_once_and_the_robot_in_it():
    made = journey(TURNED)
    meet(made, TURNED[:20], range(1, 21))
    made.move(STEP, 1.0)
    made.visits.map.relax(1000)
    before = made.visits.map.poses.copy()
    made.take_stock()
    (error, _), = made.visits.odometry.errors
    assert made.visits.place().offset == pytest.approx((1.0, -0.5 * error, -error), abs=1e-4)
    made.visits.map.relax(1000)
    assert np.abs(made.visits.map.poses - before).max() > 0.01


def test_a_relaxation_under_way_ends_though_what_is_known_changes_again_and_again():
    made = lap_and_a_half()
    made.visits.map.relax(1)
    before, error = made.visits.map.poses.copy(), made.visits.odometry.errors
    for k in range(40):
        made.visits.calibrate(error * (0.5 + k % 2))
        made.visits.map.relax(1)
    assert np.abs(made.visits.map.poses - before).max() > 0.01


def test_a_gap_that_a_run_left_is_bridged_by_what_is_known_in_the_end():
    made = journey(TURNED)
    meet(made, TURNED[:4], (11, 12, 13, 14))
    create(made, TURNED[4:6])
    made.visits.calibrate(np.array([[0.3, 0.0]]))
    made.undo(1)
    made.visits.calibrate(np.zeros((1, 2)))
    flown = journey(TURNED + TURNED[:5])
    assert links(made)[40, 41] == pytest.approx(
        between(*(flown.visits.map.pose(k) for k in (40, 45))))


def test_where_the_odometry_breaks_the_pose_is_what_it_was():
    made = lap_and_a_half()
    made.move(STEP, 1.0)
    before = made.visits.pose()
    made.break_off()
    made.move(IDENTITY, 1.0)
    assert made.visits.pose() == pytest.approx(before)


@pytest.mark.parametrize('seconds', [600.0, 1.7e9], ids=['on_the_ground', 'clock_set'])
def test_odometry_that_holds_still_errs_by_nothing_meanwhile(seconds):
    still, flown = lap_and_a_half(), lap_and_a_half()
    for made in (still, flown):
        made.move(STEP, 1.0)
        made.move(IDENTITY, seconds if made is still else 0.0)
        create(made, TURNED[21:24])
        made.take_stock()
    assert still.visits.pose() == flown.visits.pose()
    np.testing.assert_array_equal(still.visits.odometry.errors, flown.visits.odometry.errors)


def test_the_error_is_known_after_hours_too():
    """Round and round, until a hundredth of the flight is more than half a turn too far."""
    turned = [Pose2(x, y, yaw + 0.03) for x, y, yaw in SQUARE]
    made = journey(turned)
    for k in range(40 * 300):
        made.move(turned[k % 40], 1.0)
        made.visits.add(k % 40 + 1, IDENTITY, 1)
    made.take_stock()
    assert made.visits.odometry.errors[0, 0] == pytest.approx(0.03, rel=0.02)


def test_a_run_taken_back_tells_nothing_of_the_odometry():
    made = lap_and_a_half()
    made.undo(1)
    assert made.visits.odometry.errors.tolist() == [[0.0, 0.0]]


LONGER = [Pose2(1.1 * x, y, yaw) for x, y, yaw in SQUARE]


def carried_off(n_laps, n_created=0):
    """Return a journey round a square twice and then, by odometry that tells more, again."""
    made = journey(SQUARE)
    meet(made, SQUARE, range(1, 41))
    made.break_off()
    made.move(IDENTITY, 0.0)
    made.meet(0, IDENTITY)
    for _ in range(n_laps):
        meet(made, LONGER, [*range(1, 40), 0])
    create(made, [Pose2(1.1, 0.0, 0.0)] * n_created)
    meet(made, [Pose2(-1.1 * n_created, 0.0, 0.0)], [0])
    made.take_stock()
    return made


@pytest.mark.parametrize('n_laps', [1, 2, 100])
def test_odometry_that_meets_but_what_is_there_takes_over_its_scale(n_laps):
    made = carried_off(n_laps)
    (_, before), (_, after) = made.visits.odometry.errors
    assert 1.1 * (1.0 - after) == pytest.approx(1.0, abs=0.02)
    assert before == 0.0
    made.move(Pose2(1.1, 0.0, 0.0), 1.0)
    assert made.visits.place().offset.x_m == pytest.approx(1.1 * (1.0 - after))


def test_where_both_make_the_map_neither_is_right_but_their_mean():
    made = carried_off(2, n_created=41)
    (_, before), (_, after) = made.visits.odometry.errors
    assert (1.1 * (1.0 - after)) / (1.0 - before) == pytest.approx(1.0, abs=0.02)
    assert before == pytest.approx(-after)
    other = Journey(Config())
    other.restore(made.state())
    np.testing.assert_array_equal(other.visits.odometry.errors, made.visits.odometry.errors)


def test_of_one_odometry_no_scale_is_known_though_a_smaller_map_were_more_alike():
    """It drifts aside, and so the loop closes by half a metre less than it should."""
    drifting = [Pose2(x, 0.02, yaw) for x, _, yaw in SQUARE]
    made = journey(drifting)
    meet(made, drifting, [(k + 2) % 40 + 1 for k in range(40)])
    made.take_stock()
    errors = made.visits.odometry.errors
    assert errors[0, 0] != 0.0
    assert errors[:, 1].tolist() == [0.0]


def test_what_is_known_is_no_more_than_can_be():
    made = journey([STEP])
    made.visits.calibrate(np.array([[200.0, -1.5]]))
    assert made.visits.odometry.errors.tolist() == [[100.0, -0.9]]


# What was flown while lost

def lost_and_found():
    """Return a journey that flew 0 to 3, was carried away, flew 4 to 8 and met 1 as it flew on."""
    made = journey([STEP] * 3)
    made.break_off()
    made.visits.create(made.visits.pose())
    create(made, [STEP] * 4)
    meet(made, [STEP], [1])
    return made


def test_what_was_flown_while_lost_hangs_on_to_the_map_by_the_odometry_from_there():
    made = lost_and_found()
    assert made.pieces.detour(np.arange(9)).tolist() == 2 * [
        [0.0, 0.0, 0.0, 0.0, 5.0, 4.0, 3.0, 2.0, 1.0]]


def test_what_is_flown_afterwards_sets_out_from_the_place_that_was_met():
    made = lost_and_found()
    assert made.pieces.detour(8).tolist() == [1.0, 1.0]
    create(made, [STEP, STEP])
    assert made.pieces.detour(10).tolist() == [2.0, 2.0]


def test_once_met_again_it_is_tied_there_too():
    made = lost_and_found()
    meet(made, [STEP, STEP], [2, 4])
    made.pieces.tie()
    meet(made, [STEP], [2])
    assert made.pieces.detour(np.arange(4, 9)).tolist() == 2 * [[1.0, 2.0, 3.0, 2.0, 1.0]]


def test_from_where_it_was_met_again_its_own_places_are_as_far_as_they_were_flown():
    made = lost_and_found()
    meet(made, [STEP], [5])
    assert made.pieces.detour(np.arange(4, 9)).tolist() == 2 * [[1.0, 0.0, 1.0, 2.0, 2.0]]


def test_a_journey_without_a_break_has_nothing_loose():
    made = journey(SQUARE)
    meet(made, [STEP], [0])
    assert not made.pieces.detour(np.arange(len(SQUARE))).any()


def test_a_piece_apart_is_not_loose_in_itself():
    made = journey([STEP] * 3)
    made.break_off()
    made.visits.create(made.visits.pose())
    create(made, [STEP] * 4)
    assert not made.pieces.detour(np.arange(4, 9)).any()


def test_nor_when_it_was_lost_where_the_map_was_loose():
    made = lost_and_found()
    meet(made, [STEP], [5])
    made.break_off()
    made.visits.create(made.visits.pose())
    assert made.pieces.detour(9).tolist() == [0.0, 0.0]


def test_a_robot_that_was_put_somewhere_and_then_lost_is_not_there_when_the_map_grows_again():
    made = journey([STEP] * 3)
    made.put(1, IDENTITY)
    made.break_off()
    made.settle()
    made.visits.create(made.visits.pose())
    assert not made.pieces.is_localised
    assert links(made).keys() == {(0, 1), (1, 2), (2, 3)}


def test_what_no_match_led_to_is_where_it_was_put_by_hand():
    made = journey([STEP] * 3)
    for _ in range(2):
        made.break_off()
        made.put(1, IDENTITY)
        made.visits.create(made.visits.pose())
    meet(made, [STEP], [3])
    assert made.pieces.detour(np.arange(6)).tolist() == 2 * [[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]


def test_where_a_lost_robot_was_put_by_hand_is_not_loose():
    made = journey([STEP] * 3)
    made.break_off()
    made.put(1, IDENTITY)
    made.settle()
    create(made, [STEP])
    assert made.pieces.detour(np.arange(5)).tolist() == 2 * [[0.0, 0.0, 0.0, 0.0, 1.0]]
