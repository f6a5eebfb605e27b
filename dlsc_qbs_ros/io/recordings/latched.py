"""What whoever comes late is told of latched topics: their last messages."""

from __future__ import annotations

from collections import deque
from itertools import chain
from typing import Any, Mapping, NamedTuple, Sequence


class LatchedMessage(NamedTuple):
    """A serialised message that is still valid when others follow."""

    topic: str
    data: bytes
    publish_time_ns: int
    sequence: int


class Latched:
    """
    The last messages of each latched topic, as many as it has publishers that latch.

    Nothing tells who published a message; where each has spoken once, as those of static
    transforms have, none is missing.
    """

    def __init__(self):
        self._messages: dict[str, deque[LatchedMessage]] = {}

    def announce(self, topic: str, offered_qos: Sequence[Mapping[str, Any]]) -> None:
        """Take in what the publishers of a topic offer; while one latches, all gone stay valid."""
        n_latched = sum(qos.get('durability') == 'transient_local' for qos in offered_qos)
        before = self._messages.get(topic, deque(maxlen=0))
        if not n_latched:
            self._messages.pop(topic, None)
        elif n_latched > before.maxlen:
            self._messages[topic] = deque(before, n_latched)

    def keep(self, message: LatchedMessage) -> None:
        """Take in a message, if its topic is latched."""
        if message.topic in self._messages:
            self._messages[message.topic].append(message)

    def last(self, room_bytes: float) -> list[LatchedMessage]:
        """Return what a subscriber that comes now is told, less what there is no room for."""
        told = []
        for message in chain.from_iterable(self._messages.values()):
            if len(message.data) <= room_bytes:
                room_bytes -= len(message.data)
                told.append(message)
        return told
