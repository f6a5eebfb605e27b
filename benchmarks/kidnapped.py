"""
Two flights joined by a jump: the drone is carried away in mid-flight, and its encoder starts anew.

Flies both apart, then one after the other, and prints MAE_L and MAE_M of each, how far the drone
flew until it knew where it was, whether that was true, and what joins the two pieces of the map.
With `--foreign` the second flight is of another world: exits 1 when anything was recognised there,
else when the pieces were not joined or MAE_M is more than 20 % above that of the flights apart.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
import sys

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import Code, GroundTruthSample, OdometrySample
from dlsc_qbs_ros.evaluation.association import associate
from dlsc_qbs_ros.evaluation.metrics import evaluate_run, Metrics
from dlsc_qbs_ros.io.flight import read_flight
from dlsc_qbs_ros.pipeline.runner import encode, EncodedFlight, map_codes, RunResult
import numpy as np

PAUSE_NS = 1_000_000_000
MAX_RATIO = 1.2


def read(path: Path) -> tuple[EncodedFlight, list[GroundTruthSample]]:
    """Return an encoded flight and its ground truth."""
    events = [*read_flight(path)]
    truth = [event for event in events if isinstance(event, GroundTruthSample)]
    return encode((event for event in events if not isinstance(event, GroundTruthSample)),
                  Config()), truth


def later(event, shift_ns: int):
    """Return an event at another time, its odometry in another segment."""
    event = replace(event, stamp_ns=event.stamp_ns + shift_ns)
    if isinstance(event, OdometrySample):
        return replace(event, segment=event.segment + 1)
    if isinstance(event, Code):
        return replace(event, dictionary_ns=event.dictionary_ns + shift_ns)
    return event


def judge(name: str, result: RunResult, truth: list[GroundTruthSample]) -> Metrics:
    """Print and return the figures, aligned on the final map: nobody aligns on what is lost."""
    metrics = evaluate_run(replace(result, poses=result.final_poses), truth)
    online = evaluate_run(result, truth)
    print(f'{name:8s} MAE_L {online.mae_l:.3f} m, of the final map: MAE_L {metrics.mae_l:.3f} m, '
          f'MAE_M {metrics.mae_m:.3f} m; {len(result.experiences)} experiences, '
          f'{len(result.closures)} closures')
    return metrics


def joints(result: RunResult, jump_ns: int, truth: list[GroundTruthSample]) -> np.ndarray:
    """Return how far apart the ends of each link between the two flights truly are, in metres."""
    stamps_ns = result.stamps_ns[result.births]
    is_second = stamps_ns[result.links] >= jump_ns
    links = result.links[is_second[:, 0] != is_second[:, 1]]
    places = associate(stamps_ns, truth)[links][:, :, :2]
    return np.hypot(*(places[:, 0] - places[:, 1]).T)


def main() -> int:
    """Fly; return 1 when it is not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('first', type=Path)
    parser.add_argument('second', type=Path)
    parser.add_argument('--foreign', action='store_true')
    args = parser.parse_args()
    (first, first_truth), (second, second_truth) = read(args.first), read(args.second)
    shift_ns = (max(event.stamp_ns for event in first.events) + PAUSE_NS
                - min(event.stamp_ns for event in second.events))
    moved_truth = [later(sample, shift_ns) for sample in second_truth]
    apart = [judge('first', map_codes(first, Config()), first_truth),
             judge('second', map_codes(second, Config()), second_truth)]
    both = map_codes(replace(first, events=[*first.events, *(
        later(event, shift_ns) for event in second.events)]), Config())
    metrics = judge('joined', both, first_truth + moved_truth)
    jump_ns = second.events[0].stamp_ns + shift_ns
    off_m = joints(both, jump_ns, first_truth + moved_truth)
    is_lost = (both.stamps_ns >= jump_ns) & np.isinf(both.sigmas[:, 0])
    steps_m = np.hypot(*np.diff(both.odometry[is_lost, :2], axis=0).T)
    print(f'lost for {is_lost.sum()} codes, {steps_m.sum():.1f} m; {len(off_m)} links join the '
          f'two, between places at most {np.max(off_m, initial=0.0):.1f} m apart')
    if args.foreign:
        return int(len(off_m) > 0)
    expected = np.average([each.mae_m for each in apart], weights=[each.frames for each in apart])
    print(f'MAE_M {metrics.mae_m / expected:.2f} of the mean of the two apart')
    return int(not len(off_m) or metrics.mae_m > MAX_RATIO * expected)


if __name__ == '__main__':
    sys.exit(main())
