"""The recorder node: any topics, as they come over the wire, into one MCAP recording."""

from __future__ import annotations

from datetime import datetime
import re
import sys

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription

from ..config import RecorderConfig
from ..errors import ConfigError, RecordingError
from ..io.bag import BagWriter
from ..ros.diagnostics import ERROR, OK, publish_diagnostics, SequenceGaps, WARN
from ..ros.logging import forward_logging
from ..ros.parameters import load_config
from ..ros.qos import adapted_to, qos_to_words
from ..ros.runtime import run_node
from ..ros.serialization import message_type
from ..ros.stamps import received_ns

DISCOVERY_PERIOD_S = 0.1
QUEUE_DEPTH = 1000


class RecorderNode(Node):
    """Subscribes to what matches as it appears and writes every message unread."""

    def __init__(self):
        super().__init__('recorder')
        forward_logging(self)
        self._config = load_config(self, ('recorder',)).recorder
        self._pattern = _compiled(self._config)
        self._names = {self._resolved(topic) for topic in self._config.topics}
        self._recorded: dict[str, Subscription] = {}
        self._gaps: dict[str, SequenceGaps] = {}
        self._refused: set[str] = set()
        # Topics that had several publishers: each counts on its own, so gaps mean nothing.
        self._shared: set[str] = set()
        self._failure, self._not_written = '', 0
        self._writer = BagWriter(
            self._config.output or f'recording_{datetime.now():%Y_%m_%d-%H_%M_%S}')
        self.create_timer(DISCOVERY_PERIOD_S, self._discover,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))
        publish_diagnostics(self, self._report)
        self.get_logger().info(f'recording into {self._writer.directory}')

    def destroy_node(self) -> None:
        """Write what waits, finish the recording, then end; raise RecordingError if not whole."""
        try:
            for subscription in self._recorded.values():
                self._drain(subscription)
            self._writer.close()
            self.get_logger().info(f'{self._writer.directory}: {self._writer.message_count} '
                                   f'messages, {self._writer.byte_count} bytes')
        finally:
            super().destroy_node()

    def _resolved(self, topic: str) -> str:
        try:
            return self.resolve_topic_name(topic)
        except RuntimeError as error:
            raise ConfigError(f'recorder.topics: {topic!r} is no name of a topic') from error

    def _discover(self) -> None:
        """Subscribe to topics that match and are new, and where publishers changed their offer."""
        if self._failure or self._is_waiting_for_clock():
            return
        for topic, types in self.get_topic_names_and_types():
            if topic in self._refused or not self._matches(topic):
                continue
            offers = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
            if len(offers) > 1:
                self._shared.add(topic)
            if offers:
                try:
                    self._record(topic, types, offers)
                except RecordingError as error:
                    self._refused.add(topic)
                    self.get_logger().error(f'{topic} is not recorded: {error}')

    def _is_waiting_for_clock(self) -> bool:
        """Tell whether log times would lie before the simulated clock's first tick."""
        return self.get_clock().ros_time_is_active and self.get_clock().now().nanoseconds == 0

    def _matches(self, topic: str) -> bool:
        if not self._names and self._pattern is None:
            return not any(token.startswith('_') for token in topic.split('/'))  # hidden
        return topic in self._names or (
            self._pattern is not None and self._pattern.fullmatch(topic) is not None)

    def _record(self, topic: str, types: list[str], offers: list) -> None:
        qos = adapted_to(offers, QUEUE_DEPTH)
        subscription = self._recorded.get(topic)
        if subscription is None:
            if len(types) != 1:
                raise RecordingError(f'it has {len(types)} types, {", ".join(types)}; expected 1')
            msg_type = message_type(types[0])
            self._writer.add_topic(topic, types[0], [qos_to_words(offer) for offer in offers])
            self._gaps[topic] = SequenceGaps()
        elif subscription.qos_profile == qos:
            return
        else:
            msg_type = subscription.msg_type
            self.destroy_subscription(subscription)
        self._recorded[topic] = self.create_subscription(
            msg_type, topic, lambda data, info: self._write(topic, data, info), qos, raw=True)

    def _drain(self, subscription: Subscription) -> None:
        """Write what has arrived and no callback has seen."""
        with subscription.handle:
            for _ in range(QUEUE_DEPTH):
                taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    return
                subscription.callback(*taken)

    def _write(self, topic: str, data: bytes, info: dict) -> None:
        self._gaps[topic].observe(info['publication_sequence_number'])
        clock = self.get_clock()
        log_time_ns = clock.now().nanoseconds if clock.ros_time_is_active else received_ns(info)
        try:
            self._writer.write(topic, data, log_time_ns, info['source_timestamp'])
        except RecordingError as error:
            self._failure = str(error)
            self._not_written += 1
            self.get_logger().error(f'nothing more is recorded: {error}', once=True)

    def _report(self) -> tuple[bytes, str, dict[str, object]]:
        lost = sum(gaps.lost for topic, gaps in self._gaps.items() if topic not in self._shared)
        values = {'topics': len(self._recorded), 'messages': self._writer.message_count,
                  'bytes': self._writer.byte_count, 'lost': lost,
                  'not_written': self._not_written, 'output': str(self._writer.directory),
                  'refused_topics': ' '.join(sorted(self._refused))}
        if self._failure:
            return ERROR, self._failure, values
        awaited = self._awaited()
        problem = f'waiting for {", ".join(awaited)}' if awaited else 'losses' if lost else ''
        return WARN if problem or self._refused else OK, problem or 'recording', values

    def _awaited(self) -> list[str]:
        if self._is_waiting_for_clock():
            return ['/clock']
        if self._pattern is not None and not self._recorded:
            return [f'topics that match {self._config.regex}']
        return sorted(self._names - self._recorded.keys() - self._refused)


def _compiled(config: RecorderConfig) -> re.Pattern | None:
    try:
        return re.compile(config.regex) if config.regex else None
    except re.error as error:
        raise ConfigError(f'recorder.regex = {config.regex!r}: {error}') from error


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    return run_node(RecorderNode, args)


if __name__ == '__main__':
    sys.exit(main())
