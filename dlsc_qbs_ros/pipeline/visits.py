"""Which experiences the robot was at, visit by visit, and the links that this makes of them."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

import numpy as np

from ..core.experience_map import ExperienceMap
from ..core.geometry import between, between_rows, compose, compose_rows, invert, wrap_angle
from ..core.rows import Rows
from ..core.types import IDENTITY, Pose2, Track
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
    the gap, and what was created after them moves along.

    Attributes
    ----------
    map : ExperienceMap
    experience : Rows of int64
        The experience of each visit.
    run : Rows of int64
        The run of matches that each visit is part of; 0 for none.
    flown : Rows of shape (n, 3)
        The seconds, metres and breaks of odometry up to each visit.
    flown_now : ndarray of shape (3,)
        The same up to here.
    birth : Rows of int64
        The visit that created each experience.

    """

    def __init__(self):
        self.map = ExperienceMap()
        self.experience = Rows(np.zeros(0, np.int64))
        self.run = Rows(np.zeros(0, np.int64))
        self.flown = Rows(np.zeros((0, 3)))
        self.flown_now = np.zeros(3)
        self.birth = Rows(np.zeros(0, np.int64))
        # Per visit: the pose in the frame of its experience, and by odometry alone.
        self._offset = Rows(np.zeros((0, 3)))
        self._track = Rows(np.zeros((0, 3)))
        # Per link: the visit that made it.
        self._maker = Rows(np.zeros(0, np.int64))
        # The visit that the robot's place is given by: the last one, but for a robot that was
        # put elsewhere; its motion since then, and its pose by odometry alone.
        self._stand = -1
        self._here = self._since = IDENTITY

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
            'robot_track': np.array(self._here),
            'robot_since': np.array(self._since),
            'robot_flown': self.flown_now.copy(),
            'robot_stand': np.array([self._stand])}

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
        self._here, self._since = (
            Pose2(*state[name].tolist()) for name in ('robot_track', 'robot_since'))
        self.flown_now = state['robot_flown'].copy()
        self._stand = int(state['robot_stand'][0])

    def move(self, motion: Pose2, seconds: float) -> None:
        """Carry the robot along with the odometry."""
        self._here, self._since = compose(self._here, motion), compose(self._since, motion)
        self.flown_now = self.flown_now + (seconds, hypot(motion.x_m, motion.y_m), 0.0)

    def cut(self) -> None:
        """Let no link span from the last visit to the next."""
        self.flown_now = self.flown_now + (0.0, 0.0, 1.0)

    def put(self, experience: int, offset: Pose2) -> None:
        """Take the robot to be at an offset from an old experience, without a visit."""
        self._stand, self._since = int(self.birth.values[experience]), offset

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
        self._track.append(self._here)
        self.run.append(run)
        self.flown.append(self.flown_now)
        self._stand, self._since = -1, IDENTITY
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
        return Place(self, self._stand % n, self._since) if n else None

    def pose(self) -> Pose2:
        """Return where the robot stands in the map."""
        return compose(self.pose_at(self._stand), self._since)

    def track(self) -> Track:
        """Return where the robot is by odometry alone."""
        return Track(self._here, *self.flown_now[:2].tolist())

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
        """Return the seconds and metres flown since experiences were created, (n, 2)."""
        return (self.flown_now - self.flown.values[self.birth.values[experiences]])[:, :2]

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
                (self._track, self._here), (self.flown, self.flown_now)))
        return compose_rows(self.map.poses[experience], offset), track, flown

    def _arrival(self, visit: int) -> Pose2:
        """Return where a visit was, by odometry, in the frame of the last visit's experience."""
        return compose(self.offset_at(visit - 1),
                       between(self.track_at(visit - 1), self.track_at(visit)))

    def _is_cut(self, visit: int) -> bool:
        """Whether odometry broke between the visit before and this one."""
        return bool(self.flown.values[visit, 2] != self.flown.values[visit - 1, 2])

    def _link(self, visit: int) -> None:
        """Link a visit's experience to that of the visit before, as odometry led there."""
        if visit == 0 or self._is_cut(visit):
            return
        origin, target = self.experience.values[[visit - 1, visit]].tolist()
        motion = compose(self._arrival(visit), invert(self.offset_at(visit)))
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
