"""The replay node: a recorded flight onto live topics, with the clock it was recorded under."""

from __future__ import annotations

from collections import Counter
from itertools import chain
from pathlib import Path
import time
from typing import Collection, NamedTuple

from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile

from .flight_clock import CLOCK, FlightClock
from .flow_control import FlowControl
from ..errors import RecordingError
from ..io.bag import bag_topics, BagMessage, latched_topics, read_bag
from ..ros.logging import forward_logging
from ..ros.qos import create_publisher
from ..ros.runtime import StopRequest
from ..ros.serialization import header_stamp_ns, message_type

SENSOR_TYPES = (
    'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage', 'nav_msgs/msg/Odometry')
# Fast DDS asks for acknowledgements every 3 s only: few waits, and a queue that holds far more
# than is played between two of them. Only what is not acknowledged takes memory.
QUEUE_DEPTH = 10000
UNACKNOWLEDGED = 5000
PATIENCE_S = 5.0
SETTLE_S = 0.5


class Played(NamedTuple):
    """What a replay published: messages per topic, and how long it took."""

    counts: Counter[str]
    flight_s: float
    wall_s: float


class ReplayNode(Node):
    """
    Publishes what was recorded, byte for byte, paced by the log times.

    `rate` is flight time over wall time; infinite: as fast as those who work on it can follow.
    """

    def __init__(self, flight: Path, topics: Collection[str] | None, rate: float,
                 stop: StopRequest):
        super().__init__('replay')
        forward_logging(self)
        self._flight = flight
        self._stop = stop
        self._spinner = SingleThreadedExecutor()
        self._spinner.add_node(self)
        self._flight_clock = FlightClock(self, rate, self._spin)
        self._types = bag_topics(flight)
        self._publishers_of = self._make_publishers(topics)
        self._flow = FlowControl(
            self, {publisher.topic_name for publisher in self._publishers_of.values()},
            self._spin)

    def play(self, wait_s: float) -> Played:
        """Wait for subscribers, then play to the end or a stop request."""
        counts: Counter[str] = Counter()
        messages = read_bag(self._flight, self._publishers_of)
        first = next(messages, None)
        if first is None:
            return Played(counts, 0.0, 0.0)
        self._wait_for_subscribers(wait_s, first.log_time_ns)
        for message in chain([first], messages):
            is_sound = self._wait_until_due(message)
            if self._stop.received:
                break
            if not is_sound:
                continue
            self._publishers_of[message.topic].publish(message.data)
            counts[message.topic] += 1
            if counts[message.topic] % UNACKNOWLEDGED == 0:
                self._wait_until_acknowledged(message.topic)
        played = Played(counts, self._flight_clock.flight_s, self._flight_clock.wall_s)
        for topic in self._publishers_of:
            self._wait_until_acknowledged(topic)
        self._flow.settle(SETTLE_S)
        return played

    def _wait_until_due(self, message: BagMessage) -> bool:
        """Wait for clock and listeners; return False when the message is no sound one."""
        self._flight_clock.run_until(message.log_time_ns)
        if message.type_name in SENSOR_TYPES:
            try:
                self._flow.stay_close(header_stamp_ns(message.data))
            except RecordingError as error:
                self.get_logger().warning(
                    f'{message.topic}: a message is not played: {error}')
                return False
        return True

    def _make_publishers(self, topics: Collection[str] | None) -> dict[str, Publisher]:
        """Make a publisher for each topic to play; of a topic asked for, the type must be here."""
        latched = latched_topics(self._flight)
        publishers = {}
        for topic in self._types if topics is None else topics:
            if topic not in self._types:
                raise RecordingError(f'{self._flight}: no topic {topic!r}; '
                                     f'it has {", ".join(sorted(self._types)) or "none"}')
            if topic == CLOCK:
                continue
            try:
                msg_type = message_type(self._types[topic])
            except RecordingError as error:
                self.get_logger().warning(f'{topic} is not played: {error}')
                continue
            durability = (DurabilityPolicy.TRANSIENT_LOCAL if topic in latched
                          else DurabilityPolicy.VOLATILE)
            publishers[topic] = create_publisher(
                self, msg_type, topic, QoSProfile(depth=QUEUE_DEPTH, durability=durability))
        return publishers

    def _wait_for_subscribers(self, seconds: float, start_ns: int) -> None:
        """
        Wait, at most so long, until every sensor topic has a subscriber and no more are coming.

        A recorder subscribes only once it has seen the publishers and the clock.
        """
        sensors = [topic for topic in self._publishers_of if self._types[topic] in SENSOR_TYPES]
        until_s = time.monotonic() + seconds
        seen, settled_s = None, 0.0
        self._flight_clock.stand_at(start_ns)
        while time.monotonic() < until_s and self._spin(0.05):
            self._flight_clock.stand_at(start_ns)
            counts = {topic: publisher.get_subscription_count()
                      for topic, publisher in self._publishers_of.items()}
            if counts != seen:
                seen, settled_s = counts, time.monotonic() + SETTLE_S
            elif all(map(counts.get, sensors)) and time.monotonic() > settled_s:
                return
        for topic in sensors:
            if not self._publishers_of[topic].get_subscription_count():
                self.get_logger().warning(f'nobody subscribes to {topic}')

    def _wait_until_acknowledged(self, topic: str) -> None:
        """Wait, at most `PATIENCE_S`, until reliable subscribers have all that was published."""
        until_s = time.monotonic() + PATIENCE_S
        while not self._publishers_of[topic].wait_for_all_acked(Duration(seconds=0.1)):
            if self._stop.received:
                return
            if time.monotonic() > until_s:
                self.get_logger().warning(f'{topic}: a subscriber does not acknowledge')
                return

    def _spin(self, seconds: float) -> bool:
        self._spinner.spin_once(timeout_sec=seconds)
        return not self._stop.received
