"""One flight through one method: what a process of `evaluate` is given to do."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
import time
from typing import Any, Iterable, Iterator

from tqdm import tqdm

from .methods import Method, METHODS, Source
from ..config import Config, MavlinkConfig
from ..core.types import Dictionary, Frame, GroundTruthSample
from ..errors import DlscQbsError, RecordingError
from ..evaluation.closures import false_closures
from ..evaluation.metrics import evaluate_run
from ..evaluation.place_recognition import Recognition, recognise
from ..evaluation.table import Outcome, Row, Run
from ..io.flight import read_flight
from ..pipeline.coder import Coder
from ..pipeline.encoder import DescriptorEncoder, Encoded, Encoder, FrameEncoder
from ..pipeline.mapper import Mapper
from ..pipeline.runner import encode, EncodedFlight, map_codes, RunResult

TUNE = 'tune'


@dataclass(frozen=True)
class Flight:
    """A recording: what it is called, where it lies, its topics where they are given."""

    name: str
    path: Path
    image_topic: str | None = None
    odom_topic: str | None = None
    ground_truth_topic: str | None = None
    tlog: Path | None = None

    def events(self, refused: Counter[str] | None = None,
               mavlink: MavlinkConfig = MavlinkConfig()) -> Iterator:
        """Read it; see `read_flight`."""
        return read_flight(self.path, self.image_topic, self.odom_topic,
                           self.ground_truth_topic, refused, self.tlog, mavlink)


@dataclass(frozen=True)
class Job:
    """
    One flight through one method, once for each mu.

    A mu is a number, None for the row's own, or `TUNE` for the one of least MAE_L.
    """

    flight: Flight
    method: str
    config: Config
    thresholds: tuple[float | str | None, ...] = (None,)
    network: Path | None = None
    shows_progress: bool = False


class _Timed:
    """An encoder and the time it takes."""

    def __init__(self, encoder: FrameEncoder):
        self._encoder = encoder
        self.seconds = 0.0

    def process(self, frame: Frame) -> Encoded:
        """Encode one frame; see `FrameEncoder`."""
        started = time.perf_counter()
        encoded = self._encoder.process(frame)
        self.seconds += time.perf_counter() - started
        return encoded


@dataclass(frozen=True)
class _Encoded:
    """The flight of a job after its encoder, beside what only ground truth tells."""

    job: Job
    flight: EncodedFlight
    measure: Any
    truth: list[GroundTruthSample]
    refused: Counter[str]
    encode_s: float
    results: dict[Config, RunResult] = field(default_factory=dict)

    @property
    def method(self) -> Method:
        """Return the method of the job."""
        return METHODS[self.job.method]

    @property
    def direction(self) -> int:
        """Return that of the measure: by default codes are compared by cosine."""
        return 1 if self.measure is None else self.measure.direction

    def configured(self, threshold: float | None) -> Config:
        """Return the configuration for one mu."""
        return self.method.configured(self.job.config, self.direction, threshold)

    def mapped(self, config: Config) -> RunResult:
        """Take the flight through the back end, once for each configuration."""
        if config not in self.results:
            self.results[config] = map_codes(self.flight, config, self.measure)
        return self.results[config]


def run_job(job: Job) -> Outcome:
    """
    Read and encode the flight of a job once, map it with each mu, and recognise its places.

    Raises
    ------
    DlscQbsError
        Whatever is wrong with the flight or the network; its message names the flight.

    """
    try:
        encoded = _encoded(job)
        runs = [_run(encoded, threshold) for threshold in job.thresholds]
        return Outcome(runs, *_recognitions(encoded))
    except DlscQbsError as error:
        if str(job.flight.path) in str(error):
            raise
        raise type(error)(f'{job.flight.path}: {error}') from error


def _encoded(job: Job) -> _Encoded:
    method, measure = METHODS[job.method], None
    config = job.config.override(method.overrides)
    if method.make is None:
        encoder = _Timed(Encoder(config))
    else:
        describe, measure = method.make(Source(job.network, job.flight.events))
        encoder = _Timed(DescriptorEncoder(describe, config.view))
    truth: list[GroundTruthSample] = []
    refused: Counter[str] = Counter()
    flight = encode(_sensed(job, truth, refused), config, encoder)
    return _Encoded(job, flight, measure, truth, refused, encoder.seconds)


def _sensed(job: Job, truth: list[GroundTruthSample], refused: Counter[str]) -> Iterator:
    """Pass on what a drone would sense, put ground truth aside, show the progress."""
    with _shown(None, job, ' frames') as bar:
        for event in job.flight.events(refused, job.config.mavlink):
            if isinstance(event, GroundTruthSample):
                truth.append(event)
                continue
            bar.update(isinstance(event, Frame))
            yield event


def _shown(items: Iterable | None, job: Job, unit: str) -> tqdm:
    return tqdm(items, f'{job.flight.name} {job.method}', unit=unit, leave=False,
                disable=None if job.shows_progress else True)


def _run(encoded: _Encoded, threshold: float | str | None) -> Run:
    """Map the flight with one mu, or with the best."""
    job, is_tuned = encoded.job, threshold == TUNE and bool(encoded.method.grid)
    if threshold == TUNE:
        threshold = _best_threshold(encoded) if is_tuned else None
    config = encoded.configured(threshold)
    result = encoded.mapped(config)
    counts = result.counts
    if not len(result.stamps_ns):
        raise RecordingError('expected odometry before and after some of the frames, found none: '
                             f'{counts["frames"]} frames, no pose')
    used = encoded.direction * config.ratslam.threshold if encoded.method.grid else None
    row = Row(
        job.flight.name, job.method, evaluate_run(result, encoded.truth), used, is_tuned,
        false_closures(result, encoded.truth), len(result.stamps_ns), counts, encoded.refused,
        encoded.encode_s, result.seconds - encoded.flight.seconds)
    return Run(row, result)


def _best_threshold(encoded: _Encoded) -> float:
    """Return the mu of least MAE_L, as the paper tunes it; of equals, the strictest."""
    if not encoded.truth:
        raise RecordingError('--threshold tune: expected ground truth, found none')

    def error_m(threshold: float) -> float:
        metrics = evaluate_run(encoded.mapped(encoded.configured(threshold)), encoded.truth)
        if metrics is None:
            raise RecordingError('--threshold tune: ground truth and codes share no time')
        return metrics.mae_l

    return min(_shown(encoded.method.grid, encoded.job, ' thresholds'), key=error_m)


def _recognitions(encoded: _Encoded) -> tuple[Recognition | None, Recognition | None]:
    """Return how well places were recognised, as it flew and under the last dictionary."""
    if not encoded.method.grid:
        return None, None
    config = encoded.job.config.override(encoded.method.overrides)

    def codes_of(dictionary: Dictionary, views: list) -> Any:
        return Coder(dictionary, config).encode_views(views)

    def recognition(under_last: bool) -> Recognition | None:
        book = Mapper(config, encoded.measure).view_cells
        return recognise(encoded.flight.events, encoded.truth, book, codes_of, under_last)

    return recognition(False), recognition(True) if encoded.flight.counts['epochs'] else None
