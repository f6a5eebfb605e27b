"""The weights of VGG-11 that torchvision publishes (vgg11-*.pth) to ONNX, for evaluate --onnx."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Sequence

from .common import run_tool, writing
from ..baselines.vgg11 import convert


def main(argv: Sequence[str] | None = None) -> int:
    """Convert the weights; print expected errors as one line and return the exit code."""
    return run_tool('convert_vgg11', _convert, _parser().parse_args(argv))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='convert_vgg11', description=__doc__)
    parser.add_argument('weights', metavar='FILE.pth', type=Path,
                        help='state dictionary of vgg11 or vgg11_bn')
    parser.add_argument('--out', metavar='FILE.onnx', type=Path, required=True)
    return parser


def _convert(args: argparse.Namespace) -> None:
    with writing(args.out):
        args.out.parent.mkdir(parents=True, exist_ok=True)
    convert(args.weights, args.out)
    print(f'{args.out}: the convolutional layers of {args.weights}')
