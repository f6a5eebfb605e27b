"""A recorded flight through encoder and ratslam, in recorded order, without ROS."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import inf
import time
from typing import Iterable, Iterator

import numpy as np

from .encoder import Encoder, FrameEncoder
from .odometry import OdometryNormaliser
from .ratslam import RatSlam
from ..config import Config
from ..core.geometry import compose
from ..core.local_view import Measure
from ..core.types import Code, Dictionary, Frame, OdometrySample, RawOdometry, View
from ..errors import ImageError, StampError


@dataclass(frozen=True)
class RunResult:
    """
    What a flight left behind; n codes were used, m experiences stand at the end.

    Attributes
    ----------
    stamps_ns : ndarray of shape (n,), int64
    poses : ndarray of shape (n, 3)
        x, y in metres and yaw in radians at each code's stamp, as the map stood when that code
        was processed.
    sigmas : ndarray of shape (n, 2)
        Their deviations, of the position in metres and of the yaw in radians.
    final_poses : ndarray of shape (n, 3)
        The same, as the map stands at the end.
    odometry : ndarray of shape (n, 3)
        The odometry pose at each code's stamp.
    experiences : ndarray of shape (m, 3)
    births : ndarray of shape (m,), int64
        The code, of the n, at which each experience was made.
    links : ndarray of shape (l, 2), int64
        Indices of the experiences that each link joins.
    closures : ndarray of shape (c, 2), int64
        Indices of the experiences joined by loop closures.
    closure_motions : ndarray of shape (c, 3)
        The second in the frame of the first, as each closure has it.
    counts : dict
        frames, view_cells, experiences, closures, learning_frames, epochs and what was refused.
    seconds : float
        Wall time of the run.

    """

    stamps_ns: np.ndarray
    poses: np.ndarray
    sigmas: np.ndarray
    final_poses: np.ndarray
    odometry: np.ndarray
    experiences: np.ndarray
    births: np.ndarray
    links: np.ndarray
    closures: np.ndarray
    closure_motions: np.ndarray
    counts: dict[str, int]
    seconds: float


@dataclass(frozen=True)
class EncodedFlight:
    """A flight after the encoder: what reaches ratslam, in order."""

    events: list[OdometrySample | Dictionary | View | Code]
    counts: dict[str, int]
    seconds: float


def run(events: Iterable[Frame | RawOdometry], config: Config) -> RunResult:
    """Take a flight through encoder and ratslam."""
    return map_codes(encode(events, config), config)


def encode(events: Iterable[Frame | RawOdometry], config: Config,
           encoder: FrameEncoder | None = None) -> EncodedFlight:
    """Take a flight through DLSC-QBS or another encoder, once for any number of `map_codes`."""
    started = time.perf_counter()
    counts = Counter(frames=0, learning_frames=0, epochs=0)
    encoded = list(_encode(events, config, encoder or Encoder(config), counts))
    return EncodedFlight(encoded, counts, time.perf_counter() - started)


def _encode(events: Iterable[Frame | RawOdometry], config: Config, encoder: FrameEncoder,
            counts: Counter[str]) -> Iterator[OdometrySample | Dictionary | View | Code]:
    normaliser = OdometryNormaliser(config.odometry)
    for event in events:
        if isinstance(event, RawOdometry):
            sample = normaliser.accept(event)
            if sample is not None:
                yield sample
            continue
        try:
            result = encoder.process(event)
        except (ImageError, StampError):
            counts['frames_refused'] += 1
            continue
        counts['frames'] += 1
        counts['learning_frames'] += result.learned
        counts['run_aways'] += result.ran_away
        if result.dictionary is not None:
            counts['epochs'] += 1
            yield result.dictionary
        yield result.view
        yield result.code
    counts.update(normaliser.counts)


def map_codes(flight: EncodedFlight, config: Config, measure: Measure | None = None
              ) -> RunResult:
    """Take an encoded flight through ratslam; codes are compared by cosine or another measure."""
    started = time.perf_counter()
    track: list[tuple] = []
    ratslam = RatSlam(config, measure=measure, on_update=lambda mapper: track.append(
        (mapper.odometry, mapper.pose(), mapper.place, mapper.sigmas())))
    add = {OdometrySample: ratslam.add_odometry, Dictionary: ratslam.add_dictionary,
           View: ratslam.add_view, Code: ratslam.add_code}
    for event in flight.events:
        add[type(event)](event)
        ratslam.advance(0.0)
    ratslam.advance(inf)
    return _result(ratslam, track, flight, time.perf_counter() - started)


def _result(ratslam: RatSlam, track: list[tuple], flight: EncodedFlight, seconds: float
            ) -> RunResult:
    mapper = ratslam.mapper
    closures, motions = (rows[mapper.map.is_closure]
                         for rows in (mapper.map.links, mapper.map.motions))
    counts = {**ratslam.counts, **flight.counts,
              'view_cells': len(mapper.view_cells),
              'experiences': len(mapper.map), 'closures': len(closures),
              'closures_undone': mapper.undone}
    return RunResult(
        stamps_ns=np.array([odometry.stamp_ns for odometry, *_ in track], np.int64),
        poses=_rows((pose for _, pose, _, _ in track), 3),
        sigmas=_rows((sigmas for *_, sigmas in track), 2),
        final_poses=_rows((compose(mapper.map.pose(place.experience), place.offset)
                           for _, _, place, _ in track), 3),
        odometry=_rows((odometry.pose for odometry, *_ in track), 3),
        experiences=mapper.map.poses.copy(),
        births=np.unique([place.experience for _, _, place, _ in track], return_index=True)[1],
        links=mapper.map.links.copy(),
        closures=closures, closure_motions=motions, counts=counts,
        seconds=flight.seconds + seconds)


def _rows(rows: Iterable, width: int) -> np.ndarray:
    return np.array(list(rows), float).reshape(-1, width)
