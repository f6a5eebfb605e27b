"""Which parts of the map hang together, where odometry broke in between."""

from __future__ import annotations

from math import inf

import numpy as np

from .looseness import looseness
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
        # Per visit up to the last change: see `looseness`. None after a change.
        self._loose: np.ndarray | None = None

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

    def detour(self, experiences: int | np.ndarray) -> np.ndarray:
        """
        Return the seconds and metres of odometry between experiences and the robot's anchor.

        The anchor is the old place that it was last at, (2, n) the result. The oldest segment of
        a piece is the map, as it is; what hangs on to it by odometry alone, as a stretch that
        was flown while lost does, may lie elsewhere by the drift of that way.
        """
        visits, anchor = self._visits, self._anchor()
        births = visits.birth.values[experiences]
        if anchor is None or np.array_equal(self._piece, np.arange(len(self._piece))):
            return np.zeros((2, *np.shape(births)))
        if self._loose is None:
            segments = visits.flown.values[:, 2].astype(int)
            self._loose = looseness(visits, self._piece[segments] == segments)
        flown = visits.flown.values
        along = np.abs(flown[births] - flown[anchor])
        along[along[..., 2] > 0.0] = inf
        return np.minimum(self._ways(births) + self._ways(anchor), along[..., :2]).T

    def _anchor(self) -> int | None:
        """Return the visit that made the old place the robot was last at; None if at none yet."""
        visits = self._visits
        if visits.is_put:
            return visits.place().visit
        met = np.flatnonzero(visits.run.values)
        if not len(met) or visits.flown.values[met[-1], 2] != visits.odometry.flown[2]:
            return None
        return int(visits.birth.values[visits.experience.values[met[-1]]])

    def _ways(self, births: int | np.ndarray) -> np.ndarray:
        """Return how loose visits are, (n, 2); those since the last change go on from there."""
        known = np.minimum(births, len(self._loose) - 1)
        flown = self._visits.flown.values
        return self._loose[known] + (flown[births] - flown[known])[..., :2]

    def tie(self) -> None:
        """Take note that another match ties the map together."""
        self._loose = None

    def put(self, experience: int) -> None:
        """Take the robot to be in the piece of an experience from here on."""
        if self.is_apart(experience):
            self._put.append((self._visits.odometry.flown[2], self._segment(experience)))
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
        self._loose = None
        visits = self._visits
        met = np.flatnonzero(visits.run.values)
        births = visits.birth.values[visits.experience.values[met]]
        joins = np.vstack([visits.flown.values[[met, births], 2].T, self._put.values])
        self._piece = np.arange(int(visits.odometry.flown[2]) + 1)
        for pair in np.unique(joins.astype(int), axis=0).tolist():
            pieces = self._piece[pair]
            self._piece[np.isin(self._piece, pieces)] = pieces.min()

    def _segment(self, experiences: int | np.ndarray) -> float | np.ndarray:
        """Return the segment of odometry that experiences were created in."""
        return self._visits.flown.values[self._visits.birth.values[experiences], 2]
