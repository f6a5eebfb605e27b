"""Products of inputs with a snapshot's atoms and with kept inputs, in 32 and in 16 bits."""

import numpy as np
import pytest

from dlsc_qbs_ros.core import kernel
from dlsc_qbs_ros.core.projection import (
    COLUMNS, gram_of, LONG, make_projection, Projection, ShortProjection, TERMS)

N_ATOMS, ROOM = 5, 12
TOP = 32766  # what the largest value of a row of 16 bits becomes

needs_kernel = pytest.mark.skipif(
    kernel.LIBRARY is None, reason='the compiled kernel was not built')
KINDS = [Projection, pytest.param(ShortProjection, marks=needs_kernel)]


def rows_of(n, n_inputs, seed=0):
    return np.random.default_rng(seed).normal(size=(n, n_inputs)).astype(np.float32)


def smooth(n, n_inputs, seed=0):
    """Return rows whose neighbouring entries are much alike, as pixels are."""
    rng = np.random.default_rng(seed)
    phase = 2 * np.pi * (rng.integers(1, 9, (n, 1)) * np.linspace(0, 1, n_inputs)
                         + rng.random((n, 1)))
    return (3.0 + np.cos(phase)).astype(np.float32)


def plain(n, n_inputs, seed=0):
    """Return rows of few levels, in which equal neighbours are rounded alike: the worst case."""
    return np.rint(4.0 * smooth(n, n_inputs, seed)) / np.float32(3.0) - np.float32(4.1)


def filled(kind, n_inputs, n_kept, seed=0):
    """Return a projection and the rows (N_ATOMS + n_kept, n_inputs) that were put into it."""
    atoms, kept = rows_of(N_ATOMS, n_inputs, seed), rows_of(n_kept, n_inputs, seed + 1)
    projection = kind(atoms, ROOM)
    for slot, row in enumerate(kept):
        projection.keep(slot, row[None])
    return projection, np.concatenate([atoms, kept]).astype(float)


def deviations(products, inputs, rows):
    """Return the errors of products relative to the lengths of input and row."""
    lengths = np.linalg.norm(inputs, axis=1)[:, None] * np.linalg.norm(rows, axis=1)
    return np.abs(products - inputs.astype(float) @ rows.T) / lengths


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('n', [1, 3])
@pytest.mark.parametrize('n_kept', [0, 1, 4, 7, ROOM])
@pytest.mark.parametrize('n_inputs', [1, 50, 4096, 20_001])
def test_products_are_those_with_atoms_and_then_with_kept_inputs(kind, n, n_kept, n_inputs):
    projection, rows = filled(kind, n_inputs, n_kept)
    inputs = rows_of(n, n_inputs, 9)
    products = projection.products(inputs, n_kept)
    assert (products.shape, products.dtype) == ((n, N_ATOMS + n_kept), np.float64)
    assert (deviations(products, inputs, rows) < 1e-4).all()


@pytest.mark.parametrize('kind', KINDS)
def test_inputs_may_be_kept_several_at_once_and_anew(kind):
    projection, rows = filled(kind, 50, 7)
    others, inputs = rows_of(3, 50, 8), rows_of(2, 50, 9)
    projection.keep(2, others)
    rows[N_ATOMS + 2:N_ATOMS + 5] = others
    assert (deviations(projection.products(inputs, 7), inputs, rows) < 1e-4).all()


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('start, stop', [(0, 9), (2, 9), (6, 9), (9, 9)])
def test_another_snapshot_takes_along_the_inputs_of_the_slots_named(kind, start, stop):
    projection, rows = filled(kind, 50, 9)
    atoms, inputs = rows_of(N_ATOMS, 50, 7), rows_of(2, 50, 8)
    projection.replace(atoms, slice(start, stop))
    expected = np.concatenate([atoms, rows[N_ATOMS + start:N_ATOMS + stop]])
    products = projection.products(inputs, stop - start)
    assert (deviations(products, inputs, expected) < 1e-4).all()
    assert projection.atoms is atoms


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('n_inputs', [1, COLUMNS - 1, COLUMNS, COLUMNS + 1, 5000])
@pytest.mark.parametrize('n_kept', [0, 6])
def test_a_combination_of_rows_is_their_product_with_its_weights(kind, n_inputs, n_kept):
    projection, rows = filled(kind, n_inputs, n_kept)
    weights = np.random.default_rng(2).normal(size=(3, N_ATOMS + n_kept))
    out = np.full((3, n_inputs), np.nan, np.float32)
    projection.combine(weights, out)
    assert np.abs(out - weights @ rows).max() < 1e-3


@pytest.mark.parametrize('start, stop', [(0, 1), (1, 1200), (1200, 3000), (700, 700)])
def test_a_combination_may_be_made_of_some_columns_only(start, stop):
    projection, rows = filled(Projection, 3000, 6)
    weights = np.random.default_rng(2).normal(size=(3, N_ATOMS + 6))
    out = np.full((3, 3000), np.nan, np.float32)
    projection.combine(weights, out, start, stop)
    assert np.isnan(out[:, :start]).all() and np.isnan(out[:, stop:]).all()
    np.testing.assert_allclose(out[:, start:stop], (weights @ rows)[:, start:stop], atol=1e-5)


@pytest.mark.parametrize('kind', KINDS)
def test_atoms_are_shared_and_never_written_to(kind):
    atoms = rows_of(N_ATOMS, 50)
    atoms.flags.writeable = False
    projection = kind(atoms, ROOM)
    projection.keep(0, rows_of(ROOM, 50, 1))
    projection.products(rows_of(1, 50, 2), ROOM)
    projection.combine(np.ones((2, N_ATOMS + ROOM)), np.empty((2, 50), np.float32))
    assert projection.atoms is atoms


