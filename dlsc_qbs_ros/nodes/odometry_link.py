"""Odometry from an autopilot's MAVLink link, behind the protocol of odometry sources."""

from __future__ import annotations

from collections import Counter, deque
from pathlib import Path
from typing import Callable

from rclpy.node import Node

from ..config import Config, OdometryConfig
from ..core.types import OdometrySample, RawOdometry
from ..io.mavlink.link import MavlinkLink
from ..io.mavlink.tlog import TlogPlayer
from ..pipeline.odometry import OdometryNormaliser

# Ten seconds at 200 Hz: more is only held while the executor stands still for longer.
MAX_WAITING = 2000


class OdometryLink:
    """
    Delivers what an autopilot sends, on the thread of the node's executor.

    The link has a thread of its own, which may not call what the executor runs: it puts samples
    in a queue and wakes the executor up.
    """

    frame_id = 'odom'

    def __init__(self, node: Node, config: Config):
        self._node = node
        self._normaliser = OdometryNormaliser(config.odometry)
        self._waiting: deque[RawOdometry] = deque()
        self._lost = 0
        if Path(config.mavlink.connection).suffix == '.tlog':
            self._link = TlogPlayer(config.mavlink)
        else:
            self._link = MavlinkLink(config.mavlink, lambda: node.get_clock().now().nanoseconds)
        self.send = self._link.send

    def start(self, deliver: Callable[[OdometrySample], None]) -> None:
        """Begin to deliver."""
        self._deliver = deliver
        self._wake_up = self._node.create_guard_condition(self._drain)
        self._link.start(self._enqueue)

    def stop(self) -> None:
        """Stop delivering."""
        self._link.stop()
        self._node.destroy_guard_condition(self._wake_up)
        self._waiting.clear()

    def reconfigure(self, config: OdometryConfig) -> None:
        """Go on with other limits."""
        self._normaliser.reconfigure(config)

    def diagnostics(self) -> Counter[str]:
        """Return what was accepted, lost, and refused by cause."""
        return (self._normaliser.counts + self._link.diagnostics()
                + Counter(odometry_lost=self._lost))

    def state(self) -> dict[str, object]:
        """Return words and figures on the link."""
        return self._link.state()

    def why_silent(self) -> str:
        """Return in plain words why no odometry comes."""
        return self._link.why_silent()

    def _enqueue(self, raw: RawOdometry) -> None:
        if len(self._waiting) < MAX_WAITING:
            self._waiting.append(raw)
        else:
            self._lost += 1
        self._wake_up.trigger()

    def _drain(self) -> None:
        while self._waiting:
            sample = self._normaliser.accept(self._waiting.popleft())
            if sample is not None:
                self._deliver(sample)
