"""What closures say of the path: against hand-computed cases and literal least squares."""

from math import pi

import numpy as np
import pytest

from dlsc_qbs_ros.core.consistency import (
    calibration, Chain, contradiction, deviations, surprises)
from dlsc_qbs_ros.core.drift import rectified
from dlsc_qbs_ros.core.geometry import between, between_rows, compose, compose_rows, wrap_angle
from dlsc_qbs_ros.core.types import IDENTITY, Pose2

NO_CALIBRATION = np.zeros(2)
MATCH = np.array([0.04, 0.04, 0.01])


def path(motions, start=IDENTITY):
    """Return the poses that motions lead through."""
    poses = [start]
    for motion in motions:
        poses.append(compose(poses[-1], Pose2(*motion)))
    return np.array(poses)


def line(n, variance=0.01, guess=None):
    """Return a chain of n motions of 1 m straight ahead that turns by nothing."""
    motions = np.tile([1.0, 0.0, 0.0], (n, 1))
    variances = np.tile([variance, variance, 1e-12], (n, 1))
    return Chain(path(motions) if guess is None else guess, motions, np.ones(n), variances)


def laps(n_laps, seed=0, noise=0.02, bias=0.0, scale=0.0):
    """Return a chain over laps of a square of 8 m, and the true poses of its nodes."""
    rng = np.random.default_rng(seed)
    true = np.array(([(1.0, 0.0, 0.0)] * 8 + [(0.0, 0.0, pi / 2)]) * 4 * n_laps)
    n = len(true)
    motions = true + rng.normal(0.0, noise, (n, 3)) + [0.0, 0.0, bias]
    motions[:, :2] *= 1.0 + scale
    return Chain(path(motions), motions, np.ones(n), np.full((n, 3), noise ** 2)), path(true)


def literal_chi_square(chain, ends, variances, calibration_variances, n_steps=30):
    """Return the least sum of squares over all unknowns, with derivatives by differences."""
    n = len(chain.motions)
    sigmas = np.sqrt(np.concatenate([chain.variances.ravel(), calibration_variances]))

    def residuals(x):
        noise, (bias, scale) = (x * sigmas)[:-2].reshape(n, 3), (x * sigmas)[-2:]
        motions = chain.motions + noise
        half = 0.5 * chain.seconds * bias
        motions = motions + np.column_stack([
            half * chain.motions[:, 1] - scale * chain.motions[:, 0],
            -half * chain.motions[:, 0] - scale * chain.motions[:, 1], -chain.seconds * bias])
        poses = path(motions)
        errors = [np.array(between(Pose2(*poses[a]), Pose2(*poses[b]))) for a, b in ends]
        return np.concatenate([x, (np.array(errors) / np.sqrt(variances)).ravel()])

    x = np.zeros(len(sigmas))
    for _ in range(n_steps):
        r = residuals(x)
        jacobian = np.column_stack([
            (residuals(x + step) - residuals(x - step)) / 2e-5 for step in 1e-5 * np.eye(len(x))])
        x = x - np.linalg.lstsq(jacobian, r, rcond=None)[0]
    return float(np.sum(residuals(x) ** 2))


def total(chain, ends, variances, calibration_variances=NO_CALIBRATION):
    """Return the chi-square of all closures: what falls when all of them go."""
    return surprises(chain, ends, variances, calibration_variances, np.zeros(len(ends), int))[0]


# Hand-computed

def test_a_closure_that_agrees_with_odometry_is_no_surprise():
    motions = np.array([(2.0, 0.0, pi / 2)] * 4)
    chain = Chain(path(motions), motions, np.ones(4), np.full((4, 3), 0.01))
    fall, = surprises(chain, np.array([[0, 4]]), MATCH, NO_CALIBRATION, np.array([0]))
    assert fall == pytest.approx(0.0, abs=1e-12)


def test_a_gap_counts_in_deviations_of_the_odometry_and_the_match():
    """Five motions of variance 0.01 and a match of 0.04; 5 m apart: 25 / 0.09."""
    fall, = surprises(line(5), np.array([[0, 5]]), MATCH, NO_CALIBRATION, np.array([0]))
    assert fall == pytest.approx(25.0 / 0.09)


def test_the_error_of_the_scale_is_one_for_all_motions():
    """It adds its variance times the square of the distance: 0.09 + 0.04 * 25."""
    fall, = surprises(line(5), np.array([[0, 5]]), MATCH, np.array([0.0, 0.04]), np.array([0]))
    assert fall == pytest.approx(25.0 / 1.09)


