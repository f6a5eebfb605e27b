"""The hand-made rows of the table: raw template, ORB, thumbnail, histograms of gradients."""

import cv2
import numpy as np
import pytest

from dlsc_qbs_ros.baselines import orb as orb_module
from dlsc_qbs_ros.baselines.hog import Hog
from dlsc_qbs_ros.baselines.orb import Orb, RatioTest
from dlsc_qbs_ros.baselines.sad import RawTemplate, ShiftedSad
from dlsc_qbs_ros.baselines.thumbnail import Thumbnail
from dlsc_qbs_ros.core.local_view import ViewCells
from dlsc_qbs_ros.errors import ImageError

BASELINES = [RawTemplate, Orb, Thumbnail, Hog]


def scene(seed=0, rows=240, columns=320):
    """Return random boxes of all sizes: edges and corners, as between shelves."""
    rng = np.random.default_rng(seed)
    grey = np.full((rows, columns), 128, np.uint8)
    for _ in range(80):
        y, x = rng.integers(0, rows - 8), rng.integers(0, columns - 8)
        height, width = rng.integers(8, 60, 2)
        grey[y:y + height, x:x + width] = rng.integers(0, 256)
    return grey


def value(baseline, a, b):
    """Return how the measure of a baseline compares two images."""
    measure = baseline.measure
    query, kept = (measure.prepare(baseline.describe(grey)) for grey in (a, b))
    return float(measure.compare(query, kept[None])[0])


