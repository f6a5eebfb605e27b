"""Poses go back to the autopilot at their rate, in its axes, and only while they are known."""

from math import inf, pi

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import IDENTITY, OdometrySample, Pose2, PoseEstimate
from dlsc_qbs_ros.io.mavlink.framing import dialect
from dlsc_qbs_ros.io.mavlink.vision import vision_message, VisionOutput
import numpy as np
import pytest

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 20_000_000


def estimate(k=0, pose=IDENTITY, sigma_m=0.3, sigma_rad=0.1, map_T_odom=IDENTITY, odom=IDENTITY,
             track=None, **odometry):
    """Give the k-th estimate at 50 Hz."""
    stamp_ns = START_NS + k * PERIOD_NS
    return PoseEstimate(stamp_ns, pose, OdometrySample(stamp_ns, odom, **odometry), map_T_odom,
                        odom if track is None else track, sigma_m, sigma_rad)


class Flight:
    """Estimates at 50 Hz and codes at 10 Hz, and what goes out."""

    def __init__(self, **values):
        self.sent = []
        config = Config().override({f'mavlink.{key}': value for key, value in values.items()})
        self.output = VisionOutput(config, self.sent.append)
        self._k = self.n_closures = 0

    def go_on(self, n=50, has_codes=True, **changes):
        """Fly for n estimates; return what was sent."""
        self.sent.clear()
        for k in range(self._k, self._k + n):
            if has_codes and k % 5 == 0:
                self.output.map_updated(START_NS + k * PERIOD_NS, self.n_closures)
            self.output.offer(estimate(k, **changes))
        self._k += n
        return list(self.sent)


@pytest.mark.parametrize('rate_hz, n_sent', [(10.0, 20), (4.0, 8), (30.0, 60), (100.0, 100)])
def test_the_rate_is_kept_in_the_mean_within_that_of_odometry(rate_hz, n_sent):
    assert len(Flight(vision_rate_hz=rate_hz).go_on(100)) == n_sent


