"""Recordings are written as rosbag2 does, read whoever wrote them, and honest about gaps."""

from functools import lru_cache
import logging
from pathlib import Path
import subprocess
import sys

from dlsc_qbs_ros.errors import RecordingError
from dlsc_qbs_ros.io.recordings.bag import bag_topics, BagMessage, latched_topics, read_bag
from dlsc_qbs_ros.io.recordings.bag_writer import BagWriter
from dlsc_qbs_ros.io.recordings.message_definitions import message_definition, schema, type_hash
from dlsc_qbs_ros.ros.image_conversions import image_to_msg
from dlsc_qbs_ros.ros.qos import qos_to_words
from dlsc_qbs_ros.ros.serialization import serialize
from geometry_msgs.msg import PoseStamped
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer as RosbagsWriter
from rosbags.typesys import get_typestore, Stores
from std_msgs.msg import String
import yaml

IMAGE, POSE, STRING = (
    'sensor_msgs/msg/Image', 'geometry_msgs/msg/PoseStamped', 'std_msgs/msg/String')
TYPES = {'/camera': IMAGE, '/pose': POSE, '/name': STRING}
LATCHED = qos_to_words(QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))


@lru_cache(maxsize=None)  # the serialiser leaves padding bytes as they happen to be
def messages(n=40, first=0):
    """Return messages on three topics, as they were logged one after the other."""
    rng = np.random.default_rng(first)
    payloads = {
        '/camera': lambda k: image_to_msg(
            k, rng.integers(0, 256, (50, 60, 3), dtype=np.uint8), 'rgb8', 'camera'),
        '/pose': lambda k: PoseStamped(),
        '/name': lambda k: String(data=str(k))}
    return [BagMessage(topic, TYPES[topic], serialize(payloads[topic](k)), 10 * k + 100, 10 * k)
            for k in range(first, first + n) for topic in [list(TYPES)[k % 3]]]


def write(directory, recorded):
    with BagWriter(directory) as writer:
        for topic, type_name in TYPES.items():
            writer.add_topic(topic, type_name, [LATCHED] if topic == '/name' else [])
        for message in recorded:
            writer.write(message.topic, message.data, message.log_time_ns, message.publish_time_ns)
    return directory


@pytest.fixture
def bag(tmp_path):
    return write(tmp_path / 'flight', messages())


def mcap_of(directory):
    path, = directory.glob('*.mcap')
    return path


def test_what_was_written_is_read(bag):
    assert list(read_bag(bag)) == messages()
    assert list(read_bag(mcap_of(bag))) == messages()


def test_topics_are_told_with_their_types(bag):
    assert bag_topics(bag) == TYPES
    assert latched_topics(bag) == {'/name'}


def test_chosen_topics_alone_are_read(bag):
    assert list(read_bag(bag, ['/pose'])) == [m for m in messages() if m.topic == '/pose']


def test_messages_come_in_the_order_of_their_log_times(tmp_path):
    recorded = messages()
    shuffled = [recorded[k] for k in np.random.default_rng(0).permutation(len(recorded))]
    assert list(read_bag(write(tmp_path / 'flight', shuffled))) == recorded


def test_rosbags_reads_it_message_for_message(bag):
    with AnyReader([bag]) as reader:
        assert {topic: info.msgtype for topic, info in reader.topics.items()} == TYPES
        read = [(connection.topic, connection.msgtype, bytes(data), log_time_ns)
                for connection, log_time_ns, data in reader.messages()]
        names = [reader.deserialize(data, STRING).data
                 for connection, _, data in reader.messages() if connection.topic == '/name']
    assert read == [message[:4] for message in messages()]
    assert names == [str(k) for k in range(2, 40, 3)]


