"""A replay puts every recorded message on its topic, in order, with the clock, at any rate."""

import signal
import time

from dlsc_qbs_ros.core.types import Code, OdometrySample, Pose2, RawOdometry
from dlsc_qbs_ros.io.recordings.bag_writer import BagWriter
from dlsc_qbs_ros.io.recordings.message_definitions import message_definition
from dlsc_qbs_ros.ros.conversions import code_to_msg, odometry_to_msg
from dlsc_qbs_ros.ros.image_conversions import image_to_msg
from dlsc_qbs_ros.ros.serialization import serialize, type_name
from dlsc_qbs_ros.ros.stamps import stamp_to_ns
from link_log import write_tlog
from mcap.writer import Writer
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import String

START_NS = 1_600_000_000_000_000_000
PERIOD_NS = 20_000_000
IMAGE_EVERY = 5
LATCHED = {'durability': 'transient_local'}


def image(stamp_ns):
    rng = np.random.default_rng(stamp_ns)
    return image_to_msg(
        stamp_ns, rng.integers(0, 256, (40, 50, 3), dtype=np.uint8), 'rgb8', 'camera')


def odometry(stamp_ns):
    return odometry_to_msg(
        OdometrySample(stamp_ns, Pose2(stamp_ns * 1e-9, 0.0, 0.0)), 0.0, 0.0, 'odom', 'base_link')


def record(directory, n=100, more=()):
    """Record n odometry messages, every fifth with an image, and more (topic, message)."""
    with BagWriter(directory) as writer:
        writer.add_topic('/odom', 'nav_msgs/msg/Odometry')
        writer.add_topic('/camera/image_raw', 'sensor_msgs/msg/Image')
        for topic, msg in more:
            writer.add_topic(topic, type_name(msg), [LATCHED] if topic == '/latched' else [])
            writer.write(topic, serialize(msg), START_NS, START_NS)
        for k in range(n):
            stamp_ns = START_NS + k * PERIOD_NS
            if k % IMAGE_EVERY == 0:
                writer.write('/camera/image_raw', serialize(image(stamp_ns)), stamp_ns, stamp_ns)
            writer.write('/odom', serialize(odometry(stamp_ns)), stamp_ns, stamp_ns)
    return directory


def stamps_ns(messages):
    return [stamp_to_ns(message.header.stamp) for message in messages]


@pytest.mark.parametrize('rate', ['max', '4'])
def test_every_message_is_delivered_in_order_with_the_clock(start, observer, tmp_path, rate):
    flight = record(tmp_path / 'flight')
    images = observer.collect(Image, '/camera/image_raw')
    poses = observer.collect(Odometry, '/odom')
    clock = observer.collect(Clock, '/clock')
    replay = start('cli.replay', flight, '--rate', rate)
    observer.spin_until(lambda: not replay.is_running())
    assert replay.wait() == 0, replay.text()
    expected_ns = [START_NS + k * PERIOD_NS for k in range(100)]
    observer.spin_until(lambda: len(poses) == 100 and len(images) == 20 and stamp_to_ns(
        clock[-1].clock) == expected_ns[-1])
    assert poses == [odometry(stamp_ns) for stamp_ns in expected_ns]
    assert images == [image(stamp_ns) for stamp_ns in expected_ns[::IMAGE_EVERY]]
    ticks_ns = [stamp_to_ns(tick.clock) for tick in clock]
    assert ticks_ns == sorted(ticks_ns)
    assert set(expected_ns) <= set(ticks_ns)
    assert '100 /odom' in replay.text() and '20 /camera/image_raw' in replay.text()
    assert '2.0 s of flight' in replay.text()


def test_with_a_start_it_plays_as_if_it_were_recorded_then(start, observer, tmp_path):
    latched = ('/latched', String(data='kept'))
    flight = record(tmp_path / 'flight', n=10, more=[latched])
    images = observer.collect(Image, '/camera/image_raw')
    poses = observer.collect(Odometry, '/odom')
    clock = observer.collect(Clock, '/clock')
    start_ns = time.time_ns() // 1_000_000_000 * 1_000_000_000 + 2_000_000_000
    replay = start('cli.replay', flight, '--start-at', start_ns / 1e9)
    observer.spin_until(lambda: poses)
    assert time.time_ns() >= start_ns
    observer.spin_until(lambda: len(poses) == 10 and len(images) == 2 and stamp_to_ns(
        clock[-1].clock) == start_ns + 9 * PERIOD_NS)
    assert stamps_ns(poses) == [start_ns + k * PERIOD_NS for k in range(10)]
    assert stamps_ns(images) == [start_ns, start_ns + IMAGE_EVERY * PERIOD_NS]
    assert images[0].data == image(START_NS).data
    assert replay.wait() == 0