def test_stamps_are_those_of_the_poses():
    stamps_us = [message.time_usec for message in Flight(vision_rate_hz=10.0).go_on(11)]
    assert stamps_us == [START_NS // 1000 + k * 100_000 for k in range(3)]


def test_nothing_goes_out_before_the_first_code():
    flight = Flight()
    assert flight.go_on(has_codes=False) == []
    assert flight.output.counts['vision_withheld'] == 10


@pytest.mark.parametrize('unknown', [{'sigma_m': inf}, {'sigma_rad': inf}])
def test_nothing_goes_out_while_odometry_is_broken(unknown):
    flight = Flight()
    flight.go_on()
    assert flight.go_on(**unknown) == []
    assert len(flight.go_on()) == 10


def test_without_codes_for_a_second_nothing_goes_out():
    flight = Flight(vision_rate_hz=10.0)
    flight.go_on(50)
    assert len(flight.go_on(100, has_codes=False)) == 10


def test_the_reset_counter_steps_with_every_closure_made_or_taken_back():
    flight = Flight()
    assert {message.reset_counter for message in flight.go_on()} == {0}
    for n_closures, counter in ((1, 1), (2, 2), (2, 2), (1, 3)):
        flight.n_closures = n_closures
        assert {message.reset_counter for message in flight.go_on()} == {counter}


def test_it_steps_from_the_pose_at_the_closing_code_on():
    flight = Flight(vision_rate_hz=50.0)
    flight.output.map_updated(START_NS, 0)
    flight.output.map_updated(START_NS + 3 * PERIOD_NS, 1)
    assert [message.reset_counter for message in flight.go_on(5, has_codes=False)] == [
        0, 0, 0, 1, 1]


def test_it_steps_where_poses_go_on_after_they_were_withheld():
    flight = Flight()
    before = flight.go_on()[-1].reset_counter
    flight.go_on(sigma_m=inf)
    assert {message.reset_counter for message in flight.go_on()} == {before + 1}


@pytest.mark.parametrize('correction, n_steps', [
    (Pose2(0.29, 0.0, 0.0), 0), (Pose2(0.0, 0.31, 0.0), 1), (Pose2(0.0, 0.0, -0.11), 1)])
def test_it_steps_where_the_map_moves_the_pose_without_a_closure(correction, n_steps):
    flight = Flight()
    flight.go_on()
    counters = {message.reset_counter
                for message in flight.go_on(pose=correction, map_T_odom=correction)}
    assert counters == {n_steps}


def test_it_steps_once_small_moves_have_come_to_a_large_one():
    flight = Flight()
    flight.go_on()
    counters = []
    for k in range(8):
        moved = Pose2(0.11 * k, 0.0, 0.0)
        counters.append(flight.go_on(pose=moved, map_T_odom=moved)[-1].reset_counter)
    assert counters == [0, 0, 0, 1, 1, 1, 2, 2]


def test_what_is_known_of_the_error_of_the_odometry_is_no_step():
    """It turns map_T_odom all the time, and the poses with it, but they go on as they should."""
    flight, counters = Flight(), set()
    for k in range(600):
        turned = Pose2(0.0, 0.0, 0.0015 * k)
        counters |= {message.reset_counter for message in flight.go_on(
            5, pose=turned, map_T_odom=turned, track=turned)}
    assert len(counters) == 1


def test_flying_is_no_move_of_the_map():
    flight = Flight()
    flight.go_on()
    there = Pose2(5.0, -3.0, 1.0)
    assert {message.reset_counter for message in flight.go_on(pose=there, odom=there)} == {0}


def test_it_goes_round_after_255():
    flight = Flight(vision_rate_hz=50.0)
    counters = []
    for flight.n_closures in range(1, 300):
        counters.append(flight.go_on(5)[-1].reset_counter)
    assert counters[:3] == [1, 2, 3]
    assert counters[253:257] == [254, 255, 0, 1]


def test_a_clock_that_falls_back_does_not_silence_it():
    flight = Flight()
    flight.go_on()
    flight._k = -1000
    assert len(flight.go_on()) == 10


def test_the_pose_is_in_axes_forward_right_down():
    message = vision_message(estimate(
        pose=Pose2(1.0, 2.0, pi / 2), z_m=3.0, roll_rad=0.0, pitch_rad=0.0), 7, 0.3)
    assert (message.frame_id, message.child_frame_id) == (
        dialect.MAV_FRAME_LOCAL_FRD, dialect.MAV_FRAME_BODY_FRD)
    assert (message.x, message.y, message.z) == (1.0, -2.0, -3.0)
    assert message.q == pytest.approx([0.5 ** 0.5, 0.0, 0.0, -0.5 ** 0.5])  # to the left
    assert (message.reset_counter, message.estimator_type) == (
        7, dialect.MAV_ESTIMATOR_TYPE_VISION)


def test_roll_stays_and_pitch_changes_its_sign():
    message = vision_message(estimate(roll_rad=0.2, pitch_rad=0.0), 0, 0.3)
    assert message.q == pytest.approx([np.cos(0.1), np.sin(0.1), 0.0, 0.0])
    message = vision_message(estimate(roll_rad=0.0, pitch_rad=0.2), 0, 0.3)
    assert message.q == pytest.approx([np.cos(0.1), 0.0, -np.sin(0.1), 0.0])


def test_the_covariance_is_known_and_that_of_the_velocity_is_not():
    message = vision_message(estimate(sigma_m=2.0, sigma_rad=0.5), 0, 0.3)
    covariance = np.zeros((6, 6))
    covariance[np.triu_indices(6)] = message.pose_covariance
    np.testing.assert_array_equal(covariance, np.diag([4.0, 4.0, 4.0, 0.25, 0.25, 0.25]))
    assert np.isnan([message.vx, message.vy, message.vz, message.rollspeed, message.pitchspeed,
                     message.yawspeed, message.velocity_covariance[0]]).all()


@pytest.mark.parametrize('sigma_m, quality', [(0.0, 100), (0.3, 100), (0.6, 50), (1e6, 1)])
def test_the_quality_falls_with_the_deviation_but_stays_known(sigma_m, quality):
    assert vision_message(estimate(sigma_m=sigma_m), 0, 0.3).quality == quality


def test_it_survives_the_wire():
    message = vision_message(estimate(pose=Pose2(1.5, -2.5, 0.0)), 200, 0.3)
    mavlink = dialect.MAVLink(None, 1, 191)
    again = mavlink.decode(bytearray(message.pack(mavlink)))
    assert (again.x, again.y, again.reset_counter, again.quality) == (1.5, 2.5, 200, 100)
