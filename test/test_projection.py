"""Products of inputs with a snapshot's atoms and with kept inputs, by numpy and by the kernel."""

import numpy as np
import pytest

from dlsc_qbs_ros.core import kernel
from dlsc_qbs_ros.core.planes import PlaneProjection
from dlsc_qbs_ros.core.preprocessing import PixelInput
from dlsc_qbs_ros.core.projection import gram_of, Projection, TERMS

N_ATOMS, ROOM = 5, 12
TOLERANCE = 3e-6  # relative to the lengths of what is multiplied

KINDS = [Projection, pytest.param(PlaneProjection, marks=pytest.mark.skipif(
    kernel.LIBRARY is None, reason='the compiled kernel was not built'))]


def rows_of(n, n_inputs, seed=0):
    return np.random.default_rng(seed).normal(size=(n, n_inputs)).astype(np.float32)


def input_of(n_inputs, seed=0, standardise=True):
    """Return an input as a camera gives it: shades between two levels of grey."""
    rng = np.random.default_rng(seed)
    low, high = np.sort(rng.integers(0, 256, 2))
    return PixelInput(rng.integers(low, high + 1, (1, n_inputs)).astype(np.uint8), standardise)


def exact(vector):
    """Return an input (n_inputs,) in float64."""
    factor, mean, _ = vector.affine
    return factor * (vector.pixels - mean)


def filled(kind, n_inputs, n_kept, seed=0):
    """Return a projection and the rows (N_ATOMS + n_kept, n_inputs) that were put into it."""
    atoms = rows_of(N_ATOMS, n_inputs, seed)
    kept = [input_of(n_inputs, seed + 1 + k) for k in range(n_kept)]
    projection = kind(atoms, ROOM)
    for vector in kept:
        projection.keep(vector)
    return projection, np.vstack([atoms, *map(exact, kept)])


def assert_products(projection, vector, rows):
    """Assert that the products are those with these rows."""
    products, values = projection.products(vector), exact(vector)
    assert (products.shape, products.dtype) == ((len(rows),), np.float64)
    lengths = np.linalg.norm(values) * np.linalg.norm(rows, axis=1)
    assert (np.abs(products - rows @ values) <= TOLERANCE * lengths).all()


def combined(projection, weights, start=0, stop=None):
    """Return what `combine` yields as one array, NaN where it does not."""
    whole = np.full((len(weights), projection.n_inputs), np.nan, np.float32)
    for columns, block in projection.combine(
            weights, start, projection.n_inputs if stop is None else stop):
        assert block.dtype == np.float32
        whole[:, columns] = block
    return whole


def other_atoms(projection, atoms):
    """Return atoms as the projection takes them."""
    other = projection.new_atoms()
    for columns, block in projection.combine(
            np.eye(N_ATOMS, N_ATOMS + projection.n_kept), 0, projection.n_inputs):
        other[:, columns] = atoms[:, columns]
    return other


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('standardise', [True, False])
@pytest.mark.parametrize('n_kept', [0, 1, 7, ROOM])
@pytest.mark.parametrize('n_inputs', [1, 50, 255, 256, 4096, 4097, 20_001])
def test_products_are_those_with_atoms_and_then_with_kept_inputs(
        kind, n_kept, n_inputs, standardise):
    projection, rows = filled(kind, n_inputs, n_kept)
    assert_products(projection, input_of(n_inputs, 9, standardise), rows)


@pytest.mark.parametrize('kind', KINDS)
def test_an_input_is_kept_in_the_slot_after_those_in_use(kind):
    projection, rows = filled(kind, 50, 7)
    other = input_of(50, 8)
    assert (projection.n_kept, projection.room) == (7, ROOM - 7)
    assert projection.keep(other) == 7
    assert (projection.n_kept, projection.room) == (8, ROOM - 8)
    assert_products(projection, input_of(50, 9), np.vstack([rows, exact(other)]))


