"""The life of a node's process: start, spin, a clean end on SIGINT and SIGTERM."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
from typing import Callable, Sequence

import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidHandle, ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
import rclpy.utilities

from .managed_node import ManagedNode
from ..errors import ConfigError, DlscQbsError

_WAKE_UP_S = 0.2


class StopRequest:
    """
    SIGINT and SIGTERM as a flag, from construction on.

    rclpy's own handlers invalidate the context at once, so that callbacks under way and the
    teardown raise; with a flag both end in peace, however often a signal comes.
    """

    def __init__(self):
        self.received = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._receive)

    def _receive(self, *_) -> None:
        self.received = True


def run_node(node_class: type[ManagedNode], args: Sequence[str] | None = None) -> int:
    """
    Make a node, start it and spin it until SIGINT or SIGTERM; return the process's exit code.

    An expected error is one line on stderr and exit code 1; an argument that is not one of
    ROS's is exit code 2.
    """
    def work(stop: StopRequest) -> None:
        argv = sys.argv[1:] if args is None else args
        _parser(node_class).parse_args(without_ros_args(argv))
        spin(node_class(), stop)
    return run_ros(work, args)


def run_ros(work: Callable[[StopRequest], None], args: Sequence[str] | None = None) -> int:
    """Run `work` with ROS initialised; return 0, or 1 after one line about an expected error."""
    stop = StopRequest()
    try:
        _initialise(args)
        work(stop)
    except (DlscQbsError, ParameterException) as error:  # rclpy's own: use_sim_time := 3
        print(f'error: {error}', file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()
    return 0


def without_ros_args(argv: Sequence[str]) -> list[str]:
    """Return a command line, without the program's name, less what belongs to ROS."""
    return rclpy.utilities.remove_ros_args(['', *argv])[1:]


def _parser(node_class: type[ManagedNode]) -> argparse.ArgumentParser:
    return argparse.ArgumentParser(
        description=node_class.__doc__,
        epilog='Parameters are given as usual: '
        '--ros-args -p section.name:=value --params-file FILE')


def spin(node: ManagedNode, stop: StopRequest) -> None:
    """Start a node and run its callbacks, one at a time, until a stop is requested; destroy it."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    # Python handles a signal only when the executor comes back from waiting, whatever callback of
    # the node is under way.
    node.create_timer(_WAKE_UP_S, lambda: None, MutuallyExclusiveCallbackGroup(),
                      Clock(clock_type=ClockType.STEADY_TIME))
    try:
        node.start()
        while not stop.received:
            try:
                executor.spin_once()
            except InvalidHandle:  # the answer of a service that was taken back meanwhile
                node.get_logger().warning('a service that is gone has not answered')
    finally:
        executor.shutdown()
        node.destroy_node()


def _initialise(args: Sequence[str] | None) -> None:
    if not {'HOME', 'ROS_HOME', 'ROS_LOG_DIR'} & set(os.environ):
        # A service of the system has no home, and rcl refuses to start without a place for logs.
        os.environ['ROS_LOG_DIR'] = os.path.join(tempfile.gettempdir(), 'ros_log')
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise ConfigError(' '.join(str(error).split())) from error
