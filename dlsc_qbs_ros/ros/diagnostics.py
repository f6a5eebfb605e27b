"""What a node says about itself, once a second."""

from __future__ import annotations

from typing import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from .conversions import diagnostics_to_msg
from .qos import create_publisher, OUTPUT
from .serialization import type_name

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
PERIOD_S = 1.0

Report = Callable[[], tuple[bytes, str, dict[str, object]]]


def publish_diagnostics(node: Node, report: Report) -> None:
    """
    Publish `report()`, (level, message, values), on /diagnostics once a second.

    The second is one of wall time: a node must be heard under a simulated clock that stands still.
    """
    publisher = create_publisher(node, DiagnosticArray, '/diagnostics', OUTPUT)

    def publish() -> None:
        publisher.publish(diagnostics_to_msg(
            node.get_clock().now().nanoseconds, node.get_fully_qualified_name(), *report()))
    node.create_timer(PERIOD_S, publish, clock=Clock(clock_type=ClockType.STEADY_TIME))


def why_silent(node: Node, subscription: Subscription) -> str:
    """Return in plain words why nothing comes over a subscription."""
    topic = subscription.topic_name
    publishers = node.get_publishers_info_by_topic(topic)
    if not publishers:
        return f'nobody publishes {topic}'
    unheard = '; '.join(filter(None, (_why_unheard(p, subscription) for p in publishers)))
    if unheard:
        return f'{topic} is published {unheard}: nothing can arrive'
    return f'{topic} is published by {", ".join(map(_name, publishers))}, but nothing comes'


def _why_unheard(publisher: TopicEndpointInfo, subscription: Subscription) -> str:
    """Return what is incompatible about a publisher; nothing where the two can talk."""
    offered, asked = publisher.qos_profile, subscription.qos_profile
    wanted = type_name(subscription.msg_type)
    if publisher.topic_type != wanted:
        unlike = f'{publisher.topic_type}, not {wanted}'
    elif (offered.reliability, asked.reliability) == (
            ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE):
        unlike = 'best effort, not reliable'
    elif (offered.durability, asked.durability) == (
            DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL):
        unlike = 'volatile, not transient local'
    else:
        return ''
    return f'by {_name(publisher)} as {unlike}'


def _name(publisher: TopicEndpointInfo) -> str:
    return f'{publisher.node_namespace.rstrip("/")}/{publisher.node_name}'


class SequenceGaps:
    """Losses, seen as gaps in the publication sequence numbers of one publisher."""

    def __init__(self):
        self.lost = 0
        self._last: int | None = None

    def restart(self) -> None:
        """Take in that nobody listened for a while."""
        self._last = None

    def observe(self, sequence_number: int | None) -> None:
        """
        Take the next number, or None from a middleware that does not count.

        A number that does not rise belongs to a publisher that restarted.
        """
        if None not in (sequence_number, self._last) and sequence_number > self._last:
            self.lost += sequence_number - self._last - 1
        self._last = sequence_number
