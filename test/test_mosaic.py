"""Atoms as one picture: where each stands and how it is scaled."""

import numpy as np
import pytest

from dlsc_qbs_ros.core.mosaic import MID_GREY, mosaic, SEPARATOR


def test_a_hand_drawn_mosaic():
    """Three atoms of 1 x 2 pixels: two on top, one below, the last cell empty."""
    atoms = np.array([[0.0, 2.0], [-0.5, 0.25], [-8.0, 8.0]])
    np.testing.assert_array_equal(mosaic(atoms, height=1, width=2), [
        [128, 255, 0, 1, 192],
        [0, 0, 0, 0, 0],
        [1, 255, 0, 0, 0]])


@pytest.mark.parametrize('n_atoms, rows, columns', [
    (1, 1, 1), (2, 1, 2), (3, 2, 2), (5, 2, 3), (7, 3, 3), (64, 8, 8), (65, 8, 9), (128, 11, 12)])
def test_the_grid_is_as_square_as_can_be(n_atoms, rows, columns):
    picture = mosaic(np.ones((n_atoms, 12)), height=3, width=4)
    assert picture.dtype == np.uint8
    assert picture.shape == (4 * rows - 1, 5 * columns - 1)
    assert np.count_nonzero(picture) == 12 * n_atoms


def test_atoms_stand_in_reading_order_with_their_pixels_in_place():
    atoms = np.random.default_rng(0).normal(size=(6, 3, 5)).astype(np.float32)
    picture = mosaic(atoms.reshape(6, -1), height=3, width=5)
    for k, atom in enumerate(atoms):
        row, column = divmod(k, 3)
        cell = picture[4 * row:4 * row + 3, 6 * column:6 * column + 5].astype(float)
        np.testing.assert_allclose(
            (cell - MID_GREY) / 127, atom / np.abs(atom).max(), atol=0.5 / 127 + 1e-6)


def test_the_scale_of_an_atom_is_its_own():
    atoms = np.random.default_rng(1).normal(size=(4, 9)).astype(np.float32)
    scales = np.array([[1e-20], [1.0], [512.0], [1e30]], np.float32)
    np.testing.assert_array_equal(mosaic(atoms, 3, 3), mosaic(scales * atoms, 3, 3))


def test_a_negated_atom_is_the_negative_of_its_picture():
    atoms = np.random.default_rng(2).normal(size=(1, 20))
    total = mosaic(atoms, 4, 5).astype(int) + mosaic(-atoms, 4, 5)
    np.testing.assert_array_equal(total, 2 * MID_GREY)


def test_an_atom_of_zeros_is_mid_grey():
    np.testing.assert_array_equal(mosaic(np.zeros((1, 6)), 2, 3), MID_GREY)


@pytest.mark.parametrize('value', [np.nan, np.inf, -np.inf])
@pytest.mark.filterwarnings('error')
def test_an_atom_that_is_not_finite_stays_black_and_hides_no_other(value):
    atoms = np.array([[value, 1.0], [0.0, 1.0]])
    picture = mosaic(atoms, 1, 2)
    np.testing.assert_array_equal(picture, [[SEPARATOR, SEPARATOR, SEPARATOR, MID_GREY, 255]])


def test_the_atoms_are_left_as_they_were():
    atoms = np.arange(6.0).reshape(1, 6)
    atoms.flags.writeable = False
    mosaic(atoms, 2, 3)


def test_atoms_of_another_size_are_refused():
    with pytest.raises(ValueError, match='reshape'):
        mosaic(np.ones((4, 6)), 2, 4)
