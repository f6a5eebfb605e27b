"""
What a frame costs in each part of the pipeline, on one simulated flight.

Machines differ: each part is also given as a ratio to one product of the dictionary and the
input vector by BLAS, the least that any encoder of this kind must do, measured in the same run.
"""

from __future__ import annotations

import time

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import GroundTruthSample
from dlsc_qbs_ros.pipeline.encoder import Encoder
from dlsc_qbs_ros.pipeline.runner import encode, map_codes
from dlsc_qbs_ros.sim.simulation import simulate_flight
import numpy as np

SECONDS = 60.0
VIEWS = ((43, 32), (87, 65), (346, 260))


def timed(task, items) -> float:
    """Return the median time of a task over items, in milliseconds."""
    times = []
    for item in items:
        started = time.perf_counter()
        task(item)
        times.append(time.perf_counter() - started)
    return 1e3 * float(np.median(times))


def floor_ms(width: int, height: int, n_atoms: int) -> float:
    """Return the time of one product of a dictionary and an input vector."""
    rng = np.random.default_rng(0)
    atoms = rng.normal(size=(n_atoms, width * height)).astype(np.float32)
    return timed(lambda view: atoms @ view, rng.normal(
        size=(100, width * height)).astype(np.float32))


def main() -> None:
    """Print the table."""
    flight = simulate_flight(2, 0, SECONDS)
    started = time.perf_counter()
    frames = list(flight.frames())
    rendering_ms = 1e3 * (time.perf_counter() - started) / len(frames)
    print(f'{"part":34s} {"ms/frame":>9s} {"products":>9s}')
    print(f'{"simulate: render 346x260":34s} {rendering_ms:9.2f}')
    for width, height in VIEWS:
        config = Config().override({
            'encoder.input': 'image', 'view.width': width, 'view.height': height})
        product_ms = floor_ms(width, height, config.encoder.n_atoms)
        encoder_ms = timed(Encoder(config).process, frames)
        print(f'{f"encode: view {width}x{height}":34s} {encoder_ms:9.2f} '
              f'{encoder_ms / product_ms:9.1f}')
    config = Config()
    encoder_ms = timed(Encoder(config).process, frames)
    print(f'{"encode: patches of a view 43x32":34s} {encoder_ms:9.2f}')
    encoded = encode((event for event in flight.events(iter(frames))
                      if not isinstance(event, GroundTruthSample)), config)
    result = map_codes(encoded, config)
    mapping_ms = 1e3 * (result.seconds - encoded.seconds) / len(result.stamps_ns)
    print(f'{"map: odometry, code and relaxation":34s} {mapping_ms:9.2f}')


if __name__ == '__main__':
    main()
