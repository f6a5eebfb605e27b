"""A subscription that no executor waits for."""

from __future__ import annotations

from typing import Any, Iterator, Mapping, NamedTuple

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import (
    EventHandler, QoSSubscriptionEventType, SubscriptionEventCallbacks)
from rclpy.node import Node
from rclpy.qos import QoSProfile


class Arrival(NamedTuple):
    """A serialised message, and what the middleware says of it."""

    topic: str
    data: bytes
    info: Mapping[str, Any]


class PolledSubscription:
    """
    Serialised messages of a topic, and a count of lost ones, for whoever asks.

    An executor of rclpy builds its wait set twice for each message, which is most of the work of
    recording a small one. Messages know when they came, and their queue is long: they can wait.
    """

    def __init__(self, node: Node, msg_type: type, topic: str, qos: QoSProfile):
        self.qos = qos
        self._node = node
        group = _Unexecuted()
        self._subscription = node.create_subscription(
            msg_type, topic, lambda data: None, qos, raw=True, callback_group=group,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False))
        self._lost = _LostEvents(
            callback_group=group, callback=None, parent_impl=self._subscription.handle,
            event_type=QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST)

    @property
    def n_publishers(self) -> int:
        """Return the number of publishers that it hears."""
        return self._subscription.get_publisher_count()

    def take(self, limit: int) -> Iterator[Arrival]:
        """Yield messages that have arrived, up to a limit."""
        handle = self._subscription.handle
        with handle:
            for _ in range(limit):
                taken = handle.take_message(self._subscription.msg_type, True)
                if taken is None:
                    return
                yield Arrival(self._subscription.topic, *taken)

    def take_lost_count(self) -> int:
        """Return how many messages the middleware has lost since this was asked before."""
        return self._lost.take_count()

    def destroy(self) -> None:
        """Stop listening."""
        self._lost.destroy()
        self._node.destroy_subscription(self._subscription)


class _Unexecuted(CallbackGroup):

    def can_execute(self, entity) -> bool:
        return False


class _LostEvents(EventHandler):

    def take_count(self) -> int:
        self._ready_to_take_data = True  # else it waits for an executor to find it so
        event = self.take_data()
        return event.total_count_change if event else 0
