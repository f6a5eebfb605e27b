"""View cells are compared by cosine, and runs of them by the mean along the run."""

import numpy as np
import pytest

from dlsc_qbs_ros.core.local_view import CentredCells, COMMON, Cosine, ViewCells


# View cells

class Apart:
    """A distance: the largest difference of any entry."""

    direction, worst = -1, 9.0

    def prepare(self, descriptor):
        return descriptor.astype(np.float32)

    def compare(self, query, kept):
        return np.abs(kept - query).max(axis=(1, 2))


def book(codes, cells=None):
    cells = ViewCells(Cosine()) if cells is None else cells
    for code in codes:
        cells.add(np.asarray(code, np.float32))
    return cells


def unit(codes):
    return Cosine().prepare(np.asarray(codes))


def test_likeness_is_the_cosine_of_the_paper():
    cells = book(([3.0, 4.0], [0.0, 2.0], [-6.0, -8.0], [4.0, -3.0]))
    np.testing.assert_allclose(
        cells.likeness(np.array([30.0, 40.0])), [1.0, 0.8, -1.0, 0.0], atol=1e-6)


def test_a_distance_is_likeness_with_a_minus_sign_and_descriptors_have_any_shape():
    cells = book((np.ones((2, 3)), np.full((2, 3), 4.0), np.zeros((2, 3))), ViewCells(Apart()))
    assert cells.kept.shape == (3, 2, 3)
    np.testing.assert_array_equal(cells.likeness(np.full((2, 3), 2.0)), [-1.0, -2.0, -9.0])
    np.testing.assert_array_equal(cells.likeness(np.zeros((2, 3))), [-9.0, -9.0, -9.0])


def test_cells_are_numbered_as_they_come():
    cells = ViewCells(Cosine())
    assert len(cells) == 0
    assert [cells.add(np.ones(3)) for _ in range(200)] == list(range(200))
    assert len(cells) == 200
    assert cells.kept.shape == (200, 3)


def test_many_cells_keep_their_codes_while_the_book_grows():
    codes = np.random.default_rng(0).normal(size=(500, 8))
    np.testing.assert_allclose(book(codes).kept, unit(codes), atol=1e-6)


@pytest.mark.parametrize('cells', [ViewCells(Cosine()), CentredCells()])
def test_an_empty_book_resembles_nothing(cells):
    assert cells.likeness(np.ones(4)).shape == (0,)


@pytest.mark.parametrize('cells', [ViewCells(Cosine()), CentredCells()])
def test_a_code_of_nothing_resembles_nothing(cells):
    book(np.vstack([np.zeros(3), np.eye(3)]), cells)
    np.testing.assert_array_equal(cells.likeness(np.zeros(3)), [0.0] * 4)
    seen = cells.likeness(np.eye(3)[0])
    assert seen[0] == 0.0 and np.argmax(seen) == 1


def test_a_new_book_takes_the_place_of_the_old_and_goes_on_growing():
    cells = book(3 * [[1.0, 0.0]])
    cells.replace(np.array([[0.0, 5.0], [2.0, 0.0], [0.0, 0.0]], np.float32))
    assert cells.add(np.array([0.0, -1.0])) == 3
    np.testing.assert_allclose(
        cells.likeness(np.array([0.0, 1.0])), [1.0, 0.0, 0.0, -1.0], atol=1e-6)


def test_units_have_length_1():
    codes = np.random.default_rng(0).normal(size=(4, 5))
    np.testing.assert_allclose(np.linalg.norm(unit(codes), axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(unit(codes)[1], codes[1] / np.linalg.norm(codes[1]), atol=1e-6)


# Codes about their mean

def about_the_mean(codes, query):
    """Return the cosines by the definition."""
    codes, query = unit(codes).astype(float), unit(query).astype(float)
    mean = COMMON * codes.mean(axis=0)
    return [float((code - mean) @ (query - mean)
                  / np.linalg.norm(code - mean) / np.linalg.norm(query - mean))
            for code in codes]


@pytest.mark.parametrize('replaced', [False, True])
def test_codes_are_compared_about_their_mean(replaced):
    """However the book came about, cell by cell or as a whole and then cell by cell."""
    codes = 1.0 + np.random.default_rng(4).normal(size=(60, 12))
    cells = book(np.ones((40, 12)) if replaced else codes[:40], CentredCells())
    if replaced:
        cells.replace(codes[:40].astype(np.float32))
    book(codes[40:], cells)
    query = 1.0 + np.random.default_rng(5).normal(size=12)
    np.testing.assert_allclose(cells.likeness(query), about_the_mean(codes, query), atol=1e-6)


def test_what_all_codes_have_in_common_makes_no_two_of_them_alike():
    codes = 5.0 + np.random.default_rng(6).normal(size=(80, 20))
    plain, centred = book(codes), book(codes, CentredCells())
    assert np.median(plain.likeness(codes[0])) > 0.95
    assert np.median(centred.likeness(codes[0])) < 0.8
    assert centred.likeness(codes[0])[0] == pytest.approx(1.0)


def test_a_book_of_one_code_knows_it_again():
    cells = book([[1.0, 2.0]], CentredCells())
    assert cells.likeness(np.array([2.0, 4.0])) == pytest.approx([1.0])


def large_book(monkeypatch, n=300, n_values=200, n_exact=20):
    """Return codes that have much in common, the large book of them, and the plain one."""
    rng = np.random.default_rng(2)
    codes = (4.0 + rng.normal(size=(n, n_values))).astype(np.float32)
    plain = book(codes, CentredCells())
    monkeypatch.setattr(CentredCells, 'LARGE', 100)
    monkeypatch.setattr(CentredCells, 'N_EXACT', n_exact)
    return codes, book(codes, CentredCells()), plain


def test_the_best_cells_of_a_large_book_are_compared_as_those_of_a_small_one(monkeypatch):
    codes, large, plain = large_book(monkeypatch)
    noise = np.random.default_rng(3).normal(size=codes.shape)
    for k in range(0, 300, 20):
        query = codes[k] + 0.5 * noise[k]
        monkeypatch.setattr(CentredCells, 'LARGE', 1000)
        expected = plain.likeness(query)
        monkeypatch.setattr(CentredCells, 'LARGE', 100)
        found = large.likeness(query)
        assert np.argmax(found) == k
        assert found[k] == pytest.approx(expected[k], abs=1e-6)
        assert np.count_nonzero(np.abs(found - expected) < 1e-6) >= CentredCells.N_EXACT
        assert np.std(found - expected) < 0.08


def test_a_large_book_is_alike_however_it_came_about_and_knows_blank_codes(monkeypatch):
    codes, large, _ = large_book(monkeypatch)
    codes[7] = 0.0
    large.replace(codes[:200])
    large.extend(codes[200:])
    assert large.likeness(codes[5])[7] == 0.0
    assert not large.likeness(codes[7]).any()
    np.testing.assert_allclose(
        large.likeness(codes[5]), book(codes, CentredCells()).likeness(codes[5]), atol=1e-5)