def test_the_error_of_the_yaw_rate_is_one_for_all_motions():
    """A robot that turns on the spot by 0.1 rad in each of 4 s: 0.16 / (0.01 + 16 * 0.02)."""
    motions = np.tile([0.0, 0.0, 0.1], (4, 1))
    chain = Chain(path(motions), motions, np.ones(4), np.full((4, 3), 1e-12))
    fall, = surprises(chain, np.array([[0, 4]]), MATCH, np.array([0.02, 0.0]), np.array([0]))
    assert fall == pytest.approx(0.16 / (0.01 + 0.32))


def test_each_segment_of_odometry_has_a_scale_of_its_own():
    """Two halves of 3 m add their variances: 0.06 + 0.04 + 2 * 0.04 * 3 ** 2."""
    chain = line(6)._replace(segments=np.array([0, 0, 0, 1, 1, 1]))
    fall, = surprises(chain, np.array([[0, 6]]), MATCH, np.array([0.0, 0.04]), np.array([0]))
    assert fall == pytest.approx(36.0 / (0.06 + 0.04 + 2 * 0.04 * 9.0))


def test_what_a_closure_says_of_the_yaw_rate_is_shared_with_the_match_by_their_variances():
    """A robot that turns on the spot by 0.1 rad in each of 4 s, which it does not in truth."""
    motions = np.tile([0.0, 0.0, 0.1], (4, 1))
    chain = Chain(path(motions), motions, np.ones(4), np.full((4, 3), 1e-12))
    (yaw_rate, scale), = calibration(
        chain, np.array([[0, 4]]), MATCH, np.array([0.02, 0.0]), np.ones(1))
    assert yaw_rate == pytest.approx(0.1 * 0.32 / (0.32 + 0.01))
    assert scale == 0.0


def out_and_back(scales):
    """Return a chain 10 m out and back again, each way by an odometry that tells too much."""
    motions = np.repeat([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], 10, axis=0)
    motions[:, 0] *= np.repeat(scales, 10)
    return Chain(path(motions), motions, np.ones(20), np.full((20, 3), 1e-12),
                 np.repeat([0, 1], 10))


@pytest.mark.parametrize('share', [0.0, 0.5, 0.7, 1.0])
def test_scales_are_told_by_how_much_segments_differ(share):
    """
    Out by 11 m and back by 10 m, which leaves a gap of 1 m.

    With the mean of the scales taken out, that goes by their difference alone, of variance
    2 * 0.01, with a lever of 11 m by as much as the one gives in and of 10 m by the other.
    """
    chain, shares = out_and_back([1.1, 1.0]), np.array([share, 1.0 - share])
    errors = calibration(chain, np.array([[0, 20]]), MATCH, np.array([0.0, 0.01]), shares)
    lever_m = 11.0 * (1.0 - share) + 10.0 * share
    apart = 1.0 * lever_m * 0.02 / (lever_m ** 2 * 0.02 + MATCH[0])
    np.testing.assert_allclose(errors[:, 0], 0.0, atol=1e-12)
    assert errors[0, 1] - errors[1, 1] == pytest.approx(apart)
    assert shares @ errors[:, 1] == pytest.approx(0.0, abs=1e-12)


def test_closures_of_separate_stretches_do_not_touch_each_other():
    ends = np.array([[0, 2], [2, 5]])
    falls = surprises(line(5), ends, MATCH, NO_CALIBRATION, np.array([0, 1]))
    assert falls == pytest.approx([4.0 / 0.06, 9.0 / 0.07])


# Laws

@pytest.mark.parametrize('calibration', [(0.0, 0.0), (1e-4, 1e-3), (1e-2, 1e-2)])
def test_chi_square_is_that_of_literal_least_squares(calibration):
    chain, _ = laps(1, seed=1, bias=0.01)
    chain = chain._replace(seconds=np.linspace(0.5, 4.0, len(chain.motions)))
    ends = np.array([[0, 36], [3, 35], [7, 10]])
    ours = total(chain, ends, MATCH, np.array(calibration))
    literal = literal_chi_square(chain, ends, MATCH, np.array(calibration))
    assert ours == pytest.approx(literal, rel=1e-3)


