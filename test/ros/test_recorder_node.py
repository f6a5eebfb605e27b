"""The recorder, as a process beside live publishers: what it is to record lies in its file."""

import resource
import signal

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dlsc_qbs_ros.io.recordings.bag import bag_topics, latched_topics, read_bag
from dlsc_qbs_ros.nodes.recorder_node import RecorderNode
from dlsc_qbs_ros.ros.image_conversions import image_to_msg
from dlsc_qbs_ros.ros.serialization import deserialize
from geometry_msgs.msg import PoseStamped
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
import numpy as np
import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import String
from std_srvs.srv import Trigger
import yaml

N = 100


@pytest.fixture
def recorder(start, tmp_path):
    """Give a function that starts a recorder into `tmp_path / 'bag'`."""
    def start_recorder(**parameters):
        parameters = {'output': tmp_path / 'bag', **parameters}
        return start('nodes.recorder_node', '--ros-args', *(
            argument for name, value in parameters.items()
            for argument in ('-p', f'recorder.{name}:={value}')))
    return start_recorder


def status_of(reports):
    """Return the newest report of the recorder as (message, values)."""
    statuses = [s for report in reports for s in report.status if s.name == '/recorder']
    if not statuses:
        return '', {}
    return statuses[-1].message, {value.key: value.value for value in statuses[-1].values}


def record(observer, messages, before=lambda: None):
    """Publish lists of messages by publisher, once heard; wait until all are written."""
    reports = observer.collect(DiagnosticArray, '/diagnostics')
    for publisher in messages:
        observer.spin_until(publisher.get_subscription_count)
    before()
    observer.spin_until(lambda: reports)
    for publisher, sent in messages.items():
        for message in sent:
            publisher.publish(message)
    total = sum(map(len, messages.values()))
    observer.spin_until(lambda: int(status_of(reports)[1].get('messages', 0)) >= total)
    return reports


def level_of(reports):
    return [s.level for report in reports for s in report.status if s.name == '/recorder'][-1]


def names_in(bag):
    return [deserialize(m.data, m.type_name).data for m in read_bag(bag)]


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_what_was_published_is_recorded_message_for_message(
        recorder, observer, tmp_path, number):
    rng = np.random.default_rng(0)
    images = [image_to_msg(k, rng.integers(0, 256, (40, 50, 3), dtype=np.uint8), 'rgb8', 'camera')
              for k in range(N)]
    names = [String(data=str(k)) for k in range(N)]
    process = recorder(topics="['/image', '/name']")
    record(observer, {
        observer.advertise(Image, '/image'): images,
        observer.advertise(String, '/name'): names})
    assert process.stop(number) == 0

    expected = {'/image': images, '/name': names}
    read = {topic: [] for topic in expected}
    for message in read_bag(tmp_path / 'bag'):
        assert 0 < message.publish_time_ns <= message.log_time_ns
        read[message.topic].append(deserialize(message.data, message.type_name))
    assert read == expected
    with AnyReader([tmp_path / 'bag']) as reader:
        theirs = [reader.deserialize(data, connection.msgtype)
                  for connection, _, data in reader.messages() if connection.topic == '/image']
    assert [bytes(image.data) for image in theirs] == [bytes(image.data) for image in images]
    with open(tmp_path / 'bag' / 'bag_0.mcap', 'rb') as stream:
        decoded = [message.data for *_, message in make_reader(
            stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages('/name')]
    assert decoded == [name.data for name in names]
    information = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())
    assert information['rosbag2_bagfile_information']['message_count'] == 2 * N