def test_odometry_of_a_link_takes_the_place_of_what_was_recorded(start, observer, tmp_path):
    flight = record(tmp_path / 'flight', n=50)
    samples = [RawOdometry(OdometrySample(START_NS + k * PERIOD_NS + 5_000_000,
                                          Pose2(float(k), 0.0, 0.0)), 1.0, 0.0, 0.5)
               for k in range(50)]
    tlog = write_tlog(tmp_path / 'link.tlog', samples, START_NS - PERIOD_NS)
    images = observer.collect(Image, '/camera/image_raw')
    poses = observer.collect(Odometry, '/odom')
    replay = start('cli.replay', flight, '--rate', 'max', '--tlog', tlog)
    observer.spin_until(lambda: not replay.is_running() and len(poses) == 50)
    assert replay.wait() == 0, replay.text()
    assert stamps_ns(poses) == [raw.sample.stamp_ns for raw in samples]
    assert [msg.pose.pose.position.x for msg in poses] == pytest.approx(range(50))
    assert {msg.twist.twist.angular.z for msg in poses} == {0.5}
    assert len(images) == 10


def test_topics_are_chosen_and_remapped(start, observer, tmp_path):
    flight = record(tmp_path / 'flight', n=10)
    moved = observer.collect(Odometry, '/wheels')
    images = observer.collect(Image, '/camera/image_raw')
    replay = start('cli.replay', flight, '--rate', 'max', '--topics', '/odom',
                   '--ros-args', '-r', '/odom:=/wheels')
    observer.spin_until(lambda: not replay.is_running() and len(moved) == 10)
    assert replay.wait() == 0
    assert not images and 'image_raw' not in replay.text()


def test_it_waits_for_who_codes_its_images(start, observer, tmp_path):
    flight = record(tmp_path / 'flight', n=200)
    images = observer.collect(Image, '/camera/image_raw')
    codes = observer.advertise(Image, '/code')
    observer.collect(Odometry, '/odom')
    replay = start('cli.replay', flight, '--rate', 'max')
    for n_coded in range(40):
        observer.spin_until(lambda: len(images) > n_coded)
        codes.publish(code_to_msg(Code(stamps_ns(images)[n_coded], np.zeros(3, np.float32), None)))
    observer.spin_until(lambda: not replay.is_running())
    assert replay.wait() == 0
    assert 'going on without it' not in replay.text()


def test_after_a_second_of_flight_it_goes_on_without_who_says_nothing(start, observer, tmp_path):
    flight = record(tmp_path / 'flight', n=100)
    arrivals_s = []
    observer.node.create_subscription(
        Image, '/camera/image_raw', lambda _: arrivals_s.append(time.monotonic()), 100)
    observer.collect(Odometry, '/odom')
    observer.advertise(Image, '/code')
    replay = start('cli.replay', flight, '--rate', 'max')
    observer.spin_until(lambda: not replay.is_running() and len(arrivals_s) == 20)
    assert replay.wait() == 0
    assert 'no new /code for 5 s: going on without it' in replay.text()
    assert np.argmax(np.diff(arrivals_s)) == 10  # the eleventh is one second after the first


def test_recorded_codes_do_not_hold_up_their_own_replay(start, observer, tmp_path):
    code = code_to_msg(Code(START_NS, np.zeros(3, np.float32), None))
    flight = record(tmp_path / 'flight', n=100, more=[('/code', code)])
    codes = observer.collect(Image, '/code')
    observer.collect(Image, '/camera/image_raw')
    poses = observer.collect(Odometry, '/odom')
    replay = start('cli.replay', flight, '--rate', 'max')
    observer.spin_until(lambda: not replay.is_running() and len(poses) == 100)
    assert codes == [code]
    assert 'going on without it' not in replay.text()


def test_without_subscribers_it_says_so_and_plays(start, tmp_path):
    replay = start('cli.replay', record(tmp_path / 'flight', n=5), '--rate', 'max',
                   '--wait-for-subscribers', '0')
    assert replay.wait() == 0
    assert 'nobody subscribes to /camera/image_raw' in replay.text()


def test_what_was_latched_reaches_who_comes_late(start, observer, tmp_path):
    flight = record(tmp_path / 'flight', n=1000, more=[('/latched', String(data='map'))])
    observer.collect(Image, '/camera/image_raw')
    poses = observer.collect(Odometry, '/odom')
    start('cli.replay', flight)
    observer.spin_until(lambda: poses)
    latched = observer.collect(
        String, '/latched', durability=DurabilityPolicy.TRANSIENT_LOCAL)
    observer.spin_until(lambda: latched)
    assert latched == [String(data='map')]


