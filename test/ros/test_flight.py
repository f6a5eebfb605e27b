"""A recorded flight is read as frames, odometry and ground truth, whatever its topics."""

from array import array
from collections import Counter
from math import nan

from dlsc_qbs_ros.config import MavlinkConfig
from dlsc_qbs_ros.core.types import Frame, GroundTruthSample, OdometrySample, Pose2, RawOdometry
from dlsc_qbs_ros.errors import RecordingError
from dlsc_qbs_ros.io.flight import read_flight
from dlsc_qbs_ros.io.recordings.bag_writer import BagWriter
from dlsc_qbs_ros.ros.conversions import odometry_to_msg, pose_stamped_to_msg
from dlsc_qbs_ros.ros.image_conversions import image_to_msg
from dlsc_qbs_ros.ros.serialization import serialize, type_name
from link_log import write_tlog
import numpy as np
import pytest
from std_msgs.msg import String

GREY = np.arange(12, dtype=np.uint8).reshape(3, 4)


def image(stamp_ns):
    return image_to_msg(stamp_ns, GREY, 'mono8', 'camera')


def odometry(stamp_ns, x_m=1.0):
    sample = OdometrySample(stamp_ns, Pose2(x_m, 2.0, 0.0))
    return odometry_to_msg(sample, 0.5, 0.25, 'odom', 'base_link')


def truth(stamp_ns):
    return pose_stamped_to_msg(GroundTruthSample(stamp_ns, Pose2(3.0, 4.0, 0.0)), 'world')


def record(directory, events):
    with BagWriter(directory) as writer:
        for topic, msg in dict(events).items():
            writer.add_topic(topic, type_name(msg))
        for log_time_ns, (topic, msg) in enumerate(events):
            writer.write(topic, serialize(msg), log_time_ns, log_time_ns)
    return directory


def test_events_come_in_the_order_in_which_they_were_recorded(tmp_path):
    flight = record(tmp_path / 'flight', [
        ('/odom', odometry(20)), ('/camera/image_raw', image(10)), ('/ground_truth', truth(30)),
        ('/name', String())])
    raw, frame, true = read_flight(flight)
    assert raw == RawOdometry(OdometrySample(20, Pose2(1.0, 2.0, 0.0)), 0.5, 0.0, 0.25)
    assert isinstance(frame, Frame) and frame.stamp_ns == 10
    np.testing.assert_array_equal(frame.grey, GREY)
    assert true == GroundTruthSample(30, Pose2(3.0, 4.0, 0.0))


def test_a_flight_needs_no_ground_truth(tmp_path):
    flight = record(tmp_path / 'flight', [('/i', image(1)), ('/o', odometry(2))])
    assert [type(event) for event in read_flight(flight)] == [Frame, RawOdometry]


def test_topics_of_any_name_are_read_when_named(tmp_path):
    flight = record(tmp_path / 'flight', [
        ('/left', image(1)), ('/right', image(2)), ('/wheels', odometry(3)),
        ('/visual', odometry(4)), ('/mocap', truth(5)), ('/ground_truth', truth(6))])
    events = read_flight(flight, '/right', '/visual', '/mocap')
    stamps_ns = [event.sample.stamp_ns if isinstance(event, RawOdometry) else event.stamp_ns
                 for event in events]
    assert stamps_ns == [2, 4, 5]


def test_odometry_may_be_the_ground_truth_of_another(tmp_path):
    flight = record(tmp_path / 'flight', [
        ('/i', image(1)), ('/odom', odometry(2)), ('/ground_truth', odometry(3, x_m=7.0))])
    assert list(read_flight(flight))[1:] == [
        RawOdometry(OdometrySample(2, Pose2(1.0, 2.0, 0.0)), 0.5, 0.0, 0.25),
        GroundTruthSample(3, Pose2(7.0, 2.0, 0.0))]


@pytest.mark.parametrize('arguments, error', [
    ({}, 'expected one topic of sensor_msgs/msg/Image .*; found /left, /right'),
    ({'image_topic': '/left', 'odom_topic': '/gone'},
     "no topic '/gone'; it has /left, /name, /odom, /right"),
    ({'image_topic': '/name'}, "topic '/name' is std_msgs/msg/String; expected sensor_msgs"),
    ({'image_topic': '/left', 'ground_truth_topic': '/true'}, "no topic '/true'"),
    ({'image_topic': '/odom', 'ground_truth_topic': '/odom'},
     "topic '/odom' is nav_msgs/msg/Odometry; expected sensor_msgs"),
    ({'image_topic': '/left', 'odom_topic': '/odom', 'ground_truth_topic': '/odom'},
     "topic '/odom' is the ground truth; expected another")])
def test_a_topic_that_is_not_clear_is_refused(tmp_path, arguments, error):
    flight = record(tmp_path / 'flight', [
        ('/left', image(1)), ('/right', image(2)), ('/odom', odometry(3)), ('/name', String())])
    with pytest.raises(RecordingError, match=error):
        next(read_flight(flight, **arguments))


