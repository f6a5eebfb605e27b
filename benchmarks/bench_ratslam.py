"""
What an update of the map costs as the map grows, from 100 to 20,000 experiences.

A robot flies loop after loop through a made-up hall without end, each loop once and then a part
of it again, by an odometry that drifts. What it sees is a random function of where it is, smooth
over half a metre, so that places far apart look no more alike than chance has it. Every update is
a keyframe, which is the dear kind. `ms` are of CPU time of the thread that updates, less disturbed
by other programs than a clock on the wall; `wall ms` are by that clock.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import islice
import json
from math import inf, pi
from pathlib import Path
import time
from typing import Any, Callable, Iterator

from dlsc_qbs_ros.config import Config, ViewConfig
from dlsc_qbs_ros.core.geometry import compose
from dlsc_qbs_ros.core.types import Code, Dictionary, IDENTITY, OdometrySample, Pose2
from dlsc_qbs_ros.pipeline.code_book import CodeBook
from dlsc_qbs_ros.pipeline.mapper import Mapper
from dlsc_qbs_ros.pipeline.visual_gyro import VisualGyro
import numpy as np
from one_thread import start_again_in_one_thread

try:
    from dlsc_qbs_ros.ros.map_conversions import experience_map_to_cdr, path_to_cdr
except ImportError:  # no ROS here
    path_to_cdr = None

OUTPUT = Path(__file__).parent.parent / 'bench_output' / 'ratslam.json'

SIZES = (100, 1000, 5000, 20000)
# The updates that a size is measured by: those of this share of it before it is reached.
WINDOW = 0.2
MORE_UPDATES = 300
N_VALUES = 1280
SMOOTH_M, SMOOTH_RAD = 0.5, 0.4
STEP_M = 0.25
SIDES_M = 40.0, 15.0
AGAIN = 0.25
PERIOD_NS = 100_000_000
YAW_BIAS_RAD = 2e-4
SCALE = 1.01


class Hall:
    """What there is to see: rectified waves of position and heading."""

    def __init__(self, seed: int):
        rng = np.random.default_rng(seed)
        self._waves = rng.normal(size=(N_VALUES, 4)) / (
            SMOOTH_M, SMOOTH_M, SMOOTH_RAD, SMOOTH_RAD)
        self._phase = rng.uniform(0.0, 2 * pi, N_VALUES)

    def code(self, pose: Pose2) -> np.ndarray:
        """Return what is seen from a pose, an ndarray of N_VALUES float32, of length 1."""
        place = np.array([pose.x_m, pose.y_m, np.cos(pose.yaw_rad), np.sin(pose.yaw_rad)])
        values = np.maximum(np.cos(self._waves @ place + self._phase), 0.0)
        return (values / np.linalg.norm(values)).astype(np.float32)


def motions() -> Iterator[Pose2]:
    """Fly loops that share a side with the next, and the start of each a second time."""
    straight = [[Pose2(STEP_M, 0.0, 0.0)] * round(side_m / STEP_M) for side_m in SIDES_M]
    corner = [Pose2(STEP_M, 0.0, pi / 16)] * 8
    loop = 2 * (straight[0] + corner + straight[1] + corner)
    while True:
        yield from loop
        yield from loop[:round(AGAIN * len(loop))]
        yield from straight[0]


def flight(seed: int = 0) -> Iterator[tuple[OdometrySample, np.ndarray]]:
    """Return odometry that drifts and the codes, without end."""
    hall, truth, odometry = Hall(seed), IDENTITY, IDENTITY
    for k, motion in enumerate(motions()):
        truth = compose(truth, motion)
        odometry = compose(odometry, Pose2(
            SCALE * motion.x_m, 0.0, motion.yaw_rad + YAW_BIAS_RAD))
        yield OdometrySample(k * PERIOD_NS, odometry), hall.code(truth)


def timed(task: Callable, *arguments) -> tuple[float, float, Any]:
    """Return the CPU milliseconds of a call, those by the clock, and its result."""
    wall, cpu = time.perf_counter(), time.thread_time()
    result = task(*arguments)
    return 1e3 * (time.thread_time() - cpu), 1e3 * (time.perf_counter() - wall), result


def row(name: str, samples: list[tuple]) -> dict:
    """Return one line of the table."""
    ms, wall_ms = np.array([sample[:2] for sample in samples]).T
    return {'name': name, 'median_ms': float(np.median(ms)),
            'p99_ms': float(np.percentile(ms, 99)), 'worst_ms': float(ms.max()),
            'wall_median_ms': float(np.median(wall_ms)),
            'wall_p99_ms': float(np.percentile(wall_ms, 99)), 'updates': len(ms)}


def grow(mapper: Mapper, flown: Iterator) -> list[dict]:
    """Fly until the map is as large as can be; return the lines of all sizes."""
    samples, sizes = [], []
    while len(mapper.map) < SIZES[-1]:
        samples.append(timed(mapper.update, *next(flown)))
        sizes.append(len(mapper.map))
    return [row(f'{size} experiences', [
        sample for sample, now in zip(samples, sizes) if (1.0 - WINDOW) * size < now <= size])
        for size in SIZES]


def lost(mapper: Mapper, flown: Iterator) -> list[tuple]:
    """Return the times of updates that look for the robot all over the map, on new ground."""
    elsewhere, samples = flight(seed=1), []
    for _ in range(MORE_UPDATES):
        mapper.drift.anchor(inf, inf)
        (odometry, _), (_, code) = next(flown), next(elsewhere)
        samples.append(timed(mapper.update, odometry, code))
    return samples


def beside(mapper: Mapper, flown: Iterator, book: CodeBook) -> list[tuple]:
    """Return the times of updates while the book is re-encoded by another thread."""
    samples = []
    while book.missing(Code(0, np.zeros(0), 1)):
        samples.append(timed(mapper.update, *next(flown)))
        time.sleep(0.02)
        if len(samples) == MORE_UPDATES:
            book.cancel()
    return samples


def book_of(n_views: int, executor: ThreadPoolExecutor) -> CodeBook:
    """Return a code book that has begun to encode so many views."""
    config, rng = Config(), np.random.default_rng(0)
    atoms = rng.normal(size=(config.encoder.n_atoms, config.patches.size ** 2))
    atoms /= np.linalg.norm(atoms, axis=1, keepdims=True)
    book = CodeBook(config, executor, Mapper(config).cells_of)
    shape = n_views, config.view.height, config.view.width
    book.restore(rng.integers(0, 256, shape, np.uint8), [Dictionary(1, atoms.astype(np.float32))])
    return book


def turning(flown: Iterator) -> list[tuple]:
    """Return the times of telling the turn from one view to the next."""
    gyro, view, samples = VisualGyro(Config()), ViewConfig(), []
    for odometry, code in islice(flown, MORE_UPDATES):
        pixels = np.resize(np.uint8(255 * code / code.max()), (view.height, view.width))
        samples.append(timed(gyro.look, pixels, odometry))
    return samples


def publishing(mapper: Mapper) -> list[tuple]:
    """Return the times of making the messages of the whole map."""
    def build() -> int:
        graph = mapper.map
        return len(path_to_cdr(1, graph.poses, 'map')) + len(experience_map_to_cdr(
            1, graph.poses, graph.links, graph.links[graph.is_closure], 'map'))

    return [timed(build) for _ in range(20)]


def targets(cases: list[dict]) -> list[dict]:
    """Return the bounds of an update, and whether they are met."""
    small, large = cases[0], cases[len(SIZES) - 1]
    checks = [('growth of the median', large['median_ms'] / small['median_ms'], 3.0)]
    for case in cases[:len(SIZES) + 1]:
        checks += [(f'{case["name"]}: median ms', case['median_ms'], 5.0),
                   (f'{case["name"]}: p99 ms', case['p99_ms'], 33.0)]
    return [{'name': name, 'value': value, 'bound': bound, 'met': value <= bound}
            for name, value, bound in checks]


def main() -> None:
    """Print the table and write it to bench_output/ratslam.json."""
    mapper, flown = Mapper(Config()), flight()
    cases = grow(mapper, flown)
    cases.append(row(f'{SIZES[-1]}, lost', lost(mapper, flown)))
    with ThreadPoolExecutor(1) as executor:
        cases.append(row(f'{SIZES[-1]}, beside re-encoding',
                         beside(mapper, flown, book_of(2000, executor))))
    cases.append(row('a turn told by two views', turning(flight())))
    if path_to_cdr is not None:
        cases.append(row(f'{SIZES[-1]}, making path and markers', publishing(mapper)))
    print(f'{"":34s} {"median ms":>9s} {"p99 ms":>7s} {"worst":>7s} {"wall ms":>8s} '
          f'{"p99":>7s} {"updates":>7s}')
    for case in cases:
        print(f'{case["name"]:34s} {case["median_ms"]:9.2f} {case["p99_ms"]:7.2f} '
              f'{case["worst_ms"]:7.2f} {case["wall_median_ms"]:8.2f} '
              f'{case["wall_p99_ms"]:7.2f} {case["updates"]:7d}')
    met = targets(cases)
    print()
    for target in met:
        print(f'{target["name"]:34s} {target["value"]:9.2f} {target["bound"]:7g} '
              f'{"met" if target["met"] else "MISSED"}')
    OUTPUT.parent.mkdir(exist_ok=True)
    OUTPUT.write_text(json.dumps({'cases': cases, 'targets': met}, indent=1))


if __name__ == '__main__':
    start_again_in_one_thread()
    main()
