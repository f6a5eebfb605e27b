"""Turns as the views tell them, to take the error of its yaw rate out of the odometry."""

from __future__ import annotations

import numpy as np

from ..config import Config
from ..core.drift import rectified_motion, seconds_in_motion
from ..core.geometry import between
from ..core.types import OdometrySample, Pose2
from ..core.visual_turn import prepare, shift_between
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

    def __init__(self, config: Config):
        self.error = YawRateError(config.odometry)
        self._view: np.ndarray | None = None
        self._odometry: OdometrySample | None = None
        self.reconfigure(config)

    def reconfigure(self, config: Config) -> None:
        """Go on with other values of `live` parameters."""
        self._config = config.odometry
        self.error.reconfigure(config.odometry)
        self._is_on = config.odometry.visual_gyro and config.ratslam.backend != 'published'

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
        told = shift_between(
            before, self._view, (motion.x_m, motion.y_m, climb), motion.yaw_rad,
            nominal_px / self.error.scale)
        if told is not None:
            shift_px, sigma_px = told
            self.error.update(
                motion.yaw_rad, shift_px / nominal_px, sigma_px / nominal_px, seconds)

    def yaw_noise(self) -> float:
        """Return what noise of the odometry, in rad/sqrt(s), is believed."""
        return self.error.yaw_noise() if self._is_on else self._config.yaw_noise

    def corrected(self, motion: Pose2, seconds: float) -> Pose2:
        """Return a motion by odometry, of so many seconds, less the error of its yaw rate."""
        if not self._is_on:
            return motion
        turn_rad = self.error.rad_s() * seconds_in_motion(motion, seconds)
        return rectified_motion(motion, turn_rad, 0.0)
