"""What people look at to see the encoder learn: scalars and atoms → messages."""

from __future__ import annotations

from typing import Mapping

import numpy as np
from sensor_msgs.msg import Image, JointState

from .image_conversions import image_to_msg
from .stamps import ns_to_stamp
from ..core.mosaic import mosaic


TILE_PX = 32


def scalars_to_msg(stamp_ns: int, values: Mapping[str, float]) -> JointState:
    """
    Return named scalars as a joint state, the one stock type of a stamp and numbers with names.

    The types of std_msgs have no stamp: tools would plot their values by the time of arrival, in
    a replay years away from the poses. PlotJuggler shows TOPIC/NAME/position, by name, Foxglove
    TOPIC.position[INDEX], both by the header's stamp if told to.
    """
    msg = JointState(name=list(values), position=list(map(float, values.values())))
    msg.header.stamp = ns_to_stamp(stamp_ns)
    return msg


def atoms_to_msg(stamp_ns: int, atoms: np.ndarray, height: int, width: int) -> Image:
    """Return atoms, of shape (n_atoms, height * width), as tiles of one mono8 image."""
    zoom = max(TILE_PX // max(height, width), 1)  # those of patches would be hard to see
    picture = mosaic(atoms, height, width).repeat(zoom, axis=0).repeat(zoom, axis=1)
    return image_to_msg(stamp_ns, picture, 'mono8', '')
