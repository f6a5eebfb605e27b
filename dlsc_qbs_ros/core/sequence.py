"""How alike the last views and a row of view cells are, as runs of their length."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np


class Look(NamedTuple):
    """
    One of the last views: its station, and its likeness to the cells.

    `best` is the best around each station, 0 where no cell is, and `is_seen` 1 where one is.
    """

    station: int
    likeness: np.ndarray
    slack: int
    best: np.ndarray
    is_seen: np.ndarray


class Scores(NamedTuple):
    """
    How alike the last views and each view cell are, arrays of shape (n_cells,).

    Attributes
    ----------
    last : ndarray
        The similarities of the last view by itself.
    short, long : ndarray
        The scores of the runs of the fewest and of the most views that end in each cell, -1
        where there are not even the fewest.
    is_whole : ndarray of bool
        Whether the long run is of as many views as make one.

    """

    last: np.ndarray
    short: np.ndarray
    long: np.ndarray
    is_whole: np.ndarray


class SequenceScore:
    """
    The mean similarity of the last views to a run of view cells that were made in a row.

    A single view of one shelf looks like one of the next; a run of them less so. View cells are
    made at equal distances: a second pass meets one per view, give or take `slack`. Places at
    these distances are stations. Where views are missing, on this pass or when the cells were
    made, stations are passed without a view or have no cell. They count for nothing, and a run
    reaches back over them, by `REACH` times its length at most, to be of as many views.
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
               ) -> Scores | None:
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
        Scores or None
            None until as many views came as the shortest run is of.

        """
        stations = np.arange(len(similarities)) if stations is None else stations
        self._station += 1
        self._looks.append(self._look(self._station, similarities, self._slack, stations))
        if len(self._looks) < self._shortest:
            return None
        short, _ = self._mean(similarities, stations, self._shortest)
        long, n_views = self._mean(similarities, stations, self._length)
        return Scores(similarities, short, long, n_views == self._length)

    def _mean(self, similarities: np.ndarray, stations: np.ndarray, length: int
              ) -> tuple[np.ndarray, np.ndarray]:
        """Return the means along runs of up to so many views, and of how many they are, (n,)."""
        total, n_views = _seen(_at_stations(similarities, stations))
        earlier = [*self._looks][-2::-1][:self.REACH * length - 1]
        for look in earlier[:length - 1]:
            values, is_seen = _behind(look, self._station - look.station, len(total))
            total += values
            n_views += is_seen
        lacking = stations[n_views[stations] < length]
        for look in earlier[length - 1:]:
            if not len(lacking):
                break
            values, is_seen = _behind(look, self._station - look.station, len(total))
            total[lacking] += values[lacking]
            n_views[lacking] += is_seen[lacking]
            lacking = lacking[n_views[lacking] < length]
        total, n_views = total[stations], n_views[stations]
        mean = total / n_views.astype(total.dtype)
        mean[n_views < self._shortest] = -1.0
        return mean, n_views

    def _look(self, station: int, likeness: np.ndarray, slack: int, stations: np.ndarray) -> Look:
        slack = min(slack, self._length)
        row = _at_stations(likeness, stations[:len(likeness)])
        return Look(station, likeness, slack, *_seen(_best_around(row, slack)))


def _at_stations(values: np.ndarray, stations: np.ndarray) -> np.ndarray:
    """Return the values of cells station by station; NaN where there is no cell."""
    n_stations = int(stations[-1]) + 1 if len(stations) else 0
    if n_stations == len(values):
        return values
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


def _seen(row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a row with 0 where there is no cell, and 1 where there is one, int16."""
    is_seen = ~np.isnan(row)
    return np.where(is_seen, row, row.dtype.type(0)), is_seen.astype(np.int16)


def _behind(look: Look, back: int, n_stations: int) -> tuple[np.ndarray, np.ndarray]:
    """Return what is best around the station so far back from each, as `_seen`; -1 beyond."""
    values, is_seen = np.full(n_stations, -1.0, look.best.dtype), np.ones(n_stations, np.int16)
    # `best` starts with the station `slack` before the first, and that is `back` behind.
    shift = back - look.slack
    start = min(max(shift, 0), n_stations)
    end = max(min(shift + len(look.best), n_stations), start)
    values[start:end] = look.best[start - shift:end - shift]
    is_seen[start:end] = look.is_seen[start - shift:end - shift]
    return values, is_seen
