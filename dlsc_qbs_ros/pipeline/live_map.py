"""A map, the robot in it and the codes it is made of: built, saved, loaded, localised in."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import Executor

import numpy as np

from . import map_state
from .code_book import CodeBook, InlineExecutor
from .follower import Follower
from .mapper import Mapper
from ..config import Config
from ..core.inputs import make_inputs
from ..core.local_view import Measure
from ..core.types import Code, Dictionary, OdometrySample, Pose2
from ..errors import MapError


class LiveMap:
    """
    A map that codes and odometry are put into, and all that can be done with it as a whole.

    Attributes
    ----------
    config : Config
    mapper : Mapper
    is_paused : bool
        If so, odometry moves the robot, and codes are not looked at.
    codes_match : bool
        Whether the code that was checked last is what its view and dictionary make here.
    counts : Counter
        What was used, and refused, by its kind.

    """

    MAX_NORM = 1e12
    CHECK_EVERY = 50
    CHECK_TOLERANCE = 1e-3

    def __init__(self, config: Config, executor: Executor | None = None,
                 measure: Measure | None = None):
        self.config, self._measure = config, measure
        self._executor = executor or InlineExecutor()
        self._view_shape = (config.view.height, config.view.width)
        inputs = make_inputs(config)
        self._dictionary_shape = (config.encoder.n_atoms, inputs.n_inputs)
        self._code_shape = (inputs.n_values,) if measure is None else None
        self.mapper = Mapper(config, measure)
        self._book = CodeBook(config, self._executor, self.mapper.cells_of)
        self._follower = Follower(config, self.mapper)
        self._last_view: np.ndarray | None = None
        self.codes_match = True
        self.is_paused = False
        # The map as it was when it began to be kept as it is; None while it grows.
        self._kept: dict[str, np.ndarray] | None = None
        self.counts: Counter[str] = Counter()

    def reconfigure(self, config: Config) -> None:
        """Go on with other values of `live` parameters; the map stays."""
        self.config = config
        self.mapper.reconfigure(config)
        self._follower.reconfigure(config)

    @property
    def is_localised(self) -> bool:
        """Whether it is known where in the map the robot is."""
        return self._follower.is_localised

    @property
    def activity(self) -> str:
        """Return what it does, in a word."""
        if self.is_paused:
            return 'paused'
        return 'mapping' if self.mapper.is_mapping else 'localising'

    def state(self) -> dict[str, np.ndarray]:
        """
        Return the map, and the robot in it, by the names in `map_state.ARRAYS`.

        Nothing that comes later changes it. While the map is kept as it is, that is the state it
        was in when that began.
        """
        if self._kept is not None:
            return self._kept
        if self.mapper.place is None:
            raise MapError('there is no map yet')
        known = self._book.newest
        return {
            'view_cell_views': [*self._book.views],
            'view_cell_codes': self.mapper.view_cells.kept[len(self._book.views) * len(known):],
            'dictionaries': np.array([dictionary.atoms for dictionary in known], np.float32
                                     ).reshape(-1, *self._dictionary_shape),
            'dictionary_stamps_ns': np.array([dictionary.stamp_ns for dictionary in known], int),
            **self.mapper.state()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """
        Go on in a map that `state` returned, in place of the present one.

        Where odometry still is the one it was left with, the robot is where it was carried since.

        Raises
        ------
        MapError
            When it is no map to go on from; the present one then stays.

        """
        self.take_over(*self.restored(state))

    def restored(self, state: dict[str, np.ndarray]) -> tuple[Mapper, dict[str, np.ndarray]]:
        """Return what `take_over` goes on in; it takes long, and any thread may do it."""
        state = {name: np.asarray(array) for name, array in state.items()}
        map_state.check(state, self.config)
        mapper = Mapper(self.config, self._measure)
        mapper.restore(state)
        codes = state['view_cell_codes']
        mapper.view_cells.replace(codes if len(codes) else np.zeros(
            (len(state['view_cell_views']), *self._code_shape), np.float32))
        return mapper, state

    def take_over(self, mapper: Mapper, state: dict[str, np.ndarray]) -> None:
        """Go on in what `restored` returned."""
        mapper.is_mapping = self.mapper.is_mapping
        mapper.reconfigure(self.config)
        self._begin(mapper, state['view_cell_views'], [
            *map(Dictionary, state['dictionary_stamps_ns'].tolist(), state['dictionaries']),
            *self._book.newest])
        if not mapper.is_mapping:
            self._kept = state

    def reset(self) -> None:
        """Forget the map and begin another."""
        self._kept = None
        self._begin(Mapper(self.config, self._measure),
                    np.zeros((0, *self._view_shape), np.uint8), self._book.newest)

    def keep_map(self, is_kept: bool) -> None:
        """Let the map stay as it is, to be localised in, or let it grow again."""
        if is_kept and self.mapper.is_mapping:
            self._kept = self.state()
        elif not is_kept:
            self._kept = None
            self.mapper.journey.settle()
        self.mapper.is_mapping = not is_kept

    def put(self, pose: Pose2, position_sigma_m: float, yaw_sigma_rad: float) -> None:
        """Take the robot to be at a pose in the map, known this well, at the newest odometry."""
        self._follower.put(pose, position_sigma_m, yaw_sigma_rad)

    def add_dictionary(self, dictionary: Dictionary) -> None:
        """Take in the dictionary of a new epoch; one of another shape is refused."""
        if dictionary.atoms.shape != self._dictionary_shape:
            self.counts['dictionaries_of_another_shape'] += 1
            return
        if not 0.0 < np.linalg.norm(dictionary.atoms.astype(np.float64)) < self.MAX_NORM:
            self.counts['dictionaries_unusable'] += 1
            return
        self.counts['dictionaries'] += 1
        self._book.add_dictionary(dictionary)

    def _take_in(self, code: Code, view: np.ndarray, odometry: OdometrySample) -> None:
        """Use a code, with its view and the odometry at its stamp."""
        self._follower.bridge(odometry)
        last = self.mapper.odometry
        if last is not None and (odometry.segment <= last.segment
                                 and odometry.stamp_ns < last.stamp_ns):
            self.counts['codes_before_told_pose'] += 1  # it was on its way when that was told
            return
        values = code.values if code.dictionary_ns is None else self._in_force(code, view)
        # No camera that moves sees the same twice, to the last pixel: one that does hangs.
        is_new = not np.array_equal(view, self._last_view)
        self._last_view = view
        if self.is_paused:
            self.mapper.carry(odometry)
        else:
            if is_new:
                self.mapper.gyro.look(view, odometry)
            if self.mapper.update(odometry, values * is_new):
                self._book.add_view(view * is_new, code)
        self.counts['codes_used'] += 1
        self._follower.correct(odometry)

    def _in_force(self, code: Code, view: np.ndarray) -> np.ndarray:
        """Go on to another dictionary when that is due; return the values under that in force."""
        cells = self._book.advance(code)
        if cells is not None:
            self.mapper.view_cells = cells
            self.counts['code_books'] += 1
        if self.counts['codes_used'] % self.CHECK_EVERY == 0 or not self.codes_match:
            self._check(code, view)
        return self._book.in_force(code, view)

    def _check(self, code: Code, view: np.ndarray) -> None:
        """Notice an encoder that is configured otherwise: its code would not come from here."""
        error = np.abs(self._book.reencode(code, view) - code.values).max()
        self.codes_match = error <= self.CHECK_TOLERANCE * np.abs(code.values).max()
        self.counts['code_mismatches'] += not self.codes_match

    def _begin(self, mapper: Mapper, views: np.ndarray, dictionaries: list[Dictionary]) -> None:
        book = CodeBook(self.config, self._executor, mapper.cells_of)
        book.restore(views, dictionaries)
        self._book.cancel()
        self.mapper, self._book = mapper, book
        self._follower = Follower(self.config, mapper)
