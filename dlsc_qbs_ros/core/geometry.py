"""Planar rigid motions and angles. Poses are `Pose2` values; a_T_b is the pose of b in a."""

from __future__ import annotations

from math import atan2, cos, pi, sin

import numpy as np

from .types import Pose2

# No place in the world is farther away, and up to here sums of positions are still exact.
LARGEST_M = 1e8


def wrap_angle(angle_rad):
    """Return the angle, a float or an ndarray of any shape, wrapped to [-pi, pi)."""
    return (angle_rad + pi) % (2 * pi) - pi


def compose(a_T_b: Pose2, b_T_c: Pose2) -> Pose2:
    """Return a_T_c, the motion b_T_c carried out after a_T_b."""
    c, s = cos(a_T_b.yaw_rad), sin(a_T_b.yaw_rad)
    return Pose2(
        a_T_b.x_m + c * b_T_c.x_m - s * b_T_c.y_m,
        a_T_b.y_m + s * b_T_c.x_m + c * b_T_c.y_m,
        wrap_angle(a_T_b.yaw_rad + b_T_c.yaw_rad))


def invert(a_T_b: Pose2) -> Pose2:
    """Return b_T_a."""
    c, s = cos(a_T_b.yaw_rad), sin(a_T_b.yaw_rad)
    return Pose2(
        -c * a_T_b.x_m - s * a_T_b.y_m,
        s * a_T_b.x_m - c * a_T_b.y_m,
        wrap_angle(-a_T_b.yaw_rad))


def between(w_T_a: Pose2, w_T_b: Pose2) -> Pose2:
    """Return a_T_b, the motion from a to b."""
    return compose(invert(w_T_a), w_T_b)


def compose_rows(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return poses b, given in the frames of poses a, in the frame of these; both (n, 3)."""
    x, y, turn = b.T
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    return np.column_stack([
        a[:, 0] + c * x - s * y, a[:, 1] + s * x + c * y, wrap_angle(a[:, 2] + turn)])


def between_rows(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return poses b in the frames of poses a; both (n, 3)."""
    dx, dy, turn = (b - a).T
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    return np.column_stack([c * dx + s * dy, c * dy - s * dx, wrap_angle(turn)])


def interpolate(a: Pose2, b: Pose2, fraction: float) -> Pose2:
    """Return the pose at `fraction` of the way from a (0) to b (1), the shorter way round."""
    return Pose2(
        a.x_m + fraction * (b.x_m - a.x_m),
        a.y_m + fraction * (b.y_m - a.y_m),
        wrap_angle(a.yaw_rad + fraction * wrap_angle(b.yaw_rad - a.yaw_rad)))


def quaternion_to_euler(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Return (roll, pitch, yaw) in radians of a unit quaternion, in the order z, y, x."""
    roll = atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    sin_pitch = 2 * (w * y - z * x)
    pitch = float(np.arcsin(np.clip(sin_pitch, -1.0, 1.0)))
    yaw = atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def euler_to_quaternion(roll: float, pitch: float, yaw: float
                        ) -> tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w) of roll, pitch and yaw in radians."""
    cr, sr = cos(roll / 2), sin(roll / 2)
    cp, sp = cos(pitch / 2), sin(pitch / 2)
    cy, sy = cos(yaw / 2), sin(yaw / 2)
    return (sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy)


def swap_ned_enu(x, y, z):
    """
    Return a vector of NED axes in ENU axes, or the other way round.

    By permutation and sign, as a matrix product would spread a NaN over all three.
    """
    return y, x, -z


def swap_frd_flu(x, y, z):
    """Return a vector of FRD axes in FLU axes, or the other way round."""
    return x, -y, -z


def swap_ned_enu_attitude(roll_rad: float, pitch_rad: float, yaw_rad: float
                          ) -> tuple[float, float, float]:
    """Return the attitude of an FRD body in NED as that of the FLU body in ENU, or back."""
    return roll_rad, -pitch_rad, wrap_angle(pi / 2 - yaw_rad)


def swap_frd_flu_attitude(roll_rad: float, pitch_rad: float, yaw_rad: float
                          ) -> tuple[float, float, float]:
    """Return the attitude of an FRD body in FRD axes as that of the FLU body in FLU, or back."""
    return roll_rad, -pitch_rad, wrap_angle(-yaw_rad)
