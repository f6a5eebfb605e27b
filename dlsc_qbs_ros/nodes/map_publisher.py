"""The topics `path` and `experience_map`: the whole map, the more rarely the larger it is."""

from __future__ import annotations

import time

from nav_msgs.msg import Path
from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from ..pipeline.mapper import Mapper
from ..ros.map_conversions import experience_map_to_cdr, path_to_cdr
from ..ros.qos import create_publisher, MAP, wait_until_received

LAST_WORDS_S = 0.5


class MapPublisher:
    """
    Publishes a map that changed to whom it may concern, and any map to a subscriber that is new.

    At most each `PERIOD_S`, or `PER_EXPERIENCE_S` for each experience if that is more: of
    20,000 experiences every 5 s, as few bytes per second as of 2000.
    """

    PERIOD_S = 0.5
    PER_EXPERIENCE_S = 2.5e-4

    def __init__(self, node: Node):
        self._path = create_publisher(node, Path, 'path', MAP)
        self._markers = create_publisher(node, MarkerArray, 'experience_map', MAP)
        self._publishers = self._path, self._markers
        self._heard_by = [0, 0]
        self._stamp_ns: int | None = None
        self._is_news = False
        self._due_s = 0.0
        self._mapper: Mapper | None = None

    def map_updated(self, stamp_ns: int) -> None:
        """Take in that the map changed, at a stamp."""
        self._stamp_ns, self._is_news = stamp_ns, True

    def publish(self, mapper: Mapper, frame_id: str) -> None:
        """Publish what is due: call this each `PERIOD_S`."""
        self._look_at(mapper)
        if self._stamp_ns is None:
            return
        heard_by = [publisher.get_subscription_count() for publisher in self._publishers]
        is_wanted = [now > before for now, before in zip(heard_by, self._heard_by)]
        self._heard_by = heard_by
        if self._is_news and time.monotonic() >= self._due_s:
            is_wanted = [count > 0 for count in heard_by]
            self._due_s = time.monotonic() + self.PER_EXPERIENCE_S * len(mapper.map)
            self._is_news = False
        self._publish(mapper, frame_id, *is_wanted)

    def publish_last(self, mapper: Mapper, frame_id: str) -> None:
        """Publish the map for those to come, and wait for those who listen."""
        self._look_at(mapper)
        if self._stamp_ns is not None:
            self._publish(mapper, frame_id, True, True)
            wait_until_received(self._publishers, LAST_WORDS_S)

    def _look_at(self, mapper: Mapper) -> None:
        """Notice another map, which was loaded or is empty again; nobody waits to see that."""
        if mapper is self._mapper:
            return
        self._mapper, self._is_news, self._due_s = mapper, True, 0.0
        if mapper.odometry is not None:
            self._stamp_ns = mapper.odometry.stamp_ns

    def _publish(self, mapper: Mapper, frame_id: str, path: bool, markers: bool) -> None:
        graph = mapper.map
        if path:
            self._path.publish(path_to_cdr(self._stamp_ns, graph.poses, frame_id))
        if markers:
            self._markers.publish(experience_map_to_cdr(
                self._stamp_ns, graph.poses, graph.links, graph.links[graph.is_closure],
                frame_id))
