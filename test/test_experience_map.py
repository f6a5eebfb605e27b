"""The experience map: what it keeps, and where its relaxation takes it."""

from math import pi

import numpy as np
import pytest

from dlsc_qbs_ros.core.experience_map import ExperienceMap
from dlsc_qbs_ros.core.geometry import between, between_rows, compose, wrap_angle
from dlsc_qbs_ros.core.rows import Rows
from dlsc_qbs_ros.core.types import IDENTITY, Pose2

ENOUGH = 1000


def graph(poses, links):
    """Return a map with experiences at poses and links (origin, target, motion)."""
    experience_map = ExperienceMap()
    for pose in poses:
        experience_map.add_experience(Pose2(*pose))
    for origin, target, motion in links:
        experience_map.add_link(origin, target, Pose2(*motion), False)
    return experience_map


def random_graph(seed, n=12, n_extra=8, noise=0.2):
    """Return a connected map whose links contradict one another."""
    rng = np.random.default_rng(seed)
    poses = [Pose2(*row) for row in rng.uniform([-5, -5, -3], [5, 5, 3], (n, 3)).tolist()]
    pairs = [(k, k + 1) for k in range(n - 1)]
    pairs += [tuple(rng.choice(n, 2, replace=False).tolist()) for _ in range(n_extra)]
    return graph(poses, [
        (a, b, compose(between(poses[a], poses[b]), Pose2(*rng.normal(0.0, noise, 3))))
        for a, b in pairs])


def degrees(experience_map):
    return np.bincount(experience_map.links.ravel(), minlength=len(experience_map))


def literal_relaxation(experience_map, alpha=0.5, sweeps=4000):
    """Return the poses after RatSLAM's relaxation, all links at once, shared by degree."""
    poses = experience_map.poses.copy()
    share = alpha / degrees(experience_map)
    for _ in range(sweeps):
        change = np.zeros_like(poses)
        for (a, b), (x, y, yaw) in zip(experience_map.links, experience_map.motions):
            c, s = np.cos(poses[a, 2]), np.sin(poses[a, 2])
            error = poses[b] - poses[a] - (c * x - s * y, s * x + c * y, yaw)
            error[2] = wrap_angle(error[2])
            change[a] += error
            change[b] -= error
        poses += share[:, None] * change
    return poses


def from_first(poses):
    """Return poses in the frame of the first: a map as a whole may lie anywhere."""
    return between_rows(np.repeat(poses[:1], len(poses), axis=0), poses)


# The graph

def test_a_link_keeps_its_ends_its_motion_and_whether_it_closed_a_loop():
    experience_map = graph([(0, 0, 0), (1, 0, 0), (1, 1, 0)], [(0, 1, (1, 0, 0.1))])
    experience_map.add_link(2, 0, Pose2(-1, -1, 0.5), True)
    assert experience_map.links.tolist() == [[0, 1], [2, 0]]
    assert experience_map.motions.tolist() == [[1, 0, 0.1], [-1, -1, 0.5]]
    assert experience_map.is_closure.tolist() == [False, True]


@pytest.mark.parametrize('origin, target', [(0, 1), (1, 0), (1, 1)])
def test_experiences_that_are_joined_already_are_not_joined_again(origin, target):
    experience_map = graph([(0, 0, 0), (1, 0, 0)], [(0, 1, (1, 0, 0))])
    assert not experience_map.add_link(origin, target, Pose2(5, 5, 1), True)
    assert experience_map.links.tolist() == [[0, 1]]
    assert experience_map.motions.tolist() == [[1, 0, 0]]


def test_links_that_are_taken_out_leave_the_others_and_may_come_back():
    experience_map = graph([(k, 0, 0) for k in range(4)], [
        (k, k + 1, (1 + k, 0, 0)) for k in range(3)])
    experience_map.remove_links(np.array([False, True, False]))
    assert experience_map.links.tolist() == [[0, 1], [2, 3]]
    assert experience_map.motions[:, 0].tolist() == [1, 3]
    assert experience_map.is_closure.tolist() == [False, False]
    assert not experience_map.add_link(1, 0, IDENTITY, True)
    assert experience_map.add_link(2, 1, IDENTITY, True)
    assert experience_map.is_closure.tolist() == [False, False, True]


