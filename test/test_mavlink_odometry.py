"""What an autopilot's messages mean in ENU/FLU, and what is refused."""

from itertools import product
from math import cos, inf, isnan, nan, pi, sin, sqrt

from dlsc_qbs_ros.core.geometry import euler_to_quaternion, wrap_angle
from dlsc_qbs_ros.io.mavlink.clock import AutopilotClock
from dlsc_qbs_ros.io.mavlink.odometry import OdometryAssembler
from mavlink_peer import attitude, dialect, odometry, position, UNKNOWN
import numpy as np
import pytest

NED, FRD = dialect.MAV_FRAME_LOCAL_NED, dialect.MAV_FRAME_LOCAL_FRD
ENU, FLU = dialect.MAV_FRAME_LOCAL_ENU, dialect.MAV_FRAME_LOCAL_FLU
BODY_FRD, BODY_FLU = dialect.MAV_FRAME_BODY_FRD, 13
ARRIVAL_NS = 1_700_000_000_000_000_000
DOWN = np.diag([1, -1, -1])
AXES = {NED: np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]), FRD: DOWN, ENU: np.eye(3),
        FLU: np.eye(3)}


class Link:
    """Messages that take no time on the way, to an assembler."""

    def __init__(self):
        self.assembler = OdometryAssembler(AutopilotClock())

    def send(self, *messages):
        made = []
        for message in messages:
            boot_ns = (message.time_usec * 1000 if hasattr(message, 'time_usec')
                       else message.time_boot_ms * 1_000_000)
            made += self.assembler.take(message, ARRIVAL_NS + boot_ns)
        return made

    @property
    def counts(self):
        return dict(self.assembler.counts)


def wxyz(roll, pitch, yaw):
    x, y, z, w = euler_to_quaternion(roll, pitch, yaw)
    return w, x, y, z


def one(message):
    raw, = Link().send(message)
    return raw


@pytest.mark.parametrize('yaw_ned, yaw_enu', [(0.0, pi / 2), (pi / 2, 0.0), (-pi / 2, -pi)])
def test_odometry_in_ned_and_frd_is_odometry_in_enu_and_flu(yaw_ned, yaw_enu):
    raw = one(odometry(2.0, 1.0, 2.0, -3.0, wxyz(0.1, 0.2, yaw_ned),
                       vx=4.0, vy=5.0, yawspeed=0.6))
    sample = raw.sample
    assert sample.stamp_ns == ARRIVAL_NS + 2_000_000_000
    assert sample.pose == pytest.approx((2.0, 1.0, yaw_enu))
    assert (sample.z_m, sample.roll_rad, sample.pitch_rad) == pytest.approx((3.0, 0.1, -0.2))
    assert (raw.forward_m_s, raw.left_m_s, raw.yaw_rate_rad_s) == (4.0, -5.0, -0.6)


def test_the_heading_of_local_frd_is_its_own():
    raw = one(odometry(2.0, 1.0, 2.0, -3.0, wxyz(0.1, 0.2, 0.3), frame_id=FRD))
    assert raw.sample.pose == pytest.approx((1.0, -2.0, -0.3))
    assert raw.sample.z_m == 3.0


@pytest.mark.parametrize('frame', [NED, FRD, ENU, FLU])
@pytest.mark.parametrize('child', [
    BODY_FRD, BODY_FLU, dialect.MAV_FRAME_BODY_NED, NED, FRD, ENU, FLU])
def test_every_pair_of_frames_turns_pose_and_twist_as_matrices_do(frame, child):
    body_is_down = child in (BODY_FRD, dialect.MAV_FRAME_BODY_NED) or (
        child in AXES and frame in (NED, FRD))
    velocity, position_m = np.array([1.0, 2.0, 0.0]), np.array([5.0, 6.0, 7.0])
    for angles in product((-0.2, 0.0, 3.0), (-0.3, 0.4), (-2.0, 0.5)):
        raw = one(odometry(1.0, *position_m, wxyz(*angles), frame_id=frame, child_frame_id=child,
                           vx=velocity[0], vy=velocity[1], vz=velocity[2], yawspeed=0.1))
        sample = raw.sample
        expected = AXES[frame] @ rotation(*angles) @ (DOWN if body_is_down else np.eye(3))
        found = rotation(sample.roll_rad, sample.pitch_rad, sample.pose.yaw_rad)
        np.testing.assert_allclose(found, expected, atol=1e-6)
        np.testing.assert_allclose(
            (*sample.pose[:2], sample.z_m), AXES[frame] @ position_m, atol=1e-6)
        twist = raw.forward_m_s, raw.left_m_s, raw.yaw_rate_rad_s
        if child not in AXES:
            turned = velocity * (1, -1, -1) if body_is_down else velocity
            assert twist == pytest.approx((*turned[:2], -0.1 if body_is_down else 0.1))
        elif child == frame:
            heading = rotation(0.0, 0.0, -sample.pose.yaw_rad)
            assert twist[:2] == pytest.approx((heading @ AXES[frame] @ velocity)[:2])
        else:
            assert all(map(isnan, twist))  # how the two frames lie to each other is unknown