def test_best_effort_subscribers_are_served(start, observer, tmp_path):
    poses = observer.collect(Odometry, '/odom', reliability=ReliabilityPolicy.BEST_EFFORT)
    observer.collect(Image, '/camera/image_raw', reliability=ReliabilityPolicy.BEST_EFFORT)
    start('cli.replay', record(tmp_path / 'flight', n=10))
    observer.spin_until(lambda: len(poses) == 10)


def test_a_recorded_clock_is_not_played_beside_its_own(start, observer, tmp_path):
    flight = record(tmp_path / 'flight', n=5, more=[('/clock', Clock())])
    clock = observer.collect(Clock, '/clock')
    replay = start('cli.replay', flight, '--rate', 'max', '--wait-for-subscribers', '5')
    observer.spin_until(lambda: not replay.is_running() and clock)
    assert all(tick != Clock() for tick in clock)
    assert '/clock' not in replay.text()


def test_an_unknown_type_is_left_out_by_name(start, observer, tmp_path):
    path = tmp_path / 'theirs.mcap'
    with open(path, 'wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2')
        for topic, name, definition, data in (
                ('/foo', 'foo_msgs/msg/Bar', b'uint8 a', b'\0\1\0\0\1'),
                ('/odom', 'nav_msgs/msg/Odometry',
                 message_definition('nav_msgs/msg/Odometry').encode(), serialize(odometry(1)))):
            schema = writer.register_schema(name, 'ros2msg', definition)
            writer.add_message(writer.register_channel(topic, 'cdr', schema), 1, data, 1)
        writer.finish()
    poses = observer.collect(Odometry, '/odom')
    replay = start('cli.replay', path)
    observer.spin_until(lambda: not replay.is_running() and poses)
    assert replay.wait() == 0
    assert ("/foo is not played: message type 'foo_msgs/msg/Bar' is not installed"
            in replay.text())


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_in_peace(start, observer, tmp_path, number):
    observer.collect(Image, '/camera/image_raw')
    poses = observer.collect(Odometry, '/odom')
    replay = start('cli.replay', record(tmp_path / 'flight', n=1000))
    observer.spin_until(lambda: poses)
    assert replay.stop(number) == 0
    assert 'Traceback' not in replay.text()
    assert '/odom' in replay.text()


@pytest.mark.parametrize('arguments, error', [
    (['nothing'], 'error: nothing: no such file or folder'),
    (['flight', '--topics', '/gone'],
     "error: flight: no topic '/gone'; it has /camera/image_raw, /odom"),
    (['flight', '--tlog', 'gone.tlog'], 'error: gone.tlog: No such file or directory')])
def test_what_cannot_be_played_is_one_line(start, tmp_path, arguments, error):
    record(tmp_path / 'flight', n=1)
    replay = start('cli.replay', *arguments)
    assert replay.wait() == 1
    assert replay.text() == f'{error}\n'


def test_a_cut_file_is_played_to_the_cut_and_named(start, observer, tmp_path):
    record(tmp_path / 'flight', n=2000)
    content = (tmp_path / 'flight' / 'flight_0.mcap').read_bytes()
    (tmp_path / 'cut.mcap').write_bytes(content[:len(content) // 2])
    poses = observer.collect(Odometry, '/odom')
    observer.collect(Image, '/camera/image_raw')
    replay = start('cli.replay', 'cut.mcap', '--rate', 'max')
    observer.spin_until(lambda: not replay.is_running())
    assert replay.wait() == 0
    assert 0 < len(poses) < 2000
    assert 'cut.mcap: cut short, its end is missing' in replay.text()


def test_a_message_that_is_cut_is_left_out_and_named(start, observer, tmp_path):
    with BagWriter(tmp_path / 'flight') as writer:
        writer.add_topic('/odom', 'nav_msgs/msg/Odometry')
        for stamp_ns, length in ((1, None), (2, 5), (3, None)):
            writer.write('/odom', serialize(odometry(stamp_ns))[:length], stamp_ns, stamp_ns)
    poses = observer.collect(Odometry, '/odom')
    replay = start('cli.replay', 'flight')
    observer.spin_until(lambda: not replay.is_running() and len(poses) == 2)
    assert replay.wait() == 0
    assert '/odom: a message is not played: 5 bytes hold no header' in replay.text()


@pytest.mark.parametrize('rate', ['0', '-1', 'nan', 'fast'])
def test_a_rate_must_be_above_zero(start, rate):
    replay = start('cli.replay', 'flight', f'--rate={rate}')
    assert replay.wait() == 2
    assert f'argument --rate: {rate}: expected a number above 0, or max' in replay.text()


def test_a_start_leaves_no_choice_of_the_rate(start):
    replay = start('cli.replay', 'flight', '--start-at', '1', '--rate', '2')
    assert replay.wait() == 2
    assert 'not allowed with argument' in replay.text()
