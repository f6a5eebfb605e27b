"""Converged codes of stored views, the same to the last bit however they are batched."""

from dataclasses import replace

from loop_flight import LateExecutor
import numpy as np
import pytest
from vectors import vectors_of

from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.inputs import ImageInputs, make_inputs
from dlsc_qbs_ros.core.types import Code, Dictionary
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
    inputs = vectors_of(stored, True).astype(float)
    expected = coder.encode_products(inputs @ dictionary().atoms.T)
    np.testing.assert_allclose(coder.encode_views(stored), expected, atol=1e-5)


# The book

class Codes:
    """The simplest cells: the codes as they are."""

    def __init__(self, codes):
        self.codes = codes

    def extend(self, codes):
        self.codes = np.vstack([self.codes, codes])


def code(stamp_ns, dictionary_ns, view=None, seed=0):
    """Return the code of a view under a dictionary as the encoder sends it."""
    values = np.ones(20, np.float32) if view is None else Coder(
        dictionary(dictionary_ns, seed), CONFIG).encode_views([view])[0]
    return Code(stamp_ns, values, dictionary_ns)


def encoded(stored, seed):
    return Coder(dictionary(seed=seed), CONFIG).encode_views(stored)


def book_under(dictionary_ns, n_views, executor=None):
    """Return a book with a dictionary, its seed its name, in force since 100 ns."""
    book = CodeBook(CONFIG, executor or InlineExecutor(), Codes)
    book.add_dictionary(dictionary(dictionary_ns, seed=dictionary_ns))
    book.advance(code(100, dictionary_ns))
    for view in views(n_views):
        book.add_view(view, code(100, dictionary_ns))
    return book


def due_ns(begun_ns, n_views):
    return begun_ns + n_views * CodeBook.PER_VIEW_NS


def test_a_book_without_a_dictionary_waits_for_one():
    assert CodeBook(CONFIG, InlineExecutor(), Codes).missing(code(1, 5)) == 'dictionary'


def test_the_first_dictionary_is_in_force_at_once():
    book = CodeBook(CONFIG, InlineExecutor(), Codes)
    book.add_dictionary(dictionary(5))
    assert book.missing(code(1, 5)) is None
    assert book.advance(code(1, 5)).codes.shape == (0, 20)
    assert book.advance(code(2, 5)) is None


def test_another_dictionary_is_in_force_from_a_stamp_on_that_goes_by_the_number_of_views():
    book = book_under(5, 3)
    book.add_dictionary(dictionary(6, seed=6))
    assert book.advance(code(200, 6)) is None
    assert book.advance(code(due_ns(200, 3) - 1, 6)) is None
    np.testing.assert_array_equal(
        book.advance(code(due_ns(200, 3), 6)).codes, encoded(views(3), seed=6))
    assert book.advance(code(due_ns(200, 3) + 1, 6)) is None


def test_until_then_views_are_encoded_under_the_old_dictionary():
    book, view = book_under(5, 3), views(1, seed=9)[0]
    book.add_dictionary(dictionary(6, seed=6))
    new = code(200, 6, view, seed=6)
    book.advance(new)
    np.testing.assert_array_equal(book.in_force(new, view), encoded([view], seed=5)[0])
    np.testing.assert_array_equal(book.reencode(new, view), new.values)
    new = replace(new, stamp_ns=due_ns(200, 3))
    book.advance(new)
    assert book.in_force(new, view) is new.values


def test_nothing_waits_for_the_work_before_it_is_due():
    executor = LateExecutor()
    book = book_under(5, 3, executor)
    book.add_dictionary(dictionary(6, seed=6))
    book.advance(code(200, 6))
    assert book.missing(code(due_ns(200, 3) - 1, 6)) is None
    assert book.missing(code(due_ns(200, 3), 6)) == 'reencoding'
    executor.complete()
    assert book.missing(code(due_ns(200, 3), 6)) is None


@pytest.mark.parametrize('n_views', [2, CodeBook.CHUNK, 2 * CodeBook.CHUNK + 1])
def test_view_cells_made_meanwhile_are_in_the_book_too(n_views):
    """Their codes came with them; those under a third dictionary are made here."""
    book = book_under(5, n_views)
    for stamp_ns in (6, 7):
        book.add_dictionary(dictionary(stamp_ns, seed=stamp_ns))
    book.advance(code(200, 6))
    more = views(3, seed=9)
    for view, name in zip(more, (6, 7, 5)):
        book.add_view(view, code(300, name, view, seed=name))
    np.testing.assert_allclose(book.advance(code(due_ns(200, n_views), 7)).codes,
                               encoded([*views(n_views), *more], seed=6), atol=1e-6)


def test_a_view_without_content_that_comes_meanwhile_has_a_code_without():
    """A camera that hangs sends the code of a view that the map takes for blank."""
    book = book_under(5, 2)
    book.add_dictionary(dictionary(6, seed=6))
    book.advance(code(200, 6))
    book.add_view(np.zeros((12, 16), np.uint8), code(300, 6))
    assert not book.advance(code(due_ns(200, 2), 6)).codes[2].any()


def test_a_dictionary_that_comes_meanwhile_is_next():
    book = book_under(5, 2)
    for stamp_ns in (6, 7):
        book.add_dictionary(dictionary(stamp_ns, seed=stamp_ns))
    book.advance(code(200, 6))
    first = due_ns(200, 2)
    np.testing.assert_array_equal(book.advance(code(first, 7)).codes, encoded(views(2), seed=6))
    np.testing.assert_array_equal(
        book.advance(code(due_ns(first, 2), 7)).codes, encoded(views(2), seed=7))


def test_a_clock_that_falls_back_puts_nothing_off():
    book = book_under(5, 2)
    book.add_dictionary(dictionary(6, seed=6))
    book.advance(code(200, 6))
    assert book.advance(code(150, 6)) is not None


def test_a_dictionary_that_comes_twice_is_the_same_but_not_another_by_its_name():
    book = book_under(5, 2)
    book.add_dictionary(dictionary(5, seed=5))
    assert book.in_force(code(200, 5), None) is not None
    book.add_dictionary(dictionary(5, seed=8))
    book.advance(code(200, 5))
    np.testing.assert_array_equal(
        book.advance(code(due_ns(200, 2), 5)).codes, encoded(views(2), seed=8))


def test_the_last_dictionaries_are_remembered_and_no_more():
    book = book_under(1, 1)
    for stamp_ns in range(2, 9):
        book.add_dictionary(dictionary(stamp_ns, seed=stamp_ns))
    assert [book.missing(code(100, stamp_ns)) for stamp_ns in range(1, 9)] == [
        'dictionary'] * 3 + [None] * CodeBook.KEPT


def test_a_restored_book_waits_for_the_codes_of_its_views():
    executor = LateExecutor()
    book = CodeBook(CONFIG, executor, Codes)
    book.restore(np.array(views(70)), [dictionary(5, seed=5), dictionary(6, seed=6)])
    assert book.missing(code(100, 5)) == 'reencoding'
    executor.complete()
    np.testing.assert_array_equal(book.advance(code(100, 6)).codes, encoded(views(70), seed=6))


def test_work_that_is_let_go_of_is_not_done():
    executor = LateExecutor()
    book = CodeBook(CONFIG, executor, Codes)
    book.restore(np.array(views(70)), [dictionary(5)])
    book.cancel()
    executor.complete()
    assert all(chunk.cancelled() for chunk in [*book._next.chunks, book._next.cells])
