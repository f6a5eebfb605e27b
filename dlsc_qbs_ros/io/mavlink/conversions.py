"""One MAVLink message, or a position with its attitude → odometry in ENU/FLU."""

from __future__ import annotations

from math import cos, hypot, isfinite, nan, pi, sin, sqrt
from typing import Callable, NamedTuple

from .framing import dialect
from ...core.geometry import (
    quaternion_to_euler, swap_frd_flu, swap_frd_flu_attitude, swap_ned_enu, swap_ned_enu_attitude,
    wrap_angle)
from ...core.types import OdometrySample, Pose2, RawOdometry

FAILED_QUALITY = -1


class _LocalFrame(NamedTuple):
    """How axes and attitudes turn into those with z up, and whether z points down before."""

    swap: Callable
    swap_attitude: Callable
    is_down: bool


def _same(*values):
    return values


_LOCAL_FRAMES = {
    dialect.MAV_FRAME_LOCAL_NED: _LocalFrame(swap_ned_enu, swap_ned_enu_attitude, True),
    dialect.MAV_FRAME_LOCAL_FRD: _LocalFrame(swap_frd_flu, swap_frd_flu_attitude, True),
    dialect.MAV_FRAME_LOCAL_ENU: _LocalFrame(_same, _same, False),
    dialect.MAV_FRAME_LOCAL_FLU: _LocalFrame(_same, _same, False),
}
# 13 was BODY_FLU; the standard has withdrawn it, but it is still sent.
_BODY_IS_DOWN = {dialect.MAV_FRAME_BODY_FRD: True, dialect.MAV_FRAME_BODY_NED: True, 13: False}


class Attitude(NamedTuple):
    """Attitude of the FRD body in NED, and its yaw rate, at a time of the autopilot."""

    remote_ns: int
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    yaw_rate_rad_s: float


def remote_time_ns(message: dialect.MAVLink_message) -> int:
    """Return the autopilot's time of a message: since its boot, or UNIX time."""
    if hasattr(message, 'time_usec'):
        return message.time_usec * 1000
    return message.time_boot_ms * 1_000_000


def refusal(message: dialect.MAVLink_odometry_message) -> str | None:
    """Return why an ODOMETRY message gives no pose, if so."""
    if message.frame_id not in _LOCAL_FRAMES or (
            message.child_frame_id not in _LOCAL_FRAMES.keys() | _BODY_IS_DOWN.keys()):
        return 'odometry_in_unknown_frame'
    if message.quality == FAILED_QUALITY:
        return 'odometry_failed'
    if not all(map(isfinite, (message.x, message.y, message.z, *message.q))) or (
            hypot(*message.q) < 1e-6):
        return 'odometry_malformed'
    return None


def odometry_from_message(message: dialect.MAVLink_odometry_message, stamp_ns: int, segment: int
                          ) -> RawOdometry:
    """
    Return the odometry of an ODOMETRY message that `refusal` lets pass.

    `q` turns the body, FRD or FLU as the child frame or else the local frame says, into the local
    frame; the child frame is that of the twist.
    """
    frame, child = _LOCAL_FRAMES[message.frame_id], message.child_frame_id
    w, x, y, z = (value / hypot(*message.q) for value in message.q)
    roll, pitch, yaw = quaternion_to_euler(x, y, z, w)
    if _BODY_IS_DOWN.get(child, frame.is_down) != frame.is_down:
        roll = wrap_angle(roll + pi)  # the same body with its y and z the other way round
    attitude = frame.swap_attitude(roll, pitch, yaw)
    position = frame.swap(message.x, message.y, message.z)
    twist = _twist(message, attitude[2])
    return _raw(stamp_ns, segment, position, attitude, twist)


def joined_odometry(stamp_ns: int, segment: int, ned_m: tuple, ned_m_s: tuple,
                    attitude: Attitude) -> RawOdometry:
    """Return position and velocity in NED with the attitude at their time as odometry."""
    attitude_enu = swap_ned_enu_attitude(*attitude[1:4])
    forward, left = _along(swap_ned_enu(*ned_m_s), attitude_enu[2])
    return _raw(stamp_ns, segment, swap_ned_enu(*ned_m), attitude_enu,
                (forward, left, -attitude.yaw_rate_rad_s))


def attitude_from_message(message: dialect.MAVLink_message) -> Attitude | None:
    """Return what ATTITUDE or ATTITUDE_QUATERNION tells, None where it is not finite."""
    if message.get_type() == 'ATTITUDE':
        euler = message.roll, message.pitch, message.yaw
    else:
        q = message.q1, message.q2, message.q3, message.q4
        length = hypot(*q)
        if not isfinite(length) or length < 1e-6:
            return None
        w, x, y, z = (value / length for value in q)
        euler = quaternion_to_euler(x, y, z, w)
    if not all(map(isfinite, euler)):
        return None
    return Attitude(remote_time_ns(message), *euler, message.yawspeed)


def interpolated_attitude(a: Attitude, b: Attitude, remote_ns: int) -> Attitude:
    """Return the attitude at a time between two, every angle the shorter way round."""
    if a.remote_ns == b.remote_ns:
        return a
    fraction = (remote_ns - a.remote_ns) / (b.remote_ns - a.remote_ns)
    angles = (wrap_angle(p + fraction * wrap_angle(q - p)) for p, q in zip(a[1:4], b[1:4]))
    rate = a.yaw_rate_rad_s + fraction * (b.yaw_rate_rad_s - a.yaw_rate_rad_s)
    return Attitude(remote_ns, *angles, rate)


def position_sigma_m(covariance: list[float]) -> float:
    """Return the deviation of x and y together of a pose covariance[21], NaN where unknown."""
    variance = covariance[0] + covariance[6]
    return sqrt(variance) if isfinite(variance) and variance >= 0.0 else nan


def _twist(message, yaw_rad: float) -> tuple[float, float, float]:
    """Return speeds forward and left and the yaw rate, NaN in a frame that the pose is not in."""
    velocity = message.vx, message.vy, message.vz
    child = message.child_frame_id
    if child in _BODY_IS_DOWN:
        is_down = _BODY_IS_DOWN[child]
        forward, left, _ = swap_frd_flu(*velocity) if is_down else velocity
    elif child == message.frame_id:
        is_down = _LOCAL_FRAMES[child].is_down
        forward, left = _along(_LOCAL_FRAMES[child].swap(*velocity), yaw_rad)
    else:
        return nan, nan, nan
    return forward, left, -message.yawspeed if is_down else message.yawspeed


def _along(velocity: tuple, yaw_rad: float) -> tuple[float, float]:
    """Return the horizontal part of a velocity along and across a heading."""
    c, s = cos(yaw_rad), sin(yaw_rad)
    return c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0]


def _raw(stamp_ns, segment, position, attitude, twist) -> RawOdometry:
    x, y, z = position
    roll, pitch, yaw = attitude
    sample = OdometrySample(stamp_ns, Pose2(x, y, yaw), z, roll, pitch, segment)
    return RawOdometry(sample, *(speed if isfinite(speed) else nan for speed in twist))
