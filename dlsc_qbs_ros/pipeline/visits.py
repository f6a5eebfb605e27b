"""Which experiences the robot was at, visit by visit, and the links that this makes of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .dead_reckoning import DeadReckoning
from ..core.experience_map import ExperienceMap
from ..core.geometry import between_rows, compose, compose_rows, wrap_angle
from ..core.rows import Rows
from ..core.types import IDENTITY, Pose2
from ..errors import MapError

ALL = slice(None)


@dataclass(frozen=True)
class Place:
    """Where the robot stands, or stood: a motion after a visit; where that was may be revised."""

    visits: Visits
    visit: int
    since: Pose2

    @property
    def experience(self) -> int:
        """Return the experience that the place is given by."""
        return int(self.visits.experience.values[self.visit])

    @property
    def offset(self) -> Pose2:
        """Return the pose in the frame of the experience."""
        return compose(self.visits.offset_at(self.visit), self.since)


class Visits:
    """
    The visits to experiences, and the links that these make in the map.

    A visit creates an experience or meets an old one, and is linked to the visit before it,
    unless odometry broke in between. Visits can be taken back: their links go, odometry bridges
    the gap, and what was created after them moves along. Motions are those of the odometry, less
    its constant errors as far as these are known.

    Attributes
    ----------
    map : ExperienceMap
    experience : Rows of int64
        The experience of each visit.
    run : Rows of int64
        The run of matches that each visit is part of; 0 for none.
    flown : Rows of shape (n, 3)
        The seconds in motion, metres and breaks of odometry up to each visit.
    birth : Rows of int64
        The visit that created each experience.
    odometry : DeadReckoning
        From the visit that the robot's place is given by, since the last break of the odometry.

    """

    # Smaller changes of what is known of the yaw rate, in rad/s, and of the scale leave the map
    # as it is.
    BARELY = 1e-4, 1e-3

    def __init__(self):
        self.map = ExperienceMap()
        self.experience = Rows(np.zeros(0, np.int64))
        self.run = Rows(np.zeros(0, np.int64))
        self.flown = Rows(np.zeros((0, 3)))
        self.birth = Rows(np.zeros(0, np.int64))
        # Per visit: the pose in the frame of its experience, and by odometry alone.
        self._offset = Rows(np.zeros((0, 3)))
        self._track = Rows(np.zeros((0, 3)))
        # Per link: the visit that made it.
        self._maker = Rows(np.zeros(0, np.int64))
        # The visit that the robot's place is given by: the last one, but for a robot that was
        # put elsewhere.
        self._stand = -1
        self.odometry = DeadReckoning()

    def state(self) -> dict[str, np.ndarray]:
        """Return what `restore` takes, by the names in `map_state.ARRAYS`."""
        return {
            'experience_poses': self.map.poses.copy(),
            'experience_births': self.birth.values.copy(),
            'link_ends': self.map.links.copy(),
            'link_motions': self.map.motions.copy(),
            'link_is_closure': self.map.is_closure.copy(),
            'link_makers': self._maker.values.copy(),
            'visit_experiences': self.experience.values.copy(),
            'visit_offsets': self._offset.values.copy(),
            'visit_tracks': self._track.values.copy(),
            'visit_runs': self.run.values.copy(),
            'visit_flown': self.flown.values.copy(),
            'robot_stand': np.array([self._stand]),
            **self.odometry.state()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on, where nothing was visited yet, from what `state` returned."""
        for pose in state['experience_poses'].tolist():
            self.map.add_experience(Pose2(*pose))
        for (origin, target), motion, is_closure in zip(
                state['link_ends'].tolist(), state['link_motions'].tolist(),
                state['link_is_closure'].tolist()):
            if not self.map.add_link(origin, target, Pose2(*motion), is_closure):
                raise MapError(f'link {origin}-{target}: expected one between two experiences, '
                               'and once')
        (self.birth, self._maker, self.experience, self._offset, self._track, self.run,
         self.flown) = (Rows(state[name].copy()) for name in (
             'experience_births', 'link_makers', 'visit_experiences', 'visit_offsets',
             'visit_tracks', 'visit_runs', 'visit_flown'))
        self._stand = int(state['robot_stand'][0])
        self.odometry.restore(state)

    def put(self, experience: int, offset: Pose2) -> None:
        """Take the robot to be at an offset from an old experience, without a visit."""
        self._stand = int(self.birth.values[experience])
        self.odometry.set_out(offset)

    def calibrate(self, errors: np.ndarray) -> None:
        """Take other errors of yaw rate and scale, (n_segments, 2), out of all motions."""
        before = self.odometry.errors
        changes = errors.copy()
        changes[:len(before)] -= before
        if (np.abs(changes) < self.BARELY).all():
            return
        self.odometry.calibrate(errors)
        is_created = self.birth.values[self.experience.values] == np.arange(len(self.run.values))
        for visit in np.flatnonzero((self.run.values == 0) & ~is_created).tolist():
            self._offset.values[visit] = self._arrival(visit)  # taken back: odometry led there
        links = np.flatnonzero(self._maker.values > 0)
        self.map.change_motions(links, self._motions(self._maker.values[links]))

    @property
    def is_put(self) -> bool:
        """Whether the robot was put somewhere since the last visit."""
        return self._stand >= 0

    def create(self, pose: Pose2) -> None:
        """Visit an experience that is new, at a pose in the map."""
        self.birth.append(len(self.experience.values))
        self.add(self.map.add_experience(pose), IDENTITY, 0)

    def add(self, experience: int, offset: Pose2, run: int) -> None:
        """Visit an experience, at an offset from it, as one of a run of matches."""
        self.experience.append(experience)
        self._offset.append(offset)
        self._track.append(self.odometry.here)
        self.run.append(run)
        self.flown.append(self.odometry.flown)
        self._stand = -1
        self.odometry.set_out(IDENTITY)
        self._link(len(self.experience.values) - 1)

    def take_back(self, visits: np.ndarray) -> None:
        """Let visits have met nothing: their links go, and odometry bridges the gap."""
        first, after = int(visits[0]), int(visits[-1]) + 1
        is_wrong = (self._maker.values >= first) & (self._maker.values <= after)
        self.map.remove_links(is_wrong)
        self._maker = Rows(self._maker.values[~is_wrong])
        self.run.values[visits] = 0
        wrong = set(visits.tolist())
        for visit in range(first, min(after + 1, len(self.experience.values))):
            if visit in wrong:
                self._offset.values[visit] = self._arrival(visit)
                self.experience.values[visit] = self.experience.values[visit - 1]
            elif self.birth.values[self.experience.values[visit]] == visit:
                self._carry(visit, is_last=visit == after)
            self._link(visit)

    def place(self) -> Place | None:
        """Return where the robot stands; None before the first visit."""
        n = len(self.experience.values)
        return Place(self, self._stand % n, self.odometry.since) if n else None

    def pose(self) -> Pose2:
        """Return where the robot stands in the map."""
        return compose(self.pose_at(self._stand), self.odometry.since)

    def offset_at(self, visit: int) -> Pose2:
        """Return the robot's pose at a visit in the frame of the experience."""
        return Pose2(*self._offset.values[visit].tolist())

    def pose_at(self, visit: int) -> Pose2:
        """Return where the robot was in the map at a visit."""
        return compose(self.map.pose(int(self.experience.values[visit])), self.offset_at(visit))

    def track_at(self, visit: int) -> Pose2:
        """Return where the robot was by odometry alone at a visit."""
        return Pose2(*self._track.values[visit].tolist())

    def turn_at(self, visit: int) -> float:
        """Return by how much the robot turned between a visit and the one before or after it."""
        around = np.arange(max(visit - 1, 0), min(visit + 2, len(self.run.values)))
        around = around[self.flown.values[around, 2] == self.flown.values[visit, 2]]
        turns_rad = self._track.values[around, 2] - self._track.values[visit, 2]
        return float(np.abs(wrap_angle(turns_rad)).max())

    def ages(self, experiences: np.ndarray | slice = ALL) -> np.ndarray:
        """Return the seconds in motion and metres since experiences were created, (n, 2)."""
        return (self.odometry.flown - self.flown.values[self.birth.values[experiences]])[:, :2]

    def ways(self, origins: np.ndarray, visits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the seconds, and the metres as the crow flies, from visits to others, (n,).

        Nothing is known of a way on which odometry broke: it has no length.
        """
        flown, track = self.flown.values, self._track.values
        seconds, _, breaks = (flown[visits] - flown[origins]).T
        metres = np.hypot(*(track[visits] - track[origins])[:, :2].T)
        return seconds, np.where(breaks == 0.0, metres, 0.0)

    def along(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return poses in the map, by odometry alone, and what was flown, (n, 3) each, at visits.

        The visit after the last one is here and now.
        """
        here = self.place()
        experience, offset, track, flown = (
            _at(nodes, rows.values, now) for rows, now in (
                (self.experience, here.experience), (self._offset, here.offset),
                (self._track, self.odometry.here), (self.flown, self.odometry.flown)))
        return compose_rows(self.map.poses[experience], offset), track, flown

    def _arrivals(self, visits: np.ndarray) -> np.ndarray:
        """Return where visits were, by odometry, in the frames of the experiences before."""
        track, flown = self._track.values, self.flown.values
        seconds, _, _ = (flown[visits] - flown[visits - 1]).T
        return compose_rows(self._offset.values[visits - 1], self.odometry.calibrated(
            between_rows(track[visits - 1], track[visits]), seconds, flown[visits, 2]))

    def _arrival(self, visit: int) -> Pose2:
        return Pose2(*self._arrivals(np.array([visit]))[0].tolist())

    def _motions(self, visits: np.ndarray) -> np.ndarray:
        """Return the motions from the experiences before visits to those visited, (n, 3)."""
        offsets = self._offset.values[visits]
        return compose_rows(self._arrivals(visits), between_rows(offsets, np.zeros_like(offsets)))

    def _is_cut(self, visit: int) -> bool:
        """Whether odometry broke between the visit before and this one."""
        return bool(self.flown.values[visit, 2] != self.flown.values[visit - 1, 2])

    def _link(self, visit: int) -> None:
        """Link a visit's experience to that of the visit before, as odometry led there."""
        if visit == 0 or self._is_cut(visit):
            return
        origin, target = self.experience.values[[visit - 1, visit]].tolist()
        motion = Pose2(*self._motions(np.array([visit]))[0].tolist())
        is_closure = bool(self.birth.values[target] != visit)
        if self.map.add_link(origin, target, motion, is_closure):
            self._maker.append(visit)

    def _carry(self, visit: int, is_last: bool) -> None:
        """Move what a visit created to where odometry led; after the last one, all the rest."""
        if self._is_cut(visit):
            return
        experience, origin = self.experience.values[[visit, visit - 1]].tolist()
        moved = self.birth.values >= visit if is_last else [experience]
        now = compose(self.map.pose(origin), self._arrival(visit))
        self.map.move(moved, compose_rows(
            np.array([now]), between_rows(self.map.poses[[experience]], self.map.poses[moved])))


def _at(nodes: np.ndarray, of_visits: np.ndarray, now) -> np.ndarray:
    """Return the values of visits, by number; the one after the last is now."""
    values = of_visits[np.minimum(nodes, len(of_visits) - 1)]
    values[nodes == len(of_visits)] = now
    return values
