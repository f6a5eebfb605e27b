"""Every kind of file that the recorder leaves is one that the tools of others read."""

from collections import Counter
import json
import os
from pathlib import Path
import shutil
import subprocess

from dlsc_qbs_ros.config import RecorderConfig
from dlsc_qbs_ros.errors import RecordingError
from dlsc_qbs_ros.io.recordings import recording as recording_module
from dlsc_qbs_ros.io.recordings.recording import Recording
from dlsc_qbs_ros.io.recordings.recovery import recover
from dlsc_qbs_ros.ros.image_conversions import image_to_msg
from dlsc_qbs_ros.ros.qos import qos_to_words
from dlsc_qbs_ros.ros.serialization import serialize
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
import numpy as np
import pytest
from rclpy.qos import QoSProfile
from rosbags.highlevel import AnyReader
from std_msgs.msg import String

NODE_READER = Path(__file__).parents[1] / 'read_mcap.js'
TYPES = {'/camera': 'sensor_msgs/msg/Image', '/name': 'std_msgs/msg/String'}
N_PAIRS = 60
TIMEOUT_S = 20.0
KINDS = {
    'plain': {}, 'lz4': {'compression': 'lz4'}, 'zstd': {'compression': 'zstd'},
    'split': {'max_bytes': 100_000}, 'ring': {'max_bytes': 100_000, 'max_files': 2},
    'snapshot': {'snapshot_s': 1.0}, 'recovered': {'compression': 'lz4'}, 'full': {}}


def pair(k):
    """Return the messages of one moment."""
    rgb = np.random.default_rng(k).integers(0, 256, (50, 60, 3), dtype=np.uint8)
    return {'/camera': serialize(image_to_msg(k, rgb, 'rgb8', 'camera')),
            '/name': serialize(String(data=str(k)))}


def recorded(folder, kind, monkeypatch):
    """Record a flight that ends in its own way; return its folder and the numbers in it."""
    recording = Recording(folder / kind, RecorderConfig(
        min_free_bytes=1, flush_interval_s=0.005, **KINDS[kind]))
    for topic, type_name in TYPES.items():
        recording.add_topic(topic, type_name, [qos_to_words(QoSProfile(depth=5))])
    recording.attach('config.yaml', 'text/yaml', b'a: 1\n')
    for k in range(N_PAIRS):
        for topic, data in pair(k).items():
            assert recording.write(topic, data, k * 10**8, k * 10**8, k)
        if k % 10 == 0:  # wait for the writer: no file has one chunk only
            recording.add_metadata('moment', {'k': str(k)}).result(TIMEOUT_S)
    if kind == 'snapshot':
        recording.snapshot().result(TIMEOUT_S)
    if kind == 'full':
        monkeypatch.setattr(recording_module, 'free_bytes', lambda path: 0)
        with pytest.raises(RecordingError, match='0 bytes are free'):
            wait_until_stopped(recording)
            recording.close()
    recording.close()
    if kind == 'recovered':
        path, = (folder / kind).glob('*.mcap')
        os.truncate(path, path.stat().st_size - 100)
        repair, = recover(folder / kind)
        assert repair.error == ''
    return folder / kind


def wait_until_stopped(recording):
    while recording.status().state != 'stopped':
        recording.add_metadata('more', {}).exception(TIMEOUT_S)


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    with pytest.MonkeyPatch.context() as monkeypatch:
        folder = tmp_path_factory.mktemp('bags')
        yield {kind: recorded(folder, kind, monkeypatch) for kind in KINDS}


def assert_complete(kind, names):
    """Check that the numbers are those which this kind of recording keeps."""
    numbers = [int(name) for name in names]
    first = {'snapshot': N_PAIRS - 11}.get(kind, numbers[0] if kind == 'ring' else 0)
    assert numbers == list(range(first, N_PAIRS))
    assert kind != 'ring' or 0 < first


@pytest.mark.parametrize('kind', KINDS)
def test_rosbags_reads_it_with_the_types_of_the_file(bags, kind):
    with AnyReader([bags[kind]]) as reader:
        assert {topic: info.msgtype for topic, info in reader.topics.items()} == TYPES
        decoded = [(connection.topic, reader.deserialize(data, connection.msgtype))
                   for connection, _, data in reader.messages()]
        assert reader.message_count == len(decoded)
    assert_complete(kind, [msg.data for topic, msg in decoded if topic == '/name'])
    assert {msg.data.size for topic, msg in decoded if topic == '/camera'} == {9000}


@pytest.mark.parametrize('kind', KINDS)
def test_mcap_ros2_support_decodes_it_with_every_checksum_held(bags, kind):
    names = []
    for path in files_of(bags[kind]):
        with open(path, 'rb') as stream:
            reader = make_reader(
                stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            summary = reader.get_summary()
            decoded = [(channel.topic, msg) for _, channel, _, msg
                       in reader.iter_decoded_messages()]
            attached, = reader.iter_attachments()
        assert summary.statistics.message_count == len(decoded)
        assert (attached.name, attached.data) == ('config.yaml', b'a: 1\n')
        names += [msg.data for topic, msg in decoded if topic == '/name']
    assert_complete(kind, names)


def files_of(bag):
    return sorted(bag.glob('*.mcap'), key=lambda path: int(path.stem.rpartition('_')[2]))


def test_the_packages_of_foxglove_read_it(bags):
    node = shutil.which('node')
    packages = ['@mcap/core', '@mcap/support', '@foxglove/rosmsg',
                '@foxglove/rosmsg2-serialization']
    if node is None or subprocess.run(
            [node, '-e', f'{packages}.forEach(require)'], capture_output=True).returncode:
        pytest.skip(f'node with {", ".join(packages)} in NODE_PATH is not here')
    paths = [path for bag in bags.values() for path in files_of(bag)]
    done = subprocess.run([node, NODE_READER, *paths], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    contents = dict(zip(paths, json.loads(done.stdout)))
    for kind, bag in bags.items():
        read = [contents[path] for path in files_of(bag)]
        assert {content['profile'] for content in read} == {'ros2'}
        names = [name for content in read for name in content['names']]
        counts = sum((Counter(content['counts']) for content in read), Counter())
        assert_complete(kind, names)
        assert counts == {topic: len(names) for topic in TYPES}
        assert sum(content['streamed'] for content in read) == counts.total()
