"""Planar motions are a group; angles wrap; attitudes survive the round trip."""

from itertools import product
from math import pi

import numpy as np
import pytest

from dlsc_qbs_ros.core.geometry import (
    between, compose, euler_to_quaternion, interpolate, invert, quaternion_to_euler,
    swap_frd_flu, swap_frd_flu_attitude, swap_ned_enu, swap_ned_enu_attitude, wrap_angle)
from dlsc_qbs_ros.core.types import IDENTITY, Pose2


def poses(n, seed=0):
    rng = np.random.default_rng(seed)
    return [Pose2(*row) for row in rng.uniform([-9, -9, -pi], [9, 9, pi], (n, 3)).tolist()]


def assert_same(a, b):
    assert a[:2] == pytest.approx(b[:2], abs=1e-12)
    assert wrap_angle(a.yaw_rad - b.yaw_rad) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize('angle, wrapped', [
    (0.0, 0.0), (pi, -pi), (-pi, -pi), (3.5 * pi, -0.5 * pi), (-2.25 * pi, -0.25 * pi)])
def test_angles_wrap_to_minus_pi_inclusive_and_pi_exclusive(angle, wrapped):
    assert wrap_angle(angle) == pytest.approx(wrapped)


def test_an_array_of_angles_wraps_by_element():
    angles = np.array([[0.0, 4.0], [-4.0, 100.0]])
    wrapped = wrap_angle(angles)
    assert wrapped.shape == angles.shape
    np.testing.assert_allclose(np.exp(1j * wrapped), np.exp(1j * angles))
    assert (np.abs(wrapped) <= pi).all()


def test_a_quarter_turn_and_a_step_forward():
    assert_same(compose(Pose2(1.0, 2.0, pi / 2), Pose2(3.0, 1.0, pi / 2)), Pose2(0.0, 5.0, pi))


def test_a_motion_in_the_frame_of_a_pose_that_looks_left():
    assert_same(between(Pose2(1.0, 2.0, pi / 2), Pose2(0.0, 5.0, pi)), Pose2(3.0, 1.0, pi / 2))


def test_motions_are_a_group():
    for a, b, c in zip(poses(20), poses(20, 1), poses(20, 2)):
        assert_same(compose(compose(a, b), c), compose(a, compose(b, c)))
        assert_same(compose(a, IDENTITY), a)
        assert_same(compose(IDENTITY, a), a)
        assert_same(compose(a, invert(a)), IDENTITY)
        assert_same(compose(invert(a), a), IDENTITY)
        assert_same(compose(a, between(a, b)), b)


def test_motions_are_matrices():
    def matrix(pose):
        c, s = np.cos(pose.yaw_rad), np.sin(pose.yaw_rad)
        return np.array([[c, -s, pose.x_m], [s, c, pose.y_m], [0, 0, 1]])
    for a, b in zip(poses(20), poses(20, 1)):
        np.testing.assert_allclose(matrix(compose(a, b)), matrix(a) @ matrix(b), atol=1e-12)


def test_interpolation_meets_both_ends_and_the_middle():
    a, b = Pose2(1.0, 2.0, 0.2), Pose2(3.0, -2.0, 0.6)
    assert_same(interpolate(a, b, 0.0), a)
    assert_same(interpolate(a, b, 1.0), b)
    assert_same(interpolate(a, b, 0.25), Pose2(1.5, 1.0, 0.3))


def test_interpolation_turns_the_shorter_way():
    a, b = Pose2(0.0, 0.0, pi - 0.1), Pose2(0.0, 0.0, -pi + 0.3)
    assert_same(interpolate(a, b, 0.5), Pose2(0.0, 0.0, -pi + 0.1))


