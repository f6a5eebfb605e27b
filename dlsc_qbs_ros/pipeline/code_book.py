"""The views behind the view cells, and their codes under the dictionary in force."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from dataclasses import dataclass

import numpy as np

from .coder import Coder
from ..config import Config
from ..core.types import Dictionary


@dataclass(frozen=True)
class _Reencoding:
    coder: Coder
    codes: Future


class CodeBook:
    """
    Keeps one 8-bit view per view cell and re-encodes them all for each new dictionary.

    The work is done beside the stream of codes; the swap falls between the last code of one
    epoch and the first of the next, so a map does not depend on how long it took. The last
    `KEPT` dictionaries are remembered, for codes that are late or of a second encoder.
    """

    KEPT = 5

    def __init__(self, config: Config, executor: Executor):
        self._config = config
        self._executor = executor
        self._views: list[np.ndarray] = []
        self._known: dict[int, _Reencoding] = {}
        self._coder: Coder | None = None

    def add_view(self, view: np.ndarray) -> None:
        """Store the view of a new view cell."""
        self._views.append(view)

    def add_dictionary(self, dictionary: Dictionary) -> None:
        """Start to re-encode the views so far under a new dictionary."""
        if self.is_current(dictionary.stamp_ns):
            self._coder = None  # a flight played again: another dictionary by the same name
        self._known.pop(dictionary.stamp_ns, None)
        coder = Coder(dictionary, self._config)
        self._known[dictionary.stamp_ns] = _Reencoding(
            coder, self._executor.submit(coder.encode_views, list(self._views)))
        if len(self._known) > self.KEPT:
            del self._known[next(iter(self._known))]

    def is_current(self, dictionary_ns: int) -> bool:
        """Whether the codes in the book are expressed in this dictionary."""
        return self._coder is not None and self._coder.dictionary.stamp_ns == dictionary_ns

    def missing(self, dictionary_ns: int) -> str | None:
        """Return what `swap` to this dictionary would wait for: nothing, it or its codes."""
        if dictionary_ns not in self._known:
            return 'dictionary'
        return None if self._known[dictionary_ns].codes.done() else 'reencoding'

    def swap(self, dictionary_ns: int) -> np.ndarray:
        """
        Put a new dictionary in force and return the codes of all view cells under it.

        Returns
        -------
        ndarray of shape (n_cells, n_atoms), float32

        """
        ready = self._known[dictionary_ns]
        codes = ready.codes.result()
        late = ready.coder.encode_views(self._views[len(codes):])
        self._coder = ready.coder
        return np.concatenate([codes, late])

    def reencode(self, view: np.ndarray) -> np.ndarray:
        """Return the code of one view under the dictionary in force, to check a code by."""
        return self._coder.encode_views([view])[0]


class InlineExecutor(Executor):
    """Runs what is submitted at once, in the caller's thread."""

    def submit(self, task, /, *args):
        """Run a task and return its future, done."""
        future: Future = Future()
        future.set_result(task(*args))
        return future
