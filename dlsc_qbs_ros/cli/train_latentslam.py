"""Train the encoder of LatentSLAM on frames of flights, for evaluate --onnx on other flights."""

from __future__ import annotations

import argparse
from pathlib import Path
import re
from typing import Sequence

import numpy as np
from tqdm import tqdm

from .common import run_tool, writing
from ..baselines.latentslam import Vae
from ..core.types import Frame
from ..errors import ConfigError, RecordingError
from ..io.flight import read_flight


def main(argv: Sequence[str] | None = None) -> int:
    """Train; print expected errors as one line and return the exit code."""
    return run_tool('train_latentslam', _train, _parser().parse_args(argv))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='train_latentslam', description=__doc__)
    parser.add_argument('flights', metavar='FLIGHT', nargs='+', type=Path,
                        help='an MCAP file or a rosbag2 folder, not one of those to evaluate')
    parser.add_argument('--out', metavar='FILE.onnx', type=Path, required=True)
    parser.add_argument('--frames', metavar='N', type=int, default=4000,
                        help='most frames to train on, evenly over all (default: %(default)s)')
    parser.add_argument('--epochs', metavar='N', type=int, default=30,
                        help='passes over the frames (default: %(default)s)')
    parser.add_argument('--seed', metavar='S', type=int, default=0,
                        help='of weights and samples (default: %(default)s)')
    parser.add_argument('--size', metavar='WxH', default='64x48',
                        help='size of the images, multiples of 16 (default: %(default)s)')
    parser.add_argument('--image-topic', metavar='TOPIC')
    parser.add_argument('--odom-topic', metavar='TOPIC')
    return parser


def _train(args: argparse.Namespace) -> None:
    for option, value in (('--frames', args.frames), ('--epochs', args.epochs)):
        if value < 1:
            raise ConfigError(f'{option} {value}: expected at least 1')
    vae = Vae(*_size(args.size), args.seed)
    with writing(args.out):
        args.out.parent.mkdir(parents=True, exist_ok=True)
    views = _views(args, vae)
    with tqdm(total=args.epochs, unit=' epochs', disable=None, leave=False) as bar:
        for number, epoch in enumerate(vae.train(views, args.epochs), start=1):
            bar.update()
            tqdm.write(f'epoch {number}/{args.epochs}: loss {epoch.loss:.1f} nats a frame '
                       f'(reconstruction {epoch.reconstruction:.1f}, '
                       f'divergence {epoch.divergence:.1f})')
    vae.save(args.out)
    print(f'{args.out}: encoder of {args.size} images, trained on {len(views)} frames of '
          f'{", ".join(map(str, args.flights))}')


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r'(\d+)x(\d+)', text)
    if match is None:
        raise ConfigError(f'--size {text!r}: expected WIDTHxHEIGHT in pixels')
    return int(match[1]), int(match[2])


def _views(args: argparse.Namespace, vae: Vae) -> np.ndarray:
    """Return the views of at most --frames frames, evenly over all the flights."""
    views = [
        vae.view(event.grey)
        for path in args.flights
        for event in tqdm(read_flight(path, args.image_topic, args.odom_topic), str(path),
                          unit=' events', disable=None, leave=False)
        if isinstance(event, Frame)]
    if not views:
        raise RecordingError(f'{", ".join(map(str, args.flights))}: expected frames, found none')
    chosen = np.linspace(0, len(views) - 1, min(args.frames, len(views))).round().astype(int)
    return np.stack([views[k] for k in chosen])
