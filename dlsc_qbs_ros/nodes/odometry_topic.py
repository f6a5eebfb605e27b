"""Odometry from a nav_msgs/Odometry topic, behind the protocol of odometry sources."""

from __future__ import annotations

from collections import Counter
from typing import Callable

from nav_msgs.msg import Odometry
from rclpy.node import Node

from ..config import OdometryConfig
from ..core.types import OdometrySample
from ..errors import OdometryError
from ..pipeline.odometry import OdometryNormaliser
from ..ros.conversions import odometry_from_msg
from ..ros.diagnostics import SequenceGaps, why_silent
from ..ros.qos import create_subscription, ODOMETRY_INPUT


class OdometryTopic:
    """Delivers what arrives on `odom`; refuses and counts what holds no pose."""

    def __init__(self, node: Node, config: OdometryConfig):
        self._node = node
        self._normaliser = OdometryNormaliser(config)
        self._gaps = SequenceGaps()
        self.frame_id = 'odom'

    def start(self, deliver: Callable[[OdometrySample], None]) -> None:
        """Begin to deliver."""
        self._deliver = deliver
        self._gaps.restart()
        self._subscription = create_subscription(
            self._node, Odometry, 'odom', self._on_odometry, ODOMETRY_INPUT)

    def stop(self) -> None:
        """Stop delivering."""
        self._node.destroy_subscription(self._subscription)

    def reconfigure(self, config: OdometryConfig) -> None:
        """Go on with other limits."""
        self._normaliser.reconfigure(config)

    def diagnostics(self) -> Counter[str]:
        """Return what was accepted, lost, and refused by cause."""
        return self._normaliser.counts + Counter(odometry_lost=self._gaps.lost)

    def why_silent(self) -> str:
        """Return in plain words why no odometry comes."""
        return why_silent(self._node, self._subscription)

    def state(self) -> dict[str, object]:
        """Return nothing: a topic has no state."""
        return {}

    def _on_odometry(self, msg: Odometry, info: dict) -> None:
        self._gaps.observe(info['publication_sequence_number'])
        try:
            raw = odometry_from_msg(msg)
        except OdometryError as error:
            self._normaliser.counts['odometry_malformed'] += 1
            self._node.get_logger().warning(
                f'odometry refused: {error}', throttle_duration_sec=5.0)
            return
        self.frame_id = msg.header.frame_id or self.frame_id
        sample = self._normaliser.accept(raw)
        if sample is not None:
            self._deliver(sample)
