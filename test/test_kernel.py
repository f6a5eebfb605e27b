"""The compiled kernel does what numpy does without it, and is never missed."""

from ctypes import CDLL
import shutil

import numpy as np
import pytest
from vectors import vectors_of

from dlsc_qbs_ros.config import EncoderConfig
from dlsc_qbs_ros.core import kernel
from dlsc_qbs_ros.core.dictionary import DictionaryLearner
from dlsc_qbs_ros.core.preprocessing import PixelInput
from dlsc_qbs_ros.core.sparse_coding import infer, Lasso, sparse_codes

LIBRARY, SOURCE = kernel.LIBRARY, kernel.SOURCE
needs_kernel = pytest.mark.skipif(
    kernel.LIBRARY is None, reason='the compiled kernel was not built')


def with_and_without(function):
    """Return what a function gives with the kernel and without it."""
    compiled = function()
    with kernel.disabled():
        return compiled, function()


def assert_same(function, tolerance):
    compiled, plain = with_and_without(function)
    assert (compiled.shape, compiled.dtype) == (plain.shape, plain.dtype)
    np.testing.assert_allclose(
        compiled, plain, rtol=0.0, atol=tolerance * np.abs(plain).max() + 1e-300)


# Each function beside its twin in numpy

def views(kind, n, height=12, width=31):
    rng = np.random.default_rng(0)
    return {'noise': rng.integers(0, 256, (n, height, width)),
            'black': np.zeros((n, height, width)), 'white': np.full((n, height, width), 255),
            'flat': 100 + rng.integers(0, 3, (n, height, width)),
            'half': np.arange(n * height * width).reshape(n, height, width) % 2 * 255,
            }[kind].astype(np.uint8)


@needs_kernel
@pytest.mark.parametrize('standardise', [True, False])
@pytest.mark.parametrize('n', [1, 3])
@pytest.mark.parametrize('kind', ['noise', 'black', 'white', 'flat', 'half'])
def test_views_become_the_same_inputs(kind, n, standardise):
    assert_same(lambda: vectors_of(views(kind, n), standardise), 1e-6)


@needs_kernel
@pytest.mark.parametrize('height, width', [(1, 4095), (64, 64), (1, 4097), (260, 346)])
def test_views_of_any_size_become_the_same_inputs(height, width):
    assert_same(lambda: vectors_of(views('noise', 2, height, width), True), 1e-6)


def problem(n, m, n_inputs, seed=0):
    """Return products b (n, m) of inputs and atoms, and the Gram matrix (m, m) of these."""
    rng = np.random.default_rng(seed)
    atoms = rng.normal(size=(m, n_inputs)) + 0.3 * rng.normal(size=n_inputs)
    return rng.normal(size=(n, n_inputs)) @ atoms.T, atoms @ atoms.T


def inferred(m, n_rows, n_steps, lambda_1):
    """Return b, code, gradient and change for atoms that are a mix of rows, the first of more."""
    rng = np.random.default_rng(1)
    rows, mix = rng.normal(size=(n_rows, 100)), rng.normal(size=(m, n_rows + 9))
    atoms = mix[:, :n_rows] @ rows
    code, products = rng.normal(size=m), rows @ rng.normal(size=100)
    return infer(products, mix[:, :n_rows], code, atoms @ atoms.T, 0.5 / np.linalg.norm(
        atoms, 2) ** 2, lambda_1, n_steps)


@needs_kernel
@pytest.mark.parametrize('m', [1, 7, 16, 64])
@pytest.mark.parametrize('n_rows', [1, 50])
@pytest.mark.parametrize('n_steps', [0, 1, 10])
@pytest.mark.parametrize('lambda_1', [0.0, 0.2, 5.0])
def test_codes_are_inferred_alike(m, n_rows, n_steps, lambda_1):
    for i in range(3):
        assert_same(lambda: inferred(m, n_rows, n_steps, lambda_1)[i], 1e-12)
    compiled, plain = with_and_without(lambda: inferred(m, n_rows, n_steps, lambda_1)[3])
    assert compiled == pytest.approx(plain, rel=1e-10)


@needs_kernel
@pytest.mark.parametrize('n, m', [(1, 1), (1, 7), (5, 16), (200, 64)])
@pytest.mark.parametrize('n_steps', [1, 2, 10])
@pytest.mark.parametrize('lambda_1', [0.0, 3.0, 30.0, 1e9])
def test_sparse_codes_are_the_same(n, m, n_steps, lambda_1):
    b, gram = problem(n, m, 100)
    eta_c = 1.0 / np.linalg.eigvalsh(gram)[-1]
    assert_same(lambda: sparse_codes(b, gram, eta_c, lambda_1, n_steps), 1e-5)


@needs_kernel
@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
def test_sparse_codes_hide_nothing_that_is_not_finite(bad):
    b, gram = problem(3, 8, 100)
    b[1, 3] = bad
    with np.errstate(all='ignore'):
        for codes in with_and_without(lambda: sparse_codes(b, gram, 1e-3, 0.2, 10)):
            assert np.isfinite(codes).all(axis=1).tolist() == [True, False, True]


