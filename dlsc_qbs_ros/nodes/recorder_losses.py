"""What did not reach a recording: losses per topic and publisher."""

from __future__ import annotations

from typing import Callable, Collection, NamedTuple


class Losses(NamedTuple):
    """
    Messages of one topic that a recording lacks, by where they were lost.

    `gaps` has an entry for each publisher, in the order in which they were first heard;
    `message_lost` is what the middleware reports. The two see the same losses, neither sees all.
    """

    gaps: tuple[int, ...]
    message_lost: int
    overflowed: int
    not_written: int

    @property
    def total(self) -> int:
        """Return the number of messages known to be missing."""
        return max(sum(self.gaps), self.message_lost) + self.overflowed + self.not_written

    def values(self) -> dict[str, object]:
        """Return the losses in words and figures, those by gaps publisher by publisher."""
        return {'lost': self.total, **self._asdict(), 'gaps': ' '.join(map(str, self.gaps))}


class PublicationGaps:
    """
    Losses of a topic, seen as gaps in the numbers with which each of its publishers counts.

    rclpy does not tell who published a message. Where several publish on a topic, a number that
    follows directly on another is of the same publisher; any other is of one not heard before,
    while there is such, and then of the one whose last number is nearest below it. With one
    publisher that is exact. With several it is so once each was heard and goes on publishing;
    before that, a loss may pass for the first message of another.

    `publishers` returns the identifiers of those who publish now; it is asked at numbers that do
    not follow.
    """

    def __init__(self, publishers: Callable[[], Collection[bytes]]):
        self._publishers = publishers
        self._known: set[bytes] = set()
        self._last: dict[int, int] = {}  # of each publisher heard, by its place in `_lost`
        self._lost: list[int] = []

    @property
    def lost(self) -> tuple[int, ...]:
        """Return the losses, publisher by publisher."""
        return tuple(self._lost)

    def restart(self) -> None:
        """Take in that nobody listened for a while."""
        self._known.clear()
        self._last.clear()

    def observe(self, number: int | None) -> None:
        """Take the number of the next message, or None from a middleware that does not count."""
        if number is None:
            return
        publisher = self._nearest_below(number)
        if publisher is None or self._last[publisher] < number - 1:
            publisher = self._attribute(number)
        self._lost[publisher] += number - 1 - self._last[publisher]
        self._last[publisher] = number

    def _attribute(self, number: int) -> int:
        """Return the publisher of a number that does not follow on any."""
        self._look_around()
        publisher = self._nearest_below(number)
        if publisher is None or len(self._last) < len(self._known):
            publisher = len(self._lost)
            self._lost.append(0)
            self._last[publisher] = number - 1
        return publisher

    def _look_around(self) -> None:
        present = set(self._publishers())
        if present and self._known and self._known.isdisjoint(present):  # others took their place
            self.restart()
        self._known |= present

    def _nearest_below(self, number: int) -> int | None:
        below = [publisher for publisher, last in self._last.items() if last < number]
        return max(below, key=self._last.get, default=None)
