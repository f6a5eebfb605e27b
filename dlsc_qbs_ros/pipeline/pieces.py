"""Which parts of the map hang together, where odometry broke in between."""

from __future__ import annotations

import numpy as np

from .visits import ALL, Visits
from ..core.geometry import between_rows, compose, compose_rows
from ..core.rows import Rows
from ..core.types import Pose2


class Pieces:
    """
    The pieces of the map, each named by its oldest segment of odometry.

    A break of the odometry starts another piece, which has a frame of its own until a place of
    an older piece is met: then it moves there as it is, and the two are one.
    """

    def __init__(self, visits: Visits, recognisable: int):
        self._visits = visits
        # Experiences that make a piece long enough for a place of it to be recognised.
        self._recognisable = recognisable
        # Segments of odometry, counted by the breaks before them, that were put to another
        # without a visit; and the piece of the map that each segment is part of.
        self._put = Rows(np.zeros((0, 2), np.int64))
        self._piece = np.zeros(1, np.int64)

    def state(self) -> dict[str, np.ndarray]:
        """Return what `restore` takes, by the names in `map_state.ARRAYS`."""
        return {'put_segments': self._put.values.copy()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on, with the visits restored, from what `state` returned."""
        self._put = Rows(state['put_segments'].copy())
        self.label()

    @property
    def here(self) -> int:
        """Return the piece that the robot is in."""
        return int(self._piece[-1])

    def of(self, experiences: np.ndarray | slice = ALL) -> np.ndarray:
        """Return the piece that experiences are part of, shape (n,)."""
        births = self._visits.birth.values[experiences]
        if not self._piece.any():  # all are part of one, as mostly
            return np.zeros(len(births), np.int64)
        return self._piece[self._visits.flown.values[births, 2].astype(int)]

    def is_apart(self, experience: int) -> bool:
        """Whether an experience is part of another piece than the robot."""
        return bool(self._piece[int(self._segment(experience))] != self.here)

    @property
    def main(self) -> int:
        """Return the map: the oldest piece that is long enough for a place to be recognised."""
        if len(self._piece) == 1:
            return 0
        known = np.flatnonzero(np.bincount(self.of()) >= self._recognisable)
        return int(known[0]) if len(known) else 0

    @property
    def is_localised(self) -> bool:
        """Whether the robot knows where it is in the map, rather than in a piece apart."""
        return self.here == self.main

    def put(self, experience: int) -> None:
        """Take the robot to be in the piece of an experience from here on."""
        if self.is_apart(experience):
            self._put.append((self._visits.flown_now[2], self._segment(experience)))
            self.label()

    def join(self, experience: int, offset: Pose2) -> None:
        """Move the younger piece, the robot's or the experience's, to where they meet."""
        pieces, experiences = self.of(), self._visits.map
        moved = pieces == max(self.here, pieces[experience])
        ends = [self._visits.pose()], [compose(experiences.pose(experience), offset)]
        old, new = ends if pieces[experience] < self.here else ends[::-1]
        experiences.move(moved, compose_rows(
            np.array(new), between_rows(np.array(old), experiences.poses[moved])))

    def label(self) -> None:
        """Name the piece of each segment: a visit to an old experience makes two one."""
        visits = self._visits
        met = np.flatnonzero(visits.run.values)
        births = visits.birth.values[visits.experience.values[met]]
        joins = np.vstack([visits.flown.values[[met, births], 2].T, self._put.values])
        self._piece = np.arange(int(visits.flown_now[2]) + 1)
        for pair in np.unique(joins.astype(int), axis=0).tolist():
            pieces = self._piece[pair]
            self._piece[np.isin(self._piece, pieces)] = pieces.min()

    def _segment(self, experience: int) -> float:
        """Return the segment of odometry that an experience was created in."""
        return self._visits.flown.values[self._visits.birth.values[experience], 2]
