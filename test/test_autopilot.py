"""A simulated autopilot sends what it was asked for, in its own time, and answers like one."""

from contextlib import contextmanager
from math import pi
import socket
import threading
import time

from dlsc_qbs_ros.cli.simulate import main as simulate
from dlsc_qbs_ros.config import MavlinkConfig
from dlsc_qbs_ros.core.types import OdometrySample, Pose2, RawOdometry
from dlsc_qbs_ros.errors import ConfigError
from dlsc_qbs_ros.io.mavlink.autopilot import Autopilot
from dlsc_qbs_ros.io.mavlink.autopilot_messages import ENCODERS
from dlsc_qbs_ros.io.mavlink.framing import dialect
from dlsc_qbs_ros.io.mavlink.link import MavlinkLink
from dlsc_qbs_ros.sim.simulation import simulate_flight
from mavlink_peer import free_port, wait_until
import pytest

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 5_000_000


def flight(n=40):
    """Give n samples at 200 Hz, one metre after the other."""
    return [RawOdometry(OdometrySample(START_NS + k * PERIOD_NS, Pose2(float(k), 0.0, 0.0)),
                        1.0, 0.0, 0.0) for k in range(n)]


class Companion:
    """The other end of the link."""

    def __init__(self):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(('127.0.0.1', 0))
        self._mavlink = dialect.MAVLink(self, 1, dialect.MAV_COMP_ID_ONBOARD_COMPUTER)
        self.address = 'udpout:127.0.0.1:%d' % self._socket.getsockname()[1]
        self.close = self._socket.close

    def write(self, data):
        self._socket.sendto(data, self._peer)

    def send(self, message):
        self._mavlink.send(message)

    def ask(self, name, rate_hz, system=1):
        interval_us = 1e6 / rate_hz if rate_hz else -1.0
        self.send(dialect.MAVLink_command_long_message(
            system, 1, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0,
            getattr(dialect, f'MAVLINK_MSG_ID_{name}'), interval_us, 0, 0, 0, 0, 0))

    def ask_for_stream(self, stream, rate_hz):
        self.send(dialect.MAVLink_request_data_stream_message(1, 1, stream, rate_hz, 1))

    def receive(self, timeout_s=10.0):
        """Return the next message; every datagram holds one."""
        self._socket.settimeout(timeout_s)
        data, self._peer = self._socket.recvfrom(1000)
        return self._mavlink.decode(bytearray(data))

    def received(self):
        """Return the names of the messages that are there, and the messages by name."""
        messages = {}
        try:
            while True:
                message = self.receive(0.0)
                messages.setdefault(message.get_type(), []).append(message)
        except BlockingIOError:
            return messages


@pytest.fixture
def companion():
    companion = Companion()
    yield companion
    companion.close()


@contextmanager
def autopilot(companion, messages='odometry'):
    """Give an autopilot that has introduced itself."""
    with Autopilot(companion.address, ENCODERS[messages]) as autopilot:
        autopilot.serve_until(0)
        assert companion.receive().get_type() == 'HEARTBEAT'
        yield autopilot


def test_it_introduces_itself_and_sends_nothing_that_was_not_asked_for(companion):
    with Autopilot(companion.address, ENCODERS['odometry']) as autopilot:
        autopilot.fly(flight())
    heartbeat, = companion.received().pop('HEARTBEAT')
    assert (heartbeat.get_srcSystem(), heartbeat.get_srcComponent()) == (1, 1)
    assert heartbeat.type == dialect.MAV_TYPE_QUADROTOR
    assert companion.received() == {}


def test_each_message_comes_at_the_rate_that_it_was_asked_for(companion):
    with autopilot(companion, 'position') as pilot:
        companion.ask('LOCAL_POSITION_NED', 50)
        companion.ask('ATTITUDE', 200)
        pilot.serve_until(0)
        pilot.fly(flight(40))
    messages = companion.received()
    assert len(messages['ATTITUDE']) == 40
    stamps_ms = [message.time_boot_ms for message in messages['LOCAL_POSITION_NED']]
    assert {b - a for a, b in zip(stamps_ms, stamps_ms[1:])} == {20} and len(stamps_ms) == 10


