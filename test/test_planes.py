"""Three bytes an entry: what is read is what was written, to the last bit of a float32."""

import numpy as np
import pytest

from dlsc_qbs_ros.core import kernel
from dlsc_qbs_ros.core.planes import BLOCK, PlaneProjection, Planes
from dlsc_qbs_ros.core.preprocessing import PixelInput

pytestmark = pytest.mark.skipif(
    kernel.LIBRARY is None, reason='the compiled kernel was not built')

SIZES = [1, 255, 256, 257, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK + 300]


def written(values):
    planes = Planes(*values.shape)
    for columns in planes.blocks():
        planes[:, columns] = values[:, columns]
    return planes


def read(planes):
    values = np.full(planes.shape, np.nan, np.float32)
    for columns in planes.blocks():
        planes.read(columns.start, values[:, columns])
    return values


def normal(n_columns, scale=1.0, seed=0):
    return (scale * np.random.default_rng(seed).normal(size=(4, n_columns))).astype(np.float32)


def blocks(n_columns):
    return [slice(start, start + BLOCK) for start in range(0, n_columns, BLOCK)]


@pytest.mark.parametrize('n_columns', SIZES)
@pytest.mark.parametrize('scale', [1e-20, 1.0, 1e20])
def test_an_entry_is_off_by_half_a_unit_at_most(n_columns, scale):
    """A unit is 2^-22 of the largest entry in its row and block, or less."""
    values = normal(n_columns, scale)
    result = read(written(values))
    for columns in blocks(n_columns):
        largest = np.abs(values[:, columns]).max(axis=1, keepdims=True)
        assert (np.abs(result - values)[:, columns] <= 2.0 ** -23 * largest).all()


@pytest.mark.parametrize('n_columns', SIZES)
def test_what_was_read_is_written_without_a_change(n_columns):
    values = read(written(normal(n_columns)))
    np.testing.assert_array_equal(read(written(values)), values)


@pytest.mark.parametrize('largest', [2.0 ** 23, np.nextafter(np.float32(1), np.float32(0)), 1.0,
                                     -1.0, np.nextafter(np.float32(-1), np.float32(0)), 3e38])
def test_the_largest_entry_may_be_any(largest):
    values = np.full((1, 3), largest, np.float32) * np.float32([1, -0.25, 0])
    np.testing.assert_allclose(read(written(values)), values, rtol=2.0 ** -22)


def test_zeros_and_what_is_all_but_zero_are_read_as_zeros():
    values = np.float32([[0.0, -0.0, 0.0], [1e-45, 1e-40, -1e-42]])
    np.testing.assert_array_equal(read(written(values)), np.zeros_like(values))


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_spoils_its_row_and_block_only(bad):
    values = normal(3 * BLOCK)
    values[2, BLOCK + 5] = bad
    result = read(written(values))
    assert np.isnan(result[2, BLOCK:2 * BLOCK]).all()
    result[2, BLOCK:2 * BLOCK] = values[2, BLOCK:2 * BLOCK] = 0.0
    np.testing.assert_allclose(result, values, atol=1e-6)


@pytest.mark.parametrize('n_columns', SIZES)
def test_sums_are_those_of_the_rows(n_columns):
    planes = written(normal(n_columns))
    np.testing.assert_allclose(planes.sums(), read(planes).sum(axis=1, dtype=float), rtol=1e-12)


# Products

@pytest.mark.parametrize('n_columns', SIZES)
@pytest.mark.parametrize('pixel', [0, 1, 255])
@pytest.mark.parametrize('entry', [1.0, -1.0, 0.99999994, -0.99999994])
def test_products_are_exact_at_the_ends_of_all_ranges(n_columns, pixel, entry):
    atoms = np.full((3, n_columns), entry, np.float32)
    atoms[0] = 0.0
    inputs = PixelInput(np.full((1, n_columns), pixel, np.uint8), False)
    projection = PlaneProjection(atoms, 2)
    projection.keep(inputs)
    factor = inputs.affine[0]
    products = projection.products(inputs)
    np.testing.assert_allclose(products[:3], factor * pixel * atoms.astype(float).sum(axis=1),
                               rtol=2e-7)
    assert products[3] == pytest.approx(n_columns * (factor * pixel) ** 2, rel=1e-14)


def test_products_are_sums_of_integers():
    """They are those of the atoms that are read, far beyond the precision of float32."""
    n_columns = 3 * BLOCK + 300
    projection = PlaneProjection(normal(n_columns), 2)
    for view in np.random.default_rng(1).integers(0, 256, (2, 4, n_columns // 4), np.uint8):
        inputs = PixelInput(view, True)
        factor, mean, _ = inputs.affine
        expected = projection.atoms.astype(float) @ (factor * (inputs.pixels - mean))
        np.testing.assert_allclose(projection.products(inputs), expected, rtol=1e-11)


def test_atoms_are_made_once_and_never_written_to():
    projection = PlaneProjection(normal(5000), 2)
    atoms = projection.atoms
    assert projection.atoms is atoms
    copy = atoms.copy()
    for seed in range(3):
        other = projection.new_atoms()
        for columns in other.blocks():
            other[:, columns] = normal(5000, seed=seed)[:, columns]
        projection.replace(other, 0)
        np.testing.assert_array_equal(atoms, copy)
        assert np.abs(projection.atoms - atoms).max() > 1.0 or seed == 0
