"""Where every message of a recording went, in numbers."""

from __future__ import annotations

from collections import Counter
from typing import Mapping, NamedTuple


class TopicCounts(NamedTuple):
    """Where the messages of a topic went; what is missing in the sum waits for the disk."""

    written: int = 0
    overflowed: int = 0
    not_written: int = 0


class RecordingStatus(NamedTuple):
    """How a recording is doing; `state` is recording, snapshot, stopped or closed."""

    state: str
    error: str
    n_files: int
    written_bytes: int
    queued_bytes: int
    topics: dict[str, TopicCounts]

    @property
    def total(self) -> TopicCounts:
        """Return the sum over all topics."""
        return TopicCounts(*map(sum, zip(TopicCounts(), *self.topics.values())))


class Ledger:
    """What happened to the messages that were offered, by topic."""

    def __init__(self):
        self.taken: Counter[str] = Counter()
        self.overflowed: Counter[str] = Counter()  # refused: the queue was full
        self.refused: Counter[str] = Counter()  # the recording had ended
        self.meant: Counter[str] = self.taken  # for a file: all of them, but of a snapshot

    def counts(self, written: Mapping[str, int], is_lost: bool) -> dict[str, TopicCounts]:
        """Return where they are, when `is_lost` tells what of those meant is not written."""
        topics = {*self.taken.copy(), *self.overflowed.copy(), *self.refused.copy()}
        return {topic: TopicCounts(
            written[topic], self.overflowed[topic],
            self.refused[topic] + is_lost * (self.meant[topic] - written[topic]))
            for topic in sorted(topics)}
