"""What a recording lacks → message."""

from __future__ import annotations

from typing import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from .conversions import diagnostics_to_msg


def losses_to_msg(stamp_ns: int, losses: Mapping[str, Mapping[str, object]]) -> DiagnosticArray:
    """Return a status for each topic, `lost` among its values, as one diagnostic array."""
    array = DiagnosticArray()
    for topic, values in losses.items():
        msg = diagnostics_to_msg(
            stamp_ns, topic, DiagnosticStatus.WARN, f'{values["lost"]} messages lost', values)
        array.header = msg.header
        array.status.extend(msg.status)
    return array
