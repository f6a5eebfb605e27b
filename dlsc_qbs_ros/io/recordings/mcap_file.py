"""One MCAP file of ROS 2 messages, finished or cut short."""

from __future__ import annotations

import logging
from pathlib import Path
import re
import struct
from typing import Collection, IO, Iterator, NamedTuple

from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from ...errors import RecordingError

_log = logging.getLogger(__name__)
_RECORD_LIMIT_BYTES = 2**31


class BagMessage(NamedTuple):
    """One recorded message: `data` is its CDR payload with the 4-byte header."""

    topic: str
    type_name: str
    data: bytes
    log_time_ns: int
    publish_time_ns: int


class RecordedTopic(NamedTuple):
    """A topic of a recording; a latched one was offered as transient local."""

    type_name: str
    is_latched: bool


def file_topics(path: Path) -> dict[str, RecordedTopic]:
    """
    Return the topics of a file; one in another encoding than CDR is left out, with a warning.

    A file that was cut before its first topic has none.

    Raises
    ------
    RecordingError
        When the file cannot be read, is no MCAP file or is damaged.

    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    with opened(path) as stream:
        if not is_finished(stream):
            _collect(_records_before_cut(path, stream), schemas, channels)
        else:
            try:
                summary = make_reader(stream, validate_crcs=True).get_summary()
                if summary is not None and summary.channels:
                    schemas, channels = summary.schemas, summary.channels
                else:
                    stream.seek(0)
                    _collect(StreamReader(stream, validate_crcs=True).records, schemas, channels)
            except Exception as error:  # whatever the parser stumbles over, the file is the cause
                raise _damaged(path, error) from error
    return {channel.topic: RecordedTopic(schemas[channel.schema_id].name, _is_latched(channel))
            for channel in channels.values() if _is_ros2(path, channel, schemas)}


def file_messages(path: Path, topics: Collection[str]) -> Iterator[BagMessage]:
    """
    Read the messages of some topics in the order of log times.

    A file whose end is missing is read up to the cut, in the order it was written; a warning names
    it.

    Raises
    ------
    RecordingError
        When the file is damaged before its end.

    """
    with opened(path) as stream:
        if not is_finished(stream):
            yield from _messages_before_cut(path, stream, topics)
            return
        messages = make_reader(stream, validate_crcs=True).iter_messages(topics=list(topics))
        while True:
            try:
                schema, channel, message = next(messages)
            except StopIteration:
                return
            except Exception as error:  # as above
                raise _damaged(path, error) from error
            yield _bag_message(schema, channel, message)


def _messages_before_cut(path: Path, stream: IO[bytes], topics: Collection[str]
                         ) -> Iterator[BagMessage]:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    n_messages = 0
    for record in _records_before_cut(path, stream):
        _collect((record,), schemas, channels)
        if isinstance(record, Message):
            channel = channels[record.channel_id]
            if channel.topic in topics:
                n_messages += 1
                yield _bag_message(schemas[channel.schema_id], channel, record)
    _log.warning('%s: cut short, its end is missing: %d messages before the cut were read',
                 path, n_messages)


def _records_before_cut(path: Path, stream: IO[bytes]) -> Iterator:
    records = StreamReader(
        stream, validate_crcs=True, record_size_limit=_RECORD_LIMIT_BYTES).records
    while True:
        try:
            record = next(records)
        except (StopIteration, EndOfFile, struct.error):  # how the parser meets the cut
            return
        except Exception as error:  # whatever the parser stumbles over, the file is the cause
            raise _damaged(path, error) from error
        yield record


def _collect(records, schemas: dict[int, Schema], channels: dict[int, Channel]) -> None:
    for record in records:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record


def _bag_message(schema: Schema, channel: Channel, message: Message) -> BagMessage:
    return BagMessage(
        channel.topic, schema.name, message.data, message.log_time, message.publish_time)


def _is_ros2(path: Path, channel: Channel, schemas: dict[int, Schema]) -> bool:
    if channel.message_encoding == 'cdr' and channel.schema_id in schemas:
        return True
    _log.warning('%s: topic %s is left out: its encoding is %r, expected cdr with a schema',
                 path, channel.topic, channel.message_encoding)
    return False


def _is_latched(channel: Channel) -> bool:
    """Look for rosbag2's word for transient local, or the number that it wrote before Jazzy."""
    profiles = channel.metadata.get('offered_qos_profiles', '')
    return re.search(r'durability: (transient_local|1)\b', profiles) is not None


def opened(path: Path) -> IO[bytes]:
    try:
        stream = open(path, 'rb')
    except OSError as error:
        raise RecordingError(f'{path}: cannot be read: {error.strerror}') from error
    magic = stream.read(len(MCAP0_MAGIC))
    if magic != MCAP0_MAGIC:
        stream.close()
        raise RecordingError(f'{path}: not an MCAP file, it starts with {magic!r}')
    stream.seek(0)
    return stream


def is_finished(stream: IO[bytes]) -> bool:
    """Tell whether the file ends as a finished one does; leave the stream at its start."""
    size = stream.seek(0, 2)
    stream.seek(max(size - len(MCAP0_MAGIC), len(MCAP0_MAGIC)))
    finished = stream.read() == MCAP0_MAGIC
    stream.seek(0)
    return finished


def _damaged(path: Path, error: Exception) -> RecordingError:
    return RecordingError(f'{path}: damaged: {error or type(error).__name__}')
