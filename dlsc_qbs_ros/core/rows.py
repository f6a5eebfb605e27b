"""Storage that grows in flight: view cells, experiences and links."""

from __future__ import annotations

import numpy as np


class Rows:
    """An ndarray that grows by rows in constant amortised time; `values` is a live view."""

    def __init__(self, values: np.ndarray):
        self._buffer = values
        self.values = values

    def append(self, row) -> None:
        """Add one row."""
        self._make_room(1)[:] = row

    def extend(self, rows: np.ndarray) -> None:
        """Add rows."""
        self._make_room(len(rows))[:] = rows

    def _make_room(self, n_more: int) -> np.ndarray:
        n = len(self.values)
        if n + n_more > len(self._buffer):
            grown = np.empty((max(64, 2 * (n + n_more)), *self._buffer.shape[1:]),
                             self._buffer.dtype)
            grown[:n] = self.values
            self._buffer = grown
        self.values = self._buffer[:n + n_more]
        return self.values[n:]
