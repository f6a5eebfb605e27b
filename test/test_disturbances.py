"""Whatever the camera shows for a while, the map afterwards is as usable as before."""

from functools import lru_cache
from math import hypot, inf, pi
from typing import NamedTuple

import numpy as np
import pytest

from dlsc_qbs_ros.config import Config, ViewConfig
from dlsc_qbs_ros.core.geometry import compose
from dlsc_qbs_ros.core.preprocessing import make_view
from dlsc_qbs_ros.core.types import Frame, RawOdometry
from dlsc_qbs_ros.errors import ConfigError
from dlsc_qbs_ros.evaluation.alignment import align
from dlsc_qbs_ros.evaluation.metrics import share_within_95
from dlsc_qbs_ros.pipeline.encoder import Encoder
from dlsc_qbs_ros.pipeline.odometry import OdometryNormaliser
from dlsc_qbs_ros.pipeline.ratslam import RatSlam
from dlsc_qbs_ros.sim.simulation import EPOCH_NS, simulate_flight

CONFIG = Config()
# The second lap, of 33 s, is on its way; at the end there is time for more than another one.
FLIGHT = simulate_flight(2, 0, 145.0)
START_S = 45.0
RATE_HZ = 10
IMAGE = ViewConfig(width=87, height=65)


def grey(pixels):
    return np.clip(np.rint(pixels), 0, 255).astype(np.uint8)


def noise(image, k):
    return np.random.default_rng(k).integers(0, 256, image.shape, np.uint8)


def sensor_noise(image, k):
    return grey(np.random.default_rng(k).normal(2.0, 1.5, image.shape))


def beating(image, k):
    """Return the image under lamps of 100 Hz, as an exposure of changing phase meets them."""
    return grey(image * (1.0 + 0.8 * np.sin(2.0 * pi * 0.37 * k)))


# Seconds it lasts, and what becomes of image k of them; `held` is the last one before.
DISTURBANCES = {
    'a black frame': (0.1, lambda image, k, held: 0 * image),
    'a white frame': (0.1, lambda image, k, held: 0 * image + 255),
    'a frame of noise': (0.1, lambda image, k, held: noise(image, k)),
    'a minute of noise': (60.0, lambda image, k, held: noise(image, k)),
    'a lens cap for a minute': (60.0, lambda image, k, held: sensor_noise(image, k)),
    'every other frame dark': (60.0, lambda image, k, held: grey(image * (0.3, 1.6)[k % 2])),
    'every other frame black': (60.0, lambda image, k, held: image * (k % 2)),
    'lamps that flicker': (60.0, lambda image, k, held: beating(image, k)),
    'an exposure jump': (5.0, lambda image, k, held: grey(image * 10.0)),
    'a camera that hangs for a minute': (60.0, lambda image, k, held: held),
}
UNDISTURBED = 'nothing'


@lru_cache(maxsize=None)
def images():
    """Return what an undisturbed camera saw, a quarter of it in width and height."""
    return [(frame.stamp_ns, make_view(frame.grey, IMAGE)) for frame in FLIGHT.frames()]


def frames(name):
    seconds, disturb = DISTURBANCES.get(name, (0.0, None))
    start = round(START_S * RATE_HZ)
    stop = start + round(seconds * RATE_HZ)
    held = images()[start - 1][1]
    return [Frame(stamp_ns, disturb(image, k - start, held) if start <= k < stop else image)
            for k, (stamp_ns, image) in enumerate(images())]


class Flown(NamedTuple):
    """What was made of a flight; times in seconds, distances in metres."""

    times: np.ndarray
    errors: np.ndarray  # of the pose at each code, as the map stood then
    within_95: float  # the share of them that lie where the poses' deviations say
    final_errors: np.ndarray  # the same, as the map stands at the end
    meetings: np.ndarray  # rows of time and true distance from the old place that was met
    reprojection_errors: np.ndarray  # of every frame
    run_aways: int
    counts: dict

    def since(self, seconds):
        return self.times >= seconds


