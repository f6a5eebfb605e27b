"""The learner in its Gram form is Algorithm 1 of the paper, to rounding."""

from dataclasses import asdict
from functools import lru_cache
from itertools import islice

from algorithm_1 import algorithm_1
import numpy as np
import pytest
from vectors import Vector, vectors_of

from dlsc_qbs_ros.config import Config, EncoderConfig, ViewConfig
from dlsc_qbs_ros.core.dictionary import DictionaryLearner
from dlsc_qbs_ros.core.preprocessing import input_scale, make_view, PixelInput
from dlsc_qbs_ros.pipeline.encoder import Encoder
from dlsc_qbs_ros.sim.simulation import simulate_flight

TOLERANCE = 1e-4
PAPER_SIZE = {'view.width': 346, 'view.height': 260}


@lru_cache(maxsize=None)
def frames(n):
    return list(islice(simulate_flight(1, 0, 60.0).frames(), n))


def inputs_of(n, config):
    views = np.array([make_view(frame.grey, config.view) for frame in frames(n)])
    return vectors_of(views, config.view.standardise)


def literal(inputs, config, **changes):
    parameters = {**asdict(config.encoder), **changes}
    return list(algorithm_1(
        inputs, DictionaryLearner(inputs.shape[1], config.encoder).atoms_.T,
        **{name: parameters[name] for name in (
            'eta_c', 'eta_d', 'lambda_1', 'n_coding', 'n_learning', 'gate')}))


def encoded(n, config):
    encoder = Encoder(config)
    return [encoder.process(frame) for frame in frames(n)]


def deviation(a, b):
    """Return the largest difference per row, relative to the row's largest entry in b."""
    a, b = (np.array(rows).reshape(len(b), -1) for rows in (a, b))
    return np.max(np.abs(a - b).max(axis=1) / np.abs(b).max(axis=1))


def code_deviation(n, config, **changes):
    steps = literal(inputs_of(n, config), config, **changes)
    return deviation([result.code.values for result in encoded(n, config)],
                     [step.code for step in steps])


IMAGE = Config().override({'encoder.input': 'image'})
PAPER = IMAGE.override({'encoder.mode': 'paper'})
VARIANTS = [
    pytest.param(PAPER, 100, id='the SLAM parameters of the paper'),
    pytest.param(PAPER.override({'encoder.n_learning': 3}), 100, id='three learning iterations'),
    pytest.param(PAPER.override({'encoder.gate': False}), 100, id='no gate'),
    pytest.param(PAPER.override({'view.standardise': False}), 100, id='pixels in [0, 1]'),
    pytest.param(PAPER.override(PAPER_SIZE), 6, id='images of the size of the paper'),
]


@pytest.mark.parametrize('config, n', VARIANTS)
def test_codes_errors_and_gate_are_those_of_the_literal_algorithm(config, n):
    steps = literal(inputs_of(n, config), config)
    results = encoded(n, config)
    assert [result.learned for result in results] == [step.learned for step in steps]
    assert deviation([result.code.values for result in results],
                     [step.code for step in steps]) < TOLERANCE
    assert deviation([result.reprojection_error for result in results],
                     [step.error for step in steps]) < TOLERANCE


def test_the_gate_opens_and_closes_on_this_flight():
    learned = [result.learned for result in encoded(100, PAPER)]
    assert learned[:2] == [True, True]
    assert 20 < sum(learned) < 80


def test_dictionaries_that_epochs_publish_are_those_of_the_literal_algorithm():
    config = IMAGE.override({'encoder.epoch_change': 1e-3})
    steps = literal(inputs_of(100, config), config)
    published = [(result.dictionary.atoms, step.dictionary.T)
                 for result, step in zip(encoded(100, config), steps) if result.dictionary]
    assert len(published) > 20
    for atoms, phi in published:
        assert deviation([atoms], [phi]) < TOLERANCE


@pytest.mark.parametrize('broken', [
    {'eta_d': -1.4e-3}, {'lambda_1': -0.2}, {'n_coding': 9}, {'gate': False}])
def test_a_literal_algorithm_with_one_flaw_does_not_agree(broken):
    assert code_deviation(100, PAPER) < TOLERANCE
    assert code_deviation(100, PAPER, **broken) > 100 * TOLERANCE


# The Gram form

def test_the_gram_matrix_follows_the_atoms_through_hundreds_of_updates():
    config = EncoderConfig(n_learning=2)
    inputs = list(map(Vector, inputs_of(100, Config())))
    learner = DictionaryLearner(43 * 32, config)
    for k in range(400):
        learner.infer(inputs[k % 100])
        learner.learn(inputs[k % 100])
    atoms = learner.atoms_.astype(float)
    assert deviation([learner.gram_], [atoms @ atoms.T]) < 1e-6


def test_inputs_are_left_as_they_were():
    values, = inputs_of(1, Config())
    before = values.copy()
    learner = DictionaryLearner(len(values), EncoderConfig())
    values.flags.writeable = False
    learner.infer(Vector(values))
    learner.learn(Vector(values))
    np.testing.assert_array_equal(values, before)


def test_the_seed_alone_decides_the_first_dictionary():
    a, b, c = (DictionaryLearner(50, EncoderConfig(seed=seed)).atoms_ for seed in (3, 3, 4))
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - c).max() > 0.1


# The scaling law

def test_the_same_picture_at_twice_the_size_gives_the_same_codes_and_updates():
    """With every pixel and atom entry doubled in x and y, `input_scale` keeps b, G and eta."""
    small = np.array([make_view(frame.grey, ViewConfig()) for frame in frames(30)])
    large = small.repeat(2, axis=1).repeat(2, axis=2)
    learners = {view.shape: DictionaryLearner(view[0].size, EncoderConfig())
                for view in (small, large)}
    start = learners[small.shape].atoms_.reshape(-1, *small.shape[1:])
    learners[large.shape].restart(start.repeat(2, axis=1).repeat(2, axis=2).reshape(
        len(start), -1) * np.float32(input_scale(4) / input_scale(1)))
    codes = {shape: [] for shape in learners}
    for views in (small, large):
        for view in views:
            learners[views.shape].infer(PixelInput(view, True))
            learners[views.shape].learn(PixelInput(view, True))
            codes[views.shape].append(learners[views.shape].codes_[0])
    assert deviation(codes[large.shape], codes[small.shape]) < TOLERANCE


@pytest.mark.parametrize('width, height', [(22, 16), (43, 32), (87, 65), (346, 260)])
def test_atoms_and_views_are_as_long_at_every_size_as_at_that_of_the_paper(width, height):
    view = ViewConfig(width=width, height=height)
    n = width * height
    atoms = DictionaryLearner(n, EncoderConfig()).atoms_
    assert np.mean(np.sum(atoms ** 2, axis=1)) == pytest.approx(346 * 260 * 0.01 ** 2, rel=0.05)
    inputs = inputs_of(5, Config(view=view))
    np.testing.assert_allclose(np.linalg.norm(inputs, axis=1), 0.25 * np.sqrt(346 * 260),
                               rtol=1e-4)
