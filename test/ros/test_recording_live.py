"""The recorder at work: it is paused, split, asked for a snapshot, and says what it lost."""

from io import StringIO
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dlsc_qbs_ros.errors import RecordingError
from dlsc_qbs_ros.io.recordings.bag import bag_topics, read_bag
from dlsc_qbs_ros.io.recordings.bag_writer import BagWriter
from dlsc_qbs_ros.nodes.polled_subscription import PolledSubscription
from dlsc_qbs_ros.nodes.recorder_node import RecorderNode
from dlsc_qbs_ros.profiles import load_profile
from dlsc_qbs_ros.ros.serialization import deserialize, serialize
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import EventHandler
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

N = 100
LOSSES = '/recorder/losses'


class Recorder:
    """A recorder of /name in this process, which lives only while something is waited for."""

    def __init__(self, observer, bag, parameters):
        self._observer, self.bag = observer, bag
        self.node = RecorderNode(parameter_overrides=[
            Parameter(f'recorder.{name}', value=value) for name, value in {
                'output': str(bag), 'topics': ['/name'], **parameters}.items()])
        self.node.start()
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def until(self, condition):
        self._observer.spin_until(
            lambda: self._executor.spin_once(timeout_sec=0.005) or condition())

    def until_recorded(self, n):
        self.until(lambda: self.values()['messages'] >= n)

    def values(self):
        return self.node.report()[2]

    def call(self, service):
        client = self._observer.node.create_client(Trigger, f'/recorder/{service}')
        self.until(client.service_is_ready)
        future = client.call_async(Trigger.Request())
        self.until(future.done)
        return future.result().success, future.result().message

    def close(self):
        if self.node is not None:
            node, self.node = self.node, None
            self._executor.shutdown()
            node.destroy_node()

    def names(self):
        """End the recording; return what was said on /name as it was recorded."""
        self.close()
        return [deserialize(m.data, m.type_name).data for m in read_bag(self.bag, ['/name'])]


