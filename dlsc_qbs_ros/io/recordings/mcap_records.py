"""Records of MCAP as bytes, those written most often without a copy of their data."""

from __future__ import annotations

from io import BytesIO
import struct
import zlib

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, McapRecord

HEAD_BYTES = 9  # opcode and length, of every record
_MESSAGE = struct.Struct('<BQHIQQ')
_INDEX_HEAD_BYTES, _INDEX_ENTRY_BYTES = HEAD_BYTES + 6, 16


def bytes_of(record: McapRecord) -> bytes:
    """Return a record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def message_head(channel_id: int, n_bytes: int, log_time_ns: int, publish_time_ns: int,
                 sequence: int) -> bytes:
    """Return a message record up to its data, so many bytes; MCAP's number has 32 bits."""
    return _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE.size - HEAD_BYTES + n_bytes, channel_id,
                         sequence % 2**32, log_time_ns, publish_time_ns)


def chunk_head(first_ns: int, last_ns: int, content: bytes, compression: str, data: bytes
               ) -> bytes:
    """Return a chunk record up to its data."""
    word = compression.encode()
    fields = struct.pack(f'<QQQII{len(word)}sQ', first_ns, last_ns, len(content),
                         zlib.crc32(content), len(word), word, len(data))
    return struct.pack('<BQ', Opcode.CHUNK, len(fields) + len(data)) + fields


def message_counts(record: bytes) -> dict[int, int]:
    """Return how many messages of each channel a chunk has, by its record in the index."""
    index = ChunkIndex.read(ReadDataStream(BytesIO(record[HEAD_BYTES:])))
    starts = sorted((offset, key) for key, offset in index.message_index_offsets.items())
    end = index.chunk_start_offset + index.chunk_length + index.message_index_length
    ends = [offset for offset, _ in starts[1:]] + [end]
    return {key: (stop - start - _INDEX_HEAD_BYTES) // _INDEX_ENTRY_BYTES
            for (start, key), stop in zip(starts, ends)}