@pytest.mark.parametrize('euler, quaternion', [
    ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
    ((0.0, 0.0, pi / 2), (0.0, 0.0, 0.5 ** 0.5, 0.5 ** 0.5)),
    ((pi, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),
    ((0.0, pi / 2, 0.0), (0.0, 0.5 ** 0.5, 0.0, 0.5 ** 0.5)),
])
def test_quaternions_of_plain_turns(euler, quaternion):
    assert euler_to_quaternion(*euler) == pytest.approx(quaternion)
    roll, pitch, yaw = quaternion_to_euler(*quaternion)
    assert pitch == pytest.approx(euler[1], abs=1e-6)
    if abs(pitch) < 1.5:
        assert (roll, yaw) == pytest.approx((euler[0], euler[2]))


def test_attitudes_survive_the_round_trip():
    for euler in product((-3.0, -1.0, 0.0, 2.0), (-1.5, 0.0, 0.7), (-3.1, 0.0, 1.2)):
        quaternion = euler_to_quaternion(*euler)
        assert np.linalg.norm(quaternion) == pytest.approx(1.0)
        assert quaternion_to_euler(*quaternion) == pytest.approx(euler, abs=1e-9)
        assert quaternion_to_euler(*(-v for v in quaternion)) == pytest.approx(euler, abs=1e-9)


def test_rounding_does_not_throw_the_steepest_pitch_out_of_range():
    x, y, z, w = euler_to_quaternion(0.3, pi / 2, 0.4)
    scale = 1 + 1e-12
    assert quaternion_to_euler(x * scale, y * scale, z * scale, w * scale)[1] == pytest.approx(
        pi / 2)


@pytest.mark.parametrize('ned, enu', [
    ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
    ((1.0, 2.0, 3.0), (2.0, 1.0, -3.0))])
def test_north_east_down_is_east_north_up(ned, enu):
    assert swap_ned_enu(*ned) == enu
    assert swap_ned_enu(*enu) == ned


def test_forward_right_down_is_forward_left_up():
    assert swap_frd_flu(1.0, 2.0, 3.0) == (1.0, -2.0, -3.0)
    assert swap_frd_flu(1.0, -2.0, -3.0) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize('swap', [swap_ned_enu, swap_frd_flu])
def test_an_unknown_coordinate_leaves_the_others_known(swap):
    assert np.isnan(swap(1.0, 2.0, np.nan)).tolist() == [False, False, True]


@pytest.mark.parametrize('ned, enu', [
    ((0.0, 0.0, 0.0), (0.0, 0.0, pi / 2)),          # looks north
    ((0.0, 0.0, pi / 2), (0.0, 0.0, 0.0)),          # looks east
    ((0.0, 0.0, pi), (0.0, 0.0, -pi / 2)),          # looks south
    ((0.1, 0.0, pi / 2), (0.1, 0.0, 0.0)),          # right wing down in both
    ((0.0, 0.2, pi / 2), (0.0, -0.2, 0.0))])        # nose up: turned about the left axis, less
def test_attitudes_of_plain_headings(ned, enu):
    assert swap_ned_enu_attitude(*ned) == pytest.approx(enu)


@pytest.mark.parametrize('axes, swap, swap_attitude', [
    (np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]), swap_ned_enu, swap_ned_enu_attitude),
    (np.diag([1, -1, -1]), swap_frd_flu, swap_frd_flu_attitude)])
def test_attitudes_turn_as_matrices_do_and_come_back(axes, swap, swap_attitude):
    body = np.diag([1, -1, -1])
    np.testing.assert_array_equal(swap(*np.eye(3)), axes.T)
    for attitude in product((-3.0, -1.0, 0.0, 2.0), (-1.5, 0.0, 0.7), (-3.1, 0.0, 1.2)):
        swapped = swap_attitude(*attitude)
        np.testing.assert_allclose(
            rotation(swapped), axes @ rotation(attitude) @ body, atol=1e-12)
        np.testing.assert_allclose(swap_attitude(*swapped), attitude, atol=1e-12)


def rotation(attitude):
    """Return the matrix of roll, pitch and yaw: about x, then y, then z of the frame."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(attitude), np.sin(attitude)
    roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return yaw @ pitch @ roll
