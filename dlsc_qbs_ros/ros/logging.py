"""Standard logging, which everything below `ros` uses, forwarded to a node's logger."""

from __future__ import annotations

import logging

from rclpy.node import Node


def forward_logging(node: Node) -> None:
    """Send what this package logs, information and above, to the node's logger."""
    logger = logging.getLogger(__package__.partition('.')[0])
    logger.setLevel(logging.INFO)
    logger.propagate = False
    logger.handlers = [_NodeHandler(node.get_logger())]


class _NodeHandler(logging.Handler):

    def __init__(self, ros_logger):
        super().__init__()
        self._logger = ros_logger

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        if record.levelno >= logging.ERROR:  # rclpy wants one source line per severity
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        else:
            self._logger.info(text)