def rotation(roll, pitch, yaw):
    cr, sr, cp, sp, cy, sy = (f(angle) for angle in (roll, pitch, yaw) for f in (cos, sin))
    return (np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
            @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
            @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]]))


@pytest.mark.parametrize('fields, cause', [
    ({'frame_id': dialect.MAV_FRAME_GLOBAL}, 'odometry_in_unknown_frame'),
    ({'child_frame_id': dialect.MAV_FRAME_MISSION}, 'odometry_in_unknown_frame'),
    ({'frame_id': 200}, 'odometry_in_unknown_frame'),
    ({'quality': -1}, 'odometry_failed'),
    ({'x': nan}, 'odometry_malformed'), ({'z': inf}, 'odometry_malformed'),
    ({'q': (nan, 0.0, 0.0, 0.0)}, 'odometry_malformed'),
    ({'q': (0.0, 0.0, 0.0, 0.0)}, 'odometry_malformed')])
def test_what_gives_no_pose_is_refused_and_counted(fields, cause):
    link = Link()
    assert link.send(odometry(1.0, **fields)) == []
    assert link.counts == {cause: 1}


def test_a_quaternion_of_any_length_is_an_attitude():
    raw = one(odometry(1.0, q=[3e38 * value for value in wxyz(0.0, 0.0, 0.3)]))
    assert raw.sample.pose.yaw_rad == pytest.approx(pi / 2 - 0.3)


def test_a_velocity_that_is_not_there_takes_nothing_from_the_pose():
    raw = one(odometry(1.0, 1.0, vx=nan, vy=inf, yawspeed=nan))
    assert raw.sample.pose == pytest.approx((0.0, 1.0, pi / 2))
    assert all(map(isnan, (raw.forward_m_s, raw.left_m_s, raw.yaw_rate_rad_s)))


@pytest.mark.parametrize('covariance, sigma_m', [
    ([0.04] + [nan] * 5 + [0.05] + [nan] * 14, 0.3), (UNKNOWN, nan), ([nan] * 21, nan),
    ([-1.0] + [0.0] * 20, nan), ([inf] * 21, nan)])
def test_a_covariance_of_any_kind_is_survived_and_its_diagonal_told(covariance, sigma_m):
    link = Link()
    assert len(link.send(odometry(1.0, pose_covariance=covariance))) == 1
    assert link.assembler.position_sigma_m == pytest.approx(sigma_m, nan_ok=True)


def test_another_reset_counter_or_frame_is_another_segment_and_a_late_packet_begins_none():
    link = Link()
    first, reset, late, after, framed = (raw.sample.segment for raw in link.send(
        odometry(1.0), odometry(1.1, reset_counter=1), odometry(1.05),
        odometry(1.2, reset_counter=1), odometry(1.3, reset_counter=1, frame_id=FRD)))
    assert first == late != reset == after != framed


def test_a_reboot_is_another_segment():
    link = Link()
    before, = link.send(odometry(100.0))
    assert list(link.assembler.take(odometry(1.0), ARRIVAL_NS + 101_000_000_000)) == []
    after, = link.assembler.take(odometry(1.02), ARRIVAL_NS + 101_020_000_000)
    assert after.sample.segment != before.sample.segment
    assert after.sample.stamp_ns > before.sample.stamp_ns


def test_a_position_is_not_joined_with_an_attitude_from_before_a_reboot():
    link, later_ns = Link(), ARRIVAL_NS + 101_000_000_000
    link.send(attitude(100.0, yaw=1.0), position(100.1))
    made = [raw for message in (attitude(1.0), attitude(1.02), position(1.03), attitude(1.04))
            for raw in link.assembler.take(message, later_ns + message.time_boot_ms * 1_000_000)]
    assert [raw.sample.stamp_ns for raw in made] == [later_ns + 1_030_000_000]
    assert made[0].sample.pose.yaw_rad == pytest.approx(pi / 2)


