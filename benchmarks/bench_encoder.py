"""
What a frame costs the encoder, beside its floor and its peers, on one simulated flight.

The floor is one product of the dictionary and an input vector by BLAS: whatever an encoder of
this kind does, it must read its dictionary once. All cases take the same frames, in turns, in one
process on one thread, so each finds the caches as the others left them, and a busy machine slows
all alike. The flight is flown three times over, which gives every frame the same work three
times; a frame's time is the median of these. Times are CPU time, less disturbed by other programs
than a clock on the wall; on an idle machine they are the same. Of a case, the table gives the mean
over the frames, `ms`, and that mean, the median and the worst frame in products of the floor.
"""

from __future__ import annotations

import json
import time
from typing import Any, Callable, Mapping

import cv2
from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core import kernel
from dlsc_qbs_ros.core.local_view import Cosine, ViewCells
from dlsc_qbs_ros.core.preprocessing import make_view, PixelInput
from dlsc_qbs_ros.core.sequence import SequenceScore
from dlsc_qbs_ros.core.types import Frame
from dlsc_qbs_ros.pipeline.coder import Coder
from dlsc_qbs_ros.pipeline.encoder import Encoded, Encoder
from dlsc_qbs_ros.sim.simulation import simulate_flight
from encoder_cases import (
    all_tasks, floor, MiniBatchDictionaryLearning, ours, ROOT, Task, variants, with_view)
import numpy as np
from one_thread import start_again_in_one_thread

OUTPUT = ROOT / 'bench_output' / 'encoder.json'

SECONDS = 60.0
PASSES = 3
VIEW = (346, 260)
# The slow cases see one frame in so many.
EVERY = {'literal': 3, 'vgg11_forward': 100, 'sklearn_partial_fit': 100}

GROWTH_FRAMES = 200
VIEWS = ((43, 32), (87, 65), (173, 130), (346, 260))
ATOMS = (16, 32, 64, 128, 256)
STORED = (100, 1000, 10000)

# Seconds of a step, and for our own what was done with the frame.
Sample = tuple[float, str]


def kind(result: Any) -> str:
    """Return what our encoder did with a frame, beside coding it."""
    if not isinstance(result, Encoded):
        return ''
    if result.dictionary is not None:
        return 'epoch'
    return 'learning' if result.learned else 'not_learning'


def timed(task: Callable, *arguments) -> tuple[float, Any]:
    """Return the CPU seconds of a call and its result."""
    started = time.process_time()
    result = task(*arguments)
    return time.process_time() - started, result


def interleave(tasks: Mapping[str, Task], frames: list[Frame], config: Config
               ) -> dict[str, list[Sample]]:
    """
    Give every frame to every task and return the seconds and kinds of its steps.

    Their order changes with every frame, so that no task always finds the caches of another.
    """
    rng = np.random.default_rng(0)
    samples: dict[str, list[Sample]] = {name: [] for name in tasks}
    for i, frame in enumerate(frames):
        view = make_view(frame.grey, config.view)
        inputs = np.asarray(PixelInput(view, config.view.standardise))
        for name in rng.permutation(list(tasks)).tolist():
            if i % EVERY.get(name, 1) == 0:
                seconds, result = timed(tasks[name], frame, inputs)
                samples[name].append((seconds, kind(result)))
    return samples


def over_passes(passes: list[list[Sample]]) -> list[Sample]:
    """Return each frame's median over the passes, which all did the same to it."""
    return [(float(np.median([seconds for seconds, _ in turns])), turns[0][1])
            for turns in zip(*passes)]


def measure(make_tasks: Callable[[], dict[str, Task]], frames: list[Frame], config: Config
            ) -> dict[str, list[Sample]]:
    """Return the seconds and kind of every step of the tasks, made anew for each pass."""
    passes = [interleave(make_tasks(), frames, config) for _ in range(PASSES)]
    return {name: over_passes([samples[name] for samples in passes]) for name in passes[0]}


def mean_s(samples: list[Sample]) -> float:
    """Return the mean of the samples, in seconds."""
    return float(np.mean([seconds for seconds, _ in samples]))


def row(name: str, samples: list[Sample], floor_s: float) -> dict:
    """Return one line of the table."""
    seconds = np.array([elapsed for elapsed, _ in samples])
    mean_ratio, median_ratio, worst_ratio = (
        float(statistic(seconds)) / floor_s for statistic in (np.mean, np.median, np.max))
    return {'name': name, 'ms': 1e3 * floor_s * mean_ratio, 'ratio': mean_ratio,
            'median_ratio': median_ratio, 'worst_ratio': worst_ratio, 'frames': len(samples)}


def rows(samples: Mapping[str, list[Sample]]) -> list[dict]:
    """Return the lines of all cases, our own also by what was done with the frame."""
    floor_s = mean_s(samples['floor'])
    table = []
    for name, taken in samples.items():
        table.append(row(name, taken, floor_s))
        for part in ('learning', 'not_learning', 'epoch') if name in variants() else ():
            some = [sample for sample in taken if sample[1] == part]
            table += [row(f'{name}_{part}', some, floor_s)] if some else []
    return table