def test_mcap_ros2_support_decodes_it_message_for_message(bag):
    with open(mcap_of(bag), 'rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        read = [(channel.topic, schema.name, message.data, message.log_time, message.publish_time)
                for schema, channel, message in reader.iter_messages()]
        names = [decoded.data for _, channel, _, decoded in reader.iter_decoded_messages('/name')]
        images = list(reader.iter_decoded_messages('/camera'))
    assert read == [tuple(message) for message in messages()]
    assert names == [str(k) for k in range(2, 40, 3)]
    assert {(image.decoded_message.encoding, image.decoded_message.width) for image in images} == {
        ('rgb8', 60)}


def test_the_file_follows_rosbag2(bag):
    assert mcap_of(bag).name == 'flight_0.mcap'
    with open(mcap_of(bag), 'rb') as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == 'ros2'
        summary = reader.get_summary()
        metadata, = reader.iter_metadata()
    channels = {channel.topic: channel for channel in summary.channels.values()}
    assert channels['/name'].metadata['topic_type_hash'] == type_hash(STRING)
    assert yaml.safe_load(channels['/name'].metadata['offered_qos_profiles']) == [LATCHED]
    assert {(s.name, s.encoding) for s in summary.schemas.values()} == {
        (name, 'ros2msg') for name in TYPES.values()}
    information = yaml.safe_load((bag / 'metadata.yaml').read_text())
    assert metadata.name == 'rosbag2'
    assert yaml.safe_load(metadata.metadata['serialized_metadata']) == information[
        'rosbag2_bagfile_information']


def test_metadata_yaml_tells_what_is_there(bag):
    document = yaml.safe_load((bag / 'metadata.yaml').read_text())
    information = document['rosbag2_bagfile_information']
    assert (information['version'], information['storage_identifier']) == (9, 'mcap')
    assert information['message_count'] == 40
    assert information['starting_time'] == {'nanoseconds_since_epoch': 100}
    assert information['duration'] == {'nanoseconds': 390}
    assert information['relative_file_paths'] == ['flight_0.mcap']
    counts = {topic['topic_metadata']['name']: topic['message_count']
              for topic in information['topics_with_message_count']}
    assert counts == {'/camera': 14, '/pose': 13, '/name': 13}


def test_a_recording_of_nothing_is_a_recording(tmp_path):
    bag = write(tmp_path / 'empty', [])
    assert bag_topics(bag) == TYPES
    assert list(read_bag(bag)) == []
    with AnyReader([bag]) as reader:
        assert list(reader.messages()) == []


def test_a_folder_that_is_there_is_not_written_into(bag):
    with pytest.raises(RecordingError, match='flight: cannot make a new recording: .*exists'):
        BagWriter(bag)
    assert list(read_bag(bag)) == messages()


def test_a_type_without_definition_is_refused_by_name(tmp_path):
    with BagWriter(tmp_path / 'flight') as writer:
        with pytest.raises(RecordingError, match="definition of 'foo_msgs/msg/Bar'"):
            writer.add_topic('/foo', 'foo_msgs/msg/Bar')
        writer.add_topic('/name', STRING)
    assert bag_topics(tmp_path / 'flight') == {'/name': STRING}


def test_closing_twice_is_closing_once(tmp_path):
    writer = BagWriter(tmp_path / 'flight')
    writer.close()
    before = mcap_of(tmp_path / 'flight').read_bytes()
    writer.close()
    assert mcap_of(tmp_path / 'flight').read_bytes() == before


def test_a_definition_holds_each_dependency_once():
    separator = '\n' + '=' * 80 + '\n'
    root, *dependencies = message_definition('nav_msgs/msg/Odometry').split(separator)
    assert 'geometry_msgs/TwistWithCovariance twist' in root
    names = [text.splitlines()[0] for text in dependencies]
    assert len(names) == len(set(names))
    assert set(names) == {f'MSG: {name}' for name in (
        'std_msgs/Header', 'builtin_interfaces/Time', 'geometry_msgs/PoseWithCovariance',
        'geometry_msgs/Pose', 'geometry_msgs/Point', 'geometry_msgs/Quaternion',
        'geometry_msgs/TwistWithCovariance', 'geometry_msgs/Twist', 'geometry_msgs/Vector3')}


