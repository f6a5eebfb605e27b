"""The live picture of an encoder: its atoms and how it learns, for whoever looks on."""

from __future__ import annotations

from math import inf
import time

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image, JointState

from ..pipeline.encoder import Encoded, Encoder
from ..ros.learning_conversions import atoms_to_msg, scalars_to_msg
from ..ros.qos import create_publisher, OUTPUT

IMAGE_PERIOD_S = 1.0
# Of a picture of some megabytes only the newest is worth keeping.
IMAGE_OUTPUT = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)


class EncoderScope:
    """Publishes `learning` for each frame and `dictionary_image` now and then, if asked for."""

    def __init__(self, node: Node, encoder: Encoder):
        self._encoder = encoder
        self._image_s = -inf
        self._learning_publisher = create_publisher(node, JointState, 'learning', OUTPUT)
        self._image_publisher = create_publisher(node, Image, 'dictionary_image', IMAGE_OUTPUT)

    def show(self, encoded: Encoded) -> None:
        """Show what the newest frame has done; nothing is built that nobody subscribes to."""
        if self._learning_publisher.get_subscription_count():
            self._learning_publisher.publish(scalars_to_msg(encoded.code.stamp_ns, {
                'reprojection_error': encoded.reprojection_error, 'surprise': encoded.surprise,
                'gate': encoded.learned, 'epoch': encoded.epoch}))
        if self._is_image_due(encoded) and self._image_publisher.get_subscription_count():
            self._image_s = time.monotonic()
            self._image_publisher.publish(atoms_to_msg(
                encoded.code.stamp_ns, self._encoder.atoms, *self._encoder.atom_shape))

    def _is_image_due(self, encoded: Encoded) -> bool:
        """Whether an epoch starts or a second, of wall time as the work is, has passed."""
        return (encoded.dictionary is not None
                or time.monotonic() - self._image_s >= IMAGE_PERIOD_S)