def test_experiences_are_numbered_as_they_come_and_keep_their_poses():
    experience_map = ExperienceMap()
    made = [experience_map.add_experience(Pose2(k, -k, 0.0)) for k in range(300)]
    assert made == list(range(300))
    assert len(experience_map) == 300
    assert experience_map.pose(211) == Pose2(211, -211, 0.0)


def test_rows_grow_by_rows_and_can_be_written_to():
    rows = Rows(np.zeros((0, 2)))
    for k in range(200):
        rows.append((k, -k))
        rows.values[k // 2] += 1
    assert rows.values.shape == (200, 2)
    assert rows.values[199].tolist() == [199, -199]
    assert rows.values[10].tolist() == [12, -8]


def test_rows_grow_by_many_at_a_time_too():
    rows = Rows(np.zeros((0, 2), int))
    rows.extend(np.arange(200).reshape(100, 2))
    rows.append((7, 8))
    rows.extend(np.zeros((0, 2), int))
    assert rows.values.shape == (101, 2)
    assert rows.values[[0, 99, 100]].tolist() == [[0, 1], [198, 199], [7, 8]]


# Relaxation

@pytest.mark.parametrize('seed', range(4))
def test_relaxation_ends_where_that_of_ratslam_ends(seed):
    experience_map = random_graph(seed)
    expected = literal_relaxation(experience_map)
    experience_map.relax(ENOUGH)
    np.testing.assert_allclose(
        from_first(experience_map.poses), from_first(expected), atol=3e-3)


@pytest.mark.parametrize('seed', range(4))
def test_a_relaxed_map_pulls_nowhere(seed):
    """At rest the errors of the links of each experience cancel."""
    experience_map = random_graph(seed)
    experience_map.relax(ENOUGH)
    pull = np.zeros((len(experience_map), 3))
    for (a, b), motion in zip(experience_map.links, experience_map.motions):
        expected = compose(experience_map.pose(a), Pose2(*motion))
        error = np.subtract(experience_map.pose(b), expected)
        error[2] = wrap_angle(error[2])
        pull[a] += error
        pull[b] -= error
    np.testing.assert_allclose(pull, 0.0, atol=2e-3)


def test_a_map_without_contradictions_stays_put():
    experience_map = random_graph(0, noise=0.0)
    before = experience_map.poses.copy()
    experience_map.relax(ENOUGH)
    np.testing.assert_allclose(experience_map.poses, before, atol=1e-9)


@pytest.mark.parametrize('n_steps', [1, 5, ENOUGH])
def test_the_centroid_stays_put(n_steps):
    experience_map = random_graph(1)
    before = experience_map.poses[:, :2].mean(axis=0)
    experience_map.relax(n_steps)
    np.testing.assert_allclose(experience_map.poses[:, :2].mean(axis=0), before, atol=1e-9)


def test_a_loop_shares_the_gap_among_its_links():
    """A square of 1 m; the last link says 0.4 m too little: each of the four gives in by 0.1."""
    experience_map = graph(
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)],
        [(0, 1, (1, 0, 0)), (1, 2, (0, 1, 0)), (2, 3, (-1, 0, 0)), (3, 0, (0.4, -1, 0))])
    experience_map.relax(ENOUGH)
    np.testing.assert_allclose(
        from_first(experience_map.poses),
        [(0, 0, 0), (0.9, 0, 0), (0.8, 1, 0), (-0.3, 1, 0)], atol=1e-3)


def test_a_loop_of_turns_shares_the_turn_that_is_missing():
    """Four quarter turns on the spot that sum to 2 pi + 0.4: each is told 0.1 less."""
    experience_map = graph(
        [(0, 0, k * pi / 2) for k in range(4)],
        [(k, (k + 1) % 4, (0, 0, pi / 2 + 0.4 * (k == 3))) for k in range(4)])
    experience_map.relax(ENOUGH)
    turns = wrap_angle(np.diff(experience_map.poses[:, 2]))
    np.testing.assert_allclose(turns, pi / 2 - 0.1, atol=1e-3)


