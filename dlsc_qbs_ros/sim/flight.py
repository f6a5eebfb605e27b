"""
How the drone flies, what its odometry makes of it and what the beacons see.

The path is a closed loop flown again and again at about 1.1 m/s, the camera along the loop's
tangent. Slow waves of periods that share no multiple with a lap make each lap differ: up to
0.2 m to the side, 0.1 m in height, 2 degrees of roll and pitch, 1.5 degrees of yaw. They go on at
a stand, and another one, of 0.05 m, along the path.
"""

from __future__ import annotations

from math import pi
from typing import Callable

import numpy as np

from .schedule import Schedule
from .variations import PLAIN, Variations

SPEED_M_S = 1.1
STEP_M = 0.02
CORNER_M = 0.75

SOUTH_M, AISLE_1_M, AISLE_2_M, NORTH_M = 1.06, 4.625, 8.375, 11.94
WEST_M, EAST_M = 1.45, 16.55

# Flight 1 between wall and shelves, 2 between shelves only, 3 both in turn.
WAYPOINTS_M = {
    1: ((WEST_M, SOUTH_M), (EAST_M, SOUTH_M), (EAST_M, NORTH_M), (WEST_M, NORTH_M)),
    2: ((WEST_M, AISLE_1_M), (EAST_M, AISLE_1_M), (EAST_M, AISLE_2_M), (WEST_M, AISLE_2_M)),
    3: ((WEST_M, SOUTH_M), (EAST_M, SOUTH_M), (EAST_M, NORTH_M), (WEST_M, NORTH_M),
        (WEST_M, AISLE_1_M), (EAST_M, AISLE_1_M), (EAST_M, AISLE_2_M), (WEST_M, AISLE_2_M)),
}

YAW_BIAS_RAD_S = (0.006, 0.014)
YAW_WALK_RAD_SQRT_S = 0.012
SCALE_SIGMA = 0.03
STEP_SIGMA_M = 0.001
STEP_SIGMA_RAD = 0.0005
HEIGHT_SIGMA_M = 0.01
TILT_SIGMA_RAD = 0.002

BEACON_SIGMA_M = 0.05
BEACON_SIGMA_RAD = 0.02


class Trajectory:
    """The true motion of one flight, at any time."""

    def __init__(self, flight: int, rng: np.random.Generator, variations: Variations = PLAIN):
        self._lap = smooth_loop(np.array(WAYPOINTS_M[flight]))
        self.lap_length_m = len(self._lap) * STEP_M
        self.schedule = Schedule(self.lap_length_m / SPEED_M_S, variations)
        self._hurry_s = _waves(rng, 0.4, (23.0, 9.1))
        self._side_m = _waves(rng, 0.2, (83.0, 29.0))
        self._height_m = _waves(rng, 0.1, (31.0, 7.3))
        self._roll_rad = _waves(rng, 0.03, (5.3, 1.9))
        self._pitch_rad = _waves(rng, 0.03, (6.1, 2.3))
        self._yaw_rad = _waves(rng, 0.025, (4.3, 2.7))
        self._sway_m = _waves(rng, 0.05, (7.9, 3.7))

    def laps(self, times_s: np.ndarray) -> np.ndarray:
        """Return how many laps are flown, in laps and parts, less those the other way round."""
        course_s = self.schedule.course_s(times_s)
        hurry_s = self._hurry_s(self.schedule.flown_s(times_s))
        sway_m = self.schedule.standing(times_s) * self._sway_m(times_s)
        return (SPEED_M_S * (course_s + hurry_s) + sway_m) / self.lap_length_m

    def poses(self, times_s: np.ndarray) -> np.ndarray:
        """
        Return the true poses.

        Parameters
        ----------
        times_s : ndarray of shape (n,)
            Seconds since the start.

        Returns
        -------
        ndarray of shape (n, 6)
            x, y, z in metres; roll, pitch, yaw in radians, yaw unwrapped.

        """
        share = np.arange(len(self._lap) + 1) / len(self._lap)
        closed = np.concatenate((self._lap, self._lap[:1]))
        x_m, y_m, along_x, along_y = (
            np.interp(self.laps(times_s) % 1.0, share, column) for column in closed.T)
        side_m = self._side_m(times_s)
        return np.stack((
            x_m - side_m * along_y, y_m + side_m * along_x,
            self.schedule.altitude_m(times_s) + self._height_m(times_s),
            self._roll_rad(times_s), self._pitch_rad(times_s),
            np.unwrap(np.arctan2(along_y, along_x)) + self._yaw_rad(times_s)
            + self.schedule.turned_rad(times_s)), axis=1)


