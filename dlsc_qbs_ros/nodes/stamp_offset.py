"""How far the stamps of images and of odometry are apart, and what that means."""

from __future__ import annotations

from datetime import datetime, timezone

APART_S = 1.0
# No latency is a minute, and no clock that is kept in step is that far off.
ANOTHER_CLOCK_S = 60.0
YEAR_2000_S = 946_684_800


class StampOffset:
    """The stamps of image and odometry that came together and were closest, of each period."""

    def __init__(self):
        self._odometry_ns: int | None = None
        self._closest: tuple[int, int] | None = None

    def odometry_at(self, stamp_ns: int) -> None:
        """Take in the stamp of odometry that came."""
        self._odometry_ns = stamp_ns

    def image_at(self, stamp_ns: int) -> None:
        """Take in the stamp of an image, or of its code, that came."""
        if self._odometry_ns is None:
            return
        pair = stamp_ns, self._odometry_ns
        if self._closest is None or _apart_s(pair) < _apart_s(self._closest):
            self._closest = pair

    def in_words(self) -> str:
        """Say what is wrong about the stamps, if anything, and begin another period."""
        pair, self._closest = self._closest, None
        if pair is None or _apart_s(pair) <= APART_S:
            return ''
        if _apart_s(pair) <= ANOTHER_CLOCK_S:
            return f'image stamps and odometry are {_apart_s(pair):.1f} s apart'
        image, odometry = map(_time, pair)
        return ('image stamps are in another clock than odometry '
                f'(image: {image}; odometry: {odometry})')


def _apart_s(pair: tuple[int, int]) -> float:
    return abs(pair[0] - pair[1]) / 1e9


def _time(stamp_ns: int) -> str:
    """Tell a stamp of the system's time from one that began with the machine or a simulation."""
    seconds = stamp_ns // 1_000_000_000
    if seconds < YEAR_2000_S:
        return f'{seconds} s since some start'
    return f'{datetime.fromtimestamp(seconds, timezone.utc):%Y-%m-%d %H:%M:%S} UTC'
