"""A recording loses nothing it took, whatever the disk does, or says in numbers what it lost."""

from concurrent.futures import Future
import errno
import os
from pathlib import Path
import threading
import time
from unittest.mock import Mock

from dlsc_qbs_ros.config import RecorderConfig
from dlsc_qbs_ros.errors import RecordingError
from dlsc_qbs_ros.io.recordings import bag_writer, recording as recording_module
from dlsc_qbs_ros.io.recordings.bag import bag_topics, latched_topics, read_bag
from dlsc_qbs_ros.io.recordings.bag_file import BALLAST_BYTES
from dlsc_qbs_ros.io.recordings.bag_writer import BagWriter
from dlsc_qbs_ros.io.recordings.inbox import QueuedMessage
from dlsc_qbs_ros.io.recordings.mcap_repair import is_cut
from dlsc_qbs_ros.io.recordings.recording import LOSSES, Recording
from dlsc_qbs_ros.io.recordings.snapshot_buffer import SnapshotBuffer
from mcap.reader import make_reader
import pytest
from recordings import install_definitions, note, SmallDisk, TYPE
import yaml

TIMEOUT_S = 20.0
EVER = 60.0  # so long that only what is asked for is done
LATCHED = [{'durability': 'transient_local', 'reliability': 'reliable'}]
KB, MB = 1000, 1_000_000


@pytest.fixture(autouse=True)
def definitions(tmp_path, monkeypatch):
    install_definitions(tmp_path / 'prefix', monkeypatch)


@pytest.fixture
def record(tmp_path):
    """Give a function that starts a recording with topics /a and /b; all are ended."""
    started = []

    def start(losses=dict, **parameters):
        parameters = {'min_free_bytes': 0, 'sync_interval_s': 0.0, **parameters}
        recording = Recording(tmp_path / 'flight', RecorderConfig(**parameters), losses)
        started.append(recording)
        recording.add_topic('/a', TYPE)
        recording.add_topic('/b', TYPE, LATCHED)
        return recording
    yield start
    for recording in started:
        close(recording)


def close(recording):
    """Close; return the error if there is one."""
    try:
        recording.close()
    except RecordingError as error:
        return str(error)


def send(recording, numbers, topic='/a', n_bytes=0, period_ns=1):
    """Write messages; return the numbers of those that were taken."""
    return [k for k in numbers if recording.write(
        topic, note(k, n_bytes), 1000 + period_ns * k, 1000 + period_ns * k, k)]


def wait_until(condition):
    until_s = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < until_s, 'waited in vain'
        threading.Event().wait(0.005)


def numbers_of(path):
    """Return the numbers of the messages in a file or folder."""
    return [int(m.data[12:].rstrip(b'.\0')) for m in read_bag(path)]


def files_of(recording):
    return sorted(recording.directory.glob('*.mcap'))


def metadata_of(path, name):
    with open(path, 'rb') as stream:
        return [m.metadata for m in make_reader(stream).iter_metadata() if m.name == name]


def information_of(recording):
    document = yaml.safe_load((recording.directory / 'metadata.yaml').read_text())
    return document['rosbag2_bagfile_information']


def assert_all_accounted_for(recording, offered):
    """Hold the law of the counts, and that what counts as written can be read."""
    counts = recording.status().topics['/a']
    assert sum(counts) == len(offered)
    assert numbers_of(recording.directory) == list(offered[:counts.written])
    assert not any(map(is_cut, files_of(recording)))


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_what_was_taken_is_read_in_order(record, compression):
    recording = record(compression=compression)
    assert send(recording, range(500), n_bytes=5000) == list(range(500))
    recording.close()
    assert numbers_of(recording.directory) == list(range(500))
    assert recording.status().total == (500, 0, 0)
    assert recording.status().state == 'closed'
    assert bag_topics(recording.directory) == {'/a': TYPE, '/b': TYPE}
    assert latched_topics(recording.directory) == {'/b'}


