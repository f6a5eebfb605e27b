"""
How far the package is from the literal Algorithm 1, at any size of view and over any flight.

The comparison is that of `test/exactness.py`; the tests run it on small views, this on those of
the paper, too: 346x260 takes the literal algorithm about a tenth of a second per frame.
"""

from __future__ import annotations

import argparse
from itertools import islice
from pathlib import Path
import sys
import time
from typing import Iterator

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import Frame
from dlsc_qbs_ros.io.flight import read_flight
from dlsc_qbs_ros.sim.simulation import IMAGE_PERIOD_NS, simulate_flight
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / 'test'))
from exactness import compared, SETS  # noqa: E402, I100, I202

COLUMNS = ('set', 'frames', 'code', 'dictionary', 'error', 'S_2', 'flips', 'closest', 'eta_c L',
           'ms/frame')
ROW = '{:8s} {:>6d} {:>9.1e} {:>10.1e} {:>9.1e} {:>9.1e} {:>6d} {:>9.1e} {:>8.2f} {:>9.1f}'


def frames_of(flight: str, n: int) -> Iterator[Frame]:
    """Return the first n frames of a simulated flight 1, 2 or 3, or of a recording."""
    if flight in ('1', '2', '3'):
        seconds = max(1.0, (n + 1) * IMAGE_PERIOD_NS * 1e-9)
        frames = simulate_flight(int(flight), 0, seconds).frames()
    else:
        frames = (event for event in read_flight(Path(flight)) if isinstance(event, Frame))
    return islice(frames, n)


def row(name: str, config: Config, frames: Iterator[Frame], stride: int) -> str:
    """Return the row of one parameter set: the largest difference of each kind."""
    started = time.perf_counter()
    columns = compared(config, frames, stride=stride)
    n = len(columns.code)
    return ROW.format(
        name, n, columns.code.max(), np.nanmax(columns.dictionary), columns.error.max(),
        columns.surprise.max(), np.count_nonzero(~columns.agrees), columns.margin.min(),
        np.nanmax(columns.rate), 1e3 * (time.perf_counter() - started) / n)


def main() -> None:
    """Print one row for every parameter set."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--flight', default='2', help='1, 2, 3 or a recording (default: 2)')
    parser.add_argument('--frames', type=int, default=1000)
    parser.add_argument('--width', type=int, default=346)
    parser.add_argument('--height', type=int, default=260)
    parser.add_argument('--set', action='append', choices=SETS, help='default: all of them')
    parser.add_argument('--pixels', action='store_true', help='do not standardise the views')
    parser.add_argument('--stride', type=int, default=10,
                        help='compare dictionaries on every n-th frame')
    args = parser.parse_args()
    print(' '.join(f'{title:>{width}s}' for title, width in zip(
        COLUMNS, (8, 6, 9, 10, 9, 9, 6, 9, 8, 9))), flush=True)
    for name in args.set or SETS:
        config = Config().override({
            'encoder.input': 'image', 'encoder.mode': 'paper', 'encoder.protection': False,
            'view.width': args.width, 'view.height': args.height,
            'view.standardise': not args.pixels, **SETS[name]})
        print(row(name, config, frames_of(args.flight, args.frames), args.stride), flush=True)


if __name__ == '__main__':
    main()
