"""Stamps of messages ↔ integer nanoseconds."""

from __future__ import annotations

import time
from typing import Any, Mapping

from builtin_interfaces.msg import Time


def stamp_to_ns(stamp: Time) -> int:
    """Return the stamp in nanoseconds."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def ns_to_stamp(stamp_ns: int) -> Time:
    """Return the nanoseconds as a stamp."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def received_ns(info: Mapping[str, Any]) -> int:
    """Return when a message came, of its message info; now, where the middleware does not tell."""
    return info['received_timestamp'] or time.time_ns()