def test_a_message_keeps_its_number_and_times(record):
    recording = record()
    recording.write('/a', note(1), 20, 10, sequence=2**32 + 7)
    recording.close()
    with open(*files_of(recording), 'rb') as stream:
        (_, channel, message), = make_reader(stream, validate_crcs=True).iter_messages()
    assert (channel.topic, message.data) == ('/a', note(1))
    assert (message.log_time, message.publish_time, message.sequence) == (20, 10, 7)


def test_a_time_before_the_epoch_becomes_the_epoch(record):
    recording = record()
    recording.write('/a', note(1), -5, -1)
    recording.close()
    message, = read_bag(recording.directory)
    assert (message.log_time_ns, message.publish_time_ns) == (0, 0)


def test_what_was_taken_is_in_the_file_while_the_recording_goes_on(record):
    recording = record(flush_interval_s=0.001)
    send(recording, range(20))
    wait_until(lambda: recording.status().total.written == 20)
    path, = files_of(recording)
    assert is_cut(path)
    assert numbers_of(path) == list(range(20))
    wait_until(lambda: recording.status().queued_bytes == 0)
    wait_until(lambda: (recording.directory / 'metadata.yaml').exists())
    assert numbers_of(recording.directory) == list(range(20))


def test_a_queue_that_is_full_refuses_and_counts(record):
    recording = record(flush_interval_s=EVER, queue_bytes=10 * len(note(1000)))
    offered = range(1000, 1025)
    assert send(recording, offered) == list(range(1000, 1010))
    assert recording.status().queued_bytes == 10 * len(note(1000))
    assert not recording.write('/b', note(1), 1, 1)
    recording.close()
    assert recording.status().topics == {'/a': (10, 15, 0), '/b': (0, 1, 0)}
    assert_all_accounted_for(recording, offered)
    assert metadata_of(*files_of(recording), LOSSES) == [
        {'/a overflowed': '15', '/b overflowed': '1'}]


def test_what_else_was_lost_stands_in_each_file(record):
    recording = record(losses=lambda: {'/a message_lost': 3})
    send(recording, [1])
    recording.split().result(TIMEOUT_S)
    send(recording, [2])
    recording.close()
    assert [metadata_of(path, LOSSES) for path in files_of(recording)] == 2 * [
        [{'/a message_lost': '3'}]]


def test_a_message_of_a_topic_that_was_not_announced_is_refused(record):
    with pytest.raises(RecordingError, match='/c: a message of a topic that was not announced'):
        record().write('/c', note(1), 1, 1)


def test_a_type_without_definition_is_refused_by_name_and_the_rest_goes_on(record):
    recording = record()
    with pytest.raises(RecordingError, match="no message definition of 'note_msgs/msg/None'"):
        recording.add_topic('/c', 'note_msgs/msg/None')
    send(recording, [1])
    recording.close()
    assert numbers_of(recording.directory) == [1]


def test_offers_that_change_are_in_the_metadata_and_the_next_file(record):
    recording = record()
    send(recording, [1])
    recording.add_topic('/a', TYPE, LATCHED)
    recording.split().result(TIMEOUT_S)
    send(recording, [2])
    recording.close()
    assert [latched_topics(path) for path in files_of(recording)] == [{'/b'}, {'/a', '/b'}]
    assert [topic['topic_metadata']['offered_qos_profiles'] for topic in
            information_of(recording)['topics_with_message_count']] == [LATCHED, LATCHED]


def test_no_file_outgrows_its_bound(record):
    recording = record(max_bytes=100 * KB)
    send(recording, range(200), n_bytes=3000)
    recording.close()
    sizes = [path.stat().st_size for path in files_of(recording)]
    assert all(60 * KB < size <= 100 * KB for size in sizes[:-1]) and len(sizes) > 5
    assert numbers_of(recording.directory) == list(range(200))
    names = [f'flight_{k}.mcap' for k in range(len(sizes))]
    assert information_of(recording)['relative_file_paths'] == names


def test_chunks_that_are_small_count_with_what_their_index_takes(tmp_path):
    with BagWriter(tmp_path / 'flight', RecorderConfig(max_bytes=30 * KB)) as writer:
        writer.add_topic('/a', TYPE)
        for k in range(300):
            writer.write('/a', note(k), k, k)
            writer.flush()
    sizes = [path.stat().st_size for path in (tmp_path / 'flight').glob('*.mcap')]
    assert 25 * KB < max(sizes) <= 30 * KB and len(sizes) > 2


