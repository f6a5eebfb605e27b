"""Recorded flights through the pipeline the nodes run: table, metrics.json and pictures."""

from __future__ import annotations

import argparse
from collections import Counter
import json
from pathlib import Path
import sys
from typing import Any, Iterable, Iterator, Mapping, Sequence

from tqdm import tqdm

from .common import given_values, run_tool, write_config, writing
from ..config import Config
from ..core.types import Frame, GroundTruthSample
from ..errors import ConfigError, DlscQbsError, RecordingError
from ..evaluation.metrics import evaluate_run
from ..evaluation.plots import plot_run
from ..evaluation.table import format_table, Row
from ..io.flight import read_flight
from ..pipeline.runner import encode, EncodedFlight, ENCODERS, map_codes, RunResult

THRESHOLD = 'ratslam.threshold'
TUNING_GRID = tuple(round(0.98 - 0.04 * step, 2) for step in range(13))


def main(argv: Sequence[str] | None = None) -> int:
    """Evaluate flights; print expected errors as one line and return the exit code."""
    return run_tool('evaluate', _evaluate, _parser().parse_args(argv))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='evaluate', description=__doc__)
    parser.add_argument('flights', metavar='FLIGHT', nargs='+', type=Path,
                        help='an MCAP file or a rosbag2 folder')
    parser.add_argument('--encoder', metavar='NAME,...', default='dlsc_qbs',
                        help=f'any of {", ".join(ENCODERS)} (default: %(default)s)')
    parser.add_argument('--config', metavar='YAML', type=Path, help='a ROS parameter file')
    parser.add_argument('--set', metavar='KEY=VALUE', action='append', default=[],
                        help='one parameter, section.name=value; repeatable')
    parser.add_argument('--image-topic', metavar='TOPIC')
    parser.add_argument('--odom-topic', metavar='TOPIC')
    parser.add_argument('--ground-truth-topic', metavar='TOPIC')
    parser.add_argument('--threshold', metavar='MU|tune',
                        help=f'{THRESHOLD}, or the one of least MAE_L for each flight and encoder')
    parser.add_argument('--out', metavar='DIR', type=Path, required=True)
    return parser


def _evaluate(args: argparse.Namespace) -> None:
    encoders = _encoders(args.encoder)
    flights = _named(args.flights)
    values = _given_values(args)
    config = Config().override(values)
    _tell_overruled(values, encoders)
    write_config(args.out, config, [
        f'rows of {encoder}: {key} = {value!r}'
        for encoder in encoders for key, value in ENCODERS[encoder].items()])
    rows: list[Row] = []
    for name, path in flights.items():
        for encoder in encoders:
            try:
                row, result = _run(args, name, path, encoder, config)
            except DlscQbsError as error:
                if str(path) in str(error):
                    raise
                raise type(error)(f'{path}: {error}') from error
            rows.append(row)
            document = {'rows': [row.as_json() for row in rows]}
            with writing(args.out):
                (args.out / 'metrics.json').write_text(json.dumps(document, indent=2) + '\n')
                plot_run(args.out / f'{name}_{encoder}.png', row, result)
    print(format_table(rows))
    print(f'\n{args.out} holds metrics.json, config.yaml and a picture of each row.')


def _encoders(text: str) -> list[str]:
    names = list(dict.fromkeys(name.strip() for name in text.split(',')))
    for name in names:
        if name not in ENCODERS:
            raise ConfigError(f'--encoder {name!r}: expected any of {", ".join(ENCODERS)}')
    return names


def _named(paths: Sequence[Path]) -> dict[str, Path]:
    """Name each flight by the shortest end of its path that tells it from the others."""
    for path in paths:
        if not path.exists():
            raise RecordingError(f'{path}: no such file or folder')
        if not path.absolute().name:
            raise RecordingError(f'{path}: expected an MCAP file or a rosbag2 folder')
    stems = [path.with_suffix('') if path.suffix == '.mcap' else path for path in paths]
    parts = [stem.absolute().parts[1:] for stem in stems]
    for depth in range(1, max(map(len, parts)) + 1):
        flights = {'_'.join(part[-depth:]): path for part, path in zip(parts, paths)}
        if len(flights) == len(paths):
            return flights
    raise RecordingError(f'a flight is given twice: {", ".join(map(str, paths))}')


def _given_values(args: argparse.Namespace) -> dict[str, Any]:
    """Return the parameters of --config, overridden by --set, then by --threshold."""
    values = given_values(args.config, args.set)
    if args.threshold not in (None, 'tune'):
        try:
            values[THRESHOLD] = float(args.threshold)
        except ValueError:
            raise ConfigError(
                f"--threshold {args.threshold!r}: expected a number or 'tune'") from None
    return values


def _tell_overruled(values: Mapping[str, Any], encoders: Iterable[str]) -> None:
    """Say which of the given parameters the name of an encoder decides otherwise."""
    for encoder in encoders:
        for key, value in ENCODERS[encoder].items():
            if values.get(key, value) != value:
                print(f'evaluate: {key} = {values[key]!r} has no effect on the row {encoder}, '
                      f'which sets {value!r}', file=sys.stderr)


def _run(args, name: str, path: Path, encoder: str, config: Config) -> tuple[Row, RunResult]:
    """Take one flight through one encoder and the map."""
    truth: list[GroundTruthSample] = []
    config = config.override(ENCODERS[encoder])
    refused: Counter[str] = Counter()
    events = read_flight(
        path, args.image_topic, args.odom_topic, args.ground_truth_topic, refused)
    encoded = encode(_sensed(events, truth, f'{name} {encoder}'), config)
    tuned = args.threshold == 'tune' and encoder != 'odometry'
    if tuned:
        config = _tuned(encoded, config, truth)
    result = map_codes(encoded, config)
    if not len(result.stamps_ns):
        raise RecordingError('expected odometry before and after some of the frames, found none: '
                             f'{result.counts["frames"]} frames, no pose')
    threshold = None if encoder == 'odometry' else config.flat()[THRESHOLD]
    row = Row(name, encoder, evaluate_run(result, truth), threshold, tuned,
              len(result.stamps_ns), result.counts, result.seconds, refused)
    return row, result


def _sensed(events: Iterable, truth: list[GroundTruthSample], label: str) -> Iterator:
    """Pass on what a drone would sense, put ground truth aside, show the progress."""
    with tqdm(desc=label, unit=' frames', disable=None, leave=False) as bar:
        for event in events:
            if isinstance(event, GroundTruthSample):
                truth.append(event)
                continue
            bar.update(isinstance(event, Frame))
            yield event


def _tuned(encoded: EncodedFlight, config: Config, truth: list[GroundTruthSample]) -> Config:
    """Return the configuration of least MAE_L, as the paper tunes it; of equals, the strictest."""
    if not truth:
        raise RecordingError('--threshold tune: expected ground truth, found none')

    def error_m(candidate: Config) -> float:
        metrics = evaluate_run(map_codes(encoded, candidate), truth)
        if metrics is None:
            raise RecordingError('--threshold tune: ground truth and codes share no time')
        return metrics.mae_l

    candidates = [config.override({THRESHOLD: threshold}) for threshold in TUNING_GRID]
    return min(tqdm(candidates, 'threshold', disable=None, leave=False), key=error_m)