def test_a_square_flown_with_a_yaw_error_closes():
    """Odometry turned 0.1 rad too far at each corner; the closure brings the ends together."""
    odometry = [IDENTITY]
    for k in range(40):
        turn = pi / 2 + 0.1 if k % 10 == 9 else 0.0
        odometry.append(compose(odometry[-1], Pose2(0.5, 0.0, turn)))
    experience_map = graph(odometry, [
        (k, k + 1, between(a, b)) for k, (a, b) in enumerate(zip(odometry, odometry[1:]))])
    gap = np.hypot(*odometry[-1][:2])
    experience_map.add_link(40, 0, IDENTITY, True)
    experience_map.relax(ENOUGH)
    start, end = experience_map.poses[[0, 40], :2]
    assert gap > 1.0
    assert np.hypot(*(end - start)) < 0.1 * gap
    assert np.ptp(experience_map.poses[:, :2], axis=0) == pytest.approx([5.0, 5.0], abs=0.8)


def test_maps_that_are_not_joined_do_not_feel_each_other():
    separate = [(0, 1, (1, 0, 0)), (2, 3, (2, 0, 0.5))]
    experience_map = graph([(0, 0, 0), (1, 0, 0), (9, 9, 0), (10, 9, 0)], separate)
    experience_map.relax(ENOUGH)
    np.testing.assert_allclose(experience_map.poses[:2], [(0, 0, 0), (1, 0, 0)], atol=1e-9)
    c, d = experience_map.poses[2:, :2]
    assert np.hypot(*(d - c)) == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize('n', [0, 1, 3])
def test_a_map_without_links_has_nothing_to_relax(n):
    experience_map = graph([(k, 0, 0) for k in range(n)], [])
    experience_map.relax(ENOUGH)
    assert experience_map.poses[:, 0].tolist() == list(range(n))


def test_no_steps_move_nothing():
    experience_map = random_graph(2)
    before = experience_map.poses.copy()
    experience_map.relax(0)
    np.testing.assert_allclose(experience_map.poses, before, atol=1e-12)


def test_facings_stay_wrapped():
    experience_map = random_graph(3, noise=1.0)
    experience_map.relax(ENOUGH)
    assert (np.abs(experience_map.poses[:, 2]) <= pi).all()


# Relaxation as published

def test_a_sweep_moves_both_ends_of_a_link_by_half_its_error():
    """The second is 1 m too far, 0.4 m too far left and turned 0.2 rad too far."""
    experience_map = graph([(0, 0, 0), (3, 0.4, 0.7)], [(0, 1, (2, 0, 0.5))])
    experience_map.sweep(1)
    np.testing.assert_allclose(
        experience_map.poses, [(0.5, 0.2, 0.1), (2.5, 0.2, 0.6)], atol=1e-12)


def test_an_end_of_many_links_moves_by_their_mean():
    experience_map = graph([(0, 0, 0), (2, 0, 0), (0, 4, 0)], [
        (0, 1, (1, 0, 0)), (0, 2, (0, 1, 0))])
    experience_map.sweep(1)
    np.testing.assert_allclose(
        experience_map.poses, [(0.25, 0.75, 0), (1.5, 0, 0), (0, 2.5, 0)], atol=1e-12)


