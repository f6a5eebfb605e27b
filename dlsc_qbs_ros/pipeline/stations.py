"""Where view cells stand in a row: at equal distances, with room for views that are missing."""

from __future__ import annotations

import numpy as np

from .visits import Visits
from ..config import RatSlamConfig
from ..core.rows import Rows


class Stations:
    """
    The stations of view cells, told by the odometry between the visits that made them.

    Where views are missing, or older cells were met on the way, there is room for as many.

    Attributes
    ----------
    of_cells : Rows of int64
        The rising stations of the view cells.

    """

    # Cells so long apart have a gap between them, if they are so many distances of a keyframe
    # apart, too. How many are missing is told by the last legs between visits.
    GAP_S, GAP = 1.0, 3.0
    N_LEGS = 40

    def __init__(self, visits: Visits, config: RatSlamConfig):
        self.config = config
        self._visits = visits
        self.of_cells = Rows(np.zeros(0, np.int64))
        self._last_visit = 0  # that made a cell

    def restore(self, experiences: np.ndarray) -> None:
        """Go on with view cells that were made with these experiences, (n_cells,)."""
        self.of_cells = Rows(self._after(-1, experiences))

    def add(self, experience: int) -> None:
        """Take note of a view cell that was made with an experience."""
        last = int(self.of_cells.values[-1]) if len(self.of_cells.values) else -1
        self.of_cells.extend(self._after(last, np.array([experience])))

    def missing(self, seconds: float, metres: float) -> int:
        """Return how many views are missing between the last one and the next, so far from it."""
        if not self._is_gap(seconds, metres):
            return 0
        return self._missing(metres, len(self._visits.experience.values))

    def _after(self, station: int, experiences: np.ndarray) -> np.ndarray:
        visits = self._visits.birth.values[experiences]
        seconds, metres = self._visits.ways(np.append(self._last_visit, visits[:-1]), visits)
        self._last_visit = int(visits[-1])
        steps = np.ones(len(visits), np.int64)
        for k in np.flatnonzero(self._is_gap(seconds, metres)):
            steps[k] += self._missing(float(metres[k]), int(visits[k]))
        return station + np.cumsum(steps)

    def _is_gap(self, seconds, metres):
        return (seconds > self.GAP_S) & (metres > self.GAP * self.config.keyframe_distance_m)

    def _missing(self, metres: float, visit: int) -> int:
        """Return how many views there would have been on the way to a visit."""
        last = np.arange(max(visit - self.N_LEGS, 1), visit)
        _, legs_m = self._visits.ways(last - 1, last)
        leg_m = max(np.median([0.0, *legs_m]), self.config.keyframe_distance_m)
        return min(max(round(metres / leg_m) - 1, 0), 2 * self.config.sequence_length)
