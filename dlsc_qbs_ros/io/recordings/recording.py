"""A recording under way: messages go in from any thread, two threads bring them to the disk."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import Future
from pathlib import Path
import threading
from typing import Any, Callable, Mapping, Sequence

from .bag_writer import BagWriter
from .inbox import Inbox, QueuedMessage, Task
from .keeper import Keeper
from .ledger import Ledger, RecordingStatus, TopicCounts
from .message_definitions import schema
from .snapshot_buffer import SnapshotBuffer
from ..disk import free_bytes
from ...config import RecorderConfig
from ...errors import RecordingError

LOSSES = 'dlsc_qbs_ros/losses'


class Recording:
    """
    One recording: a bounded queue, a thread that writes it, another that syncs and tidies up.

    A message that `write` takes is in the file, safe from a crash of this process, within
    `flush_interval_s`, and on the medium within `sync_interval_s` more. It is counted where it
    went: written, overflowed (the queue was full) or not written (the disk refused it, or the
    recording had ended); the counts stand in each file as well, in the metadata record
    `dlsc_qbs_ros/losses`. In a snapshot recording only what `snapshot` writes is counted.

    Parameters
    ----------
    directory : Path
        The folder to make.
    config : RecorderConfig
        How to write, how often, how much.
    losses : callable
        Asked at the end of each file, from another thread, what else was lost; its table goes
        into the same record.

    Raises
    ------
    RecordingError
        When the folder is there already or cannot be made.

    """

    def __init__(self, directory: Path, config: RecorderConfig = RecorderConfig(),
                 losses: Callable[[], Mapping[str, Any]] = dict):
        self._config, self._losses = config, losses
        self._ledger = Ledger()
        self._inbox = Inbox(self._ledger, config.queue_bytes, config.flush_interval_s / 2)
        self._buffer = None
        if config.snapshot_s:
            self._buffer = SnapshotBuffer(config.snapshot_s, config.snapshot_bytes)
            self._ledger.meant = Counter()
        self._announced: set[str] = set()
        self._has_failed = self._is_closed = False
        changed = threading.Event()
        self._bag = BagWriter(directory, config, self._last_words, changed.set)
        self._keeper = Keeper(self._bag, changed, config.sync_interval_s)
        self._thread = threading.Thread(target=self._run, name='recording', daemon=True)
        self._thread.start()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    @property
    def directory(self) -> Path:
        """Return the folder of the recording."""
        return self._bag.directory

    def add_topic(self, topic: str, type_name: str,
                  offered_qos: Sequence[Mapping[str, Any]] = ()) -> None:
        """
        Announce a topic, or what its publishers offer by now, in rosbag2's words.

        Raises
        ------
        RecordingError
            When the definition of the type is not installed.

        """
        schema(type_name)
        self._announced.add(topic)
        self._inbox.do(self._bag.add_topic, topic, type_name, offered_qos)

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int,
              sequence: int = 0) -> bool:
        """
        Take one serialised message of an announced topic, never waiting for the disk.

        Return False when it is refused, and counted: the queue is full or the recording ended.
        """
        if topic not in self._announced:
            raise RecordingError(f'{topic}: a message of a topic that was not announced')
        return self._inbox.put(QueuedMessage(  # MCAP knows no time before its epoch
            topic, data, max(log_time_ns, 0), max(publish_time_ns, 0), sequence))

    def split(self) -> Future:
        """Finish the file; the next message opens the next."""
        return self._inbox.do(self._bag.split)

    def snapshot(self) -> Future:
        """Write the last seconds into a file of their own; an error without `snapshot_s`."""
        return self._inbox.do(self._write_snapshot)

    def attach(self, name: str, media_type: str, data: bytes) -> Future:
        """Put a file into each file of the recording."""
        return self._inbox.do(self._bag.attach, name, media_type, data)

    def add_metadata(self, name: str, mapping: Mapping[str, str]) -> Future:
        """Put a table of words into the file."""
        return self._inbox.do(self._bag.add_metadata, name, mapping)

    def status(self) -> RecordingStatus:
        """Return how the recording is doing."""
        running = 'recording' if self._buffer is None else 'snapshot'
        state = 'closed' if self._is_closed else 'stopped' if self._inbox.has_ended else running
        return RecordingStatus(
            state, self._inbox.error or self._keeper.problem, self._bag.n_files,
            self._bag.byte_count, self._inbox.queued_bytes, self._counts())

    def close(self) -> None:
        """
        Write all that waits and finish; closing again does nothing.

        Raises
        ------
        RecordingError
            When the recording had to end before.

        """
        if self._is_closed:
            return
        self._is_closed = True
        self._inbox.end()
        self._thread.join()
        self._keeper.stop()
        try:
            self._bag.close()
        finally:
            self._keeper.keep()
        if error := self._inbox.error or self._keeper.problem:
            raise RecordingError(error)

    def _run(self) -> None:
        """Bring what waits to the disk until the recording ends, and finish the file."""
        try:
            is_last = False
            while not is_last:
                is_last = self._inbox.has_ended  # what is taken after that is all there is
                self._write_batch()
                self._bag.flush()
                self._watch_room()
            self._bag.split()
        except RecordingError as error:
            self._fail(str(error))
        except Exception as error:  # a writer that died must not look alive
            self._fail(f'{self.directory}: the writer failed: {error!r}')

    def _write_batch(self) -> None:
        items, n_bytes = self._inbox.take(), 0
        while items:
            item = items.popleft()
            if isinstance(item, Task):
                self._run_task(item)
                continue
            n_bytes += len(item.data)
            if self._buffer is None:
                self._bag.write(*item)
            else:
                for forgotten in self._buffer.add(item):
                    self._bag.pass_over(*forgotten)
        self._inbox.handled(n_bytes)

    def _run_task(self, task: Task) -> None:
        try:
            task.run()
        except RecordingError:  # who asked for it knows
            if self._bag.error is not None:
                raise

    def _write_snapshot(self) -> None:
        if self._buffer is None:
            raise RecordingError('no snapshot: recorder.snapshot_s = 0, all messages are written')
        for message in self._buffer.take():
            self._ledger.meant[message.topic] += 1
            self._bag.write(*message)
        self._bag.split()

    def _watch_room(self) -> None:
        """End the recording, whole, while there is room for all that waits."""
        reason, n_needed = self._bag.shortage, self._config.min_free_bytes
        if not reason and (n_free := free_bytes(self.directory)) < n_needed:
            reason = f'{n_free} bytes are free, recorder.min_free_bytes = {n_needed}'
        if reason and not self._inbox.has_ended:
            self._inbox.end(f'{self.directory}: ended: {reason}')

    def _fail(self, error: str) -> None:
        self._has_failed = True
        self._inbox.end(error)
        self._inbox.abandon()

    def _counts(self) -> dict[str, TopicCounts]:
        has_failed = self._has_failed or self._bag.error is not None
        return self._ledger.counts(self._bag.counts, has_failed)

    def _last_words(self) -> dict[str, dict[str, str]]:
        """Return the record of what this file's reader will not find, up to now."""
        counts = self._counts()
        words = {f'{topic} {kind}': str(getattr(count, kind)) for topic, count in counts.items()
                 for kind in ('overflowed', 'not_written') if getattr(count, kind)}
        words.update((str(key), str(value)) for key, value in self._losses().items())
        return {LOSSES: words}
