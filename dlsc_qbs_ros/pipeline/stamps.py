"""What a stamp is to the one before it: every stream is held to the same rule."""

from __future__ import annotations

from enum import Enum

CLOCK_JUMP_NS = 1_000_000_000


class Succession(Enum):
    """How a stamp follows the newest one of its stream."""

    AFTER = 'after'
    LATE = 'late'
    RESTART = 'restart'


class StampOrder:
    """
    The newest stamp of a stream.

    A stamp that is not after it is LATE and to be refused, unless it falls back by more than
    `CLOCK_JUMP_NS`: then the clock was set or the recording started again, and the stream goes
    on from there.
    """

    def __init__(self):
        self.newest_ns: int | None = None

    def take(self, stamp_ns: int) -> Succession:
        """Tell how a stamp follows; unless it is LATE it becomes the newest."""
        if self.newest_ns is None or stamp_ns > self.newest_ns:
            succession = Succession.AFTER
        elif self.newest_ns - stamp_ns <= CLOCK_JUMP_NS:
            return Succession.LATE
        else:
            succession = Succession.RESTART
        self.newest_ns = stamp_ns
        return succession