def test_a_sourced_installation_comes_first(tmp_path, monkeypatch):
    folder = tmp_path / 'share' / 'bar_msgs' / 'msg'
    folder.mkdir(parents=True)
    (folder / 'Bar.msg').write_text('# Foo comment\nBaz[<=3] baz\nstring<=5 LIMIT="x"\n')
    (folder / 'Baz.msg').write_text('uint8 A=1\nbool[2] a\n')
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere:{tmp_path}')
    assert message_definition('bar_msgs/msg/Bar').endswith(
        f'\n{"=" * 80}\nMSG: bar_msgs/Baz\nuint8 A=1\nbool[2] a\n')
    assert type_hash('bar_msgs/msg/Bar') == ''


IDL = {'Outer': '''#include "idl_msgs/msg/Inner.idl"
module idl_msgs { module msg { struct Outer { idl_msgs::msg::Inner inner; long number; }; }; };
''', 'Inner': 'module idl_msgs { module msg { struct Inner { string name; }; }; };\n'}


def test_a_type_that_is_defined_in_idl_alone_is_recorded_in_idl(tmp_path, monkeypatch):
    folder = tmp_path / 'share' / 'idl_msgs' / 'msg'
    folder.mkdir(parents=True)
    for name, text in IDL.items():
        (folder / f'{name}.idl').write_text(text)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    heading = '=' * 80 + '\nIDL: idl_msgs/msg/'
    assert schema('idl_msgs/msg/Outer') == ('ros2idl', '\n'.join(
        heading + name + '\n' + text.removeprefix('#include "idl_msgs/msg/Inner.idl"\n')
        for name, text in IDL.items()))
    data = serialize(String(data='abc')) + bytes((7, 0, 0, 0))  # the string fills 8 bytes
    with BagWriter(tmp_path / 'flight') as writer:
        writer.add_topic('/outer', 'idl_msgs/msg/Outer')
        writer.write('/outer', data, 1, 1)
    with AnyReader([tmp_path / 'flight']) as reader:
        (connection, _, data), = reader.messages()
        outer = reader.deserialize(data, connection.msgtype)
    assert (outer.inner.name, outer.number) == ('abc', 7)


def test_a_type_that_lacks_a_part_in_idl_too_is_refused(tmp_path, monkeypatch):
    folder = tmp_path / 'share' / 'half_msgs' / 'msg'
    folder.mkdir(parents=True)
    (folder / 'Half.idl').write_text('#include "half_msgs/msg/Other.idl"\n')
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    with pytest.raises(RecordingError, match="no message definition of 'half_msgs/msg/Half'"):
        schema('half_msgs/msg/Half')


