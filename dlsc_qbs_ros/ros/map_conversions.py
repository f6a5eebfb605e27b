"""The map → messages: paths, markers and transforms."""

from __future__ import annotations

from geometry_msgs.msg import Point, PoseStamped, Quaternion, TransformStamped
from nav_msgs.msg import Path
import numpy as np
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

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


def path_to_msg(stamp_ns: int, experiences: np.ndarray, frame_id: str) -> Path:
    """Return experiences, an ndarray of shape (m, 3) of x, y in metres and yaw, as a path."""
    msg = Path()
    msg.header.stamp = ns_to_stamp(stamp_ns)
    msg.header.frame_id = frame_id
    for x, y, yaw in experiences.tolist():
        stamped = PoseStamped(header=msg.header)
        stamped.pose.position.x, stamped.pose.position.y = x, y
        stamped.pose.orientation = _quaternion(yaw)
        msg.poses.append(stamped)
    return msg


def experience_map_to_msg(stamp_ns: int, experiences: np.ndarray, links: np.ndarray,
                          closures: np.ndarray, frame_id: str) -> MarkerArray:
    """
    Return the map as three markers, one per namespace.

    The namespace `experiences` holds spheres at x, y of the ndarray `experiences` of shape (m, 3);
    `links` and `closures` hold lines between those that the int ndarrays of shapes (l, 2) and
    (c, 2) name by index.
    """
    points = [Point(x=x, y=y) for x, y in experiences[:, :2].tolist()]
    markers = (
        _marker('experiences', Marker.SPHERE_LIST, 0.15, _EXPERIENCE_COLOUR, points),
        _marker('links', Marker.LINE_LIST, 0.03, _LINK_COLOUR, _ends(points, links)),
        _marker('closures', Marker.LINE_LIST, 0.06, _CLOSURE_COLOUR, _ends(points, closures)))
    for marker in markers:
        marker.header.stamp = ns_to_stamp(stamp_ns)
        marker.header.frame_id = frame_id
    return MarkerArray(markers=list(markers))


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


def _ends(points: list[Point], pairs: np.ndarray) -> list[Point]:
    return [points[index] for index in np.asarray(pairs, int).ravel().tolist()]


def _quaternion(yaw_rad: float) -> Quaternion:
    x, y, z, w = euler_to_quaternion(0.0, 0.0, yaw_rad)
    return Quaternion(x=x, y=y, z=z, w=w)
