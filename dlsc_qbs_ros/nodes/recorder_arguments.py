"""The recorder's command line: the words of `ros2 bag record` for the recorder's parameters."""

from __future__ import annotations

import argparse
from dataclasses import fields
from typing import Sequence

from rclpy.parameter import Parameter

from ..config import RecorderConfig

# rosbag2's words where they are others than --name-of-the-parameter.
ALIASES = {'regex': ('-e',),
           'output': ('-o',),
           'max_bytes': ('-b', '--max-bag-size'),
           'max_duration_s': ('-d', '--max-bag-duration'),
           'compression': ('--compression-format',)}


def parameters_from(argv: Sequence[str]) -> list[Parameter]:
    """Return the parameters that a command line, less what belongs to ROS, sets."""
    parser = _parser()
    given = vars(parser.parse_args(argv))
    use_sim_time = given.pop('use_sim_time')
    topics = [*given.pop('topic'), *given.get('topics', ())]
    if given.pop('all') and (topics or 'regex' in given):
        parser.error('--all and a choice of topics exclude each other')
    if topics:
        given['topics'] = topics
    return [Parameter(f'recorder.{name}', value=value) for name, value in given.items()] + [
        Parameter('use_sim_time', value=True)] * use_sim_time


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='recorder', description='Record topics as they come over the wire, into a folder '
        'that rosbag2, Foxglove and rosbags read. SIGINT (Ctrl-C) ends it.',
        epilog='Each option is a parameter, too, of the section recorder: '
        '--ros-args -p section.name:=value --params-file FILE')
    parser.add_argument('topic', nargs='*', help='topics to record (default: all)')
    parser.add_argument('-a', '--all', action='store_true', help='all topics, the default')
    for spec in fields(RecorderConfig):
        _add_option(parser, spec)
    parser.add_argument('--use-sim-time', action='store_true', help='log by the time of /clock')
    return parser


def _add_option(parser: argparse.ArgumentParser, spec) -> None:
    """Add the option of one parameter; what is not given stays out of the result."""
    names = [*ALIASES.get(spec.name, ()), f'--{spec.name.replace("_", "-")}']
    meaning, unit, choices = (spec.metadata[key] for key in ('meaning', 'unit', 'choices'))
    default = f' (default: {spec.default}{" " if unit else ""}{unit})' if spec.default else ''
    kind = type(spec.default)
    how = {bool: {'action': 'store_true'}, tuple: {'nargs': '+', 'metavar': 'NAME'}}.get(
        kind, {'type': kind, 'choices': choices or None, 'metavar': None if choices else 'VALUE'})
    parser.add_argument(*names, dest=spec.name, default=argparse.SUPPRESS,
                        help=(meaning + default).replace('%', '%%'), **how)