# In 16 bits

@needs_kernel
@pytest.mark.parametrize('make', [rows_of, smooth])
@pytest.mark.parametrize('n_inputs', [1, 15, 16, 17, 33, 5000])
def test_an_entry_of_16_bits_is_off_by_half_a_unit_at_most(make, n_inputs):
    """The kept inputs are read through their combination with weight 1."""
    inputs = make(ROOM, n_inputs, 3)
    projection = ShortProjection(np.zeros((N_ATOMS, n_inputs), np.float32), ROOM)
    projection.keep(0, inputs)
    out = np.empty_like(inputs)
    projection.combine(np.eye(ROOM, N_ATOMS + ROOM, N_ATOMS), out)
    unit = np.abs(inputs).max(axis=1, keepdims=True) / TOP
    assert (np.abs(out - inputs) < 0.51 * unit).all()


@needs_kernel
@pytest.mark.parametrize('n_rows', [1, 3, 4, 5, 15, 16, 17, 31, 32, 40])
@pytest.mark.parametrize('n_inputs', [7, 4095, 4096, 4097, 20_000])
def test_a_product_in_16_bits_is_off_by_half_a_unit_per_entry_at_most(n_rows, n_inputs):
    atoms = np.zeros((N_ATOMS, n_inputs), np.float32)
    kept, inputs = rows_of(n_rows, n_inputs, 1), rows_of(2, n_inputs, 2)
    projection = ShortProjection(atoms, n_rows)
    projection.keep(0, kept)
    products = projection.products(inputs, n_rows)[:, N_ATOMS:]
    bound = np.outer(np.abs(inputs).sum(axis=1), 0.51 * np.abs(kept).max(axis=1) / TOP)
    sums = np.abs(inputs.astype(float)) @ np.abs(kept.T.astype(float))
    assert (np.abs(products - inputs.astype(float) @ kept.T.astype(float))
            <= bound + 1e-6 * sums).all()


@needs_kernel
@pytest.mark.parametrize('make', [rows_of, smooth, plain])
def test_where_rows_are_long_16_bits_cost_a_product_little(make):
    """Relative to the lengths of what is multiplied; a sum of 32 bits is worth some 1e-7."""
    kept, inputs = make(32, LONG, 1), make(8, LONG, 2)
    projection = ShortProjection(np.zeros((N_ATOMS, LONG), np.float32), len(kept))
    projection.keep(0, kept)
    products = projection.products(inputs, len(kept))[:, N_ATOMS:]
    assert deviations(products, inputs, kept.astype(float)).max() < 1e-5


@needs_kernel
@pytest.mark.parametrize('scale', [1e-25, 1e-6, 1.0, 1e6, 1e25])
def test_every_row_has_a_unit_of_its_own(scale):
    kept, inputs = rows_of(2, 100, 1), rows_of(1, 100, 2)
    kept[1] *= np.float32(scale)
    projection = ShortProjection(np.zeros((N_ATOMS, 100), np.float32), ROOM)
    projection.keep(0, kept)
    products = projection.products(inputs, 2)[:, N_ATOMS:]
    assert (deviations(products, inputs, kept.astype(float)) < 1e-4).all()


@needs_kernel
def test_an_input_of_zeros_has_products_of_zero():
    projection = ShortProjection(rows_of(N_ATOMS, 40), ROOM)
    projection.keep(0, np.zeros((1, 40), np.float32))
    projection.keep(1, rows_of(1, 40, 1))
    products = projection.products(rows_of(1, 40, 2), 2)[0, N_ATOMS:]
    assert (products[0], products[1] != 0.0) == (0.0, True)
    np.testing.assert_array_equal(projection.products(np.zeros((1, 40), np.float32), 2), 0.0)


@needs_kernel
@pytest.mark.filterwarnings('ignore::RuntimeWarning')
@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_in_one_input_spoils_no_other(bad):
    kept, inputs = rows_of(5, 300, 1), rows_of(1, 300, 2)
    projection = ShortProjection(rows_of(N_ATOMS, 300), ROOM)
    spoilt = kept.copy()
    spoilt[2, 17] = bad
    projection.keep(0, spoilt)
    products = projection.products(inputs, 5)[:, N_ATOMS:]
    sound = [0, 1, 3, 4]
    assert (deviations(products[:, sound], inputs, kept[sound].astype(float)) < 1e-4).all()
    assert not np.isfinite(products[:, 2]).any()
    inputs[0, 3] = bad
    assert not np.isfinite(projection.products(inputs, 5)).any()


@needs_kernel
def test_long_rows_are_shortened_where_the_kernel_is_there():
    atoms = np.zeros((1, LONG), np.float32)
    assert type(make_projection(atoms, 1)) is ShortProjection
    assert type(make_projection(atoms[:, 1:], 1)) is Projection
    with kernel.disabled():
        assert type(make_projection(atoms, 1)) is Projection


# The Gram matrix

@pytest.mark.parametrize('n_inputs', [1, 100, TERMS - 1, TERMS, TERMS + 1, 90_000])
def test_gram_of_is_the_products_of_all_rows_in_64_bits(n_inputs):
    rows = rows_of(6, n_inputs)
    gram = gram_of(rows)
    assert gram.dtype == np.float64
    lengths = np.linalg.norm(rows, axis=1)
    exact = rows.astype(float) @ rows.T.astype(float)
    assert (np.abs(gram - exact) < 5e-7 * np.outer(lengths, lengths)).all()
