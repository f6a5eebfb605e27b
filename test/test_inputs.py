"""A view as one vector or as all its patches, and the code of a frame made of theirs."""

import numpy as np
import pytest
from vectors import vectors_of

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.inputs import (
    CLIP, ImageInputs, make_inputs, neighbourhoods, patches_of, PatchInputs, pool,
    pooling_weights)
from dlsc_qbs_ros.errors import ConfigError

CONFIG = Config().override({'view.width': 20, 'view.height': 14, 'encoder.n_atoms': 6})


def view(seed=0, shape=(14, 20)):
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


# Which input

def test_the_configuration_names_the_input():
    assert isinstance(make_inputs(CONFIG), PatchInputs)
    assert isinstance(make_inputs(CONFIG.override({'encoder.input': 'image'})), ImageInputs)


def test_a_whole_view_is_one_vector_and_its_code_is_the_code():
    inputs = ImageInputs(CONFIG)
    assert (inputs.n_inputs, inputs.n_values) == (280, 6)
    np.testing.assert_array_equal(inputs.of(view(1)), vectors_of([view(1)], True)[0])
    codes = np.arange(12.0).reshape(2, 6)
    np.testing.assert_array_equal(inputs.pooled(codes), codes)


def test_patches_give_a_code_of_all_cells_and_atoms():
    inputs = PatchInputs(CONFIG)
    assert (inputs.n_inputs, inputs.n_values) == (25, 4 * 5 * 6)
    patches = inputs.of(view())
    assert (patches.shape, patches.dtype) == (((14 - 4) * (20 - 4), 25), np.float32)
    code = inputs.pooled(np.random.default_rng(0).normal(size=(160, 6)))
    assert (code.shape, code.dtype) == ((1, 120), np.float32)


@pytest.mark.parametrize('changes', [
    {'patches.size': 15}, {'patches.size': 11, 'patches.cells_y': 5}, {'patches.cells_x': 17}])
def test_a_view_too_small_for_its_patches_is_refused(changes):
    with pytest.raises(ConfigError, match='a view of 20x14 has .* expected at least'):
        make_inputs(CONFIG.override(changes))


# Patches

def test_a_patch_is_a_window_of_the_view_row_by_row():
    seen = view()
    patches = patches_of(seen, 5)
    pixels = (seen - seen.mean()) / seen.std()
    for k, (row, column) in ((0, (0, 0)), (16 + 3, (1, 3)), (159, (9, 15))):
        window = pixels[row:row + 5, column:column + 5].ravel()
        window = window - window.mean()
        expected = window / (5.0 * np.sqrt(window.var() + 1.0))
        np.testing.assert_allclose(patches[k], expected, atol=1e-5)


def test_patches_have_no_mean_and_a_length_below_one():
    patches = patches_of(view(3), 5)
    np.testing.assert_allclose(patches.sum(axis=1), 0.0, atol=1e-5)
    assert np.linalg.norm(patches, axis=1).max() < 1.0


@pytest.mark.parametrize('gain, offset', [(0.5, 0.0), (0.25, 100.0)])
def test_light_does_not_change_a_patch(gain, offset):
    seen = view(4)
    np.testing.assert_allclose(
        patches_of((gain * seen + offset).astype(np.uint8), 5), patches_of(seen, 5), atol=0.02)


@pytest.mark.parametrize('grey', [0, 77, 255])
def test_a_view_of_nothing_has_patches_of_nothing(grey):
    np.testing.assert_array_equal(patches_of(np.full((14, 20), grey, np.uint8), 5), 0.0)


def test_noise_on_a_plain_view_stays_small():
    """Half a grey level of noise is not blown up to what detail would be."""
    seen = np.full((14, 20), 100, np.uint8)
    seen[::2, ::3] += 1
    assert np.abs(patches_of(seen, 5)).max() < 0.05


# Pooling

def test_cells_share_out_the_patches():
    weights = pooling_weights(28, 39, 4, 5)
    assert weights.shape == (20, 28 * 39)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-5)
    assert (weights >= 0.0).all() and (weights.sum(axis=0) > 0.0).all()
    np.testing.assert_allclose(weights, weights[::-1, ::-1], atol=1e-7)


def test_two_cells_over_four_columns_by_hand():
    """Middles at 0.5 and 2.5, triangles of two columns to each side."""
    np.testing.assert_allclose(
        pooling_weights(1, 4, 1, 2), [[3 / 7, 3 / 7, 1 / 7, 0], [0, 1 / 7, 3 / 7, 3 / 7]],
        atol=1e-6)


def test_neighbours_are_the_cells_around_and_the_cell_itself():
    near = neighbourhoods(2, 3)
    np.testing.assert_allclose(near[0], np.array([1, 1, 0, 1, 1, 0]) / 4)
    np.testing.assert_allclose(near[1], np.ones(6) / 6)


def test_pooling_by_hand():
    """
    Two cells of one patch each, two atoms.

    Powers (4, 0) and (0, 0), energies 4 and 0; around each cell 2, plus a tenth of 2. So the
    one feature is sqrt(4 / 2.2), above the clip, and alone: of length 1.
    """
    codes = np.array([[-2.0, 0.0], [0.0, 0.0]])
    weights, near = np.eye(2, dtype=np.float32), np.full((2, 2), 0.5, np.float32)
    np.testing.assert_allclose(pool(codes, weights, near), [1.0, 0.0, 0.0, 0.0], atol=1e-6)


def pooled(codes, cells=(2, 2), rows=6, columns=6):
    return pool(codes, pooling_weights(rows, columns, *cells), neighbourhoods(*cells))


def random_codes(seed=0):
    return np.random.default_rng(seed).normal(size=(36, 8))


def test_the_code_of_a_frame_has_length_1_and_no_sign():
    code = pooled(random_codes())
    assert np.linalg.norm(code) == pytest.approx(1.0)
    assert (code >= 0.0).all()
    np.testing.assert_allclose(pooled(-random_codes()), code)


def test_contrast_does_not_change_the_code_of_a_frame():
    np.testing.assert_allclose(pooled(7.0 * random_codes()), pooled(random_codes()), atol=1e-6)


def test_no_feature_counts_for_much_more_than_another():
    codes = random_codes()
    codes[:, 0] *= 100.0
    code = pooled(codes).reshape(4, 8)
    assert code[:, 0].max() <= code.max()
    energies = pool(codes, pooling_weights(6, 6, 2, 2), neighbourhoods(2, 2)).reshape(4, 8)
    np.testing.assert_allclose(energies[:, 0], energies[:, 0].max())  # all clipped at CLIP
    assert 0.0 < CLIP < 1.0


def test_a_frame_of_nothing_has_a_code_of_nothing():
    np.testing.assert_array_equal(pooled(np.zeros((36, 8))), 0.0)
