"""Recordings that a crash cut short: their files repaired, their metadata as they are."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
import re
import struct
from typing import Any, Iterator

from mcap.exceptions import McapError
from mcap.reader import make_reader
import yaml

from .bag_metadata import (
    bag_information, FileSummary, METADATA_FILE, read_information, topic_metadata,
    write_information)
from .ballast import BALLAST_FILE
from .mcap_repair import header_of, is_cut, Repair, rewrite
from .mcap_writer import LIBRARY
from ..disk import locked
from ...errors import RecordingError

# What `metadata.yaml` says that the files do not.
_KEPT = ('compression_format', 'compression_mode', 'custom_data', 'ros_distro')


def repair_earlier(folder: Path) -> Iterator[Repair]:
    """
    Repair what a crash of this package left in a folder or in one below, whole or not.

    A recording that is being written is left alone; what cannot be repaired is told as well.
    """
    folder = Path(folder)
    directories = {path.parent for pattern in ('*.mcap', '*/*.mcap')
                   for path in folder.glob(pattern)}
    for directory in sorted(directories):
        with locked(directory) as is_held:
            if is_held:
                yield from _repaired(directory, [
                    path for path in _files(directory)
                    if not path.is_symlink() and _is_ours_and_cut(path)])


def recover(path: Path) -> Iterator[Repair]:
    """
    Repair a file, or all of a folder, whoever wrote it; its metadata too where it is rosbag2's.

    Raises
    ------
    RecordingError
        When it is no recording or is being written.

    """
    path = Path(path)
    if path.is_symlink():  # the file behind it is repaired, where a writer would hold a lock
        path = path.resolve()
    directory = path if path.is_dir() else path.parent
    files = _files(path) if path.is_dir() else [path]
    if not files:
        raise RecordingError(f'{path}: no MCAP file in this folder')
    cut = [file for file in files if is_cut(file)]
    with locked(directory) as is_held:
        if not is_held:
            raise RecordingError(f'{path}: is being written')
        yield from _repaired(directory, cut)


def _repaired(directory: Path, cut: list[Path]) -> Iterator[Repair]:
    """Repair the files; where a crash was, bring the metadata of the folder up to date."""
    ballast = directory / BALLAST_FILE
    for path in cut:
        try:
            yield rewrite(path)
        except RecordingError as error:
            yield Repair(path, 0, 0, str(error))
    if cut or ballast.exists():
        try:
            _list_again(directory)
            ballast.unlink(missing_ok=True)
        except (OSError, RecordingError) as error:
            yield Repair(directory, 0, 0, f'{directory}: metadata.yaml is not rewritten: {error}')


def _is_ours_and_cut(path: Path) -> bool:
    try:
        if not is_cut(path):
            return False
        header = header_of(path)
        if header is None:  # another recorder may hold it back, as it does its first chunk
            return (path.parent / BALLAST_FILE).exists()
        return header.library == LIBRARY
    except RecordingError:  # whatever it is, it is not for us to repair
        return False


def _files(directory: Path) -> list[Path]:
    """Return the MCAP files of a folder, the tenth after the ninth."""
    return sorted(directory.glob('*.mcap'), key=lambda path: [
        int(word) if word.isdigit() else word for word in re.split(r'(\d+)', path.name)])


def _list_again(directory: Path) -> None:
    """Rewrite `metadata.yaml` from the files of a rosbag2 folder."""
    files = _files(directory)
    if not (directory / METADATA_FILE).exists() and not all(re.fullmatch(
            rf'{re.escape(directory.resolve().name)}_\d+', path.stem) for path in files):
        return  # single files, no recording of rosbag2
    topics: dict[str, dict[str, Any]] = {}
    summaries = [_summary(path, topics) for path in files]
    information = bag_information(topics.values(), summaries)
    with suppress(RecordingError):  # those that are no metadata any more
        kept = read_information(directory)
        information.update({key: kept[key] for key in _KEPT if key in kept})
    write_information(directory, information, synced=True)


def _summary(path: Path, topics: dict[str, dict[str, Any]]) -> FileSummary:
    """Return what the index of a file says; add its topics."""
    if is_cut(path):
        return FileSummary(path.name, {}, 0, 0)
    try:
        with open(path, 'rb') as stream:
            summary = make_reader(stream).get_summary()
    except (McapError, ValueError, struct.error) as error:
        raise RecordingError(f'{path}: its index cannot be read: {error!r}') from error
    if summary is None or summary.statistics is None:
        raise RecordingError(f'{path}: its index lacks statistics')
    counts = {}
    for key, channel in summary.channels.items():
        profiles = yaml.safe_load(channel.metadata.get('offered_qos_profiles', '')) or []
        if channel.schema_id not in summary.schemas:
            raise RecordingError(f'{path}: {channel.topic} has no type')
        topics[channel.topic] = topic_metadata(
            channel.topic, summary.schemas[channel.schema_id].name, profiles,
            channel.metadata.get('topic_type_hash', ''))
        n_messages = summary.statistics.channel_message_counts.get(key, 0)
        counts[channel.topic] = counts.get(channel.topic, 0) + n_messages
    statistics = summary.statistics
    return FileSummary(
        path.name, counts, statistics.message_start_time, statistics.message_end_time)
