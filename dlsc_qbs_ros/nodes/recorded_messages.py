"""What a replay plays: recorded messages, as they were or as if they were new."""

from __future__ import annotations

from contextlib import suppress
from functools import lru_cache
import heapq
from itertools import chain
from pathlib import Path
from typing import Collection, Iterator

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile

from .flight_clock import CLOCK
from ..errors import RecordingError
from ..io.recordings.bag import bag_topics, BagMessage, latched_topics, read_bag
from ..ros.conversions import odometry_to_msg
from ..ros.qos import create_publisher
from ..ros.serialization import (
    begins_with_header, header_stamp_ns, message_type, serialize, with_header_stamp)

ODOMETRY = '/odom'
ODOMETRY_TYPE = 'nav_msgs/msg/Odometry'
_begins_with_header = lru_cache(begins_with_header)


class Recording:
    """
    The messages of a flight in the order in which they came.

    With `tlog`, a recording of a MAVLink link on the same clock, its odometry is on `/odom`, in
    place of what was recorded there.
    """

    def __init__(self, flight: Path, tlog: Path | None = None):
        self.flight = flight
        self._tlog = tlog
        self.types = bag_topics(flight)
        self.latched = latched_topics(flight)
        if tlog is not None:
            self.types[ODOMETRY] = ODOMETRY_TYPE

    def messages(self, topics: Collection[str], start_ns: int | None = None
                 ) -> Iterator[BagMessage]:
        """Yield the messages of these topics; with a start, as if the first had come then."""
        messages = self._merged(topics)
        first = next(messages, None)
        if first is None:
            return
        shift_ns = 0 if start_ns is None else start_ns - first.log_time_ns
        for message in chain([first], messages):
            yield _moved(message, shift_ns) if shift_ns else message

    def _merged(self, topics: Collection[str]) -> Iterator[BagMessage]:
        if self._tlog is None or ODOMETRY not in topics:
            return read_bag(self.flight, topics)
        recorded = read_bag(self.flight, [topic for topic in topics if topic != ODOMETRY])
        return heapq.merge(recorded, _odometry(self._tlog),
                           key=lambda message: message.log_time_ns)


def _odometry(tlog: Path) -> Iterator[BagMessage]:
    from ..io.mavlink.tlog import TlogOdometry  # only here: flights alone need no pymavlink
    for raw in TlogOdometry(tlog):
        msg = odometry_to_msg(
            raw.sample, raw.forward_m_s, raw.yaw_rate_rad_s, 'odom', 'base_link')
        stamp_ns = raw.sample.stamp_ns
        yield BagMessage(ODOMETRY, ODOMETRY_TYPE, serialize(msg), stamp_ns, stamp_ns)


def _moved(message: BagMessage, shift_ns: int) -> BagMessage:
    """Return a message that came later, with the stamp of its header, if it begins with one."""
    data = message.data
    if _begins_with_header(message.type_name):
        with suppress(RecordingError):  # cut: left as it is, for whoever plays it to refuse
            data = with_header_stamp(data, header_stamp_ns(data) + shift_ns)
    return message._replace(data=data, log_time_ns=message.log_time_ns + shift_ns)


def advertise(node: Node, recording: Recording, topics: Collection[str] | None, depth: int
              ) -> dict[str, Publisher]:
    """
    Make a publisher for each topic to play; None: for all but the clock.

    Raises
    ------
    RecordingError
        When a topic that was asked for is not in the recording.

    """
    publishers = {}
    for topic in recording.types if topics is None else topics:
        if topic not in recording.types:
            raise RecordingError(f'{recording.flight}: no topic {topic!r}; '
                                 f'it has {", ".join(sorted(recording.types)) or "none"}')
        if topic == CLOCK:
            continue
        try:
            msg_type = message_type(recording.types[topic])
        except RecordingError as error:
            node.get_logger().warning(f'{topic} is not played: {error}')
            continue
        durability = (DurabilityPolicy.TRANSIENT_LOCAL if topic in recording.latched
                      else DurabilityPolicy.VOLATILE)
        publishers[topic] = create_publisher(
            node, msg_type, topic, QoSProfile(depth=depth, durability=durability))
    return publishers
