"""Poses of the map back to the autopilot, as MAVLink's ODOMETRY of a vision system."""

from __future__ import annotations

from collections import Counter, deque
from math import hypot, isfinite, nan
from typing import Callable

from .framing import dialect
from ...config import Config
from ...core.geometry import (
    between, compose, euler_to_quaternion, swap_frd_flu, swap_frd_flu_attitude)
from ...core.types import PoseEstimate

# Where the variances of x, y, z, roll, pitch and yaw stand in the upper triangle, row by row.
DIAGONAL = (0, 6, 11, 15, 18, 20)
# Without codes for longer, a pose is no more than the autopilot's own odometry.
MAX_SILENCE_S = 1.0
MAX_SILENT_PERIODS = 3


class VisionOutput:
    """
    Sends poses at a set rate, and none while the map does not say where the robot is.

    The reset counter steps with every closure made or taken back, where poses go on after they
    were withheld, and where else the map moved the pose by more than the deviation of a match,
    at once or little by little: an estimator must not take that for motion.
    """

    def __init__(self, config: Config, send: Callable[[dialect.MAVLink_message], None]):
        self._send = send
        self._period_ns = int(1e9 / config.mavlink.vision_rate_hz)
        self._patience_ns = int(1e9 * max(
            MAX_SILENCE_S, MAX_SILENT_PERIODS * config.ratslam.sample_period_s))
        self._match_sigma_m = config.ratslam.match_position_sigma_m
        self._match_sigma_rad = config.ratslam.match_yaw_sigma_rad
        self._due_ns = 0
        self._code_ns: int | None = None
        self._n_closures = 0
        self._steps_ns: deque[int] = deque()
        self._is_withheld = False
        self._reset_counter = 0
        # Of the last step.
        self._reference: PoseEstimate | None = None
        self.counts: Counter[str] = Counter()

    def map_updated(self, stamp_ns: int, n_closures: int) -> None:
        """Take in that a code of that stamp was used, and how many closures there are now."""
        self._code_ns = stamp_ns
        if n_closures != self._n_closures:
            self._n_closures = n_closures
            self._steps_ns.append(stamp_ns)  # poses before it are still of the map as it was

    def offer(self, estimate: PoseEstimate) -> None:
        """Send an estimate, if one is due and it may be sent."""
        while self._steps_ns and self._steps_ns[0] <= estimate.stamp_ns:
            self._steps_ns.popleft()
            self._step(estimate)
        late_ns = estimate.stamp_ns - self._due_ns
        if -self._period_ns <= late_ns < 0:
            return
        self._due_ns = estimate.stamp_ns + self._period_ns - late_ns % self._period_ns
        if not self._is_localised(estimate):
            self._is_withheld = True
            self.counts['vision_withheld'] += 1
            return
        if self._is_withheld or self._has_moved(estimate):
            self._step(estimate)
        self._is_withheld = False
        self._send(vision_message(estimate, self._reset_counter % 256, self._match_sigma_m))
        self.counts['vision_sent'] += 1

    def _step(self, estimate: PoseEstimate) -> None:
        self._reset_counter += 1
        self._reference = estimate

    def _has_moved(self, estimate: PoseEstimate) -> bool:
        """Whether the map has moved the pose since the last step."""
        if self._reference is None:
            self._reference = estimate
        flown = between(self._reference.track, estimate.track)
        shift = between(compose(self._reference.pose, flown), estimate.pose)
        return (hypot(shift.x_m, shift.y_m) > self._match_sigma_m
                or abs(shift.yaw_rad) > self._match_sigma_rad)

    def _is_localised(self, estimate: PoseEstimate) -> bool:
        """Whether odometry has not broken since the last closure, and the camera is heard."""
        return (isfinite(estimate.position_sigma_m) and isfinite(estimate.yaw_sigma_rad)
                and self._code_ns is not None
                and estimate.stamp_ns - self._code_ns <= self._patience_ns)


def vision_message(estimate: PoseEstimate, reset_counter: int, best_sigma_m: float
                   ) -> dialect.MAVLink_odometry_message:
    """
    Return an estimate in LOCAL_FRD, which has the origin and the heading of the map.

    The quality is 100 down to the deviation of a match, and falls as the deviation grows. Height,
    roll and pitch are passed through from odometry. They are given the variances of position and
    heading, as some autopilots take one figure for all three; they are not worth fusing.
    """
    odometry, variances = estimate.odometry, [0.0] * 21
    for k, index in enumerate(DIAGONAL):
        variances[index] = (estimate.position_sigma_m if k < 3 else estimate.yaw_sigma_rad) ** 2
    quality = 100 * best_sigma_m / max(estimate.position_sigma_m, best_sigma_m)
    x, y, z, w = euler_to_quaternion(*swap_frd_flu_attitude(
        odometry.roll_rad, odometry.pitch_rad, estimate.pose.yaw_rad))
    return dialect.MAVLink_odometry_message(
        estimate.stamp_ns // 1000, dialect.MAV_FRAME_LOCAL_FRD, dialect.MAV_FRAME_BODY_FRD,
        *swap_frd_flu(estimate.pose.x_m, estimate.pose.y_m, odometry.z_m), [w, x, y, z],
        nan, nan, nan, nan, nan, nan, variances, [nan] + [0.0] * 20, reset_counter,
        dialect.MAV_ESTIMATOR_TYPE_VISION, max(1, round(quality)))
