"""One topic on its way into a recording."""

from __future__ import annotations

from collections import deque
import time
from typing import Any, Iterable, Mapping, Sequence

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from .polled_subscription import Arrival, PolledSubscription
from .recorder_losses import PublicationGaps
from ..ros.qos import adapted_to, is_compatible
from ..ros.qos_overrides import overridden
from ..ros.serialization import message_type

QUEUE_DEPTH = 1000
MATCHING_S = 0.2


class RecordedTopic:
    """
    A subscription that follows what the publishers of a topic offer, and what it missed.

    Where a policy has an override, it is not adapted.

    Raises
    ------
    RecordingError
        When the type of its messages is not installed.

    """

    def __init__(self, node: Node, topic: str, type_name: str, overrides: Mapping[str, Any]):
        self.type_name = type_name
        self.gaps = PublicationGaps(lambda: _gids(
            info for info in node.get_publishers_info_by_topic(topic)
            if info.topic_type == type_name))
        self.lost_events = 0
        self._node = node
        self._topic = topic
        self._msg_type = message_type(type_name)
        self._overrides = overrides
        self._subscription: PolledSubscription | None = None
        self._publishers: set[bytes] = set()
        self._last_of_before: list[Arrival] = []  # of the subscription before this one
        self._taken: deque[tuple[int, int]] = deque(maxlen=QUEUE_DEPTH)
        self._taken_before: set[tuple[int, int]] = set()

    def is_changed(self, offers: Sequence[TopicEndpointInfo]) -> bool:
        """Tell whether others publish than those that were listened to."""
        return self._subscription is None or self._publishers != _gids(offers)

    def listen(self, offers: Sequence[TopicEndpointInfo]) -> None:
        """
        Subscribe; anew where there is a publisher that the subscription is not compatible with.

        What suits all who publish may not suit the next. When others take the place of all of
        them, a stricter profile may get more from these: what was latched.
        """
        are_others = self._publishers.isdisjoint(_gids(offers))
        self._publishers = _gids(offers)
        qos = overridden(
            adapted_to([info.qos_profile for info in offers], QUEUE_DEPTH), self._overrides)
        before = self._subscription
        if before is not None and (before.qos == qos or not are_others and all(
                is_compatible(info.qos_profile, before.qos) for info in offers)):
            return
        if not all(is_compatible(info.qos_profile, qos) for info in offers):
            self._node.get_logger().warning(
                f'{self._topic}: its override asks for more than a publisher offers: nothing of '
                'that one is recorded')
        self._subscription = PolledSubscription(self._node, self._msg_type, self._topic, qos)
        if before is not None:
            self._replace(before)

    def take(self) -> list[Arrival]:
        """Return what has arrived."""
        arrived, self._last_of_before = self._last_of_before, []
        if self._subscription is not None:
            arrived += self._take_from(self._subscription)
        return arrived

    def leave(self) -> None:
        """Stop listening."""
        if self._subscription is not None:
            self._subscription.destroy()
            self._subscription = None
            self.gaps.restart()

    def _replace(self, before: PolledSubscription) -> None:
        """Go over from one subscription to the next with no gap and no doubles."""
        until_s = time.monotonic() + MATCHING_S
        while (self._subscription.n_publishers < len(self._publishers)
               and time.monotonic() < until_s):
            time.sleep(0.001)
        self._last_of_before += self._take_from(before)
        self._taken_before = set(self._taken)
        before.destroy()

    def _take_from(self, subscription: PolledSubscription) -> list[Arrival]:
        arrived = [arrival for arrival in subscription.take(QUEUE_DEPTH)
                   if _identity(arrival) not in self._taken_before]
        for arrival in arrived:
            self.gaps.observe(arrival.info['publication_sequence_number'])
            self._taken.append(_identity(arrival))
        self.lost_events += subscription.take_lost_count()
        return arrived


def _gids(publishers: Iterable[TopicEndpointInfo]) -> set[bytes]:
    return {bytes(info.endpoint_gid) for info in publishers}


def _identity(arrival: Arrival) -> tuple[int, int]:
    return arrival.info['publication_sequence_number'], arrival.info['source_timestamp']
