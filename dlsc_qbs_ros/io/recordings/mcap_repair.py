"""An MCAP file without its end: what is whole in it, rewritten with an index."""

from __future__ import annotations

from io import BytesIO
import os
from pathlib import Path
import struct
from typing import Iterator, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from .mcap_writer import McapWriter
from ..disk import free_bytes, sync
from ...errors import RecordingError

RECOVERED = 'dlsc_qbs_ros/recovered'
_RECORDS = {Opcode.HEADER: Header, Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel,
            Opcode.CHUNK: Chunk, Opcode.ATTACHMENT: Attachment, Opcode.METADATA: Metadata}
_HEAD = struct.Struct('<BQ')


class Repair(NamedTuple):
    """What became of a file: its messages, and the bytes in which not all is whole."""

    path: Path
    n_messages: int
    lost_bytes: int
    error: str = ''


def is_cut(path: Path) -> bool:
    """
    Tell whether the end of an MCAP file is missing.

    Raises
    ------
    RecordingError
        When it cannot be read or is no MCAP file.

    """
    try:
        with open(path, 'rb') as stream:
            start = stream.read(len(MCAP0_MAGIC))
            stream.seek(-min(path.stat().st_size, len(MCAP0_MAGIC)), os.SEEK_END)
            end = stream.read()
            is_whole = end == MCAP0_MAGIC and stream.tell() > len(MCAP0_MAGIC)
    except OSError as error:
        raise RecordingError(f'{path}: cannot be read: {error.strerror}') from error
    if not MCAP0_MAGIC.startswith(start):
        raise RecordingError(f'{path}: not an MCAP file, it starts with {start!r}')
    return not is_whole


def header_of(path: Path) -> Header | None:
    """Return the header of a file; None where it is cut before its end."""
    record = next((record for _, records in _scan(path) for record in records), None)
    return record if isinstance(record, Header) else None


def rewrite(path: Path) -> Repair:
    """
    Put a file with an index in the place of one without, in one step once it is on the medium.

    Chunks whose checksum does not fit are left out, and messages whose channel is damaged; what is
    left out stands in a record of the file.

    Raises
    ------
    RecordingError
        When there is no room for a second file, or it cannot be written; the first is left as it
        is then.

    """
    n_free, size_bytes = free_bytes(path.parent), path.stat().st_size
    if n_free < size_bytes:
        raise RecordingError(
            f'{path}: cannot be rewritten: {size_bytes} bytes are needed, {n_free} are free')
    copy = path.with_name(f'.{path.name}.recovered')
    try:
        copy.unlink(missing_ok=True)  # of a repair that was cut short itself
        header = header_of(path)
        writer = McapWriter(copy, profile=header.profile if header else 'ros2')
        lost_bytes = size_bytes - _copy(path, writer)
        writer.finish({RECOVERED: {'size_bytes': str(size_bytes), 'lost_bytes': str(lost_bytes)}})
        sync(copy)
        os.replace(copy, path)
        sync(path.parent)
    except OSError as error:
        copy.unlink(missing_ok=True)
        raise RecordingError(f'{path}: cannot be rewritten: {error.strerror}') from error
    return Repair(path, writer.counts.total(), lost_bytes)


def _copy(path: Path, writer: McapWriter) -> int:
    """Write what is whole in a file; return how many bytes of it that is."""
    whole_bytes = 0
    schemas, channels = {0: 0}, {}
    for n_bytes, records in _scan(path):
        for record in records:
            if isinstance(record, Message):
                if record.channel_id not in channels:  # nothing tells what it is
                    n_bytes = 0
                    continue
                writer.write(channels[record.channel_id], record.data, record.log_time,
                             record.publish_time, record.sequence)
            elif isinstance(record, Schema):
                schemas[record.id] = writer.add_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.schema_id in schemas and (
                    record.id not in channels):
                channels[record.id] = writer.add_channel(
                    record.topic, schemas[record.schema_id], record.metadata,
                    record.message_encoding)
            elif isinstance(record, Attachment):
                writer.add_attachment(
                    record.name, record.media_type, record.data, record.create_time)
            elif isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, Chunk):
                writer.compression = record.compression
        writer.flush()
        whole_bytes += n_bytes
    return whole_bytes


def _scan(path: Path) -> Iterator[tuple[int, list[McapRecord]]]:
    """Read each record that is whole, a chunk with those inside; tell its bytes in the file."""
    size_bytes = path.stat().st_size
    with open(path, 'rb') as stream:
        end = len(stream.read(len(MCAP0_MAGIC)))
        yield end, []
        while len(head := stream.read(_HEAD.size)) == _HEAD.size:
            opcode, length = _HEAD.unpack(head)
            end += _HEAD.size + length
            if opcode == 0 or end > size_bytes:  # zeros: what a power cut leaves
                return
            if opcode == Opcode.DATA_END:
                yield size_bytes - end + _HEAD.size + length, []  # the rest is index
                return
            try:
                records = _decoded(opcode, stream.read(length))
            except Exception:  # whatever the parser stumbles over, the file is the cause
                continue
            yield _HEAD.size + length, records


def _decoded(opcode: int, body: bytes) -> list[McapRecord]:
    stream = ReadDataStream(BytesIO(body))
    if opcode == Opcode.MESSAGE:
        return [Message.read(stream, len(body))]
    if opcode not in _RECORDS:
        return []
    record = _RECORDS[opcode].read(stream)
    if not isinstance(record, Chunk):
        return [record]
    return [record, *breakup_chunk(record, validate_crc=True)]
