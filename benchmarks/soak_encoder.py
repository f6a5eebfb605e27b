"""
The encoder for a very long time: flat memory, a finite state, a G that stays Phi Phi^T.

A simulated flight of 200 s goes round for ever, in ever other light and shifted sideways, so
that no frame comes twice. Frames are as small as twice the view: the encoder is what takes time.
Exits 1 when memory grew after the first twentieth, a number was not finite, or G drifted.
"""

from __future__ import annotations

import argparse
from math import sin
import os
from pathlib import Path
import sys
import time
from typing import Iterator

from dlsc_qbs_ros.config import Config, ViewConfig
from dlsc_qbs_ros.core.preprocessing import make_view
from dlsc_qbs_ros.core.types import Frame
from dlsc_qbs_ros.pipeline.encoder import Encoder
from dlsc_qbs_ros.profiles import load_profile
from dlsc_qbs_ros.sim.simulation import IMAGE_PERIOD_NS, simulate_flight
import numpy as np

PROFILE = Path(__file__).parents[1] / 'config' / 'small_board.yaml'
N_REPORTS = 20
MAX_GROWTH_MB = 4.0
MAX_DRIFT = 1e-4


def images(view: ViewConfig) -> list[np.ndarray]:
    """Return the images of a simulated flight at twice the size of the view."""
    size = ViewConfig(width=2 * view.width, height=2 * view.height)
    return [make_view(frame.grey, size) for frame in simulate_flight(2, 0, 200.0).frames()]


def endless(flight: list[np.ndarray]) -> Iterator[Frame]:
    """Yield the flight round and round, each time in another light and further to the side."""
    k = 0
    while True:
        lap, i = divmod(k, len(flight))
        light = 1.0 + 0.4 * sin(0.7 * lap + 0.001 * k)
        image = np.roll(flight[i], 5 * lap, axis=1) * light
        yield Frame(k * IMAGE_PERIOD_NS, np.minimum(image, 255.0).astype(np.uint8))
        k += 1


def resident_mb() -> float:
    """Return the memory of this process that is in RAM."""
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') * 1e-6


def gram_drift(encoder: Encoder) -> float:
    """Return the largest deviation of G from Phi Phi^T, relative to its largest entry."""
    learner = encoder._learner
    atoms = learner.atoms_.astype(np.float64)
    expected = atoms @ atoms.T
    return float(np.abs(learner.gram_ - expected).max() / np.abs(expected).max())


def soak(config: Config, n_frames: int) -> list[str]:
    """Encode that many frames, report every twentieth of them, and return what went wrong."""
    encoder, frames = Encoder(config), endless(images(config.view))
    n, run_aways, worst_drift, is_finite, warm_mb = n_frames // N_REPORTS, 0, 0.0, True, None
    print('   frames  frames/s  RSS MB  lambda_max  epochs  run-aways  drift of G')
    for report in range(1, N_REPORTS + 1):
        started = time.perf_counter()
        for _ in range(n):
            result = encoder.process(next(frames))
            run_aways += result.ran_away
            is_finite &= bool(np.isfinite(result.code.values).all()
                              and np.isfinite([result.reprojection_error, result.surprise]).all())
        rate, drift = n / (time.perf_counter() - started), gram_drift(encoder)
        rss_mb = resident_mb()
        worst_drift, warm_mb = max(worst_drift, drift), warm_mb or rss_mb
        print(f'{report * n:9d} {rate:9.0f} {rss_mb:7.1f} {encoder.lambda_max:11.2f} '
              f'{result.epoch:7d} {run_aways:10d} {drift:11.1e}', flush=True)
    failures = []
    if rss_mb - warm_mb > MAX_GROWTH_MB:
        failures.append(f'memory grew by {rss_mb - warm_mb:.1f} MB')
    if not is_finite:
        failures.append('a code, reprojection error or surprise was not finite')
    if not worst_drift < MAX_DRIFT:
        failures.append(f'G drifted by {worst_drift:.1e} of its largest entry')
    return failures


def main() -> int:
    """Run the soak and say what failed."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--frames', type=int, default=1_000_000)
    parser.add_argument('--config', type=Path, default=PROFILE, help='a parameter file')
    parser.add_argument('--input', choices=('image', 'patches'), default='image')
    args = parser.parse_args()
    if args.frames < N_REPORTS:
        parser.error(f'--frames {args.frames}: expected at least {N_REPORTS}')
    config = Config().override({**load_profile(args.config), 'encoder.input': args.input})
    failures = soak(config, args.frames)
    print('; '.join(failures) or 'flat memory, finite state, G is that of Phi')
    return 1 if failures else 0


if __name__ == '__main__':
    sys.exit(main())