def test_what_waits_when_the_end_comes_is_recorded(domain_id, observer, tmp_path):
    publisher = observer.advertise(String, '/name')
    rclpy.init(domain_id=domain_id, args=[
        '--ros-args', '-p', f'recorder.output:={tmp_path / "bag"}',
        '-p', "recorder.topics:=['/name']"])
    try:
        recorder = RecorderNode()
        recorder.start()
        executor = SingleThreadedExecutor()
        executor.add_node(recorder)
        observer.spin_until(
            lambda: executor.spin_once(0.02) or publisher.get_subscription_count())
        for k in range(N):  # nobody spins the recorder any more
            publisher.publish(String(data=str(k)))
        assert publisher.wait_for_all_acked(Duration(seconds=30))
        executor.shutdown()
        recorder.destroy_node()
    finally:
        rclpy.shutdown()
    assert names_in(tmp_path / 'bag') == [str(k) for k in range(N)]


def test_a_file_is_split_while_it_is_recorded(recorder, observer, tmp_path):
    publisher = observer.advertise(String, '/name')
    process = recorder(topics="['/name']")
    record(observer, {publisher: [String(data='a')]})
    response = observer.call(Trigger, '/recorder/split')
    assert (response.success, response.message) == (True, 'the next message begins a file')
    record(observer, {publisher: [String(data='b')]})
    assert process.stop() == 0
    assert [names_in(tmp_path / 'bag' / f'bag_{k}.mcap') for k in range(2)] == [['a'], ['b']]


def test_a_regex_matches_whole_names(recorder, observer, tmp_path):
    process = recorder(regex='/drone/.*')
    other = observer.advertise(String, '/other/drone/a')
    record(observer, {observer.advertise(String, f'/drone/{name}'): [String()]
                      for name in 'ab'})
    assert other.get_subscription_count() == 0
    assert process.stop() == 0
    assert bag_topics(tmp_path / 'bag') == {
        '/drone/a': 'std_msgs/msg/String', '/drone/b': 'std_msgs/msg/String'}


def test_without_a_choice_every_topic_that_appears_is_recorded(recorder, observer, tmp_path):
    process = recorder()
    first = observer.advertise(String, '/first')
    observer.spin_until(first.get_subscription_count)
    record(observer, {observer.advertise(PoseStamped, '/second'): [PoseStamped()]})
    assert process.stop() == 0
    assert bag_topics(tmp_path / 'bag').items() >= {
        '/first': 'std_msgs/msg/String', '/second': 'geometry_msgs/msg/PoseStamped',
        '/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray'}.items()


