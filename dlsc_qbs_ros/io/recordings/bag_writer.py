"""A rosbag2 folder being written: one file after the other, and what rosbag2 says about them."""

from __future__ import annotations

from collections import Counter
from contextlib import contextmanager, ExitStack, suppress
from math import inf
from pathlib import Path
import threading
import time
from typing import Any, Callable, Iterator, Mapping, Sequence

from .bag_file import Attachment, BagFile, BALLAST_BYTES
from .bag_metadata import (
    bag_information, FileSummary, METADATA_FILE, to_yaml, topic_metadata, write_information)
from .ballast import Ballast
from .latched import Latched, LatchedMessage
from .message_definitions import schema, type_hash
from ..disk import locked, sync
from ...config import RecorderConfig
from ...errors import RecordingError


class BagWriter:
    """
    Write one rosbag2 folder: `<name>_0.mcap` and its successors, and `metadata.yaml`.

    Each file begins with what is latched, so that it can be read alone; that counts once, where it
    was written first.

    A context manager. One thread owns it; `sync` and `tidy` may run on one other. A full disk
    makes itself known by `shortage`; what comes then goes into room held back for the end. Where
    a write is refused all the same, the file is finished with what fits, and the error is raised,
    now and ever after.

    Parameters
    ----------
    directory : Path
        The folder to make.
    config : RecorderConfig
        Where a file ends and how its chunks are compressed.
    last_words : callable
        Asked at the end of each file for the tables of words (name: mapping) to end it with.
    changed : callable, optional
        Called when `tidy` has something to do; left out: `tidy` itself.

    Raises
    ------
    RecordingError
        When the folder is there already or cannot be made.

    """

    def __init__(self, directory: Path, config: RecorderConfig = RecorderConfig(),
                 last_words: Callable[[], Mapping[str, Mapping[str, str]]] = dict,
                 changed: Callable[[], None] | None = None):
        self.directory = Path(directory)
        self.error: RecordingError | None = None
        self.n_files = 0
        self._config, self._last_words = config, last_words
        self._changed = self.tidy if changed is None else changed
        self._topics: dict[str, dict[str, Any]] = {}
        self._attachments: list[Attachment] = []
        self._latched = Latched()
        self._lock = threading.Lock()  # of the six below
        self._file: BagFile | None = None
        self._finished: list[FileSummary] = []
        self._unsynced: list[Path] = []
        self._finished_counts: Counter[str] = Counter()
        self._repeated: Counter[str] = Counter()  # what the file begins with
        self._finished_bytes = self._n_accepted = 0
        self._closed = False
        self._held = ExitStack()
        try:
            self.directory.resolve().name.encode()  # the metadata tell it
            self.directory.mkdir(parents=True)
            self._held.enter_context(locked(self.directory))
        except (OSError, UnicodeEncodeError) as error:
            raise RecordingError(f'{directory}: cannot make a new recording: {error}') from error
        self._ballast = Ballast(self.directory)
        self._held.callback(self._ballast.release)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    @property
    def shortage(self) -> str:
        """Return what the disk said when it was full; nothing before."""
        return self._ballast.shortage

    @property
    def counts(self) -> Counter[str]:
        """Return the messages on the disk, and those that the ring has deleted, by topic."""
        with self._lock:
            in_file = self._file.counts if self._file else Counter()
            return self._finished_counts + (in_file - self._repeated)

    @property
    def byte_count(self) -> int:
        """Return the size of all files, deleted ones too."""
        with self._lock:
            return self._finished_bytes + (self._file.size_bytes if self._file else 0)

    def add_topic(self, topic: str, type_name: str,
                  offered_qos: Sequence[Mapping[str, Any]] = ()) -> None:
        """
        Announce a topic, or what its publishers offer by now.

        `offered_qos` holds one mapping of rosbag2's words per publisher; a file that is open
        keeps what was offered first.

        Raises
        ------
        RecordingError
            When the definition of the type is not installed.

        """
        schema(type_name)
        is_new = topic not in self._topics
        self._latched.announce(topic, offered_qos)
        self._topics[topic] = topic_metadata(topic, type_name, offered_qos, type_hash(type_name))
        with self._writing():
            if self._file is not None and is_new:
                self._file.announce(self._topics[topic])

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Put a file into this file and each that follows: the ring may delete the first."""
        self._attachments.append(Attachment(name, media_type, data, time.time_ns()))
        with self._writing():
            if self._file is not None:
                self._file.attach(self._attachments[-1])

    def add_metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Put a table of words into the file."""
        with self._writing():
            self._opened().add_metadata(name, mapping)

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int,
              sequence: int = 0) -> None:
        """Write one serialised message of an announced topic."""
        with self._writing():
            if self._file is not None and not self._file.has_place(
                    len(data), log_time_ns, self._config.max_bytes, self._config.max_duration_s):
                self._finish()
            file = self._opened()
            if file.is_empty:
                self._repeat(file, log_time_ns, len(data))
            self._n_accepted += 1
            file.write(topic, data, log_time_ns, publish_time_ns, sequence)
        self._latched.keep(LatchedMessage(topic, data, publish_time_ns, sequence))

    def pass_over(self, topic: str, data: bytes, log_time_ns: int, *rest: int) -> None:
        """Take in a message that is only for what follows, where it is latched for that."""
        self._latched.keep(LatchedMessage(topic, data, *rest))

    def flush(self) -> None:
        """Hand all messages to the operating system: no crash of this process loses them."""
        with self._writing():
            if self._file is not None:
                self._file.flush()

    def split(self) -> None:
        """Finish the file; the next message opens the next."""
        with self._writing():
            if self._file is not None:
                self._finish()
                self._changed()

    def close(self) -> None:
        """Finish the recording, which closing again does not; raise its error if it has one."""
        if self._closed:
            return
        self._closed = True
        with self._held:
            try:
                with self._writing():
                    if self.n_files == 0:
                        self._opened()
                    if self._file is not None:
                        self._finish()
            except RecordingError:
                with suppress(RecordingError):
                    self.tidy()
                raise
            self.tidy()

    def sync(self) -> None:
        """Bring everything that was flushed to the medium; raise OSError when that fails."""
        with self._lock:
            paths, self._unsynced = self._unsynced, [self._file.path] if self._file else []
        for path in (*paths, self.directory):
            sync(path)

    def tidy(self) -> None:
        """Delete the files that the ring has no place for and rewrite `metadata.yaml`."""
        with self._lock:
            files = self._finished + ([self._file.summary()] if self._file else [])
        n_surplus = max(len(files) - self._config.max_files, 0) if self._config.max_files else 0
        information = bag_information(list(self._topics.values()), files[n_surplus:])
        try:
            write_information(self.directory, information, self._config.sync_interval_s > 0)
            for summary in files[:n_surplus]:
                (self.directory / summary.name).unlink(missing_ok=True)
        except OSError as error:
            raise RecordingError(f'{self.directory / METADATA_FILE}: cannot be written: '
                                 f'{error.strerror}') from error
        with self._lock:
            del self._finished[:n_surplus]

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Turn the first refusal of the disk into an error, and raise it ever after."""
        if self.error is not None:
            raise self.error
        try:
            yield
        except OSError as error:
            path = self._file.path if self._file else self.directory
            self.error = RecordingError(f'{path}: cannot be written: {error.strerror}')
            if self._file is not None:
                self._file.salvage(self._words)
                self._note_end()
            n_lost = self._n_accepted - self.counts.total()
            if n_lost:
                self.error = RecordingError(f'{self.error}; {n_lost} messages before it are lost')
            raise self.error from error

    def _opened(self) -> BagFile:
        """Return the file, or the next one with all that each file starts with."""
        if self._file is None:
            self._ballast.hold(BALLAST_BYTES)
            path = self.directory / f'{self.directory.resolve().name}_{self.n_files}.mcap'
            file = BagFile(path, self._config.compression, self._ballast)
            with self._lock:
                self._file = file
                self._unsynced.append(path)
            self.n_files += 1
            for attachment in self._attachments:
                file.attach(attachment)
            for description in self._topics.values():
                file.announce(description)
            self._changed()
        return self._file

    def _repeat(self, file: BagFile, log_time_ns: int, n_bytes: int) -> None:
        """Begin a file with what is latched, where half of it and the next message have room."""
        max_bytes = self._config.max_bytes or inf
        messages = self._latched.last(min(max_bytes / 2, max_bytes - file.size_with(n_bytes)))
        with self._lock:
            self._repeated = Counter(message.topic for message in messages)
        for topic, data, *rest in messages:
            file.write(topic, data, log_time_ns, *rest)

    def _finish(self) -> None:
        self._file.finish(self._words)
        self._note_end()

    def _note_end(self) -> None:
        with self._lock:
            self._finished.append(self._file.summary())
            self._finished_counts += self._file.counts - self._repeated
            self._repeated = Counter()
            self._finished_bytes += self._file.size_bytes
            self._file = None

    def _words(self) -> dict[str, Mapping[str, str]]:
        """Return the tables that end the file: rosbag2's and those that were asked for."""
        information = bag_information(
            list(self._topics.values()), [*self._finished, self._file.summary()])
        return {'rosbag2': {'serialized_metadata': to_yaml(information)}, **self._last_words()}
