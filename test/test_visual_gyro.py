"""Turns as views tell them, and what they make of the odometry's yaw rate."""

from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest

from dlsc_qbs_ros.config import Config, OdometryConfig
from dlsc_qbs_ros.core.types import OdometrySample, Pose2
from dlsc_qbs_ros.core.visual_turn import prepare, shift_between, turns_along
from dlsc_qbs_ros.core.yaw_rate import YawRateError
from dlsc_qbs_ros.pipeline.follower import Follower
from dlsc_qbs_ros.pipeline.journey import Journey
from dlsc_qbs_ros.pipeline.mapper import Mapper
from dlsc_qbs_ros.pipeline.visual_gyro import VisualGyro

ROWS, COLUMNS, FOCAL_PX = 32, 43, 26.0
STILL = 0.0, 0.0, 0.0
ODOMETRY = OdometryConfig(yaw_bias_rad_s=0.012, yaw_noise=0.03)
CONFIG = Config()


def panorama(yaw_rad):
    """Return what a camera that only turns sees of far, smooth surroundings, uint8."""
    rng = np.random.default_rng(0)
    x = np.arange(COLUMNS) - (COLUMNS - 1) / 2
    y = np.arange(ROWS)[:, None] - (ROWS - 1) / 2
    bearing = yaw_rad - np.arctan2(x, FOCAL_PX)
    slope = y / np.hypot(x, FOCAL_PX)
    waves = sum(np.sin(k * bearing + m * slope + phase) for k, m, phase in zip(
        rng.integers(5, 15, 12), rng.uniform(-9.0, 9.0, 12), rng.uniform(0.0, 6.3, 12)))
    return np.clip(128 + 20 * waves, 0, 255).astype(np.uint8)


def shift(turn_rad, guess_rad):
    before, after = (prepare(panorama(yaw)) for yaw in (0.3, 0.3 + turn_rad))
    return shift_between(before, after, STILL, guess_rad, FOCAL_PX)


@pytest.mark.parametrize('turn_rad', [-0.12, -0.03, 0.0, 0.01, 0.08])
@pytest.mark.parametrize('guess_error_rad', [-0.01, 0.0, 0.01])
def test_a_turn_is_told_whatever_odometry_takes_it_for(turn_rad, guess_error_rad):
    shift_px, sigma_px = shift(turn_rad, turn_rad + guess_error_rad)
    assert shift_px == pytest.approx(FOCAL_PX * turn_rad, abs=0.06)
    assert 0.0 < sigma_px < 0.1


def test_brighter_and_flatter_is_no_turn():
    view = panorama(0.3)
    dimmed = (0.5 * view + 40).astype(np.uint8)
    shift_px, _ = shift_between(prepare(view), prepare(dimmed), STILL, 0.0, FOCAL_PX)
    assert shift_px == pytest.approx(0.0, abs=0.02)


def test_a_turn_too_large_for_the_view_is_not_told():
    assert shift(0.05, 0.5) is None


@pytest.mark.parametrize('view', [
    np.full((ROWS, COLUMNS), 7, np.uint8), panorama(0.3) // 32,
    np.eye(8, 64, dtype=np.uint8) * 255, np.eye(64, 8, dtype=np.uint8) * 255])
def test_a_view_without_anything_in_it_tells_nothing(view):
    assert prepare(view) is None


def test_a_large_view_is_averaged_down():
    large = np.kron(panorama(0.1), np.ones((3, 3))).astype(np.uint8)
    np.testing.assert_allclose(prepare(large), prepare(panorama(0.1)), atol=1e-3)


def filtered(bias_rad_s, focal=1.0, prior=0.012):
    """Return the filter after a flight of straights and bends, by an odometry so wrong."""
    rng = np.random.default_rng(1)
    error, dt = YawRateError(replace(ODOMETRY, yaw_bias_rad_s=prior)), 0.1
    for k in range(600):
        turn = 0.1 if k % 120 < 15 else 0.0
        error.age(dt)
        error.update(turn + bias_rad_s * dt + rng.normal(0.0, 0.004),
                     focal * turn + rng.normal(0.0, 0.001), 0.0, dt)
    return error


@pytest.mark.parametrize('bias_rad_s', [-0.012, 0.0, 0.02])
@pytest.mark.parametrize('focal', [0.8, 1.0, 1.3])
def test_the_error_and_the_lens_are_told_apart(bias_rad_s, focal):
    error = filtered(bias_rad_s, focal)
    assert error.rad_s() == pytest.approx(bias_rad_s, abs=0.004)
    assert error.scale == pytest.approx(1.0 / focal, rel=0.05)


