"""One MCAP file, written so that whatever ends it, all before the end can be read."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
import os
from pathlib import Path
import struct
from typing import Mapping, NamedTuple
import zlib

from lz4 import frame as lz4
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment, AttachmentIndex, Channel, ChunkIndex, DataEnd, Footer, Header, McapRecord,
    MessageIndex, Metadata, MetadataIndex, Schema, Statistics, SummaryOffset)
from mcap.writer import MCAP0_MAGIC
import zstandard

from .mcap_records import bytes_of, chunk_head, HEAD_BYTES, message_counts, message_head
from ..disk import write_all

LIBRARY = 'dlsc_qbs_ros'
_COMPRESS = {'': bytes, 'lz4': lz4.compress, 'zstd': zstandard.compress}  # by MCAP's words


class _Block(NamedTuple):
    """Something the index tells of: where it starts, and its record in the index."""

    offset: int
    opcode: Opcode
    record: bytes


class McapWriter:
    """
    Write one file, straight to the operating system; what is appended is whole or taken back.

    Not thread-safe. OSError from every method that writes: nothing of that call is in the file
    then, and it may be called again. `compression`, of the chunks to come, is '', lz4 or zstd.

    """

    def __init__(self, path: Path, compression: str = '', profile: str = 'ros2'):
        self.path = Path(path)
        self.size_bytes = 0
        self.pending_bytes = 0
        self.counts: Counter[int] = Counter()  # messages on the disk, by channel
        self.compression = compression
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._blocks: list[_Block] = []
        self._index_bytes = 0
        self._pending: list[bytes] = []
        self._entries: dict[int, list[tuple[int, int]]] = {}
        self._descriptor: int | None = os.open(
            path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        try:
            self._append(MCAP0_MAGIC, bytes_of(Header(profile, LIBRARY)))
        except OSError:
            self.close()
            self.path.unlink()
            raise

    @property
    def index_bytes(self) -> int:
        """Return the room that an index would take now, or a bit more."""
        return self._index_bytes + 512

    @property
    def time_range_ns(self) -> tuple[int, int]:
        """Return the first and last log time of what is in the file; zeros where nothing is."""
        ranges = [struct.unpack_from('<QQ', block.record, HEAD_BYTES)
                  for block in self._blocks if block.opcode == Opcode.CHUNK_INDEX]
        return (min(ranges)[0], max(last for _, last in ranges)) if ranges else (0, 0)

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a message type; return its number, also of one that is there already."""
        for schema in self._schemas:
            if (schema.name, schema.encoding, schema.data) == (name, encoding, data):
                return schema.id
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._define(schema)
        self._schemas.append(schema)
        return schema.id

    def add_channel(self, topic: str, schema_id: int, metadata: Mapping[str, str],
                    message_encoding: str = 'cdr') -> int:
        """Add a topic; return its number."""
        channel = Channel(id=len(self._channels) + 1, topic=topic, schema_id=schema_id,
                          message_encoding=message_encoding, metadata=dict(metadata))
        self._define(channel)
        self._channels.append(channel)
        return channel.id

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Append a file."""
        offset, record = self.size_bytes, bytes_of(Attachment(
            create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data))
        self._append(record)
        self._note(Opcode.ATTACHMENT_INDEX, offset, AttachmentIndex(
            offset=offset, length=len(record), log_time=time_ns, create_time=time_ns,
            data_size=len(data), name=name, media_type=media_type))

    def add_metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Append a named table of words."""
        offset, record = self.size_bytes, bytes_of(Metadata(name, dict(mapping)))
        self._append(record)
        self._note(Opcode.METADATA_INDEX, offset, MetadataIndex(offset, len(record), name))

    def write(self, channel_id: int, data: bytes, log_time_ns: int, publish_time_ns: int,
              sequence: int = 0) -> None:
        """Take a message into the chunk that the next `flush` appends."""
        head = message_head(channel_id, len(data), log_time_ns, publish_time_ns, sequence)
        self._entries.setdefault(channel_id, []).append((log_time_ns, self.pending_bytes))
        self._pending += head, data
        self.pending_bytes += len(head) + len(data)

    def flush(self) -> None:
        """Append the messages taken since the last call as one chunk with its index."""
        if not self._pending:
            return
        content = b''.join(self._pending)
        data = _COMPRESS[self.compression](content)
        times_ns = [time_ns for entries in self._entries.values() for time_ns, _ in entries]
        first_ns, last_ns = min(times_ns), max(times_ns)
        head = chunk_head(first_ns, last_ns, content, self.compression, data)
        offset = self.size_bytes
        index, offsets = RecordBuilder(), {}
        for channel_id, entries in self._entries.items():
            offsets[channel_id] = offset + len(head) + len(data) + index.count
            MessageIndex(channel_id, entries).write(index)
        index_data = index.end()
        self._append(head, data, index_data)
        self._note(Opcode.CHUNK_INDEX, offset, ChunkIndex(
            chunk_length=len(head) + len(data), chunk_start_offset=offset,
            compression=self.compression, compressed_size=len(data), message_end_time=last_ns,
            message_index_length=len(index_data), message_index_offsets=offsets,
            message_start_time=first_ns, uncompressed_size=len(content)))
        self.counts.update({key: len(entries) for key, entries in self._entries.items()})
        self.discard()

    def discard(self) -> None:
        """Forget the messages that wait for `flush`."""
        self._pending, self._entries, self.pending_bytes = [], {}, 0

    def drop_last(self) -> bool:
        """Cut off the last chunk, attachment or metadata; False when none is left."""
        if not self._blocks:
            return False
        block = self._blocks.pop()
        if block.opcode == Opcode.CHUNK_INDEX:
            self.counts.subtract(message_counts(block.record))
        self._index_bytes -= len(block.record)
        self.size_bytes = block.offset
        os.ftruncate(self._descriptor, self.size_bytes)
        return True

    def finish(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Append what waits, then tables of words, index and end, and close the file."""
        self.flush()
        ending, blocks = RecordBuilder(), list(self._blocks)
        for name, mapping in metadata.items():
            offset, start = self.size_bytes + ending.count, ending.count
            Metadata(name, dict(mapping)).write(ending)
            blocks.append(_Block(offset, Opcode.METADATA_INDEX, bytes_of(
                MetadataIndex(offset, ending.count - start, name))))
        DataEnd(0).write(ending)
        data_end = ending.end()
        self._append(data_end, self._summary(blocks, self.size_bytes + len(data_end)))
        self.close()

    def close(self) -> None:
        """Close the file as it is; without `finish` it is one cut short."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def _define(self, record: Schema | Channel) -> None:
        data = bytes_of(record)
        self._append(data)
        self._index_bytes += len(data)

    def _note(self, opcode: Opcode, offset: int, record: McapRecord) -> None:
        self._blocks.append(_Block(offset, opcode, bytes_of(record)))
        self._index_bytes += len(self._blocks[-1].record)

    def _append(self, *parts: bytes) -> None:
        try:
            write_all(self._descriptor, parts, self.size_bytes)
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self.size_bytes)
            raise
        self.size_bytes += sum(map(len, parts))

    def _summary(self, blocks: list[_Block], start: int) -> bytes:
        """Return the index, the footer and the closing magic."""
        groups = {Opcode.SCHEMA: b''.join(map(bytes_of, self._schemas)),
                  Opcode.CHANNEL: b''.join(map(bytes_of, self._channels)),
                  Opcode.STATISTICS: bytes_of(self._statistics(blocks))}
        for opcode in (Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX):
            groups[opcode] = b''.join(b.record for b in blocks if b.opcode == opcode)
        offsets, offset = [], start
        for opcode, records in groups.items():
            if records:
                offsets.append(bytes_of(SummaryOffset(opcode, offset, len(records))))
            offset += len(records)
        # The footer's checksum covers the summary and the footer's own fields before it.
        footer = bytes_of(Footer(start, offset, 0))[:-4]
        summary = b''.join((*groups.values(), *offsets, footer))
        return summary + struct.pack('<I', zlib.crc32(summary)) + MCAP0_MAGIC

    def _statistics(self, blocks: list[_Block]) -> Statistics:
        n_blocks = Counter(block.opcode for block in blocks)
        first_ns, last_ns = self.time_range_ns
        return Statistics(
            attachment_count=n_blocks[Opcode.ATTACHMENT_INDEX],
            channel_count=len(self._channels), channel_message_counts=+self.counts,
            chunk_count=n_blocks[Opcode.CHUNK_INDEX], message_count=self.counts.total(),
            message_end_time=last_ns, message_start_time=first_ns,
            metadata_count=n_blocks[Opcode.METADATA_INDEX], schema_count=len(self._schemas))
