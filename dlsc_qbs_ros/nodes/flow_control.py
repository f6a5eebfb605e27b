"""Keeps a replay close to those who work on it, so that results do not depend on its speed."""

from __future__ import annotations

import time
from typing import Callable, Collection

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

from ..ros.serialization import header_stamp_ns

RESULTS = {'code': Image, 'pose': PoseWithCovarianceStamped}
MAX_LEAD_NS = 1_000_000_000
PATIENCE_S = 5.0


class FlowControl:
    """
    Watches the stamps of `code` and `pose`, where somebody publishes them.

    `played` are the topics of the replay itself: recorded results are no measure of progress.
    `spin(seconds)` runs the node's callbacks for at most that long; False means stop.
    """

    def __init__(self, node: Node, played: Collection[str], spin: Callable[[float], bool]):
        self._node = node
        self._spin = spin
        self._newest_ns: dict[str, int] | None = None
        self._names = []
        for topic, msg_type in RESULTS.items():
            name = node.resolve_topic_name(topic)
            if name not in played:
                self._names.append(name)
                node.create_subscription(
                    msg_type, topic, self._watcher(name),
                    QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT), raw=True)

    def stay_close(self, stamp_ns: int) -> None:
        """
        Wait until nobody is more than `MAX_LEAD_NS` behind a stamp that is about to go out.

        Whoever makes no progress for `PATIENCE_S` is left behind until it speaks again.
        """
        if self._newest_ns is None:
            self._newest_ns = {
                name: stamp_ns for name in self._names if self._node.count_publishers(name)}
        while lagging := [name for name, newest_ns in self._newest_ns.items()
                          if newest_ns < stamp_ns - MAX_LEAD_NS]:
            seen = dict(self._newest_ns)
            give_up_s = time.monotonic() + PATIENCE_S
            while self._newest_ns == seen and time.monotonic() < give_up_s:
                if not self._spin(0.05):
                    return
            if self._newest_ns == seen:
                self._leave_behind(lagging)

    def settle(self, seconds: float) -> None:
        """Wait until no result has come for so long."""
        seen, quiet_s = None, time.monotonic() + seconds
        while time.monotonic() < quiet_s and self._spin(0.05):
            if self._newest_ns != seen:
                seen, quiet_s = dict(self._newest_ns or {}), time.monotonic() + seconds

    def _leave_behind(self, names: list[str]) -> None:
        for name in names:
            del self._newest_ns[name]
            self._node.get_logger().warning(
                f'no new {name} for {PATIENCE_S:g} s: going on without it')

    def _watcher(self, name: str) -> Callable[[bytes], None]:
        def see(data: bytes) -> None:
            if self._newest_ns is not None:
                self._newest_ns[name] = header_stamp_ns(data)
        return see
