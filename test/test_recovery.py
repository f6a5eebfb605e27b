"""What a crash cut short is repaired: every whole message, an index, and true metadata."""

import os
from pathlib import Path
import struct
import subprocess
import sys

from dlsc_qbs_ros.cli import recover as command
from dlsc_qbs_ros.config import RecorderConfig
from dlsc_qbs_ros.errors import RecordingError
from dlsc_qbs_ros.io.recordings import mcap_repair
from dlsc_qbs_ros.io.recordings.bag import bag_topics, latched_topics, read_bag
from dlsc_qbs_ros.io.recordings.bag_writer import BagWriter
from dlsc_qbs_ros.io.recordings.ballast import BALLAST_FILE
from dlsc_qbs_ros.io.recordings.mcap_repair import is_cut, RECOVERED, Repair
from dlsc_qbs_ros.io.recordings.mcap_writer import McapWriter
from dlsc_qbs_ros.io.recordings.recovery import recover, repair_earlier
from mcap.reader import make_reader
from mcap.writer import Writer
import pytest
from recordings import install_definitions, note, SmallDisk, TYPE
import yaml

LATCHED = [{'durability': 'transient_local', 'reliability': 'reliable'}]
N_MESSAGES, PER_CHUNK = 100, 10


@pytest.fixture(autouse=True)
def definitions(tmp_path, monkeypatch):
    install_definitions(tmp_path / 'prefix', monkeypatch)


def write(directory, numbers=range(N_MESSAGES), **parameters):
    """Record messages, ten to a chunk; return the folder."""
    with BagWriter(directory, RecorderConfig(**parameters)) as writer:
        writer.add_topic('/a', TYPE, LATCHED)
        writer.attach('config.yaml', 'text/yaml', b'a: 1\n')
        for k in numbers:
            writer.write('/a', note(k, 500), 1000 + k, k, k + 7)
            if k % PER_CHUNK == PER_CHUNK - 1:
                writer.flush()
    return directory


def crash(directory, n_bytes_gone=300, files=slice(-1, None)):
    """Leave a folder as a crash does: the last file without its end, the ballast, old metadata."""
    for path in sorted(directory.glob('*.mcap'))[files]:
        os.truncate(path, path.stat().st_size - n_bytes_gone)
    (directory / BALLAST_FILE).write_bytes(b'')
    document = yaml.safe_load((directory / 'metadata.yaml').read_text())
    information = document['rosbag2_bagfile_information']
    information.update(message_count=1, relative_file_paths=information['relative_file_paths'][:1])
    (directory / 'metadata.yaml').write_text(yaml.safe_dump(document))


def numbers_of(path):
    return [int(m.data[12:].rstrip(b'.\0')) for m in read_bag(path)]


def information_of(directory):
    document = yaml.safe_load((directory / 'metadata.yaml').read_text())
    return document['rosbag2_bagfile_information']