def test_what_was_latched_before_is_recorded_as_latched(recorder, observer, tmp_path):
    publisher = observer.advertise(
        String, '/latched', durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher.publish(String(data='early'))
    process = recorder(topics="['/latched']")
    record(observer, {publisher: [String(data='late')]})
    assert process.stop() == 0
    assert names_in(tmp_path / 'bag') == ['early', 'late']
    assert latched_topics(tmp_path / 'bag') == {'/latched'}


def test_a_publisher_that_offers_less_is_recorded_too(recorder, observer, tmp_path):
    process = recorder(topics="['/name']")
    reliable = observer.advertise(String, '/name')
    observer.spin_until(reliable.get_subscription_count)
    best_effort = observer.advertise(
        String, '/name', reliability=ReliabilityPolicy.BEST_EFFORT)
    record(observer, {best_effort: [String(data='less')]})
    assert process.stop() == 0
    assert names_in(tmp_path / 'bag') == ['less']


def test_the_simulated_clock_gives_the_log_times(start, observer, tmp_path):
    process = start('nodes.recorder_node', '--ros-args', '-p', 'use_sim_time:=true',
                    '-p', 'recorder.topics:=["/name"]', '-p', f'recorder.output:={tmp_path}/bag')
    clock, publisher = observer.advertise(Clock, '/clock'), observer.advertise(String, '/name')
    observer.spin_until(clock.get_subscription_count)
    now = Clock()
    now.clock.sec = 42

    def tick_until_subscribed():
        clock.publish(now)
        return publisher.get_subscription_count()
    observer.spin_until(tick_until_subscribed)
    record(observer, {publisher: [String()]})
    assert process.stop() == 0
    assert [m.log_time_ns for m in read_bag(tmp_path / 'bag')] == [42_000_000_000]


def test_a_folder_that_is_there_is_refused_in_one_line(recorder, tmp_path):
    (tmp_path / 'bag').mkdir()
    process = recorder()
    assert process.wait() == 1
    assert process.text().startswith(f'error: {tmp_path}/bag: cannot make a new recording')
    assert len(process.text().splitlines()) == 1


def test_a_full_disk_ends_the_recording_not_the_node(recorder, observer, tmp_path):
    publisher = observer.advertise(String, '/name')
    reports = observer.collect(DiagnosticArray, '/diagnostics')
    process = recorder(topics="['/name']")
    resource.prlimit(process._popen.pid, resource.RLIMIT_FSIZE, 2 * (3_000_000,))
    observer.spin_until(publisher.get_subscription_count)
    for _ in range(60):
        publisher.publish(String(data=100_000 * 'x'))
    observer.spin_until(lambda: reports and level_of(reports) == DiagnosticStatus.ERROR)
    observer.spin_until(lambda: int(status_of(reports)[1]['not_written']) > 1)
    assert status_of(reports)[0].startswith(
        f'{tmp_path}/bag/bag_0.mcap: cannot be written: File too large')
    assert process.stop() == 1
    assert 'Traceback' not in process.text()
    assert process.text().count('nothing more is recorded') == 1
    assert len(names_in(tmp_path / 'bag')) > 10


def test_what_a_stopped_recorder_could_not_be_sent_is_lost_and_told(
        recorder, observer, tmp_path):
    publisher = observer.advertise(String, '/name', depth=1)
    process = recorder(topics="['/name']")
    reports = record(observer, {publisher: [String()]})
    process.send(signal.SIGSTOP)
    for _ in range(N):
        publisher.publish(String(data=60_000 * 'x'))
    process.send(signal.SIGCONT)
    observer.spin_until(lambda: int(status_of(reports)[1]['lost']) > 0)
    assert publisher.wait_for_all_acked(Duration(seconds=30))
    assert process.stop() == 0
    messages = list(read_bag(tmp_path / 'bag'))
    told = deserialize(messages[-1].data, 'diagnostic_msgs/msg/DiagnosticArray').status[0]
    n_lost = int({value.key: value.value for value in told.values}['gaps'])
    assert [m.topic for m in messages].count('/name') + n_lost == 1 + N
    assert f'{n_lost}  /name\n' in process.text()  # the summary
    assert process.text().endswith(f', {n_lost} lost\n')


def test_what_is_waited_for_is_named(recorder, observer):
    reports = observer.collect(DiagnosticArray, '/diagnostics')
    publisher = observer.advertise(String, '/name')
    recorder(topics="['/name', '/gone']")
    observer.spin_until(publisher.get_subscription_count)
    observer.spin_until(lambda: status_of(reports)[0] == 'waiting for /gone')
    assert level_of(reports) == DiagnosticStatus.WARN


def test_a_clock_that_does_not_tick_is_named(start, observer, tmp_path):
    reports = observer.collect(DiagnosticArray, '/diagnostics')
    start('nodes.recorder_node', '--ros-args', '-p', 'use_sim_time:=true',
          '-p', f'recorder.output:={tmp_path}/bag')
    observer.spin_until(lambda: status_of(reports)[0] == 'waiting for /clock')
    assert level_of(reports) == DiagnosticStatus.WARN


def test_a_name_that_no_topic_can_have_is_refused_in_one_line(recorder):
    process = recorder(topics="['bad topic!']")
    assert process.wait() == 1
    assert process.text() == "error: recorder.topics: 'bad topic!' is no name of a topic\n"


def test_a_bad_expression_is_refused_in_one_line(recorder):
    process = recorder(regex='"("')
    assert process.wait() == 1
    assert process.text().startswith("error: recorder.regex = '('")
