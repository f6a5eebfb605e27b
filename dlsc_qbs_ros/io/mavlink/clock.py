"""The autopilot's time → this computer's, so that its stamps compare with those of images."""

from __future__ import annotations

from collections import Counter, deque

_S = 1_000_000_000

JUMP_NS = 1 * _S
# Packets overtake each other by less than this.
REORDER_NS = 100_000_000
MAX_ROUND_TRIP_NS = 10_000_000
# Crystals drift by 1 ms in this time, and slow radio links are late for shorter.
DELAY_WINDOW_NS = 20 * _S
# Answers among which the one of least round trip tells the offset: a second of them.
N_ANSWERS = 10
# The offset follows by 5 ms each second: no crystal drifts faster, and no stamp jumps.
SLEW = 0.005
SYNC_EXPIRES_NS = 30 * _S
# Times from the year 2001 on are UNIX times: no autopilot has been up for 31 years.
UNIX_NS = 1_000_000_000 * _S

REBOOT, TIME_JUMP, OUTLIER = 'mavlink_reboots', 'mavlink_time_jumps', 'mavlink_time_outliers'


class AutopilotClock:
    """
    Tells at which time of this computer a message was measured.

    By TIMESYNC where the autopilot answers it: the offset is that of the least round trip, taken
    at once, followed slowly afterwards. Without answers, by the time of arrival less the least
    delay: no message is early, so the one delayed least tells the offset, a little too late.
    """

    def __init__(self):
        self.counts: Counter[str] = Counter()
        self.jumps = 0
        self._restart()

    def stamp(self, remote_ns: int, arrival_ns: int) -> int | None:
        """Return the time of this computer, or None for a time that is not to be believed."""
        is_unix = remote_ns >= UNIX_NS
        cause = self._timelines[is_unix].discontinuity(remote_ns, arrival_ns)
        if cause is None and not is_unix and self._answers_deny(arrival_ns - remote_ns):
            cause = TIME_JUMP
        if cause is OUTLIER:
            self.counts[OUTLIER] += 1
            return None
        if cause:
            self.jump(cause)
        offset_ns = self._timelines[is_unix].observe(remote_ns, arrival_ns)
        if offset_ns is None:
            self.jump(TIME_JUMP)
            offset_ns = self._timelines[is_unix].observe(remote_ns, arrival_ns)
        self._arrival_offset_ns = offset_ns
        if self._is_synchronised(arrival_ns) and not is_unix:
            offset_ns = self._synced_ns
        return remote_ns + offset_ns

    def answered(self, sent_ns: int, remote_ns: int, now_ns: int) -> None:
        """Take an answer to TIMESYNC: the autopilot read `remote_ns` between the two others."""
        round_trip_ns = now_ns - sent_ns
        if not 0 <= round_trip_ns <= MAX_ROUND_TRIP_NS:
            self.slow_answers += 1
            return
        answer_ns = (sent_ns + now_ns) // 2 - remote_ns
        if self._answers and abs(answer_ns - self._synced_ns) > JUMP_NS:
            self._answers.clear()
            self._n_answers = 0
        step_ns = now_ns - self._answers[-1][2] if self._answers else 0
        self._answers.append((round_trip_ns, answer_ns, now_ns))
        self._n_answers += 1
        self._follow(step_ns)

    def jump(self, cause: str) -> None:
        """Forget the offset; what follows belongs to another segment."""
        self.counts[cause] += 1
        self.jumps += 1
        self._restart()

    def state(self, now_ns: int) -> dict[str, object]:
        """Tell where the time comes from, and how far the clocks are apart."""
        synchronised = self._is_synchronised(now_ns)
        offset_ns = self._synced_ns if synchronised else self._arrival_offset_ns
        answers = list(self._answers)
        return {
            'time_source': 'timesync' if synchronised else
            'none' if offset_ns is None else 'least delay of arrival',
            'clock_offset_s': float('nan') if offset_ns is None else offset_ns / _S,
            'round_trip_ms': min(answers)[0] * 1e-6 if synchronised else float('nan'),
            'timesync_refused': self.slow_answers}

    def _restart(self) -> None:
        self._timelines = (_Timeline(), _Timeline())
        self._answers: deque[tuple[int, int, int]] = deque(maxlen=N_ANSWERS)
        self._n_answers = 0
        self._synced_ns: int | None = None
        self._arrival_offset_ns: int | None = None
        self.slow_answers = 0

    def _follow(self, step_ns: int) -> None:
        """Take the offset of the least round trip, after the first second slowly."""
        target_ns = min(self._answers)[1]
        if self._n_answers <= N_ANSWERS:
            self._synced_ns = target_ns
        else:
            limit_ns = int(SLEW * step_ns)
            change_ns = target_ns - self._synced_ns
            self._synced_ns += max(-limit_ns, min(limit_ns, change_ns))

    def _answers_deny(self, delay_ns: int) -> bool:
        """Whether answers agree with this message, and both not with those before it."""
        arrival_ns = self._timelines[False].offset_ns
        return (arrival_ns is not None and self._synced_ns is not None
                and abs(delay_ns - self._synced_ns) <= JUMP_NS
                and abs(arrival_ns - self._synced_ns) > JUMP_NS)

    def _is_synchronised(self, now_ns: int) -> bool:
        """Whether there are answers, of late, and of the clock that the messages tell."""
        if not self._answers or now_ns - self._answers[-1][2] > SYNC_EXPIRES_NS:
            return False
        arrival_ns = self._timelines[False].offset_ns
        return arrival_ns is None or abs(arrival_ns - self._synced_ns) <= JUMP_NS