def test_a_write_that_is_short_is_gone_on_with(record, monkeypatch):
    pwritev = os.pwritev
    monkeypatch.setattr(os, 'pwritev', lambda descriptor, buffers, offset: pwritev(
        descriptor, [b''.join(buffers)[:100]], offset))
    recording = record()
    send(recording, range(50))
    recording.close()
    assert numbers_of(recording.directory) == list(range(50))
    assert not is_cut(*files_of(recording))


def test_a_topic_may_come_later_and_shares_the_type_of_another(record):
    recording = record()
    send(recording, [1])
    recording.add_topic('/c', TYPE)
    send(recording, [2], topic='/c')
    recording.close()
    assert numbers_of(recording.directory) == [1, 2]
    with open(*files_of(recording), 'rb') as stream:
        summary = make_reader(stream).get_summary()
    assert {channel.topic for channel in summary.channels.values()} == {'/a', '/b', '/c'}
    assert [schema.name for schema in summary.schemas.values()] == [TYPE]


def test_a_message_larger_than_the_bound_has_a_file_of_its_own(record):
    recording = record(max_bytes=1)
    send(recording, range(3), n_bytes=3000)
    recording.close()
    assert [numbers_of(path) for path in files_of(recording)] == [[0], [1], [2]]


def test_no_file_is_longer_than_its_duration(record):
    recording = record(max_duration_s=0.1)
    send(recording, range(25), period_ns=10_000_000)
    recording.close()
    assert [numbers_of(path) for path in files_of(recording)] == [
        list(range(10)), list(range(10, 20)), list(range(20, 25))]
    information = information_of(recording)
    assert information['duration'] == {'nanoseconds': 240_000_000}
    assert [(file['starting_time']['nanoseconds_since_epoch'], file['message_count'])
            for file in information['files']] == [
        (1000, 10), (100_001_000, 10), (200_001_000, 5)]


def test_a_split_ends_the_file_and_no_empty_one_follows(record):
    recording = record()
    assert isinstance(recording.split(), Future)
    send(recording, [1])
    for _ in range(2):
        recording.split().result(TIMEOUT_S)
    path, = files_of(recording)
    assert not is_cut(path)
    recording.close()
    assert files_of(recording) == [path]


def test_a_ring_keeps_the_last_files_and_lists_no_other(record):
    recording = record(max_files=3)
    for k in range(8):
        send(recording, [k])
        recording.split().result(TIMEOUT_S)
    recording.close()
    names = ['flight_5.mcap', 'flight_6.mcap', 'flight_7.mcap']
    assert [path.name for path in files_of(recording)] == names
    assert information_of(recording)['relative_file_paths'] == names
    assert information_of(recording)['message_count'] == 3
    assert numbers_of(recording.directory) == [5, 6, 7]
    assert recording.status().total.written == 8


def test_the_metadata_never_list_a_file_that_is_deleted(tmp_path, monkeypatch):
    unlink, deleted = Path.unlink, []

    def checked_unlink(path, **options):
        if path.suffix == '.mcap':
            text = (tmp_path / 'flight' / 'metadata.yaml').read_text()
            assert path.name not in text and text.endswith('ros_distro: jazzy\n')
            deleted.append(path.name)
        unlink(path, **options)
    monkeypatch.setattr(Path, 'unlink', checked_unlink)
    with BagWriter(tmp_path / 'flight', RecorderConfig(max_files=2, max_bytes=1)) as writer:
        writer.add_topic('/a', TYPE)
        for k in range(5):
            writer.write('/a', note(k), k, k)
            information = information_of(writer)
            assert information['relative_file_paths'][-1] == f'flight_{k}.mcap'
            assert information['message_count'] == min(k, 1)
    assert deleted == ['flight_0.mcap', 'flight_1.mcap', 'flight_2.mcap']


