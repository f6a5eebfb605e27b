"""Repair recordings that a crash or a power cut left without an index."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Sequence

from .common import run_tool
from ..errors import RecordingError
from ..io.recordings.recovery import recover


def main(argv: Sequence[str] | None = None) -> int:
    """Repair recordings; print expected errors as one line and return the exit code."""
    return run_tool('recover', _recover, _parser().parse_args(argv))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog='recover', description=__doc__)
    parser.add_argument('recordings', metavar='FILE', type=Path, nargs='+',
                        help='an MCAP file, or the folder of a recording; each is rewritten, and '
                        'stays as it is until that is done')
    return parser


def _recover(args: argparse.Namespace) -> None:
    n_failed = 0
    for recording in args.recordings:
        repairs = list(recover(recording))
        for repair in repairs:
            print(repair.error or f'{repair.path}: {repair.n_messages} messages recovered, '
                  f'{repair.lost_bytes} bytes left out')
        if not repairs:
            print(f'{recording}: whole, nothing to repair')
        n_failed += sum(repair.error != '' for repair in repairs)
    if n_failed:
        raise RecordingError(f'not repaired: {n_failed}')
