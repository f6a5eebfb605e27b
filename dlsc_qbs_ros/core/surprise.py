"""The Quadratic Bayesian Surprise: learn only from what the dictionary models ever worse."""

from __future__ import annotations

from collections import deque


class SurpriseGate:
    """
    S_2 of the paper's eq. (quadraticnofil), smoothed by a moving average.

    S_2(k) = e_k - e_(k-1), e_k the reprojection error of frame k under the dictionary before
    it learned from that frame; averaged over the last `window` differences, over those there
    are at first. S_2 starts at 1, so the first two frames are learned from: the first
    difference is known after the second frame.
    """

    def __init__(self, window: int):
        self._errors: deque[float] = deque(maxlen=window + 1)
        self.surprise = 1.0

    @property
    def is_open(self) -> bool:
        """Whether the next frame is learned from (Algorithm 1, line 6)."""
        return self.surprise > 0.0

    def observe(self, error: float) -> None:
        """Take in the reprojection error e_k (Algorithm 1, line 12)."""
        self._errors.append(error)
        n_differences = len(self._errors) - 1
        if n_differences > 0:
            # The mean of successive differences telescopes.
            self.surprise = (self._errors[-1] - self._errors[0]) / n_differences