def test_each_file_begins_with_what_is_latched(record):
    recording = record(max_files=2)
    send(recording, [0, 1], topic='/b')
    for k in range(10, 16, 2):
        send(recording, [k, k + 1])
        recording.split().result(TIMEOUT_S)
    send(recording, [2], topic='/b')
    recording.close()
    assert [numbers_of(path) for path in files_of(recording)] == [[1, 14, 15], [1, 2]]
    assert sorted(numbers_of(recording.directory)) == [1, 2, 14, 15]
    repeated = next(read_bag(files_of(recording)[0]))
    assert (repeated.publish_time_ns, repeated.log_time_ns) == (1001, 1014)
    assert {name: count.written for name, count in recording.status().topics.items()} == {
        '/a': 6, '/b': 3}
    files = information_of(recording)['files']
    assert [file['message_count'] for file in files] == [3, 2]


def test_of_a_latched_topic_as_many_messages_are_repeated_as_it_has_publishers(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        for offers in (LATCHED, [*LATCHED, {'durability': 'volatile'}, *LATCHED], LATCHED):
            writer.add_topic('/tf_static', TYPE, offers)
        for k in range(3):
            writer.write('/tf_static', note(k), k, k)
        writer.split()
        writer.write('/tf_static', note(3), 3, 3)
    assert numbers_of(tmp_path / 'bag' / 'bag_1.mcap') == [1, 2, 3]


@pytest.mark.parametrize('room', range(7 * MB, 10 * MB, 500_000))
def test_the_counts_hold_where_a_disk_refuses_what_is_repeated(
        record, tmp_path, monkeypatch, room):
    SmallDisk(tmp_path / 'flight', monkeypatch, room, errno.EIO)
    recording = record(compression='none')
    topics = ['/c', '/d', '/e']
    for topic in topics:
        recording.add_topic(topic, TYPE, LATCHED)
        send(recording, [0], topic, n_bytes=1_200_000)
    for k in (1, 2, 3):
        recording.split()
        send(recording, [k])
    assert 'Input/output error' in close(recording)
    counts = recording.status().topics
    assert sum(map(sum, counts.values())) == 6
    assert all(counts[topic] == (1, 0, 0) for topic in topics)
    assert numbers_of(recording.directory) == [0, 0, 0, *range(1, 1 + counts['/a'].written)]


@pytest.mark.parametrize('kilobytes', [35, 60, 80])
def test_what_is_latched_makes_no_file_larger_than_it_may_be(record, kilobytes):
    recording = record(max_bytes=100 * KB)
    send(recording, [0], topic='/b', n_bytes=45 * KB)
    send(recording, range(1, 6), n_bytes=kilobytes * KB)
    recording.close()
    assert max(path.stat().st_size for path in files_of(recording)) <= 100 * KB


def test_what_is_no_longer_latched_is_not_repeated_and_what_was_is_still_read_once(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/b', TYPE, LATCHED)
        for k in (0, 1):
            writer.write('/b', note(k), k, k)
            writer.split()
        writer.add_topic('/b', TYPE, [{'durability': 'volatile'}])
        for k in (2, 3):
            writer.write('/b', note(k), k, k)
            writer.split()
    files = [numbers_of(tmp_path / 'bag' / f'bag_{k}.mcap') for k in range(4)]
    assert files == [[0], [0, 1], [2], [3]]
    assert numbers_of(tmp_path / 'bag') == [0, 1, 2, 3]


def test_what_is_latched_never_fills_a_file(record):
    recording = record(max_bytes=50 * KB)
    send(recording, [0], topic='/b', n_bytes=30 * KB)
    send(recording, range(1, 11), n_bytes=10 * KB)
    recording.close()
    assert numbers_of(recording.directory) == list(range(11))
    assert len(files_of(recording)) == 4


def test_a_snapshot_is_the_last_seconds_in_a_file_of_their_own(record):
    recording = record(snapshot_s=1.0)
    assert recording.status().state == 'snapshot'
    send(recording, range(30), period_ns=100_000_000)
    recording.snapshot().result(TIMEOUT_S)
    path, = files_of(recording)
    assert not is_cut(path)
    assert numbers_of(path) == list(range(19, 30))
    send(recording, range(30, 33), period_ns=100_000_000)
    recording.snapshot().result(TIMEOUT_S)
    send(recording, range(33, 36), period_ns=100_000_000)
    recording.close()
    assert [numbers_of(path) for path in files_of(recording)] == [
        list(range(19, 30)), [30, 31, 32]]
    assert recording.status().total == (14, 0, 0)


def test_a_snapshot_has_the_last_message_of_a_latched_topic_however_old(record):
    recording = record(snapshot_s=1.0)
    send(recording, [0, 1], topic='/b')
    send(recording, range(100, 103), period_ns=100_000_000)
    for more in ([], [103]):
        send(recording, more, period_ns=100_000_000)
        recording.snapshot().result(TIMEOUT_S)
    recording.close()
    assert [numbers_of(path) for path in files_of(recording)] == [[1, 100, 101, 102], [1, 103]]
    for path in files_of(recording):
        first, second = list(read_bag(path))[:2]
        assert first.log_time_ns == second.log_time_ns  # nobody who plays it waits in between
    assert recording.status().total == (4, 0, 0)


def test_a_latched_message_that_is_recent_is_written_once(record):
    recording = record(snapshot_s=1.0)
    send(recording, [0, 1])
    send(recording, [2], topic='/b')
    recording.snapshot().result(TIMEOUT_S)
    recording.close()
    assert numbers_of(recording.directory) == [0, 1, 2]


def test_a_snapshot_that_fails_counts_what_it_should_have_written(record, tmp_path, monkeypatch):
    recording = record(snapshot_s=1.0)
    send(recording, range(30), period_ns=100_000_000)
    SmallDisk(tmp_path / 'flight', monkeypatch, 0, errno.EIO)
    with pytest.raises(RecordingError, match='Input/output error'):
        recording.snapshot().result(TIMEOUT_S)
    close(recording)
    assert recording.status().topics['/a'].written == 0
    assert 0 < recording.status().topics['/a'].not_written <= 11


def test_a_snapshot_takes_no_more_memory_than_it_may(record):
    recording = record(snapshot_s=EVER, snapshot_bytes=3 * len(note(0)))
    send(recording, range(10))
    recording.snapshot().result(TIMEOUT_S)
    recording.close()
    assert numbers_of(recording.directory) == [7, 8, 9]


def test_a_snapshot_of_a_recording_that_writes_everything_is_refused(record):
    recording = record()
    with pytest.raises(RecordingError, match='no snapshot: recorder.snapshot_s = 0'):
        recording.snapshot().result(TIMEOUT_S)
    assert send(recording, [1]) == [1]


def test_attachments_are_in_every_file_and_tables_in_theirs(record):
    recording = record()
    recording.attach('config.yaml', 'text/yaml', b'a: 1\n')
    send(recording, [1])
    recording.add_metadata('pilot', {'name': 'A'}).result(TIMEOUT_S)
    recording.split()
    recording.attach('camera.yaml', 'text/yaml', b'b: 2\n')
    send(recording, [2])
    recording.close()
    attached = []
    for path in files_of(recording):
        with open(path, 'rb') as stream:
            attached.append({a.name: a.data for a in make_reader(stream).iter_attachments()})
    config = {'config.yaml': b'a: 1\n'}
    assert attached == [config, {**config, 'camera.yaml': b'b: 2\n'}]
    assert [metadata_of(path, 'pilot') for path in files_of(recording)] == [[{'name': 'A'}], []]


def test_the_recording_ends_whole_before_the_disk_is_full(record, monkeypatch):
    free = [10 * MB]
    monkeypatch.setattr(recording_module, 'free_bytes', lambda path: free[0])
    recording = record(min_free_bytes=MB, flush_interval_s=0.001)
    taken = send(recording, range(100))
    free[0] = MB - 1
    wait_until(lambda: recording.status().state == 'stopped')
    assert send(recording, range(100, 110)) == []
    path, = files_of(recording)
    wait_until(lambda: not is_cut(path))
    assert recording.status().topics['/a'] == (len(taken), 0, 10)
    assert_all_accounted_for(recording, range(110))
    assert close(recording) == recording.status().error == (
        f'{recording.directory}: ended: 999999 bytes are free, '
        'recorder.min_free_bytes = 1000000')
    with pytest.raises(RecordingError, match='999999 bytes are free'):
        recording.split().result(TIMEOUT_S)


@pytest.mark.parametrize('room', [3 * MB, 3 * MB + 1234, 3_456_789])
def test_on_a_full_disk_all_that_was_taken_is_in_a_whole_file(record, tmp_path, monkeypatch, room):
    SmallDisk(tmp_path / 'flight', monkeypatch, BALLAST_BYTES + room)
    recording = record(flush_interval_s=0.001)
    offered = range(200)
    taken = send(recording, offered, n_bytes=30_000)
    wait_until(lambda: recording.status().state == 'stopped')
    assert close(recording) == f'{recording.directory}: ended: No space left on device'
    assert numbers_of(recording.directory) == taken
    assert_all_accounted_for(recording, offered)


@pytest.mark.parametrize('room', range(1 * MB, 2 * MB, 234_567))
def test_the_counts_hold_where_a_disk_ends_a_file_that_repeats(
        record, tmp_path, monkeypatch, room):
    SmallDisk(tmp_path / 'flight', monkeypatch, room, errno.EIO)
    recording = record(max_bytes=200 * KB)
    recording.add_topic('/a', TYPE, LATCHED)
    offered = range(200)
    send(recording, offered, n_bytes=30_000)
    assert 'Input/output error' in close(recording)
    counts = recording.status().topics['/a']
    assert sum(counts) == len(offered)
    assert numbers_of(recording.directory) == list(offered[:counts.written])


def test_without_more_room_the_last_messages_give_way_to_the_index(record, tmp_path, monkeypatch):
    SmallDisk(tmp_path / 'flight', monkeypatch, 1000 * MB, errno.EFBIG, limit_bytes=3 * MB)
    recording = record()
    offered = range(200)
    taken = send(recording, offered, n_bytes=30_000)
    error = close(recording)
    counts = recording.status().topics['/a']
    assert_all_accounted_for(recording, offered)
    assert 60 <= counts.written < 100 and counts.written < len(taken)
    assert 'flight_0.mcap: cannot be written: File too large; ' in error
    assert metadata_of(*files_of(recording), LOSSES) != [{}]
    assert information_of(recording)['message_count'] == counts.written


@pytest.mark.parametrize('limit', range(2_100_000, 2_110_000, 1111))
def test_wherever_a_file_must_end_it_ends_whole(tmp_path, monkeypatch, limit):
    SmallDisk(tmp_path / 'flight', monkeypatch, 1000 * MB, errno.EFBIG, limit_bytes=limit)
    writer = BagWriter(tmp_path / 'flight')
    writer.add_topic('/a', TYPE)
    with pytest.raises(RecordingError, match='File too large; [0-9]+ messages before it are lost'):
        for k in range(1000):
            writer.write('/a', note(k, 10_000), k, k)
    with pytest.raises(RecordingError, match='File too large'):
        writer.close()
    path, = (tmp_path / 'flight').glob('*.mcap')
    assert not is_cut(path)
    with open(path, 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        statistics = reader.get_summary().statistics
        n_messages = sum(1 for _ in reader.iter_messages())
    assert numbers_of(path) == list(range(n_messages))
    assert n_messages == statistics.message_count == writer.counts['/a'] > 90
    assert statistics.message_end_time == n_messages - 1


@pytest.mark.parametrize('fill', [
    lambda recording: recording.attach('map.bin', 'application/octet-stream', bytes(MB)),
    lambda recording: recording.add_metadata('pilot', {'name': 'A' * MB}),
    lambda recording: recording.split()])
def test_a_disk_that_is_full_for_something_else_loses_nothing_either(
        record, tmp_path, monkeypatch, fill):
    disk = SmallDisk(tmp_path / 'flight', monkeypatch, 1000 * MB)
    recording = record(flush_interval_s=0.001)
    send(recording, range(10))
    wait_until(lambda: recording.status().total.written == 10)
    disk.size_bytes = disk.size_bytes - disk.free_bytes() + 100
    fill(recording).result(TIMEOUT_S)
    wait_until(lambda: recording.status().state == 'stopped')
    assert close(recording) == f'{recording.directory}: ended: No space left on device'
    assert_all_accounted_for(recording, range(10))


def test_the_ring_deletes_later_what_it_could_not_when_the_metadata_failed(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')
    writer = BagWriter(tmp_path / 'flight', RecorderConfig(max_files=1), changed=lambda: None)
    writer.add_topic('/a', TYPE)
    for k in range(3):
        writer.write('/a', note(k), k, k)
        writer.split()
    with monkeypatch.context() as full:
        full.setattr(os, 'replace', fail)
        with pytest.raises(RecordingError, match='metadata.yaml: cannot be written: No space'):
            writer.tidy()
    assert len(list((tmp_path / 'flight').glob('*.mcap'))) == 3
    writer.close()
    assert [path.name for path in (tmp_path / 'flight').glob('*.mcap')] == ['flight_2.mcap']


@pytest.mark.parametrize('limit', range(20_000, 21_000, 173))
def test_chunks_give_way_to_the_index_until_it_fits(tmp_path, monkeypatch, limit):
    SmallDisk(tmp_path / 'flight', monkeypatch, 1000 * MB, errno.EFBIG, limit_bytes=limit)
    writer = BagWriter(tmp_path / 'flight')
    writer.add_topic('/a', TYPE)
    n_flushed = 0
    with pytest.raises(RecordingError, match='File too large'):
        while True:
            writer.write('/a', note(n_flushed), n_flushed, n_flushed)
            writer.flush()
            n_flushed += 1
    path, = (tmp_path / 'flight').glob('*.mcap')
    with open(path, 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        statistics = reader.get_summary().statistics
        n_messages = sum(1 for _ in reader.iter_messages())
    assert 0 < n_messages < n_flushed
    assert statistics.channel_message_counts == {1: n_messages}
    assert statistics.chunk_count == n_messages == writer.counts['/a']
    assert numbers_of(path) == list(range(n_messages))


def test_a_disk_that_is_gone_leaves_what_it_had(record, tmp_path, monkeypatch):
    disk = SmallDisk(tmp_path / 'flight', monkeypatch, 1000 * MB, errno.EIO)
    recording = record(flush_interval_s=0.001)
    send(recording, range(10))
    wait_until(lambda: recording.status().total.written == 10)
    disk.size_bytes = 0
    send(recording, range(10, 20))
    wait_until(lambda: recording.status().state == 'stopped')
    assert 'flight_0.mcap: cannot be written: Input/output error' in close(recording)
    assert recording.status().topics['/a'] == (10, 0, 10)
    assert numbers_of(recording.directory) == list(range(10))


def test_a_writer_that_fails_is_a_recording_that_stopped(record, monkeypatch):
    def fail(*_):
        raise ZeroDivisionError('a bug')
    recording = record(flush_interval_s=0.001)
    monkeypatch.setattr(BagWriter, 'write', fail)
    send(recording, [1])
    wait_until(lambda: recording.status().state == 'stopped')
    assert recording.status().topics['/a'] == (0, 0, 1)
    assert "the writer failed: ZeroDivisionError('a bug')" in close(recording)


def test_a_folder_that_is_there_is_not_written_into(record, tmp_path):
    (tmp_path / 'flight').mkdir()
    with pytest.raises(RecordingError, match='flight: cannot make a new recording: .*exists'):
        record()


def test_syncing_is_done_by_a_thread_of_its_own_and_once_more_at_the_end(record, monkeypatch):
    synced, whole, fdatasync = [], [], os.fdatasync

    def note_sync(descriptor):
        path = Path(os.readlink(f'/proc/self/fd/{descriptor}'))
        synced.append((threading.current_thread().name, path.name))
        if path.suffix == '.mcap' and not is_cut(path):
            whole.append(path.name)
        fdatasync(descriptor)
    monkeypatch.setattr(os, 'fdatasync', note_sync)
    recording = record(sync_interval_s=0.01)
    send(recording, [1])
    wait_until(lambda: {name for _, name in synced} == {'flight_0.mcap', 'flight'})
    assert {thread for thread, _ in synced} == {'recording_keeper'}
    assert whole == []
    recording.close()
    assert whole == ['flight_0.mcap']


def test_a_file_that_ended_is_synced_once_more(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(bag_writer, 'sync', lambda path: synced.append(path.name))
    writer = BagWriter(tmp_path / 'flight')
    writer.add_topic('/a', TYPE)
    writer.write('/a', note(1), 1, 1)
    writer.split()
    writer.sync()
    assert synced == ['flight_0.mcap', 'flight']
    writer.sync()
    assert synced[2:] == ['flight']
    writer.close()


def test_nothing_is_synced_where_that_is_not_wished_for(record, monkeypatch):
    monkeypatch.setattr(os, 'fdatasync', lambda _: pytest.fail('synced'))
    recording = record(sync_interval_s=0.0)
    send(recording, [1])
    recording.close()
    assert recording.status().error == ''


def test_metadata_that_cannot_be_written_are_told_until_they_can(record, monkeypatch):
    def fail(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')
    recording = record()
    with monkeypatch.context() as full:
        full.setattr(os, 'replace', fail)
        send(recording, [1])
        wait_until(lambda: recording.status().error == (
            f'{recording.directory / "metadata.yaml"}: cannot be written: '
            'No space left on device'))
    recording.split().result(TIMEOUT_S)
    wait_until(lambda: recording.status().error == '')
    assert information_of(recording)['message_count'] == 1
    assert not (recording.directory / 'metadata.yaml.part').exists()


def test_a_folder_that_no_sync_is_known_for_is_no_failure(record, monkeypatch):
    def fail(_):
        raise OSError(errno.EINVAL, 'Invalid argument')
    monkeypatch.setattr(os, 'fdatasync', fail)
    recording = record(sync_interval_s=0.01)
    recording.close()
    assert recording.status().error == ''


def test_a_sync_that_fails_is_told(record, monkeypatch):
    fdatasync = os.fdatasync

    def fail(_):
        monkeypatch.setattr(os, 'fdatasync', fdatasync)  # the system tells it once
        raise OSError(errno.EIO, 'Input/output error')
    monkeypatch.setattr(os, 'fdatasync', fail)
    recording = record(sync_interval_s=0.01)
    wait_until(lambda: 'cannot be synced: Input/output error' in recording.status().error)
    assert send(recording, [1]) == [1]
    assert 'cannot be synced' in close(recording)
    assert numbers_of(recording.directory) == [1]


def test_a_clock_that_falls_back_begins_a_file(tmp_path):
    with BagWriter(tmp_path / 'bag', RecorderConfig(max_duration_s=1.0)) as writer:
        writer.add_topic('/a', TYPE)
        for k, time_s in enumerate([100.0, 100.9, 10.0, 10.9, 11.0]):
            writer.write('/a', note(k), round(time_s * 1e9), 0)
    assert [len(list(read_bag(tmp_path / 'bag' / f'bag_{k}.mcap'))) for k in range(3)] == [2, 2, 1]


def test_a_snapshot_holds_the_last_seconds_also_of_a_clock_that_fell_back():
    buffer = SnapshotBuffer(5.0, 2**20)
    for time_s in (*range(100), *range(50)):
        buffer.add(QueuedMessage('/a', b'', time_s * 10**9, 0, 0))
    assert [message.log_time_ns // 10**9 for message in buffer.take()] == list(range(44, 50))


def test_a_folder_whose_name_no_metadata_can_tell_is_refused(tmp_path):
    with pytest.raises(RecordingError, match='cannot make a new recording: .*surrogates'):
        BagWriter(tmp_path / os.fsdecode(b'\xff'))
    assert [path.name for path in tmp_path.iterdir()] == ['prefix']


def test_a_keeper_that_died_is_told(record, monkeypatch):
    recording = record()
    monkeypatch.setattr(BagWriter, 'tidy', Mock(side_effect=ValueError('broken')))
    send(recording, range(1))
    recording._keeper._thread.join(10.0)
    assert "the keeper failed: ValueError('broken')" in recording.status().error
    monkeypatch.undo()
    with pytest.raises(RecordingError, match='the keeper failed'):
        recording.close()
