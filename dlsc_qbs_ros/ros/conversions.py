"""Poses, odometry, codes, dictionaries and diagnostics: core types ↔ messages."""

from __future__ import annotations

from math import hypot, isfinite, sqrt
import re
from typing import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Pose, PoseStamped, PoseWithCovarianceStamped, Quaternion
from nav_msgs.msg import Odometry
import numpy as np
from sensor_msgs.msg import Image

from .image_conversions import image_to_grey, image_to_msg
from .stamps import ns_to_stamp, stamp_to_ns
from ..core.geometry import euler_to_quaternion, LARGEST_M, quaternion_to_euler
from ..core.types import (
    Code, Dictionary, GroundTruthSample, OdometrySample, Pose2, PoseEstimate, RawOdometry, View)
from ..errors import ImageError, OdometryError

UNMEASURED_VARIANCE = 1e6
_DICTIONARY_FRAME = re.compile(r'dictionary_(-?\d{1,19})', re.ASCII)


def odometry_to_msg(sample: OdometrySample, velocity_m_s: float, yaw_rate_rad_s: float,
                    frame_id: str, child_frame_id: str) -> Odometry:
    """Return an odometry message; the velocity points forward, along the body's x axis."""
    msg = Odometry(child_frame_id=child_frame_id)
    msg.header.stamp = ns_to_stamp(sample.stamp_ns)
    msg.header.frame_id = frame_id
    msg.pose.pose = _pose_to_msg(sample.pose, sample.z_m, sample.roll_rad, sample.pitch_rad)
    msg.twist.twist.linear.x = velocity_m_s
    msg.twist.twist.angular.z = yaw_rate_rad_s
    return msg


def odometry_from_msg(msg: Odometry) -> RawOdometry:
    """
    Return pose and twist of an odometry message.

    Raises
    ------
    OdometryError
        When the pose is not finite, beyond the world or its quaternion has no length.

    """
    pose, z_m, roll, pitch = _pose_from_msg(msg.pose.pose)
    twist = msg.twist.twist
    return RawOdometry(
        OdometrySample(stamp_to_ns(msg.header.stamp), pose, z_m, roll, pitch),
        twist.linear.x, twist.linear.y, twist.angular.z)


def pose_stamped_to_msg(sample: GroundTruthSample, frame_id: str) -> PoseStamped:
    """Return a planar pose as a stamped pose at height 0."""
    msg = PoseStamped(pose=_pose_to_msg(sample.pose))
    msg.header.stamp = ns_to_stamp(sample.stamp_ns)
    msg.header.frame_id = frame_id
    return msg


def pose_stamped_from_msg(msg: PoseStamped | PoseWithCovarianceStamped | Odometry
                          ) -> GroundTruthSample:
    """Return the planar pose; raise OdometryError when it is not finite."""
    pose = getattr(msg.pose, 'pose', msg.pose)
    return GroundTruthSample(stamp_to_ns(msg.header.stamp), _pose_from_msg(pose)[0])


def initial_pose_from_msg(msg: PoseWithCovarianceStamped) -> tuple[Pose2, float, float]:
    """
    Return the planar pose, and its deviations in metres and radians.

    Raises
    ------
    OdometryError
        When the pose is not finite or a variance is none.

    """
    variances = [float(msg.pose.covariance[k]) for k in (0, 7, 35)]
    if not all(0.0 <= variance <= UNMEASURED_VARIANCE for variance in variances):
        raise OdometryError(f'variances of x, y and yaw {variances}: expected values in '
                            f'[0, {UNMEASURED_VARIANCE:g}]')
    x, y, yaw = variances
    return _pose_from_msg(msg.pose.pose)[0], sqrt(max(x, y)), sqrt(yaw)


def pose_to_msg(estimate: PoseEstimate, frame_id: str) -> PoseWithCovarianceStamped:
    """
    Return an estimate with z, roll and pitch of its odometry sample.

    Those three are passed through, not estimated: their variance says `UNMEASURED_VARIANCE`.
    """
    odometry = estimate.odometry
    msg = PoseWithCovarianceStamped()
    msg.header.stamp = ns_to_stamp(estimate.stamp_ns)
    msg.header.frame_id = frame_id
    msg.pose.pose = _pose_to_msg(
        estimate.pose, odometry.z_m, odometry.roll_rad, odometry.pitch_rad)
    unmeasured = UNMEASURED_VARIANCE
    position, yaw = (min(sigma ** 2, unmeasured)
                     for sigma in (estimate.position_sigma_m, estimate.yaw_sigma_rad))
    msg.pose.covariance = np.diag(
        [position, position, unmeasured, unmeasured, unmeasured, yaw]).ravel()
    return msg


