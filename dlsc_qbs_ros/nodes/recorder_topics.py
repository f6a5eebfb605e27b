"""The topics that a recorder has found, and what it missed of them."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from .polled_subscription import Arrival
from .recorded_topic import RecordedTopic
from .recorder_losses import Losses
from .recorder_selection import TopicSelection
from ..errors import RecordingError
from ..io.recordings.ledger import RecordingStatus, TopicCounts
from ..io.recordings.recording import Recording
from ..ros.qos import qos_to_words
from ..ros.qos_overrides import Overrides
from ..ros.stamps import received_ns


class RecorderTopics:
    """
    Finds topics that are to be recorded, announces them to the recording and listens to them.

    `refused` holds topics that cannot be recorded, or types on them, and why.
    """

    def __init__(self, node: Node, recording: Recording, selection: TopicSelection,
                 overrides: Overrides):
        self.refused: dict[str, str] = {}
        self._undecided: set[str] = set()  # of these, those that only now have several types
        self._node = node
        self._recording = recording
        self._selection = selection
        self._overrides = overrides
        self._topics: dict[str, RecordedTopic] = {}

    def discover(self) -> None:
        """Listen to topics that are new, and anew where publishers changed what they offer."""
        for topic, _ in self._node.get_topic_names_and_types():
            if topic not in self._selection or topic in self.refused.keys() - self._undecided:
                continue
            offers = self._node.get_publishers_info_by_topic(topic)
            if offers:
                try:
                    self._record(topic, offers)
                except RecordingError as error:
                    self._refuse(topic, str(error))

    def take(self) -> list[Arrival]:
        """Return what has arrived, in the order of arrival."""
        arrived = [arrival for topic in self._topics.values() for arrival in topic.take()]
        return sorted(arrived, key=lambda arrival: received_ns(arrival.info))

    def leave(self) -> None:
        """Stop listening."""
        for topic in self._topics.values():
            topic.leave()

    def awaited(self) -> list[str]:
        """Return what is to be recorded and was not found yet."""
        return self._selection.awaited(self._topics.keys() | self.refused)

    def losses(self, status: RecordingStatus) -> dict[str, Losses]:
        """Return what of each topic did not get here, or not from here to the disk."""
        counts = {name: status.topics.get(name, TopicCounts()) for name in self._topics}
        return {name: Losses(topic.gaps.lost, topic.lost_events, counts[name].overflowed,
                             counts[name].not_written)
                for name, topic in self._topics.items()}

    def missed(self) -> dict[str, str]:
        """Return in words what did not get here; safe to call from any thread."""
        words = {}
        for name, topic in dict(self._topics).items():
            if sum(topic.gaps.lost):
                words[f'{name} gaps'] = ' '.join(map(str, topic.gaps.lost))
            if topic.lost_events:
                words[f'{name} message_lost'] = str(topic.lost_events)
        return words

    def _refuse(self, name: str, reason: str) -> None:
        if name not in self.refused:
            self.refused[name] = reason
            self._node.get_logger().error(f'{name} is not recorded: {reason}')

    def _record(self, topic: str, offers: list[TopicEndpointInfo]) -> None:
        types = sorted({info.topic_type for info in offers})
        recorded = self._topics.get(topic)
        if recorded is None:
            recorded = self._decide(topic, types)
        if recorded is None:
            return
        for other in types:
            if other != recorded.type_name:
                self._refuse(f'{topic} of {other}', f'it is recorded as {recorded.type_name}')
        fitting = [info for info in offers if info.topic_type == recorded.type_name]
        if not fitting or not recorded.is_changed(fitting):
            return
        self._recording.add_topic(
            topic, recorded.type_name, [qos_to_words(info.qos_profile) for info in fitting])
        self._topics[topic] = recorded
        recorded.listen(fitting)

    def _decide(self, topic: str, types: list[str]) -> RecordedTopic | None:
        """Return a new topic; none as long as its publishers disagree on the type."""
        if len(types) > 1:
            self._undecided.add(topic)
            self._refuse(topic, f'it has {len(types)} types, {", ".join(types)}; expected 1')
            return None
        if topic in self._undecided:
            self._undecided.remove(topic)
            del self.refused[topic]
        return RecordedTopic(self._node, topic, types[0], self._overrides.get(topic, {}))
