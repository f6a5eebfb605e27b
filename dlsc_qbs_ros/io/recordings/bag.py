"""Recordings: MCAP files and rosbag2 folders, read as they come, whoever wrote them."""

from __future__ import annotations

import heapq
from pathlib import Path
from typing import Collection, Iterator

from .bag_metadata import METADATA_FILE, read_information
from .mcap_file import BagMessage, file_messages, file_topics, RecordedTopic
from ...errors import RecordingError


def bag_topics(path: Path) -> dict[str, str]:
    """Return the topics of a file or rosbag2 folder with their types."""
    return {topic: recorded.type_name for topic, recorded in _topics(Path(path)).items()}


def latched_topics(path: Path) -> set[str]:
    """Return the topics whose last message was, in any file, meant for late subscribers too."""
    return {topic for file_path in _files(Path(path))
            for topic, recorded in file_topics(file_path).items() if recorded.is_latched}


def read_bag(path: Path, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
    """
    Read a file or rosbag2 folder, anybody's, several files too, in the order of log times.

    What each file of ours begins with, because it was latched in one before, is read once.

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
    files = _files(path)
    messages = heapq.merge(*(file_messages(file_path, wanted) for file_path in files),
                           key=lambda message: message.log_time_ns)
    yield from messages if len(files) == 1 else _once(messages, latched_topics(path))


def _once(messages: Iterator[BagMessage], latched: Collection[str]) -> Iterator[BagMessage]:
    seen = set()
    for message in messages:
        if message.topic in latched:
            identity = hash((message.topic, message.publish_time_ns, message.data))
            if identity in seen:
                continue
            seen.add(identity)
        yield message


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
    files = [path / name for name in _listed_files(path)]
    files = files or sorted(path.glob('*.mcap'))
    if not files:
        raise RecordingError(f'{path}: no MCAP file in this folder')
    for file_path in files:
        if not file_path.is_file():
            raise RecordingError(f'{file_path}: named in metadata.yaml, but not there')
    return files


def _listed_files(directory: Path) -> list[str]:
    information = read_information(directory)
    mode = str(information.get('compression_mode') or 'none').lower()
    if mode != 'none':  # inside a file, MCAP's own compression is welcome
        raise RecordingError(
            f'{directory / METADATA_FILE}: compressed by rosbag2, '
            f'{information.get("compression_format")} per {mode}; expected compression_mode none')
    return information.get('relative_file_paths', [])
