"""Where the robot is by odometry alone, and less the constant errors that closures tell."""

from __future__ import annotations

from math import hypot

import numpy as np

from ..core.drift import rectified, rectified_motion, seconds_in_motion
from ..core.geometry import between, compose
from ..core.types import IDENTITY, Pose2, Track

# No odometry errs by more than this: in rad/s, and as a share of what it tells.
MAX_ERRORS = np.array([100.0, 0.9])


class DeadReckoning:
    """
    The odometry of the flight, segment by segment.

    Attributes
    ----------
    here : Pose2
        The robot's pose by odometry alone, less the error that views tell.
    flown : ndarray of shape (3,)
        The seconds in motion, metres and breaks of odometry up to here.
    since : Pose2
        Where the robot is in the frame that it set out from: the motion since then is calibrated.
    errors : ndarray of shape (n_segments, 2)
        Of the yaw rate, in rad/s, and of the scale, of the segments between breaks; 0 of those
        after the last one.

    """

    def __init__(self):
        self.here = self.since = IDENTITY
        self.flown = np.zeros(3)
        self.errors = np.zeros((0, 2))
        # Where and when the robot set out, and where it was then by odometry alone.
        self._start, self._start_here, self._start_s = IDENTITY, IDENTITY, 0.0

    def state(self) -> dict[str, np.ndarray]:
        """Return what `restore` takes, by the names in `map_state.ARRAYS`."""
        return {
            'robot_track': np.array(self.here), 'robot_flown': self.flown.copy(),
            'robot_start': np.array([*self._start, *self._start_here, self._start_s]),
            'odometry_errors': self.errors.copy()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on from what `state` returned."""
        self.here = Pose2(*state['robot_track'].tolist())
        self.flown = state['robot_flown'].copy()
        *numbers, self._start_s = state['robot_start'].tolist()
        self._start, self._start_here = Pose2(*numbers[:3]), Pose2(*numbers[3:])
        self.calibrate(state['odometry_errors'])

    def track(self) -> Track:
        """Return where the robot is by odometry alone."""
        return Track(self.here, *self.flown[:2].tolist())

    def move(self, motion: Pose2, seconds: float) -> None:
        """Carry the robot along."""
        self.here = compose(self.here, motion)
        self.flown = self.flown + (
            seconds_in_motion(motion, seconds), hypot(motion.x_m, motion.y_m), 0.0)
        self._go_on()

    def cut(self) -> None:
        """Let another segment begin."""
        self.halt()
        self.flown = self.flown + (0.0, 0.0, 1.0)

    def set_out(self, pose: Pose2) -> None:
        """Let the robot set out from here, at a pose in any frame."""
        self.since = self._start = pose
        self._start_here, self._start_s = self.here, float(self.flown[0])

    def halt(self) -> None:
        """Take the way so far as it is: what is yet to come may turn on it."""
        self.set_out(self.since)

    def calibrate(self, errors: np.ndarray) -> None:
        """Go on with other errors of yaw rate and scale, (n_segments, 2)."""
        self.errors = np.clip(errors, -MAX_ERRORS, MAX_ERRORS)
        self._go_on()

    def calibrated(self, motions: np.ndarray, seconds: np.ndarray, segments: np.ndarray
                   ) -> np.ndarray:
        """Return motions of the odometry, (n, 3), less its errors."""
        errors = np.vstack([self.errors, np.zeros(2)])
        yaw_rate, scale = errors[np.minimum(segments.astype(int), len(errors) - 1)].T
        return rectified(motions, seconds * yaw_rate, scale)

    def calibrated_here(self, motion: Pose2, seconds: float) -> Pose2:
        """Return a motion of the odometry of this segment, less its errors."""
        segment = int(self.flown[2])
        if segment >= len(self.errors):
            return motion
        yaw_rate, scale = self.errors[segment].tolist()
        return rectified_motion(motion, seconds * yaw_rate, scale)

    def _go_on(self) -> None:
        self.since = compose(self._start, self.calibrated_here(
            between(self._start_here, self.here), float(self.flown[0]) - self._start_s))