@pytest.mark.parametrize('kind', KINDS)
def test_what_is_forgotten_makes_room_for_others(kind):
    projection, rows = filled(kind, 50, 7)
    projection.forget()
    assert (projection.n_kept, projection.room) == (0, ROOM)
    other = input_of(50, 8)
    assert projection.keep(other) == 0
    assert_products(projection, input_of(50, 9), np.vstack([rows[:N_ATOMS], exact(other)]))


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('n_forgotten', [0, 2, 6, 9])
def test_other_atoms_go_with_the_inputs_that_were_kept_last(kind, n_forgotten):
    projection, rows = filled(kind, 5000, 9)
    for seed in (7, 8, 9):
        atoms = rows_of(N_ATOMS, 5000, seed)
        before = projection.atoms
        copy, kept = before.copy(), rows[N_ATOMS:]
        n_kept = len(kept)
        staying = projection.replace(other_atoms(projection, atoms), min(n_forgotten, n_kept))
        assert staying == slice(min(n_forgotten, n_kept), n_kept)
        rows = np.concatenate([atoms, kept[staying]])
        assert projection.n_kept == len(rows) - N_ATOMS
        assert_products(projection, input_of(5000, 8), rows)
        np.testing.assert_allclose(projection.atoms, atoms, atol=1e-6)
        np.testing.assert_array_equal(before, copy)


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('n_inputs', [1, 511, 512, 513, 4096, 5000])
@pytest.mark.parametrize('n_kept', [0, 6])
def test_a_combination_of_rows_is_their_product_with_its_weights(kind, n_inputs, n_kept):
    projection, rows = filled(kind, n_inputs, n_kept)
    weights = np.random.default_rng(2).normal(size=(3, N_ATOMS + n_kept))
    scale = np.abs(weights) @ np.abs(rows).max(axis=1)
    assert (np.abs(combined(projection, weights) - weights @ rows)
            <= TOLERANCE * scale[:, None]).all()


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('start, stop', [(0, 1), (0, 8192), (4096, 8192), (8192, 9000)])
def test_a_combination_may_be_made_of_some_columns_only(kind, start, stop):
    projection, rows = filled(kind, 9000, 6)
    weights = np.random.default_rng(2).normal(size=(3, N_ATOMS + 6))
    whole = combined(projection, weights, start, stop)
    assert np.isnan(whole[:, :start]).all() and np.isnan(whole[:, stop:]).all()
    np.testing.assert_allclose(whole[:, start:stop], (weights @ rows)[:, start:stop], rtol=1e-5,
                               atol=1e-3)


@pytest.mark.parametrize('kind', KINDS)
def test_a_combination_leaves_out_what_was_kept_since_its_weights_were_made(kind):
    projection, rows = filled(kind, 5000, 6)
    weights = np.random.default_rng(2).normal(size=(3, N_ATOMS + 4))
    np.testing.assert_allclose(combined(projection, weights), weights @ rows[:N_ATOMS + 4],
                               rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_what_is_not_finite_in_one_atom_spoils_no_other(kind, bad):
    atoms = rows_of(N_ATOMS, 300)
    atoms[2, 17] = bad
    products = kind(atoms, ROOM).products(input_of(300, 2))
    assert np.isfinite(products).tolist() == [True, True, False, True, True]


# The Gram matrix

@pytest.mark.parametrize('n_inputs', [1, 100, TERMS - 1, TERMS, TERMS + 1, 90_000])
def test_gram_of_is_the_products_of_all_rows_in_64_bits(n_inputs):
    rows = rows_of(6, n_inputs)
    gram = gram_of(rows)
    assert gram.dtype == np.float64
    lengths = np.linalg.norm(rows, axis=1)
    expected = rows.astype(float) @ rows.T.astype(float)
    assert (np.abs(gram - expected) < 5e-7 * np.outer(lengths, lengths)).all()
