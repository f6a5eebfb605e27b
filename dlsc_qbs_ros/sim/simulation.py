"""A simulated flight as a stream of stamped values, like a recording of a real one."""

from __future__ import annotations

from dataclasses import dataclass
import heapq
from math import ceil
from typing import Iterator

import cv2
import numpy as np

from .camera import Camera
from .flight import beacons, drift, Trajectory, twists, WAYPOINTS_M
from .schedule import lamps, Schedule
from .variations import PLAIN, Variations
from .world import make_world
from ..core.geometry import wrap_angle
from ..core.types import Frame, GroundTruthSample, OdometrySample, Pose2, RawOdometry
from ..errors import ConfigError

EPOCH_NS = 1_700_000_000_000_000_000
DEFAULT_SECONDS = {1: 150.0, 2: 160.0, 3: 250.0}
SECONDS_RANGE = (1.0, 3600.0)
FLIGHTS_IN_AISLES = (2, 3)

ODOMETRY_PERIOD_NS = 20_000_000
IMAGE_PERIOD_NS = 100_000_000
GROUND_TRUTH_PERIOD_NS = 50_000_000
IMAGE_PHASE_NS = 7_000_000
GROUND_TRUTH_PHASE_NS = 13_000_000


@dataclass(frozen=True)
class Picture:
    """A colour image of the camera: `rgb` is a uint8 ndarray of shape (height, width, 3)."""

    stamp_ns: int
    rgb: np.ndarray


@dataclass(frozen=True)
class SimulatedFlight:
    """
    What a flight's sensors saw; pictures are rendered as they are asked for.

    Attributes
    ----------
    flight, seed : int
    variations : Variations
        What happens besides laps.
    trajectory : Trajectory
        The truth.
    image_stamps_ns : ndarray of shape (n,), int64
    odometry : tuple of RawOdometry
        Drifting, from the origin (`flight.drift`).
    ground_truth : tuple of GroundTruthSample
        In the hall's frame, noisy (`flight.beacons`).

    """

    flight: int
    seed: int
    variations: Variations
    trajectory: Trajectory
    image_stamps_ns: np.ndarray
    odometry: tuple[RawOdometry, ...]
    ground_truth: tuple[GroundTruthSample, ...]

    def pictures(self) -> Iterator[Picture]:
        """Render the flight in colour; every call gives the same pixels."""
        world = make_world(self.seed, self.variations.twin_aisle)
        camera = Camera(world, [self.seed, self.flight, 3])
        times_s = _seconds(self.image_stamps_ns)
        poses = self.trajectory.poses(times_s)
        shares = lamps(times_s, self.variations.dimmed_to).tolist()
        for stamp_ns, pose, share in zip(self.image_stamps_ns.tolist(), poses, shares):
            yield Picture(stamp_ns, camera.render(pose, share))

    def frames(self) -> Iterator[Frame]:
        """Render the flight in grey."""
        for picture in self.pictures():
            yield Frame(picture.stamp_ns, cv2.cvtColor(picture.rgb, cv2.COLOR_RGB2GRAY))

    def events(self, images: Iterator[Frame] | Iterator[Picture]) -> Iterator:
        """Merge `frames()` or `pictures()` with odometry and ground truth, in stamp order."""
        return heapq.merge(images, self.odometry, self.ground_truth, key=_stamp_ns)


def simulate_flight(flight: int, seed: int, seconds: float | None = None,
                    variations: Variations = PLAIN) -> SimulatedFlight:
    """
    Fly one of the paper's three flights through the warehouse of a seed.

    Parameters
    ----------
    flight : int
        1 between wall and shelves, 2 between shelves only, 3 both.
    seed : int
        Not negative; the same seed gives the same bytes.
    seconds : float, optional
        Duration; by default enough for three laps and a bit, for all stops, and for a fourth lap
        where one of the three is unlike the others.
    variations : Variations
        What happens besides laps. All of it comes to pass: a duration too short is refused.

    Raises
    ------
    ConfigError
        If one of them is out of range.

    """
    if flight not in WAYPOINTS_M:
        raise ConfigError(f'flight = {flight}: expected one of 1, 2, 3')
    if seed < 0:
        raise ConfigError(f'seed = {seed}: expected at least 0')
    if variations.twin_aisle and flight not in FLIGHTS_IN_AISLES:
        raise ConfigError(f'flight = {flight}: expected one of 2, 3, which pass the twin aisle')
    trajectory = Trajectory(flight, np.random.default_rng([seed, flight, 0]), variations)
    seconds = _checked_seconds(seconds, flight, trajectory.schedule)
    return SimulatedFlight(
        flight, seed, variations, trajectory, _stamps(seconds, IMAGE_PERIOD_NS, IMAGE_PHASE_NS),
        _odometry(trajectory, seconds, np.random.default_rng([seed, flight, 1])),
        _ground_truth(trajectory, seconds, np.random.default_rng([seed, flight, 2])))


def _checked_seconds(seconds: float | None, flight: int, schedule: Schedule) -> float:
    """Return the duration, the default one where none is given."""
    if seconds is None:
        seconds = float(ceil(DEFAULT_SECONDS[flight] + schedule.extra_s))
    low, high = SECONDS_RANGE
    if not low <= seconds <= high:
        raise ConfigError(f'seconds = {seconds}: expected a value in [{low:g}, {high:g}]')
    if seconds < schedule.complete_s:
        raise ConfigError(f'seconds = {seconds}: expected at least '
                          f'{ceil(schedule.complete_s)} for all that was asked to happen')
    return seconds


def _odometry(trajectory, seconds, rng) -> tuple[RawOdometry, ...]:
    stamps_ns = _stamps(seconds, ODOMETRY_PERIOD_NS, 0)
    times_s = _seconds(stamps_ns)
    poses = drift(times_s, trajectory.poses(times_s), rng)
    return tuple(
        RawOdometry(OdometrySample(stamp_ns, Pose2(x, y, wrap_angle(yaw)), z, roll, pitch), *twist)
        for stamp_ns, (x, y, z, roll, pitch, yaw), twist in zip(
            stamps_ns.tolist(), poses.tolist(), twists(times_s, poses).tolist()))


def _ground_truth(trajectory, seconds, rng) -> tuple[GroundTruthSample, ...]:
    stamps_ns = _stamps(seconds, GROUND_TRUTH_PERIOD_NS, GROUND_TRUTH_PHASE_NS)
    rows = beacons(trajectory.poses(_seconds(stamps_ns)), rng).tolist()
    return tuple(
        GroundTruthSample(stamp_ns, Pose2(x, y, wrap_angle(yaw)))
        for stamp_ns, (x, y, yaw) in zip(stamps_ns.tolist(), rows))


def _stamps(seconds: float, period_ns: int, phase_ns: int) -> np.ndarray:
    """Return stamps from the epoch on, the last one not after `seconds`."""
    return EPOCH_NS + np.arange(phase_ns, int(seconds * 1e9) + 1, period_ns, dtype=np.int64)


def _stamp_ns(event: Frame | Picture | RawOdometry | GroundTruthSample) -> int:
    return event.sample.stamp_ns if isinstance(event, RawOdometry) else event.stamp_ns


def _seconds(stamps_ns: np.ndarray) -> np.ndarray:
    return (stamps_ns - EPOCH_NS) * 1e-9
