"""The paper's figure on the encoder: replay with and without QBS, run-away, learned atoms."""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import asdict
import json
from pathlib import Path
import sys
from typing import Any, Iterable, Sequence

import numpy as np
from tqdm import tqdm

from .common import given_values, run_tool, write_config, writing
from ..config import Config
from ..core.types import Frame
from ..errors import RecordingError
from ..evaluation.encoder_figure import (
    atoms_finding, Finding, replay_finding, run_away_finding)
from ..evaluation.encoder_plots import plot_atoms, plot_replay, plot_run_away
from ..io.flight import read_flight
from ..pipeline.continual_learning import (
    learn, Learning, random_schedule, replay, views_of)

# The size of image and the parameters in the caption of the figure. Views stay standardised: on
# brighter pixels than the paper's, parameters that were stable there are not, and what follows a
# run-away hangs on rounding.
PAPER = {'view.width': 346, 'view.height': 260}
PANELS = {
    'a': {'encoder.eta_c': 5e-3, 'encoder.lambda_1': 0.5, 'encoder.eta_d': 2e-3},
    'b': {'encoder.eta_c': 1e-2, 'encoder.lambda_1': 0.25, 'encoder.eta_d': 4e-3},
}
# Every run decides these by itself.
WITHOUT_EFFECT = {'encoder.gate', 'encoder.protection'}
MIN_FRAMES = 50
N_DRAWS = 3


def main(argv: Sequence[str] | None = None) -> int:
    """Reproduce the figure; print expected errors as one line and return the exit code."""
    return run_tool('reproduce_encoder', _reproduce, _parser().parse_args(argv))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='reproduce_encoder', description=__doc__,
        epilog='Images are taken at 346x260, as in the paper, unless --config or --set says '
        'otherwise; view.standardise=false leaves their pixels in [0, 1].')
    parser.add_argument('flight', metavar='FLIGHT', type=Path,
                        help='an MCAP file or a rosbag2 folder')
    parser.add_argument('--config', metavar='YAML', type=Path, help='a ROS parameter file')
    parser.add_argument('--set', metavar='KEY=VALUE', action='append', default=[],
                        help='one parameter, section.name=value, in all panels; repeatable')
    parser.add_argument('--image-topic', metavar='TOPIC')
    parser.add_argument('--odom-topic', metavar='TOPIC')
    parser.add_argument('--out', metavar='DIR', type=Path, required=True)
    return parser


def _reproduce(args: argparse.Namespace) -> None:
    values = given_values(args.config, args.set)
    a, b = (Config().override({**PAPER, **panel, **values}) for panel in PANELS.values())
    for key in sorted(values.keys() & WITHOUT_EFFECT):
        print(f'reproduce_encoder: {key} has no effect: learning runs with the gate and without, '
              'unprotected', file=sys.stderr)
    write_config(args.out, a, [f'panel b: {key} = {value!r}' for key, value in b.flat().items()
                               if value != a.flat()[key]])
    views, refused = _views(args, a)
    gated, always, *draws = _learn_and_replay(views, a)
    courses = [learn(_shown(views, f'(b) {label}'), b, schedule)
               for label, schedule in _with_and_without(views)]
    size = a.view.height, a.view.width
    findings = {
        'replay_loss': replay_finding(gated, always, draws),
        'run_away': run_away_finding(*courses),
        'atoms': atoms_finding(learn([], a), gated[0], always[0], *size)}
    document = _document(args.flight, len(views), refused, a, b, findings)
    with writing(args.out):
        (args.out / 'encoder.json').write_text(
            json.dumps(document, indent=2, allow_nan=False) + '\n')
    print(*(finding.sentence for finding in findings.values()), sep='\n')
    note = f'{args.flight.stem}, {len(views)} frames, {_pixels(a)}'
    with writing(args.out):
        plot_replay(args.out / 'replay_loss.png', gated[1], always[1],
                    [errors for _, errors in draws], note)
        plot_run_away(args.out / 'run_away.png', *courses, note)
        plot_atoms(args.out / 'atoms.png', gated[0].atoms, *size, note)
    print(f'\n{args.out} holds encoder.json, config.yaml, replay_loss.png, run_away.png and '
          'atoms.png.')


def _views(args: argparse.Namespace, config: Config) -> tuple[list[np.ndarray], Counter[str]]:
    """Return the views of the flight and the count of what was refused."""
    refused: Counter[str] = Counter()
    events = read_flight(args.flight, args.image_topic, args.odom_topic, refused=refused)
    frames = (event for event in events if isinstance(event, Frame))
    views = views_of(_shown(frames, 'reading'), config.view, refused)
    if len(views) < MIN_FRAMES:
        raise RecordingError(
            f'{args.flight}: expected at least {MIN_FRAMES} frames, found {len(views)}')
    return views, refused


def _shown(items: Iterable, label: str) -> tqdm:
    return tqdm(items, label, unit=' frames', disable=None, leave=False)


def _with_and_without(views: list) -> list[tuple[str, np.ndarray | None]]:
    """Return label and schedule of a run with QBS and of one that learns from every frame."""
    return [('with QBS', None), ('without QBS', np.ones(len(views), bool))]


def _learn_and_replay(views: list, config: Config) -> list[tuple[Learning, np.ndarray]]:
    """Return learning and replay errors with QBS, without, and of random draws of frames."""
    runs: list[tuple[Learning, np.ndarray]] = []

    def run(label: str, schedule: np.ndarray | None) -> None:
        learning = learn(_shown(views, f'(a) {label}'), config, schedule)
        errors = replay(_shown(views, f'(a) {label}, replay'), config, learning.atoms)
        runs.append((learning, errors))

    for label, schedule in _with_and_without(views):
        run(label, schedule)
    n_learned = int(runs[0][0].learned.sum())
    for seed in range(N_DRAWS):
        run(f'random frames {seed + 1}/{N_DRAWS}', random_schedule(len(views), n_learned, seed))
    return runs


def _document(flight: Path, n_frames: int, refused: Counter[str], a: Config, b: Config,
              findings: dict[str, Finding]) -> dict[str, Any]:
    """Return encoder.json: each panel with its parameters, numbers, verdict and sentence."""
    parameters = {'replay_loss': a, 'run_away': b, 'atoms': a}
    return {
        'flight': str(flight), 'frames': n_frames, 'refused': dict(refused),
        'view': asdict(a.view),
        **{name: {'parameters': asdict(parameters[name].encoder), **finding.as_json()}
           for name, finding in findings.items()}}


def _pixels(config: Config) -> str:
    kind = 'standardised' if config.view.standardise else 'pixels in [0, 1]'
    return f'{config.view.width}x{config.view.height}, {kind}'
