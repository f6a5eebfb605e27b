"""The attractor network: one packet of activity that moves with odometry and jumps at matches."""

from math import cos, pi, sin

import numpy as np
import pytest

from dlsc_qbs_ros.config import PoseCellsConfig
from dlsc_qbs_ros.core.pose_cells import (
    EXCITATION, GLOBAL_INHIBITION, INHIBITION, N_HEADINGS, PoseCells)
from dlsc_qbs_ros.core.types import IDENTITY, Pose2

CELL_RAD = 2 * pi / N_HEADINGS


def settled(heading=0, **config):
    """Return a network whose packet rests in the middle, looking along a heading in cells."""
    cells = PoseCells(PoseCellsConfig(**config))
    for _ in range(10):
        cells.step(IDENTITY)
    for _ in range((heading - N_HEADINGS // 2) % N_HEADINGS):
        cells.step(Pose2(0.0, 0.0, CELL_RAD))
    assert round(cells.position()[2]) == heading
    return cells


def travelled(cells, motion, n_steps):
    """Return how far the read-out goes, in cells, unwrapped."""
    size = np.array(cells.shape[::-1])
    total, before = np.zeros(3), cells.position()
    for _ in range(n_steps):
        cells.step(motion)
        after = cells.position()
        total += (after - before + size / 2) % size - size / 2
        before = after
    return total


def convolved(activity, width, deviation):
    """Return the circular convolution with a Gaussian cube of sum 1, by its definition."""
    reach = np.arange(width) - width // 2
    offsets = np.array(np.meshgrid(reach, reach, reach)).reshape(3, -1).T
    weights = np.exp(-np.sum(offsets ** 2, axis=1) / (2 * deviation ** 2))
    return sum(weight * np.roll(activity, offset, (0, 1, 2))
               for weight, offset in zip(weights / weights.sum(), offsets.tolist()))


def shifted(layer, x, y):
    """Return a layer moved by a fractional number of cells, bilinearly, on the torus."""
    left, up = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - left, y - up
    return sum(weight * np.roll(layer, (up + dy, left + dx), (0, 1)) for dy, dx, weight in (
        (0, 0, (1 - fy) * (1 - fx)), (0, 1, (1 - fy) * fx),
        (1, 0, fy * (1 - fx)), (1, 1, fy * fx)))


def literal_step(activity, motion, cell_size_m):
    """Return the activity after RatSLAM's step, operation by operation."""
    activity = convolved(activity, *EXCITATION)
    activity = activity - convolved(activity, *INHIBITION)
    activity = np.maximum(activity - GLOBAL_INHIBITION, 0.0)
    moved = np.empty_like(activity)
    for k, layer in enumerate(activity):
        c, s = cos(k * CELL_RAD), sin(k * CELL_RAD)
        moved[k] = shifted(layer, (c * motion.x_m - s * motion.y_m) / cell_size_m,
                           (s * motion.x_m + c * motion.y_m) / cell_size_m)
    turn = motion.yaw_rad / CELL_RAD
    whole = int(np.floor(turn))
    moved = ((1 - turn + whole) * np.roll(moved, whole, 0)
             + (turn - whole) * np.roll(moved, whole + 1, 0))
    return moved / moved.sum()


@pytest.mark.parametrize('size_xy, cell_size_m', [(8, 1.0), (11, 0.5)])
def test_a_step_is_that_of_ratslam_operation_by_operation(size_xy, cell_size_m):
    cells = PoseCells(PoseCellsConfig(size_xy=size_xy, cell_size_m=cell_size_m))
    rng = np.random.default_rng(0)
    expected = cells.activity = rng.random(cells.shape) ** 40
    for x, y, yaw in rng.normal(0.0, 1.2, (6, 3)):
        expected = literal_step(expected, Pose2(x, y, yaw), cell_size_m)
        cells.step(Pose2(x, y, yaw))
        np.testing.assert_allclose(cells.activity, expected, atol=1e-12)


@pytest.mark.parametrize('injection', [0.0, 0.3, 100.0])
def test_activity_stays_a_distribution(injection):
    cells = PoseCells(PoseCellsConfig())
    rng = np.random.default_rng(1)
    for x, y, yaw in rng.normal(0.0, 0.7, (100, 3)):
        cells.inject(rng.uniform(0.0, 60.0, 3), injection)
        cells.step(Pose2(x, y, yaw))
        assert cells.activity.sum() == pytest.approx(1.0)
        assert (cells.activity >= 0.0).all()


def test_a_packet_that_is_placed_is_there_alone():
    cells = settled()
    cells.place(np.array([3.2, 20.9, 35.8]))
    assert cells.activity.sum() == cells.activity[0, 0, 3] == 1.0


def test_a_packet_at_rest_stays_one_packet_where_it_is():
    cells = settled(18)
    before = cells.activity.copy()
    for _ in range(200):
        cells.step(IDENTITY)
    np.testing.assert_allclose(cells.position(), [10.0, 10.0, 18.0], atol=1e-6)
    np.testing.assert_allclose(cells.activity, before, atol=1e-3)
    assert (cells.activity > 1e-6).sum() < 200


# Motion

@pytest.mark.parametrize('heading', range(0, N_HEADINGS, 3))
def test_a_step_forward_moves_the_packet_along_its_heading(heading):
    moved = travelled(settled(heading), Pose2(1.0, 0.0, 0.0), 4)
    angle = heading * CELL_RAD
    np.testing.assert_allclose(moved, [4 * cos(angle), 4 * sin(angle), 0.0], atol=0.25)


def test_a_step_to_the_left_moves_it_to_its_left():
    np.testing.assert_allclose(
        travelled(settled(9), Pose2(0.0, 1.0, 0.0), 4), [-4.0, 0.0, 0.0], atol=0.2)


def test_a_diagonal_of_fractions_adds_up():
    np.testing.assert_allclose(
        travelled(settled(0), Pose2(0.5, -0.25, 0.0), 16), [8.0, -4.0, 0.0], atol=0.5)


def test_the_packet_goes_round_the_torus():
    cells = settled(0)
    np.testing.assert_allclose(
        travelled(cells, Pose2(1.0, 0.0, 0.0), 23), [23.0, 0.0, 0.0], atol=0.5)
    assert 0.0 <= cells.position()[0] < 21.0


def test_metres_count_by_the_size_of_a_cell():
    moved = travelled(settled(0, cell_size_m=0.25), Pose2(0.25, 0.0, 0.0), 4)
    assert moved[0] == pytest.approx(4.0, abs=0.1)


@pytest.mark.parametrize('turn, n_steps', [
    (CELL_RAD, 40), (-CELL_RAD, 40), (0.5 * CELL_RAD, 20), (3.0, 5)])
def test_a_turn_turns_the_packet_and_leaves_its_place(turn, n_steps):
    moved = travelled(settled(0), Pose2(0.0, 0.0, turn), n_steps)
    np.testing.assert_allclose(
        moved, [0.0, 0.0, n_steps * turn / CELL_RAD], atol=0.02 * n_steps)


@pytest.mark.parametrize('cells_per_step', [0.05, 0.1, 0.2])
def test_a_slow_packet_lags_by_less_than_a_sixth(cells_per_step):
    """The attractor holds the packet to the grid: a known property of such networks."""
    moved = travelled(settled(0), Pose2(cells_per_step, 0.0, 0.0), int(5 / cells_per_step))
    assert 5.0 * 5 / 6 < moved[0] <= 5.0


# Injection

def test_activity_is_injected_into_the_nearest_cell_of_the_torus():
    cells = PoseCells(PoseCellsConfig())
    cells.activity[:] = 0.0
    for energy in (2.0, 0.5):
        cells.inject(np.array([20.6, -1.2, 37.4]), energy)
    assert np.argwhere(cells.activity).tolist() == [[1, 20, 0]]
    assert cells.activity.sum() == 2.5


def test_a_small_injection_does_not_move_the_packet_but_a_second_one_does():
    cells, place = settled(18), np.array([16.0, 5.0, 25.0])
    distances = []
    for _ in range(2):
        cells.inject(place, 0.3)
        for _ in range(3):
            cells.step(IDENTITY)
        distances.append(float(cells.distance(cells.position(), place)))
    assert distances[0] > 10.0
    assert distances[1] < 0.5


def test_after_a_jump_the_old_packet_fades_until_one_is_left():
    cells, place = settled(18), np.array([16.0, 5.0, 25.0])
    cells.inject(place, 1.0)
    old = []
    for _ in range(200):
        cells.step(IDENTITY)
        old.append(cells.activity[15:22, 7:14, 7:14].sum())
    assert (np.diff(old[20:]) <= 0.0).all()
    assert old[-1] < 1e-6
    np.testing.assert_allclose(cells.position(), place, atol=1e-3)


# Positions

@pytest.mark.parametrize('place', [(3.0, 9.0, 30.0), (0.0, 20.0, 0.0), (20.6, 0.4, 35.7)])
def test_the_read_out_is_the_centre_of_the_packet_across_the_seams(place):
    cells = PoseCells(PoseCellsConfig())
    x, y, heading = place
    axes = [np.abs((np.arange(n) - centre + n / 2) % n - n / 2)
            for n, centre in zip(cells.shape, (heading, y, x))]
    profiles = [np.maximum(0.0, 3.0 - axis) for axis in axes]
    cells.activity = np.einsum('i,j,k', *profiles)
    assert cells.distance(cells.position(), np.array(place)) < 0.1


def test_the_read_out_does_not_listen_to_a_weaker_packet():
    cells = PoseCells(PoseCellsConfig())
    cells.activity[:] = 0.0
    cells.activity[30, 15, 3] = 0.4
    cells.activity[10, 4, 12] = 0.6
    np.testing.assert_allclose(cells.position(), [12.0, 4.0, 10.0], atol=1e-9)


def test_distance_is_the_shortest_on_the_torus():
    cells = PoseCells(PoseCellsConfig())
    a = np.array([1.0, 2.0, 35.0])
    b = np.array([[20.0, 2.0, 35.0], [1.0, 2.0, 1.0], [22.0, -40.0, 35.0], [4.0, 6.0, 35.0]])
    np.testing.assert_allclose(cells.distance(a, b), [2.0, 2.0, 0.0, 5.0])


def test_a_turned_position_turns_by_the_angle():
    position = PoseCells(PoseCellsConfig()).turned(np.array([1.0, 2.0, 3.0]), pi / 2)
    np.testing.assert_allclose(position, [1.0, 2.0, 12.0])
