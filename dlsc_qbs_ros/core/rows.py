"""Storage that grows in flight: view cells, experiences and links."""

from __future__ import annotations

import numpy as np


class Rows:
    """An ndarray that grows by rows in constant amortised time; `values` is a live view."""

    def __init__(self, values: np.ndarray):
        self._buffer = values
        self.values = values

    def append(self, row) -> None:
        n = len(self.values)
        if n == len(self._buffer):
            grown = np.empty((max(64, 2 * n), *self._buffer.shape[1:]), self._buffer.dtype)
            grown[:n] = self.values
            self._buffer = grown
        self._buffer[n] = row
        self.values = self._buffer[:n + 1]