def without_end(path):
    """Return the content of a file up to the last chunk's index."""
    content = path.read_bytes()
    with open(path, 'rb') as stream:
        last = make_reader(stream).get_summary().chunk_indexes[-1]
    return content[:last.chunk_start_offset + last.chunk_length + last.message_index_length]


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_all_that_is_whole_comes_back_with_its_index(tmp_path, compression):
    directory = write(tmp_path / 'flight', compression=compression)
    path = directory / 'flight_0.mcap'
    with open(path, 'rb') as stream:
        reader = make_reader(stream)
        before = list(reader.iter_messages())
        n_chunks = len(reader.get_summary().chunk_indexes)
    path.write_bytes(without_end(path))
    assert list(recover(path)) == [Repair(path, N_MESSAGES, 0)]
    with open(path, 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert list(reader.iter_messages()) == before
        summary = reader.get_summary()
        assert {a.name: a.data for a in reader.iter_attachments()} == {'config.yaml': b'a: 1\n'}
    assert {index.compression for index in summary.chunk_indexes} == {
        compression.replace('none', '')}
    assert len(summary.chunk_indexes) == n_chunks
    assert latched_topics(path) == {'/a'}


def test_a_file_cut_anywhere_gives_every_whole_chunk(tmp_path):
    whole = write(tmp_path / 'flight') / 'flight_0.mcap'
    content = without_end(whole)
    with open(whole, 'rb') as stream:
        ends = [index.chunk_start_offset + index.chunk_length
                for index in make_reader(stream).get_summary().chunk_indexes]
    path = tmp_path / 'alone.mcap'
    for size in range(0, len(content), 997):
        path.write_bytes(content[:size])
        repair, = recover(path)
        n_chunks = sum(end <= size for end in ends)
        assert numbers_of_whole(path) == list(range(n_chunks * PER_CHUNK))
        assert repair[:2] == (path, n_chunks * PER_CHUNK)
        assert 0 <= repair.lost_bytes < 7000


def numbers_of_whole(path):
    assert not is_cut(path)
    with open(path, 'rb') as stream:
        return [int(message.data[12:].rstrip(b'.\0')) for _, _, message in
                make_reader(stream, validate_crcs=True).iter_messages()]


def test_a_file_that_lost_only_its_index_lost_nothing(tmp_path):
    directory = write(tmp_path / 'flight')
    path = directory / 'flight_0.mcap'
    n_index = path.stat().st_size - len(without_end(path))
    for n_gone in (1, 8, 50, n_index // 2):
        os.truncate(path, path.stat().st_size - n_gone)
        repair, = recover(path)
        assert repair == (path, N_MESSAGES, 0, '')


def test_what_was_left_out_stands_in_the_file(tmp_path):
    path = write(tmp_path / 'flight') / 'flight_0.mcap'
    content = without_end(path)[:-2000]
    path.write_bytes(content)
    repair, = recover(path)
    assert 3000 < repair.lost_bytes < 5000
    with open(path, 'rb') as stream:
        words, = (m.metadata for m in make_reader(stream).iter_metadata() if m.name == RECOVERED)
    assert words == {'size_bytes': str(len(content)), 'lost_bytes': str(repair.lost_bytes)}


def test_a_damaged_chunk_is_left_out_and_the_rest_comes_back(tmp_path):
    path = write(tmp_path / 'flight') / 'flight_0.mcap'
    content = bytearray(without_end(path))
    content[content.index(note(34, 500)) + 100] ^= 1
    path.write_bytes(content)
    repair, = recover(path)
    expected = [k for k in range(N_MESSAGES) if not 30 <= k < 40]
    assert numbers_of(path) == expected
    assert repair.n_messages == len(expected)
    assert 5000 < repair.lost_bytes < 6000


def test_zeros_at_the_end_as_a_power_cut_leaves_them_are_left_out(tmp_path):
    path = write(tmp_path / 'flight') / 'flight_0.mcap'
    path.write_bytes(without_end(path) + bytes(4096))
    assert list(recover(path)) == [Repair(path, N_MESSAGES, 4096)]


def test_recovering_twice_is_recovering_once(tmp_path):
    directory = write(tmp_path / 'flight')
    crash(directory)
    assert len(list(recover(directory))) == 1
    before = (directory / 'flight_0.mcap').read_bytes()
    assert list(recover(directory)) == []
    assert (directory / 'flight_0.mcap').read_bytes() == before


def test_the_metadata_of_a_folder_tell_what_is_there_again(tmp_path):
    directory = write(tmp_path / 'flight', max_duration_s=8e-9)
    expected = information_of(directory)
    assert len(expected['files']) == 13
    crash(directory, n_bytes_gone=1)
    assert len(list(recover(directory))) == 1
    assert information_of(directory) == expected
    assert numbers_of(directory) == list(range(N_MESSAGES))
    assert sorted(path.name for path in directory.iterdir() if path.suffix != '.mcap') == [
        'metadata.yaml']


def test_metadata_that_are_missing_are_written_and_damaged_ones_replaced(tmp_path):
    directory = write(tmp_path / 'flight')
    expected = information_of(directory)
    for ruin in (lambda path: path.unlink(), lambda path: path.write_text('rosbag2_bagf')):
        crash(directory, n_bytes_gone=1)
        ruin(directory / 'metadata.yaml')
        assert len(list(recover(directory))) == 1
        assert information_of(directory) == expected


def test_a_file_of_the_folder_that_cannot_be_listed_is_told(tmp_path):
    directory = write(tmp_path / 'flight')
    crash(directory)
    with open(directory / 'flight_1.mcap', 'wb') as stream:
        writer = Writer(stream, use_statistics=False)
        writer.start('ros2')
        writer.finish()
    *repairs, listing = recover(directory)
    assert repairs == [Repair(directory / 'flight_0.mcap', N_MESSAGES, 0)]
    assert listing.error == (f'{directory}: metadata.yaml is not rewritten: '
                             f'{directory / "flight_1.mcap"}: its index lacks statistics')


def test_a_file_that_is_no_part_of_a_recording_gets_no_metadata(tmp_path):
    path = write(tmp_path / 'flight') / 'flight_0.mcap'
    alone = tmp_path / 'downloads' / 'some.mcap'
    alone.parent.mkdir()
    alone.write_bytes(without_end(path))
    assert list(recover(alone)) == [Repair(alone, N_MESSAGES, 0)]
    assert [path.name for path in alone.parent.iterdir()] == ['some.mcap']


def test_recordings_of_others_are_recovered(tmp_path):
    path = tmp_path / 'theirs.mcap'
    with open(path, 'wb') as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start('ros2')
        schema = writer.register_schema(TYPE, 'ros2msg', b'string data')
        channels = [writer.register_channel('/a', 'cdr', schema) for _ in range(2)]
        for k in range(10):
            writer.add_message(channels[k % 2], k, note(k), k)
    assert list(recover(path)) == [Repair(path, 10, 0)]
    assert numbers_of(path) == list(range(10))


def test_what_earlier_runs_left_is_repaired_when_the_next_starts(tmp_path):
    runs = [write(tmp_path / f'run_{k}', max_duration_s=40e-9) for k in range(3)]
    crash(runs[0])
    crash(runs[2], files=slice(None))
    repairs = list(repair_earlier(tmp_path))
    assert [repair.path.name for repair in repairs] == [
        'run_0_2.mcap', 'run_2_0.mcap', 'run_2_1.mcap', 'run_2_2.mcap']
    for run in runs:
        assert not any(map(is_cut, run.glob('*.mcap')))
        n_messages = sum(len(numbers_of(path)) for path in run.glob('*.mcap'))
        assert information_of(run)['message_count'] == n_messages >= 90
        assert not (run / BALLAST_FILE).exists()
    assert list(repair_earlier(tmp_path)) == []


def test_a_recording_under_way_is_left_alone(tmp_path):
    with BagWriter(tmp_path / 'flight') as writer:
        writer.add_topic('/a', TYPE)
        writer.write('/a', note(1), 1, 1)
        writer.flush()
        assert list(repair_earlier(tmp_path)) == []
        with pytest.raises(RecordingError, match='flight: is being written'):
            list(recover(tmp_path / 'flight'))
    assert numbers_of(tmp_path / 'flight') == [1]


def test_cut_files_of_others_are_left_alone_unless_asked_for(tmp_path):
    path = write(tmp_path / 'flight') / 'flight_0.mcap'
    content = without_end(path)
    path.write_bytes(content.replace(b'dlsc_qbs_ros', b'other_writer'))
    assert list(repair_earlier(tmp_path)) == []
    assert len(list(recover(path))) == 1


def test_a_file_of_another_that_still_holds_its_header_back_is_left_alone(tmp_path):
    path = tmp_path / 'theirs' / 'theirs_0.mcap'
    path.parent.mkdir()
    with open(path, 'wb') as stream:
        writer = Writer(stream)
        writer.start('ros2')
        assert path.stat().st_size == 0  # it stands in the stream's buffer
        assert list(repair_earlier(tmp_path)) == []
        schema = writer.register_schema(TYPE, 'ros2msg', b'string data')
        writer.add_message(writer.register_channel('/a', 'cdr', schema), 0, note(7), 0)
        writer.finish()
    assert numbers_of(path) == [7]


def test_an_empty_file_beside_the_ballast_is_ours_and_repaired(tmp_path):
    directory = write(tmp_path / 'flight')
    crash(directory)
    os.truncate(directory / 'flight_0.mcap', 0)
    assert list(repair_earlier(tmp_path)) == [Repair(directory / 'flight_0.mcap', 0, 0)]


def test_a_link_to_a_file_stays_one_and_gives_no_way_round_the_lock(tmp_path):
    link = tmp_path / 'latest.mcap'
    link.symlink_to(tmp_path / 'flight' / 'flight_0.mcap')
    with BagWriter(tmp_path / 'flight') as writer:
        writer.add_topic('/a', TYPE)
        writer.write('/a', note(1), 1, 1)
        writer.flush()
        assert list(repair_earlier(tmp_path)) == []
        with pytest.raises(RecordingError, match='flight_0.mcap: is being written'):
            list(recover(link))
    crash(tmp_path / 'flight')
    assert list(recover(link)) == [Repair(link.resolve(), 1, 0)]
    assert link.is_symlink() and numbers_of(link) == [1]


def test_messages_of_a_damaged_channel_are_left_out_and_the_rest_comes_back(tmp_path):
    path = tmp_path / 'some.mcap'
    writer = McapWriter(path)
    schema = writer.add_schema(TYPE, 'ros2msg', b'string data')
    starts = []
    for topic in ('/a', '/b'):
        starts.append(writer.size_bytes)
        channel = writer.add_channel(topic, schema, {})
        writer.write(channel, note(channel), 1, 1)
    writer.flush()
    writer.close()
    content = bytearray(path.read_bytes())
    content[starts[0] + 13:starts[0] + 17] = b'\xff' * 4  # the length of its name
    path.write_bytes(content)
    repair, = recover(path)
    assert repair.n_messages == 1 and repair.lost_bytes > 0
    assert numbers_of(path) == [2]


@pytest.mark.parametrize('damage, why', [
    (lambda path: path.write_bytes(b'\x89MCAP0\r\n' + b'\x14' * 60 + b'\x89MCAP0\r\n'),
     'its index cannot be read'),
    (lambda path: path.unlink() or without_a_type(path), '/a has no type')])
def test_a_file_that_cannot_be_listed_hinders_no_other_repair(tmp_path, damage, why):
    runs = [write(tmp_path / name, max_duration_s=40e-9) for name in ('first', 'second')]
    for run in runs:
        crash(run)
    damage(runs[0] / 'first_0.mcap')
    repairs = list(repair_earlier(tmp_path))
    assert [repair.path.name for repair in repairs] == [
        'first_2.mcap', 'first', 'second_2.mcap']
    assert why in repairs[1].error


def without_a_type(path):
    writer = McapWriter(path)
    writer.write(writer.add_channel('/a', 0, {}, 'json'), b'{}', 1, 1)
    writer.finish({})


def test_how_others_compressed_their_messages_stays_in_the_metadata(tmp_path):
    directory = write(tmp_path / 'flight')
    crash(directory)
    document = yaml.safe_load((directory / 'metadata.yaml').read_text())
    how = {'compression_format': 'zstd', 'compression_mode': 'MESSAGE'}
    document['rosbag2_bagfile_information'].update(how)
    (directory / 'metadata.yaml').write_text(yaml.safe_dump(document))
    list(recover(directory))
    assert how.items() <= information_of(directory).items()


def test_a_file_that_cannot_be_rewritten_stays_as_it_is_and_is_told(tmp_path, monkeypatch):
    directory = write(tmp_path / 'flight')
    crash(directory)
    before = (directory / 'flight_0.mcap').read_bytes()
    SmallDisk(directory, monkeypatch, len(before) + 30_000)
    repair, = repair_earlier(tmp_path)
    assert repair.error == (
        f'{directory / "flight_0.mcap"}: cannot be rewritten: No space left on device')
    monkeypatch.setattr(mcap_repair, 'free_bytes', lambda path: 1000)
    repair, = recover(directory)
    assert repair.error.endswith(f'{len(before)} bytes are needed, 1000 are free')
    assert (directory / 'flight_0.mcap').read_bytes() == before
    assert {path.name for path in directory.iterdir()} <= {
        'flight_0.mcap', 'metadata.yaml', BALLAST_FILE}


def test_a_repair_that_was_cut_itself_is_begun_again(tmp_path):
    directory = write(tmp_path / 'flight')
    crash(directory)
    (directory / '.flight_0.mcap.recovered').write_bytes(b'half of it')
    assert len(list(recover(directory))) == 1
    assert len(numbers_of(directory)) == N_MESSAGES
    assert not (directory / '.flight_0.mcap.recovered').exists()


@pytest.mark.parametrize('content', [b'#ROSBAG V2.0\n', struct.pack('<Q', 0)])
def test_what_is_no_mcap_file_is_refused(tmp_path, content):
    path = tmp_path / 'file.mcap'
    path.write_bytes(content)
    with pytest.raises(RecordingError, match='file.mcap: not an MCAP file, it starts with'):
        list(recover(path))
    assert list(repair_earlier(tmp_path)) == []


KILLED = '''
import itertools, sys, time
from dlsc_qbs_ros.io.recordings.recording import Recording
from recordings import note, TYPE
recording = Recording(sys.argv[1])
recording.add_topic('/a', TYPE)
for k in itertools.count():
    recording.write('/a', note(k, 5000), k, k)
    if recording.status().topics['/a'].written >= 1000:
        print(k, flush=True)
'''


def test_nothing_that_was_written_dies_with_its_process(tmp_path):
    root = Path(__file__).parents[1]
    process = subprocess.Popen(
        [sys.executable, '-c', KILLED, tmp_path / 'flight'], stdout=subprocess.PIPE, text=True,
        env={**os.environ, 'PYTHONPATH': f'{root}:{root / "test"}'})
    process.stdout.readline()
    process.kill()
    process.communicate()
    repair, = repair_earlier(tmp_path)
    assert repair.error == '' and repair.n_messages >= 1000
    assert numbers_of(tmp_path / 'flight') == list(range(repair.n_messages))
    assert information_of(tmp_path / 'flight')['message_count'] == repair.n_messages


def test_the_command_says_what_it_did(tmp_path, capsys):
    directory = write(tmp_path / 'flight')
    crash(directory)
    path = directory / 'flight_0.mcap'
    assert command.main([str(directory)]) == 0
    assert capsys.readouterr().out == (
        f'{path}: {N_MESSAGES} messages recovered, 0 bytes left out\n')
    assert command.main([str(path)]) == 0
    assert capsys.readouterr().out == f'{path}: whole, nothing to repair\n'
    assert bag_topics(directory) == {'/a': TYPE}


@pytest.mark.parametrize('make, error', [
    (lambda folder: folder / 'nothing.mcap', 'nothing.mcap: cannot be read: No such file'),
    (lambda folder: folder, 'no MCAP file in this folder')])
def test_the_command_says_why_it_could_not(tmp_path, capsys, make, error):
    assert command.main([str(make(tmp_path))]) == 1
    assert error in capsys.readouterr().err


def test_the_command_repairs_what_it_can_and_fails_for_the_rest(tmp_path, capsys, monkeypatch):
    directory = write(tmp_path / 'flight')
    crash(directory)
    monkeypatch.setattr(mcap_repair, 'free_bytes', lambda path: 0)
    assert command.main([str(directory)]) == 1
    output = capsys.readouterr()
    assert 'flight_0.mcap: cannot be rewritten' in output.out
    assert output.err == 'recover: not repaired: 1\n'
