"""The life of a map: what saves, loads, forgets and keeps it, and puts the robot into it."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
from rclpy.clock import Clock, ClockType
from std_srvs.srv import SetBool, Trigger

from .services import finished, offer
from ..config import Config
from ..errors import MapError, OdometryError
from ..io.map_file import is_there, read_map, write_map
from ..pipeline.map_state import refuse_other, shaping
from ..pipeline.mapper import Mapper
from ..pipeline.ratslam import RatSlam
from ..ros.conversions import initial_pose_from_msg
from ..ros.managed_node import ManagedNode


class MapServices:
    """
    Serves a node's `~/save_map`, `~/load_map` and so on, and saves its map by itself.

    Files are read and written by a thread, updates go on meanwhile: what is written is a copy of
    the map that takes no time, what was read takes its place in one step.
    """

    # What a timer that does not run is made with.
    IDLE_S = 1.0

    def __init__(self, node: ManagedNode, ratslam: RatSlam, config: Config):
        self._node, self._ratslam, self._config = node, ratslam, config
        self._worker = ThreadPoolExecutor(1, thread_name_prefix='map_file')
        self._writing: Future | None = None
        # The codes used when the map last grew, and when it was as in the file that is its own.
        self._grown_at = self._saved_at = 0
        self._own_file = ''
        self._is_loading = self._has_ended = False
        # There before a thread counts: nobody who goes through the counts sees them grow.
        ratslam.counts['maps_not_saved'] += 0
        self._begin()
        for service, act in (
                ('save_map', self._save_map), ('load_map', self._load_map),
                ('reset', self._reset), ('pause', lambda: self._pause(True)),
                ('resume', lambda: self._pause(False))):
            offer(node, Trigger, service, act)
        offer(node, SetBool, 'set_localization_mode', self._keep)
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
        self._is_loading, self._has_ended = False, True  # what is still read is let go
        if self._config.ratslam.autosave_s:
            self._worker.submit(int).result()
            self._autosave()
        self._worker.shutdown()

    def _begin(self) -> None:
        """Go on in the map of the file, where there is one."""
        settings = self._config.ratslam
        if self._has_file():
            path = self._path()
            self._node.get_logger().info(self._take_over(path, *self._read(path)))
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

    def _read(self, path: str) -> tuple[Mapper, dict[str, np.ndarray]]:
        """Return what the map is gone on with."""
        config, state = read_map(path)
        try:
            refuse_other(config, self._ratslam.config)
            return self._ratslam.restored(state)
        except MapError as error:
            raise MapError(f'{path}: {error}') from error

    def _take_over(self, path: str, mapper: Mapper, state: dict[str, np.ndarray]) -> str:
        if self._has_ended:
            raise MapError('the map has ended meanwhile')
        self._ratslam.take_over(mapper, state)
        self._grown_at = self._saved_at = self._ratslam.counts['codes_used']
        self._own_file = path
        return f'{path}: {len(mapper.map)} experiences'

    async def _load_map(self) -> str:
        path, self._is_loading = self._path(), True
        try:
            return self._take_over(path, *await finished(
                self._node, self._worker.submit(self._read, path)))
        finally:
            self._is_loading = False

    async def _save_map(self) -> str:
        return await finished(self._node, self._save())

    def _save(self) -> Future:
        """Hand a copy of the map to the thread that writes it."""
        self._note_growth()
        return self._worker.submit(
            self._write, self._path(), self._ratslam.state(), self._grown_at)

    def _write(self, path: str, state: dict[str, np.ndarray], grown_at: int) -> str:
        write_map(path, shaping(self._ratslam.config), state)
        self._saved_at, self._own_file = grown_at, path
        return path

    def _note_growth(self) -> None:
        if self._ratslam.mapper.is_mapping:
            self._grown_at = self._ratslam.counts['codes_used']

    def _autosave(self) -> None:
        """Save a map that has grown since it last was saved, unless that is still under way."""
        self._note_growth()
        is_writing = self._writing is not None and not self._writing.done()
        if self._grown_at == self._saved_at or self._ratslam.mapper.place is None or is_writing:
            return
        self._save_aside()

    def _save_aside(self) -> None:
        """Save the map where no other is nor is read, and say so if that goes wrong."""
        if self._is_loading:
            return  # what is to be given up would be written over what takes its place
        try:
            if self._path() != self._own_file and self._has_file():
                raise MapError(f'{self._path()} holds another: call save_map or load_map')
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

    def _keep(self, is_kept: bool) -> str:
        has_grown = self._ratslam.mapper.is_mapping
        self._note_growth()
        self._ratslam.keep_map(is_kept)
        if is_kept and has_grown and self._config.ratslam.autosave_s:
            self._save_aside()  # the last growth that there is to save
        return self._ratslam.activity

    def _reset(self) -> str:
        if not self._ratslam.mapper.is_mapping:
            raise MapError('the map stays as it is: ~/set_localization_mode false comes first')
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
