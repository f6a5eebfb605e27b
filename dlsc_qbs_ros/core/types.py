"""What passes between the parts: stamped, immutable values without any ROS type."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class Pose2(NamedTuple):
    """A planar pose: the frame's origin in metres and its heading in radians (REP-103)."""

    x_m: float
    y_m: float
    yaw_rad: float


IDENTITY = Pose2(0.0, 0.0, 0.0)


class Track(NamedTuple):
    """Where the robot is by odometry alone, and how long it took to come there."""

    pose: Pose2
    seconds: float
    metres: float


@dataclass(frozen=True)
class Frame:
    """A camera frame: `grey` is a uint8 ndarray of shape (height, width)."""

    stamp_ns: int
    grey: np.ndarray


@dataclass(frozen=True)
class OdometrySample:
    """
    One pose of the odometry, normalised at the border to ENU/FLU.

    `segment` changes when the estimator was reset, rebooted or jumped in time; no increment is
    ever taken between samples of two segments.
    """

    stamp_ns: int
    pose: Pose2
    z_m: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    segment: int = 0


@dataclass(frozen=True)
class RawOdometry:
    """
    An odometry message as it came: its pose, and its twist in the body frame (FLU).

    The twist is NaN where the source gave none.
    """

    sample: OdometrySample
    forward_m_s: float
    left_m_s: float
    yaw_rate_rad_s: float


@dataclass(frozen=True)
class GroundTruthSample:
    """The true planar pose at one stamp."""

    stamp_ns: int
    pose: Pose2


@dataclass(frozen=True)
class Dictionary:
    """
    A dictionary snapshot: `atoms` is a float32 ndarray of shape (n_atoms, n_inputs).

    `stamp_ns` is the stamp of the first frame whose code refers to it, and its name.
    """

    stamp_ns: int
    atoms: np.ndarray


@dataclass(frozen=True)
class Code:
    """
    The latent code of a frame: `values` is a float32 ndarray of shape (n_values,).

    `dictionary_ns` names the dictionary the code is expressed in (`Dictionary.stamp_ns`), or is
    None when the code comes from a live dictionary that nobody else can see.
    """

    stamp_ns: int
    values: np.ndarray
    dictionary_ns: int | None


@dataclass(frozen=True)
class View:
    """The view a code was made of: `pixels` is a uint8 ndarray of shape (height, width)."""

    stamp_ns: int
    pixels: np.ndarray


@dataclass(frozen=True)
class PoseEstimate:
    """
    The pose in the map frame for one odometry sample, and the map_T_odom that gave it.

    `track` is where the robot came by odometry, from anywhere, less what is known of its error.
    """

    stamp_ns: int
    pose: Pose2
    odometry: OdometrySample
    map_T_odom: Pose2
    track: Pose2
    position_sigma_m: float
    yaw_sigma_rad: float