class Log:
    """Looks over the mapper's shoulder: where it believed to be, and which old places it met."""

    def __init__(self):
        self.stamps_ns, self.poses, self.places, self.meetings = [], [], [], []
        self.sigmas_m = []
        self._born = []

    def __call__(self, mapper):
        stamp_ns, place = mapper.odometry.stamp_ns, mapper.place
        here = positions()[stamp_ns]
        is_new = len(mapper.map) > len(self._born)
        if is_new:
            self._born.append(here)
        elif place.experience != self.places[-1].experience:
            there = self._born[place.experience]
            self.meetings.append((seconds(stamp_ns), hypot(*(here - there))))
        self.stamps_ns.append(stamp_ns)
        self.poses.append(mapper.pose())
        self.sigmas_m.append(mapper.sigmas()[0])
        self.places.append(place)


def seconds(stamp_ns):
    return (np.asarray(stamp_ns) - EPOCH_NS) * 1e-9


@lru_cache(maxsize=None)
def positions():
    """Return the true position at the stamp of every image."""
    stamps_ns = FLIGHT.image_stamps_ns
    return dict(zip(stamps_ns.tolist(), FLIGHT.trajectory.poses(seconds(stamps_ns))[:, :2]))


def offsets(poses, stamps_ns):
    """Return x and y of every pose from the truth, aligned as for MAE_L."""
    estimate, truth = np.array(poses)[:, :2], np.array([positions()[ns] for ns in stamps_ns])
    return estimate - align(truth, estimate).apply(truth)


def distances(poses, stamps_ns):
    """Return the distance |x| + |y| of every pose from the truth."""
    return np.abs(offsets(poses, stamps_ns)).sum(axis=1)


@lru_cache(maxsize=None)
def flown(name):
    encoder, normaliser = Encoder(CONFIG), OdometryNormaliser(CONFIG.odometry)
    log, results = Log(), []
    ratslam = RatSlam(CONFIG, on_update=log)
    for event in FLIGHT.events(iter(frames(name))):
        if isinstance(event, Frame):
            results.append(encoder.process(event))
            if results[-1].dictionary is not None:
                ratslam.add_dictionary(results[-1].dictionary)
            ratslam.add_view(results[-1].view)
            ratslam.add_code(results[-1].code)
        elif isinstance(event, RawOdometry):
            ratslam.add_odometry(normaliser.accept(event))
        ratslam.advance(0.0)
    ratslam.advance(inf)
    final = [compose(ratslam.mapper.map.pose(place.experience), place.offset)
             for place in log.places]
    return Flown(
        seconds(log.stamps_ns), distances(log.poses, log.stamps_ns),
        share_within_95(offsets(log.poses, log.stamps_ns), 0.0, np.array(log.sigmas_m)),
        distances(final, log.stamps_ns), np.array(log.meetings),
        np.array([result.reprojection_error for result in results]),
        sum(result.ran_away for result in results), ratslam.counts)


def test_the_undisturbed_flight_is_a_fair_measure():
    result = flown(UNDISTURBED)
    assert result.errors[result.since(START_S)].mean() < 0.4
    assert len(result.meetings) > 200


@pytest.mark.parametrize('name', DISTURBANCES)
def test_the_map_afterwards_is_as_usable_as_before(name):
    result, undisturbed = flown(name), flown(UNDISTURBED)
    end_s = START_S + DISTURBANCES[name][0]
    settled = result.since(end_s + 10.0)
    assert (result.errors[settled].mean()
            < 1.3 * undisturbed.errors[settled].mean() + 0.1)
    seen = (result.times < START_S) | settled
    assert (result.final_errors[seen].mean()
            < 1.3 * undisturbed.final_errors[seen].mean() + 0.1)


@pytest.mark.parametrize('name', [UNDISTURBED, *DISTURBANCES])
def test_the_pose_says_how_far_off_it_may_be(name):
    """A covariance that held exactly would have 95 % of the errors within their bounds."""
    assert flown(name).within_95 >= 0.9


