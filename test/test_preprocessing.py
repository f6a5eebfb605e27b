"""From image to view to input vector."""

import numpy as np
import pytest
from vectors import vectors_of

from dlsc_qbs_ros.config import ViewConfig
from dlsc_qbs_ros.core import kernel
from dlsc_qbs_ros.core.preprocessing import (
    DEVIATION, input_scale, make_view, MIN_CONTRAST, N_PAPER, PixelInput)
from dlsc_qbs_ros.errors import ImageError


def picture(rows, columns, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (rows, columns), dtype=np.uint8)


# Image to view

def test_a_view_of_a_whole_ratio_holds_block_means():
    grey = picture(32 * 3, 43 * 5)
    blocks = grey.reshape(32, 3, 43, 5).mean(axis=(1, 3))
    np.testing.assert_allclose(make_view(grey, ViewConfig()), blocks, atol=0.5 + 1e-3)


def test_pixels_under_two_cells_are_shared_by_area():
    """Three columns into two of the least height: (a + b / 2) / 1.5 and (b / 2 + c) / 1.5."""
    grey = np.tile(np.array([[30, 90, 210] * 2], np.uint8), (4, 1))
    expected = np.tile([[50, 170] * 2], (4, 1))
    np.testing.assert_array_equal(make_view(grey, ViewConfig(width=4, height=4)), expected)


@pytest.mark.parametrize('rows, columns', [(260, 346), (480, 640), (33, 44), (720, 1280)])
def test_the_mean_of_the_image_is_kept(rows, columns):
    grey = picture(rows, columns) // 2 + np.linspace(0, 100, columns).astype(np.uint8)
    assert make_view(grey, ViewConfig()).mean() == pytest.approx(grey.mean(), abs=0.1)


@pytest.mark.parametrize('rows, columns', [(260, 346), (480, 640), (65, 87), (1080, 1920)])
def test_a_view_is_what_opencv_makes_by_area(rows, columns):
    cv2 = pytest.importorskip('cv2')
    grey = picture(rows, columns)
    expected = cv2.resize(grey, (43, 32), interpolation=cv2.INTER_AREA).astype(int)
    assert np.abs(make_view(grey, ViewConfig()) - expected).max() <= 1


@pytest.mark.parametrize('value', [0, 1, 127, 254, 255])
def test_a_plain_image_keeps_its_grey(value):
    view = make_view(np.full((97, 211), value, np.uint8), ViewConfig())
    assert (view == value).all()


def test_an_image_smaller_than_the_view_is_enlarged():
    grey = np.array([[10, 200], [60, 90]], np.uint8)
    view = make_view(grey, ViewConfig(width=8, height=6))
    np.testing.assert_array_equal(view, grey.repeat(3, axis=0).repeat(4, axis=1))


def test_an_image_of_the_size_of_the_view_is_the_view_but_not_the_same_memory():
    grey = picture(32, 43)
    view = make_view(grey, ViewConfig())
    np.testing.assert_array_equal(view, grey)
    grey[:] = 0
    assert view.any()


@pytest.mark.parametrize('side, kept', [
    ('crop_top', np.s_[10:, :]), ('crop_bottom', np.s_[:30, :]),
    ('crop_left', np.s_[:, 12:]), ('crop_right', np.s_[:, :36])])
def test_a_crop_cuts_its_share_off_its_side(side, kept):
    grey = picture(40, 48)
    size = {'width': 12, 'height': 10}
    np.testing.assert_array_equal(
        make_view(grey, ViewConfig(**size, **{side: 0.25})),
        make_view(np.ascontiguousarray(grey[kept]), ViewConfig(**size)))


def test_the_image_is_left_as_it_was():
    grey = picture(100, 100)
    grey.flags.writeable = False
    make_view(grey, ViewConfig(crop_top=0.1))


@pytest.mark.parametrize('grey, message', [
    (np.zeros((4, 4, 3), np.uint8), r'a grey uint8 image, got uint8 of shape \(4, 4, 3\)'),
    (np.zeros((4, 4), np.uint16), r'got uint16 of shape \(4, 4\)'),
    (np.zeros((4, 4)), r'got float64'),
    (np.zeros((0, 7), np.uint8), r'nothing is left of an image of 7x0'),
    (np.zeros((7, 0), np.uint8), r'nothing is left of an image of 0x7'),
])
def test_what_is_no_grey_image_is_refused(grey, message):
    with pytest.raises(ImageError, match=message):
        make_view(grey, ViewConfig())


# View to input vector

def views(n, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (n, 32, 43), dtype=np.uint8)


def test_standardised_inputs_have_no_mean_and_one_deviation():
    inputs = vectors_of(views(5), True) / input_scale(32 * 43)
    assert (inputs.shape, inputs.dtype) == ((5, 32 * 43), np.float32)
    np.testing.assert_allclose(inputs.mean(axis=1), 0.0, atol=1e-5)
    np.testing.assert_allclose(inputs.std(axis=1), DEVIATION, rtol=1e-5)


def test_standardised_inputs_do_not_feel_brightness_and_contrast():
    view = views(1) // 4 * 2
    brighter = view // 2 + np.uint8(100)
    np.testing.assert_allclose(
        vectors_of(brighter, True), vectors_of(view, True), atol=1e-3)


def test_inputs_of_the_paper_are_pixels_between_0_and_1():
    view = views(2)
    np.testing.assert_allclose(vectors_of(view, False) / input_scale(32 * 43),
                               view.reshape(2, -1) / 255.0, rtol=1e-6)


def test_rows_are_read_from_left_to_right_and_top_to_bottom():
    view = np.zeros((1, 4, 5), np.uint8)
    view[0, 1, 2] = 255
    assert vectors_of(view, False).argmax() == 1 * 5 + 2


@pytest.mark.parametrize('has_kernel', [True, False])
@pytest.mark.parametrize('standardise', [True, False])
@pytest.mark.parametrize('height, width', [(1, 1), (32, 43), (260, 346)])
def test_the_squared_length_of_an_input_is_known(
        height, width, standardise, has_kernel, monkeypatch):
    if not has_kernel:
        monkeypatch.setattr(kernel, 'LIBRARY', None)
    view = np.random.default_rng(0).integers(90, 256, (height, width), np.uint8)
    vector = PixelInput(view, standardise)
    values = np.asarray(vector).astype(float)
    assert vector.squared_norm == pytest.approx(values @ values, rel=3e-6)


@pytest.mark.parametrize('value', [0, 128, 255])
def test_a_view_without_features_is_nothing(value):
    inputs = vectors_of(np.full((1, 32, 43), value, np.uint8), True)
    np.testing.assert_allclose(inputs, 0.0, atol=1e-3)


def test_noise_around_a_plain_surface_is_not_blown_up():
    view = np.full((1, 32, 43), 100, np.uint8)
    view[0, ::2] += 2
    inputs = vectors_of(view, True) / input_scale(32 * 43)
    assert inputs.std() == pytest.approx(DEVIATION * 1.0 / MIN_CONTRAST, rel=1e-4)


def test_the_scale_is_1_at_the_size_of_the_paper_and_2_at_a_quarter_of_its_pixels():
    assert input_scale(N_PAPER) == 1.0
    assert input_scale(N_PAPER // 4) == pytest.approx(2.0)