@pytest.mark.parametrize('n_sweeps', [1, 7])
@pytest.mark.parametrize('seed', range(3))
def test_sweeps_are_those_of_ratslam(seed, n_sweeps):
    experience_map = random_graph(seed)
    expected = literal_relaxation(experience_map, sweeps=n_sweeps)
    experience_map.sweep(n_sweeps)
    np.testing.assert_allclose(experience_map.poses[:, :2], expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(
        wrap_angle(experience_map.poses[:, 2] - expected[:, 2]), 0.0, atol=1e-9)


@pytest.mark.parametrize('seed', range(3))
def test_sweeps_and_the_solved_map_end_in_the_same_place(seed):
    swept, solved = random_graph(seed), random_graph(seed)
    swept.sweep(4000)
    solved.relax(ENOUGH)
    np.testing.assert_allclose(from_first(swept.poses), from_first(solved.poses), atol=3e-3)


def test_sweeps_leave_a_map_without_contradictions_and_one_without_links():
    for experience_map in (random_graph(0, noise=0.0), graph([(1, 2, 3)], [])):
        before = experience_map.poses.copy()
        experience_map.sweep(20)
        np.testing.assert_allclose(experience_map.poses, before, atol=1e-9)


def test_facings_stay_wrapped_under_sweeps():
    experience_map = random_graph(3, noise=1.0)
    experience_map.sweep(50)
    assert (np.abs(experience_map.poses[:, 2]) <= pi).all()


# A relaxation that takes several calls

def closed_loop(n=60):
    """Return a square, a closed path by an odometry that is 0.1 rad off at each corner."""
    odometry = [IDENTITY]
    for k in range(n - 1):
        turn = pi / 2 + 0.1 if k % (n // 4) == n // 4 - 1 else 0.0
        odometry.append(compose(odometry[-1], Pose2(0.5, 0.0, turn)))
    experience_map = graph(odometry, [
        (k, k + 1, between(a, b)) for k, (a, b) in enumerate(zip(odometry, odometry[1:]))])
    experience_map.add_link(n - 1, 0, Pose2(0.5, 0.0, pi / 2), True)
    return experience_map


def test_a_relaxation_in_many_calls_moves_all_at_the_last_as_one_call_does():
    at_once, spread = closed_loop(), closed_loop()
    before = spread.poses.copy()
    at_once.relax(ENOUGH)
    n_calls = 0
    while np.array_equal(spread.poses, before):
        spread.relax(1)
        n_calls += 1
    assert n_calls > 10
    np.testing.assert_array_equal(spread.poses, at_once.poses)


def test_what_is_added_meanwhile_goes_along():
    experience_map = closed_loop()
    experience_map.relax(3)
    for origin in (59, 60, 5):
        pose = compose(experience_map.pose(origin), Pose2(1.0, 0.5, 0.3))
        added = experience_map.add_experience(pose)
        experience_map.add_link(origin, added, Pose2(1.0, 0.5, 0.3), False)
    before = experience_map.poses.copy()
    experience_map.relax(ENOUGH)
    assert np.abs(experience_map.poses - before).max() > 0.1
    for origin, target in ((59, 60), (60, 61), (5, 62)):
        motion = between(experience_map.pose(origin), experience_map.pose(target))
        assert motion == pytest.approx(Pose2(1.0, 0.5, 0.3))


def test_a_link_that_agrees_does_not_hide_one_that_does_not():
    experience_map = graph([(0, 0, 0), (3, 0, 0), (4, 0, 0)], [
        (0, 1, (1, 0, 0)), (1, 2, (1, 0, 0))])
    experience_map.relax(ENOUGH)
    assert np.diff(experience_map.poses[:, 0]) == pytest.approx([1.0, 1.0], abs=1e-3)


def move(experience_map):
    experience_map.move(np.array([7]), experience_map.poses[[7]] + 0.2)


def unlink(experience_map):
    experience_map.remove_links(np.arange(len(experience_map.links)) == 20)


@pytest.mark.parametrize('change', [move, unlink])
def test_a_change_of_what_there_was_begins_it_anew(change):
    begun, fresh = closed_loop(), closed_loop()
    begun.relax(3)
    for experience_map in (begun, fresh):
        change(experience_map)
        experience_map.relax(ENOUGH)
    np.testing.assert_array_equal(begun.poses, fresh.poses)


def test_a_link_that_comes_meanwhile_has_its_turn_after():
    experience_map = closed_loop()
    experience_map.relax(3)
    experience_map.add_link(10, 40, Pose2(1.0, 1.0, 1.0), True)
    experience_map.relax(ENOUGH)
    one = experience_map.poses.copy()
    experience_map.relax(ENOUGH)
    assert np.abs(experience_map.poses - one).max() > 0.1


def test_the_radius_is_half_the_diagonal_of_the_box_about_the_map():
    experience_map = ExperienceMap()
    assert experience_map.radius_m == 0.0
    for pose in (Pose2(1.0, 1.0, 0.0), Pose2(4.0, 5.0, 0.0), Pose2(2.0, 1.0, 0.0)):
        experience_map.add_experience(pose)
    assert experience_map.radius_m == pytest.approx(2.5)
    experience_map.add_experience(Pose2(1.0, -7.0, 0.0))
    assert experience_map.radius_m == pytest.approx(0.5 * np.hypot(3.0, 12.0))
    experience_map.move(np.array([3]), np.array([(1.0, 1.0, 0.0)]))
    assert experience_map.radius_m == pytest.approx(2.5)
