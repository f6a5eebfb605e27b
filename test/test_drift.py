"""What odometry may be wrong by, worked out by hand."""

from math import inf, isinf, pi, sqrt

import numpy as np
import pytest

from dlsc_qbs_ros.config import OdometryConfig
from dlsc_qbs_ros.core.drift import Drift, rectified, rectified_motion
from dlsc_qbs_ros.core.types import IDENTITY, Pose2

CONFIG = OdometryConfig(translation_drift=0.03, yaw_bias_rad_s=0.01, yaw_noise=0.02)
FAR = 1e3


def flown(*motions, anchor=(0.0, 0.0), config=CONFIG):
    drift = Drift(config)
    drift.anchor(*anchor)
    for motion, seconds in motions:
        drift.move(motion, seconds)
    return drift


def test_before_any_motion_everything_is_known():
    drift = Drift(CONFIG)
    assert (drift.position_sigma_m(FAR), drift.yaw_sigma_rad()) == (0.0, 0.0)


def test_heading_errs_by_bias_and_random_walk():
    drift = flown((IDENTITY, 10.0), (IDENTITY, 15.0))
    assert drift.yaw_sigma_rad() == pytest.approx(sqrt((0.01 * 25) ** 2 + 0.02 ** 2 * 25))


def test_position_errs_by_a_share_of_the_path_not_of_the_displacement():
    config = OdometryConfig(translation_drift=0.03, yaw_bias_rad_s=0.0, yaw_noise=0.0)
    drift = flown((Pose2(3.0, 4.0, 0.0), 1.0), (Pose2(-3.0, -4.0, 0.0), 1.0), config=config)
    assert drift.position_sigma_m(FAR) == pytest.approx(0.03 * 10.0)


def test_position_errs_by_the_heading_over_half_the_path():
    config = OdometryConfig(translation_drift=0.0, yaw_bias_rad_s=0.01, yaw_noise=0.0)
    drift = flown((Pose2(8.0, 0.0, 0.0), 10.0), config=config)
    assert drift.position_sigma_m(FAR) == pytest.approx(0.5 * 8.0 * 0.1)


def test_heading_cannot_throw_the_position_farther_than_across_the_map():
    config = OdometryConfig(translation_drift=0.0, yaw_bias_rad_s=0.01, yaw_noise=0.0)
    drift = flown((Pose2(80.0, 0.0, 0.0), 10.0), config=config)
    assert drift.position_sigma_m(5.0) == pytest.approx(0.5 * 5.0 * 0.1)


def test_what_was_left_at_the_anchor_stays():
    drift = flown((Pose2(2.0, 0.0, 0.0), 0.0), anchor=(0.3, 0.1))
    assert drift.yaw_sigma_rad() == pytest.approx(0.1)
    assert drift.position_sigma_m(FAR) == pytest.approx(
        sqrt(0.3 ** 2 + 0.06 ** 2 + (0.5 * 2.0 * 0.1) ** 2))


def test_an_anchor_forgets_path_and_time():
    drift = flown((Pose2(50.0, 0.0, 0.0), 100.0))
    drift.anchor(0.2, 0.05)
    assert drift.position_sigma_m(FAR) == pytest.approx(0.2)
    assert drift.yaw_sigma_rad() == pytest.approx(0.05)


@pytest.mark.parametrize('motion', [IDENTITY, Pose2(1.0, 0.0, 0.1)])
@pytest.mark.parametrize('map_radius_m', [0.0, 5.0])
def test_a_pose_that_nobody_knows_is_known_by_infinity(motion, map_radius_m):
    drift = flown((motion, 1.0), anchor=(inf, inf))
    assert isinf(drift.position_sigma_m(map_radius_m))
    assert isinf(drift.yaw_sigma_rad())


def test_what_it_were_after_more_odometry_is_what_more_odometry_makes_it():
    drift, longer = (flown((Pose2(metres, 0.0, 0.0), seconds), anchor=(0.3, 0.1))
                     for metres, seconds in ((2.0, 3.0), (6.0, 10.0)))
    beyond = drift.beyond(np.array([0.0, 7.0]), np.array([0.0, 4.0]))
    assert beyond.yaw_sigma_rad() == pytest.approx([drift.yaw_sigma_rad(),
                                                    longer.yaw_sigma_rad()])
    assert beyond.position_sigma_m(3.0) == pytest.approx([drift.position_sigma_m(3.0),
                                                          longer.position_sigma_m(3.0)])


def test_half_a_turn_too_far_on_the_way_led_aside_by_a_quarter():
    """And a motion that turned by no more than it should is as it was."""
    np.testing.assert_allclose(
        rectified(np.array([[2.0, 0.0, pi], [1.0, 2.0, 0.3]]), np.array([pi, 0.0]), np.zeros(2)),
        [[0.0, -2.0, 0.0], [1.0, 2.0, 0.3]], atol=1e-12)


def test_an_arc_that_was_none_is_straight():
    steps, pose = np.tile([0.01, 0.0, 0.0004], (500, 1)), np.zeros(3)
    for x, y, turn in steps:
        c, s = np.cos(pose[2]), np.sin(pose[2])
        pose += (c * x - s * y, s * x + c * y, turn)
    np.testing.assert_allclose(
        rectified(pose[None], np.array([0.2]), np.zeros(1))[0], [5.0, 0.0, 0.0], atol=0.01)


def test_a_motion_that_was_told_too_long_is_shorter_and_turns_as_far():
    np.testing.assert_allclose(
        rectified(np.array([[2.0, -1.0, 0.3]]), np.zeros(1), np.array([0.1])), [[1.8, -0.9, 0.3]])


@pytest.mark.parametrize('motion', [(2.0, -1.0, 0.3), (0.0, 1.0, 3.1), (-1.0, 0.0, -3.0)])
def test_one_motion_is_rectified_as_many_are(motion):
    many = rectified(np.array([motion]), np.array([-0.2]), np.array([0.1]))
    assert rectified_motion(Pose2(*motion), -0.2, 0.1) == pytest.approx(many[0])