@pytest.mark.parametrize('make', BASELINES)
class TestEveryBaseline:
    """What ViewCells relies on."""

    def test_an_image_is_most_like_itself(self, make):
        baseline = make()
        cells = ViewCells(baseline.measure)
        for seed in range(6):
            cells.add(baseline.describe(scene(seed)))
        for seed in range(6):
            assert cells.likeness(baseline.describe(scene(seed))).argmax() == seed

    def test_unlike_images_lie_on_the_worse_side_of_like_ones(self, make):
        baseline = make()
        like = value(baseline, scene(), scene() // 8 * 8)
        unlike = value(baseline, scene(), scene(1))
        assert (like - unlike) * baseline.measure.direction > 0

    def test_many_are_compared_as_one_by_one(self, make):
        baseline = make()
        kept = np.stack([
            baseline.measure.prepare(baseline.describe(scene(seed))) for seed in range(5)])
        together = baseline.measure.compare(kept[2], kept)
        assert together.shape == (5,)
        for row, expected in zip(kept, together):
            one, = baseline.measure.compare(kept[2], row[None])
            assert one == pytest.approx(expected, abs=1e-6)

    def test_descriptors_have_one_shape_whatever_the_image_shows(self, make):
        baseline = make()
        images = [scene(), scene(1, 480, 640), np.full((240, 320), 7, np.uint8)]
        shapes = {(d.shape, d.dtype) for d in map(baseline.describe, images)}
        assert len(shapes) == 1

    def test_the_image_is_left_as_it_was(self, make):
        grey = scene()
        grey.flags.writeable = False
        make().describe(grey)

    def test_an_image_with_nothing_in_it_is_like_no_other(self, make):
        """Of the raw template, true of black only: a wall of one grey is a template too."""
        baseline = make()
        blank = np.full((240, 320), 0 if make is RawTemplate else 100, np.uint8)
        cells = ViewCells(baseline.measure)
        cells.add(baseline.describe(scene()))
        cells.add(baseline.describe(blank))
        worst = baseline.measure.direction * baseline.measure.worst
        assert cells.likeness(baseline.describe(blank)).tolist() == [worst, worst]
        assert cells.likeness(baseline.describe(scene()))[1] == worst

    def test_what_is_no_grey_image_is_refused(self, make):
        with pytest.raises(ImageError, match='expected a grey uint8 image, got float64'):
            make().describe(np.zeros((240, 320)))


@pytest.mark.parametrize('make', [RawTemplate, Thumbnail, Hog])
def test_a_like_b_is_as_b_like_a(make):
    baseline = make()
    assert value(baseline, scene(0), scene(1)) == pytest.approx(
        value(baseline, scene(1), scene(0)), abs=1e-6)


@pytest.mark.parametrize('make', [Thumbnail, Hog])
def test_a_similarity_does_not_feel_brightness_and_contrast(make):
    dimmed = scene() // 2 + np.uint8(20)
    assert value(make(), scene(), dimmed) == pytest.approx(1.0, abs=2e-3)


# Raw template

def sad(a, b, max_shift_px):
    measure = ShiftedSad(max_shift_px)
    a, b = (measure.prepare(np.array(rows, np.uint8)) for rows in (a, b))
    return float(measure.compare(a, b[None])[0])


@pytest.mark.parametrize('max_shift_px, expected', [
    (0, (0 + 51 + 51 + 102) / 4),
    (1, (0 + 51 + 51) / 3),
    (2, (0 + 51) / 2),
    (3, 0),
])
def test_the_distance_is_the_mean_over_the_columns_that_overlap_at_the_best_shift(
        max_shift_px, expected):
    """From black, that of the columns that stay in the picture: the leftmost are the darkest."""
    a, b = [[0, 51, 51, 102]], [[0, 0, 0, 0]]
    assert sad(a, b, max_shift_px) == pytest.approx(expected / 255)
    assert sad(b, a, max_shift_px) == pytest.approx(expected / 255)


def test_white_is_as_far_from_black_as_can_be():
    assert sad([[0] * 4] * 3, [[255] * 4] * 3, 1) == 1.0


def test_every_row_shifts_alike():
    """Each row alone has a shift that fits, but none fits both."""
    a = [[9, 0, 0, 0], [0, 9, 0, 0]]
    b = [[0, 9, 0, 0], [9, 0, 0, 0]]
    assert sad(a[:1], b[:1], 1) == sad(a[1:], b[1:], 1) == 0.0
    assert sad(a, b, 1) > 0.0


@pytest.mark.parametrize('shift_px', [-4, -3, -1, 0, 2, 4])
def test_a_template_is_found_again_after_a_turn_of_a_few_columns(shift_px):
    wide = np.random.default_rng(0).integers(0, 256, (20, 80), dtype=np.uint8)
    assert sad(wide[:, 10:70], wide[:, 10 + shift_px:70 + shift_px], 4) == 0.0
    assert sad(wide[:, 10:70], wide[:, 15:75], 4) > 0.1


def test_the_template_holds_the_block_means_of_the_whole_image():
    grey = np.random.default_rng(0).integers(0, 256, (20 * 7, 60 * 3), dtype=np.uint8)
    blocks = grey.reshape(20, 7, 60, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(RawTemplate().describe(grey), blocks, atol=0.5 + 1e-3)


# ORB

def features(*rows):
    """Return features of 32 bytes, each made of one repeated byte."""
    return np.array([[byte] * 32 for byte in rows], np.uint8)


def match(query, other, ratio=0.75):
    measure = RatioTest(ratio)
    return float(measure.compare(measure.prepare(query), measure.prepare(other)[None])[0])


@pytest.mark.parametrize('query, other, expected', [
    ([255, 1], [255, 1], 0.0),              # each finds itself, the other far away
    ([255, 1], [255, 254], 0.5),            # 1 is 7 bits of a byte from 255, 8 from 254
    ([255], [255, 1, 2, 4], 0.75),          # one match of four that were possible
    ([255, 1, 2, 4], [255, 254], 0.75),
    ([255, 0, 0], [255, 1, 0], 0.5),        # a row of zeros is no feature
    ([0, 0], [255, 1], 1.0),
    ([255, 1], [255, 0], 1.0),              # without a second nearest there is no ratio
])
def test_the_distance_counts_the_features_that_pass_the_ratio_test(query, other, expected):
    assert match(features(*query), features(*other)) == pytest.approx(expected)


def test_the_nearest_must_be_clearly_nearer_than_the_second():
    """0x0f is 3 bits of a byte from 0x01 and 4 from 0xff: a ratio of 3 / 4."""
    query, other = features(0x0f), features(0x01, 0xff)
    assert match(query, other, ratio=0.75) == 1.0
    assert match(query, other, ratio=0.76) == 0.5


def test_matches_are_those_of_opencv_s_own_matcher():
    a, b = (Orb(150).describe(scene(seed)) for seed in (0, 1))
    b[:40] = a[30:70]
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(a[a.any(axis=1)], b[b.any(axis=1)], k=2)
    n_matches = sum(first.distance < 0.75 * second.distance for first, second in pairs)
    assert n_matches >= 30
    larger = max(np.count_nonzero(d.any(axis=1)) for d in (a, b))
    assert match(a, b) == pytest.approx(1 - n_matches / larger)


def test_a_view_of_few_features_is_not_like_any_other():
    crowd = Orb().describe(scene())
    few = np.zeros_like(crowd)
    few[:2] = crowd[:2]
    assert match(few, crowd) >= 1 - 2 / 100


class TestMemo:
    """Pairs that were compared once."""

    @staticmethod
    def prepared(n, seed=0):
        rng = np.random.default_rng(seed)
        measure = RatioTest(0.9)
        return measure, np.stack([
            measure.prepare(rng.integers(1, 256, (20, 32), dtype=np.uint8)) for _ in range(n)])

    def test_a_pair_is_matched_once_in_whatever_order_it_is_asked_for(self, monkeypatch):
        measure, kept = self.prepared(5)
        first = measure.compare(kept[0], kept)
        monkeypatch.setattr(orb_module.cv2, 'batchDistance', None)
        np.testing.assert_array_equal(measure.compare(kept[0], kept[::-1]), first[::-1])

    def test_the_two_directions_of_a_pair_are_two(self):
        measure, kept = self.prepared(2, seed=3)
        kept[1, 10:20] = 0  # ten features only
        there, = measure.compare(kept[0], kept[1:])
        back, = measure.compare(kept[1], kept[:1])
        fresh = RatioTest(0.9)
        assert back == fresh.compare(kept[1], kept[:1])[0]
        assert there == fresh.compare(kept[0], kept[1:])[0]

    def test_it_is_emptied_when_full_and_no_value_changes(self, monkeypatch):
        monkeypatch.setattr(orb_module, 'MEMO_PAIRS', 7)
        measure, kept = self.prepared(6)
        first = [measure.compare(query, kept) for query in kept]
        for query, expected in zip(kept, first):
            np.testing.assert_array_equal(measure.compare(query, kept), expected)
            assert sum(map(len, measure._memo.values())) <= 7


@pytest.mark.parametrize('rows, columns', [(0, 0), (1, 1), (24, 120), (31, 31), (62, 62)])
def test_an_image_too_small_for_orb_shows_it_nothing(rows, columns):
    assert not Orb().describe(scene()[:rows, :columns]).any()


def test_orb_gives_no_more_features_than_asked_for_and_zeros_for_those_it_lacks():
    found = Orb(50).describe(scene())
    assert (found.shape, found.dtype) == ((50, 32), np.uint8)
    one_box = np.zeros((240, 320), np.uint8)
    one_box[100:140, 100:160] = 255
    few = Orb(50).describe(one_box)
    n_found = np.count_nonzero(few.any(axis=1))
    assert 0 < n_found < 50
    assert not few[n_found:].any()


# Thumbnail

def test_the_thumbnail_is_compared_by_the_correlation_of_its_pixels():
    a, b = (np.random.default_rng(seed).integers(0, 256, (16, 21), dtype=np.uint8)
            for seed in (0, 1))
    b = (a // 3 + b // 2).astype(np.uint8)
    expected = np.corrcoef(a.ravel(), b.ravel())[0, 1]
    assert value(Thumbnail(), a, b) == pytest.approx(expected, abs=1e-6)


# Histograms of gradients

def histograms(grey):
    """Return the descriptor by block rows, block columns, cells of a block, bins."""
    return Hog().describe(grey).reshape(3, 4, 4, 9)


def test_a_ramp_downwards_fills_the_bin_of_its_direction():
    """The middle one of nine; four equal cells of length 1 are 1/2 each, clipped or not."""
    ramp = np.tile(np.arange(64, dtype=np.uint8)[:, None] * 2, (1, 80))
    expected = np.zeros(9)
    expected[4] = 0.5
    np.testing.assert_allclose(
        histograms(ramp), np.broadcast_to(expected, (3, 4, 4, 9)), atol=1e-6)


def test_a_ramp_to_the_right_lies_between_the_last_bin_and_the_first():
    ramp = np.tile(np.arange(80, dtype=np.uint8) * 2, (64, 1))
    expected = np.zeros(9)
    expected[[0, 8]] = np.sqrt(1 / 8)
    np.testing.assert_allclose(
        histograms(ramp), np.broadcast_to(expected, (3, 4, 4, 9)), atol=1e-6)


def test_dark_on_bright_is_as_bright_on_dark():
    np.testing.assert_allclose(
        Hog().describe(255 - scene()), Hog().describe(scene()), atol=5e-3)  # of rounding


def test_each_cell_counts_where_it_stands():
    """An edge within the first cell shows in the first block and in no other."""
    grey = np.zeros((64, 80), np.uint8)
    grey[4:8, 4:8] = 200
    filled = histograms(grey).any(axis=-1)
    assert np.argwhere(filled).tolist() == [[0, 0, 0]]


def test_noise_on_a_plain_wall_is_not_taken_for_structure():
    wall = np.full((64, 80), 100, np.uint8)
    wall[::8, ::8] += 1
    assert np.linalg.norm(histograms(wall), axis=(-1, -2)).max() < 0.5
    assert np.linalg.norm(histograms(scene()), axis=(-1, -2)).max() == pytest.approx(1, abs=1e-3)
