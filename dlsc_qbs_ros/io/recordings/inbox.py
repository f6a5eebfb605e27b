"""What waits for the writer of a recording: messages, as many as may, and tasks."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future
import threading
from typing import Callable, NamedTuple

from .ledger import Ledger
from ...errors import RecordingError

URGENT_BYTES = 2**20


class QueuedMessage(NamedTuple):
    """A serialised message on its way into a file."""

    topic: str
    data: bytes
    log_time_ns: int
    publish_time_ns: int
    sequence: int


class Task(NamedTuple):
    """Something that the writer does when it gets to it."""

    function: Callable[..., None]
    arguments: tuple
    done: Future

    def run(self) -> None:
        """Do it, unless nobody wants it any more; raise what it raises, here as well."""
        if not self.done.set_running_or_notify_cancel():
            return
        try:
            self.done.set_result(self.function(*self.arguments))
        except Exception as error:
            self.done.set_exception(error)
            raise


class Inbox:
    """
    A queue from any thread to one, which takes all that is there at once, and not too often.

    Once it has ended, with an error or without, it takes nothing more in.
    """

    def __init__(self, ledger: Ledger, max_bytes: int, period_s: float):
        self.error = ''
        self.has_ended = False
        self.queued_bytes = 0  # of messages, until they are `handled`
        self._ledger, self._max_bytes, self._period_s = ledger, max_bytes, period_s
        self._condition = threading.Condition()
        self._items: deque[QueuedMessage | Task] = deque()
        self._taken: deque[QueuedMessage | Task] = deque()
        self._is_urgent = False

    def put(self, message: QueuedMessage) -> bool:
        """Take a message in, or count that there is no room or no end to wait for."""
        n_bytes = len(message.data)
        with self._condition:
            if self.has_ended:
                self._ledger.refused[message.topic] += 1
                return False
            if self.queued_bytes + n_bytes > self._max_bytes:
                self._ledger.overflowed[message.topic] += 1
                return False
            self._ledger.taken[message.topic] += 1
            self._items.append(message)
            self.queued_bytes += n_bytes
            if self.queued_bytes >= URGENT_BYTES:
                self._wake()
        return True

    def do(self, function: Callable[..., None], *arguments) -> Future:
        """Have something done after all that waits by now."""
        task = Task(function, arguments, Future())
        with self._condition:
            if self.has_ended:
                task.done.set_exception(RecordingError(self.error or 'the recording is closed'))
            else:
                self._items.append(task)
                self._wake()
        return task.done

    def take(self) -> deque[QueuedMessage | Task]:
        """Wait, one period at most, for something urgent; return what there is."""
        with self._condition:
            self._condition.wait_for(lambda: self._is_urgent or self.has_ended, self._period_s)
            self._is_urgent = False
            self._taken, self._items = self._items, deque()
            return self._taken

    def handled(self, n_bytes: int) -> None:
        """Make room for other messages."""
        with self._condition:
            self.queued_bytes -= n_bytes

    def end(self, error: str = '') -> None:
        """Take nothing more in; the first error stays."""
        with self._condition:
            self.has_ended = True
            self.error = self.error or error
            self._condition.notify()

    def abandon(self) -> None:
        """Forget what waits and what was taken last; whoever waits for a task gets the error."""
        with self._condition:
            left = [*self._taken, *self._items]
            self._items.clear()
            self.queued_bytes = 0
        for item in left:
            if isinstance(item, Task):
                item.done.set_exception(RecordingError(self.error))

    def _wake(self) -> None:
        self._is_urgent = True
        self._condition.notify()
