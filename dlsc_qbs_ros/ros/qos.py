"""Quality of service: the profiles of the topics, overridable, and rosbag2's words for them."""

from __future__ import annotations

from contextlib import contextmanager
from copy import copy
import time
from typing import Any, Callable, Iterator, Sequence

from rclpy.duration import Duration
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy, qos_check_compatible, QoSCompatibility, QoSProfile, ReliabilityPolicy)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from ..errors import ConfigError

# Sensor data: deep enough for a short burst, no deeper, or a slow board falls seconds behind.
IMAGE_INPUT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
ODOMETRY_INPUT = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)
OUTPUT = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE)
# Depth 1 would drop a dictionary that is followed by the next before the reader has taken it.
DICTIONARY = QoSProfile(
    depth=5, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
MAP = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def create_publisher(node: Node, msg_type: type, topic: str, qos: QoSProfile) -> Publisher:
    """Create a publisher whose profile `qos_overrides` may change; raise ConfigError if badly."""
    with _overrides_checked(topic):
        return node.create_publisher(  # rclpy writes the overrides into the profile: pass a copy
            msg_type, topic, copy(qos),
            qos_overriding_options=QoSOverridingOptions.with_default_policies())


def create_subscription(node: Node, msg_type: type, topic: str, callback: Callable,
                        qos: QoSProfile) -> Subscription:
    """Create a subscription whose profile `qos_overrides` may change; raise ConfigError."""
    with _overrides_checked(topic):
        return node.create_subscription(
            msg_type, topic, callback, copy(qos),
            qos_overriding_options=QoSOverridingOptions.with_default_policies())


def wait_until_received(publishers: Sequence[Publisher], seconds: float) -> None:
    """
    Give reliable subscribers time for what was published last, before the publishers go.

    A subscriber that learns first that a publisher is gone drops what is still on its way.
    """
    until_s = time.monotonic() + seconds
    for publisher in publishers:
        left_s = max(until_s - time.monotonic(), 0.0)
        publisher.wait_for_all_acked(Duration(seconds=left_s))


def adapted_to(offers: Sequence[QoSProfile], depth: int) -> QoSProfile:
    """Return the strictest profile that is compatible with every publisher's offer."""
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    latched = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


def is_compatible(offered: QoSProfile, requested: QoSProfile) -> bool:
    """Tell whether a subscription hears a publisher."""
    return qos_check_compatible(offered, requested)[0] != QoSCompatibility.ERROR


def qos_to_words(qos: QoSProfile) -> dict[str, Any]:
    """Return an offered profile in the words that rosbag2 keeps in a recording."""
    return {
        'history': 'unknown',  # discovery does not tell history and depth
        'depth': 0,
        'reliability': qos.reliability.short_key,
        'durability': qos.durability.short_key,
        'deadline': _duration(qos.deadline),
        'lifespan': _duration(qos.lifespan),
        'liveliness': qos.liveliness.short_key,
        'liveliness_lease_duration': _duration(qos.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': qos.avoid_ros_namespace_conventions}


def _duration(duration: Duration) -> dict[str, int]:
    sec, nsec = divmod(duration.nanoseconds, 1_000_000_000)
    return {'sec': sec, 'nsec': nsec}


@contextmanager
def _overrides_checked(topic: str) -> Iterator[None]:
    try:
        yield
    except (ParameterException, RuntimeError) as error:
        raise ConfigError(f'qos_overrides of topic {topic!r}: {error}') from error
