"""What a node says about itself, once a second."""

from __future__ import annotations

from typing import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from .conversions import diagnostics_to_msg
from .qos import create_publisher, OUTPUT

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


class SequenceGaps:
    """Losses, seen as gaps in the publication sequence numbers of one publisher."""

    def __init__(self):
        self.lost = 0
        self._last: int | None = None

    def observe(self, sequence_number: int | None) -> None:
        """
        Take the next number, or None from a middleware that does not count.

        A number that does not rise belongs to a publisher that restarted.
        """
        if None not in (sequence_number, self._last) and sequence_number > self._last:
            self.lost += sequence_number - self._last - 1
        self._last = sequence_number
