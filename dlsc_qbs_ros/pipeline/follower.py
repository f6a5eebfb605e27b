"""A pose for every odometry sample: between codes, over breaks, from one run to the next."""

from __future__ import annotations

from copy import copy
from math import hypot, inf

from .mapper import Mapper
from ..config import Config
from ..core.drift import seconds_in_motion
from ..core.geometry import between, compose, invert
from ..core.types import IDENTITY, OdometrySample, Pose2, PoseEstimate


class Follower:
    """
    Carries the mapper's last correction, and the drift since then, along with the odometry.

    Its constant errors, as far as the map has told, are taken out. Where odometry breaks, it
    goes on from the last pose until a code tells better. In a map that was loaded, the first
    odometry is taken for what the map was left with, if it may be that.
    """

    # A node that starts again comes back that soon; an autopilot that does takes longer.
    BRIDGED_S = 30.0
    # It may have flown by so many times its mean speed meanwhile.
    BRIDGED_SPEEDS = 3.0

    def __init__(self, config: Config, mapper: Mapper):
        self._config = config.ratslam
        self._mapper = mapper
        # The newest odometry that has been used, by a code or for a pose, and the drift there.
        self._last = mapper.odometry
        self._drift = copy(mapper.drift)
        self._may_bridge = mapper.odometry is not None
        # A pose, and its deviations, that was told before there was any odometry to go with it.
        self._told: tuple[Pose2, float, float] | None = None
        self._map_T_odom = mapper.map_T_odom() if self._may_bridge else IDENTITY
        self._track = IDENTITY

    def reconfigure(self, config: Config) -> None:
        """Go on with other values of `live` parameters."""
        self._config = config.ratslam
        self._drift.reconfigure(config.odometry)

    @property
    def is_localised(self) -> bool:
        """Whether it is known where in the map the robot is."""
        mapped, last = self._mapper.odometry, self._last
        is_broken = None not in (mapped, last) and mapped.segment != last.segment
        return self._mapper.is_localised and not is_broken

    def put(self, pose: Pose2, position_sigma_m: float, yaw_sigma_rad: float) -> None:
        """Take the robot to be at a pose in the map, known this well, at the newest odometry."""
        if self._may_bridge:
            self._told = pose, position_sigma_m, yaw_sigma_rad
            return
        last, mapper = self._last, self._mapper
        if last is None:
            mapper.put(pose, position_sigma_m, yaw_sigma_rad)
        else:
            if mapper.odometry is None or last.segment != mapper.odometry.segment:
                mapper.carry(last)
            mapper.put(compose(pose, between(last.pose, mapper.odometry.pose)),
                       position_sigma_m, yaw_sigma_rad)
            self._map_T_odom = compose(pose, invert(last.pose))
        self._drift.anchor(position_sigma_m, yaw_sigma_rad)

    def bridge(self, sample: OdometrySample) -> None:
        """Take the first odometry in a loaded map for what it was, where nothing is against it."""
        if not self._may_bridge:
            return
        self._may_bridge, last = False, self._mapper.odometry
        if self._told is not None:
            self._last = sample
            self.put(*self._told)
            return
        seconds = (sample.stamp_ns - last.stamp_ns) * 1e-9
        motion = between(last.pose, sample.pose)
        _, flown_s, flown_m = self._mapper.visits.odometry.track()
        allowed_m = (self._config.keyframe_distance_m
                     + self.BRIDGED_SPEEDS * flown_m * seconds / max(flown_s, 1.0))
        if 0.0 <= seconds <= self.BRIDGED_S and hypot(motion.x_m, motion.y_m) <= allowed_m:
            self._mapper.bridge(sample.segment)
            self._last = self._mapper.odometry

    def correct(self, odometry: OdometrySample) -> None:
        """Take over the mapper's correction, unless odometry has broken since that code."""
        if self._last is None or self._last.stamp_ns <= odometry.stamp_ns:
            self._last = odometry
        if self._last.segment != odometry.segment or self._mapper.place is None:
            return
        self._drift = copy(self._mapper.drift)
        if not self._mapper.is_localised:
            self._drift.anchor(inf, inf)
        here = compose(self._mapper.pose(), self._flown(odometry, self._last))
        self._map_T_odom = compose(here, invert(self._last.pose))

    def follow(self, sample: OdometrySample) -> PoseEstimate:
        """Go on to the next odometry sample and return its pose."""
        self.bridge(sample)
        last, self._last = self._last, sample
        if last is not None:
            self._carry(last, sample)
        return PoseEstimate(
            sample.stamp_ns, compose(self._map_T_odom, sample.pose), sample, self._map_T_odom,
            self._track, *self._mapper.sigmas(self._drift))

    def _carry(self, last: OdometrySample, sample: OdometrySample) -> None:
        """Carry the drift along; where odometry breaks, go on from the last pose."""
        here = compose(self._map_T_odom, last.pose)
        if last.segment == sample.segment and last.stamp_ns <= sample.stamp_ns:
            motion = self._flown(last, sample)
            here, self._track = compose(here, motion), compose(self._track, motion)
        else:
            self._drift.anchor(inf, inf)
        self._map_T_odom = compose(here, invert(sample.pose))

    def _flown(self, last: OdometrySample, sample: OdometrySample) -> Pose2:
        """Carry the drift from one sample to the next; return the motion, less known errors."""
        motion = between(last.pose, sample.pose)
        seconds = (sample.stamp_ns - last.stamp_ns) * 1e-9
        self._drift.move(motion, seconds)
        mapped = self._mapper.odometry
        if mapped is None or mapped.segment != sample.segment:
            return motion
        motion = self._mapper.gyro.corrected(motion, seconds)
        return self._mapper.visits.odometry.calibrated_here(
            motion, seconds_in_motion(motion, seconds))
