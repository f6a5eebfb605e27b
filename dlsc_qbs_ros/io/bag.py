"""Recordings: MCAP files and rosbag2 folders, written as rosbag2 Jazzy does, read as they come."""

from __future__ import annotations

from contextlib import contextmanager, suppress
import heapq
from pathlib import Path
from typing import Any, Collection, Iterator, Mapping, Sequence

from mcap.writer import CompressionType, Writer
import yaml

from .mcap_file import BagMessage, file_messages, file_topics, RecordedTopic
from .message_definitions import message_definition, type_hash
from ..errors import RecordingError


class BagWriter:
    """
    Write one rosbag2 folder: `<name>_0.mcap` and, when closed, `metadata.yaml`.

    A context manager; not thread-safe, so one thread owns it.

    Raises
    ------
    RecordingError
        When the folder is there already or cannot be made; from every method, when the disk
        refuses to be written to, and from then on.

    """

    def __init__(self, directory: Path):
        self.directory = Path(directory)
        self._path = self.directory / f'{self.directory.resolve().name}_0.mcap'
        try:
            self.directory.mkdir(parents=True)
            self._file = open(self._path, 'xb')
        except OSError as error:
            raise RecordingError(f'{directory}: cannot make a new recording: {error}') from error
        self._writer = Writer(self._file, compression=CompressionType.NONE)
        self._writer.start(profile='ros2', library='dlsc_qbs_ros')
        self._channels: dict[str, int] = {}
        self._topics: dict[str, dict[str, Any]] = {}
        self._first_ns = self._last_ns = 0
        self._error: RecordingError | None = None
        self.message_count = 0
        self.byte_count = 0

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def add_topic(self, topic: str, type_name: str,
                  offered_qos: Sequence[Mapping[str, Any]] = ()) -> None:
        """
        Announce a topic; `offered_qos` holds one mapping of rosbag2's words per publisher.

        Raises
        ------
        RecordingError
            When the definition of the type is not installed.

        """
        definition = message_definition(type_name)
        profiles = [dict(profile) for profile in offered_qos]
        words = yaml.safe_dump(profiles, sort_keys=False) if profiles else ''
        with self._writing():
            schema = self._writer.register_schema(type_name, 'ros2msg', definition.encode())
            self._channels[topic] = self._writer.register_channel(topic, 'cdr', schema, {
                'offered_qos_profiles': words, 'topic_type_hash': type_hash(type_name)})
        self._topics[topic] = {'message_count': 0, 'topic_metadata': {
            'name': topic,
            'type': type_name,
            'serialization_format': 'cdr',
            'offered_qos_profiles': profiles,
            'type_description_hash': type_hash(type_name)}}

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Write one serialised message of an announced topic."""
        with self._writing():
            self._writer.add_message(self._channels[topic], log_time_ns, data, publish_time_ns)
        first = self.message_count == 0
        self._first_ns = log_time_ns if first else min(self._first_ns, log_time_ns)
        self._last_ns = max(self._last_ns, log_time_ns)
        self._topics[topic]['message_count'] += 1
        self.message_count += 1
        self.byte_count += len(data)

    def close(self) -> None:
        """
        Finish the file and write `metadata.yaml`; closing again does nothing.

        A file that could not be written to its end stays unfinished, as one cut short.
        """
        if self._file.closed:
            return
        information = self._information()
        try:
            with self._writing():
                self._writer.add_metadata('rosbag2', {
                    'serialized_metadata': yaml.safe_dump(information, sort_keys=False)})
                self._writer.finish()
                self._file.close()
                self._write_metadata(information)
        except RecordingError:
            with suppress(OSError):
                self._file.close()
            with suppress(OSError):
                self._write_metadata(information)
            raise

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Turn the first refusal of the disk into an error, and raise it ever after."""
        if self._error is not None:
            raise self._error
        try:
            yield
        except OSError as error:
            self._error = RecordingError(f'{self._path}: cannot be written: {error.strerror}')
            raise self._error from error

    def _write_metadata(self, information: Mapping[str, Any]) -> None:
        path = self.directory / 'metadata.yaml'
        try:
            path.write_text(yaml.safe_dump(
                {'rosbag2_bagfile_information': information}, sort_keys=False))
        except OSError:
            path.unlink(missing_ok=True)  # half of it would make the recording unreadable
            raise

    def _information(self) -> dict[str, Any]:
        """Return the bag's description, version 9 of rosbag2's metadata."""
        duration = {'nanoseconds': max(self._last_ns - self._first_ns, 0)}
        start = {'nanoseconds_since_epoch': self._first_ns}
        return {
            'version': 9,
            'storage_identifier': 'mcap',
            'duration': duration,
            'starting_time': start,
            'message_count': self.message_count,
            'topics_with_message_count': list(self._topics.values()),
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [self._path.name],
            'files': [{
                'path': self._path.name,
                'starting_time': dict(start),
                'duration': dict(duration),
                'message_count': self.message_count}],
            'custom_data': None,
            'ros_distro': 'jazzy',
        }


def bag_topics(path: Path) -> dict[str, str]:
    """Return the topics of a file or rosbag2 folder with their types."""
    return {topic: recorded.type_name for topic, recorded in _topics(Path(path)).items()}


def latched_topics(path: Path) -> set[str]:
    """Return the topics whose last message is meant for late subscribers too."""
    return {topic for topic, recorded in _topics(Path(path)).items() if recorded.is_latched}


def read_bag(path: Path, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
    """
    Read a file or rosbag2 folder, anybody's, several files too, in the order of log times.

    A file whose end is missing is read up to the cut, in the order it was written, and a warning
    names it.

    Raises
    ------
    RecordingError
        When the path holds no recording, a file is damaged or a wanted topic is not in it.

    """
    path = Path(path)
    present = bag_topics(path)
    for topic in topics or ():
        if topic not in present:
            raise RecordingError(
                f'{path}: no topic {topic!r}; it has {", ".join(sorted(present)) or "none"}')
    wanted = set(present if topics is None else topics)
    yield from heapq.merge(
        *(file_messages(file_path, wanted) for file_path in _files(path)),
        key=lambda message: message.log_time_ns)


def _topics(path: Path) -> dict[str, RecordedTopic]:
    topics: dict[str, RecordedTopic] = {}
    for file_path in _files(path):
        topics.update(file_topics(file_path))
    return topics


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise RecordingError(f'{path}: no such file or folder')
    files = [path / name for name in _listed_files(path / 'metadata.yaml')]
    files = files or sorted(path.glob('*.mcap'))
    if not files:
        raise RecordingError(f'{path}: no MCAP file in this folder')
    for file_path in files:
        if not file_path.is_file():
            raise RecordingError(f'{file_path}: named in metadata.yaml, but not there')
    return files


def _listed_files(path: Path) -> list[str]:
    """Return the names that metadata.yaml lists; none where a crash left no such file."""
    if not path.is_file():
        return []
    try:
        information = yaml.safe_load(path.read_text())['rosbag2_bagfile_information']
        names = list(information['relative_file_paths'])
    except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError) as error:
        raise RecordingError(f'{path}: not the metadata of a rosbag2 recording') from error
    mode = str(information.get('compression_mode') or 'none').lower()
    if mode != 'none':  # inside a file, MCAP's own compression is welcome
        raise RecordingError(
            f'{path}: compressed by rosbag2, {information.get("compression_format")} per {mode}; '
            'expected compression_mode none')
    return names
