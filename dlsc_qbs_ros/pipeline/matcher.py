"""Which old place the views show, as far as odometry allows it, and where that puts the robot."""

from __future__ import annotations

from math import hypot, inf
from typing import NamedTuple

import numpy as np

from .journey import Journey
from .relocaliser import Relocaliser
from .stations import Stations
from ..config import Config
from ..core.geometry import between, wrap_angle
from ..core.rows import Rows
from ..core.sequence import Scores, SequenceScore
from ..core.types import Pose2


class Match(NamedTuple):
    """The view cell that a run of views ends in, and whether odometry did not expect that."""

    view_cell: int
    is_jump: bool


class Matcher:
    """
    Compares runs of views and weighs what they say against the odometry; the map stays.

    Attributes
    ----------
    view_cell : Rows of int64
        The view cell of each experience.

    """

    # A run of views that a gap cut short may be that short for a place to be tracked by it. So
    # short a run shows a place, too, where paths meet for a moment, if it is more alike than a
    # whole one must be by this share of the leeway.
    SHORTEST_RUN = 4
    SURENESS = 0.1
    # By this share of the leeway, a place where odometry did not expect the robot must be more
    # alike than any other in reach.
    LEAD = 0.5

    def __init__(self, config: Config, journey: Journey):
        self._config = config.ratslam
        self._is_published = config.ratslam.backend == 'published'
        self._length = config.ratslam.sequence_length
        self._journey = journey
        self._visits, self._pieces = journey.visits, journey.pieces
        self._map = journey.visits.map
        self._sequence = SequenceScore(
            1 if self._is_published else self._length, shortest=self.SHORTEST_RUN)
        self._relocaliser = Relocaliser(config)
        self.view_cell = Rows(np.zeros(0, np.int64))
        self._stations = Stations(self._visits, self._config)

    def reconfigure(self, config: Config) -> None:
        """Go on with other values of `live` parameters."""
        self._config = self._stations.config = config.ratslam
        self._relocaliser.reconfigure(config)

    def state(self) -> dict[str, np.ndarray]:
        """Return what `restore` takes, by the names in `map_state.ARRAYS`."""
        return {'experience_view_cells': self.view_cell.values.copy(),
                **self._sequence.state(len(self._stations.of_cells.values))}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on, with the visits restored, from what `state` returned."""
        self.view_cell = Rows(state['experience_view_cells'].copy())
        _, first = np.unique(self.view_cell.values, return_index=True)
        self._stations.restore(first)
        self._sequence.restore(state, self._stations.of_cells.values)

    def add_experience(self, view_cell: int) -> None:
        """Take note of the view cell of an experience that was just created."""
        self.view_cell.append(view_cell)
        if view_cell == len(self._stations.of_cells.values):
            self._stations.add(len(self.view_cell.values) - 1)

    def go_on(self, seconds: float, metres: float) -> None:
        """Take note of how far the next view is from the last one."""
        missing = self._stations.missing(seconds, metres)
        if missing > self._length:
            self.end_run()
        elif missing:
            self._sequence.skip(missing, self._stations.of_cells.values)

    def end_run(self) -> None:
        """Let the next view not continue those before."""
        self._sequence.clear()

    def clear(self) -> None:
        """Forget the views, and what was sighted, so far."""
        self._sequence.clear()
        self._relocaliser.clear()

    def score(self, likeness: np.ndarray) -> Scores | None:
        """Return how alike the last views and each cell are; None at first."""
        return self._sequence.update(likeness, self._stations.of_cells.values)

    def find(self, scores: Scores) -> int | None:
        """Return an experience of another piece of the map, where views alone tell of one."""
        pieces = self._pieces.of()
        is_apart = pieces != self._pieces.here
        if self._is_published or not is_apart.any():
            return None
        cells = self.view_cell.values
        of_experiences = np.where(is_apart, scores.long[cells], -inf)
        if not scores.is_whole[cells[np.argmax(of_experiences)]]:
            return None
        return self._relocaliser.find(
            of_experiences, self._map.poses, pieces, self._visits.odometry.track())

    def match(self, scores: Scores) -> Match | None:
        """Return the view cell that the last run of views ends in, if odometry allows one."""
        if self._visits.place() is None:
            return None
        if self._is_published:
            best = int(np.argmax(scores.long))
            return Match(best, False) if scores.long[best] >= self._config.threshold else None
        match, is_doubtful = self._by_long_run(scores)
        if match is None:
            match, is_doubtful = self._by_short_run(scores.short)
        return None if is_doubtful else match

    def _by_long_run(self, scores: Scores) -> tuple[Match | None, bool]:
        """
        Match the longest run there is, as long as the last view still belongs to it.

        Return whether another place makes the match doubtful, too.
        """
        score, config = scores.long, self._config
        lowest = min(config.threshold, config.tracking_threshold)
        in_reach, is_tracked = self._gate((score >= lowest) & (scores.last >= lowest))
        cells = np.flatnonzero(in_reach)
        near, far = np.where(
            scores.is_whole[cells],
            [[config.tracking_threshold], [config.threshold]], [[config.threshold], [inf]])
        needed = np.where(is_tracked[cells], near, far)
        candidates = np.flatnonzero(score[cells] >= needed)
        if not len(candidates):
            return None, False
        chosen = candidates[np.argmax(score[cells[candidates]])]
        best = int(cells[chosen])
        match = Match(best, bool(needed[chosen] == far[chosen]))
        return match, (self._is_ambiguous(best, score, in_reach, self._length) if match.is_jump
                       else self._is_outdone(best, score))

    def _by_short_run(self, score: np.ndarray) -> tuple[Match | None, bool]:
        """Match a run of few views, where it is very much alike; return what the long one does."""
        enough = self._config.threshold + self.SURENESS * self._leeway
        if self._leeway == 0.0 or score.max(initial=-inf) < enough:
            return None, False
        in_reach, _ = self._gate(score >= enough - self.LEAD * self._leeway)
        score = np.where(in_reach, score, -inf)
        best = int(np.argmax(score))
        if score[best] < enough:
            return None, False
        n_views = min(self.SHORTEST_RUN, self._length)
        return Match(best, True), self._is_ambiguous(best, score, in_reach, n_views)

    def sigmas_at(self, experience: int) -> tuple[float, float]:
        """
        Return the deviations of position and heading at which a view is met again.

        A run may be met a view early or late: in a bend the heading is off by that turn, too.
        """
        turn_rad = self._visits.turn_at(int(self._visits.birth.values[experience]))
        return (self._config.match_position_sigma_m,
                hypot(self._config.match_yaw_sigma_rad, turn_rad))

    def trust(self, experience: int) -> tuple[float, float]:
        """Return the weights of odometry beside a view, for position and heading."""
        if self._pieces.is_apart(experience):
            return 0.0, 0.0
        of_match, of_odometry = self.sigmas_at(experience), self._sigmas(experience)
        trust_m, trust_rad = map(_share, of_match, of_odometry)
        return trust_m, trust_rad

    def offset_from(self, experience: int) -> Pose2:
        """
        Return where the robot stands in the frame of an experience whose view it sees.

        Odometry says where, the view says "here, heading the same way"; each is weighed by its
        variance. The yaw is RatSLAM's relative heading.
        """
        expected = between(self._map.pose(experience), self._visits.pose())
        trust_m, trust_rad = (0.0, 0.0) if self._is_published else self.trust(experience)
        return Pose2(trust_m * expected.x_m, trust_m * expected.y_m,
                     trust_rad * expected.yaw_rad)

    def old_experiences(self, view_cell: int) -> np.ndarray:
        """
        Return the experiences of a view cell that may be met again.

        Not one that a match has just made because the packet had not arrived yet.
        """
        experiences = np.flatnonzero(self.view_cell.values == view_cell)
        return experiences[self._is_old_enough(experiences)]

    def nearest_experience(self, view_cell: int) -> int:
        """Return the old experience of a view cell that is nearest to the estimated position."""
        experiences = self.old_experiences(view_cell)
        here = self._visits.pose()
        offsets = self._map.poses[experiences, :2] - (here.x_m, here.y_m)
        return int(experiences[np.argmin(np.hypot(*offsets.T))])

    def _sigmas(self, experiences: int | np.ndarray) -> tuple:
        """Return the deviations of the robot's position and heading, as seen from experiences."""
        drift = self._journey.drift.beyond(*self._pieces.detour(experiences))
        return drift.position_sigma_m(self._map.radius_m), drift.yaw_sigma_rad()

    def _gate(self, is_asked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Return which of the view cells asked for, (n_cells,), are in reach, and which tracked.

        In reach is a cell with an old enough experience, in this piece of the map, within the
        drift of the odometry since the last closure. It is tracked where odometry expects it.
        """
        in_reach, is_tracked = np.zeros((2, len(is_asked)), bool)
        asked = np.flatnonzero(is_asked[self.view_cell.values])
        if not len(asked):
            return in_reach, is_tracked
        here = self._visits.pose()
        reach = self._config.gate_sigmas
        sigma_m, sigma_rad = self._sigmas(asked)
        x_m, y_m, yaw_rad = self._map.poses[asked].T
        offset_m = np.hypot(x_m - here.x_m, y_m - here.y_m)
        turn_rad = np.abs(wrap_angle(yaw_rad - here.yaw_rad))
        allowed = (
            (offset_m <= reach * np.hypot(sigma_m, self._config.match_position_sigma_m))
            & (turn_rad <= reach * np.hypot(sigma_rad, self._config.match_yaw_sigma_rad))
            & (self._pieces.of(asked) == self._pieces.here)
            & self._is_old_enough(asked))
        # Near by chance is not tracking: odometry must be sure enough to tell.
        is_expected = allowed & (
            np.maximum(offset_m, sigma_m) <= self._config.tracking_distance_m)
        cells = self.view_cell.values[asked]
        in_reach[cells[allowed]] = is_tracked[cells[is_expected]] = True
        return in_reach, is_tracked

    @property
    def _leeway(self) -> float:
        """Return how much likeness odometry makes up for, as tracking takes off the threshold."""
        return max(self._config.threshold - self._config.tracking_threshold, 0.0)

    def _is_outdone(self, view_cell: int, score: np.ndarray) -> bool:
        """
        Return whether the views are more like another old place than odometry makes up for.

        Then the robot is not where it is believed to be, but there, out of reach; and what is
        somewhat alike here is the next bay of the shelves.
        """
        return len(self._old_ones(score > score[view_cell] + self._leeway)) > 0

    def _is_ambiguous(self, view_cell: int, score: np.ndarray, in_reach: np.ndarray, n_views: int
                      ) -> bool:
        """Return whether, of the view cells in reach, one of another place is about as alike."""
        rivals = self._old_ones(
            in_reach & (score > score[view_cell] - self.LEAD * self._leeway))
        x_m, y_m, _ = self._map.poses[rivals].T
        place = self._map.pose(self.nearest_experience(view_cell))
        # Runs of views that share some are alike.
        run_m = n_views * self._config.keyframe_distance_m
        return bool(np.any(np.hypot(x_m - place.x_m, y_m - place.y_m) > run_m))

    def _old_ones(self, is_asked: np.ndarray) -> np.ndarray:
        """Return the old enough experiences, in this piece of the map, of view cells asked for."""
        experiences = np.flatnonzero(is_asked[self.view_cell.values])
        is_here = self._pieces.of(experiences) == self._pieces.here
        return experiences[is_here & self._is_old_enough(experiences)]

    def _is_old_enough(self, experiences: np.ndarray) -> np.ndarray:
        """Return whether experiences may be met again; those of another piece always may."""
        if self._is_published:
            return np.ones(len(experiences), bool)
        age_s, path_m = self._visits.ages(experiences).T
        is_old = (age_s >= self._config.min_age_s) & (path_m >= self._config.min_path_m)
        return is_old | (self._pieces.of(experiences) != self._pieces.here)


def _share(match_sigma: float, odometry_sigma: float) -> float:
    """Return the weight of the odometry beside a match."""
    return float(match_sigma ** 2 / (match_sigma ** 2 + odometry_sigma ** 2))
