"""How far odometry alone leads from the map to what was flown while the robot was lost."""

from __future__ import annotations

import numpy as np

from .visits import Visits

# Farther, in seconds and in metres, than anything flies: visits that no match leads to.
NOWHERE = 1e7
TOLERANCE = 1e-3


def looseness(visits: Visits, is_firm: np.ndarray) -> np.ndarray:
    """
    Return the shortest ways of odometry from what is firm to each visit.

    The ways lead along the flight, not across its breaks, and from a visit that met an old
    experience, at no cost, to the visit that created it. Visits that none leads to were put
    where they are by hand: they are as firm.

    Parameters
    ----------
    visits : Visits
        Of the whole flight, at least one.
    is_firm : ndarray of shape (n_visits,), bool
        Where the ways begin.

    Returns
    -------
    ndarray of shape (n_visits, 2)
        In seconds and in metres, each the shortest of its kind.

    """
    flown = visits.flown.values
    segment = np.cumsum(np.diff(flown[:, 2], prepend=flown[0, 2]) > 0)
    line = flown[:, :2] + 2.0 * NOWHERE * segment[:, None]
    met = np.flatnonzero(visits.run.values)
    ends = np.concatenate([met, visits.birth.values[visits.experience.values[met]]])
    ways, longer = np.where(is_firm[:, None], 0.0, np.full((1, 2), NOWHERE)), None
    while longer is None or np.any(longer - ways > TOLERANCE):
        longer = ways.copy()
        np.minimum.at(ways, ends, np.tile(np.minimum(*np.split(ways[ends], 2)), (2, 1)))
        onward = np.minimum.accumulate(ways - line) + line
        back = np.minimum.accumulate((ways + line)[::-1])[::-1] - line
        ways = np.minimum(ways, np.minimum(onward, back))
    return np.where(ways >= NOWHERE, 0.0, ways)
