"""
Algorithm 1 of the paper, line by line: N x M dictionary, no Gram matrix, float64.

It is what the package's fast form is held against; nothing here is made to be quick.
"""

from typing import NamedTuple

import numpy as np


class Step(NamedTuple):
    """What one frame gave; `dictionary` is the one the code was inferred under."""

    code: np.ndarray
    dictionary: np.ndarray
    error: float
    learned: bool


def prox(x, threshold):
    """Return the proximal operator of threshold * ||x||_1, eq. (proxop)."""
    return np.maximum(0, x - threshold) + np.minimum(0, x + threshold)


class Literal:
    """The algorithm one input vector at a time, which learns where it is told to."""

    def __init__(self, dictionary, *, eta_c, eta_d, lambda_1, n_coding, n_learning):
        self._phi = np.array(dictionary, np.float64)
        self._c = np.zeros(self._phi.shape[1])
        self._eta_c, self._eta_d, self._lambda_1 = eta_c, eta_d, lambda_1
        self._n_coding, self._n_learning = n_coding, n_learning
        self._errors = []
        self.s_2 = 1.0

    @property
    def largest_error(self):
        """Return the largest reprojection error in S_2, or 1 before there is one."""
        return max(self._errors[-6:], default=1.0)

    def step(self, s, learned):
        """Take an input vector (N,) and return its `Step`."""
        phi, c, s = self._phi, self._c, np.asarray(s, np.float64)
        for _ in range(self._n_coding):
            c = prox(c - self._eta_c * phi.T @ (phi @ c - s), self._eta_c * self._lambda_1)
        self._errors.append(np.sum((phi @ c - s) ** 2))
        step = Step(c, phi, self._errors[-1], learned)
        for _ in range(self._n_learning):
            if learned:
                phi = phi - self._eta_d * np.outer(phi @ c - s, c)
        self._phi, self._c = phi, c
        differences = np.diff(self._errors)
        if len(differences):
            self.s_2 = np.mean(differences[-5:])
        return step


def algorithm_1(inputs, dictionary, *, gate=True, **parameters):
    """Yield a `Step` for every input vector (N,) from an N x M start dictionary."""
    literal = Literal(dictionary, **parameters)
    for s in inputs:
        yield literal.step(s, literal.s_2 > 0 or not gate)