def test_recordings_of_rosbags_are_read(tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    string = store.types[STRING]
    with RosbagsWriter(
            tmp_path / 'theirs', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/name', STRING, typestore=store)
        for k in range(5):
            writer.write(connection, k, store.serialize_cdr(string(data=str(k)), STRING))
    assert bag_topics(tmp_path / 'theirs') == {'/name': STRING}
    assert [m.log_time_ns for m in read_bag(tmp_path / 'theirs')] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize('options', [
    {'compression': CompressionType.ZSTD, 'chunk_size': 4096},
    {'compression': CompressionType.LZ4, 'chunk_size': 4096},
    {'use_chunking': False},
    {'repeat_channels': False, 'repeat_schemas': False, 'use_statistics': False}])
def test_other_layouts_of_the_file_are_read(tmp_path, options):
    path = tmp_path / 'theirs.mcap'
    with open(path, 'wb') as stream:
        mcap_writer(stream, messages(), **options)
    if options.get('repeat_channels', True):
        assert list(read_bag(path)) == messages()
    assert bag_topics(path) == TYPES


def mcap_writer(stream, recorded, encoding='cdr', **options):
    writer = Writer(stream, **options)
    writer.start(profile='ros2')
    channels = {}
    for topic, name in TYPES.items():
        schema = writer.register_schema(name, 'ros2msg', message_definition(name).encode())
        channels[topic] = writer.register_channel(topic, encoding, schema)
    for m in recorded:
        writer.add_message(channels[m.topic], m.log_time_ns, m.data, m.publish_time_ns)
    writer.finish()


def test_several_files_are_one_recording(tmp_path):
    folder = tmp_path / 'split'
    folder.mkdir()
    parts = {'b.mcap': messages(20, first=15), 'a.mcap': messages(20)}
    for name, recorded in parts.items():
        with open(folder / name, 'wb') as stream:
            mcap_writer(stream, recorded)
    expected = sorted(parts['a.mcap'] + parts['b.mcap'], key=lambda m: m.log_time_ns)
    assert [m.log_time_ns for m in read_bag(folder)] == [m.log_time_ns for m in expected]
    (folder / 'metadata.yaml').write_text(yaml.safe_dump(
        {'rosbag2_bagfile_information': {'relative_file_paths': ['a.mcap']}}))
    assert list(read_bag(folder)) == messages(20)


def test_a_topic_in_another_encoding_is_left_out_and_named(tmp_path, caplog):
    path = tmp_path / 'theirs.mcap'
    with open(path, 'wb') as stream:
        mcap_writer(stream, [], encoding='json')
    assert bag_topics(path) == {}
    assert "topic /pose is left out: its encoding is 'json'" in caplog.text


def test_a_missing_topic_is_named_with_those_there_are(bag):
    with pytest.raises(RecordingError, match="no topic '/odom'; it has /camera, /name, /pose"):
        next(read_bag(bag, ['/odom']))


def cut(bag, size):
    path = bag.parent / 'cut.mcap'
    path.write_bytes(mcap_of(bag).read_bytes()[:size])
    return path


def test_a_file_cut_in_half_is_read_to_the_cut_and_named(tmp_path, caplog):
    recorded = messages(1500)
    bag = write(tmp_path / 'flight', recorded)
    path = cut(bag, mcap_of(bag).stat().st_size // 2)
    read = list(read_bag(path))
    assert 300 < len(read) < 1200
    assert read == recorded[:len(read)]
    assert f'{path}: cut short, its end is missing: {len(read)} messages' in caplog.text


@pytest.mark.parametrize('missing', [1, 7, 8, 9, 50, 500])
def test_a_file_without_its_end_loses_no_message(bag, caplog, missing):
    caplog.set_level(logging.WARNING)
    path = cut(bag, mcap_of(bag).stat().st_size - missing)
    assert list(read_bag(path)) == messages()
    assert 'cut short' in caplog.text


@pytest.mark.parametrize('size', [8, 9, 20, 100, 2000])
def test_a_file_cut_before_its_first_message_holds_none_and_is_named(bag, caplog, size):
    path = cut(bag, size)
    assert bag_topics(path) == {}
    assert list(read_bag(path)) == []
    assert f'{path}: cut short, its end is missing: 0 messages' in caplog.text


def test_a_file_cut_before_its_first_message_keeps_nobody_from_those_beside_it(tmp_path, caplog):
    bag = write(tmp_path / 'flight', messages())
    (bag / 'metadata.yaml').unlink()
    (bag / 'flight_1.mcap').write_bytes(mcap_of(bag).read_bytes()[:20])
    assert list(read_bag(bag)) == messages()
    assert 'flight_1.mcap: cut short' in caplog.text


@pytest.mark.parametrize('content', [b'', b'\x89MCA', b'#ROSBAG V2.0\n', bytes(100)])
def test_what_is_no_mcap_file_is_refused(tmp_path, content):
    path = tmp_path / 'file.mcap'
    path.write_bytes(content)
    with pytest.raises(RecordingError, match='file.mcap: not an MCAP file, it starts with'):
        next(read_bag(path))


def test_a_file_damaged_in_its_middle_is_refused(bag):
    content = bytearray(mcap_of(bag).read_bytes())
    content[len(content) // 4:len(content) // 2] = bytes(len(content) // 2 - len(content) // 4)
    mcap_of(bag).write_bytes(content)
    with pytest.raises(RecordingError, match='flight_0.mcap: damaged'):
        list(read_bag(bag))


def flip_a_bit(path):
    content = bytearray(path.read_bytes())
    content[content.index(messages()[0].data) + 1000] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize('missing', [0, 8])
def test_a_bit_that_flipped_does_not_pass(bag, missing):
    flip_a_bit(mcap_of(bag))
    path = cut(bag, mcap_of(bag).stat().st_size - missing)
    with pytest.raises(RecordingError, match='cut.mcap: damaged'):
        list(read_bag(path))


FULL_DISK = '''
import resource, sys
from dlsc_qbs_ros.errors import RecordingError
from dlsc_qbs_ros.io.recordings.bag_writer import BagWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, 3_000_000))
writer = BagWriter(sys.argv[1])
writer.add_topic('/camera', 'sensor_msgs/msg/Image')
for attempt in (lambda: [writer.write('/camera', bytes(100_000), k, k) for k in range(100)],
                lambda: writer.write('/camera', b'', 0, 0), writer.close, writer.close):
    try:
        attempt()
    except RecordingError as error:
        print(error)
'''


def test_where_no_more_may_be_written_is_an_error_and_what_was_written_is_whole(tmp_path):
    output = subprocess.run(
        [sys.executable, '-c', FULL_DISK, tmp_path / 'flight'], cwd=Path(__file__).parents[2],
        capture_output=True, text=True, check=True)
    path = tmp_path / 'flight' / 'flight_0.mcap'
    assert output.stderr == ''
    assert output.stdout.splitlines() == 3 * [
        f'{path}: cannot be written: File too large; 11 messages before it are lost']
    with open(path, 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert [m.log_time for _, _, m in reader.iter_messages()] == list(range(22))
    with AnyReader([tmp_path / 'flight']) as reader:
        assert reader.message_count == 22


@pytest.mark.parametrize('mode', ['message', 'FILE'])
def test_what_rosbag2_compressed_is_refused_by_name(bag, mode):
    path = bag / 'metadata.yaml'
    document = yaml.safe_load(path.read_text())
    document['rosbag2_bagfile_information'].update(
        compression_format='zstd', compression_mode=mode)
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(RecordingError, match=f'compressed by rosbag2, zstd per {mode.lower()}'):
        next(read_bag(bag))


@pytest.mark.parametrize('make, error', [
    (lambda folder: folder / 'nothing', 'nothing: no such file or folder'),
    (lambda folder: folder, 'no MCAP file in this folder')])
def test_a_path_without_recording_is_refused(tmp_path, make, error):
    with pytest.raises(RecordingError, match=error):
        next(read_bag(make(tmp_path)))


@pytest.mark.parametrize('text, error', [
    ('rosbag2_bagfile_information: {relative_file_paths: [gone.mcap]}',
     'gone.mcap: named in metadata.yaml, but not there'),
    ('rosbag2_bagfile_information: {}', 'not the metadata of a rosbag2 recording'),
    ('[1, 2', 'not the metadata'), ('- 1', 'not the metadata'), ('', 'not the metadata')])
def test_metadata_that_does_not_fit_is_refused(bag, text, error):
    (bag / 'metadata.yaml').write_text(text)
    with pytest.raises(RecordingError, match=error):
        next(read_bag(bag))


@pytest.mark.parametrize('name', ['hololens_walk', 'tum_fr1_rpy', 'jackal_odom'])
def test_real_recordings_are_read(name):
    folder = Path(__file__).parents[3] / 'shared' / 'data' / name
    if not folder.is_dir():
        pytest.skip(f'{folder} is not here')
    information = yaml.safe_load((folder / 'metadata.yaml').read_text())
    count = information['rosbag2_bagfile_information']['message_count']
    assert sum(1 for _ in read_bag(folder)) == count
