"""The metadata of a rosbag2 folder, version 9, as rosbag2 Jazzy writes it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, Iterable, Mapping, NamedTuple

import yaml

from ..disk import replacement
from ...errors import RecordingError

METADATA_FILE = 'metadata.yaml'


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):
    """The fastest one there is, which writes what two topics share twice."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


class FileSummary(NamedTuple):
    """One file of a recording: its messages by topic, its first and last log time."""

    name: str
    counts: Mapping[str, int]
    first_ns: int
    last_ns: int


def topic_metadata(topic: str, type_name: str, offered_qos: Iterable[Mapping[str, Any]],
                   type_hash: str) -> dict[str, Any]:
    """Describe a topic; `offered_qos` holds one mapping of rosbag2's words per publisher."""
    return {
        'name': topic,
        'type': type_name,
        'serialization_format': 'cdr',
        'offered_qos_profiles': [dict(profile) for profile in offered_qos],
        'type_description_hash': type_hash}


def channel_metadata(topic: Mapping[str, Any]) -> dict[str, str]:
    """Return what the channel of a described topic says in a file."""
    profiles = topic['offered_qos_profiles']
    return {'offered_qos_profiles': to_yaml(profiles) if profiles else '',
            'topic_type_hash': topic['type_description_hash']}


def bag_information(topics: Iterable[Mapping[str, Any]], files: Iterable[FileSummary]
                    ) -> dict[str, Any]:
    """Describe a recording of these topics in these files."""
    files = list(files)
    counts = sum((Counter(file.counts) for file in files), Counter())
    filled = [file for file in files if file.counts]
    first_ns = min((file.first_ns for file in filled), default=0)
    last_ns = max((file.last_ns for file in filled), default=0)
    return {
        'version': 9,
        'storage_identifier': 'mcap',
        'duration': {'nanoseconds': last_ns - first_ns},
        'starting_time': {'nanoseconds_since_epoch': first_ns},
        'message_count': counts.total(),
        'topics_with_message_count': [
            {'topic_metadata': dict(topic), 'message_count': counts[topic['name']]}
            for topic in topics],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file.name for file in files],
        'files': [{
            'path': file.name,
            'starting_time': {'nanoseconds_since_epoch': file.first_ns},
            'duration': {'nanoseconds': file.last_ns - file.first_ns},
            'message_count': sum(file.counts.values())} for file in files],
        'custom_data': None,
        'ros_distro': 'jazzy',
    }


def to_yaml(value: Any) -> str:
    """Return a value as YAML, in the order of its keys."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False)


def write_information(directory: Path, information: Mapping[str, Any], synced: bool) -> None:
    """Replace `metadata.yaml` in one step."""
    text = to_yaml({'rosbag2_bagfile_information': information})
    with replacement(directory / METADATA_FILE, synced) as stream:
        stream.write(text.encode())


def read_information(directory: Path) -> dict[str, Any]:
    """
    Return what `metadata.yaml` says; nothing where a crash left no such file.

    Raises
    ------
    RecordingError
        When it is not the metadata of a recording.

    """
    path = directory / METADATA_FILE
    if not path.is_file():
        return {}
    try:
        information = yaml.safe_load(path.read_text())['rosbag2_bagfile_information']
        information['relative_file_paths'] = list(information['relative_file_paths'])
    except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError) as error:
        raise RecordingError(f'{path}: not the metadata of a rosbag2 recording') from error
    return information
