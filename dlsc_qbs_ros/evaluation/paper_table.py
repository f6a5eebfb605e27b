"""The table in the form of the paper: a row per encoder, a column per kind of flight."""

from __future__ import annotations

import re
from typing import Iterable, Mapping, NamedTuple, Sequence

from .table import Row

OURS, ORACLE = 'dlsc_qbs', 'oracle'
METRICS = ('MAE_L', 'MAE_M')


class Errors(NamedTuple):
    """MAE_L and MAE_M in metres."""

    mae_l: float
    mae_m: float


# As printed, on the paper's own three flights; its odometry and its system's name are not ours.
PAPER: Mapping[str, tuple[Errors, ...]] = {
    'ratslam': (Errors(0.72, 0.22), Errors(1.499, 0.248), Errors(2.714, 1.15)),
    'vgg11': (Errors(3.95, 0.244), Errors(2.58, 1.15), Errors(1.775, 0.266)),
    'latentslam': (Errors(0.54, 0.21), Errors(0.438, 0.239), Errors(1.266, 0.274)),
    'orb': (Errors(0.456, 0.165), Errors(0.407, 0.215), Errors(4.258, 1.595)),
    'dlsc_qbs': (Errors(0.588, 0.1572), Errors(0.742, 0.329), Errors(1.596, 0.244)),
}


def kind_of(flight: str) -> str:
    """Return the column of a flight: which of the paper's it is like, or its name less a seed."""
    name = re.sub(r'_seed_?\d+$', '', flight)
    match = re.fullmatch(r'(?:.*_)?flight_?([123])', name)
    return f'Flight {match[1]}' if match else name


def paper_errors(encoder: str, kind: str) -> Errors | None:
    """Return what the paper prints for an encoder and a kind of flight."""
    match = re.fullmatch(r'Flight ([123])', kind)
    return PAPER[encoder][int(match[1]) - 1] if match and encoder in PAPER else None


def mean_errors(rows: Iterable[Row]) -> dict[tuple[str, str], Errors]:
    """Return the means over the flights of each kind, by encoder and kind, as rows come."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row.metrics is not None:
            groups.setdefault((row.encoder, kind_of(row.flight)), []).append(row)
    return {key: Errors(_mean(row.metrics.mae_l for row in group),
                        _mean(row.metrics.mae_m for row in group))
            for key, group in groups.items()}


def _mean(values: Iterable[float]) -> float:
    values = list(values)
    return sum(values) / len(values)


class Contest(NamedTuple):
    """Our mean error of one kind of flight, the best other row's and the oracle's."""

    kind: str
    metric: str
    ours: float
    rival: str
    theirs: float
    oracle: float | None

    @property
    def is_won(self) -> bool:
        """Whether no other row is better."""
        return self.ours < self.theirs


def contests(rows: Sequence[Row], tuned_rows: Sequence[Row], same: Iterable[str] = ()
             ) -> list[Contest]:
    """
    Hold our row, at its one mu, against every other, each with its mu tuned to each flight.

    Parameters
    ----------
    rows, tuned_rows : sequence of Row
        At the mu of all flights, and at that of each.
    same : iterable of str
        Rows that are ours by another name.

    Returns
    -------
    list of Contest
        Two for each kind of flight. The oracle is no rival.

    """
    ours, tuned = mean_errors(rows), mean_errors(tuned_rows)
    others = {key: errors for key, errors in tuned.items()
              if key[0] not in {OURS, ORACLE, *same}}
    found = []
    for kind in dict.fromkeys(kind for encoder, kind in ours if encoder == OURS):
        for index, metric in enumerate(METRICS):
            rivals = {encoder: errors[index] for (encoder, other), errors in others.items()
                      if other == kind}
            if rivals:
                best = min(rivals, key=rivals.__getitem__)
                ceiling = ours.get((ORACLE, kind))
                found.append(Contest(kind, metric, ours[OURS, kind][index], best, rivals[best],
                                     ceiling and ceiling[index]))
    return found
