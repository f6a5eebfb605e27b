"""One file of a rosbag2 recording, and how it ends on a disk that is full."""

from __future__ import annotations

from collections import Counter
import errno
from pathlib import Path
from typing import Any, Callable, Mapping, NamedTuple

from .bag_metadata import channel_metadata, FileSummary
from .ballast import Ballast
from .mcap_writer import McapWriter
from .message_definitions import schema

CHUNK_BYTES = 2**20
BALLAST_BYTES = 2**24
_NO_ROOM = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)
_TOPIC_IN_METADATA_BYTES = 1024  # about what rosbag2's record at a file's end has for a topic


class Attachment(NamedTuple):
    """A file that goes into every file of a recording."""

    name: str
    media_type: str
    data: bytes
    time_ns: int


class BagFile:
    """Topics by their names in one file; OSError from all that writes to it."""

    def __init__(self, path: Path, compression: str, ballast: Ballast):
        self.path = path
        self._ballast = ballast
        self._writer: McapWriter = ballast.insist(
            lambda: McapWriter(path, compression.replace('none', '')))
        self._channels: dict[str, int] = {}
        self._first_ns: int | None = None

    @property
    def size_bytes(self) -> int:
        """Return the size of what is on the disk."""
        return self._writer.size_bytes

    @property
    def is_empty(self) -> bool:
        """Return whether no message was taken in yet."""
        return self._first_ns is None

    @property
    def counts(self) -> Counter[str]:
        """Return the messages on the disk, by topic."""
        return +Counter({topic: self._writer.counts[channel]
                         for topic, channel in list(self._channels.items())})

    def summary(self) -> FileSummary:
        """Return what `metadata.yaml` says about it."""
        return FileSummary(self.path.name, self.counts, *self._writer.time_range_ns)

    def announce(self, description: Mapping[str, Any]) -> None:
        """Put a topic, and its type with it, into the file."""
        topic, type_name = description['name'], description['type']
        encoding, definition = schema(type_name)
        schema_id = self._ballast.insist(
            lambda: self._writer.add_schema(type_name, encoding, definition.encode()))
        self._channels[topic] = self._ballast.insist(
            lambda: self._writer.add_channel(topic, schema_id, channel_metadata(description)))

    def attach(self, attachment: Attachment) -> None:
        """Put another file into it."""
        self._ballast.insist(lambda: self._writer.add_attachment(*attachment))

    def add_metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Put a table of words into it."""
        self._ballast.insist(lambda: self._writer.add_metadata(name, mapping))

    def size_with(self, n_bytes: int) -> int:
        """Return about how large it would be in the end with one more message."""
        return (self.size_bytes + self._writer.pending_bytes + n_bytes + self._writer.index_bytes
                + _TOPIC_IN_METADATA_BYTES * len(self._channels))

    def has_place(self, n_bytes: int, log_time_ns: int, max_bytes: int, max_duration_s: float
                  ) -> bool:
        """Tell whether a message may go in, as the first may; a limit of 0 is none."""
        if self.is_empty:
            return True
        is_small = not max_bytes or self.size_with(n_bytes) <= max_bytes
        return is_small and (
            not max_duration_s  # a simulated clock may fall back
            or abs(log_time_ns - self._first_ns) < max_duration_s * 1e9)

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int,
              sequence: int) -> None:
        """Take a message in; it is on the disk once its chunk is."""
        self._writer.write(self._channels[topic], data, log_time_ns, publish_time_ns, sequence)
        if self._first_ns is None:
            self._first_ns = log_time_ns
        if self._writer.pending_bytes >= CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Bring all messages to the disk."""
        self._ballast.insist(self._writer.flush)
        # The index of a long recording needs more room than is held at its start.
        n_bytes = BALLAST_BYTES // 2 + 2 * self._writer.index_bytes
        self._ballast.insist(lambda: self._ballast.hold(n_bytes))

    def finish(self, last_words: Callable[[], Mapping[str, Mapping[str, str]]]) -> None:
        """Write the index, and before it the tables of words that are asked for now."""
        self.flush()
        words = last_words()
        self._ballast.insist(lambda: self._writer.finish(words))

    def salvage(self, last_words: Callable[[], Mapping[str, Mapping[str, str]]]) -> None:
        """Finish with what fits; a file that nothing fits into stays as one cut short."""
        self._writer.discard()
        while True:
            try:
                return self.finish(last_words)
            except OSError as error:
                if error.errno not in _NO_ROOM or not self._writer.drop_last():
                    return self._writer.close()