@needs_kernel
def test_inferring_leaves_the_code_it_starts_from_alone():
    (b,), gram = problem(1, 8, 100)
    code = np.ones(8)
    infer(b, np.eye(8), code, gram, 1e-3, 0.2, 10)
    np.testing.assert_array_equal(code, np.ones(8))


@needs_kernel
@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
def test_inferring_hides_nothing_that_is_not_finite(bad):
    (b,), gram = problem(1, 8, 100)
    b[3] = bad
    with np.errstate(all='ignore'):
        for code in with_and_without(
                lambda: infer(b, np.eye(8), np.zeros(8), gram, 1e-3, 0.2, 10)[1]):
            assert not np.isfinite(code).all()


@needs_kernel
@pytest.mark.parametrize('m', [1, 7, 64])
@pytest.mark.parametrize('lambda_1', [0.0, 0.2, 5.0, 30.0, 200.0])
def test_exact_codes_are_the_same(m, lambda_1):
    b, gram = problem(20, m, 100)
    assert_same(lambda: Lasso(gram, lambda_1).solve(b), 1e-10)


@needs_kernel
@pytest.mark.parametrize('n_inputs', [300, 20_000])
def test_a_learner_is_the_same(n_inputs):
    config = EncoderConfig(n_atoms=8, eta_c=2e-3, epoch_change=0.05)
    waves = np.cos(np.outer(np.arange(1, 9), np.linspace(0.0, 6.0, n_inputs)))
    views = np.random.default_rng(0).normal(size=(60, 8)) @ waves
    views = np.clip(128 + 20 * views, 0, 255).astype(np.uint8)

    def atoms():
        learner = DictionaryLearner(n_inputs, config)
        for view in views:
            inputs = PixelInput(view, True)
            learner.infer(inputs)
            learner.learn(inputs)
        assert learner.is_stable
        return np.concatenate([learner.atoms_, learner.snapshot_], axis=1)
    assert_same(atoms, 3e-6)


# However arrays lie in memory

def layouts(array):
    """Return arrays equal to the one given, in other orders and with gaps."""
    wide = np.repeat(np.repeat(array, 2, axis=0), 2, axis=-1)
    return [np.asfortranarray(array), wide[::2, ..., ::2], array[::-1].copy()[::-1],
            array[..., ::-1].copy()[..., ::-1]]


def test_views_may_lie_in_memory_as_they_like():
    array = views('noise', 3)
    for same in layouts(array):
        np.testing.assert_array_equal(vectors_of(same, True), vectors_of(array, True))


def test_products_may_lie_in_memory_as_they_like():
    b, gram = problem(3, 8, 100)
    for same in layouts(b):
        for function in (Lasso(gram, 0.2).solve, lambda b: sparse_codes(b, gram, 1e-3, 0.2, 5)):
            np.testing.assert_array_equal(function(same), function(b))


@pytest.mark.parametrize('n_inputs', [300, 20_000])
def test_inputs_may_lie_in_memory_as_they_like(n_inputs):
    views = np.random.default_rng(0).integers(0, 256, (3, 10, n_inputs // 10), np.uint8)

    def atoms(views):
        learner = DictionaryLearner(n_inputs, EncoderConfig(n_atoms=8))
        for view in views:
            learner.infer(PixelInput(view, True))
            learner.learn(PixelInput(view, True))
        return learner.atoms_
    for same in layouts(views):
        np.testing.assert_array_equal(atoms(same), atoms(views))


# With it or without

@needs_kernel
def test_disabled_ends_with_its_block_even_by_an_error():
    with kernel.disabled():
        assert kernel.LIBRARY is None
    assert kernel.LIBRARY is LIBRARY
    with pytest.raises(KeyError), kernel.disabled():
        raise KeyError
    assert kernel.LIBRARY is LIBRARY


def test_where_no_library_was_built_there_is_none(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel, 'SOURCE', tmp_path / '_kernel.c')
    assert kernel._load() is None
    shutil.copy(SOURCE, tmp_path)
    assert kernel._load() is None


@needs_kernel
def test_a_library_of_another_version_is_left_alone(tmp_path, monkeypatch):
    """Its functions may take other arguments, or planes of another layout."""
    for path in (SOURCE, SOURCE.with_suffix('.so')):
        shutil.copy(path, tmp_path)
    monkeypatch.setattr(kernel, 'SOURCE', tmp_path / SOURCE.name)
    assert kernel._load() is not None
    with kernel.SOURCE.open('a') as stream:
        stream.write(' ')
    assert kernel._load() is None


def test_a_library_that_does_not_say_what_it_was_made_of_is_left_alone(monkeypatch):
    monkeypatch.setattr(kernel, 'CDLL', lambda path: CDLL(None))
    assert kernel._load() is None


def test_a_library_of_another_machine_is_left_alone(tmp_path, monkeypatch):
    shutil.copy(SOURCE, tmp_path)
    (tmp_path / '_kernel.so').write_bytes(b'\x7fELF of another machine')
    monkeypatch.setattr(kernel, 'SOURCE', tmp_path / SOURCE.name)
    assert kernel._load() is None