def test_an_odometry_that_is_sure_of_its_yaw_rate_is_left_alone():
    assert filtered(0.01, prior=0.0).rad_s() == 0.0


@pytest.mark.parametrize('bias_rad_s', [-0.001, 0.001])
def test_an_odometry_with_a_compass_stays_as_it_is(bias_rad_s):
    assert filtered(bias_rad_s).rad_s() == 0.0


def test_views_that_contradict_odometry_are_not_believed():
    assert filtered(0.3).rad_s() == 0.0


def test_another_odometry_begins_without_an_error_but_with_the_lens():
    error = filtered(0.012, focal=1.3)
    error.restart()
    assert error.rad_s() == 0.0
    assert error.scale == pytest.approx(1.0 / 1.3, rel=0.05)


def test_an_odometry_of_other_deviations_is_another():
    error = filtered(0.012, focal=1.3)
    told = error.rad_s()
    error.reconfigure(ODOMETRY)
    assert error.rad_s() == told
    error.reconfigure(replace(ODOMETRY, yaw_noise=0.02))
    assert error.rad_s() == 0.0
    assert error.scale == pytest.approx(1.0 / 1.3, rel=0.05)


@pytest.mark.parametrize('focal', [-1.0, 0.2, 0.3, 3.0, 8.0])
def test_views_that_no_lens_explains_are_not_believed(focal):
    """As of a camera that looks to the side, whose way looks like a turn, or a mirrored one."""
    error = filtered(0.012, focal)
    assert error.rad_s() == 0.0
    assert error.yaw_noise() == ODOMETRY.yaw_noise
    assert 0.4 <= error.scale <= 2.5


def test_the_noise_of_the_odometry_is_told():
    """Here 0.004 rad a tenth of a second; it is held for 1.5 times as much."""
    assert filtered(0.012).yaw_noise() == pytest.approx(1.5 * 0.004 / sqrt(0.1), rel=0.25)


def test_views_that_tell_nothing_leave_what_is_believed():
    error = YawRateError(ODOMETRY)
    for _ in range(600):
        error.update(0.003, 0.0, 1.0, 0.1)
    assert error.yaw_noise() == ODOMETRY.yaw_noise
    assert error.rad_s() == 0.0


def test_an_error_is_forgotten_where_no_views_come():
    error = filtered(0.012)
    assert error.rad_s() > 0.008
    error.age(3600.0)
    assert error.rad_s() == 0.0
    assert error.state() == pytest.approx([error.scale, 0.0, error.state()[2], 0.012 ** 2,
                                           *error.state()[4:]], abs=1e-6)


def test_what_was_learned_can_be_gone_on_from():
    error, other = filtered(0.012, focal=1.3), YawRateError(ODOMETRY)
    other.restore(error.state())
    assert (other.scale, other.rad_s(), other.yaw_noise()) == (
        error.scale, error.rad_s(), error.yaw_noise())
    np.testing.assert_array_equal(other.state(), error.state())


def looked(config, bias_rad_s=0.012):
    """Turn to and fro on the spot, with an odometry so wrong."""
    gyro, yaw = VisualGyro(config), 0.0
    for k in range(300):
        yaw += 0.03 * np.sin(k / 9)
        gyro.look(panorama(yaw), turned(k, yaw + bias_rad_s * 0.1 * k))
    return gyro


def turned(k, yaw_rad):
    return OdometrySample(k * 100_000_000, Pose2(0.0, 0.0, yaw_rad))


def blank_wall(k):
    """Return it through a lens that is darker to the sides, uint8: it looks so however turned."""
    y, x = np.mgrid[:ROWS, :COLUMNS]
    shade = np.hypot(x - COLUMNS / 2, y - ROWS / 2) ** 2 / (COLUMNS / 2) ** 2
    noise = np.random.default_rng(k).normal(0.0, 0.5, (ROWS, COLUMNS))
    return (110.0 - 20.0 * shade + noise).astype(np.uint8)


@pytest.mark.parametrize('rate_rad_s', [0.05, 0.1, -0.3])
def test_what_does_not_turn_along_is_no_scene(rate_rad_s):
    """Nothing is told by the shade of a lens, and what was known of the error stays."""
    gyro, known, new = looked(CONFIG), looked(CONFIG).error, VisualGyro(CONFIG)
    for k in range(300, 600):
        for either in gyro, new:
            either.look(blank_wall(k), turned(k, rate_rad_s * 0.1 * k))
    assert gyro.error.rad_s() == pytest.approx(known.rad_s(), abs=0.002)
    assert gyro.error.yaw_noise() == pytest.approx(known.yaw_noise(), rel=0.02)
    assert gyro.error.scale == pytest.approx(known.scale, rel=0.02)
    assert new.error.rad_s() == 0.0


