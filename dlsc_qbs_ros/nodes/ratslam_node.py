"""The ratslam node: codes and odometry in; pose, path, map and transform out."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from math import inf
import sys
import time

from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import Image

from .map_publisher import MapPublisher
from .map_services import MapServices
from .odometry_source import create_odometry_source, create_vision_output
from .pose_publisher import PosePublisher
from .ratslam_report import RatSlamReport
from ..config import Config
from ..core.types import Code, OdometrySample, PoseEstimate
from ..errors import ImageError
from ..pipeline.mapper import Mapper
from ..pipeline.ratslam import RatSlam
from ..ros.conversions import code_from_msg, dictionary_from_msg, view_from_msg
from ..ros.diagnostics import why_silent
from ..ros.managed_node import ManagedNode
from ..ros.qos import create_subscription, DICTIONARY, OUTPUT
from ..ros.runtime import run_node

SETTLE_PERIOD_S = 0.02


class RatSlamNode(ManagedNode):
    """Feeds what arrives to the pipeline and publishes what it has settled, in stamp order."""

    def __init__(self):
        super().__init__(
            'ratslam', ('view', 'encoder', 'patches', 'odometry', 'mavlink', 'ratslam',
                        'pose_cells'))

    def configure(self, config: Config, undo: ExitStack) -> None:
        """Make an empty map and what it is heard by."""
        self._config = config.ratslam
        self._reencoder = ThreadPoolExecutor(1, thread_name_prefix='reencoding')
        undo.callback(self._reencoder.shutdown, cancel_futures=True)
        self._ratslam = RatSlam(config, self._reencoder, self._on_update)
        self._map_publisher = MapPublisher(self)
        self._odometry = create_odometry_source(self, config)
        self._pose_publisher = PosePublisher(self, self._odometry)
        self._vision = create_vision_output(self._odometry, config)
        self._report = RatSlamReport(self._ratslam, self._odometry)
        self._map_services = MapServices(self, self._ratslam, config)
        undo.callback(self._map_services.stop)

    def activate(self, undo: ExitStack) -> None:
        """Listen to codes and odometry."""
        undo.callback(self._finish)
        *_, codes = [
            create_subscription(self, Image, topic, self._receiver(topic, from_msg, add), qos)
            for topic, qos, from_msg, add in (
                ('dictionary', DICTIONARY, dictionary_from_msg, self._ratslam.add_dictionary),
                ('view', OUTPUT, view_from_msg, self._ratslam.add_view),
                ('code', OUTPUT, code_from_msg, self._add_code))]
        self._report.streams_begin(lambda: why_silent(self, codes))
        self._odometry.start(self._on_odometry)
        undo.callback(self._odometry.stop)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(SETTLE_PERIOD_S, self._settle, clock=steady)
        self.create_timer(MapPublisher.PERIOD_S, self._publish_map, clock=steady)

    def reconfigure(self, config: Config) -> None:
        """Go on with other thresholds, periods and deviations."""
        self._config = config.ratslam
        self._ratslam.reconfigure(config)
        self._odometry.reconfigure(config.odometry)
        self._map_services.reconfigure(config)

    def report(self) -> tuple[bytes, str, dict[str, object]]:
        """Say how it goes, and what is amiss."""
        level, message, values = self._report()
        return level, message, {**values, **(self._vision.counts if self._vision else {})}

    def _finish(self) -> None:
        """Settle what is left and publish the last state of the map."""
        self._settle(inf)
        self._map_publisher.publish_last(self._ratslam.mapper, self._config.map_frame)
        self._pose_publisher.finish()

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

    def _add_code(self, code: Code) -> None:
        self._report.code_arrived(code.stamp_ns)
        self._ratslam.add_code(code, time.monotonic())

    def _on_odometry(self, sample: OdometrySample) -> None:
        self._report.odometry_arrived(sample)
        self._ratslam.add_odometry(sample, time.monotonic())
        self._settle()

    def _on_update(self, mapper: Mapper) -> None:
        self._map_publisher.map_updated(mapper.odometry.stamp_ns)
        if self._vision:
            self._vision.map_updated(
                mapper.odometry.stamp_ns, int(mapper.map.is_closure.sum()))

    def _settle(self, now_s: float | None = None) -> None:
        now_s = time.monotonic() if now_s is None else now_s
        for estimate in self._ratslam.advance(now_s):
            self._publish_pose(estimate)

    def _publish_pose(self, estimate: PoseEstimate) -> None:
        self._pose_publisher.publish(estimate, self._config)
        self._report.pose_published(estimate)
        if self._vision:
            self._vision.offer(estimate)

    def _publish_map(self) -> None:
        self._map_publisher.publish(self._ratslam.mapper, self._config.map_frame)


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    return run_node(RatSlamNode, args)


if __name__ == '__main__':
    sys.exit(main())
