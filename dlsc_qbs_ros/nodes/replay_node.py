"""The replay node: a recorded flight onto live topics, with the clock it was recorded under."""

from __future__ import annotations

from collections import Counter
from itertools import chain
import time
from typing import Collection, NamedTuple

from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from .flight_clock import FlightClock
from .flow_control import FlowControl
from .recorded_messages import advertise, Recording
from ..errors import RecordingError
from ..io.recordings.bag import BagMessage
from ..ros.logging import forward_logging
from ..ros.runtime import StopRequest
from ..ros.serialization import header_stamp_ns

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
    With `start_ns`, it begins when the system's clock tells that, as if recorded from then on.
    """

    def __init__(self, recording: Recording, topics: Collection[str] | None, rate: float,
                 start_ns: int | None, stop: StopRequest):
        super().__init__('replay')
        forward_logging(self)
        self._recording = recording
        self._start_ns = start_ns
        self._stop = stop
        self._spinner = SingleThreadedExecutor()
        self._spinner.add_node(self)
        self._flight_clock = FlightClock(self, rate, self._spin)
        self._publishers_of = advertise(self, recording, topics, QUEUE_DEPTH)
        self._flow = FlowControl(
            self, {publisher.topic_name for publisher in self._publishers_of.values()},
            self._spin)

    def play(self, wait_s: float) -> Played:
        """Wait for subscribers, then play to the end or a stop request."""
        counts: Counter[str] = Counter()
        messages = self._recording.messages(self._publishers_of, self._start_ns)
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

    def _wait_for_subscribers(self, seconds: float, start_ns: int) -> None:
        """
        Wait, at most so long, until every sensor topic has a subscriber and no more are coming.

        A recorder subscribes only once it has seen the publishers and the clock.
        """
        sensors = [topic for topic in self._publishers_of
                   if self._recording.types[topic] in SENSOR_TYPES]
        until_s = time.monotonic() + seconds
        seen, settled_s = None, 0.0
        self._stand_at(start_ns)
        while time.monotonic() < until_s and self._spin(0.05):
            self._stand_at(start_ns)
            counts = {topic: publisher.get_subscription_count()
                      for topic, publisher in self._publishers_of.items()}
            if counts != seen:
                seen, settled_s = counts, time.monotonic() + SETTLE_S
            elif all(map(counts.get, sensors)) and time.monotonic() > settled_s:
                return
        for topic in sensors:
            if not self._publishers_of[topic].get_subscription_count():
                self.get_logger().warning(f'nobody subscribes to {topic}')

    def _stand_at(self, first_ns: int) -> None:
        """Let the flight start now, or when the time of its first message has come."""
        lead_s = 0.0 if self._start_ns is None else (first_ns - time.time_ns()) * 1e-9
        self._flight_clock.stand_at(first_ns, lead_s)

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