def test_an_interval_that_is_no_divisor_is_kept_in_the_mean(companion):
    with autopilot(companion) as pilot:
        companion.ask('ODOMETRY', 30)
        pilot.serve_until(0)
        pilot.fly(flight(121))
    stamps_us = [message.time_usec for message in companion.received()['ODOMETRY']]
    assert stamps_us[-1] - stamps_us[0] == pytest.approx((len(stamps_us) - 1) * 1e6 / 30, abs=5e3)


def test_a_stream_can_be_stopped(companion):
    with autopilot(companion) as pilot:
        companion.ask('ODOMETRY', 200)
        companion.ask('ODOMETRY', 0)
        pilot.serve_until(0)
        pilot.fly(flight(5))
    messages = companion.received()
    assert [ack.result for ack in messages['COMMAND_ACK']] == [dialect.MAV_RESULT_ACCEPTED] * 2
    assert 'ODOMETRY' not in messages


def test_the_old_request_for_a_stream_is_honoured(companion):
    with autopilot(companion, 'position') as pilot:
        companion.ask_for_stream(dialect.MAV_DATA_STREAM_POSITION, 200)
        companion.ask_for_stream(dialect.MAV_DATA_STREAM_EXTRA1, 100)
        companion.ask_for_stream(dialect.MAV_DATA_STREAM_RC_CHANNELS, 100)
        pilot.serve_until(0)
        pilot.fly(flight(20))
    messages = companion.received()
    assert {name: len(those) for name, those in messages.items()} == {
        'LOCAL_POSITION_NED': 20, 'ATTITUDE': 10}


@pytest.mark.parametrize('name, system, results', [
    ('LOCAL_POSITION_NED', 1, [dialect.MAV_RESULT_DENIED]), ('ODOMETRY', 2, [])])
def test_what_it_has_not_is_denied_and_what_is_for_others_ignored(
        companion, name, system, results):
    with autopilot(companion) as pilot:
        companion.ask(name, 10, system)
        pilot.serve_until(0)
    assert [ack.result for ack in companion.received().get('COMMAND_ACK', [])] == results


def test_what_it_does_not_know_is_ignored(companion):
    with autopilot(companion) as pilot:
        companion.write(bytes.fromhex('fd 00 00 00 00 01 bf ff ff ff 00 00'))
        pilot.serve_until(0)
    assert not pilot.received and not companion.received()


def test_other_commands_are_not_supported(companion):
    with autopilot(companion) as pilot:
        companion.send(dialect.MAVLink_command_long_message(
            1, 1, dialect.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 0))
        pilot.serve_until(0)
    ack, = companion.received()['COMMAND_ACK']
    assert (ack.command, ack.result) == (
        dialect.MAV_CMD_NAV_TAKEOFF, dialect.MAV_RESULT_UNSUPPORTED)


def test_it_tells_its_time_since_boot_to_whoever_asks(companion):
    with autopilot(companion) as pilot:
        companion.send(dialect.MAVLink_timesync_message(0, 1234))
        companion.send(dialect.MAVLink_timesync_message(99, 1234))  # an answer, not for it
        before_ns = pilot.time_ns
        pilot.serve_until(0)
        answer, = companion.received()['TIMESYNC']
        assert answer.ts1 == 1234
        assert before_ns <= answer.tc1 <= pilot.time_ns


def test_samples_are_stamped_with_when_they_are_due_from_the_start_on(companion):
    with autopilot(companion) as pilot:
        companion.ask('ODOMETRY', 200)
        pilot.serve_until(0)
        boot_ns = time.time_ns() - pilot.time_ns
        start_ns = time.time_ns() + 50_000_000
        pilot.fly(flight(3), start_ns)
    stamps_us = [message.time_usec for message in companion.received()['ODOMETRY']]
    assert [b - a for a, b in zip(stamps_us, stamps_us[1:])] == [5000, 5000]
    assert stamps_us[0] == pytest.approx((start_ns - boot_ns) * 1e-3, abs=2000)


# Facing east and climbing 3 m in ENU; the same in NED, where yaw turns from north to the right
# and pitch upwards is positive.
EAST = RawOdometry(OdometrySample(0, Pose2(1.0, 2.0, 0.0), 3.0, 0.1, -0.2), 4.0, 0.5, 0.25)


