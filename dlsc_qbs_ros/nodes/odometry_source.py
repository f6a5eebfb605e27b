"""Which odometry source a node gets, and whether poses go back to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.node import Node

from .odometry_topic import OdometryTopic
from ..config import Config
from ..errors import ConfigError
from ..pipeline.odometry import OdometrySource

if TYPE_CHECKING:
    from ..io.mavlink.vision import VisionOutput


def create_odometry_source(node: Node, config: Config) -> OdometrySource:
    """Return the source that `odometry.source` names; raise ConfigError where it cannot be."""
    if config.odometry.source == 'nav_msgs':
        return OdometryTopic(node, config.odometry)
    try:
        from .odometry_link import OdometryLink
    except ImportError as error:
        if error.name.partition('.')[0] != 'pymavlink':
            raise
        raise ConfigError("odometry.source = 'mavlink': needs pymavlink, which is not "
                          'installed') from error
    return OdometryLink(node, config)


def create_vision_output(source: OdometrySource, config: Config) -> VisionOutput | None:
    """Return what sends poses back over the source's link, where it is to; or None."""
    if not config.mavlink.vision_output:
        return None
    if config.odometry.source != 'mavlink':
        raise ConfigError(f'mavlink.vision_output = True: odometry.source = '
                          f'{config.odometry.source!r} has no link; expected mavlink')
    from ..io.mavlink.vision import VisionOutput
    return VisionOutput(config, source.send)
