"""The life of a map: what saves, loads, forgets and keeps it, and puts the robot into it."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Callable

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.task import Future as Promise
from std_srvs.srv import SetBool, Trigger

from ..config import Config
from ..errors import DlscQbsError, MapError, OdometryError
from ..io.map_file import is_there, read_map, write_map
from ..pipeline.map_state import refuse_other, shaping
from ..pipeline.ratslam import RatSlam
from ..ros.conversions import initial_pose_from_msg
from ..ros.managed_node import ManagedNode


class MapServices:
    """
    Serves a node's `~/save_map`, `~/load_map` and so on, and saves its map by itself.

    Files are written by a thread, from a copy of the map that takes no time: updates go on.
    """

    # What a timer that does not run is made with.
    IDLE_S = 1.0

    def __init__(self, node: ManagedNode, ratslam: RatSlam, config: Config):
        self._node, self._ratslam, self._config = node, ratslam, config
        self._writer = ThreadPoolExecutor(1, thread_name_prefix='map_file')
        self._writing: Future | None = None
        self._saved_codes = 0
        # There before a thread counts: nobody who goes through the counts sees them grow.
        ratslam.counts['maps_not_saved'] += 0
        self._begin()
        for service, serve in (
                ('load_map', self._load), ('reset', self._reset),
                ('pause', lambda: self._pause(True)), ('resume', lambda: self._pause(False))):
            node.create_service(Trigger, f'~/{service}', _trigger(serve))
        # In a group of its own, so that while it waits for the file everything else goes on.
        node.create_service(Trigger, '~/save_map', self._serve_save,
                            callback_group=MutuallyExclusiveCallbackGroup())
        node.create_service(SetBool, '~/set_localization_mode', self._serve_mode)
        node.create_subscription(
            PoseWithCovarianceStamped, 'initialpose', self._on_initial_pose, 1)
        # One for all intervals: what is made while active would go with that.
        self._timer = node.create_timer(
            self.IDLE_S, self._autosave, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._timer.cancel()
        self.reconfigure(config)

    def reconfigure(self, config: Config) -> None:
        """Save to another file or at another interval."""
        self._config = config
        period_ns = int(config.ratslam.autosave_s * 1e9)
        if not period_ns:
            self._timer.cancel()
        elif self._timer.is_canceled() or self._timer.timer_period_ns != period_ns:
            self._timer.timer_period_ns = period_ns
            self._timer.reset()

    def stop(self) -> None:
        """Save what is new, if the map is to be saved at all, and end."""
        if self._config.ratslam.autosave_s:
            self._writer.submit(int).result()
            self._autosave()
        self._writer.shutdown()

    def _begin(self) -> None:
        """Go on in the map of the file, where there is one."""
        settings = self._config.ratslam
        if self._has_file():
            self._node.get_logger().info(self._load())
        if settings.mode == 'localization':
            if not self._has_file():
                raise MapError(f'ratslam.mode = localization: ratslam.map_file '
                               f'{settings.map_file!r} is no file to be localised in')
            self._ratslam.keep_map(True)

    def _has_file(self) -> bool:
        path = self._config.ratslam.map_file
        return bool(path) and is_there(path)

    def _path(self) -> str:
        if not self._config.ratslam.map_file:
            raise MapError('ratslam.map_file is empty: set it to a path')
        return self._config.ratslam.map_file

    def _load(self) -> str:
        path = self._path()
        config, state = read_map(path)
        try:
            refuse_other(config, self._ratslam.config)
            self._ratslam.restore(state)
        except MapError as error:
            raise MapError(f'{path}: {error}') from error
        return f'{path}: {len(self._ratslam.mapper.map)} experiences'

    def _save(self) -> Future:
        """Hand a copy of the map to the thread that writes it."""
        path, state, config = self._path(), self._ratslam.state(), shaping(self._ratslam.config)
        self._saved_codes = self._ratslam.counts['codes_used']
        return self._writer.submit(write_map, path, config, state)

    def _autosave(self) -> None:
        """Save a map that has grown since it last was saved, unless that is still under way."""
        if (self._ratslam.counts['codes_used'] == self._saved_codes
                or not self._ratslam.mapper.is_mapping or self._ratslam.mapper.place is None
                or self._writing is not None and not self._writing.done()):
            return
        self._save_aside()

    def _save_aside(self) -> None:
        """Save the map, and say so if that goes wrong."""
        try:
            self._writing = self._save()
        except MapError as error:
            self._complain(error)
        else:
            self._writing.add_done_callback(lambda future: self._complain(future.exception()))

    def _complain(self, error: BaseException | None) -> None:
        if error is not None:
            self._ratslam.counts['maps_not_saved'] += 1
            self._node.get_logger().error(
                f'map not saved: {error}', throttle_duration_sec=10.0)

    async def _serve_save(self, request, response):
        try:
            writing, written = self._save(), Promise()
            writing.add_done_callback(written.set_result)
            (await written).result()
            response.success, response.message = True, self._path()
        except DlscQbsError as error:
            response.message = str(error)
        return response

    def _serve_mode(self, request, response):
        return _trigger(lambda: self._keep(request.data))(request, response)

    def _keep(self, is_kept: bool) -> str:
        has_grown = self._ratslam.mapper.is_mapping
        self._ratslam.keep_map(is_kept)
        if is_kept and has_grown and self._config.ratslam.autosave_s:
            self._save_aside()  # the last growth that there is to save
        return self._ratslam.activity

    def _reset(self) -> str:
        self._ratslam.reset()
        return 'the map is empty'

    def _pause(self, is_paused: bool) -> str:
        self._ratslam.is_paused = is_paused
        return self._ratslam.activity

    def _on_initial_pose(self, msg: PoseWithCovarianceStamped) -> None:
        """Believe a pose in the map; it is taken for where the robot stands now."""
        frame = self._config.ratslam.map_frame
        try:
            if msg.header.frame_id not in ('', frame):
                raise OdometryError(f'in frame {msg.header.frame_id!r}: expected {frame!r}')
            self._ratslam.put(*initial_pose_from_msg(msg))
        except OdometryError as error:
            self._node.get_logger().warning(f'initialpose refused: {error}')


def _trigger(serve: Callable[[], str]):
    """Return a service's callback that says what was done, or why not."""
    def callback(request, response):
        try:
            response.message, response.success = serve(), True
        except DlscQbsError as error:
            response.message = str(error)
        return response
    return callback
