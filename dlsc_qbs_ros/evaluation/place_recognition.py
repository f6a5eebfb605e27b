"""How well places are recognised: precision and recall of the best earlier view of each view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable, Iterable, Sequence

import numpy as np

from .association import associate
from ..core.geometry import wrap_angle
from ..core.local_view import ViewCells
from ..core.types import Code, Dictionary, GroundTruthSample, View

# The best view at least so much earlier is the match, right when it is so near.
MIN_AGE_S = 15.0
MAX_DISTANCE_M = 1.0
MAX_TURN_RAD = 0.5
# Every pair of views is compared: of longer flights, every k-th view is taken.
MAX_VIEWS = 400

# From a dictionary and views to the codes (n_views, n_values) of those under it.
Encode = Callable[[Dictionary, list[np.ndarray]], np.ndarray]


@dataclass(frozen=True)
class Recognition:
    """
    The matches of a flight, the surest first.

    Attributes
    ----------
    precision : ndarray of shape (n,)
        The share of matches that are right, among the first k.
    recall : ndarray of shape (n,)
        The share of all revisits that are found by then; of equally sure matches, only the last
        has its place in both.
    top_1 : float
        The share of revisits whose match is right, however sure.
    n_revisits : int
        The views that have an earlier one of the same place.
    n_views : int
        The views that were taken and have ground truth, of which each was compared with all that
        are old enough.

    """

    precision: np.ndarray
    recall: np.ndarray
    top_1: float
    n_revisits: int
    n_views: int

    def recall_at(self, precision: float) -> float:
        """Return the largest share of revisits found at this precision: R99 at 0.99."""
        return float(self.recall[self.precision >= precision].max(initial=0.0))

    def as_json(self) -> dict[str, Any]:
        """Return the figures for metrics.json."""
        return {'top_1': self.top_1, 'r99': self.recall_at(0.99), 'r90': self.recall_at(0.90),
                'revisits': self.n_revisits, 'views': self.n_views}


def recognise(events: Iterable, ground_truth: Sequence[GroundTruthSample], book: ViewCells,
              encode: Encode, under_last: bool = False) -> Recognition | None:
    """
    Match the views of a flight, as a code book would.

    Parameters
    ----------
    events : iterable
        What came out of the encoder (`pipeline.runner.EncodedFlight.events`): each view and its
        code, and each dictionary before the first code under it.
    ground_truth : sequence of GroundTruthSample
        In any order; a view without any is left out, as a match, too.
    book : ViewCells
        A code book that is still empty; it says how codes are compared.
    encode : callable
        How views are re-encoded.
    under_last : bool
        False: as it flew, each code under the dictionary of its time, with all earlier views
        re-encoded under that. True: everything under the last dictionary.

    Returns
    -------
    Recognition or None
        None where no place was visited twice.

    """
    views, codes, dictionaries = _sampled(events)
    poses = associate(_stamps_ns(codes), ground_truth)
    has_truth = np.isfinite(poses).all(axis=1)
    views, codes = ([item for item, is_kept in zip(items, has_truth) if is_kept]
                    for items in (views, codes))
    poses = poses[has_truth]
    if under_last and dictionaries:
        name, dictionary = list(dictionaries.items())[-1]
        values = encode(dictionary, [view.pixels for view in views])
        codes = [Code(code.stamp_ns, row, name) for code, row in zip(codes, values)]
    matches, scores = _matches(views, codes, dictionaries, book, encode)
    n_old = _n_old(_stamps_ns(codes))
    has_revisit = np.array([is_same(poses[:n], pose).any() for n, pose in zip(n_old, poses)])
    used = n_old > 0
    if not has_revisit.any():
        return None
    right = np.array([is_same(poses[match:match + 1], pose).all()
                      for match, pose in zip(matches, poses)])
    return _recognition(scores[used], (right & has_revisit)[used], int(has_revisit.sum()),
                        len(views))


def _sampled(events: Iterable) -> tuple[list[View], list[Code], dict[int, Dictionary]]:
    """Return at most MAX_VIEWS views at equal distances, their codes and all dictionaries."""
    views, codes, dictionaries = [], [], {}
    for event in events:
        if isinstance(event, View):
            views.append(event)
        elif isinstance(event, Code):
            codes.append(event)
        elif isinstance(event, Dictionary):
            dictionaries[event.stamp_ns] = event
    step = -(-len(codes) // MAX_VIEWS) or 1
    return views[::step], codes[::step], dictionaries


def _stamps_ns(codes: list[Code]) -> np.ndarray:
    return np.array([code.stamp_ns for code in codes], np.int64)


def _n_old(stamps_ns: np.ndarray) -> np.ndarray:
    """Return how many of the views are old enough to be matched, for each view."""
    stamps_ns = np.maximum.accumulate(stamps_ns)  # a clock that falls back makes nothing older
    return np.searchsorted(stamps_ns, stamps_ns - round(MIN_AGE_S * 1e9), side='right')


def _matches(views: list[View], codes: list[Code], dictionaries: dict[int, Dictionary],
             book: ViewCells, encode: Encode) -> tuple[np.ndarray, np.ndarray]:
    """Return the index of the best old view of each view, and how alike the two are."""
    matches, scores = np.zeros(len(codes), int), np.zeros(len(codes))
    n_old = _n_old(_stamps_ns(codes))
    current: int | None = None
    values: list[np.ndarray] = []
    for k, code in enumerate(codes):
        if code.dictionary_ns != current:
            current = code.dictionary_ns
            values = list(encode(dictionaries[current], [view.pixels for view in views[:k]]))
            if len(book):
                book.replace(np.array(values[:len(book)]))
        values.append(code.values)
        while len(book) < n_old[k]:
            book.add(values[len(book)])
        if len(book):
            likeness = book.likeness(code.values)
            matches[k] = np.argmax(likeness)
            scores[k] = likeness[matches[k]]
    return matches, scores


def is_same(poses: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Whether n poses (n, 3) are of the place and heading of one, or each its own; NaN is not."""
    apart = poses - others
    return ((np.hypot(apart[:, 0], apart[:, 1]) <= MAX_DISTANCE_M)
            & (np.abs(wrap_angle(apart[:, 2])) <= MAX_TURN_RAD))


def _recognition(scores: np.ndarray, right: np.ndarray, n_revisits: int, n_views: int
                 ) -> Recognition:
    order = np.argsort(-scores, kind='stable')
    n_right = right[order].cumsum()
    is_last = np.append(np.diff(scores[order]) < 0.0, True)
    accepted = np.arange(1, len(order) + 1)[is_last]
    return Recognition(n_right[is_last] / accepted, n_right[is_last] / n_revisits,
                       int(n_right[-1]) / n_revisits, n_revisits, n_views)
