"""What the robot flew and met, so that a place met by mistake can be taken back."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import hypot, inf

import numpy as np

from ..config import Config
from ..core.consistency import Chain, contradiction
from ..core.drift import Drift
from ..core.experience_map import ExperienceMap
from ..core.geometry import between, between_rows, compose, compose_rows, invert
from ..core.rows import Rows
from ..core.types import IDENTITY, Pose2


@dataclass(frozen=True)
class Place:
    """Where the robot stands, or stood: a motion after a visit; where that was may be revised."""

    journey: Journey
    visit: int
    since: Pose2

    @property
    def experience(self) -> int:
        """Return the experience that the place is given by."""
        return int(self.journey.experience.values[self.visit])

    @property
    def offset(self) -> Pose2:
        """Return the pose in the frame of the experience."""
        return compose(self.journey.offset_at(self.visit), self.since)


class Journey:
    """
    The visits to experiences, and the links that these make in the map.

    A visit creates an experience or meets an old one, and is linked to the visit before it,
    unless odometry broke in between. Visits that meet old experiences without a gap are one run.
    A run that contradicts odometry and the other runs can be taken back: its links go, odometry
    bridges the gap, and what was created after it moves along.

    Attributes
    ----------
    map : ExperienceMap
    drift : Drift
        Since the last visit that met an old experience.
    experience : Rows of int64
        The experience of each visit.
    undone : int
        How many runs were taken back.

    """

    # What bounds the time of a test: the closures in it, the newest ones, and the nodes of the
    # path by odometry, beside those that the closures join.
    MAX_CLOSURES = 40
    MAX_NODES = 100
    # Deviation of the position after one metre of odometry's random walk.
    WALK_SIGMA_M = 0.05
    # A start of a run this many deviations of a match off is taken back.
    ASKEW = 2.0
    # Of a motion while odometry was broken: nobody knows.
    BREAK_VARIANCE = 1e4

    def __init__(self, config: Config):
        self._config = config.ratslam
        self._odometry = config.odometry
        self.map = ExperienceMap()
        self.drift = Drift(config.odometry)
        self.undone = 0
        self.experience = Rows(np.zeros(0, np.int64))
        # Per visit: the pose in the frame of its experience, and by odometry alone; its run, 0
        # for none; and the seconds, metres and breaks of odometry up to it.
        self._offset = Rows(np.zeros((0, 3)))
        self._track = Rows(np.zeros((0, 3)))
        self._run = Rows(np.zeros(0, np.int64))
        self._flown = Rows(np.zeros((0, 3)))
        # Per experience: the visit that created it. Per link: the visit that made it.
        self._birth = Rows(np.zeros(0, np.int64))
        self._maker = Rows(np.zeros(0, np.int64))
        # Now: the pose by odometry alone and since the last visit; and what is flown.
        self._here = self._since = IDENTITY
        self._so_far = np.zeros(3)
        # The visits that are tested as closures. A run is as few as it is pieces of news: ever
        # farther apart.
        self._closures: deque[int] = deque(maxlen=self.MAX_CLOSURES)
        self._n_runs = 0
        self._run_start_m = self._next_closure_m = 0.0
        self._last_met_m = -inf

    def move(self, motion: Pose2, seconds: float) -> None:
        """Carry the robot along with the odometry."""
        self._here, self._since = compose(self._here, motion), compose(self._since, motion)
        self.drift.move(motion, seconds)
        self._so_far = self._so_far + (seconds, hypot(motion.x_m, motion.y_m), 0.0)

    def break_off(self) -> None:
        """Take note that nobody knows how the robot came from the last visit to here."""
        self.drift.anchor(inf, inf)
        self._so_far = self._so_far + (0.0, 0.0, 1.0)

    def place(self) -> Place | None:
        """Return where the robot stands; None before the first visit."""
        last = len(self.experience.values) - 1
        return None if last < 0 else Place(self, last, self._since)

    def offset_at(self, visit: int) -> Pose2:
        """Return the robot's pose at a visit in the frame of the experience."""
        return Pose2(*self._offset.values[visit].tolist())

    def pose(self) -> Pose2:
        """Return where the robot stands in the map."""
        return compose(self._pose_at(len(self.experience.values) - 1), self._since)

    def ages(self) -> np.ndarray:
        """Return the seconds and metres flown since each experience was created, (n, 2)."""
        return (self._so_far - self._flown.values[self._birth.values])[:, :2]

    def create(self, pose: Pose2) -> None:
        """Visit an experience that is new, at a pose in the map."""
        self._birth.append(len(self.experience.values))
        self._visit(self.map.add_experience(pose), IDENTITY, 0)

    def meet(self, experience: int, offset: Pose2) -> bool:
        """Visit an old experience, at an offset from it; return whether that is news to test."""
        expected = between(self.map.pose(experience), self.pose())
        path_m = float(self._so_far[1])
        if (path_m - self._last_met_m > self._config.min_path_m
                or hypot(expected.x_m, expected.y_m) > self._config.tracking_distance_m):
            self._n_runs += 1
            self._run_start_m = self._next_closure_m = path_m
        self._last_met_m = path_m
        self._visit(experience, offset, self._n_runs)
        if path_m < self._next_closure_m or self._config.backend == 'published':
            return False
        self._next_closure_m = path_m + max(path_m - self._run_start_m, self._config.min_path_m)
        self._closures.append(len(self.experience.values) - 1)
        self._check_start()
        return True

    def contradiction(self, experience: int | None = None) -> int | None:
        """
        Return the run that contradicts odometry and the other runs, if one does.

        With an experience, as if it were met here, by a run of its own, which is run 0.
        """
        visits = np.array(self._closures, np.int64)
        runs = self._run.values[visits]
        births = self._birth.values[self.experience.values[visits]]
        if experience is not None:
            visits, runs = np.append(visits, len(self.experience.values)), np.append(runs, 0)
            births = np.append(births, self._birth.values[experience])
        ends = np.column_stack([births, visits])
        nodes = np.union1d(
            ends, np.linspace(births.min(), visits.max(), self.MAX_NODES, dtype=int))
        names, groups = np.unique(runs, return_inverse=True)
        match_m, match_rad = self._config.match_position_sigma_m, self._config.match_yaw_sigma_rad
        worst = contradiction(
            self._chain(nodes), np.searchsorted(nodes, ends),
            np.square([match_m, match_m, match_rad]),
            np.square([self._odometry.yaw_bias_rad_s, self._odometry.translation_drift]), groups)
        return None if worst is None else int(names[worst])

    def undo(self, run: int) -> None:
        """Take back a run; the drift is what it has become since the one before it."""
        self._take_back(np.flatnonzero(self._run.values == run))
        self._last_met_m = -inf
        self.undone += 1
        met = np.flatnonzero(self._run.values)
        seconds, metres, breaks = self._so_far - self._flown.values[met[-1] if len(met) else 0]
        self.drift.anchor(*((inf, inf) if breaks else (
            self._config.match_position_sigma_m, self._config.match_yaw_sigma_rad)))
        self.drift.move(Pose2(float(metres), 0.0, 0.0), float(seconds))

    def _check_start(self) -> None:
        """Take back the start of a run when its second closure says that it was elsewhere."""
        visits = np.flatnonzero(self._run.values == self._n_runs)
        first, last = int(visits[0]), int(visits[-1])
        if (np.count_nonzero(self._run.values[self._closures] == self._n_runs) != 2
                or self._flown.values[first, 2] != self._flown.values[first - 1, 2]):
            return
        flown = between(self._track_at(last), self._track_at(first))
        apart = between(self._pose_at(first), compose(self._pose_at(last), flown))
        if hypot(apart.x_m, apart.y_m) > self.ASKEW * self._config.match_position_sigma_m:
            self._take_back(visits[:-1])

    def _take_back(self, visits: np.ndarray) -> None:
        """Let visits have met nothing: their links go, and odometry bridges the gap."""
        first, after = int(visits[0]), int(visits[-1]) + 1
        is_wrong = (self._maker.values >= first) & (self._maker.values <= after)
        self.map.remove_links(is_wrong)
        self._maker = Rows(self._maker.values[~is_wrong])
        self._run.values[visits] = 0
        wrong = set(visits.tolist())
        for visit in range(first, min(after + 1, len(self.experience.values))):
            if visit in wrong:
                self._offset.values[visit] = self._arrival(visit)
                self.experience.values[visit] = self.experience.values[visit - 1]
            elif self._birth.values[self.experience.values[visit]] == visit:
                self._carry(visit, is_last=visit == after)
            self._link(visit)
        self._closures = deque(
            [k for k in self._closures if self._run.values[k]], self.MAX_CLOSURES)

    def _pose_at(self, visit: int) -> Pose2:
        return compose(self.map.pose(int(self.experience.values[visit])), self.offset_at(visit))

    def _track_at(self, visit: int) -> Pose2:
        return Pose2(*self._track.values[visit].tolist())

    def _visit(self, experience: int, offset: Pose2, run: int) -> None:
        self.experience.append(experience)
        self._offset.append(offset)
        self._track.append(self._here)
        self._run.append(run)
        self._flown.append(self._so_far)
        self._since = IDENTITY
        self._link(len(self.experience.values) - 1)

    def _arrival(self, visit: int) -> Pose2:
        """Return where a visit was, by odometry, in the frame of the last visit's experience."""
        return compose(self.offset_at(visit - 1),
                       between(self._track_at(visit - 1), self._track_at(visit)))

    def _link(self, visit: int) -> None:
        """Link a visit's experience to that of the visit before, as odometry led there."""
        if visit == 0 or self._flown.values[visit, 2] != self._flown.values[visit - 1, 2]:
            return
        origin, target = self.experience.values[[visit - 1, visit]].tolist()
        motion = compose(self._arrival(visit), invert(self.offset_at(visit)))
        is_closure = bool(self._birth.values[target] != visit)
        if self.map.add_link(origin, target, motion, is_closure):
            self._maker.append(visit)

    def _carry(self, visit: int, is_last: bool) -> None:
        """Move what a visit created to where odometry led; after the last one, all the rest."""
        experience, origin = self.experience.values[[visit, visit - 1]].tolist()
        moved = self._birth.values >= visit if is_last else [experience]
        now = compose(self.map.pose(origin), self._arrival(visit))
        self.map.poses[moved] = compose_rows(
            np.array([now]), between_rows(self.map.poses[[experience]], self.map.poses[moved]))

    def _chain(self, nodes: np.ndarray) -> Chain:
        """Return the path by odometry through visits; the one after the last visit is here."""
        here = self.place()
        experience = np.append(self.experience.values, here.experience)[nodes]
        offset = np.vstack([self._offset.values, here.offset])[nodes]
        track = np.vstack([self._track.values, self._here])[nodes]
        flown = np.vstack([self._flown.values, self._so_far])[nodes]
        seconds, metres, breaks = np.diff(flown, axis=0).T
        unknown = self.BREAK_VARIANCE * breaks + 1e-9
        turn = self._odometry.yaw_noise ** 2 * seconds + unknown
        along = self.WALK_SIGMA_M ** 2 * metres + unknown
        # A turn somewhere on the way throws its end sideways.
        across = along + turn * (0.5 * metres) ** 2
        return Chain(compose_rows(self.map.poses[experience], offset),
                     between_rows(track[:-1], track[1:]), seconds,
                     np.column_stack([along, across, turn]))
