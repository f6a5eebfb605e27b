"""Converged codes of stored views, the same to the last bit however they are batched."""

from loop_flight import LateExecutor
import numpy as np
import pytest

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.inputs import ImageInputs, make_inputs
from dlsc_qbs_ros.core.preprocessing import view_to_inputs
from dlsc_qbs_ros.core.types import Dictionary
from dlsc_qbs_ros.pipeline.code_book import CodeBook, InlineExecutor
from dlsc_qbs_ros.pipeline.coder import Coder

BATCH = ImageInputs.batch
CONFIG = Config().override({
    'encoder.input': 'image', 'view.width': 16, 'view.height': 12, 'encoder.n_atoms': 20})


def dictionary(stamp_ns=1, seed=0, config=CONFIG):
    n = make_inputs(config).n_inputs
    atoms = np.random.default_rng([seed, 1]).normal(0.0, 0.1, (config.encoder.n_atoms, n))
    return Dictionary(stamp_ns, atoms.astype(np.float32))


def views(n, seed=0, config=CONFIG):
    return list(np.random.default_rng(seed).integers(
        0, 256, (n, config.view.height, config.view.width), dtype=np.uint8))


# Codes do not depend on company

@pytest.mark.parametrize('of', ['image', 'patches'])
@pytest.mark.parametrize('n_atoms, width, height', [(20, 16, 12), (64, 43, 32), (37, 21, 17)])
def test_the_code_of_a_view_is_the_same_to_the_last_bit_in_any_company(
        of, n_atoms, width, height):
    config = CONFIG.override({
        'encoder.input': of, 'encoder.n_atoms': n_atoms,
        'view.width': width, 'view.height': height})
    coder = Coder(dictionary(config=config), config)
    stored = views(101, config=config)
    codes = coder.encode_views(stored)
    rng = np.random.default_rng(1)
    for _ in range(10):
        order = rng.permutation(101)[:rng.integers(1, 102)]
        np.testing.assert_array_equal(coder.encode_views([stored[i] for i in order]), codes[order])
    for i in (0, BATCH - 1, BATCH, 100):
        np.testing.assert_array_equal(coder.encode_views([stored[i]])[0], codes[i])


def test_a_view_beside_one_that_converges_slowly_keeps_its_code():
    coder = Coder(dictionary(), CONFIG)
    plain, busy = np.full((12, 16), 9, np.uint8), views(1)[0]
    alone = coder.encode_views([busy])[0]
    for company in ([plain] * 3, views(3, seed=5), [busy] * 3):
        np.testing.assert_array_equal(coder.encode_views([*company, busy])[3], alone)


def test_no_views_have_no_codes():
    assert Coder(dictionary(), CONFIG).encode_views([]).shape == (0, 20)


def test_stored_views_are_encoded_as_inputs_are():
    coder = Coder(dictionary(), CONFIG)
    stored = views(3)
    inputs = view_to_inputs(np.array(stored), True).astype(float)
    expected = coder.encode_products(inputs @ dictionary().atoms.T)
    np.testing.assert_allclose(coder.encode_views(stored), expected, atol=1e-5)


# The book

def book_with(n_views, executor=None):
    book = CodeBook(CONFIG, executor or InlineExecutor())
    for view in views(n_views):
        book.add_view(view)
    return book


def test_a_book_without_a_dictionary_waits_for_one():
    book = book_with(2)
    assert not book.is_current(1)
    assert book.missing(1) == 'dictionary'


def test_a_dictionary_is_in_force_from_the_swap_on():
    book = book_with(2)
    book.add_dictionary(dictionary(5))
    assert book.missing(5) is None
    assert not book.is_current(5)
    codes = book.swap(5)
    assert book.is_current(5)
    np.testing.assert_array_equal(codes, Coder(dictionary(), CONFIG).encode_views(views(2)))


def test_the_swap_waits_for_codes_that_are_late():
    executor = LateExecutor()
    book = book_with(2, executor)
    book.add_dictionary(dictionary(5))
    assert book.missing(5) == 'reencoding'
    executor.complete()
    assert book.missing(5) is None


def test_views_that_came_after_the_dictionary_are_encoded_at_the_swap():
    executor = LateExecutor()
    book = book_with(40, executor)
    book.add_dictionary(dictionary(5))
    for view in views(50)[40:]:
        book.add_view(view)
    executor.complete()
    np.testing.assert_array_equal(
        book.swap(5), Coder(dictionary(), CONFIG).encode_views(views(50)))


def test_an_empty_book_swaps_to_no_codes():
    book = CodeBook(CONFIG, InlineExecutor())
    book.add_dictionary(dictionary(5))
    assert book.swap(5).shape == (0, 20)


def test_the_last_dictionaries_are_remembered_and_no_more():
    book = book_with(1)
    for stamp_ns in range(1, 9):
        book.add_dictionary(dictionary(stamp_ns, seed=stamp_ns))
    assert [book.missing(stamp_ns) for stamp_ns in range(1, 9)] == [
        'dictionary'] * 3 + [None] * CodeBook.KEPT


def test_an_older_dictionary_comes_back_in_force_with_the_views_since():
    book = book_with(2)
    for stamp_ns in (5, 6):
        book.add_dictionary(dictionary(stamp_ns, seed=stamp_ns))
    book.swap(6)
    more = views(3, seed=9)
    for view in more:
        book.add_view(view)
    np.testing.assert_array_equal(
        book.swap(5), Coder(dictionary(5, seed=5), CONFIG).encode_views([*views(2), *more]))
    assert book.is_current(5) and not book.is_current(6)


def test_another_dictionary_by_the_name_of_that_in_force_takes_its_place():
    book = book_with(3)
    book.add_dictionary(dictionary(5, seed=1))
    book.swap(5)
    book.add_dictionary(dictionary(5, seed=2))
    assert not book.is_current(5)
    np.testing.assert_array_equal(
        book.swap(5), Coder(dictionary(5, seed=2), CONFIG).encode_views(views(3)))


def test_one_view_is_encoded_under_the_dictionary_in_force():
    book = book_with(1)
    book.add_dictionary(dictionary(5, seed=1))
    book.swap(5)
    book.add_dictionary(dictionary(6, seed=2))
    view = views(1, seed=9)[0]
    np.testing.assert_array_equal(
        book.reencode(view), Coder(dictionary(5, seed=1), CONFIG).encode_views([view])[0])
