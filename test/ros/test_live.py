"""The live graph: three processes give what the pipeline gives, at any speed, and end well."""

from contextlib import suppress
from math import inf
from pathlib import Path
import signal

from diagnostic_msgs.msg import DiagnosticArray
from dlsc_qbs_ros.cli.simulate import main as simulate
from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import (
    Code, Dictionary, GroundTruthSample, OdometrySample, View)
from dlsc_qbs_ros.io.flight import read_flight
from dlsc_qbs_ros.io.recordings.bag import read_bag
from dlsc_qbs_ros.pipeline.ratslam import RatSlam
from dlsc_qbs_ros.pipeline.runner import encode, map_codes
from dlsc_qbs_ros.ros.serialization import deserialize
from dlsc_qbs_ros.ros.stamps import stamp_to_ns
from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy
from visualization_msgs.msg import MarkerArray

PROFILE = Path(__file__).parents[2] / 'config' / 'replay.yaml'
SECONDS = 45


@pytest.fixture(scope='module')
def flight(tmp_path_factory):
    """Give a short simulated flight between the shelves, a lap and a third."""
    path = tmp_path_factory.mktemp('flight') / 'flight'
    assert simulate(['--flight', '2', '--seed', '0', '--seconds', str(SECONDS),
                     '--encoding', 'mono8', '--out', str(path)]) == 0
    return path


@pytest.fixture(scope='module')
def encoded(flight):
    return encode((event for event in read_flight(flight)
                   if not isinstance(event, GroundTruthSample)), Config())


@pytest.fixture(scope='module')
def expected_poses(encoded):
    """Give stamp -> (x, y, z) of every pose that the pipeline gives."""
    ratslam = RatSlam(Config())
    add = {OdometrySample: ratslam.add_odometry, Dictionary: ratslam.add_dictionary,
           View: ratslam.add_view, Code: ratslam.add_code}
    poses = []
    for event in encoded.events:
        add[type(event)](event)
        poses += ratslam.advance(0.0)
    poses += ratslam.advance(inf)
    return {e.stamp_ns: (e.pose.x_m, e.pose.y_m, e.odometry.z_m) for e in poses}


class Graph:
    """Encoder, ratslam and recorder as processes, and what they recorded."""

    TOPICS = ('/pose', '/path', '/experience_map', '/code', '/view')

    def __init__(self, start, observer, recording, recorded=TOPICS):
        ros_args = ['--ros-args', '--params-file', PROFILE]
        self.recording = recording
        self.nodes = [
            start('nodes.encoder_node', *ros_args, '-r', 'image:=/camera/image_raw'),
            start('nodes.ratslam_node', *ros_args, '-r', 'odom:=/odom'),
            start('nodes.recorder_node', *ros_args, '-p', f'recorder.output:={recording}',
                  '-p', f'recorder.topics:=[{", ".join(recorded)}]')]
        awaited = {'/code', '/view', *recorded}
        observer.spin_until(lambda: all(map(observer.node.count_subscribers, awaited)))

    def play(self, start, flight, rate):
        assert start('cli.replay', flight, '--rate', rate,
                     '--topics', '/camera/image_raw', '/odom').wait(4 * SECONDS) == 0

    def stop(self):
        """End the mapper first, so that what it says last is recorded too."""
        encoder, ratslam, recorder = self.nodes
        return [node.stop() for node in (ratslam, encoder, recorder)]

    def recorded(self, topic):
        return [deserialize(message.data, message.type_name)
                for message in read_bag(self.recording, [topic])]

    def poses(self):
        """Return stamp -> (x, y, z); the stamps must rise."""
        poses = {}
        for msg in self.recorded('/pose'):
            position = msg.pose.pose.position
            stamp_ns = stamp_to_ns(msg.header.stamp)
            assert not poses or stamp_ns > next(reversed(poses))
            poses[stamp_ns] = (position.x, position.y, position.z)
        return poses


def xy(points):
    return np.array([(point.x, point.y) for point in points]).reshape(-1, 2)


@pytest.mark.parametrize('rate', ['1', '5', 'max'])
def test_the_live_graph_gives_what_the_pipeline_gives_at_any_rate(
        start, observer, tmp_path, flight, encoded, expected_poses, rate):
    graph = Graph(start, observer, tmp_path / 'recording')
    graph.play(start, flight, rate)
    assert graph.stop() == [0, 0, 0]
    path, experience_map = (graph.recorded(topic)[-1] for topic in ('/path', '/experience_map'))

    result = map_codes(encoded, Config())
    assert result.counts['closures'] > 0
    experiences, links, closures = (xy(marker.points) for marker in experience_map.markers)
    np.testing.assert_array_equal(experiences, result.experiences[:, :2])
    np.testing.assert_array_equal(links, result.experiences[result.links.ravel(), :2])
    np.testing.assert_array_equal(closures, result.experiences[result.closures.ravel(), :2])
    np.testing.assert_array_equal(
        xy(pose.pose.position for pose in path.poses), result.experiences[:, :2])

    poses = graph.poses()
    assert poses.keys() == expected_poses.keys()
    np.testing.assert_allclose(
        list(poses.values()), [expected_poses[stamp] for stamp in poses], rtol=0, atol=1e-6)


def test_a_recorder_that_stands_still_is_sent_what_it_missed(
        start, observer, tmp_path, flight, expected_poses):
    graph = Graph(start, observer, tmp_path / 'recording', ['/pose'])
    recorder = graph.nodes[-1]
    poses = observer.collect(PoseWithCovarianceStamped, 'pose')
    reports = observer.collect(DiagnosticArray, '/diagnostics')
    replay = start('cli.replay', flight, '--rate', 'max')
    observer.spin_until(lambda: len(poses) > 100)
    recorder.send(signal.SIGSTOP)
    observer.spin_until(lambda: len(poses) > 700)
    recorder.send(signal.SIGCONT)
    observer.spin_until(lambda: not replay.is_running())
    observer.spin_until(lambda: n_recorded(reports) >= len(poses))
    assert graph.stop() == [0, 0, 0]
    assert graph.poses().keys() == expected_poses.keys()


def n_recorded(reports):
    """Return the number of messages that the recorder last said it had."""
    return max((int(value.value) for report in reports for status in report.status
                if status.name == '/recorder'
                for value in status.values if value.key == 'messages'), default=0)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_each_node_ends_within_two_seconds_in_mid_flight(start, tmp_path, flight, observer,
                                                         number):
    graph = Graph(start, observer, tmp_path / 'recording')
    poses = observer.collect(PoseWithCovarianceStamped, 'pose')
    start('cli.replay', flight)
    observer.spin_until(lambda: len(poses) > 20)
    for node in graph.nodes:
        assert node.stop(number) == 0, node.text()
        assert 'Traceback' not in node.text()
    with suppress(StopIteration):
        next(read_bag(graph.recording))  # a file that was closed is read without complaint


def test_a_late_subscriber_has_the_map(start, tmp_path, flight, observer):
    graph = Graph(start, observer, tmp_path / 'recording')
    graph.play(start, flight, 'max')
    maps = observer.collect(MarkerArray, 'experience_map', depth=1,
                            durability=DurabilityPolicy.TRANSIENT_LOCAL)
    observer.spin_until(lambda: maps)
    assert len(maps[-1].markers[0].points) > 50