@pytest.mark.parametrize('name', DISTURBANCES)
def test_old_places_are_met_again_afterwards_and_no_other_place_is_taken_for_one(name):
    result, undisturbed = flown(name), flown(UNDISTURBED)
    assert result.meetings[:, 1].max() < 1.5
    end_s = START_S + DISTURBANCES[name][0]
    n, expected = (np.sum(one.meetings[:, 0] > end_s) for one in (result, undisturbed))
    assert n > 0.7 * expected


@pytest.mark.parametrize('name', DISTURBANCES)
def test_the_dictionary_afterwards_shows_ordinary_frames_as_well_as_before(name):
    """Seconds later; a little worse than one that had a minute more of them to learn from."""
    result, undisturbed = flown(name), flown(UNDISTURBED)
    assert np.isfinite(result.reprojection_errors).all()
    after = round((START_S + DISTURBANCES[name][0] + 2.0) * RATE_HZ)
    for window in (slice(after, after + 80), slice(after + 80, None)):
        assert (result.reprojection_errors[window].mean()
                < 1.5 * undisturbed.reprojection_errors[window].mean())


@pytest.mark.parametrize('name', DISTURBANCES)
def test_no_learner_runs_away_and_every_code_is_used(name):
    result = flown(name)
    assert result.run_aways == 0
    assert result.counts['codes_used'] == len(images())
    assert result.counts['code_mismatches'] == 0


# Hostile parameters

SMALL = {'encoder.input': 'image', 'view.width': 16, 'view.height': 12}
BOUNDS = {  # within those of the configuration
    'encoder.eta_c': (1e-4, 10.0), 'encoder.eta_d': (1e-4, 10.0),
    'encoder.lambda_1': (1e-3, 100.0), 'encoder.sigma_w': (1e-5, 10.0)}


def hostile_config(seed):
    """Draw rates and weights, mostly hopeless ones."""
    rng = np.random.default_rng(seed)
    values = {key: float(np.exp(rng.uniform(*np.log(bounds)))) for key, bounds in BOUNDS.items()}
    return Config().override({
        **SMALL, **values, 'encoder.mode': ('epochs', 'paper')[seed % 2],
        'encoder.gate': bool(rng.integers(2)), 'view.standardise': bool(rng.integers(2)),
        'encoder.n_atoms': int(rng.integers(1, 65)), 'encoder.n_coding': int(rng.integers(1, 40)),
        'encoder.n_learning': int(rng.integers(0, 6)), 'encoder.gate_window': int(
            rng.integers(1, 8))})


def hostile_frames(seed, n=40):
    """Draw images of all kinds, from plain to noise, in any order."""
    rng = np.random.default_rng(seed)
    wall = grey(np.cumsum(rng.normal(0.0, 20.0, (12, 16 + n)), axis=1) + 128)
    for k in range(n):
        image = wall[:, k:k + 16]
        kinds = (image, image, noise(image, k), 0 * image, 0 * image + 255, grey(10.0 * image))
        yield Frame((k + 1) * 100_000_000, kinds[rng.integers(len(kinds))])


@pytest.mark.parametrize('seed', range(60))
@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_at_any_rates_nothing_that_goes_out_is_ever_not_finite(seed):
    try:
        encoder = Encoder(hostile_config(seed))
    except ConfigError as error:  # coding does not converge under the first dictionary
        assert 'eta_c' in str(error)
        return
    for frame in hostile_frames(seed):
        result = encoder.process(frame)
        assert np.isfinite(result.code.values).all()
        assert result.dictionary is None or np.isfinite(result.dictionary.atoms).all()
        assert np.isfinite([result.reprojection_error, result.surprise]).all()


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_rates_that_are_too_high_do_make_the_learner_run_away():
    config = Config().override({**SMALL, 'encoder.eta_d': 1.0})
    assert sum(result.ran_away for result in map(Encoder(config).process, hostile_frames(0))) > 5
