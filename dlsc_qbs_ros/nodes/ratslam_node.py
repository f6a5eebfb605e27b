"""The ratslam node: codes and odometry in; pose, path, map and transform out."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from math import inf
import sys
import time

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Path
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import Image
from visualization_msgs.msg import MarkerArray

from .odometry_topic import OdometryTopic
from .ratslam_report import RatSlamReport
from ..core.types import OdometrySample, PoseEstimate
from ..errors import ImageError
from ..pipeline.mapper import Mapper
from ..pipeline.ratslam import RatSlam
from ..ros.conversions import code_from_msg, dictionary_from_msg, pose_to_msg, view_from_msg
from ..ros.diagnostics import publish_diagnostics
from ..ros.logging import forward_logging
from ..ros.map_conversions import experience_map_to_msg, path_to_msg, TFMessage, transform_to_msg
from ..ros.parameters import load_config
from ..ros.qos import (
    create_publisher, create_subscription, DICTIONARY, MAP, OUTPUT, wait_until_received)
from ..ros.runtime import run_node

SETTLE_PERIOD_S = 0.02
MAP_PERIOD_S = 0.5
LAST_WORDS_S = 0.5


class RatSlamNode(Node):
    """Feeds what arrives to the pipeline and publishes what it has settled, in stamp order."""

    def __init__(self):
        super().__init__('ratslam')
        forward_logging(self)
        config = load_config(self, ('view', 'encoder', 'odometry', 'ratslam', 'pose_cells'))
        self._config = config.ratslam
        self._map_ns: int | None = None
        self._reencoder = ThreadPoolExecutor(1, thread_name_prefix='reencoding')
        self._ratslam = RatSlam(config, self._reencoder, self._on_update)
        self._pose_publisher = create_publisher(self, PoseWithCovarianceStamped, 'pose', OUTPUT)
        self._path_publisher = create_publisher(self, Path, 'path', MAP)
        self._map_publisher = create_publisher(self, MarkerArray, 'experience_map', MAP)
        self._tf_publisher = self._create_tf_publisher()
        self._odometry = OdometryTopic(self, config.odometry)
        self._report = RatSlamReport(self._ratslam, self._odometry)
        for topic, qos, from_msg, add in (
                ('dictionary', DICTIONARY, dictionary_from_msg, self._ratslam.add_dictionary),
                ('view', OUTPUT, view_from_msg, self._ratslam.add_view),
                ('code', OUTPUT, code_from_msg, self._add_code)):
            create_subscription(self, Image, topic, self._receiver(topic, from_msg, add), qos)
        self._odometry.start(self._on_odometry)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(SETTLE_PERIOD_S, self._settle, clock=steady)
        self.create_timer(MAP_PERIOD_S, self._publish_map, clock=steady)
        publish_diagnostics(self, self._report)

    def destroy_node(self) -> None:
        """Settle what is left, publish the last state of the map, then end."""
        self._odometry.stop()
        self._reencoder.shutdown()
        self._settle(inf)
        self._publish_map()
        wait_until_received(
            (self._pose_publisher, self._path_publisher, self._map_publisher), LAST_WORDS_S)
        super().destroy_node()

    def _create_tf_publisher(self):
        if not self._config.publish_tf:
            return None
        if TFMessage is None:
            self.get_logger().warning('tf2_msgs is not installed: nothing goes out on /tf')
            return None
        return create_publisher(self, TFMessage, '/tf', OUTPUT)

    def _receiver(self, topic: str, from_msg, add):
        def receive(msg: Image, info: dict) -> None:
            self._report.message_arrived(topic, info)
            try:
                add(from_msg(msg))
            except ImageError as error:
                self._report.message_refused(topic)
                self.get_logger().warning(
                    f'{topic} refused: {error}', throttle_duration_sec=5.0)
            self._settle()
        return receive

    def _add_code(self, code) -> None:
        self._ratslam.add_code(code, time.monotonic())

    def _on_odometry(self, sample: OdometrySample) -> None:
        self._report.odometry_arrived(sample)
        self._ratslam.add_odometry(sample, time.monotonic())
        self._settle()

    def _on_update(self, mapper: Mapper) -> None:
        self._map_ns = mapper.odometry.stamp_ns

    def _settle(self, now_s: float | None = None) -> None:
        now_s = time.monotonic() if now_s is None else now_s
        for estimate in self._ratslam.advance(now_s):
            self._publish_pose(estimate)

    def _publish_pose(self, estimate: PoseEstimate) -> None:
        self._pose_publisher.publish(pose_to_msg(estimate, self._config.map_frame))
        self._report.pose_published(estimate)
        if self._tf_publisher is not None:
            self._publish_transform(estimate)

    def _publish_transform(self, estimate: PoseEstimate) -> None:
        parent, child = self._config.map_frame, self._odometry.frame_id
        if parent == child:
            self.get_logger().error(f'odometry is in {child!r}, the frame of the map: no '
                                    'transform goes out; rename one of them', once=True)
            return
        self._tf_publisher.publish(transform_to_msg(
            estimate.stamp_ns, estimate.map_T_odom, parent, child))

    def _publish_map(self) -> None:
        """Publish the map when it has been updated since it last was."""
        if self._map_ns is None:
            return
        graph, frame = self._ratslam.mapper.map, self._config.map_frame
        self._path_publisher.publish(path_to_msg(self._map_ns, graph.poses, frame))
        self._map_publisher.publish(experience_map_to_msg(
            self._map_ns, graph.poses, graph.links, graph.links[graph.is_closure], frame))
        self._map_ns = None


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    return run_node(RatSlamNode, args)


if __name__ == '__main__':
    sys.exit(main())
