"""The last seconds in memory, to be written when someone asks for them."""

from __future__ import annotations

from collections import deque

from .inbox import QueuedMessage


class SnapshotBuffer:
    """
    The messages of the last seconds, and no more of them than there is room for.

    Of a latched topic the last message stays, however old it is: without the dictionary or the
    static transforms the others are of little use.
    """

    def __init__(self, duration_s: float, max_bytes: int):
        self._duration_ns, self._max_bytes = round(duration_s * 1e9), max_bytes
        self._messages: deque[QueuedMessage] = deque()
        self._latched: dict[str, QueuedMessage] = {}
        self._n_bytes = 0

    def add(self, message: QueuedMessage, is_latched: bool) -> None:
        """Take a message in and forget those that are too old by now, or too many."""
        if is_latched:
            self._latched[message.topic] = message
        self._messages.append(message)
        self._n_bytes += len(message.data)
        while self._messages and (  # a simulated clock may fall back
                self._n_bytes > self._max_bytes
                or abs(message.log_time_ns - self._messages[0].log_time_ns) > self._duration_ns):
            self._n_bytes -= len(self._messages.popleft().data)

    def take(self) -> list[QueuedMessage]:
        """Return what is here, what is latched first; only that is kept for the next time."""
        recent = list(self._messages)
        self._messages.clear()
        self._n_bytes = 0
        taken = set(map(id, recent))
        return [m for m in self._latched.values() if id(m) not in taken] + recent