def test_a_scene_that_comes_back_tells_again():
    gyro = VisualGyro(CONFIG)
    for k in range(100):
        gyro.look(blank_wall(k), turned(k, 0.01 * k))
    for k in range(100, 400):
        gyro.look(panorama(0.2 * np.sin(k / 9)), turned(k, 0.2 * np.sin(k / 9) + 0.0012 * k))
    assert gyro.error.rad_s() == pytest.approx(0.012, abs=0.004)


def test_of_another_odometry_nothing_was_known_before():
    gyro = looked(CONFIG)
    gyro.restart()
    for k in range(300, 400):
        gyro.look(blank_wall(k), turned(k, 0.01 * k))
    assert gyro.error.rad_s() == 0.0


@pytest.mark.parametrize('turn_rad', [-0.15, 0.15])
def test_a_scene_turns_along_and_a_shade_does_not(turn_rad):
    before, after = (prepare(panorama(yaw)) for yaw in (0.3, 0.3 + turn_rad))
    for guess in (0.5, 0.8, 1.2):
        assert turns_along(before, after, guess * FOCAL_PX * turn_rad)
    assert not turns_along(before, after, -FOCAL_PX * turn_rad)
    assert not turns_along(prepare(blank_wall(0)), prepare(blank_wall(1)), FOCAL_PX * turn_rad)
    assert turns_along(before, after, 0.21 * COLUMNS) is None


def test_the_error_is_taken_out_of_motions_while_they_last():
    gyro = looked(CONFIG)
    motion = gyro.corrected(Pose2(1.0, 0.0, 0.1), 1.0)
    assert motion.yaw_rad == pytest.approx(0.1 - 0.012, abs=0.004)
    assert gyro.corrected(Pose2(0.0, 0.0, 0.0), 5.0) == Pose2(0.0, 0.0, 0.0)


@pytest.mark.parametrize('values', [
    {'odometry.visual_gyro': False}, {'ratslam.backend': 'published'},
    {'odometry.yaw_bias_rad_s': 0.0}])
def test_where_it_is_not_wanted_motions_stay(values):
    motion = Pose2(1.0, 0.2, 0.1)
    assert looked(CONFIG.override(values)).corrected(motion, 1.0) == pytest.approx(motion)


def sample(k, turn_rad=0.1, segment=0):
    return OdometrySample(k * 1_000_000_000, Pose2(0.0, 0.0, turn_rad * k), segment=segment)


def told():
    """Return a map whose gyro has found an error of 0.012 rad/s."""
    mapper = Mapper(CONFIG)
    mapper.gyro.restore(np.array([1.0, 0.012, 1e-4, 1e-5, 0.002, 20.0]))
    return mapper


def test_the_map_turns_less_than_odometry_until_that_breaks():
    mapper, code = told(), np.ones(4, np.float32)
    error = mapper.gyro.error.rad_s()
    assert error == pytest.approx(0.011, abs=0.001)
    for k in range(3):
        mapper.update(sample(k), code)
    assert mapper.pose().yaw_rad == pytest.approx(2 * (0.1 - error))
    mapper.update(sample(3, segment=1), code)
    before = mapper.pose().yaw_rad
    mapper.update(sample(4, segment=1), code)
    assert mapper.pose().yaw_rad - before == pytest.approx(0.1)


@pytest.mark.parametrize('turn_rad', [0.1, 0.0125])
def test_the_pose_between_codes_goes_on_as_the_map_will(turn_rad):
    """So slow a turn is none of a robot that moves, less the error."""
    mapper, code = told(), np.ones(4, np.float32)
    follower = Follower(CONFIG, mapper)
    mapper.update(sample(0, turn_rad), code)
    mapper.visits.calibrate(np.array([[0.003, 0.0]]))
    follower.correct(sample(0, turn_rad))
    for k in range(1, 5):
        pose = follower.follow(sample(k, turn_rad)).pose
    mapper.update(sample(4, turn_rad), code)
    assert pose == pytest.approx(mapper.pose(), abs=1e-9)


def test_closures_are_held_against_the_noise_that_views_tell():
    """A circle that ends 0.3 rad off is no contradiction as odometry is believed to be."""
    contradictions = []
    for noise in (0.03, 0.005):
        journey = Journey(CONFIG.override({'odometry.yaw_bias_rad_s': 0.0}))
        journey.believe(noise)
        journey.visits.create(Pose2(0.0, 0.0, 0.0))
        for _ in range(200):
            journey.move(Pose2(0.1, 0.0, 2 * pi / 200 + 0.3 / 200), 0.1)
        contradictions.append(journey.contradiction(0))
    assert contradictions == [None, 0]
