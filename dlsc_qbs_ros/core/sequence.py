"""How alike the last views and a row of view cells are, as runs of their length."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np


class Look(NamedTuple):
    """One of the last views: its station, its likeness to the cells, and the best around each."""

    station: int
    likeness: np.ndarray
    slack: int
    best: np.ndarray


class SequenceScore:
    """
    The mean similarity of the last views to a run of view cells that were made in a row.

    A single view of one shelf looks like one of the next; a run of them less so. View cells are
    made at equal distances: a second pass meets one per view, give or take `slack`. Places at
    these distances are stations. Where views are missing, on this pass or when the cells were
    made, stations are passed without a view or have no cell. They count for nothing, and a run
    reaches back over them, by `REACH` times its length at most, to be of as many views.

    Attributes
    ----------
    is_whole : ndarray of shape (n_cells,), bool
        Whether the run that ends in each view cell is of as many views as make one.

    """

    REACH = 2
    # How many stations were passed without a view is known to this share of them.
    UNSURE = 0.4

    def __init__(self, length: int, slack: int = 1, shortest: int | None = None):
        self._length = length
        self._shortest = length if shortest is None else min(shortest, length)
        self._slack = slack
        self._looks: deque[Look] = deque(maxlen=self.REACH * length)
        self._station = 0
        self.is_whole = np.zeros(0, bool)

    def state(self, n_cells: int) -> dict[str, np.ndarray]:
        """Return what `restore` takes, by the names in `map_state.ARRAYS`."""
        likenesses = np.full((len(self._looks), n_cells), -1.0, np.float32)
        for row, look in zip(likenesses, self._looks):
            row[:len(look.likeness)] = look.likeness
        return {'look_likenesses': likenesses, 'looks': np.array(
            [(self._station - look.station, look.slack, len(look.likeness))
             for look in self._looks], int).reshape(-1, 3)}

    def restore(self, state: dict[str, np.ndarray], stations: np.ndarray) -> None:
        """Go on from what `state` returned, with the stations (n_cells,) of the cells."""
        self._looks.extend(
            self._look(self._station - back, likeness[:n_cells], slack, stations)
            for likeness, (back, slack, n_cells) in zip(state['look_likenesses'].copy(),
                                                        state['looks'].tolist()))

    def clear(self) -> None:
        """Forget the views so far: the next one does not continue them."""
        self._looks.clear()

    def skip(self, n_stations: int, stations: np.ndarray) -> None:
        """Pass about so many stations without a view; `stations` (n_cells,) are the cells'."""
        slack = int(np.ceil(self.UNSURE * n_stations))
        self._station += n_stations
        self._looks = deque(
            [self._look(look.station, look.likeness, look.slack + slack, stations)
             for look in self._looks], self._looks.maxlen)

    def update(self, similarities: np.ndarray, stations: np.ndarray | None = None
               ) -> np.ndarray | None:
        """
        Take in the similarities of the next view, shape (n_cells,).

        Parameters
        ----------
        similarities : ndarray of shape (n_cells,)
            How alike the view and each view cell are.
        stations : ndarray of shape (n_cells,), int, optional
            The rising stations of the cells, from 0; left out, there is a cell at each.

        Returns
        -------
        ndarray of shape (n_cells,) or None
            The score of the run that ends in each view cell, -1 where that is of less than
            `shortest` views; None until so many came, which are `length` if left out.

        """
        stations = np.arange(len(similarities)) if stations is None else stations
        self._station += 1
        self._looks.append(self._look(self._station, similarities, self._slack, stations))
        total, n_views = self._sum(similarities, stations)
        self.is_whole = n_views == self._length
        if len(self._looks) < self._shortest:
            return None
        score = total / n_views.astype(total.dtype)
        score[n_views < self._shortest] = -1.0
        return score

    def _sum(self, similarities: np.ndarray, stations: np.ndarray
             ) -> tuple[np.ndarray, np.ndarray]:
        """Return the sums along the runs that end in each cell, and of how many views, (n,)."""
        total, earlier = _at_stations(similarities, stations), [*self._looks][-2::-1]
        if len(total) == len(stations):  # no station lacks a cell, so all views count
            earlier = earlier[:self._length - 1]
            for look in earlier:
                total += _behind(look, self._station - look.station, len(total))
            return total, np.full(len(total), len(earlier) + 1)
        n_views = np.ones(len(total), np.int16)
        for look in earlier:
            values = _behind(look, self._station - look.station, len(total))
            is_used = ~np.isnan(values) & (n_views < self._length)
            np.add(total, values, out=total, where=is_used)
            n_views += is_used
        return total[stations], n_views[stations]

    def _look(self, station: int, likeness: np.ndarray, slack: int, stations: np.ndarray) -> Look:
        slack = min(slack, self._length)
        row = _at_stations(likeness, stations[:len(likeness)])
        return Look(station, likeness, slack, _best_around(row, slack))


def _at_stations(values: np.ndarray, stations: np.ndarray) -> np.ndarray:
    """Return the values of cells station by station; NaN where there is no cell."""
    n_stations = int(stations[-1]) + 1 if len(stations) else 0
    if n_stations == len(values):
        return values.copy()
    row = np.full(n_stations, np.nan, values.dtype)
    row[stations] = values
    return row


def _best_around(row: np.ndarray, slack: int) -> np.ndarray:
    """Return the best of row[j - slack .. j + slack] for j from -slack to len(row) - 1 + slack."""
    if not len(row):  # nothing is best
        return row
    n = len(row) + 2 * slack
    padded = np.full(n + 2 * slack, np.nan, row.dtype)
    padded[2 * slack:2 * slack + len(row)] = row
    return np.fmax.reduce([padded[k:k + n] for k in range(2 * slack + 1)])


def _behind(look: Look, back: int, n_stations: int) -> np.ndarray:
    """Return what is best around the station so far back from each; -1 before the first."""
    values = np.full(n_stations, -1.0, look.best.dtype)
    # `best` starts with the station `slack` before the first, and that is `back` behind.
    best = look.best[max(look.slack - back, 0):]
    start = max(back - look.slack, 0)
    end = max(min(start + len(best), n_stations), start)
    values[start:end] = best[:end - start]
    return values