@pytest.mark.parametrize('bias', [-0.01, 0.012])
def test_the_yaw_rate_errs_by_what_it_was_made_to_in_each_segment(bias):
    """As far as noise lets that be seen; of a segment without a closure nothing is known."""
    (first, _), (second, _) = laps(2, seed=3, bias=bias), laps(2, seed=4, bias=-0.5 * bias)
    n = len(first.motions)
    motions = np.vstack([first.motions, second.motions, [[1.0, 0.0, bias]] * 5])
    segments = np.repeat([0, 1, 2], [n, n, 5])
    variances = np.vstack([first.variances, second.variances, [[4e-4] * 3] * 5])
    variances[[n, 2 * n]] = 1e4
    chain = Chain(path(motions), motions, np.ones(2 * n + 5), variances, segments)
    lap = n // 2
    ends = np.array([[k, k + lap] for k in (*range(1, lap, 4), *range(n + 1, n + lap, 4))])
    errors = calibration(chain, ends, MATCH, np.array([1e-4, 1e-4]), np.full(3, 1 / 3))
    assert errors[:, 0] == pytest.approx([bias, -0.5 * bias, 0.0], abs=2e-3)


def test_without_that_error_the_path_is_what_was_flown():
    chain, truth = laps(1, noise=1e-9, bias=0.01)
    n = len(chain.motions)
    straight = rectified(chain.motions, np.full(n, 0.01), np.zeros(n))
    np.testing.assert_allclose(path(straight)[:, :2], truth[:, :2], atol=0.3)
    assert np.abs(chain.poses[:, :2] - truth[:, :2]).max() > 1.5


def test_a_surprise_is_what_chi_square_falls_by_without_the_run():
    ends, runs = np.array([[0, 9], [1, 6], [2, 9], [4, 8]]), np.array([0, 0, 1, 2])
    chain = line(10)
    falls = surprises(chain, ends, MATCH, np.array([0.0, 1e-3]), runs)
    everything = total(chain, ends, MATCH, np.array([0.0, 1e-3]))
    without = [total(chain, ends[runs != run], MATCH, np.array([0.0, 1e-3])) for run in range(3)]
    assert falls == pytest.approx(everything - np.array(without))


def test_where_the_map_lies_and_how_the_closures_are_sorted_says_nothing():
    chain, _ = laps(2, seed=2)
    ends, runs = np.array([[0, 36], [2, 38], [9, 45]]), np.array([0, 0, 1])
    falls = surprises(chain, ends, MATCH, NO_CALIBRATION, runs)
    moved = chain._replace(poses=compose_rows(np.array([(3.0, -2.0, 2.5)]), chain.poses))
    assert surprises(moved, ends, MATCH, NO_CALIBRATION, runs) == pytest.approx(falls, rel=1e-6)
    swapped = surprises(chain, ends[::-1], MATCH, NO_CALIBRATION, 1 - runs[::-1])
    assert swapped[::-1] == pytest.approx(falls, rel=1e-6)


def test_the_first_guess_tells_how_often_the_robot_has_turned():
    """A yaw error of 0.1 rad/s over 72 s is more than a turn; the guess knows better."""
    chain, true = laps(2, bias=0.1)
    chain = chain._replace(poses=true)
    calibration = np.array([0.01, 1e-6])
    assert total(chain, np.array([[0, 36], [0, 72]]), MATCH, calibration) < 12.0


def test_rows_compose_and_part_as_single_poses_do():
    a, b = np.random.default_rng(0).uniform(-3.0, 3.0, (2, 5, 3))
    composed, parted = compose_rows(a, b), between_rows(a, b)
    for k in range(5):
        assert composed[k] == pytest.approx(compose(Pose2(*a[k]), Pose2(*b[k])))
        assert parted[k] == pytest.approx(between(Pose2(*a[k]), Pose2(*b[k])))
    difference = between_rows(a, composed) - b
    difference[:, 2] = wrap_angle(difference[:, 2])
    np.testing.assert_allclose(difference, 0.0, atol=1e-12)


# Who is wrong

@pytest.mark.parametrize('gap_m, ends, named', [
    (1.00, [[0, 1]], None), (1.02, [[0, 1]], 0),
    (0.72, [[0, 1], [1, 2]], None), (0.73, [[0, 1], [1, 2]], None),
    (0.75, [[0, 1], [1, 2]], 0)])
def test_a_run_may_be_a_surprise_of_11_and_1_for_each_more_closure(gap_m, ends, named):
    """Each gap counts gap^2 / (0.05 + 0.04): 11.1 and 11.6; 11.5, 11.8 and 12.5 for two."""
    motions = np.tile([gap_m, 0.0, 0.0], (2, 1))
    chain = Chain(path(motions), motions, np.ones(2), np.tile([0.05, 0.05, 1e-12], (2, 1)))
    runs = np.zeros(len(ends), int)
    assert contradiction(chain, np.array(ends), MATCH, NO_CALIBRATION, runs) == named


TRUE = [[0, 36], [2, 38], [20, 56], [22, 58], [30, 66]]


