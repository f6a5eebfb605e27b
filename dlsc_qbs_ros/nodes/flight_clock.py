"""The clock a flight was recorded under, running again on /clock."""

from __future__ import annotations

import time
from typing import Callable

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

from ..ros.qos import create_publisher
from ..ros.stamps import ns_to_stamp

CLOCK = '/clock'
STEP_NS = 1_000_000
WAKE_UP_S = 0.01


class FlightClock:
    """
    Stands at the flight's start, then runs at `rate` times wall time; infinite: never waits.

    `spin(seconds)` runs the node's callbacks for at most that long; False means stop.
    """

    def __init__(self, node: Node, rate: float, spin: Callable[[float], bool]):
        self._publisher = create_publisher(node, Clock, CLOCK, QoSProfile(depth=10))
        self._rate = rate
        self._spin = spin
        self._start_s = self._start_ns = self._now_ns = 0

    @property
    def flight_s(self) -> float:
        """Return the flight time that has passed."""
        return (self._now_ns - self._start_ns) * 1e-9

    @property
    def wall_s(self) -> float:
        """Return the wall time since the clock last stood."""
        return time.monotonic() - self._start_s

    def stand_at(self, flight_ns: int, lead_s: float = 0.0) -> None:
        """Tell the time at which the flight is going to start, in so many seconds from now."""
        self._start_s, self._start_ns = time.monotonic() + lead_s, flight_ns
        self._tell(flight_ns)

    def run_until(self, flight_ns: int) -> None:
        """Let the clock run until a time, and tell it."""
        due_s = (flight_ns - self._start_ns) * 1e-9 / self._rate
        # Time is read once a turn: a wait that had turned negative would never end.
        while (left_s := due_s - self.wall_s) > 0.0 and self._spin(min(left_s, WAKE_UP_S)):
            self._advance(min(flight_ns, self._start_ns + int(self.wall_s * self._rate * 1e9)))
        self._advance(flight_ns)

    def _advance(self, flight_ns: int) -> None:
        if flight_ns >= self._now_ns + STEP_NS:
            self._tell(flight_ns)

    def _tell(self, flight_ns: int) -> None:
        self._now_ns = flight_ns
        self._publisher.publish(Clock(clock=ns_to_stamp(flight_ns)))
