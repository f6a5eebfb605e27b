"""A flight over a real link: images on a topic, odometry from an autopilot, poses back to it."""

from pathlib import Path
import socket
import threading
import time

from dlsc_qbs_ros.cli.simulate import main as simulate
from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.errors import ConfigError
from dlsc_qbs_ros.io.mavlink.autopilot import Autopilot
from dlsc_qbs_ros.io.mavlink.autopilot_messages import ENCODERS
from dlsc_qbs_ros.nodes.odometry_source import create_vision_output
from dlsc_qbs_ros.ros.stamps import stamp_to_ns
from dlsc_qbs_ros.sim.simulation import simulate_flight
from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
import pytest

PROFILE = Path(__file__).parents[2] / 'config' / 'replay.yaml'
SECONDS = 3
PERIOD_NS = 20_000_000


@pytest.fixture
def port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(('127.0.0.1', 0))
        return probe.getsockname()[1]


def test_a_drone_flies_with_nothing_but_a_camera_and_a_link(start, observer, tmp_path, port):
    flight = tmp_path / 'flight'
    assert simulate(['--flight', '1', '--seconds', str(SECONDS), '--encoding', 'mono8',
                     '--out', str(flight)]) == 0
    odometry = simulate_flight(1, 0, SECONDS).odometry
    poses = observer.collect(PoseWithCovarianceStamped, 'pose')
    nodes = [
        start('nodes.encoder_node', '--ros-args', '--params-file', PROFILE,
              '-r', 'image:=/camera/image_raw'),
        start('nodes.ratslam_node', '--ros-args', '--params-file', PROFILE,
              '-p', 'odometry.source:=mavlink', '-p', 'odometry.yaw_bias_rad_s:=0.0',
              '-p', 'mavlink.rate_hz:=50.0',
              '-p', f'mavlink.connection:=udpin:127.0.0.1:{port}',
              '-p', 'mavlink.vision_output:=true', '-p', 'ratslam.max_wait_s:=2.0')]
    observer.spin_until(lambda: observer.node.count_subscribers('/code')
                        and observer.node.count_subscribers('/camera/image_raw'))
    start_ns = time.time_ns() + 3_000_000_000
    with Autopilot(f'udpout:127.0.0.1:{port}', ENCODERS['odometry']) as autopilot:
        pilot = threading.Thread(target=autopilot.fly, args=(odometry, start_ns), daemon=True)
        pilot.start()
        replay = start('cli.replay', flight, '--start-at', start_ns / 1e9,
                       '--topics', '/camera/image_raw')
        observer.spin_until(lambda: not pilot.is_alive() and not replay.is_running())
        sent, received = dict(autopilot.sent), dict(autopilot.received)
    assert sent['ODOMETRY'] == len(odometry)
    observer.spin_until(lambda: len(poses) == len(odometry))
    assert [node.stop() for node in reversed(nodes)] == [0, 0]
    # On so short a flight nothing is met again, and no error of the yaw rate is taken out: the
    # pose is that of the odometry, at its time.
    flown = np.array([(*raw.sample.pose[:2], raw.sample.z_m) for raw in odometry])
    given = np.array([(msg.pose.pose.position.x, msg.pose.pose.position.y,
                       msg.pose.pose.position.z) for msg in poses])
    np.testing.assert_allclose(given, flown, rtol=0, atol=1e-4)
    stamps_ns = np.array([stamp_to_ns(msg.header.stamp) for msg in poses])
    due_ns = start_ns + PERIOD_NS * np.arange(len(odometry))
    np.testing.assert_allclose(stamps_ns - due_ns, 0, rtol=0, atol=20e6)
    assert received['ODOMETRY'] > 4 * (SECONDS - 1)


def test_poses_go_back_only_where_they_are_to_and_there_is_a_link():
    assert create_vision_output(None, Config()) is None
    with pytest.raises(ConfigError, match="odometry.source = 'nav_msgs' has no link"):
        create_vision_output(None, Config().override({'mavlink.vision_output': True}))
