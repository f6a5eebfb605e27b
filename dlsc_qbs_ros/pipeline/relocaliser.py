"""Where a robot is that lost its way: from views alone, and believed only when confirmed."""

from __future__ import annotations

from collections import deque
from math import hypot, inf, sqrt
from typing import NamedTuple

import numpy as np

from ..config import Config
from ..core.drift import Drift
from ..core.geometry import between, compose, wrap_angle
from ..core.types import Pose2, Track


class Sighting(NamedTuple):
    """A place that the last run of views looks like, and where odometry was then."""

    place: Pose2
    track: Track


class Relocaliser:
    """
    Believes in a place after two runs of views that share none and that odometry agrees with.

    With no odometry to gate by, look-alikes are all that can deceive: a run must be like one
    place by `MARGIN` more than like any other of that piece of the map, a second run, flown
    after the first one, must be so too, and most of the runs since then must agree with both.
    """

    MARGIN = 0.1
    # How far back a sighting may confirm another, in lengths of a run.
    MEMORY = 4

    def __init__(self, config: Config):
        self._sightings: deque[Sighting] = deque()
        self.reconfigure(config)

    def reconfigure(self, config: Config) -> None:
        """Go on with other values of `live` parameters."""
        self._config, self._odometry = config.ratslam, config.odometry
        self._run_m = config.ratslam.sequence_length * config.ratslam.keyframe_distance_m

    def clear(self) -> None:
        """Forget what was sighted: the odometry of before is of no use any more."""
        self._sightings.clear()

    def find(self, score: np.ndarray, poses: np.ndarray, pieces: np.ndarray, track: Track
             ) -> int | None:
        """
        Take in what the last run of views looks like; return a place that is to be believed.

        Parameters
        ----------
        score : ndarray of shape (n,)
            How alike that run is to the one that ends in each experience; -inf where the robot
            can't have lost its way to.
        poses : ndarray of shape (n, 3)
            Of the experiences, in metres and radians.
        pieces : ndarray of shape (n,)
            The piece of the map that each is part of: each has a frame of its own.
        track : Track
            Where the robot is by odometry.

        """
        best = int(np.argmax(score))
        if score[best] < self._config.threshold:
            return None
        offsets = poses[:, :2] - poses[best, :2]
        is_rival = (pieces == pieces[best]) & (np.hypot(*offsets.T) > self._run_m)
        if np.max(score[is_rival], initial=-inf) > score[best] - self.MARGIN:
            return None
        sighting = Sighting(Pose2(*poses[best].tolist()), track)
        is_confirmed = self._is_confirmed(sighting)
        self._sightings.append(sighting)
        return best if is_confirmed else None

    def _is_confirmed(self, sighting: Sighting) -> bool:
        """Whether a sighting of one run ago or more, and most since, agree with this one."""
        now_m = sighting.track.metres
        while self._sightings and (
                now_m - self._sightings[0].track.metres > self.MEMORY * self._run_m):
            self._sightings.popleft()
        agrees = [self._agree(earlier, sighting) for earlier in self._sightings]
        first = next((k for k, earlier in enumerate(self._sightings) if agrees[k]
                      and now_m - earlier.track.metres >= self._run_m), None)
        return first is not None and 2 * sum(agrees[first:]) > len(agrees[first:])

    def _agree(self, a: Sighting, b: Sighting) -> bool:
        """Whether odometry may have led from one place to the other."""
        error = between(compose(a.place, between(a.track.pose, b.track.pose)), b.place)
        drift = Drift(self._odometry)
        drift.anchor(sqrt(2.0) * self._config.match_position_sigma_m,
                     sqrt(2.0) * self._config.match_yaw_sigma_rad)
        drift.move(Pose2(b.track.metres - a.track.metres, 0.0, 0.0),
                   b.track.seconds - a.track.seconds)
        reach = self._config.gate_sigmas
        return (hypot(error.x_m, error.y_m) <= reach * drift.position_sigma_m(inf)
                and abs(wrap_angle(error.yaw_rad)) <= reach * drift.yaw_sigma_rad())