def growth(frames: list[Frame], config: Config) -> list[dict]:
    """Return the lines of our step at another size, as ratios to the floor of that size."""
    samples = measure(
        lambda: {'floor': floor(config),
                 **{name: ours(config, variant) for name, variant in variants().items()}},
        frames, config)
    floor_s = mean_s(samples['floor'])
    size = f'{config.view.width}x{config.view.height}_{config.encoder.n_atoms}_atoms'
    return [{**row(f'{name}_{size}', samples[name], floor_s), 'floor_ms': 1e3 * floor_s}
            for name in variants()]


def stored_views(frames: list[Frame], floor_s: float) -> list[dict]:
    """Return the lines of stored views: one match of a code, one whole re-encoding."""
    config = with_view(43, 32)
    encoded = list(map(Encoder(config).process, frames))
    dictionary = [one.dictionary for one in encoded if one.dictionary][-1]
    table = []
    for n_views in STORED:
        views = [encoded[i % len(encoded)].view.pixels for i in range(n_views)]
        coder = Coder(dictionary, config)
        reencoding = [[(timed(coder.encode_views, views)[0], '')] for _ in range(PASSES)]
        codes = coder.encode_views(views)
        matching = [matches(codes, config) for _ in range(PASSES)]
        table += [row(f'match_{n_views}_views', over_passes(matching), floor_s),
                  row(f'reencode_{n_views}_views', over_passes(reencoding), floor_s)]
    return table


def matches(codes: np.ndarray, config: Config) -> list[Sample]:
    """Return the seconds of comparing one code, in its sequence, with all stored ones."""
    cells = ViewCells(Cosine())
    cells.replace(codes)
    length = config.ratslam.sequence_length
    score = SequenceScore(length)
    samples = [(timed(lambda code: score.update(cells.likeness(code)), code)[0], '')
               for code in codes[:100]]
    return samples[length:]  # before, there was no sequence to compare


def targets(cases: list[dict]) -> list[dict]:
    """Return the targets of our step, in ratios to the floor and ms, and whether they are met."""
    by_name = {case['name']: case for case in cases}
    bounds = {'dlsc_qbs': 2.2, 'dlsc_qbs_compiled': 1.3}
    checks = []
    for name in variants():
        checks += [(f'{name} products', by_name[name]['ratio'], 'at most', bounds[name]),
                   (f'{name} worst products', by_name[name]['worst_ratio'], 'at most', 15.0)]
        checks += [(f'{name}_{small} ms', by_name[f'{name}_{small}']['ms'], 'at most', 1.0)
                   for small in ('87x65', '43x32', 'small_board')]
        checks += [(f'literal / {name}', by_name['literal']['ms'] / by_name[name]['ms'],
                    'at least', 8.0)]
    return [{'name': name, 'value': value, 'bound': f'{side} {bound:g}',
             'met': value <= bound if side == 'at most' else value >= bound}
            for name, value, side, bound in checks]


def print_rows(title: str, table: list[dict]) -> None:
    """Print lines of the table under a heading."""
    print(f'\n{title:38s} {"ms":>9s} {"products":>9s} {"median":>8s} {"worst":>8s} {"frames":>7s}')
    for line in table:
        print(f'{line["name"]:38s} {line["ms"]:9.3f} {line["ratio"]:9.2f} '
              f'{line["median_ratio"]:8.2f} {line["worst_ratio"]:8.2f} {line["frames"]:7d}')


def main() -> None:
    """Print the table and write it to bench_output/encoder.json."""
    cv2.setNumThreads(1)
    if kernel.LIBRARY is None:
        print('the compiled kernel is not built here: no rows for it')
    if MiniBatchDictionaryLearning is None:
        print('scikit-learn is not installed: no row for its partial_fit')
    config = with_view(*VIEW)
    frames = list(simulate_flight(2, 0, SECONDS).frames())
    cases = rows(measure(lambda: all_tasks(config), frames, config))
    print_rows(f'{len(frames)} frames, view {VIEW[0]}x{VIEW[1]}', cases)
    sizes = [with_view(*size) for size in VIEWS] + [with_view(87, 65, n_atoms=n) for n in ATOMS]
    over_sizes = [line for size in sizes for line in growth(frames[:GROWTH_FRAMES], size)]
    print_rows('by size, over the floor of that size', over_sizes)
    over_views = stored_views(frames, 1e-3 * cases[0]['ms'])
    print_rows('by stored views', over_views)
    met = targets(cases)
    print()
    for target in met:
        print(f'{target["name"]:38s} {target["value"]:9.2f} {target["bound"]:>14s} '
              f'{"met" if target["met"] else "MISSED"}')
    OUTPUT.parent.mkdir(exist_ok=True)
    OUTPUT.write_text(json.dumps({'floor_ms': cases[0]['ms'], 'cases': cases, 'targets': met,
                                  'growth': over_sizes + over_views}, indent=1))


if __name__ == '__main__':
    start_again_in_one_thread()
    main()