@pytest.fixture
def record(domain_id, observer, tmp_path):
    """Give a function that starts a recorder with parameters."""
    rclpy.init(domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
    recorders = []

    def start_recorder(**parameters):
        recorders.append(Recorder(observer, tmp_path / 'bag', parameters))
        return recorders[-1]
    yield start_recorder
    for recorder in recorders:
        recorder.close()
    rclpy.shutdown()


@pytest.fixture
def publisher(observer):
    return observer.advertise(String, '/name')


def say(publisher, *names):
    for name in names:
        publisher.publish(String(data=str(name)))
    assert publisher.wait_for_all_acked(Duration(seconds=30))


def policies(observer, name):
    """Return that policy of each subscription to /name."""
    return [getattr(info.qos_profile, name)
            for info in observer.node.get_subscriptions_info_by_topic('/name')]


def metadata_records(path):
    """Return the newest metadata record of each name in a file."""
    with open(path, 'rb') as stream:
        return {record.name: record.metadata for record in make_reader(stream).iter_metadata()}


def test_while_paused_nothing_is_recorded_and_nothing_lost(record, publisher):
    recorder = record(start_paused=True)
    recorder.until(publisher.get_subscription_count)
    for name, service in (('a', 'resume'), ('b', 'pause'), ('c', 'resume'), ('d', 'resume')):
        say(publisher, name)
        assert recorder.call(service) == (True, f'{service}d')
    assert recorder.values()['lost'] == 0
    assert recorder.names() == ['b', 'd']


def test_a_split_begins_a_file(record, publisher):
    recorder = record()
    recorder.until(publisher.get_subscription_count)
    for k in range(3):
        say(publisher, k)
        recorder.until_recorded(k + 1)
        assert recorder.call('split') == (True, 'the next message begins a file')
    assert recorder.names() == ['0', '1', '2']
    assert sorted(path.name for path in recorder.bag.glob('*.mcap')) == [
        'bag_0.mcap', 'bag_1.mcap', 'bag_2.mcap']


def test_a_snapshot_writes_what_was_kept(record, publisher):
    recorder = record(snapshot_s=60.0)
    recorder.until(publisher.get_subscription_count)
    say(publisher, 'a', 'b')
    assert recorder.call('snapshot') == (True, 'written')
    assert recorder.values()['messages'] == 2
    say(publisher, 'c')
    assert recorder.names() == ['a', 'b']


def test_a_snapshot_of_what_is_not_kept_is_refused(record):
    success, message = record().call('snapshot')
    assert not success
    assert 'recorder.snapshot_s = 0' in message


def test_messages_are_written_in_the_order_in_which_they_came(record, observer, publisher):
    recorder = record(topics=['/name', '/other'])
    other = observer.advertise(String, '/other')
    recorder.until(lambda: publisher.get_subscription_count() and other.get_subscription_count())
    for k in range(6):
        say((other, publisher)[k % 2], k)
    recorder.until_recorded(6)
    recorder.close()
    with open(recorder.bag / 'bag_0.mcap', 'rb') as stream:
        written = [deserialize(record.data, 'std_msgs/msg/String').data
                   for record in StreamReader(stream).records if isinstance(record, Message)]
    assert written == list('012345')


def test_a_terminal_shows_how_it_goes(record, monkeypatch):
    terminal = StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr('sys.stderr', terminal)
    record().until(terminal.getvalue)
    assert terminal.getvalue().startswith('recording  0:00:0')


def test_what_a_short_queue_lost_is_told_and_stands_in_the_file(
        record, publisher, observer, tmp_path):
    (tmp_path / 'qos.yaml').write_text('/name: {history: keep_last, depth: 1}')
    told = observer.collect(DiagnosticArray, LOSSES)
    recorder = record(qos_profile_overrides_path=str(tmp_path / 'qos.yaml'))
    recorder.until(publisher.get_subscription_count)
    say(publisher, 'first')
    recorder.until_recorded(1)
    say(publisher, *range(N))
    recorder.until(lambda: told)
    assert recorder.values()['lost'] == recorder.values()['lost /name'] == N - 1
    assert recorder.node.report()[:2] == (DiagnosticStatus.WARN, 'losses')
    assert recorder.names() == ['first', str(N - 1)]

    last, = [deserialize(m.data, m.type_name) for m in read_bag(recorder.bag, [LOSSES])]
    assert last == told[-1]
    assert (last.status[0].name, last.status[0].message) == ('/name', f'{N - 1} messages lost')
    assert {value.key: value.value for value in last.status[0].values} == {
        'lost': f'{N - 1}', 'gaps': f'{N - 1}', 'message_lost': '0', 'overflowed': '0',
        'not_written': '0'}
    assert metadata_records(recorder.bag / 'bag_0.mcap')['dlsc_qbs_ros/losses'] == {
        '/name gaps': f'{N - 1}'}


def test_what_the_middleware_reports_as_lost_is_counted(record, publisher, monkeypatch):
    events = [SimpleNamespace(total_count_change=3), SimpleNamespace(total_count_change=2)]
    monkeypatch.setattr(
        EventHandler, 'take_data', lambda handler: events.pop() if events else None)
    recorder = record()
    recorder.until(lambda: recorder.values()['lost'] == 5)
    recorder.close()
    assert metadata_records(recorder.bag / 'bag_0.mcap')['dlsc_qbs_ros/losses'] == {
        '/name message_lost': '5'}


def test_what_finds_no_room_in_the_queue_of_the_writer_is_counted(record, publisher):
    recorder = record(queue_bytes=1000)
    recorder.until(publisher.get_subscription_count)
    say(publisher, 'small', 2000 * 'x')
    recorder.until(lambda: recorder.values()['overflowed'] == 1)
    recorder.until_recorded(1)
    assert recorder.values()['lost'] == 1
    assert recorder.names() == ['small']
    assert metadata_records(recorder.bag / 'bag_0.mcap')['dlsc_qbs_ros/losses'] == {
        '/name overflowed': '1'}


def test_nothing_is_lost_or_doubled_while_the_subscription_is_adapted(
        record, observer, publisher, monkeypatch):
    recorder = record()
    recorder.until(publisher.get_subscription_count)
    say(publisher, 'before')
    n_publishers = PolledSubscription.n_publishers.fget

    def speak_once_both_listen(subscription):
        n = n_publishers(subscription)
        if n == 2:
            say(publisher, 'to both')
        return n
    monkeypatch.setattr(PolledSubscription, 'n_publishers', property(speak_once_both_listen))
    observer.advertise(String, '/name', reliability=ReliabilityPolicy.BEST_EFFORT)
    recorder.until(lambda: policies(observer, 'reliability') == [ReliabilityPolicy.BEST_EFFORT])
    say(publisher, 'after')
    recorder.until_recorded(3)
    assert recorder.values()['lost'] == 0
    assert recorder.names() == ['before', 'to both', 'after']


def test_a_stricter_subscription_takes_the_place_when_only_latched_ones_publish(
        record, observer, publisher):
    recorder = record()
    recorder.until(publisher.get_subscription_count)
    observer.node.destroy_publisher(publisher)
    recorder.until(lambda: not observer.node.count_publishers('/name'))
    latched = observer.advertise(
        String, '/name', durability=DurabilityPolicy.TRANSIENT_LOCAL)
    latched.publish(String(data='latched'))
    recorder.until(lambda: policies(observer, 'durability') == [DurabilityPolicy.TRANSIENT_LOCAL])
    recorder.until_recorded(1)
    assert recorder.names() == ['latched']


def test_an_override_that_a_publisher_cannot_meet_is_told(
        record, observer, tmp_path, capfd):
    (tmp_path / 'qos.yaml').write_text('/name: {reliability: reliable}')
    publisher = observer.advertise(
        String, '/name', reliability=ReliabilityPolicy.BEST_EFFORT)
    recorder = record(qos_profile_overrides_path=str(tmp_path / 'qos.yaml'))
    recorder.until(lambda: recorder.values()['topics'])
    assert not publisher.get_subscription_count()
    assert '/name: its override asks for more than a publisher offers' in capfd.readouterr().err


def test_a_type_that_is_not_installed_is_refused_by_name_and_the_rest_recorded(
        record, publisher, monkeypatch):
    recorder = record(topics=['/odd', '/name'])
    offers = RecorderNode.get_publishers_info_by_topic
    monkeypatch.setattr(RecorderNode, 'get_topic_names_and_types', lambda node: [
        ('/odd', ['odd_msgs/msg/Odd']), ('/name', ['std_msgs/msg/String'])])
    monkeypatch.setattr(RecorderNode, 'get_publishers_info_by_topic', lambda node, topic: (
        [SimpleNamespace(topic_type='odd_msgs/msg/Odd')] if topic == '/odd'
        else offers(node, topic)))
    recorder.until(publisher.get_subscription_count)
    say(publisher, 'a')
    recorder.until_recorded(1)
    assert recorder.values()['refused_topics'] == '/odd'
    assert recorder.node.report()[:2] == (DiagnosticStatus.WARN, '1 topic refused')
    assert recorder.names() == ['a']


def test_another_type_on_a_topic_changes_nothing_for_the_first(
        record, observer, publisher, domain_id):
    recorder = record()
    recorder.until(publisher.get_subscription_count)
    stranger = type(observer)(domain_id)  # one participant has one type for a topic
    stranger.advertise(Bool, '/name')
    recorder.until(lambda: len(recorder.node.get_publishers_info_by_topic('/name')) == 2)
    observer.advertise(String, '/name', reliability=ReliabilityPolicy.BEST_EFFORT)
    recorder.until(lambda: policies(observer, 'reliability') == [ReliabilityPolicy.BEST_EFFORT])
    say(publisher, 'a')
    recorder.until_recorded(1)
    stranger.close()
    assert recorder.names() == ['a']
    assert bag_topics(recorder.bag) == {'/name': 'std_msgs/msg/String'}


def test_the_configuration_and_files_named_in_it_are_attached_to_each_file(
        record, publisher, tmp_path):
    (tmp_path / 'camera.yaml').write_text('focal_length: 300')
    recorder = record(attachments=[str(tmp_path / 'camera.yaml')])
    recorder.until(publisher.get_subscription_count)
    for k in range(2):
        say(publisher, k)
        recorder.call('split')
    recorder.close()
    for path in recorder.bag.glob('*.mcap'):
        with open(path, 'rb') as stream:
            attached = {a.name: a.data for a in make_reader(stream).iter_attachments()}
        assert attached['camera.yaml'] == b'focal_length: 300'
        (tmp_path / 'config.yaml').write_bytes(attached['config.yaml'])
        assert load_profile(tmp_path / 'config.yaml')['recorder.topics'] == ['/name']


def test_an_attachment_that_is_not_there_is_refused_before_anything_is_made(record, tmp_path):
    with pytest.raises(RecordingError, match='recorder.attachments: nothing.yaml: cannot be read'):
        record(attachments=['nothing.yaml'])
    assert not (tmp_path / 'bag').exists()


def test_what_an_earlier_recorder_left_unfinished_is_repaired(record, tmp_path, capfd):
    path = tmp_path / 'earlier' / 'earlier_0.mcap'
    with BagWriter(path.parent) as writer:
        writer.add_topic('/name', 'std_msgs/msg/String')
        writer.write('/name', serialize(String(data='a')), 1, 1)
    path.write_bytes(path.read_bytes()[:-100])
    recorder = record()
    recorder.until(lambda: recorder.values()['repaired_files'] == 1)
    recorder.close()
    assert f'{path} had no end and was repaired: 1 messages' in capfd.readouterr().err
    assert [m.data for m in read_bag(path)] == [serialize(String(data='a'))]


def test_an_inactive_recorder_keeps_its_recording(record, publisher):
    recorder = record()
    recorder.until(publisher.get_subscription_count)
    say(publisher, 'a')
    assert recorder.node.trigger_deactivate() == TransitionCallbackReturn.SUCCESS
    recorder.until(lambda: not publisher.get_subscription_count())
    say(publisher, 'b')
    assert recorder.node.trigger_activate() == TransitionCallbackReturn.SUCCESS
    recorder.until(publisher.get_subscription_count)
    say(publisher, 'c')
    recorder.until_recorded(2)
    assert recorder.values()['lost'] == 0
    assert recorder.names() == ['a', 'c']
