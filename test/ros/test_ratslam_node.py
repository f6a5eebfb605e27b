"""The ratslam node, as a process: what it refuses, what it says of itself, what it survives."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import Code, Frame, OdometrySample, Pose2, View
from dlsc_qbs_ros.pipeline.encoder import Encoder
from dlsc_qbs_ros.ros.conversions import (
    code_to_msg, dictionary_to_msg, odometry_to_msg, view_to_msg)
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy
from sensor_msgs.msg import Image

START_NS = 1_600_000_000_000_000_000
PERIOD_NS = 100_000_000


class Graph:
    """A ratslam node fed by hand."""

    def __init__(self, start, observer, *ros_args):
        self.observer = observer
        self.poses = observer.collect(PoseWithCovarianceStamped, 'pose')
        self.reports = observer.collect(DiagnosticArray, '/diagnostics')
        self.publishers = {
            'odom': observer.advertise(Odometry, 'odom'),
            'code': observer.advertise(Image, 'code'),
            'view': observer.advertise(Image, 'view'),
            'dictionary': observer.advertise(
                Image, 'dictionary', durability=DurabilityPolicy.TRANSIENT_LOCAL)}
        self.process = start('nodes.ratslam_node', '--ros-args', *ros_args)
        observer.spin_until(lambda: self.reports and all(
            publisher.get_subscription_count() for publisher in self.publishers.values()))

    def send(self, topic, msg):
        self.publishers[topic].publish(msg)

    def fly(self, k, encoder, spoil=lambda code: code):
        """Send the k-th frame's dictionary, view and code, and odometry at its stamp."""
        stamp_ns = START_NS + k * PERIOD_NS
        grey = np.random.default_rng(k).integers(0, 256, (32, 43), dtype=np.uint8)
        encoded = encoder.process(Frame(stamp_ns, grey))
        if encoded.dictionary is not None:
            self.send('dictionary', dictionary_to_msg(encoded.dictionary))
        self.send('view', view_to_msg(encoded.view))
        self.send('code', code_to_msg(spoil(encoded.code)))
        self.send('odom', odometry(k))

    def status(self, condition):
        """Return the first status for which the condition on its counts holds."""
        found = []

        def look():
            for report in self.reports:
                status = report.status[0]
                if condition({value.key: value.value for value in status.values}):
                    found.append(status)
            return found
        self.observer.spin_until(look)
        return found[0]


def odometry(k):
    sample = OdometrySample(START_NS + k * PERIOD_NS, Pose2(0.1 * k, 0.0, 0.0), z_m=1.5)
    return odometry_to_msg(sample, 1.0, 0.0, 'odom', 'base_link')


def not_finite(msg):
    msg.pose.pose.position.x = float('nan')
    return msg


def without_length(msg):
    msg.pose.pose.orientation.w = 0.0
    return msg


@pytest.fixture
def graph(start, observer):
    return Graph(start, observer)


def test_every_odometry_sample_has_its_pose_and_what_is_not_planar_passes_through(graph):
    encoder = Encoder(Config())
    for k in range(20):
        graph.fly(k, encoder)
    graph.observer.spin_until(lambda: len(graph.poses) == 20)
    assert graph.poses[0].header.frame_id == 'map'
    for k, msg in enumerate(graph.poses):
        position = msg.pose.pose.position
        assert (position.x, position.z) == pytest.approx((0.1 * k, 1.5), abs=1e-9)
        assert msg.pose.covariance[0] >= 0.0
    assert graph.process.stop() == 0


@pytest.mark.parametrize('spoil', [not_finite, without_length])
def test_odometry_without_a_pose_is_refused_counted_and_survived(graph, spoil):
    for msg in (odometry(0), spoil(odometry(1)), odometry(2)):
        graph.send('odom', msg)
    graph.observer.spin_until(lambda: len(graph.poses) == 2)
    status = graph.status(lambda values: values.get('odometry_malformed') == '1')
    assert status.level == DiagnosticStatus.WARN
    assert 'odometry malformed' in status.message
    assert 'odometry refused' in graph.process.text()
    assert graph.process.stop() == 0


def test_odometry_that_goes_backwards_is_refused_and_counted(graph):
    for k in (5, 4, 5, 6):
        graph.send('odom', odometry(k))
    graph.observer.spin_until(lambda: len(graph.poses) == 2)
    graph.status(lambda values: values.get('odometry_out_of_order') == '2')


@pytest.mark.parametrize('topic, msg, counted', [
    ('code', Image(encoding='mono8', width=4, height=1, step=4, data=[0] * 4), 'code_malformed'),
    ('view', Image(encoding='32FC1', width=1, height=1, step=4, data=[0] * 4), 'view_malformed'),
    ('dictionary', Image(encoding='32FC1', width=1, height=1, step=4, data=[0] * 4),
     'dictionary_malformed'),
    ('code', code_to_msg(Code(START_NS, np.ones(7, np.float32), None)),
     'codes_of_another_length'),
    ('view', view_to_msg(View(START_NS, np.zeros((5, 5), np.uint8))), 'views_of_another_shape'),
])
def test_what_does_not_fit_is_refused_counted_and_survived(graph, topic, msg, counted):
    graph.send(topic, msg)
    graph.status(lambda values: values.get(counted) == '1')
    assert graph.process.stop() == 0


def test_codes_of_an_encoder_configured_otherwise_are_an_error_in_diagnostics(graph):
    encoder = Encoder(Config())
    graph.fly(0, encoder, lambda code: Code(code.stamp_ns, 2 * code.values, code.dictionary_ns))
    status = graph.status(lambda values: values.get('code_mismatches') == '1')
    assert status.level == DiagnosticStatus.ERROR
    assert 'configured' in status.message


def test_silence_is_said_in_plain_words(graph):
    status = graph.status(lambda values: True)
    assert status.level == DiagnosticStatus.WARN
    assert status.message == 'no odometry, no codes'


def test_poses_flow_on_when_the_encoder_has_died(graph):
    graph.fly(0, Encoder(Config()))
    for k in range(1, 30):
        graph.send('odom', odometry(k))
    graph.observer.spin_until(lambda: len(graph.poses) == 30)


@pytest.mark.parametrize('key, value, said', [
    ('ratslam.treshold', '0.9', "unknown parameter 'ratslam.treshold'"),
    ('ratslam.threshold', '1.5', r'ratslam.threshold = 1.5: expected a value in [-1.0, 1.0]'),
    ('odometry.source', 'sonar', "odometry.source = 'sonar': expected one of nav_msgs"),
])
def test_a_bad_parameter_is_one_line_and_exit_code_1(start, key, value, said):
    process = start('nodes.ratslam_node', '--ros-args', '-p', f'{key}:={value}')
    assert process.wait() == 1
    assert said in process.text()
    assert 'Traceback' not in process.text()


def test_the_report_has_its_figures_from_the_start_and_tells_rate_and_latency(graph):
    status = graph.status(lambda values: True)
    assert {value.key for value in status.values} >= {
        'odometry_accepted', 'codes_received', 'codes_used', 'dictionaries', 'code_books', 'poses',
        'pose_rate_hz', 'latency_ms', 'experiences', 'links', 'closures'}
    for k in range(10):
        graph.send('odom', odometry(k))
    values = {value.key: float(value.value)
              for value in graph.status(lambda values: values['poses'] == '10').values}
    assert values['latency_ms'] >= 0.0
    assert any(float(value.value) > 0 for report in graph.reports
               for value in report.status[0].values if value.key == 'pose_rate_hz')