def smooth_loop(corners_m: np.ndarray) -> np.ndarray:
    """
    Round the corners of a closed polygon by a Gaussian of CORNER_M along the path.

    Parameters
    ----------
    corners_m : ndarray of shape (n_corners, 2)
        The polygon.

    Returns
    -------
    ndarray of shape (n, 4)
        x, y and the unit tangent, about every STEP_M of the smooth loop.

    """
    polygon = _resampled(corners_m)
    frequency = np.fft.fftfreq(len(polygon), STEP_M)[:, None]
    gauss = np.exp(-2.0 * (pi * CORNER_M * frequency) ** 2)
    smooth = _resampled(np.fft.ifft(np.fft.fft(polygon, axis=0) * gauss, axis=0).real)
    tangent = np.roll(smooth, -1, axis=0) - np.roll(smooth, 1, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.concatenate((smooth, tangent), axis=1)


def _resampled(points_m: np.ndarray) -> np.ndarray:
    """Return points at even distances along the closed polygon."""
    closed = np.concatenate((points_m, points_m[:1]))
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1)))
    even = np.linspace(0.0, along[-1], round(along[-1] / STEP_M), endpoint=False)
    return np.stack([np.interp(even, along, column) for column in closed.T], axis=1)


def _waves(rng, amplitude: float, periods_s: tuple[float, ...]) -> Callable:
    """Return a function of time: sines of these periods and seeded phases, at most `amplitude`."""
    phases = rng.uniform(0.0, 2 * pi, len(periods_s))
    return lambda times_s: amplitude * np.mean(
        [np.sin(2 * pi * times_s / period + phase)
         for period, phase in zip(periods_s, phases)], axis=0)


def drift(times_s: np.ndarray, poses: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """
    Return the odometry of a flight: what dead reckoning makes of its increments.

    Each increment in the body frame is scaled by 1 + N(0, SCALE_SIGMA), one draw per flight, and
    gets white noise of STEP_SIGMA_M per axis and STEP_SIGMA_RAD. The yaw drifts by a constant
    bias, of random sign and 0.006 to 0.014 rad/s, and by a random walk of YAW_WALK_RAD_SQRT_S.
    Height, roll and pitch pass through with white noise of HEIGHT_SIGMA_M and TILT_SIGMA_RAD.

    Parameters
    ----------
    times_s : ndarray of shape (n,)
        Seconds since the start.
    poses : ndarray of shape (n, 6)
        The true ones (`Trajectory.poses`).
    rng : numpy.random.Generator
        Draws bias, scale and noise.

    Returns
    -------
    ndarray of shape (n, 6)
        The first one at the origin of the plan, looking along x.

    """
    steps_s = np.diff(times_s)
    bias = rng.choice((-1.0, 1.0)) * rng.uniform(*YAW_BIAS_RAD_S)
    scale = 1.0 + rng.normal(0.0, SCALE_SIGMA)
    turns = np.diff(poses[:, 5]) + bias * steps_s + rng.normal(
        0.0, np.sqrt(STEP_SIGMA_RAD ** 2 + YAW_WALK_RAD_SQRT_S ** 2 * steps_s))
    moves = scale * _turned(np.diff(poses[:, :2], axis=0), -poses[:-1, 5])
    moves += rng.normal(0.0, STEP_SIGMA_M, moves.shape)
    yaw = np.append(0.0, np.cumsum(turns))
    odometry = poses + rng.normal(0.0, 1.0, poses.shape) * (
        0.0, 0.0, HEIGHT_SIGMA_M, TILT_SIGMA_RAD, TILT_SIGMA_RAD, 0.0)
    odometry[0, :2] = 0.0
    odometry[1:, :2] = np.cumsum(_turned(moves, yaw[:-1]), axis=0)
    odometry[:, 5] = yaw
    return odometry


def twists(times_s: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Return forward and left velocity in m/s and yaw rate in rad/s of poses, shape (n, 3)."""
    velocity = np.gradient(poses[:, :2], times_s, axis=0)
    turning = np.gradient(poses[:, 5], times_s)
    return np.column_stack((_turned(velocity, -poses[:, 5]), turning))


def beacons(poses: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return x, y, yaw as ultra-wide-band beacons see them, shape (n, 3): white noise on each."""
    return poses[:, (0, 1, 5)] + rng.normal(0.0, 1.0, (len(poses), 3)) * (
        BEACON_SIGMA_M, BEACON_SIGMA_M, BEACON_SIGMA_RAD)


def _turned(vectors: np.ndarray, angles_rad: np.ndarray) -> np.ndarray:
    c, s = np.cos(angles_rad), np.sin(angles_rad)
    x, y = vectors.T
    return np.stack((c * x - s * y, s * x + c * y), axis=1)
