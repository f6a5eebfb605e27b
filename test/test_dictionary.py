"""The learner: its live atoms are Algorithm 1's, whatever happens to its snapshots meanwhile."""

from contextlib import contextmanager
import tracemalloc

from algorithm_1 import prox
import numpy as np
import pytest
from vectors import Vector

from dlsc_qbs_ros.config import Config, EncoderConfig
from dlsc_qbs_ros.core import kernel, snapshot
from dlsc_qbs_ros.core.dictionary import DictionaryLearner, HEADROOM
from dlsc_qbs_ros.core.preprocessing import N_PAPER, PixelInput
from dlsc_qbs_ros.errors import ConfigError
from dlsc_qbs_ros.pipeline.encoder import Encoder

TOLERANCE = 3e-6
MANY = 30_000  # inputs: a snapshot of their atoms is made over three frames
LENGTH = 0.25 * np.sqrt(N_PAPER)  # of an input, at any size
NEVER = 10.0  # an epoch_change that no learner reaches
SMALL = EncoderConfig(n_atoms=8, eta_c=2e-3)
IMAGE = Config().override({'encoder.input': 'image'})


def waves(n_frames, n_inputs, seed=0):
    """Return smooth input vectors (n_frames, n_inputs), float32, that drift slowly."""
    rng = np.random.default_rng(seed)
    shapes = np.cos(2 * np.pi * (rng.integers(1, 9, (12, 1)) * np.linspace(0, 1, n_inputs)
                                 + rng.random((12, 1))))
    inputs = (np.cumsum(rng.normal(0.0, 0.2, (n_frames, 12)), axis=0) + rng.normal(size=12)
              ) @ shapes
    inputs *= LENGTH / np.linalg.norm(inputs, axis=-1, keepdims=True)
    return inputs.astype(np.float32)


def stream(n_frames, n_inputs, seed=0):
    """Return the input vectors of frames that drift slowly."""
    return list(map(Vector, waves(n_frames, n_inputs, seed)))


def pixel_stream(n_frames, n_inputs):
    """Yield input vectors as a camera gives them."""
    shades = waves(n_frames, n_inputs) / (LENGTH / np.sqrt(n_inputs))
    views = np.clip(np.rint(128 + 50 * shades), 0, 255).astype(np.uint8)
    return (PixelInput(view, True) for view in views)


class Literal:
    """Algorithm 1, atoms as rows, float64."""

    def __init__(self, atoms, config):
        self.atoms, self._config = atoms.astype(np.float64), config
        self.code = np.zeros(len(atoms))

    def step(self, vector):
        """Infer and learn; return the reprojection error."""
        config, phi, code, s = self._config, self.atoms, self.code, np.asarray(vector)
        for _ in range(config.n_coding):
            code = prox(code - config.eta_c * (code @ phi - s) @ phi.T,
                        config.eta_c * config.lambda_1)
        error = np.sum((code @ phi - s) ** 2)
        for _ in range(config.n_learning):
            phi = phi - config.eta_d * np.outer(code, code @ phi - s)
        self.code, self.atoms = code, phi
        return error


def deviation(a, b):
    """Return the largest difference, relative to the largest entry of b."""
    return np.abs(a - b).max() / np.abs(b).max()


def step(learner, vector):
    error = learner.infer(vector)
    learner.learn(vector)
    return error


def assert_is_algorithm_1(learner, vectors, config, literal=None):
    """Assert that the learner stays beside Algorithm 1; return the snapshots it took."""
    literal = literal or Literal(learner.atoms_, config)
    snapshots = [learner.snapshot_]
    for vector in vectors:
        assert step(learner, vector) == pytest.approx(
            literal.step(vector), abs=TOLERANCE * LENGTH ** 2)
        assert deviation(learner.codes_, literal.code[None]) < TOLERANCE
        assert deviation(learner.atoms_, literal.atoms) < TOLERANCE
        assert deviation(learner.gram_, literal.atoms @ literal.atoms.T) < TOLERANCE
        if learner.snapshot_ is not snapshots[-1]:
            snapshots.append(learner.snapshot_)
    assert learner.is_stable
    return snapshots[1:]


