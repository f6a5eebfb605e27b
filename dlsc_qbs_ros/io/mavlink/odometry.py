"""Messages of one autopilot → odometry: ODOMETRY, or positions joined with attitudes."""

from __future__ import annotations

from collections import Counter, deque
from math import isfinite, nan
from typing import Iterator, NamedTuple

from .clock import AutopilotClock
from .conversions import (
    Attitude, attitude_from_message, interpolated_attitude, joined_odometry, odometry_from_message,
    position_sigma_m, refusal, remote_time_ns)
from .framing import dialect
from ...core.types import RawOdometry

# ODOMETRY holds more, so positions are left alone while it has come within this time.
PREFERENCE_NS = 1_000_000_000
# Attitudes farther apart tell nothing about the time between them.
MAX_ATTITUDE_GAP_NS = 1_000_000_000
N_KEPT = 64
# What a segment of joined positions has in place of the frame_id of ODOMETRY.
_JOINED = 255


class _Position(NamedTuple):
    remote_ns: int
    stamp_ns: int
    ned_m: tuple[float, float, float]
    ned_m_s: tuple[float, float, float]


class OdometryAssembler:
    """
    Makes odometry of what an autopilot sends; what is refused is counted by cause.

    The number of a segment is made of the jumps of the clock, the frame and the reset counter of
    the estimator: whichever changes, another segment begins, and a late packet cannot begin one.
    """

    def __init__(self, clock: AutopilotClock):
        self._clock = clock
        self._jumps = 0
        self.counts: Counter[str] = Counter()
        self.position_sigma_m = nan
        self._preferred_until_ns: int | None = None
        self._attitudes: deque[Attitude] = deque(maxlen=N_KEPT)
        self._positions: deque[_Position] = deque()
        self._takers = {
            'ODOMETRY': self._take_odometry,
            'LOCAL_POSITION_NED': self._take_position,
            'LOCAL_POSITION_NED_COV': self._take_position,
            'ATTITUDE': self._take_attitude,
            'ATTITUDE_QUATERNION': self._take_attitude}

    def take(self, message: dialect.MAVLink_message, arrival_ns: int) -> Iterator[RawOdometry]:
        """Yield the odometry that this message completes."""
        taker = self._takers.get(message.get_type())
        if taker is None or taker != self._take_odometry and self._is_preferring(arrival_ns):
            return
        stamp_ns = self._clock.stamp(remote_time_ns(message), arrival_ns)
        if stamp_ns is None:
            return
        if self._jumps != self._clock.jumps:
            self._jumps = self._clock.jumps
            self._attitudes.clear()
            self._positions.clear()
        yield from taker(message, stamp_ns, arrival_ns)

    def _is_preferring(self, arrival_ns: int) -> bool:
        """Whether parts are left alone, and their time too: it wraps, that of ODOMETRY not."""
        return self._preferred_until_ns is not None and arrival_ns < self._preferred_until_ns

    def _take_odometry(self, message, stamp_ns, arrival_ns) -> Iterator[RawOdometry]:
        cause = refusal(message)
        if cause:
            self.counts[cause] += 1
            return
        self._preferred_until_ns = arrival_ns + PREFERENCE_NS
        self.position_sigma_m = position_sigma_m(message.pose_covariance)
        yield odometry_from_message(
            message, stamp_ns, self._segment(message.frame_id, message.reset_counter))

    def _take_position(self, message, stamp_ns, arrival_ns) -> Iterator[RawOdometry]:
        ned_m = message.x, message.y, message.z
        if not all(map(isfinite, ned_m)):
            self.counts['odometry_malformed'] += 1
            return
        self._positions.append(_Position(
            remote_time_ns(message), stamp_ns, ned_m, (message.vx, message.vy, message.vz)))
        if len(self._positions) > N_KEPT:
            self._positions.popleft()
            self.counts['positions_without_attitude'] += 1
        yield from self._join()

    def _take_attitude(self, message, stamp_ns, arrival_ns) -> Iterator[RawOdometry]:
        attitude = attitude_from_message(message)
        if attitude is None:
            self.counts['attitude_malformed'] += 1
        elif not self._attitudes or attitude.remote_ns > self._attitudes[-1].remote_ns:
            self._attitudes.append(attitude)
            yield from self._join()

    def _join(self) -> Iterator[RawOdometry]:
        """Yield the positions up to the newest attitude, each with the attitude at its time."""
        while self._positions and self._attitudes and (
                self._positions[0].remote_ns <= self._attitudes[-1].remote_ns):
            position = self._positions.popleft()
            attitude = self._attitude_at(position.remote_ns)
            if attitude is None:
                self.counts['positions_without_attitude'] += 1
                continue
            yield joined_odometry(position.stamp_ns, self._segment(_JOINED), position.ned_m,
                                  position.ned_m_s, attitude)

    def _attitude_at(self, remote_ns: int) -> Attitude | None:
        after = self._attitudes[-1]
        for before in reversed(self._attitudes):
            if before.remote_ns <= remote_ns:
                near = after.remote_ns - before.remote_ns <= MAX_ATTITUDE_GAP_NS
                return interpolated_attitude(before, after, remote_ns) if near else None
            after = before
        return None

    def _segment(self, origin: int, reset_counter: int = 0) -> int:
        return self._clock.jumps << 16 | origin << 8 | reset_counter
