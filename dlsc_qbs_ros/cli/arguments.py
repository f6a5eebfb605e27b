"""What the tools that take flights through many encoders are told, and what it means."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Sequence

from .job import Flight
from .methods import Method, METHODS
from ..errors import ConfigError, RecordingError


def add_pipeline(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say what runs, on which topics and where."""
    parser.add_argument('--config', metavar='YAML', type=Path, help='a ROS parameter file')
    parser.add_argument('--set', metavar='KEY=VALUE', action='append', default=[],
                        help='one parameter, section.name=value; repeatable')
    parser.add_argument('--image-topic', metavar='TOPIC')
    parser.add_argument('--odom-topic', metavar='TOPIC')
    parser.add_argument('--ground-truth-topic', metavar='TOPIC')
    parser.add_argument('--tlog', metavar='FILE', type=Path,
                        help='take the odometry from this recording of a MAVLink link instead, '
                        'on the clock of the flights')
    networks = ', '.join(name for name, method in METHODS.items() if method.has_network)
    parser.add_argument('--onnx', metavar='[NAME=]FILE', action='append', default=[],
                        help=f'the network of an encoder ({networks}; onnx if not said); '
                        'repeatable')
    parser.add_argument('--jobs', metavar='N', type=int, default=1,
                        help='flights and encoders at a time (default: %(default)s)')
    parser.add_argument('--scheduler', metavar='ADDRESS',
                        help='of a Dask cluster to do them instead, which reads the same files')


def methods_named(text: str) -> list[Method]:
    """Return the methods of a list with commas; raise ConfigError for an unknown one."""
    names = list(dict.fromkeys(name.strip() for name in text.split(',')))
    for name in names:
        if name not in METHODS:
            raise ConfigError(f'--encoder {name!r}: expected any of {", ".join(METHODS)}')
    return [METHODS[name] for name in names]


def networks_given(assignments: Sequence[str], methods: Sequence[Method]) -> dict[str, Path]:
    """Return the file of each encoder with a network; raise ConfigError where one is missing."""
    networks: dict[str, Path] = {}
    for text in assignments:
        name, equals, path = text.partition('=')
        if not equals or name not in METHODS:
            name, path = 'onnx', text
        if not METHODS[name].has_network:
            raise ConfigError(f'--onnx {text!r}: the encoder {name} has no network')
        networks[name] = Path(path).absolute()
    for method in methods:
        if method.has_network and method.name not in networks:
            raise ConfigError(f'--encoder {method.name}: expected --onnx {method.name}=FILE')
    return networks


def notes(methods: Sequence[Method], threshold: float | str | None = None) -> list[str]:
    """Return what config.yaml cannot hold: what is different in the rows of each method."""
    decided = [f'rows of {method.name}: {key} = {value!r}'
               for method in methods for key, value in method.decides().items()]
    return decided + [f'--threshold {threshold} in all rows'] * (threshold is not None)


def flights_named(paths: Sequence[Path], args: argparse.Namespace) -> list[Flight]:
    """Return flights, each named by the shortest end of its path that tells it from the others."""
    for path in paths:
        if not path.exists():
            raise RecordingError(f'{path}: no such file or folder')
        if not path.absolute().name:
            raise RecordingError(f'{path}: expected an MCAP file or a rosbag2 folder')
    tlog = args.tlog and args.tlog.absolute()
    stems = [path.with_suffix('') if path.suffix == '.mcap' else path for path in paths]
    parts = [stem.absolute().parts[1:] for stem in stems]
    for depth in range(1, max(map(len, parts)) + 1):
        flights = {'_'.join(part[-depth:]): path for part, path in zip(parts, paths)}
        if len(flights) == len(paths):
            return [Flight(name, path.absolute(), args.image_topic, args.odom_topic,
                           args.ground_truth_topic, tlog) for name, path in flights.items()]
    raise RecordingError(f'a flight is given twice: {", ".join(map(str, paths))}')
