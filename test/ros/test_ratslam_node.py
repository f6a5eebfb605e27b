"""The ratslam node, as a process: what it refuses, what it says of itself, what it survives."""

from dataclasses import replace
import os

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.geometry import compose, quaternion_to_euler
from dlsc_qbs_ros.core.types import Code, Frame, OdometrySample, Pose2, View
from dlsc_qbs_ros.pipeline.encoder import Encoder
from dlsc_qbs_ros.ros.conversions import (
    code_to_msg, dictionary_to_msg, odometry_to_msg, view_to_msg)
from dlsc_qbs_ros.ros.stamps import stamp_to_ns
from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion, TransformStamped
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
        observer.spin_until(lambda: self.reports)
        self.wait_for_subscriptions()

    def wait_for_subscriptions(self):
        self.observer.spin_until(lambda: all(
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
    return odometry_to_msg(sample(k), 1.0, 0.0, 'odom', 'base_link')


def sample(k):
    return OdometrySample(START_NS + k * PERIOD_NS, Pose2(0.1 * k, 0.0, 0.3), z_m=1.5,
                          roll_rad=0.1, pitch_rad=-0.2)


def not_finite(msg):
    msg.pose.pose.position.x = float('nan')
    return msg


def without_length(msg):
    msg.pose.pose.orientation = Quaternion(x=0.0, y=0.0, z=0.0, w=0.0)
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
        assert stamp_to_ns(msg.header.stamp) == sample(k).stamp_ns
        position, q = msg.pose.pose.position, msg.pose.pose.orientation
        assert (position.x, position.z) == pytest.approx((0.1 * k, 1.5), abs=1e-9)
        assert quaternion_to_euler(q.x, q.y, q.z, q.w) == pytest.approx((0.1, -0.2, 0.3))
        assert msg.pose.covariance[0] >= 0.0
    assert graph.process.stop() == 0


@pytest.fixture
def transforms(observer, tmp_path, monkeypatch):
    """Give what goes out on /tf, by its stamp: the one transform of each message."""
    # tf2_msgs is not in every installation; what stands in for it is a transform by itself.
    package = tmp_path / 'tf2_msgs'
    package.mkdir()
    (package / '__init__.py').touch()
    (package / 'msg.py').write_text(
        'from geometry_msgs.msg import TransformStamped\n'
        'class TFMessage(TransformStamped):\n'
        '    def __init__(self, transforms):\n'
        '        sent, = transforms\n'
        '        super().__init__(header=sent.header, child_frame_id=sent.child_frame_id,\n'
        '                         transform=sent.transform)\n'
        'TFMessage.__name__ = "TransformStamped"\n'
        'TFMessage.__module__ = TransformStamped.__module__\n')
    monkeypatch.setenv('PYTHONPATH', str(tmp_path), prepend=os.pathsep)
    return observer.collect(TransformStamped, '/tf')


def planar(transform):
    """Return a transform of the plane; that it is one is checked."""
    q, t = transform.rotation, transform.translation
    roll, pitch, yaw = quaternion_to_euler(q.x, q.y, q.z, q.w)
    assert (roll, pitch, t.z) == (0.0, 0.0, 0.0)
    return Pose2(t.x, t.y, yaw)


def test_the_transform_of_a_stamp_takes_odometry_to_the_pose(transforms, graph):
    observer, encoder = graph.observer, Encoder(Config())
    for k in range(10):
        graph.fly(k, encoder)
    moved = odometry_to_msg(replace(sample(10), pose=Pose2(70.0, 3.0, -1.0)), 1.0, 0.0, 'odom', '')
    graph.send('odom', moved)  # the estimator jumped; the pose does not
    observer.spin_until(lambda: len(graph.poses) == len(transforms) == 11)
    for k, (pose, transform) in enumerate(zip(graph.poses, transforms)):
        assert transform.header == pose.header
        assert (transform.header.frame_id, transform.child_frame_id) == ('map', 'odom')
        map_T_base = compose(planar(transform.transform),
                             Pose2(70.0, 3.0, -1.0) if k == 10 else sample(k).pose)
        position = pose.pose.pose.position
        assert (map_T_base.x_m, map_T_base.y_m) == pytest.approx((position.x, position.y))
    assert position.x == pytest.approx(0.9)


def test_transforms_are_switched_off_and_on_in_flight(transforms, graph):
    observer = graph.observer
    for k, is_on in enumerate((True, False, True)):
        assert observer.set_parameters('ratslam', ratslam__publish_tf=is_on) == ''
        graph.send('odom', odometry(k))
        observer.spin_until(lambda: len(graph.poses) == k + 1)
    observer.spin_until(lambda: len(transforms) == 2)
    assert [transform.header for transform in transforms] == [
        pose.header for pose in graph.poses[::2]]


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
    said = (DiagnosticStatus.WARN,
            'no odometry: /odom is published by /observer, but nothing comes, '
            'no codes: /code is published by /observer, but nothing comes')
    graph.observer.spin_until(lambda: said in [  # the first may come before all are known
        (report.status[0].level, report.status[0].message) for report in graph.reports])


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
    values = {value.key: value.value
              for value in graph.status(lambda values: values['poses'] == '10').values}
    assert float(values['latency_ms']) >= 0.0
    assert any(float(value.value) > 0 for report in graph.reports
               for value in report.status[0].values if value.key == 'pose_rate_hz')


def test_a_node_set_inactive_publishes_nothing_keeps_its_map_and_goes_on(graph):
    observer, encoder = graph.observer, Encoder(Config())
    for k in range(40):
        graph.fly(k, encoder)
    observer.spin_until(lambda: len(graph.poses) == 40)
    assert observer.transition('ratslam', 'deactivate')
    del graph.poses[:], graph.reports[:]
    for k in range(40, 60):
        graph.fly(k, encoder)
    graph.status(lambda values: not values)
    assert (graph.reports[-1].status[0].message, graph.poses) == ('inactive', [])

    assert observer.transition('ratslam', 'activate')
    graph.wait_for_subscriptions()
    for k in range(60, 100):
        graph.fly(k, encoder)
    observer.spin_until(lambda: len(graph.poses) == 40)
    # Odometry went on: what was flown meanwhile is in the map as one motion.
    assert graph.poses[-1].pose.pose.position.x == pytest.approx(9.9, abs=1e-6)
    values = {value.key: value.value for value in graph.status(
        lambda values: values.get('poses') == '80').values}
    assert int(values['experiences']) > 24  # an experience each 0.3 m of two times 4 m
    assert not [key for key in values if key.endswith('_lost')]
    assert graph.process.stop() == 0


def test_a_node_cleaned_up_begins_an_empty_map(graph):
    observer, encoder = graph.observer, Encoder(Config())
    for k in range(20):
        graph.fly(k, encoder)
    observer.spin_until(lambda: len(graph.poses) == 20)
    for label in ('deactivate', 'cleanup', 'configure', 'activate'):
        assert observer.transition('ratslam', label)
    graph.reports.clear()
    status = graph.status(lambda values: values)
    assert {'experiences': '0', 'poses': '0'}.items() <= {
        value.key: value.value for value in status.values}.items()


def test_a_managed_node_waits_says_what_is_wrong_and_is_put_right(start, observer):
    reports = observer.collect(DiagnosticArray, '/diagnostics')
    process = start('nodes.ratslam_node', '--ros-args', '-p', 'autostart:=false',
                    '-p', 'ratslam.threshold:=1.5')
    observer.spin_until(lambda: reports)
    assert reports[0].status[0].message == 'unconfigured'
    assert not observer.transition('ratslam', 'configure')
    said = 'ratslam.threshold = 1.5: expected a value in [-1.0, 1.0]'
    observer.spin_until(lambda: reports[-1].status[0].message == f'unconfigured: {said}')
    assert reports[-1].status[0].level == DiagnosticStatus.ERROR
    assert said in process.text()
    assert observer.set_parameters('ratslam', ratslam__threshold=0.5) == ''
    assert observer.transition('ratslam', 'configure')
    assert observer.transition('ratslam', 'activate')
    assert process.stop() == 0


def test_thresholds_change_in_flight_and_shapes_are_refused(graph):
    observer, encoder = graph.observer, Encoder(Config())
    assert observer.set_parameters('ratslam', ratslam__keyframe_distance_m=0.95) == ''
    for k in range(41):
        graph.fly(k, encoder)
    assert graph.status(lambda values: values.get('codes_used') == '41')
    graph.status(lambda values: values.get('experiences') == '5')  # one each metre
    assert 'deactivate and clean up first' in observer.set_parameters(
        'ratslam', ratslam__keyframe_distance_m=2.0, encoder__n_atoms=32)
    for k in range(41, 51):
        graph.fly(k, encoder)
    graph.status(lambda values: values.get('experiences') == '6')
