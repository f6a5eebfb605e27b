"""The time of a node's clock at which messages arrived."""

from __future__ import annotations

import time

from rclpy.clock import Clock

from .polled_subscription import Arrival
from ..ros.stamps import received_ns


class ArrivalClock:
    """
    Arrivals on the node's clock.

    The middleware stamps them with wall time. A simulated clock is read at `tick`, before
    arrivals are looked for, and interpolated between two ticks.
    """

    def __init__(self, clock: Clock):
        self._clock = clock
        self._before = self._last = (0, 0)  # wall time, time of the clock

    def tick(self) -> None:
        """Read the clock."""
        self._before, self._last = self._last, (time.time_ns(), self._clock.now().nanoseconds)

    def time_ns(self, arrival: Arrival) -> int:
        """Return when a message came; when the clock did not run evenly, of the last tick."""
        wall_ns = received_ns(arrival.info)
        if not self._clock.ros_time_is_active:
            return wall_ns
        (wall_0, time_0), (wall_1, time_1) = self._before, self._last
        if not (0 < time_0 <= time_1 and wall_0 < wall_1):
            return time_1
        share = min(max((wall_ns - wall_0) / (wall_1 - wall_0), 0.0), 1.0)
        return time_0 + round(share * (time_1 - time_0))
