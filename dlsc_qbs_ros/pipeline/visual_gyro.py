"""Turns as the views tell them, to take the error of its yaw rate out of the odometry."""

from __future__ import annotations

import numpy as np

from ..config import Config
from ..core.drift import rectified_motion, seconds_in_motion
from ..core.geometry import between, wrap_angle
from ..core.types import OdometrySample, Pose2
from ..core.visual_turn import prepare, shift_between, turns_along
from ..core.yaw_rate import YawRateError


class VisualGyro:
    """
    Compares each view with the one before, and the odometry between them with both.

    The camera looks ahead. Its lens is learned from the turns.

    Attributes
    ----------
    error : YawRateError
        Of this odometry.

    """

    # From one view to the next.
    LONGEST_S, LONGEST_M = 0.5, 1.0
    # Of a lens of 71 degrees.
    NOMINAL_FOCAL = 0.7
    # After such a turn, what is seen is to have turned along; not so many times on end, and it is
    # no scene.
    PROOF_RAD, MOST_FAILURES = 0.15, 3

    def __init__(self, config: Config):
        self.error = YawRateError(config.odometry)
        self._view: np.ndarray | None = None
        self._odometry: OdometrySample | None = None
        self._failures = 0
        self.reconfigure(config)

    def reconfigure(self, config: Config) -> None:
        """Go on with other values of `live` parameters."""
        self._config = config.odometry
        self.error.reconfigure(config.odometry)
        self._is_on = config.odometry.visual_gyro and config.ratslam.backend != 'published'
        self._begin()

    def restart(self) -> None:
        """Begin with another odometry; the camera stays."""
        self.error.restart()
        self._begin()

    def restore(self, state: np.ndarray) -> None:
        """Go on from what `error.state()` returned."""
        self.error.restore(state)
        self._begin()

    def _begin(self) -> None:
        # What was seen, and the odometry, when it last was to have turned along, and what was
        # known of the error when it last had.
        self._proof: tuple[np.ndarray, OdometrySample] | None = None
        self._known = self.error.state()

    def look(self, view: np.ndarray, odometry: OdometrySample) -> None:
        """Take in a view (height, width), uint8, and the odometry at its stamp."""
        if not self._is_on:
            return
        last, before = self._odometry, self._view
        self._odometry, self._view = odometry, prepare(view)
        if last is None or last.segment != odometry.segment:
            return
        seconds = (odometry.stamp_ns - last.stamp_ns) * 1e-9
        self.error.age(max(seconds, 0.0))
        motion = between(last.pose, odometry.pose)
        climb = odometry.z_m - last.z_m
        is_near = (0.0 < seconds_in_motion(motion, seconds) <= self.LONGEST_S
                   and max(map(abs, (motion.x_m, motion.y_m, climb))) <= self.LONGEST_M)
        if before is None or self._view is None or not is_near:
            return
        nominal_px = self.NOMINAL_FOCAL * before.shape[1]
        focal_px = nominal_px / self.error.scale
        if not self._sees_a_scene(focal_px):
            return
        told = shift_between(
            before, self._view, (motion.x_m, motion.y_m, climb), motion.yaw_rad, focal_px)
        if told is not None:
            shift_px, sigma_px = told
            self.error.update(
                motion.yaw_rad, shift_px / nominal_px, sigma_px / nominal_px, seconds)

    def _sees_a_scene(self, focal_px: float) -> bool:
        """Return whether what is seen turns along with odometry; forget what was told if not."""
        view, odometry = self._proof = self._proof or (self._view, self._odometry)
        turn_rad = wrap_angle(self._odometry.pose.yaw_rad - odometry.pose.yaw_rad)
        if abs(turn_rad) > self.PROOF_RAD:
            self._proof = self._view, self._odometry
            told = turns_along(view, self._view, focal_px * turn_rad)
            if told:
                self._failures, self._known = 0, self.error.state()
            elif told is not None:
                self._failures += 1
                if self._failures == self.MOST_FAILURES:
                    self.error.restore(self._known)
        return self._failures < self.MOST_FAILURES

    def yaw_noise(self) -> float:
        """Return what noise of the odometry, in rad/sqrt(s), is believed."""
        return self.error.yaw_noise() if self._is_on else self._config.yaw_noise

    def corrected(self, motion: Pose2, seconds: float) -> Pose2:
        """Return a motion by odometry, of so many seconds, less the error of its yaw rate."""
        if not self._is_on:
            return motion
        turn_rad = self.error.rad_s() * seconds_in_motion(motion, seconds)
        return rectified_motion(motion, turn_rad, 0.0)
