"""The paper's table from nothing: flights, LatentSLAM's training, every row, and one report."""

from __future__ import annotations

import argparse
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
import json
from pathlib import Path
import platform
import sys
from tempfile import TemporaryDirectory
import time
from typing import Any, Sequence

import cv2
import numpy as np
from tqdm import tqdm

from . import simulate, train_latentslam
from .arguments import add_pipeline, flights_named, networks_given, notes
from .common import given_values, run_tool, write_config, writing
from .job import Flight, Job, run_job, TUNE
from .methods import Method, METHODS
from .spread import spread
from ..config import Config
from ..errors import DlscQbsError, RecordingError
from ..evaluation.plots import new_figure
from ..evaluation.report import Report
from ..evaluation.table import format_table, Outcome

KINDS = (1, 2, 3)


def main(argv: Sequence[str] | None = None) -> int:
    """Reproduce the table; print expected errors as one line and return the exit code."""
    argv = sys.argv[1:] if argv is None else argv
    args = _parser().parse_args(argv)
    args.command = ' '.join(['reproduce', *argv])
    return run_tool('reproduce', _reproduce, args)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='reproduce', description=__doc__)
    parser.add_argument('--flights', metavar='FLIGHT', nargs='+', type=Path,
                        help='MCAP files or rosbag2 folders, instead of simulated flights')
    parser.add_argument('--seeds', metavar='S', nargs='+', type=int, default=[0],
                        help='of the simulated flights, three of each (default: 0)')
    parser.add_argument('--training', metavar='FLIGHT', nargs='+', type=Path,
                        help='what LatentSLAM is trained on, instead of simulated flights of '
                        'another seed')
    add_pipeline(parser)
    parser.add_argument('--out', metavar='DIR', type=Path, required=True)
    return parser


def _reproduce(args: argparse.Namespace) -> None:
    started = time.monotonic()
    config = Config().override(given_values(args.config, args.set))
    networks = networks_given(args.onnx, [])
    write_config(args.out, config, notes(list(METHODS.values())))
    new_figure(args.out / 'report.html', (1.0, 1.0))  # fails now rather than after all the work
    flights = flights_named(args.flights or _simulated(args, args.seeds), args)
    facts = _facts(args, flights)
    left_out = {} if 'latentslam' in networks else _train(args, flights, networks, facts)
    methods, same = _distinct(config, networks, left_out)
    jobs = [Job(flight, method.name, config, (None, TUNE) if method.grid else (None,),
                networks.get(method.name), args.jobs == 1 and args.scheduler is None)
            for flight in flights for method in methods]
    outcomes: list[Outcome] = []
    try:
        for outcome in tqdm(spread(run_job, jobs, args.jobs, args.scheduler), 'reproduce',
                            len(jobs), unit=' rows', leave=False, disable=None):
            outcomes.append(outcome)
    finally:
        facts['wall time'] = f'{(time.monotonic() - started) / 60.0:.1f} min'
        if outcomes:  # what is there is told, whatever went wrong with the rest
            _write(args.out, Report(
                _all_names(outcomes, same), {name: METHODS[name].meaning for name in METHODS},
                same, left_out, config.flat(), notes(list(METHODS.values())), facts))


def _simulated(args: argparse.Namespace, seeds: Sequence[int]) -> list[Path]:
    """Return the flights of some seeds, made where they are not there yet."""
    flights = [(kind, seed, args.out / 'flights' / f'flight{kind}_seed{seed}')
               for seed in seeds for kind in KINDS]
    missing = [flight for flight in flights if not flight[2].exists()]
    for _ in tqdm(spread(_simulate, missing, args.jobs), 'simulate', len(missing),
                  unit=' flights', leave=False, disable=None):
        pass
    return [path for _, _, path in flights]


def _simulate(flight: tuple[int, int, Path]) -> None:
    """Make a flight of a kind and a seed, which is there once it is whole."""
    kind, seed, path = flight
    with writing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=path.parent) as folder:
            draft = Path(folder) / path.name
            if simulate.main(['--flight', str(kind), '--seed', str(seed), '--encoding', 'mono8',
                              '--out', str(draft)]):
                raise RecordingError(f'{path}: could not be made')
            draft.rename(path)


def _train(args: argparse.Namespace, evaluated: Sequence[Flight], networks: dict[str, Path],
           facts: dict[str, Any]) -> dict[str, str]:
    """Train LatentSLAM on flights that are not evaluated; return why it is left out, if it is."""
    missing = [name for name in ('torch', 'onnx') if find_spec(name) is None]
    if missing:
        return {'latentslam': f'training it takes the extra [train]: no {", ".join(missing)}'}
    flights = args.training or _simulated(args, [max(args.seeds) + 1])
    shared = {flight.path.resolve() for flight in evaluated} & {*map(Path.resolve, flights)}
    if shared:
        raise DlscQbsError(f'{min(shared)}: expected LatentSLAM to be trained on flights other '
                           'than those evaluated, found it among both (--training)')
    model = args.out / 'latentslam.onnx'
    if train_latentslam.main([*map(str, flights), '--out', str(model)]):
        raise DlscQbsError('LatentSLAM could not be trained')
    networks['latentslam'] = model
    facts['LatentSLAM trained on'] = ', '.join(flight.name for flight in flights)
    facts['PyTorch'] = _version('torch')
    return {}


def _distinct(config: Config, networks: dict[str, Path], left_out: dict[str, str]
              ) -> tuple[list[Method], dict[str, str]]:
    """Return the methods to run and, by name, those that are one of them by another name."""
    first: dict[Any, Method] = {}
    same: dict[str, str] = {}
    for method in METHODS.values():
        if method.has_network and method.name not in networks:
            if method.name == 'vgg11':
                left_out['vgg11'] = 'its weights are given by --onnx vgg11=FILE (convert_vgg11)'
            continue
        key = (method.configured(config, 1, None), method.make, networks.get(method.name))
        if first.setdefault(key, method) is not method:
            same[method.name] = first[key].name
    return list(first.values()), same


def _all_names(outcomes: Sequence[Outcome], same: dict[str, str]) -> list[Outcome]:
    """Return the outcomes in the order of the methods, those of two names twice."""
    of_flight: dict[str, dict[str, Outcome]] = {}
    for outcome in outcomes:
        row = outcome.runs[0].row
        of_flight.setdefault(row.flight, {})[row.encoder] = outcome
    return [_renamed(found[same.get(name, name)], name)
            for found in of_flight.values() for name in METHODS if same.get(name, name) in found]


def _renamed(outcome: Outcome, name: str) -> Outcome:
    return replace(outcome, runs=[
        replace(run, row=replace(run.row, encoder=name)) for run in outcome.runs])


def _facts(args: argparse.Namespace, flights: Sequence[Flight]) -> dict[str, Any]:
    """Return what it takes to make the same again."""
    return {
        'command': args.command, 'flights': ', '.join(flight.name for flight in flights),
        'seeds of the flights': 'given flights' if args.flights else list(args.seeds),
        'dlsc_qbs_ros': _version('dlsc_qbs_ros'), 'Python': platform.python_version(),
        'NumPy': np.__version__, 'OpenCV': cv2.__version__, 'machine': platform.platform()}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return 'not installed'


def _write(out: Path, report: Report) -> None:
    with writing(out):
        (out / 'report.json').write_text(json.dumps(report.document(), indent=2) + '\n')
        (out / 'report.html').write_text(report.page())
    print(format_table(report.rows))
    print(f'\n{out} holds report.html, report.json and config.yaml.')
