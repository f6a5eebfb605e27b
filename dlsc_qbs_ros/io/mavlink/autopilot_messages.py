"""A sample of odometry as the MAVLink messages by which autopilots tell it."""

from __future__ import annotations

from math import cos, nan, sin
from typing import Callable

from .framing import dialect
from ...core.geometry import euler_to_quaternion, swap_ned_enu, swap_ned_enu_attitude
from ...core.types import OdometrySample, RawOdometry

# From a sample and the nanoseconds since boot that it is of.
Encoder = Callable[[RawOdometry, int], dialect.MAVLink_message]
UNKNOWN = [nan] + [0.0] * 20


def odometry(raw: RawOdometry, boot_ns: int) -> dialect.MAVLink_odometry_message:
    """Return pose in NED and twist of the body in one message, as PX4 does."""
    return dialect.MAVLink_odometry_message(
        boot_ns // 1000, dialect.MAV_FRAME_LOCAL_NED, dialect.MAV_FRAME_BODY_FRD,
        *_position(raw.sample), _quaternion(raw.sample), raw.forward_m_s, -raw.left_m_s, nan,
        nan, nan, -raw.yaw_rate_rad_s, UNKNOWN, UNKNOWN, raw.sample.segment % 256,
        dialect.MAV_ESTIMATOR_TYPE_AUTOPILOT)


def local_position_ned(raw: RawOdometry, boot_ns: int
                       ) -> dialect.MAVLink_local_position_ned_message:
    """Return position and velocity in NED."""
    yaw_rad = raw.sample.pose.yaw_rad
    east_m_s = cos(yaw_rad) * raw.forward_m_s - sin(yaw_rad) * raw.left_m_s
    north_m_s = sin(yaw_rad) * raw.forward_m_s + cos(yaw_rad) * raw.left_m_s
    return dialect.MAVLink_local_position_ned_message(
        _milliseconds(boot_ns), *_position(raw.sample), north_m_s, east_m_s, nan)


def attitude(raw: RawOdometry, boot_ns: int) -> dialect.MAVLink_attitude_message:
    """Return the attitude in NED as angles."""
    return dialect.MAVLink_attitude_message(
        _milliseconds(boot_ns), *_attitude(raw.sample), nan, nan, -raw.yaw_rate_rad_s)


def attitude_quaternion(raw: RawOdometry, boot_ns: int
                        ) -> dialect.MAVLink_attitude_quaternion_message:
    """Return the attitude in NED as a quaternion."""
    return dialect.MAVLink_attitude_quaternion_message(
        _milliseconds(boot_ns), *_quaternion(raw.sample), nan, nan, -raw.yaw_rate_rad_s)


# The two ways in which autopilots tell where they are, by the names of the messages.
ENCODERS: dict[str, dict[str, Encoder]] = {
    'odometry': {'ODOMETRY': odometry},
    'position': {'LOCAL_POSITION_NED': local_position_ned, 'ATTITUDE': attitude,
                 'ATTITUDE_QUATERNION': attitude_quaternion},
}


def _milliseconds(boot_ns: int) -> int:
    return boot_ns // 1_000_000 % 2**32


def _position(sample: OdometrySample) -> tuple[float, float, float]:
    return swap_ned_enu(sample.pose.x_m, sample.pose.y_m, sample.z_m)


def _attitude(sample: OdometrySample) -> tuple[float, float, float]:
    return swap_ned_enu_attitude(sample.roll_rad, sample.pitch_rad, sample.pose.yaw_rad)


def _quaternion(sample: OdometrySample) -> list[float]:
    """Return the attitude as MAVLink has it: w first."""
    x, y, z, w = euler_to_quaternion(*_attitude(sample))
    return [w, x, y, z]
