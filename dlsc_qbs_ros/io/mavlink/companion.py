"""What a companion says to an autopilot and makes of what it hears; no line, no thread."""

from __future__ import annotations

from collections import Counter, deque
from math import inf
from pathlib import Path
import time
from typing import Callable, Iterable, Iterator

from .clock import JUMP_NS, REBOOT, TIME_JUMP
from .framing import dialect
from .receiver import Receiver
from .requests import PERIOD_S as REQUEST_PERIOD_S
from .requests import RateRequests
from .signing import PERSIST_PERIOD_S, Signing
from ...config import MavlinkConfig
from ...core.types import RawOdometry

COMPONENT = dialect.MAV_COMP_ID_ONBOARD_COMPUTER
HEARTBEAT_PERIOD_S = 1.0
TIMESYNC_PERIOD_S = 0.1
# Odometry older than this is missing.
FRESH_S = 0.5


class Companion:
    """
    One side of a link: bytes in, odometry and bytes out.

    Times `now_s` are of a clock that is never set; `now_ns` is the one that images are stamped
    with.
    """

    def __init__(self, config: MavlinkConfig, now_ns: Callable[[], int] = time.time_ns):
        self._now_ns = now_ns
        self._sender = dialect.MAVLink(None, config.system or 1, COMPONENT)
        self._signing = Signing(Path(config.key_file), self._sender) if config.key_file else None
        self._receiver = Receiver(config, signing=self._signing, on_message=self._on_message)
        self._requests = RateRequests(config.rate_hz)
        self._counts = Counter(mavlink_timestamps_unsaved=0)
        self._replies: deque[dialect.MAVLink_message] = deque(maxlen=100)
        self._timesync_sent_ns: deque[int] = deque(maxlen=10)
        self._duties = {
            self._beat: HEARTBEAT_PERIOD_S, self._ask_time: TIMESYNC_PERIOD_S,
            self._ask_rates: REQUEST_PERIOD_S}
        self._due_s = dict.fromkeys(self._duties, -inf)
        self._save_due_s = -inf
        self._lead_ns: int | None = None
        self.heard_s = self.odometry_s = -inf

    def connected(self, datagrams: bool) -> None:
        """Begin on a new line, of datagrams or a stream."""
        self._receiver.connected(datagrams)
        self._renew()

    def receive(self, data: bytes, now_s: float) -> list[RawOdometry]:
        """Return the odometry that these bytes complete."""
        arrival_ns = self._now_ns()
        self._watch_clock(arrival_ns, now_s)
        accepted, reboots = self._receiver.accepted, self._receiver.clock.counts[REBOOT]
        odometry = list(self._receiver.receive(data, arrival_ns))
        if self._receiver.accepted > accepted:
            self.heard_s = now_s
        if odometry:
            self.odometry_s = now_s
        if self._receiver.clock.counts[REBOOT] > reboots:
            self._renew()
        return odometry

    def outgoing(self, now_s: float) -> Iterator[bytes]:
        """Yield the packets to send now."""
        while self._replies:
            yield self.pack(self._replies.popleft())
        for duty, period_s in self._duties.items():
            if now_s >= self._due_s[duty]:
                self._due_s[duty] = now_s + period_s
                for message in duty(now_s):
                    yield self.pack(message)

    def pack(self, message: dialect.MAVLink_message) -> bytes:
        """Return a message as a packet of this sender, signed where there is a key."""
        if self._receiver.autopilot:
            self._sender.srcSystem = self._receiver.autopilot[0]
        if self._signing:
            self._signing.stamp()
        packet = message.pack(self._sender)
        self._sender.seq = (self._sender.seq + 1) % 256
        return packet

    def save(self) -> None:
        """Keep on disk what must outlive this session."""
        if self._signing:
            try:
                self._signing.save()
            except OSError:
                self._counts['mavlink_timestamps_unsaved'] += 1

    def save_in_time(self, now_s: float) -> None:
        """Keep it now and then; the disk may take its time."""
        if now_s >= self._save_due_s:
            self._save_due_s = now_s + PERSIST_PERIOD_S
            self.save()

    def counts(self) -> Counter[str]:
        """Return what was amiss, by cause."""
        return self._counts + self._receiver.counts()

    def state(self) -> dict[str, object]:
        """Return words and figures on the autopilot and its clock."""
        return self._receiver.state(self._now_ns())

    def condition(self, now_s: float) -> str:
        """Return how the link is, in words."""
        if self._receiver.autopilot is None:
            return 'no heartbeat of an autopilot'
        if self.odometry_s == -inf:
            return 'the autopilot sends none'
        silent_s = now_s - self.odometry_s
        return f'none for {silent_s:.1f} s' if silent_s > FRESH_S else 'up'

    def _renew(self) -> None:
        self._requests.renew()
        self._due_s[self._ask_rates] = -inf

    def _watch_clock(self, now_ns: int, now_s: float) -> None:
        """Notice when the clock of this computer is set."""
        lead_ns = now_ns - int(now_s * 1e9)
        if self._lead_ns is not None and abs(lead_ns - self._lead_ns) > JUMP_NS:
            self._receiver.clock.jump(TIME_JUMP)
        self._lead_ns = lead_ns

    def _on_message(self, message: dialect.MAVLink_message) -> None:
        kind = message.get_type()
        if kind == 'COMMAND_ACK':
            self._requests.answered(message)
        elif kind == 'TIMESYNC' and message.tc1 == 0:
            self._replies.append(dialect.MAVLink_timesync_message(self._now_ns(), message.ts1))
        elif kind == 'TIMESYNC' and message.ts1 in self._timesync_sent_ns:
            self._receiver.clock.answered(message.ts1, message.tc1, self._now_ns())

    def _beat(self, now_s: float) -> Iterable[dialect.MAVLink_message]:
        yield dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, 0, 0,
            dialect.MAV_STATE_ACTIVE, 3)

    def _ask_time(self, now_s: float) -> Iterable[dialect.MAVLink_message]:
        if self._receiver.autopilot:
            self._timesync_sent_ns.append(self._now_ns())
            yield dialect.MAVLink_timesync_message(0, self._timesync_sent_ns[-1])

    def _ask_rates(self, now_s: float) -> Iterable[dialect.MAVLink_message]:
        if now_s - self.heard_s > HEARTBEAT_PERIOD_S + FRESH_S:
            self._requests.renew()  # it may be rebooting
            return ()
        return self._requests.due(self._receiver.autopilot, now_s - self.odometry_s <= FRESH_S)
