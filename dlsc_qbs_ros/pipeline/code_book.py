"""The views behind the view cells, and their codes under the dictionary in force."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from typing import Callable, Protocol

import numpy as np

from .coder import Coder
from ..config import Config
from ..core.types import Code, Dictionary


class Cells(Protocol):
    """What is made of codes."""

    def extend(self, codes: np.ndarray) -> None:
        """Take in codes (n, n_values) of more view cells."""


@dataclass
class _Reencoding:
    """
    The codes of all view cells under another dictionary, on their way.

    They are waited for at the first code whose stamp is out of `waiting_ns`.
    """

    coder: Coder
    chunks: list[Future]
    cells: Future
    waiting_ns: range
    codes_since: list[np.ndarray] = field(default_factory=list)


class CodeBook:
    """
    Keeps one 8-bit view per view cell and re-encodes them all when the dictionary changes.

    The work is done beside the stream of codes. Until it is due, `PER_VIEW_NS` per view after
    the first code of the new dictionary, what comes is encoded under the old one too, so that
    nothing waits and all view cells stay comparable. The swap falls at a stamp, hence a map does
    not depend on how long the work took; only a machine slower than that has to be waited for.
    The last `KEPT` dictionaries are remembered, for codes that are late or of a second encoder.
    """

    KEPT = 5
    CHUNK = 64
    PER_VIEW_NS = 40_000_000

    def __init__(self, config: Config, executor: Executor,
                 cells_of: Callable[[np.ndarray], Cells]):
        self._config = config
        self._executor = executor
        self._cells_of = cells_of
        self._views: list[np.ndarray] = []
        self._known: dict[int, Coder] = {}
        self._in_force: Coder | None = None
        self._next: _Reencoding | None = None

    views = property(lambda self: self._views)

    @property
    def newest(self) -> list[Dictionary]:
        """Return the dictionary that came last, if any."""
        return [coder.dictionary for coder in [*self._known.values()][-1:]]

    @property
    def is_restoring(self) -> bool:
        """Whether no code can be used before views that were restored are encoded."""
        return (self._next is not None and not self._next.waiting_ns
                and not self._next.cells.done())

    def restore(self, views: np.ndarray, dictionaries: list[Dictionary]) -> None:
        """
        Begin, where nothing was stored yet, with views (n, height, width), uint8.

        Codes wait until these are encoded under the last of the dictionaries.
        """
        self._views = list(views)
        for dictionary in dictionaries:
            self.add_dictionary(dictionary)
        if dictionaries:
            self._begin(self._known[dictionaries[-1].stamp_ns], range(0))

    def add_view(self, view: np.ndarray, code: Code) -> None:
        """Store the view of a new view cell, and the code that came with it."""
        self._views.append(view)
        if self._next is not None:
            is_new = self._known.get(code.dictionary_ns) is self._next.coder and view.any()
            self._next.codes_since.append(
                code.values if is_new else self._next.coder.encode_views([view])[0])

    def add_dictionary(self, dictionary: Dictionary) -> None:
        """Take in a dictionary; one that comes a second time is the same."""
        known = self._known.pop(dictionary.stamp_ns, None)
        if known is None or not np.array_equal(known.dictionary.atoms, dictionary.atoms):
            known = Coder(dictionary, self._config)
        self._known[dictionary.stamp_ns] = known
        if len(self._known) > self.KEPT:
            del self._known[next(iter(self._known))]

    def missing(self, code: Code) -> str | None:
        """Return what a code has to wait for: nothing, its dictionary or the view cells' codes."""
        if code.dictionary_ns not in self._known:
            return 'dictionary'
        is_ready = not self._is_due(code) or self._next.cells.done()
        return None if is_ready else 'reencoding'

    def advance(self, code: Code) -> Cells | None:
        """Go on to a code that misses nothing; return the cells of another dictionary, if due."""
        cells = self._swap() if self._is_due(code) else None
        coder = self._known[code.dictionary_ns]
        if coder is self._in_force or self._next is not None:
            return cells
        if not self._views:
            self._in_force = coder
            return self._cells_of(coder.encode_views([]))
        self._begin(coder, range(
            code.stamp_ns, code.stamp_ns + len(self._views) * self.PER_VIEW_NS))
        return cells

    def in_force(self, code: Code, view: np.ndarray) -> np.ndarray:
        """Return the values of a code under the dictionary in force."""
        if self._known[code.dictionary_ns] is self._in_force:
            return code.values
        return self._in_force.encode_views([view])[0]

    def reencode(self, code: Code, view: np.ndarray) -> np.ndarray:
        """Return what the values of a code should be, to check them by."""
        return self._known[code.dictionary_ns].encode_views([view])[0]

    def cancel(self) -> None:
        """Let go of work that is not needed any more."""
        for future in [*self._next.chunks, self._next.cells] if self._next else ():
            future.cancel()

    def _begin(self, coder: Coder, waiting_ns: range) -> None:
        chunks = [
            self._executor.submit(coder.encode_views, self._views[start:start + self.CHUNK])
            for start in range(0, len(self._views), self.CHUNK)]
        self._next = _Reencoding(
            coder, chunks, self._executor.submit(self._assemble, coder, chunks), waiting_ns)

    def _assemble(self, coder: Coder, chunks: list[Future]) -> Cells:
        return self._cells_of(np.vstack(
            [coder.encode_views([]), *(chunk.result() for chunk in chunks)]))

    def _is_due(self, code: Code) -> bool:
        return self._next is not None and code.stamp_ns not in self._next.waiting_ns

    def _swap(self) -> Cells:
        """Put the next dictionary in force and return all view cells under it."""
        done, self._next = self._next, None
        self._in_force = done.coder
        cells = done.cells.result()
        if done.codes_since:
            cells.extend(np.array(done.codes_since))
        return cells


class InlineExecutor(Executor):
    """Runs what is submitted at once, in the caller's thread."""

    def submit(self, task, /, *args):
        """Run a task and return its future, done."""
        future: Future = Future()
        future.set_result(task(*args))
        return future
