"""What is amiss with the inputs is said in plain words, each fault in its own."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dlsc_qbs_ros.core.types import Code, OdometrySample, Pose2
from dlsc_qbs_ros.nodes.stamp_offset import StampOffset
from dlsc_qbs_ros.ros.conversions import code_to_msg, odometry_to_msg
from dlsc_qbs_ros.ros.image_conversions import image_to_msg
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, Image

S = 1_000_000_000
START_NS = 1_600_000_000 * S
BEST_EFFORT = {'reliability': ReliabilityPolicy.BEST_EFFORT}


class Patient:
    """A node that is ill-treated, and what it says."""

    def __init__(self, start, observer, module, *ros_args):
        self._observer = observer
        self._reports = observer.collect(DiagnosticArray, '/diagnostics')
        start(f'nodes.{module}', '--ros-args', *ros_args)

    def says(self, words, treat=lambda: None):
        """Treat the node so until it says this first."""
        self._reports.clear()

        def said():
            treat()
            return any(report.status[0].message.startswith(words)
                       and report.status[0].level == DiagnosticStatus.WARN
                       for report in self._reports)
        try:
            self._observer.spin_until(said, 10.0)
        except AssertionError as error:
            messages = {report.status[0].message for report in self._reports}
            raise AssertionError(f'expected {words!r}, heard {messages}') from error


def image(stamp_ns):
    grey = np.random.default_rng(0).integers(0, 256, (32, 43), dtype=np.uint8)
    return image_to_msg(stamp_ns, grey, 'mono8', 'camera')


def code(stamp_ns):
    return code_to_msg(Code(stamp_ns, np.ones(1280, np.float32), None))


def odometry(stamp_ns):
    return odometry_to_msg(
        OdometrySample(stamp_ns, Pose2(0.0, 0.0, 0.0)), 1.0, 0.0, 'odom', 'base_link')


def test_the_ways_of_having_no_image_are_told_apart(start, observer):
    encoder = Patient(start, observer, 'encoder_node', '-r', '__ns:=/drone', '-p',
                      'qos_overrides./drone/image.subscription.reliability:=reliable')

    encoder.says('no image: nobody publishes /drone/image')
    camera = observer.advertise(CompressedImage, '/drone/image')
    encoder.says('no image: /drone/image is published by /observer as '
                 'sensor_msgs/msg/CompressedImage, not sensor_msgs/msg/Image: '
                 'nothing can arrive')
    observer.node.destroy_publisher(camera)
    camera = observer.advertise(Image, '/drone/image', **BEST_EFFORT)
    encoder.says('no image: /drone/image is published by /observer as best effort, '
                 'not reliable: nothing can arrive')
    observer.node.destroy_publisher(camera)
    camera = observer.advertise(Image, '/drone/image')
    encoder.says('no image: /drone/image is published by /observer, but nothing comes')
    encoder.says('image stamps do not advance', lambda: camera.publish(image(START_NS)))


def test_the_ways_of_having_no_odometry_are_told_apart(start, observer):
    codes = observer.advertise(Image, 'code')
    ratslam = Patient(start, observer, 'ratslam_node')
    stamps = iter(range(START_NS, START_NS + 1000 * S, S // 10))

    def with_codes():
        codes.publish(code(next(stamps)))
    ratslam.says('no odometry: nobody publishes /odom', with_codes)
    publisher = observer.advertise(PoseStamped, 'odom')
    ratslam.says('no odometry: /odom is published by /observer as geometry_msgs/msg/PoseStamped, '
                 'not nav_msgs/msg/Odometry: nothing can arrive', with_codes)
    observer.node.destroy_publisher(publisher)
    publisher = observer.advertise(Odometry, 'odom')
    ratslam.says('no odometry: /odom is published by /observer, but nothing comes', with_codes)

    def with_the_same_odometry():
        with_codes()
        publisher.publish(odometry(START_NS))
    ratslam.says('odometry stamps do not advance', with_the_same_odometry)
    observer.node.destroy_publisher(codes)
    observer.advertise(Image, 'code', **BEST_EFFORT)
    ratslam.says('odometry stamps do not advance, no codes: /code is published by /observer as '
                 'best effort, not reliable: nothing can arrive',
                 lambda: publisher.publish(odometry(START_NS)))


@pytest.mark.parametrize('offset_ns, words', [
    (3 * S, 'image stamps and odometry are 3.0 s apart'),
    (1234 * S - START_NS, 'image stamps are in another clock than odometry (image: '
     '2020-09-13 12:26:40 UTC; odometry: 1234 s since some start)')])
def test_stamps_that_do_not_fit_together_are_told(start, observer, offset_ns, words):
    codes = observer.advertise(Image, 'code')
    odometries = observer.advertise(Odometry, 'odom')
    ratslam = Patient(start, observer, 'ratslam_node')
    observer.spin_until(
        lambda: codes.get_subscription_count() and odometries.get_subscription_count())
    stamps = iter(range(START_NS, START_NS + S, S // 1000))  # a slow camera

    def fly():
        stamp_ns = next(stamps)
        odometries.publish(odometry(stamp_ns + offset_ns))
        codes.publish(code(stamp_ns))
    ratslam.says(words, fly)


def in_words(pairs_s):
    offset = StampOffset()
    for image_s, odometry_s in pairs_s:
        offset.odometry_at(round(odometry_s * S))
        offset.image_at(round(image_s * S))
    return offset.in_words()


@pytest.mark.parametrize('pairs_s, words', [
    ([], ''), ([(10.0, 10.2)], ''), ([(10.0, 11.0)], ''),
    ([(10.0, 12.0), (13.0, 11.0)], 'image stamps and odometry are 2.0 s apart'),
    ([(10.0, 12.0), (10.1, 10.0)], ''),  # one came late
    ([(10.0, 70.0)], 'image stamps and odometry are 60.0 s apart'),
    ([(10.0, 71.0)], 'image stamps are in another clock than odometry '
     '(image: 10 s since some start; odometry: 71 s since some start)')])
def test_the_closest_stamps_of_a_period_count(pairs_s, words):
    assert in_words(pairs_s) == words


def test_each_period_begins_anew():
    offset = StampOffset()
    offset.image_at(0)  # nothing to compare with yet
    offset.odometry_at(5 * S)
    offset.image_at(0)
    assert offset.in_words() and not offset.in_words()
