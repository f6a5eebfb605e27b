"""The ratslam node with an autopilot in place of a topic, over a real UDP link."""

from contextlib import contextmanager
from pathlib import Path
import socket
import subprocess
import sys
from threading import Thread
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import OdometrySample, Pose2, RawOdometry
from dlsc_qbs_ros.io.mavlink.autopilot import Autopilot
from dlsc_qbs_ros.io.mavlink.autopilot_messages import ENCODERS
from dlsc_qbs_ros.nodes.odometry_link import MAX_WAITING, OdometryLink
from geometry_msgs.msg import PoseWithCovarianceStamped
import pytest

PERIOD_NS = 20_000_000


class Flight:
    """A ratslam node on a link of its own, and an autopilot that flies when it is told to."""

    def __init__(self, start, observer, port):
        self.observer, self.port = observer, port
        self.poses = observer.collect(PoseWithCovarianceStamped, 'pose')
        self.reports = observer.collect(DiagnosticArray, '/diagnostics')
        self.process = start(
            'nodes.ratslam_node', '--ros-args', '-p', 'odometry.source:=mavlink',
            '-p', f'mavlink.connection:=udpin:127.0.0.1:{port}', '-p', 'mavlink.rate_hz:=50.0')

    def fly(self, n_poses):
        """Fly east at 1 m/s until so many poses more have come."""
        wanted = len(self.poses) + n_poses
        with autopilot(self.port):
            self.observer.spin_until(lambda: len(self.poses) >= wanted)

    def status(self, condition):
        """Return level and values of the next status whose message and values fulfil it."""
        self.reports.clear()
        found = []

        def look():
            for report in self.reports:
                for status in report.status:
                    values = {value.key: value.value for value in status.values}
                    if 'ratslam' in status.name and condition(status.message, values):
                        found.append((status.level, values))
            return found
        self.observer.spin_until(look)
        return found[0]


@contextmanager
def autopilot(port):
    def samples():
        k = 0
        while not landed:
            k += 1
            yield RawOdometry(OdometrySample(
                k * PERIOD_NS, Pose2(k * PERIOD_NS * 1e-9, 0.0, 0.0), 1.5), 1.0, 0.0, 0.0)

    def fly():
        with Autopilot(f'udpout:127.0.0.1:{port}', ENCODERS['odometry']) as pilot:
            pilot.fly(samples())
    landed = []
    thread = Thread(target=fly)
    thread.start()
    try:
        yield
    finally:
        landed.append(True)
        thread.join()


@pytest.fixture
def port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(('127.0.0.1', 0))
        return udp.getsockname()[1]


@pytest.fixture
def flight(start, observer, port):
    return Flight(start, observer, port)


def test_what_the_autopilot_flies_comes_out_as_poses_on_this_computers_clock(flight):
    flight.fly(30)
    now_s = time.time()
    stamps_s = [msg.header.stamp.sec + 1e-9 * msg.header.stamp.nanosec for msg in flight.poses]
    assert stamps_s == sorted(stamps_s)
    assert 0.0 < now_s - stamps_s[-1] < 5.0
    first, last = flight.poses[0].pose.pose.position, flight.poses[-1].pose.pose.position
    assert last.x - first.x == pytest.approx(stamps_s[-1] - stamps_s[0], abs=0.05)
    assert (last.y, last.z) == pytest.approx((0.0, 1.5), abs=1e-3)
    assert flight.process.stop() == 0


def test_the_state_of_the_link_is_told_and_a_reboot_is_counted_and_survived(flight):
    flight.status(
        lambda message, _: 'no odometry: no heartbeat of an autopilot' in message)
    flight.fly(15)
    level, values = flight.status(lambda message, _: 'no odometry: none for' in message)
    assert level == DiagnosticStatus.WARN
    assert values['mavlink_autopilot'] == '1/1'
    flight.fly(15)
    _, values = flight.status(lambda _, values: values.get('odometry_resets') == '1')
    assert values.keys() & {'mavlink_reboots', 'mavlink_time_jumps'}
    assert values['time_source'] in ('timesync', 'least delay of arrival')
    assert flight.process.stop() == 0


class StandingStill:
    """A node whose executor stands still until it is told to run."""

    def create_guard_condition(self, callback):
        self.run = callback
        return self

    def trigger(self):
        pass

    def destroy_guard_condition(self, guard):
        pass


def test_an_executor_that_stands_still_loses_what_exceeds_the_queue_and_counts_it(port):
    node, delivered = StandingStill(), []
    source = OdometryLink(node, Config().override(
        {'mavlink.connection': f'udpout:127.0.0.1:{port}'}))
    source.start(delivered.append)
    for k in range(MAX_WAITING + 5):
        source._enqueue(RawOdometry(
            OdometrySample(k * PERIOD_NS, Pose2(0.0, 0.0, 0.0)), 0.0, 0.0, 0.0))
    assert delivered == []
    node.run()
    assert [sample.stamp_ns for sample in delivered] == [
        k * PERIOD_NS for k in range(MAX_WAITING)]
    assert source.diagnostics() == {'odometry_accepted': MAX_WAITING, 'odometry_lost': 5}
    source.stop()


def test_without_pymavlink_a_link_is_refused_in_words():
    code = """if True:
        import sys
        sys.modules['pymavlink'] = None
        from dlsc_qbs_ros.config import Config
        from dlsc_qbs_ros.nodes.odometry_source import create_odometry_source
        create_odometry_source(None, Config().override({'odometry.source': 'mavlink'}))"""
    process = subprocess.run([sys.executable, '-c', code], cwd=Path(__file__).parents[2],
                             capture_output=True, text=True, timeout=60)
    assert process.returncode == 1
    assert process.stderr.splitlines()[-1] == (
        "dlsc_qbs_ros.errors.ConfigError: odometry.source = 'mavlink': needs pymavlink, which is "
        'not installed')


@pytest.mark.parametrize('parameter, said', [
    ('mavlink.connection:=telepathy', "mavlink.connection = 'telepathy': expected udpin:HOST"),
    ('mavlink.key_file:=gone', "mavlink.key_file = 'gone': No such file")])
def test_a_link_that_cannot_be_is_one_line_and_exit_code_1(start, parameter, said):
    process = start('nodes.ratslam_node', '--ros-args', '-p', 'odometry.source:=mavlink',
                    '-p', parameter)
    assert process.wait() == 1
    assert said in process.text()
    assert 'Traceback' not in process.text()