@contextmanager
def columns_per_frame(n):
    """Make so many columns of a snapshot per frame."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(snapshot, 'COLUMNS_PER_FRAME', n)
        yield


# Algorithm 1

@pytest.mark.parametrize('n_inputs, n_atoms, n_frames', [(30, 8, 500), (1376, 16, 200),
                                                         (MANY, 8, 50)])
@pytest.mark.parametrize('n_learning', [1, 3])
def test_live_atoms_are_those_of_algorithm_1_through_many_snapshots(
        n_inputs, n_atoms, n_frames, n_learning):
    config = EncoderConfig(n_atoms=n_atoms, n_learning=n_learning, eta_c=2e-3, epoch_change=0.1)
    snapshots = assert_is_algorithm_1(
        DictionaryLearner(n_inputs, config), pixel_stream(n_frames, n_inputs), config)
    assert len(snapshots) > 4


def test_more_inputs_than_atoms_and_fewer_are_learned_from_alike():
    config = EncoderConfig(n_atoms=8, eta_c=2e-3)
    for n_inputs in (5, 8, 9):
        assert_is_algorithm_1(DictionaryLearner(n_inputs, config), stream(80, n_inputs), config)


def test_frames_without_learning_change_codes_only():
    learner = DictionaryLearner(30, SMALL)
    for vector in stream(20, 30):
        step(learner, vector)
    atoms, gram = learner.atoms_, learner.gram_.copy()
    for vector in stream(20, 30, seed=1):
        learner.infer(vector)
    np.testing.assert_array_equal(learner.gram_, gram)
    np.testing.assert_allclose(learner.atoms_, atoms, rtol=0, atol=1e-6 * np.abs(atoms).max())


@pytest.mark.parametrize('config, scale', [
    (EncoderConfig(n_atoms=8, n_learning=0), 1.0), (EncoderConfig(n_atoms=8, eta_d=0.0), 1.0),
    (EncoderConfig(n_atoms=8), 0.0)], ids=['no steps', 'no rate', 'nothing seen'])
def test_learning_that_leaves_the_atoms_alone_takes_no_snapshot(config, scale):
    learner = DictionaryLearner(300, config)
    held, atoms = learner.snapshot_, learner.atoms_
    for values in np.float32(scale) * waves(200, 300):
        step(learner, Vector(values))
    assert learner.snapshot_ is held
    np.testing.assert_array_equal(learner.atoms_, atoms)


# Snapshots

def test_a_snapshot_is_taken_when_the_atoms_have_moved_by_epoch_change():
    config = EncoderConfig(n_atoms=8, eta_c=2e-3, epoch_change=0.2)
    learner = DictionaryLearner(300, config)
    n_taken = 0
    for vector in stream(200, 300):
        held, live = learner.snapshot_, learner.atoms_.astype(float)
        change = np.linalg.norm(live - held) / np.linalg.norm(held)
        step(learner, vector)
        is_new = learner.snapshot_ is not held
        assert is_new == (change > 0.2) or change == pytest.approx(0.2, abs=1e-4)
        n_taken += is_new
    assert n_taken > 4


@pytest.mark.parametrize('epoch_change', [0.2, NEVER])
def test_a_snapshot_holds_the_atoms_as_they_were_when_it_was_begun(epoch_change):
    """Whether they had moved or the room came to its end: a frame makes its columns, no more."""
    config = EncoderConfig(n_atoms=8, eta_c=2e-3, epoch_change=epoch_change)
    with columns_per_frame(100):  # of 700: begun in one frame, adopted six later
        learner = DictionaryLearner(700, config)
        atoms, n_taken = [], 0
        for vector in stream(200, 700):
            held = learner.snapshot_
            atoms.append(learner.atoms_)
            step(learner, vector)
            if learner.snapshot_ is not held:
                assert deviation(learner.snapshot_, atoms[-7]) < 1e-6
                assert deviation(learner.snapshot_, atoms[-6]) > 1e-4
                n_taken += 1
    assert n_taken > 2


def test_a_snapshot_over_several_frames_is_begun_when_the_atoms_have_moved_by_epoch_change():
    """How far they are from the next one is known before it is whole."""
    config = EncoderConfig(n_atoms=8, eta_c=2e-3, epoch_change=0.2)
    learner = DictionaryLearner(700, config)
    changes, adopted = [], [-1]
    with columns_per_frame(100):
        for k, vector in enumerate(stream(200, 700)):
            held, live = learner.snapshot_, learner.atoms_.astype(float)
            changes.append(np.linalg.norm(live - held) / np.linalg.norm(held))
            step(learner, vector)
            if learner.snapshot_ is not held:
                begun = k - 6
                assert changes[begun] > 0.2
                assert all(change <= 0.2 for change in changes[adopted[-1] + 1:begun])
                adopted.append(k)
    assert len(adopted) > 4


@pytest.mark.parametrize('n_columns', [1, 37, 300, 699])
def test_a_snapshot_over_several_frames_gives_the_learner_of_one_at_once(n_columns):
    vectors, learners = stream(150, 700), []
    for columns in (n_columns, 700):
        with columns_per_frame(columns):
            learner = DictionaryLearner(700, SMALL)
            codes = []
            for vector in vectors:
                step(learner, vector)
                codes.append(learner.codes_[0])
            learners.append((learner, codes))
    (slow, slow_codes), (quick, quick_codes) = learners
    assert deviation(np.array(slow_codes), np.array(quick_codes)) < 1e-5
    assert deviation(slow.atoms_, quick.atoms_) < 1e-5
    assert deviation(slow.gram_, quick.gram_) < 1e-5


def test_a_snapshot_is_taken_before_the_room_for_inputs_runs_out():
    config = EncoderConfig(n_atoms=8, eta_c=2e-3, epoch_change=NEVER)
    snapshots = assert_is_algorithm_1(
        DictionaryLearner(300, config), stream(200, 300), config)
    assert 200 / 64 - 1 < len(snapshots) < 200 / 32


def test_a_snapshot_is_finished_at_once_when_the_room_runs_out_meanwhile():
    config = EncoderConfig(n_atoms=8, eta_c=2e-3, epoch_change=NEVER)
    with columns_per_frame(1):
        snapshots = assert_is_algorithm_1(
            DictionaryLearner(300, config), stream(200, 300), config)
    assert len(snapshots) > 2


def test_adopting_a_snapshot_moves_nothing():
    """The frames it took were learned from: their inputs are kept, others are not."""
    with columns_per_frame(100):
        learner, n_taken = DictionaryLearner(700, SMALL), 0
        for vector in stream(120, 700):
            held, atoms, gram = learner.snapshot_, learner.atoms_, learner.gram_.copy()
            learner.infer(vector)
            if learner.snapshot_ is not held:
                assert deviation(learner.atoms_, atoms) < 1e-6
                assert deviation(learner.snapshot_, atoms) > 1e-4
                np.testing.assert_array_equal(learner.gram_, gram)
                n_taken += 1
            learner.learn(vector)
    assert n_taken > 3


@pytest.mark.parametrize('n_inputs', [300, MANY])
def test_the_products_for_published_codes_are_those_with_the_snapshot(n_inputs):
    learner = DictionaryLearner(n_inputs, SMALL)
    for inputs in pixel_stream(40, n_inputs):
        learner.infer(inputs)
        vector, held = np.asarray(inputs), learner.snapshot_.astype(float)
        lengths = np.linalg.norm(vector) * np.linalg.norm(held, axis=1)
        products, = learner.snapshot_products_
        assert (np.abs(products - held @ vector) < TOLERANCE * lengths).all()
        assert deviation(learner.snapshot_gram_, held @ held.T) < TOLERANCE
        learner.learn(inputs)


def test_a_snapshot_is_never_written_to():
    learner = DictionaryLearner(300, SMALL)
    held, copies = [], []
    for vector in stream(150, 300):
        if not held or learner.snapshot_ is not held[-1]:
            held.append(learner.snapshot_)
            copies.append(learner.snapshot_.copy())
        step(learner, vector)
    assert len(held) > 4
    for atoms, copy in zip(held, copies):
        assert (atoms.dtype, atoms.flags.writeable) == (np.float32, False)
        np.testing.assert_array_equal(atoms, copy)


# Beginning again

def test_restart_goes_on_from_the_given_atoms_and_zero_codes():
    learner, atoms = DictionaryLearner(30, SMALL), DictionaryLearner(30, SMALL).atoms_[::-1]
    for vector in stream(60, 30):
        step(learner, vector)
    learner.restart(atoms)
    np.testing.assert_array_equal(learner.atoms_, atoms)
    assert not learner.codes_.any()
    assert_is_algorithm_1(learner, stream(60, 30, seed=1), SMALL)


def learner_of(lambda_max, n_inputs=300):
    """Return a learner whose first atoms have this largest eigenvalue, as a share of the limit."""
    learner = DictionaryLearner(n_inputs, SMALL)
    learner.restart(learner.atoms_ * np.float32(np.sqrt(
        lambda_max * learner.lambda_max_limit / learner.lambda_max)))
    return learner


@pytest.mark.parametrize('share, expected', [
    (0.3, 0.3), (0.79, 0.79), (0.9, HEADROOM), (0.99, HEADROOM)])
def test_falling_back_goes_on_from_the_snapshot_with_room_below_the_limit(share, expected):
    learner = learner_of(share)
    for vector in stream(5, 300):
        step(learner, vector)
    snapshot_ = learner.snapshot_
    learner.fall_back()
    assert learner.lambda_max / learner.lambda_max_limit == pytest.approx(expected, rel=1e-5)
    assert deviation(learner.atoms_, snapshot_ * np.sqrt(expected / share)) < 1e-6
    assert learner.snapshot_ is snapshot_
    assert not learner.codes_.any()


@pytest.mark.parametrize('share', [0.3, 0.95])
@pytest.mark.parametrize('n_frames', [5, 25, 26, 30])
def test_a_learner_that_fell_back_goes_on_as_algorithm_1(share, n_frames):
    """However far it was, amid a snapshot or not."""
    config = EncoderConfig(n_atoms=8, eta_c=2e-3, epoch_change=NEVER)
    with columns_per_frame(30):
        learner = learner_of(share)
        for vector in stream(n_frames, 300):
            step(learner, vector)
        learner.fall_back()
        assert_is_algorithm_1(learner, stream(60, 300, seed=1), config)


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
@pytest.mark.parametrize('bad', [np.nan, np.inf, 1e30])
def test_a_learner_that_is_not_finite_is_not_stable_and_falls_back_to_one_that_is(bad):
    learner = DictionaryLearner(30, SMALL)
    step(learner, stream(1, 30)[0])
    spoiled = Vector(np.full(30, bad, np.float32))
    step(learner, spoiled)
    assert not learner.is_stable
    assert learner.lambda_max >= learner.lambda_max_limit
    learner.fall_back()
    assert learner.is_stable
    assert_is_algorithm_1(learner, stream(40, 30), SMALL)


@pytest.mark.parametrize('share', [0.4, 0.9, 0.999, 1.001, 3.0])
@pytest.mark.parametrize('spectrum', ['one', 'some', 'all alike'])
def test_stable_is_a_coding_rate_below_two_over_lambda_max(share, spectrum):
    """Whether one eigenvalue is large, or all are, or as it comes."""
    atoms = {'one': np.ones((8, 300)), 'all alike': np.eye(8, 300),
             'some': DictionaryLearner(300, SMALL).atoms_}[spectrum].astype(np.float32)
    learner = DictionaryLearner(300, SMALL)
    learner.restart(atoms)
    assert learner.lambda_max == pytest.approx(np.linalg.norm(atoms, 2) ** 2, rel=1e-5)
    learner.restart(atoms * np.float32(np.sqrt(
        share * learner.lambda_max_limit / learner.lambda_max)))
    assert learner.lambda_max_limit == 2.0 / SMALL.eta_c
    assert learner.is_stable == (share < 1.0)


# Memory

def held_by(learner):
    """Return the bytes of all arrays a learner holds of n_inputs entries or more, each once."""
    buffers, left, seen = {}, [learner], set()
    while left:
        value = left.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        if isinstance(value, np.ndarray):
            while isinstance(value.base, np.ndarray):
                value = value.base
            buffers[id(value)] = value.nbytes if value.size >= N_PAPER else 0
        elif hasattr(value, '__dict__'):
            left.extend(vars(value).values())
    return sum(buffers.values())


@pytest.mark.parametrize('has_kernel', [
    False, pytest.param(True, marks=pytest.mark.skipif(
        kernel.LIBRARY is None, reason='the compiled kernel was not built'))])
def test_at_the_size_of_the_paper_the_dictionary_is_held_three_times_at_most(
        has_kernel, monkeypatch):
    """
    Be it as the snapshot, the next one and as much again for kept inputs, all float32.

    With the kernel, the snapshot that goes out is float32, the one that is multiplied and the
    next take 3/4 of it each, kept inputs 1/4.
    """
    if not has_kernel:
        monkeypatch.setattr(kernel, 'LIBRARY', None)
    config = EncoderConfig(n_atoms=24, eta_c=2e-3, epoch_change=0.1)
    one, vectors = 24 * N_PAPER * 4, pixel_stream(60, N_PAPER)
    n_taken, gram = 0, None
    tracemalloc.start()
    try:
        learner = DictionaryLearner(N_PAPER, config)
        tracemalloc.reset_peak()
        for vector in vectors:
            step(learner, vector)
            assert held_by(learner) <= 3 * one
            n_taken, gram = n_taken + (learner.snapshot_gram_ is not gram), learner.snapshot_gram_
        assert tracemalloc.get_traced_memory()[1] < 3.5 * one
    finally:
        tracemalloc.stop()
    assert n_taken > 3


def test_nothing_grows_from_frame_to_frame():
    vectors = stream(100, 300)
    learner = DictionaryLearner(300, SMALL)
    tracemalloc.start()
    try:
        for vector in vectors:
            step(learner, vector)
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        for vector in vectors:
            step(learner, vector)
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    one = learner.snapshot_.nbytes
    assert abs(after - before) < one
    assert peak - before < 5 * one


# The encoder refuses what cannot work

def test_the_encoder_refuses_a_coding_rate_at_which_coding_diverges_from_the_first():
    config = IMAGE.override({'encoder.eta_c': 0.1, 'view.width': 16, 'view.height': 12})
    with pytest.raises(ConfigError, match=(
            r'^encoder\.eta_c = 0\.1: expected less than 2 / lambda_max = 0\.\d+ of the first')):
        Encoder(config)


def test_the_encoder_takes_any_coding_rate_without_protection():
    encoder = Encoder(IMAGE.override({
        'encoder.eta_c': 0.2, 'encoder.mode': 'paper', 'encoder.protection': False}))
    assert encoder.lambda_max > encoder.lambda_max_limit


def test_protection_may_be_off_in_paper_mode_only():
    assert not EncoderConfig(mode='paper', protection=False).protection
    with pytest.raises(ConfigError, match=(
            r"encoder\.protection = False: expected True in mode 'epochs'")):
        EncoderConfig(protection=False)
