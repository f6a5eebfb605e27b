"""The map → messages: paths, markers and transforms."""

from __future__ import annotations

import struct

from geometry_msgs.msg import Point, PoseStamped, Quaternion, TransformStamped
from nav_msgs.msg import Path
import numpy as np
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from .serialization import serialize
from .stamps import ns_to_stamp
from ..core.geometry import euler_to_quaternion
from ..core.types import Pose2

try:  # not part of every minimal installation
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None

_EXPERIENCE_COLOUR = ColorRGBA(r=0.1, g=0.6, b=1.0, a=1.0)
_LINK_COLOUR = ColorRGBA(r=0.6, g=0.6, b=0.6, a=1.0)
_CLOSURE_COLOUR = ColorRGBA(r=1.0, g=0.3, b=0.1, a=1.0)


# What stands in a message for the x of a point, until the points of the map take its place.
_STAND_INS = 1e-300, 2e-300, 3e-300
_POSE_BYTES = 7 * 8


def path_to_cdr(stamp_ns: int, experiences: np.ndarray, frame_id: str) -> bytes:
    """
    Return experiences, an ndarray of shape (m, 3) of x, y in metres and yaw, as a nav_msgs/Path.

    It comes as CDR: made message by message, a large map would take a second. rclpy writes two
    poses, and the bytes of the second are repeated.
    """
    header = _header(stamp_ns, frame_id)
    empty = serialize(Path(header=header))
    if not len(experiences):
        return empty
    poses = [PoseStamped(header=header), PoseStamped(header=header)]
    for pose, stand_in in zip(poses, _STAND_INS):
        pose.pose.position.x = stand_in
    data = serialize(Path(header=header, poses=poses))
    first, second = (data.index(struct.pack('<d', x)) + _POSE_BYTES for x in _STAND_INS[:2])
    records = np.tile(np.frombuffer(data[first:second], np.uint8), (len(experiences), 1))
    x, y, yaw = experiences.T
    zero = np.zeros_like(x)
    numbers = np.column_stack([x, y, zero, zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)])
    records[:, -_POSE_BYTES:] = numbers.astype('<f8').view(np.uint8)
    start = first - _POSE_BYTES
    return b''.join([empty[:-4], struct.pack('<I', len(experiences)), data[len(empty):start],
                     records.ravel()[len(data[first:second]) - _POSE_BYTES:].tobytes()])


def experience_map_to_cdr(stamp_ns: int, experiences: np.ndarray, links: np.ndarray,
                          closures: np.ndarray, frame_id: str) -> bytes:
    """
    Return the map as three markers, one per namespace, in a visualization_msgs/MarkerArray.

    The namespace `experiences` holds spheres at x, y of the ndarray `experiences` of shape (m, 3);
    `links` and `closures` hold lines between those that the int ndarrays of shapes (l, 2) and
    (c, 2) name by index. It comes as CDR, see `path_to_cdr`.
    """
    points = np.column_stack([experiences[:, :2], np.zeros(len(experiences))])
    drawn = points, points[links.ravel()], points[closures.ravel()]
    stand_ins = [[Point(x=x)] if len(of) else [] for x, of in zip(_STAND_INS, drawn)]
    markers = [
        _marker('experiences', Marker.SPHERE_LIST, 0.15, _EXPERIENCE_COLOUR, stand_ins[0]),
        _marker('links', Marker.LINE_LIST, 0.03, _LINK_COLOUR, stand_ins[1]),
        _marker('closures', Marker.LINE_LIST, 0.06, _CLOSURE_COLOUR, stand_ins[2])]
    for marker in markers:
        marker.header = _header(stamp_ns, frame_id)
    data = serialize(MarkerArray(markers=markers))
    for stand_in, of in zip(_STAND_INS, drawn):
        if len(of):
            data = _with_points(data, stand_in, of)
    return data


def _with_points(data: bytes, stand_in: float, points: np.ndarray) -> bytes:
    """Put points (n, 3) in the place of the one that stands for them."""
    start = data.index(struct.pack('<d', stand_in))
    # Their number lies right before: from the pose on, a Marker is aligned without a gap there.
    return b''.join([data[:start - 4], struct.pack('<I', len(points)),
                     points.astype('<f8').tobytes(), data[start + 24:]])


def transform_to_msg(stamp_ns: int, parent_T_child: Pose2, frame_id: str, child_frame_id: str):
    """Return a TFMessage with one planar transform; only where `TFMessage` is not None."""
    stamped = TransformStamped(child_frame_id=child_frame_id)
    stamped.header.stamp = ns_to_stamp(stamp_ns)
    stamped.header.frame_id = frame_id
    stamped.transform.translation.x = float(parent_T_child.x_m)
    stamped.transform.translation.y = float(parent_T_child.y_m)
    stamped.transform.rotation = _quaternion(parent_T_child.yaw_rad)
    return TFMessage(transforms=[stamped])


def _marker(namespace: str, kind: int, width_m: float, colour: ColorRGBA, points: list[Point]
            ) -> Marker:
    """Return a marker of points; one without points takes an earlier one off the display."""
    msg = Marker(ns=namespace, type=kind, color=colour, points=points,
                 action=Marker.ADD if points else Marker.DELETE)
    msg.scale.x = msg.scale.y = msg.scale.z = width_m
    msg.pose.orientation.w = 1.0
    return msg


def _header(stamp_ns: int, frame_id: str) -> Header:
    return Header(stamp=ns_to_stamp(stamp_ns), frame_id=frame_id)


def _quaternion(yaw_rad: float) -> Quaternion:
    x, y, z, w = euler_to_quaternion(0.0, 0.0, yaw_rad)
    return Quaternion(x=x, y=y, z=z, w=w)