def test_position_and_attitude_meet_at_the_time_of_the_position():
    joined, = Link().send(
        attitude(1.0, 0.0, 0.2, 0.1, 1.0), position(1.25, 1.0, 2.0, -3.0),
        attitude(1.5, 0.4, 0.0, 0.3, 3.0))
    sample = joined.sample
    assert sample.stamp_ns == ARRIVAL_NS + 1_250_000_000
    assert sample.pose == pytest.approx((2.0, 1.0, pi / 2 - 0.2))
    assert (sample.z_m, sample.roll_rad, sample.pitch_rad) == pytest.approx((3.0, 0.2, -0.1))
    assert joined.yaw_rate_rad_s == pytest.approx(-2.0)


def test_the_heading_turns_the_shorter_way_over_south():
    joined, = Link().send(attitude(1.0, yaw=pi - 0.1), position(1.1), attitude(1.2, yaw=-pi + 0.3))
    assert wrap_angle(pi / 2 - joined.sample.pose.yaw_rad) == pytest.approx(-pi + 0.1)


def test_a_velocity_in_ned_is_told_along_the_heading():
    joined, = Link().send(position(1.0, vx=1.0, vy=1.0), attitude(1.0, yaw=pi / 4))
    assert joined.forward_m_s == pytest.approx(sqrt(2.0))
    assert joined.left_m_s == pytest.approx(0.0, abs=1e-7)


def test_either_may_come_first_and_either_kind_of_attitude_serves():
    quaternion = dialect.MAVLink_attitude_quaternion_message(
        2000, *wxyz(0.0, 0.0, 0.5), 0.0, 0.0, 0.0)
    for messages in ((position(2.0), quaternion), (quaternion, position(2.0))):
        joined, = Link().send(*messages)
        assert joined.sample.pose.yaw_rad == pytest.approx(pi / 2 - 0.5)


def test_positions_with_covariance_serve_as_well():
    message = dialect.MAVLink_local_position_ned_cov_message(
        2_000_000, 0, 1.0, 2.0, 3.0, *[0.0] * 6, [nan] * 45)
    joined, = Link().send(attitude(2.0), message)
    assert joined.sample.pose == pytest.approx((2.0, 1.0, pi / 2))


@pytest.mark.parametrize('messages', [
    [attitude(1.0), position(2.0), attitude(3.0)],
    [position(1.0), attitude(1.1)],
    [position(1.0 + 0.02 * k) for k in range(65)]],
    ids=['attitudes far apart', 'none before it', 'none at all'])
def test_a_position_whose_attitude_nobody_knows_is_refused_and_counted(messages):
    link = Link()
    assert link.send(*messages) == []
    assert link.counts == {'positions_without_attitude': 1}


@pytest.mark.parametrize('message, cause', [
    (position(1.0, x=nan), 'odometry_malformed'), (attitude(1.0, yaw=inf), 'attitude_malformed'),
    (dialect.MAVLink_attitude_quaternion_message(1000, *[0.0] * 7), 'attitude_malformed')])
def test_positions_and_attitudes_that_are_none_are_refused_and_counted(message, cause):
    link = Link()
    link.send(attitude(0.9), message, attitude(1.1))
    assert link.counts == {cause: 1}


def test_a_late_attitude_disturbs_nothing():
    joined, = Link().send(
        attitude(1.0, yaw=0.1), attitude(1.2, yaw=0.3), attitude(1.1, yaw=3.0), position(1.1))
    assert joined.sample.pose.yaw_rad == pytest.approx(pi / 2 - 0.2)


def test_odometry_is_preferred_while_it_comes_and_its_parts_serve_when_it_stops():
    link = Link()
    assert len(link.send(attitude(0.9), odometry(1.0), position(1.1), attitude(1.2))) == 1
    joined, = link.send(attitude(2.9), position(3.0), attitude(3.1))
    first, = link.send(odometry(3.2))
    assert joined.sample.segment != first.sample.segment


def test_a_time_of_32_bits_that_wraps_does_not_disturb_odometry():
    link, wrap_s = Link(), 2 ** 32 / 1000
    made = []
    for k in range(-100, 100):
        time_s = wrap_s + 0.02 * k
        made += link.send(odometry(time_s))
        for late_s in (0.005, 0.01):
            part = attitude((time_s + late_s) % wrap_s)
            arrival_ns = ARRIVAL_NS + round((time_s + late_s) * 1e9)
            made += link.assembler.take(part, arrival_ns)
    assert len(made) == 200
    assert len({raw.sample.segment for raw in made}) == 1


def test_messages_of_other_kinds_give_nothing():
    link = Link()
    message = dialect.MAVLink_sys_status_message(*[0] * 13)
    assert list(link.assembler.take(message, ARRIVAL_NS)) == []
    assert link.counts == {}
