"""What the robot flew and met, so that a place met by mistake can be taken back."""

from __future__ import annotations

from collections import deque
from math import hypot, inf

import numpy as np

from .pieces import Pieces
from .visits import Visits
from ..config import Config
from ..core.consistency import calibration, Chain, contradiction, deviations
from ..core.drift import Drift
from ..core.geometry import between, between_rows, compose
from ..core.types import Pose2


class Journey:
    """
    The matches on the way, and which of them are to be believed.

    Visits that meet old experiences without a gap are one run. A run that contradicts odometry
    and the other runs can be taken back.

    Attributes
    ----------
    visits : Visits
    pieces : Pieces
    drift : Drift
        Since the last visit that met an old experience, or the start of the piece.
    undone : int
        How many runs were taken back.

    """

    # What bounds the time of a test or a survey: the closures in it, for a test the newest ones,
    # and the nodes of the path by odometry, beside those that the closures join.
    MAX_CLOSURES = 40
    N_NODES = 100
    # In hours there are more nodes: from one to the next, no error of a yaw rate may turn far.
    SECONDS_PER_NODE = 60.0
    # What tells of the odometry are closures no farther apart than so many runs of views: on
    # longer ways, its noise hides its scale.
    LONGEST_RUNS = 4.0
    # How well places are known is found for one node of so many, and interpolated in between.
    SURVEY_STEP = 3
    # Deviation of the position after one metre of odometry's random walk.
    WALK_SIGMA_M = 0.05
    # A start of a run this many deviations of a match off is taken back.
    ASKEW = 2.0
    # Of a motion while odometry was broken: nobody knows.
    BREAK_VARIANCE = 1e4
    NEVER_M = -1e9

    def __init__(self, config: Config):
        self._config = config.ratslam
        self._odometry = config.odometry
        # What closures are held against: views tell how noisy the odometry is.
        self._yaw_noise = config.odometry.yaw_noise
        self.visits = Visits()
        self.pieces = Pieces(self.visits, config.ratslam.sequence_length)
        self.drift = Drift(config.odometry)
        self.undone = 0
        # The visits that are tested as closures. A run is as few as it is pieces of news: ever
        # farther apart.
        self._closures: deque[int] = deque(maxlen=self.MAX_CLOSURES)
        self._n_runs = 0
        self._run_start_m = self._next_closure_m = 0.0
        self._last_met_m = self.NEVER_M
        # Visits, and the deviations of the map's places there: position in metres and heading.
        self._surveyed: tuple[np.ndarray, np.ndarray] | None = None

    def reconfigure(self, config: Config) -> None:
        """Go on with other values of `live` parameters."""
        self._config, self._odometry = config.ratslam, config.odometry
        self._yaw_noise = config.odometry.yaw_noise
        self.drift.reconfigure(config.odometry)

    def believe(self, yaw_noise: float) -> None:
        """Hold closures against another noise of the odometry, in rad/sqrt(s)."""
        self._yaw_noise = yaw_noise

    def state(self) -> dict[str, np.ndarray]:
        """Return what `restore` takes, by the names in `map_state.ARRAYS`."""
        return {
            'closure_visits': np.array(self._closures, np.int64),
            'robot_drift': self.drift.state(),
            'run_counts': np.array([self._n_runs, self.undone]),
            'run_metres': np.array(
                [self._run_start_m, self._next_closure_m, self._last_met_m]),
            **self.visits.state(), **self.pieces.state()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on, where nothing was visited yet, from what `state` returned."""
        self._closures.extend(state['closure_visits'].tolist())
        self.drift.restore(state['robot_drift'])
        self._n_runs, self.undone = state['run_counts'].tolist()
        self._run_start_m, self._next_closure_m, self._last_met_m = state['run_metres'].tolist()
        self.visits.restore(state)
        self.pieces.restore(state)
        self.survey()

    def move(self, motion: Pose2, seconds: float) -> None:
        """Carry the robot along with the odometry."""
        self.visits.odometry.move(motion, seconds)
        self.drift.move(motion, seconds)

    def break_off(self) -> None:
        """Take note that nobody knows how the robot came from the last visit to here."""
        self.drift.anchor(0.0, 0.0)
        if self.visits.place() is not None:  # else the map is yet to begin
            self._cut()

    def put(self, experience: int, offset: Pose2) -> None:
        """Take the robot to be at an offset from an old experience, without a visit."""
        self.visits.put(experience, offset)
        self.pieces.put(experience)

    def settle(self) -> None:
        """Visit the place that the robot was put to, so that the way on is linked to it."""
        place = self.visits.place()
        # Where odometry broke since then, there is no way on from it.
        if self.visits.is_put and not self.pieces.is_apart(place.experience):
            self._cut()
            self._n_runs += 1
            self._last_met_m = self.NEVER_M
            self.visits.add(place.experience, place.offset, self._n_runs)
            self.pieces.label()

    def meet(self, experience: int, offset: Pose2) -> bool:
        """Visit an old experience, at an offset from it; return whether that is news to test."""
        path_m = self.visits.odometry.track().metres
        self._begin_run(experience, path_m)
        is_apart = self.pieces.is_apart(experience)
        if is_apart:
            self.pieces.join(experience, offset)
        self.visits.add(experience, offset, self._n_runs)
        if is_apart:
            self.pieces.label()
        if path_m < self._next_closure_m or self._config.backend == 'published':
            return False
        self._next_closure_m = path_m + max(path_m - self._run_start_m, self._config.min_path_m)
        self._closures.append(len(self.visits.experience.values) - 1)
        self.pieces.tie()
        self._check_start()
        return True

    def contradiction(self, experience: int | None = None) -> int | None:
        """
        Return the run that contradicts odometry and the other runs, if one does.

        With an experience, as if it were met here, by a run of its own, which is run 0.
        """
        visits = np.array(self._closures, np.int64)
        runs = self.visits.run.values[visits]
        if experience is not None:
            runs = np.append(runs, 0)
        names, groups = np.unique(runs, return_inverse=True)
        nodes, *closures = self._closed(visits, experience)
        worst = contradiction(self._chain(nodes, self.BREAK_VARIANCE), *closures, groups)
        return None if worst is None else int(names[worst])

    def take_stock(self) -> None:
        """Learn from the closures that stand what they tell of the odometry and of the map."""
        self._calibrate()
        self.survey()

    def _calibrate(self) -> None:
        """
        Take out of the odometry what closures tell of its constant errors.

        Segments count in the mean of their scales by how much of the map they made: who meets
        but what is there takes over its scale.
        """
        visits, births = self._met(), self.visits.birth.values
        segment_of = self.visits.flown.values[:, 2].astype(int)
        errors = np.zeros((int(self.visits.odometry.flown[2]) + 1, 2))
        longest_m = (self.LONGEST_RUNS * self._config.sequence_length
                     * self._config.keyframe_distance_m)
        if len(visits):
            segments = np.unique(segment_of[visits])[-self.MAX_CLOSURES:]
            nodes, *closures = self._closed(np.concatenate([
                self._newest(visits[segment_of[visits] == segment],
                             self.MAX_CLOSURES // len(segments), longest_m)
                for segment in segments]))
            chain = self._chain(nodes, self.BREAK_VARIANCE)
            names = np.unique(chain.segments).astype(int)
            made = np.bincount(segment_of[births], minlength=len(errors))[names]
            errors[names] = calibration(chain, *closures, made / max(made.sum(), 1))
        self.visits.calibrate(errors)

    def survey(self) -> None:
        """Find how well the closures make known where places are in the map as a whole."""
        self._surveyed = None
        visits = self._met()
        if not len(visits):
            return
        births, met = self.visits.birth.values, self.visits.experience.values
        nodes, *closures = self._closed(self._newest(visits, self.MAX_CLOSURES, inf))
        places = np.flatnonzero(births[met[nodes]] == nodes)[::self.SURVEY_STEP]
        # What broke was joined by a match, whether that is among these closures or not.
        chain = self._chain(nodes, self._config.match_position_sigma_m ** 2)
        self._surveyed = nodes[places], deviations(chain, *closures, places)

    def place_sigmas(self) -> tuple[float, float]:
        """Return the last survey's deviations, of position and heading, of the place here."""
        if self._surveyed is None:
            return 0.0, 0.0
        visits, sigmas = self._surveyed
        birth = self.visits.birth.values[self.visits.place().experience]
        position_m, yaw_rad = (float(np.interp(birth, visits, column)) for column in sigmas.T)
        return position_m, yaw_rad

    def undo(self, run: int) -> None:
        """Take back a run; the drift is what it has become since the one before it."""
        visits = self.visits
        self._take_back(np.flatnonzero(visits.run.values == run))
        self._last_met_m = self.NEVER_M
        self.undone += 1
        self.pieces.label()
        met = np.append(0, np.flatnonzero(visits.run.values))[-1]
        start = np.searchsorted(visits.flown.values[:, 2], visits.odometry.flown[2])
        seconds, metres, _ = visits.odometry.flown - np.vstack(
            [visits.flown.values, visits.odometry.flown])[max(met, start)]
        self.drift.anchor(self._config.match_position_sigma_m, self._config.match_yaw_sigma_rad)
        self.drift.move(Pose2(float(metres), 0.0, 0.0), float(seconds))
        self.take_stock()

    def _cut(self) -> None:
        """Let another segment of the odometry begin."""
        self.visits.odometry.cut()
        self.pieces.label()

    def _begin_run(self, experience: int, path_m: float) -> None:
        """Begin another run where a match comes after a gap, or elsewhere than expected."""
        expected = between(self.visits.map.pose(experience), self.visits.pose())
        if (path_m - self._last_met_m > self._config.min_path_m
                or hypot(expected.x_m, expected.y_m) > self._config.tracking_distance_m):
            self._n_runs += 1
            self._run_start_m = self._next_closure_m = path_m
        self._last_met_m = path_m

    def _check_start(self) -> None:
        """Take back the start of a run when its second closure says that it was elsewhere."""
        runs, breaks = self.visits.run.values, self.visits.flown.values[:, 2]
        visits = np.flatnonzero(runs == self._n_runs)
        first, last = int(visits[0]), int(visits[-1])
        if (np.count_nonzero(runs[self._closures] == self._n_runs) != 2
                or breaks[first] != breaks[first - 1]):
            return
        flown = between(self.visits.track_at(last), self.visits.track_at(first))
        apart = between(self.visits.pose_at(first), compose(self.visits.pose_at(last), flown))
        if hypot(apart.x_m, apart.y_m) > self.ASKEW * self._config.match_position_sigma_m:
            self._take_back(visits[:-1])

    def _take_back(self, visits: np.ndarray) -> None:
        self.visits.take_back(visits)
        self._closures = deque(
            [k for k in self._closures if self.visits.run.values[k]], self.MAX_CLOSURES)

    def _met(self) -> np.ndarray:
        """Return the visits that met old experiences, (n,)."""
        return np.flatnonzero(self.visits.run.values)

    def _newest(self, visits: np.ndarray, n: int, longest_m: float) -> np.ndarray:
        """Return the first of visits in each of the newest stretches, about n of equal length."""
        metres = self.visits.flown.values[visits, 1]
        stretch_m = max(min(np.ptp(metres) / n, longest_m), self._config.min_path_m, 1e-9)
        visits, metres = (rows[metres >= metres[-1] - n * stretch_m] for rows in (visits, metres))
        return visits[np.unique(metres // stretch_m, return_index=True)[1]]

    def _closed(self, visits: np.ndarray, experience: int | None = None
                ) -> tuple[np.ndarray, ...]:
        """
        Return nodes on the path, the closures' ends among them and what both may err by.

        With an experience, the robot meets that one here, after these visits.
        """
        births, met = self.visits.birth.values, self.visits.experience.values
        starts = births[met[visits]]
        if experience is not None:
            visits, starts = np.append(visits, len(met)), np.append(starts, births[experience])
        ends = np.column_stack([starts, visits])
        first, last = starts.min(), visits.max()
        _, _, flown = self.visits.along(np.array([first, last]))
        n_nodes = max(self.N_NODES, int(np.ptp(flown[:, 0]) / self.SECONDS_PER_NODE))
        nodes = np.union1d(ends, np.linspace(first, last, n_nodes, dtype=int))
        match_m, match_rad = self._config.match_position_sigma_m, self._config.match_yaw_sigma_rad
        return (nodes, np.searchsorted(nodes, ends), np.square([match_m, match_m, match_rad]),
                np.square([self._odometry.yaw_bias_rad_s, self._odometry.translation_drift]))

    def _chain(self, nodes: np.ndarray, break_variance: float) -> Chain:
        """Return the path by odometry through visits; the one after the last visit is here."""
        poses, track, flown = self.visits.along(nodes)
        seconds, metres, breaks = np.diff(flown, axis=0).T
        unknown = break_variance * breaks + 1e-9
        turn = self._yaw_noise ** 2 * seconds + unknown
        along = self.WALK_SIGMA_M ** 2 * metres + unknown
        # A turn somewhere on the way throws its end sideways.
        across = along + turn * (0.5 * metres) ** 2
        return Chain(poses, between_rows(track[:-1], track[1:]), seconds,
                     np.column_stack([along, across, turn]), flown[1:, 2])
