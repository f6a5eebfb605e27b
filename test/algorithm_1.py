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


def algorithm_1(inputs, dictionary, *, eta_c, eta_d, lambda_1, n_coding, n_learning, gate=True):
    """Yield a `Step` for every input vector (N,) from an N x M start dictionary."""
    phi = np.array(dictionary, np.float64)
    c = np.zeros(phi.shape[1])
    s_2 = 1.0
    errors = []
    for s in np.asarray(inputs, np.float64):
        for _ in range(n_coding):
            c = prox(c - eta_c * phi.T @ (phi @ c - s), eta_c * lambda_1)
        errors.append(np.sum((phi @ c - s) ** 2))
        learned = s_2 > 0 or not gate
        yield Step(c, phi, errors[-1], learned)
        for _ in range(n_learning):
            if learned:
                phi = phi - eta_d * np.outer(phi @ c - s, c)
        differences = np.diff(errors)
        if len(differences):
            s_2 = np.mean(differences[-5:])