def code_to_msg(code: Code) -> Image:
    """Return a code as a 1×D image of 32FC1; its frame_id names the dictionary, if any."""
    frame_id = '' if code.dictionary_ns is None else f'dictionary_{code.dictionary_ns}'
    return image_to_msg(code.stamp_ns, _float32(code.values)[np.newaxis], '32FC1', frame_id)


def code_from_msg(msg: Image) -> Code:
    """Return the code; raise ImageError when the message is not one."""
    values = _floats_from_msg(msg)
    if len(values) != 1:
        raise ImageError(f'code of {len(values)} rows: expected 1')
    return Code(stamp_to_ns(msg.header.stamp), values[0],
                _dictionary_ns(msg) if msg.header.frame_id else None)


def view_to_msg(view: View, frame_id: str = '') -> Image:
    """Return a view as a mono8 image."""
    return image_to_msg(view.stamp_ns, view.pixels, 'mono8', frame_id)


def view_from_msg(msg: Image) -> View:
    """Return the view; raise ImageError when the message is not one."""
    if msg.encoding != 'mono8':
        raise ImageError(f'view with encoding {msg.encoding!r}: expected mono8')
    return View(stamp_to_ns(msg.header.stamp), image_to_grey(msg))


def dictionary_to_msg(dictionary: Dictionary) -> Image:
    """Return a dictionary as an M×N image of 32FC1; its stamp is its name."""
    return image_to_msg(dictionary.stamp_ns, _float32(dictionary.atoms), '32FC1',
                        f'dictionary_{dictionary.stamp_ns}')


def dictionary_from_msg(msg: Image) -> Dictionary:
    """Return the dictionary; raise ImageError when the message is not one."""
    return Dictionary(_dictionary_ns(msg), _floats_from_msg(msg))


def diagnostics_to_msg(stamp_ns: int, name: str, level: bytes, message: str,
                       values: Mapping[str, object]) -> DiagnosticArray:
    """Return one status, levels as in diagnostic_msgs/DiagnosticStatus, as a diagnostic array."""
    status = DiagnosticStatus(level=level, name=name, message=message, values=[
        KeyValue(key=key, value=_text(value)) for key, value in values.items()])
    msg = DiagnosticArray(status=[status])
    msg.header.stamp = ns_to_stamp(stamp_ns)
    return msg


def _text(value: object) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)


def _pose_to_msg(pose: Pose2, z_m: float = 0.0, roll: float = 0.0, pitch: float = 0.0) -> Pose:
    msg = Pose()
    msg.position.x, msg.position.y, msg.position.z = float(pose.x_m), float(pose.y_m), float(z_m)
    x, y, z, w = euler_to_quaternion(roll, pitch, pose.yaw_rad)
    msg.orientation = Quaternion(x=x, y=y, z=z, w=w)
    return msg


def _pose_from_msg(msg: Pose) -> tuple[Pose2, float, float, float]:
    """Return (pose, z in metres, roll and pitch in radians); raise OdometryError."""
    position = (msg.position.x, msg.position.y, msg.position.z)
    q = msg.orientation
    quaternion = (q.x, q.y, q.z, q.w)
    if not all(abs(value) <= LARGEST_M for value in position):
        raise OdometryError(
            f'position {position}: expected finite numbers, none beyond {LARGEST_M:g}')
    length = hypot(*quaternion)
    if not (isfinite(length) and length > 1e-6):
        raise OdometryError(f'quaternion {quaternion}: expected one of length 1')
    roll, pitch, yaw = quaternion_to_euler(*(value / length for value in quaternion))
    return Pose2(position[0], position[1], yaw), position[2], roll, pitch


def _float32(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, np.float32)


def _floats_from_msg(msg: Image) -> np.ndarray:
    """Return a 32FC1 image as a float32 ndarray of shape (rows, columns)."""
    if msg.encoding != '32FC1' or msg.step != 4 * msg.width or msg.width * msg.height == 0:
        raise ImageError(f'{msg.height}×{msg.width} image of {msg.encoding!r} with step '
                         f'{msg.step}: expected packed 32FC1')
    if len(msg.data) != msg.step * msg.height:
        raise ImageError(f'{len(msg.data)} bytes of data: expected {msg.step * msg.height}, '
                         f'{msg.height} rows of {msg.step} bytes')
    order = '>' if msg.is_bigendian else '<'
    values = np.frombuffer(msg.data, f'{order}f4').reshape(msg.height, msg.width)
    if not np.isfinite(values).all():
        raise ImageError('32FC1 image holds values that are not finite')
    return values.astype(np.float32, copy=False)


def _dictionary_ns(msg: Image) -> int:
    match = _DICTIONARY_FRAME.fullmatch(msg.header.frame_id)
    if match is None:
        raise ImageError(f'frame_id {msg.header.frame_id!r}: expected dictionary_<nanoseconds>')
    return int(match[1])
