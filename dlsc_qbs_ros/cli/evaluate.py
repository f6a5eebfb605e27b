"""Recorded flights through the pipeline the nodes run: table, metrics.json and pictures."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import sys
from typing import Any, Mapping, Sequence

from tqdm import tqdm

from .arguments import add_pipeline, flights_named, methods_named, networks_given, notes
from .common import given_values, run_tool, write_config, writing
from .job import Job, run_job, TUNE
from .methods import Method, METHODS
from .spread import spread
from ..config import Config
from ..errors import ConfigError
from ..evaluation.plots import plot_run
from ..evaluation.table import format_table, Outcome


def main(argv: Sequence[str] | None = None) -> int:
    """Evaluate flights; print expected errors as one line and return the exit code."""
    return run_tool('evaluate', _evaluate, _parser().parse_args(argv))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='evaluate', description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog='encoders:\n' + '\n'.join(
            f'  {name:17}{method.meaning}' for name, method in METHODS.items()))
    parser.add_argument('flights', metavar='FLIGHT', nargs='+', type=Path,
                        help='an MCAP file or a rosbag2 folder')
    parser.add_argument('--encoder', metavar='NAME,...', default='dlsc_qbs',
                        help='any of those below (default: %(default)s)')
    add_pipeline(parser)
    parser.add_argument('--threshold', metavar='MU|tune',
                        help="mu, in the units of the encoder's measure, or the one of least "
                        'MAE_L for each flight and encoder; left out: one of each encoder')
    parser.add_argument('--out', metavar='DIR', type=Path, required=True)
    return parser


def _evaluate(args: argparse.Namespace) -> None:
    methods = methods_named(args.encoder)
    networks = networks_given(args.onnx, methods)
    flights = flights_named(args.flights, args)
    values = given_values(args.config, args.set)
    threshold = _threshold(args.threshold)
    config = Config().override(values)
    _tell_overruled(values, methods)
    for method in methods:  # refuse what cannot be before any work
        method.configured(config, 1, None if threshold == TUNE else threshold)
    write_config(args.out, config, notes(methods, threshold))
    jobs = [Job(flight, method.name, config, (threshold,), networks.get(method.name),
                args.jobs == 1 and args.scheduler is None)
            for flight in flights for method in methods]
    outcomes: list[Outcome] = []
    for outcome in tqdm(spread(run_job, jobs, args.jobs, args.scheduler), 'evaluate',
                        len(jobs), unit=' rows', leave=False, disable=None):
        outcomes.append(outcome)
        _write(args.out, outcomes)
    print(format_table([outcome.runs[0].row for outcome in outcomes]))
    print(f'\n{args.out} holds metrics.json, timing.json, config.yaml and a picture of each row.')


def _write(out: Path, outcomes: list[Outcome]) -> None:
    """Write what is there so far, and the picture of the last."""
    with writing(out):
        _dump(out / 'metrics.json', [
            outcome.as_json(outcome.runs[0]) for outcome in outcomes])
        _dump(out / 'timing.json', [outcome.runs[0].row.timing() for outcome in outcomes])
        run = outcomes[-1].runs[0]
        plot_run(out / f'{run.row.flight}_{run.row.encoder}.png', run.row, run.result)


def _dump(path: Path, rows: list[dict[str, Any]]) -> None:
    path.write_text(json.dumps({'rows': rows}, indent=2) + '\n')


def _threshold(text: str | None) -> float | str | None:
    if text in (None, TUNE):
        return text
    try:
        return float(text)
    except ValueError:
        raise ConfigError(f"--threshold {text!r}: expected a number or 'tune'") from None


def _tell_overruled(values: Mapping[str, Any], methods: Sequence[Method]) -> None:
    """Say which of the given parameters the name of an encoder decides otherwise."""
    for method in methods:
        for key, value in method.decides().items():
            if values.get(key, value) != value:
                print(f'evaluate: {key} = {values[key]!r} has no effect on the row {method.name}, '
                      f'which sets {value!r}', file=sys.stderr)
