"""Over whole flights the package is Algorithm 1: its codes, dictionary, S_2 and gate."""

from functools import lru_cache
from itertools import islice
from pathlib import Path

from algorithm_1 import algorithm_1
from exactness import compared, literal_beside, SETS, step_size
import numpy as np
import pytest
from vectors import vectors_of

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.dictionary import DictionaryLearner
from dlsc_qbs_ros.core.preprocessing import make_view
from dlsc_qbs_ros.core.types import Frame
from dlsc_qbs_ros.sim.simulation import simulate_flight

# Measured with float32 products: 1e-5 for codes and dictionaries, 2e-6 for S_2, none flips.
TOLERANCE = 1e-4
SURPRISE_TOLERANCE = 1e-5

PAPER = Config().override({
    'encoder.input': 'image', 'encoder.mode': 'paper', 'encoder.protection': False})
PIXELS = {'view.standardise': False}


@lru_cache(maxsize=None)
def simulated():
    return list(islice(simulate_flight(2, 0, 101.0).frames(), 1000))


@lru_cache(maxsize=None)
def recorded(name):
    """Return the frames of a real flight, where it lies beside the checkout."""
    folder = Path(__file__).parents[2] / 'shared' / 'data' / name
    if not folder.is_dir():
        pytest.skip(f'{folder} is not here')
    pytest.importorskip('rclpy')
    from dlsc_qbs_ros.io.flight import read_flight
    return [event for event in read_flight(folder) if isinstance(event, Frame)]


def assert_is_algorithm_1(columns):
    """Assert equality to rounding; a decision may flip where rounding reaches across zero."""
    for name in ('code', 'dictionary', 'error'):
        assert np.nanmax(getattr(columns, name)) < TOLERANCE, name
    assert columns.surprise.max() < SURPRISE_TOLERANCE
    flipped = ~columns.agrees
    assert (columns.margin[flipped] < SURPRISE_TOLERANCE).all(), np.flatnonzero(flipped)


@pytest.mark.parametrize('name', SETS)
def test_over_a_simulated_flight_the_package_is_algorithm_1(name):
    columns = compared(PAPER.override(SETS[name]), simulated())
    assert len(columns.code) == 1000
    assert 300 < columns.learned.sum() < 700
    assert_is_algorithm_1(columns)


@pytest.mark.parametrize('name', SETS)
@pytest.mark.parametrize('flight, n', [('tum_fr1_rpy', 720), ('hololens_walk', 373)])
def test_over_a_real_flight_the_package_is_algorithm_1(name, flight, n):
    columns = compared(PAPER.override(SETS[name]), recorded(flight))
    assert len(columns.code) == n
    assert_is_algorithm_1(columns)


@pytest.mark.parametrize('name', ['SLAM', 'Fig. a'])
def test_with_pixels_as_inputs_the_package_is_algorithm_1(name):
    columns = compared(PAPER.override({**PIXELS, **SETS[name]}), simulated())
    assert len(columns.code) == 1000
    assert_is_algorithm_1(columns)


@pytest.mark.parametrize('width, height, name, n', [
    (87, 65, 'SLAM', 1000), (173, 130, 'Fig. a', 200)])
def test_with_larger_views_the_package_is_algorithm_1(width, height, name, n):
    config = PAPER.override({'view.width': width, 'view.height': height, **SETS[name]})
    columns = compared(config, simulated()[:n], stride=50)
    assert len(columns.code) == n
    assert_is_algorithm_1(columns)


def test_where_the_package_runs_away_so_does_algorithm_1():
    """With pixels and the rates of Fig. b, which the surprise does not save on this flight."""
    config = PAPER.override({**PIXELS, **SETS['Fig. b']})
    columns = compared(config, simulated())
    n = len(columns.code)
    assert 100 < n < 1000
    assert_is_algorithm_1(columns)
    *_, last = literal(simulated()[:n + 1], config)
    assert step_size(last.dictionary, config) > 2.0


# The comparison itself

def literal(frames, config):
    views = np.array([make_view(frame.grey, config.view) for frame in frames])
    inputs = vectors_of(views, config.view.standardise)
    encoder = config.encoder
    return algorithm_1(
        inputs, DictionaryLearner(inputs.shape[1], encoder).atoms_.T, eta_c=encoder.eta_c,
        eta_d=encoder.eta_d, lambda_1=encoder.lambda_1, n_coding=encoder.n_coding,
        n_learning=encoder.n_learning)


def test_the_literal_algorithm_beside_the_package_is_algorithm_1_to_the_last_bit():
    frames = simulated()[:100]
    beside = literal_beside(
        DictionaryLearner(PAPER.view.width * PAPER.view.height, PAPER.encoder), PAPER)
    for frame, expected in zip(frames, literal(frames, PAPER)):
        learned = beside.s_2 > 0.0
        inputs = vectors_of([make_view(frame.grey, PAPER.view)], True)
        step = beside.step(inputs[0], learned)
        np.testing.assert_array_equal(step.code, expected.code)
        np.testing.assert_array_equal(step.dictionary, expected.dictionary)
        assert (step.error, step.learned) == (expected.error, expected.learned)


@pytest.mark.parametrize('broken', [
    {'encoder.eta_d': 1.5e-3}, {'encoder.eta_c': 4.9e-3}, {'encoder.lambda_1': 0.19},
    {'encoder.n_coding': 9}, {'encoder.n_learning': 2}])
def test_a_package_with_one_flaw_is_not_algorithm_1(broken):
    columns = compared(PAPER.override(broken), simulated()[:100], literal_config=PAPER)
    with pytest.raises(AssertionError, match='code'):
        assert_is_algorithm_1(columns)


@pytest.mark.parametrize('broken', [{'encoder.gate': False}, {'encoder.gate_window': 4}])
def test_a_package_with_another_gate_is_not_algorithm_1(broken):
    columns = compared(PAPER.override(broken), simulated()[:100])
    assert columns.margin[~columns.agrees].max() > 100 * SURPRISE_TOLERANCE
    with pytest.raises(AssertionError):
        assert_is_algorithm_1(columns)
