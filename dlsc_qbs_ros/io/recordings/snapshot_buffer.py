"""The last seconds in memory, to be written when someone asks for them."""

from __future__ import annotations

from collections import deque

from .inbox import QueuedMessage


class SnapshotBuffer:
    """The messages of the last seconds, and no more of them than there is room for."""

    def __init__(self, duration_s: float, max_bytes: int):
        self._duration_ns, self._max_bytes = round(duration_s * 1e9), max_bytes
        self._messages: deque[QueuedMessage] = deque()
        self._n_bytes = 0

    def add(self, message: QueuedMessage) -> list[QueuedMessage]:
        """Take a message in and return those that are too old by now, or too many."""
        self._messages.append(message)
        self._n_bytes += len(message.data)
        forgotten = []
        while self._messages and (  # a simulated clock may fall back
                self._n_bytes > self._max_bytes
                or abs(message.log_time_ns - self._messages[0].log_time_ns) > self._duration_ns):
            forgotten.append(self._messages.popleft())
            self._n_bytes -= len(forgotten[-1].data)
        return forgotten

    def take(self) -> list[QueuedMessage]:
        """Return what is here, once."""
        recent = list(self._messages)
        self._messages.clear()
        self._n_bytes = 0
        return recent