def test_a_flight_without_odometry_is_refused(tmp_path):
    flight = record(tmp_path / 'flight', [('/left', image(1))])
    with pytest.raises(RecordingError, match='nav_msgs/msg/Odometry; found none'):
        next(read_flight(flight))


def test_bad_messages_are_refused_counted_and_named_once(tmp_path, caplog):
    truncated, unknown, not_finite = image(2), image(3), odometry(4)
    truncated.data = array('B', bytes(5))
    unknown.encoding = 'jpeg2000'
    not_finite.pose.pose.position.x = nan
    flight = record(tmp_path / 'flight', [
        ('/i', image(1)), ('/i', truncated), ('/i', unknown), ('/o', not_finite),
        ('/o', odometry(5)), ('/i', image(6))])
    refused = Counter()
    events = list(read_flight(flight, refused=refused))
    assert [type(event) for event in events] == [Frame, RawOdometry, Frame]
    assert refused == {'/i': 2, '/o': 1}
    assert [record.message for record in caplog.records] == [
        f'{flight}: /i: refused: 5 bytes of data: expected at least 12, '
        '3 rows of 4 bytes as mono8',
        f'{flight}: /o: refused: position (nan, 2.0, 0.0): expected finite numbers, '
        'none beyond 1e+08']


def test_a_message_that_is_cut_is_refused(tmp_path):
    with BagWriter(tmp_path / 'flight') as writer:
        for topic, msg in (('/i', image(1)), ('/o', odometry(1))):
            writer.add_topic(topic, type_name(msg))
            writer.write(topic, serialize(msg)[:20], 1, 1)
    refused = Counter()
    assert list(read_flight(tmp_path / 'flight', refused=refused)) == []
    assert refused == {'/i': 1, '/o': 1}


SECOND_NS = 1_000_000_000
BOOT_NS = 1_700_000_000 * SECOND_NS


def flown(seconds):
    """Give odometry of so many seconds after boot, at 2 m/s along x."""
    return [RawOdometry(OdometrySample(
        BOOT_NS + second * SECOND_NS, Pose2(2.0 * second, 0.5, 0.0)), 2.0, 0.0, 0.0)
        for second in seconds]


def test_odometry_may_come_from_a_recording_of_a_link(tmp_path):
    flight = record(tmp_path / 'flight', [
        ('/camera/image_raw', image(BOOT_NS)), ('/odom', odometry(BOOT_NS))])
    tlog = write_tlog(tmp_path / 'link.tlog', flown([10, 20]), BOOT_NS)
    frame, *raw = read_flight(flight, tlog=tlog)
    assert isinstance(frame, Frame)
    assert [sample.sample.pose.x_m for sample in raw] == pytest.approx([20.0, 40.0])
    assert [sample.sample.stamp_ns for sample in raw] == [
        BOOT_NS + 10 * SECOND_NS, BOOT_NS + 20 * SECOND_NS]


def test_the_two_are_merged_in_the_order_in_which_they_came(tmp_path):
    with BagWriter(tmp_path / 'flight') as writer:
        writer.add_topic('/camera/image_raw', 'sensor_msgs/msg/Image')
        for second in (5, 15, 25):
            stamp_ns = BOOT_NS + second * SECOND_NS
            writer.write('/camera/image_raw', serialize(image(stamp_ns)), stamp_ns, stamp_ns)
    tlog = write_tlog(tmp_path / 'link.tlog', flown([10, 20]), BOOT_NS)
    assert [type(event) for event in read_flight(tmp_path / 'flight', tlog=tlog)] == [
        Frame, RawOdometry, Frame, RawOdometry, Frame]


def test_what_the_log_lost_is_counted_beside_what_was_refused(tmp_path):
    flight = record(tmp_path / 'flight', [('/camera/image_raw', image(1))])
    tlog = write_tlog(tmp_path / 'link.tlog', flown([10, 11]), BOOT_NS)
    tlog.write_bytes(tlog.read_bytes() + bytes(100))
    refused = Counter()
    assert len(list(read_flight(flight, tlog=tlog, refused=refused))) == 3
    assert refused == {'link.tlog (mavlink_corrupt)': 1}


def test_the_autopilot_of_a_log_is_chosen_by_its_id(tmp_path):
    flight = record(tmp_path / 'flight', [('/camera/image_raw', image(1))])
    tlog = write_tlog(tmp_path / 'link.tlog', flown([10]), BOOT_NS)
    with pytest.raises(RecordingError, match='link.tlog: holds no odometry of an autopilot'):
        list(read_flight(flight, tlog=tlog, mavlink=MavlinkConfig(system=2)))


def test_a_log_that_is_not_there_is_refused(tmp_path):
    flight = record(tmp_path / 'flight', [('/camera/image_raw', image(1))])
    with pytest.raises(RecordingError, match='gone.tlog: No such file'):
        list(read_flight(flight, tlog=tmp_path / 'gone.tlog'))
