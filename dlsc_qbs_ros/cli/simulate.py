"""
Make a warehouse flight: camera, drifting odometry and ground truth.

It is recorded, as a rosbag2 folder; or its odometry is flown, in real time, by a simulated
autopilot at the other end of a MAVLink link.
"""

from __future__ import annotations

import argparse
from dataclasses import fields
from pathlib import Path
from typing import Callable, Sequence

from tqdm import tqdm

from .common import run_tool
from ..core.types import GroundTruthSample, RawOdometry
from ..errors import ConfigError, RecordingError
from ..io.recordings.bag_writer import BagWriter
from ..sim.encodings import ENCODINGS
from ..sim.simulation import Picture, simulate_flight, SimulatedFlight
from ..sim.variations import EACH, PLAIN, Variations

TOPICS = {
    Picture: ('/camera/image_raw', 'sensor_msgs/msg/Image'),
    RawOdometry: ('/odom', 'nav_msgs/msg/Odometry'),
    GroundTruthSample: ('/ground_truth', 'geometry_msgs/msg/PoseStamped'),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Simulate a flight; print expected errors as one line and return the exit code."""
    return run_tool('simulate', _simulate, _parser().parse_args(argv))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='simulate', description=__doc__)
    parser.add_argument('--flight', metavar='{1,2,3}', type=int, required=True,
                        help='1 between wall and shelves, 2 between shelves only, 3 both')
    parser.add_argument('--seed', metavar='S', type=int, default=0,
                        help='of warehouse, flight and sensors (default: %(default)s)')
    target = parser.add_mutually_exclusive_group(required=True)
    target.add_argument('--out', metavar='DIR', type=Path, help='the recording to make')
    target.add_argument('--mavlink', metavar='udpout:HOST:PORT', help='the link to fly on')
    parser.add_argument('--seconds', metavar='T', type=float,
                        help='duration (default: three laps and a bit, more for what follows)')
    parser.add_argument('--encoding', metavar='NAME', default='rgb8',
                        help=f'any of {", ".join(ENCODINGS)} (default: %(default)s)')
    _add_autopilot(parser.add_argument_group('with --mavlink'))
    _add_variations(parser.add_argument_group('what happens on the way, any of it together'))
    return parser


def _add_autopilot(group: argparse._ArgumentGroup) -> None:
    group.add_argument('--mavlink-messages', metavar='odometry|position',
                       choices=('odometry', 'position'), default='odometry',
                       help='ODOMETRY, as PX4 sends it (default), or LOCAL_POSITION_NED and '
                       'ATTITUDE, as ArduPilot does')
    group.add_argument('--start-at', metavar='UNIX_S', type=float,
                       help='fly when the clock of this machine tells that (default: now)')


def _add_variations(group: argparse._ArgumentGroup) -> None:
    def add(flag: str, metavar: str, variation: str, field: str, text: str):
        usual = getattr(EACH[variation], field)
        group.add_argument(flag, metavar=metavar, dest=field, type=float, nargs='?', const=usual,
                           default=getattr(PLAIN, field), help=f'{text} ({usual:g} if not said)')

    add('--second-altitude', 'M', 'second_altitude', 'second_altitude_m',
        f'fly every other lap at M metres instead of {PLAIN.second_altitude_m:g}')
    group.add_argument('--reversed-lap', action='store_true',
                       help='fly the second lap the other way round')
    add('--pause', 'S', 'pause', 'pause_s', 'hover for S seconds in mid-flight')
    add('--dimmed', 'SHARE', 'dimmed', 'dimmed_to', 'dim the lights half-way to this share')
    group.add_argument('--twin-aisle', action='store_true',
                       help='make one aisle between the shelves look exactly like the other')


def _simulate(args: argparse.Namespace) -> None:
    if args.encoding not in ENCODINGS:
        raise ConfigError(
            f'encoding {args.encoding!r}: expected one of {", ".join(ENCODINGS)}')
    variations = Variations(**{
        field.name: getattr(args, field.name) for field in fields(Variations)})
    flight = simulate_flight(args.flight, args.seed, args.seconds, variations)
    if args.mavlink is not None:
        _fly(flight, args.mavlink, args.mavlink_messages, args.start_at)
        return
    try:
        _record(flight, args.encoding, args.out)
    except OSError as error:
        raise RecordingError(f'{args.out}: cannot write the recording: {error}') from error
    print(f'{args.out}: flight {args.flight}, seed {args.seed}: '
          f'{len(flight.image_stamps_ns)} images ({args.encoding}), '
          f'{len(flight.odometry)} odometry, {len(flight.ground_truth)} ground truth')


def _record(flight: SimulatedFlight, encoding: str, out: Path) -> None:
    from ..ros.serialization import serialize  # only here: --help and errors need no ROS
    to_msg = _converters(encoding)
    with BagWriter(out) as writer, tqdm(
            total=len(flight.image_stamps_ns), unit='frame', disable=None) as progress:
        for topic, type_name in TOPICS.values():
            writer.add_topic(topic, type_name)
        for event in flight.events(flight.pictures()):
            stamp_ns, msg = to_msg[type(event)](event)
            writer.write(TOPICS[type(event)][0], serialize(msg), stamp_ns, stamp_ns)
            progress.update(isinstance(event, Picture))


def _fly(flight: SimulatedFlight, address: str, messages: str, start_s: float | None) -> None:
    from ..io.mavlink.autopilot import Autopilot  # only here: recordings need no pymavlink
    from ..io.mavlink.autopilot_messages import ENCODERS
    with Autopilot(address, ENCODERS[messages]) as autopilot:
        autopilot.fly(flight.odometry, None if start_s is None else int(start_s * 1e9))
        for direction, counts in (('sent', autopilot.sent), ('received', autopilot.received)):
            print(f'{direction}: ' + ', '.join(
                f'{count} {name}' for name, count in sorted(counts.items())))


def _converters(encoding: str) -> dict[type, Callable]:
    """Return, for each kind of event, the function to its stamp and message."""
    from ..ros.conversions import image_to_msg, odometry_to_msg, pose_stamped_to_msg
    encode = ENCODINGS[encoding]

    def picture(event: Picture):
        return event.stamp_ns, image_to_msg(event.stamp_ns, encode(event.rgb), encoding, 'camera')

    def odometry(event: RawOdometry):
        return event.sample.stamp_ns, odometry_to_msg(
            event.sample, event.forward_m_s, event.yaw_rate_rad_s, 'odom', 'base_link')

    def ground_truth(event: GroundTruthSample):
        return event.stamp_ns, pose_stamped_to_msg(event, 'world')

    return {Picture: picture, RawOdometry: odometry, GroundTruthSample: ground_truth}
