"""How far odometry may have drifted, and its motions without what is known of that."""

from __future__ import annotations

from copy import copy
from math import hypot, pi

import numpy as np

from .geometry import compose, wrap_angle
from .types import Pose2
from ..config import OdometryConfig


# Odometry that is slower than both, in m/s and rad/s, holds still, and so does its error.
STILL_M_S, STILL_RAD_S = 0.02, 0.002


def seconds_in_motion(motion: Pose2, seconds: float) -> float:
    """
    Return for how long odometry moved, or told a turn, on a motion that took so many seconds.

    None of the time that it stands on the ground, or that its clock was set forward by.
    """
    moves = hypot(motion.x_m, motion.y_m) > STILL_M_S * seconds
    return seconds if moves or abs(motion.yaw_rad) > STILL_RAD_S * seconds else 0.0


def rectified(motions: np.ndarray, turns_rad: np.ndarray, scale_errors: np.ndarray
              ) -> np.ndarray:
    """
    Return motions of an odometry that turned too far on the way, evenly, and told too much.

    Parameters
    ----------
    motions : ndarray of shape (n, 3)
        In metres and radians. Each should be straight, or turn evenly, itself.
    turns_rad : ndarray of shape (n,)
        By how much each turned too far to the left.
    scale_errors : ndarray of shape (n,)
        By which share of itself each is too long.

    Returns
    -------
    ndarray of shape (n, 3)

    """
    x, y, yaw = motions.T
    c, s = np.cos(0.5 * turns_rad), np.sin(0.5 * turns_rad)
    x, y = (1.0 - scale_errors) * (c * x + s * y), (1.0 - scale_errors) * (c * y - s * x)
    return np.column_stack([x, y, wrap_angle(yaw - turns_rad)])


def rectified_motion(motion: Pose2, turn_rad: float, scale_error: float) -> Pose2:
    """Return one motion as `rectified` does, without arrays."""
    x_m, y_m, yaw_rad = compose(Pose2(0.0, 0.0, -0.5 * turn_rad), motion)
    return Pose2((1.0 - scale_error) * x_m, (1.0 - scale_error) * y_m,
                 wrap_angle(yaw_rad - 0.5 * turn_rad))


class Drift:
    """
    Deviations of position and heading, since the last anchor.

    Over t seconds and L metres since then, a yaw rate error of deviation b and a random walk of
    n rad/sqrt(s) give the heading the variance (b t)^2 + n^2 t; the position errs by a share of
    L and by half the heading's error over the path, which cannot throw it farther than across
    the map. Both add to what was left at the anchor.
    """

    def __init__(self, config: OdometryConfig):
        self._config = config
        self.anchor(0.0, 0.0)

    def reconfigure(self, config: OdometryConfig) -> None:
        """Go on with other deviations, as if they had held since the anchor."""
        self._config = config

    def anchor(self, position_sigma_m: float, yaw_sigma_rad: float) -> None:
        """Start again from a pose known this well."""
        self._anchor_sigma = position_sigma_m, yaw_sigma_rad
        self._path_m = self._time_s = 0.0

    def state(self) -> np.ndarray:
        """Return what it is made of, (4,): both deviations at the anchor, metres, seconds."""
        return np.array([*self._anchor_sigma, self._path_m, self._time_s])

    def restore(self, state: np.ndarray) -> None:
        """Go on from what `state` returned."""
        *anchor_sigma, self._path_m, self._time_s = state.tolist()
        self._anchor_sigma = tuple(anchor_sigma)

    def move(self, motion: Pose2, seconds: float) -> None:
        """Account for one motion of the odometry."""
        self._path_m += hypot(motion.x_m, motion.y_m)
        self._time_s += seconds

    def beyond(self, seconds, metres) -> Drift:
        """Return what it were after more odometry; arrays (n,) make the deviations (n,) too."""
        other = copy(self)
        other._time_s, other._path_m = self._time_s + seconds, self._path_m + metres
        return other

    def yaw_sigma_rad(self):
        """Return the deviation of the heading."""
        bias = self._config.yaw_bias_rad_s * self._time_s
        return np.sqrt(self._anchor_sigma[1] ** 2 + bias ** 2
                       + self._config.yaw_noise ** 2 * self._time_s)

    def position_sigma_m(self, map_radius_m: float):
        """Return the deviation of the position, in a map of this radius."""
        lever = np.minimum(self._path_m, map_radius_m)
        # Infinite in a new segment; but no turn is more than half a one.
        yaw_sigma = np.minimum(self.yaw_sigma_rad(), pi)
        return np.sqrt(self._anchor_sigma[0] ** 2
                       + (self._config.translation_drift * self._path_m) ** 2
                       + (0.5 * lever * yaw_sigma) ** 2)
