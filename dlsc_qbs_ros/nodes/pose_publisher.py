"""The topic `pose`, and on /tf what takes odometry to it."""

from __future__ import annotations

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node

from ..config import RatSlamConfig
from ..core.types import PoseEstimate
from ..pipeline.odometry import OdometrySource
from ..ros.conversions import pose_to_msg
from ..ros.map_conversions import TFMessage, transform_to_msg
from ..ros.qos import create_publisher, OUTPUT, wait_until_received

LAST_WORDS_S = 0.5


class PosePublisher:
    """
    Publishes the pose of every odometry sample, and the transform from `map` to `odom`.

    As REP-105 has it, all corrections are in that transform; odometry stays smooth, as it came.
    """

    def __init__(self, node: Node, odometry: OdometrySource):
        self._logger = node.get_logger()
        self._odometry = odometry
        self._poses = create_publisher(node, PoseWithCovarianceStamped, 'pose', OUTPUT)
        self._transforms = TFMessage and create_publisher(node, TFMessage, '/tf', OUTPUT)

    def publish(self, estimate: PoseEstimate, config: RatSlamConfig) -> None:
        """Publish an estimate."""
        self._poses.publish(pose_to_msg(estimate, config.map_frame))
        if config.publish_tf:
            self._publish_transform(estimate, config.map_frame)

    def finish(self) -> None:
        """Give those who listen time for the last pose."""
        wait_until_received((self._poses,), LAST_WORDS_S)

    def _publish_transform(self, estimate: PoseEstimate, parent: str) -> None:
        child = self._odometry.frame_id
        if self._transforms is None:
            self._logger.warning('tf2_msgs is not installed: nothing goes out on /tf', once=True)
        elif parent == child:
            self._logger.error(f'odometry is in {child!r}, the frame of the map: no transform '
                               'goes out; rename one of them', once=True)
        else:
            self._transforms.publish(transform_to_msg(
                estimate.stamp_ns, estimate.map_T_odom, parent, child))
