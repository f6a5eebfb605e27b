"""Play a recorded flight onto live topics."""

from __future__ import annotations

import argparse
from math import inf, nan
from pathlib import Path
import sys
from typing import Sequence

from ..nodes.recorded_messages import Recording
from ..nodes.replay_node import ReplayNode
from ..ros.runtime import run_ros, StopRequest, without_ros_args


def main(argv: Sequence[str] | None = None) -> int:
    """Play a flight; print what was played, or one line about an expected error."""
    argv = list(sys.argv[1:] if argv is None else argv)
    options = _parser().parse_args(without_ros_args(argv))
    return run_ros(lambda stop: _replay(options, stop), ['replay', *argv])


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='replay', description=__doc__,
        epilog='Topics are remapped as usual: --ros-args -r /from:=/to')
    parser.add_argument('flight', type=Path, help='an MCAP file or a rosbag2 folder')
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument('--rate', type=_rate, default=1.0, metavar='R|max',
                      help='flight time over wall time (default: 1); max: as fast as the '
                      'nodes can follow')
    pace.add_argument('--start-at', type=float, metavar='UNIX_S',
                      help='start when the clock of this machine tells that, with stamps from '
                      'then on, beside what is live')
    parser.add_argument('--topics', nargs='+', metavar='TOPIC',
                        help='play only these (default: all)')
    parser.add_argument('--tlog', type=Path, metavar='FILE',
                        help='play the odometry of this recording of a MAVLink link, on the clock '
                        'of the flight, on /odom')
    parser.add_argument('--wait-for-subscribers', type=float, default=10.0, metavar='S',
                        help='longest wait, in seconds, until somebody subscribes to each '
                        'image and odometry topic (default: 10)')
    return parser


def _rate(text: str) -> float:
    try:
        rate = inf if text == 'max' else float(text)
    except ValueError:
        rate = nan
    if not rate > 0:
        raise argparse.ArgumentTypeError(f'{text}: expected a number above 0, or max')
    return rate


def _replay(options: argparse.Namespace, stop: StopRequest) -> None:
    start_ns = None if options.start_at is None else int(options.start_at * 1e9)
    node = ReplayNode(Recording(options.flight, options.tlog), options.topics, options.rate,
                      start_ns, stop)
    try:
        played = node.play(options.wait_for_subscribers)
    finally:
        node.destroy_node()
    for topic, count in sorted(played.counts.items()):
        print(f'{count:8d} {topic}')
    speed = played.flight_s / played.wall_s if played.wall_s else 0.0
    print(f'{played.flight_s:.1f} s of flight in {played.wall_s:.1f} s, '
          f'{speed:.2f} times its speed')


if __name__ == '__main__':
    sys.exit(main())