def test_a_pose_and_a_twist_as_local_position_and_attitude():
    encoders = ENCODERS['position']
    position = encoders['LOCAL_POSITION_NED'](EAST, 5_000_000)
    assert (position.time_boot_ms, position.x, position.y, position.z) == (5, 2.0, 1.0, -3.0)
    assert (position.vx, position.vy) == pytest.approx((0.5, 4.0))
    attitude = encoders['ATTITUDE'](EAST, 5_000_000)
    assert (attitude.roll, attitude.pitch, attitude.yaw) == pytest.approx((0.1, 0.2, pi / 2))
    assert attitude.yawspeed == -0.25


@pytest.mark.parametrize('kind, name', [
    ('odometry', 'ODOMETRY'), ('position', 'ATTITUDE_QUATERNION')])
def test_a_heading_as_quaternion_with_w_first(kind, name):
    level = RawOdometry(OdometrySample(0, Pose2(0.0, 0.0, 0.0)), 0.0, 0.0, 0.0)
    message = ENCODERS[kind][name](level, 0)
    quaternion = message.q if kind == 'odometry' else [
        message.q1, message.q2, message.q3, message.q4]
    assert quaternion == pytest.approx([0.5 ** 0.5, 0.0, 0.0, 0.5 ** 0.5])


def test_odometry_has_its_frames_and_the_twist_of_the_body():
    message = ENCODERS['odometry']['ODOMETRY'](EAST, 7_000)
    assert (message.frame_id, message.child_frame_id) == (
        dialect.MAV_FRAME_LOCAL_NED, dialect.MAV_FRAME_BODY_FRD)
    assert (message.time_usec, message.x, message.y, message.z) == (7, 2.0, 1.0, -3.0)
    assert (message.vx, message.vy, message.yawspeed) == (4.0, -0.5, -0.25)


def test_an_address_that_is_none_is_refused():
    with pytest.raises(ConfigError, match="'udp:here': expected udpin:HOST:PORT"):
        Autopilot('udp:here', {})


@pytest.mark.parametrize('messages', ['odometry', 'position'])
def test_what_it_flies_is_what_a_companion_of_ours_gets(messages):
    flown = simulate_flight(1, 0, 1.0).odometry
    port = free_port()
    link = MavlinkLink(MavlinkConfig(connection=f'udpin:127.0.0.1:{port}', rate_hz=50.0))
    got = []
    link.start(got.append)
    with Autopilot(f'udpout:127.0.0.1:{port}', ENCODERS[messages]) as pilot:
        while not pilot.received['COMMAND_LONG']:  # asked for what is there, and for what is not
            pilot.serve_until(pilot.time_ns + 100_000_000)
        pilot.fly(flown, time.time_ns() + 200_000_000)
        sent = pilot.sent['ODOMETRY' if messages == 'odometry' else 'LOCAL_POSITION_NED']
    wait_until(lambda: len(got) >= sent - 1)
    link.stop()
    first = len(flown) - sent
    for raw, there in zip(got, flown[first:]):
        a, b = raw.sample, there.sample
        assert (*a.pose, a.z_m, a.roll_rad, a.pitch_rad) == pytest.approx(
            (*b.pose, b.z_m, b.roll_rad, b.pitch_rad), abs=1e-5)
        assert (raw.forward_m_s, raw.left_m_s, raw.yaw_rate_rad_s) == pytest.approx(
            (there.forward_m_s, there.left_m_s, there.yaw_rate_rad_s), abs=1e-5)
    assert sent >= 25


def test_simulate_flies_a_flight_over_the_link(companion, capsys):
    pilot = threading.Thread(target=simulate, args=([
        '--flight', '1', '--seconds', '1', '--mavlink', companion.address],))
    pilot.start()
    assert companion.receive().get_type() == 'HEARTBEAT'
    companion.ask('ODOMETRY', 50)
    pilot.join(10.0)
    assert not pilot.is_alive()
    assert 40 <= len(companion.received()['ODOMETRY']) <= 51
    assert 'received: 1 COMMAND_LONG' in capsys.readouterr().out


def test_a_flight_is_recorded_or_flown_and_not_both(capsys):
    with pytest.raises(SystemExit):
        simulate(['--flight', '1', '--out', 'flight', '--mavlink', 'udpout:127.0.0.1:1'])
    assert 'not allowed with argument' in capsys.readouterr().err