class _Timeline:
    """One clock of the autopilot, by when the times that it told have come."""

    def __init__(self):
        self.offset_ns: int | None = None
        self._newest_ns = 0
        self._suspect: tuple[int, int] | None = None
        self._window_ends_ns = 0
        self._least_ns: list[int] = []

    def discontinuity(self, remote_ns: int, arrival_ns: int) -> str | None:
        """
        Return what a time is that does not go on from those before.

        One that falls, or leaps ahead of the least delay, is an outlier while it stands alone,
        and when the next one agrees with it a reboot or a jump. One that falls, but comes no
        later than the limit, was overtaken on the way.
        """
        if self.offset_ns is None:
            return None
        late_ns, fallen_ns = arrival_ns - remote_ns - self.offset_ns, self._newest_ns - remote_ns
        has_fallen = fallen_ns > REORDER_NS and late_ns > JUMP_NS
        if not has_fallen and late_ns >= -JUMP_NS:
            self._suspect = None
            return None
        suspect, self._suspect = self._suspect, (remote_ns, arrival_ns)
        if suspect is None or abs(
                remote_ns - suspect[0] - (arrival_ns - suspect[1])) > JUMP_NS:
            return OUTLIER
        return REBOOT if has_fallen else TIME_JUMP

    def observe(self, remote_ns: int, arrival_ns: int) -> int | None:
        """
        Return what to add to this clock: the least delay of the last one or two windows.

        None when all that came in them was so late that one of the clocks must have been set.
        """
        delay_ns = arrival_ns - remote_ns
        if not self._least_ns or arrival_ns >= self._window_ends_ns:
            self._window_ends_ns = arrival_ns + DELAY_WINDOW_NS
            self._least_ns = [*self._least_ns[-1:], delay_ns]
        self._least_ns[-1] = min(self._least_ns[-1], delay_ns)
        self._newest_ns = max(self._newest_ns, remote_ns)
        before_ns, self.offset_ns = self.offset_ns, min(self._least_ns)
        is_set = before_ns is not None and self.offset_ns - before_ns > JUMP_NS
        return None if is_set else self.offset_ns
