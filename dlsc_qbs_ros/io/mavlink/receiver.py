"""Packets from anyone → the odometry of one autopilot: all of a link but lines and threads."""

from __future__ import annotations

from collections import Counter
from typing import Callable, Iterator

from .clock import AutopilotClock
from .framing import dialect, Framer, Packet, SequenceCounter
from .odometry import OdometryAssembler
from .signing import Signing
from ...config import MavlinkConfig
from ...core.types import RawOdometry

# Who is silent for so long, while another beats so often, has been replaced.
SILENCE_NS = 10_000_000_000
N_BEATS = 5
# What does not fly; scripts often name an autopilot all the same, and a tracker has one.
NO_VEHICLES = {dialect.MAV_TYPE_GCS, dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_TYPE_GIMBAL,
               dialect.MAV_TYPE_ANTENNA_TRACKER}
REPLACED = 'mavlink_autopilots_replaced'


def _ignore(message: dialect.MAVLink_message) -> None:
    pass


class Receiver:
    """
    Believes one autopilot: the first whose HEARTBEAT fits the configuration.

    Once that one has fallen silent for long, another may take its place: that is another segment.
    Other messages of it go to `on_message` as well; with `signing`, nothing unsigned is believed.
    """

    def __init__(self, config: MavlinkConfig, *, signing: Signing | None = None,
                 on_message: Callable[[dialect.MAVLink_message], None] = _ignore):
        self._config = config
        self._signing = signing
        self._on_message = on_message
        self._framer = Framer(True)
        self._sequence = SequenceCounter()
        self.clock = AutopilotClock()
        self._assembler = OdometryAssembler(self.clock)
        self._counts: Counter[str] = Counter()
        self.autopilot: tuple[int, int] | None = None
        self._heard_ns = 0
        self._beats: Counter[tuple[int, int]] = Counter()  # of others, since it was heard
        self.foreign = 0
        self.unknown = 0
        self.accepted = 0

    def connected(self, datagrams: bool) -> None:
        """Begin with a new line, of datagrams or a stream."""
        self._counts['mavlink_corrupt'] += self._framer.corrupt
        self._framer = Framer(datagrams)

    def receive(self, data: bytes, arrival_ns: int) -> Iterator[RawOdometry]:
        """Yield the odometry that these bytes complete."""
        for packet in self._framer.feed(data):
            yield from self.take(packet, arrival_ns)

    def take(self, packet: Packet, arrival_ns: int) -> Iterator[RawOdometry]:
        """Yield the odometry that this packet completes."""
        refusal = self._signing.refusal(packet) if self._signing else None
        if refusal:
            self._counts[refusal] += 1
            return
        sender = packet.system, packet.component
        if sender != self.autopilot and self._is_wanted(packet):
            self._consider(sender, arrival_ns)
        if sender != self.autopilot:
            self.foreign += 1
            return
        self._heard_ns = arrival_ns
        self._beats.clear()
        self._sequence.observe(packet)
        if packet.message is None:
            self.unknown += 1
            return
        self.accepted += 1
        self._on_message(packet.message)
        yield from self._assembler.take(packet.message, arrival_ns)

    def counts(self) -> Counter[str]:
        """Return what was amiss, by cause."""
        return self._counts + self.clock.counts + self._assembler.counts + Counter(
            mavlink_corrupt=self._framer.corrupt, mavlink_lost=self._sequence.lost,
            mavlink_reordered=self._sequence.reordered)

    def state(self, now_ns: int) -> dict[str, object]:
        """Return the autopilot, what came, and the state of its clock."""
        system, component = self.autopilot or (0, 0)
        return {
            'mavlink_autopilot': f'{system}/{component}' if self.autopilot else 'none',
            'mavlink_packets': self.accepted, 'mavlink_foreign': self.foreign,
            'mavlink_unknown': self.unknown,
            'odometry_sigma_m': self._assembler.position_sigma_m,
            **self.clock.state(now_ns)}

    def _consider(self, sender: tuple[int, int], arrival_ns: int) -> None:
        """Believe another from now on, if nobody is, or who was believed is gone."""
        self._beats[sender] += 1
        if self.autopilot is None:
            self.autopilot = sender
        elif self._beats[sender] >= N_BEATS and arrival_ns - self._heard_ns > SILENCE_NS:
            self.autopilot = sender
            self._sequence.restart()
            self.clock.jump(REPLACED)

    def _is_wanted(self, packet: Packet) -> bool:
        message = packet.message
        return (message is not None and message.get_type() == 'HEARTBEAT'
                and message.autopilot != dialect.MAV_AUTOPILOT_INVALID
                and message.type not in NO_VEHICLES
                and self._config.system in (0, packet.system)
                and self._config.component in (0, packet.component))