def verdict(ends, runs, **lap):
    chain, true = laps(2, **lap)
    return contradiction(
        chain._replace(poses=true), np.array(ends), MATCH, np.array([1e-3, 1e-3]),
        np.array(runs))


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('errors', [{}, {'bias': 0.02}, {'scale': 0.03}])
def test_true_closures_stay(seed, errors):
    assert verdict(TRUE, [0, 0, 1, 1, 2], seed=seed, **errors) is None


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('wrong', [[7, 63], [20, 62], [12, 46]])
def test_the_wrong_run_is_named_and_not_those_it_bends(seed, wrong):
    assert verdict([*TRUE, wrong], [0, 0, 1, 1, 2, 3], seed=seed, bias=0.02) == 3


@pytest.mark.parametrize('seed', range(4))
def test_a_wrong_run_of_many_closures_is_named_by_two_true_runs(seed):
    wrong = [[3, 43], [4, 44], [5, 45]]
    assert verdict([*TRUE, *wrong], [0, 0, 1, 1, 2, 3, 3, 3], seed=seed) == 3


# How well places are known

NO_CLOSURES = np.zeros((0, 2), int)
EXACT = np.full(3, 1e-12)


def test_without_closures_a_line_is_a_random_walk_less_the_best_rigid_motion():
    """Along the line that is its mean; across, a slope too, as the heading errs by nothing."""
    nodes = np.arange(6)
    walk = 0.01 * np.minimum.outer(nodes, nodes)
    mean, slope = np.ones((6, 1)), np.column_stack([np.ones(6), nodes])
    left = [np.eye(6) - fit @ np.linalg.pinv(fit) for fit in (mean, slope)]
    along, across = (np.diag(rest @ walk @ rest) for rest in left)
    turn = np.linalg.pinv(slope)[1]
    known = deviations(line(5), NO_CLOSURES, MATCH, NO_CALIBRATION, nodes)
    assert known[:, 0] == pytest.approx(np.sqrt(0.5 * (along + across)))
    assert known[:, 1] == pytest.approx(np.sqrt(turn @ walk @ turn))


def test_a_closed_ring_is_known_equally_well_everywhere():
    """Four steps of variance v, out and back: (4^2 - 1) / (12 * 4) v along the line, each."""
    motions = np.array([(1.0, 0.0, 0.0)] * 2 + [(-1.0, 0.0, 0.0)] * 2)
    chain = Chain(path(motions), motions, np.ones(4), np.tile([0.01, 1e-12, 1e-12], (4, 1)))
    known = deviations(chain, np.array([[0, 4]]), EXACT, NO_CALIBRATION, np.arange(4))
    assert known[:, 0] == pytest.approx(np.sqrt(0.5 * 15.0 / 48.0 * 0.01), rel=1e-4)


def test_no_closure_tells_of_the_scale():
    """A corner 1 m out to both sides errs by a share of that; the middle of a side by half."""
    motions = np.array([(1.0, 0.0, 0.0), (1.0, 0.0, pi / 2)] * 4)
    chain = Chain(path(motions), motions, np.ones(8), np.full((8, 3), 1e-12))
    known = deviations(
        chain, np.array([[0, 8]]), MATCH, np.array([0.0, 0.03 ** 2]), np.arange(8))
    assert known[:, 0] == pytest.approx([0.03, 0.03 * 0.5 ** 0.5] * 4, rel=1e-4)
    assert known[:, 1] == pytest.approx(0.0, abs=1e-5)


def test_each_more_closure_makes_places_better_known_wherever_the_map_lies():
    chain, true = laps(2, seed=3)
    chain = chain._replace(poses=true)
    nodes, calibration = np.arange(0, 73, 6), np.array([1e-4, 1e-3])
    n_closures = (0, 1, 3, 5)
    known = [deviations(chain, np.array(TRUE[:n] or NO_CLOSURES), MATCH, calibration, nodes)
             for n in n_closures]
    assert (np.diff([np.square(each).sum(axis=0) for each in known], axis=0) < 0.0).all()
    moved = chain._replace(poses=compose_rows(np.array([(3.0, -2.0, 2.5)]), true))
    again = deviations(moved, np.array(TRUE), MATCH, calibration, nodes)
    np.testing.assert_allclose(again, known[-1], rtol=1e-6)


def test_however_long_there_was_no_closure_something_finite_is_said():
    motions = np.tile([1.0, 0.0, 0.0], (4, 1))
    chain = Chain(path(motions), motions, np.full(4, 1e12), np.full((4, 3), 1e9))
    ends = np.array([[0, 3], [0, 4], [1, 4]])
    assert np.isfinite(deviations(chain, ends, MATCH, np.array([1.0, 1.0]), np.arange(5))).all()
