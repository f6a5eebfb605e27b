"""
LASSO codes as pure functions of b = s phi^T and the Gram matrix G = phi phi^T.

Rows are samples or atoms: inputs s (n, N), atoms phi (M, N), codes c (n, M), b (n, M), G (M, M).
"""

from __future__ import annotations

import numpy as np

TOLERANCE = 1e-6
MAX_STEPS = 2000


def soft_threshold(x: np.ndarray, threshold: float) -> np.ndarray:
    """Return the proximal operator of threshold * ||x||_1 (paper, eq. proxop)."""
    return np.sign(x) * np.maximum(np.abs(x) - threshold, 0.0)


def proximal_steps(codes: np.ndarray, b: np.ndarray, gram: np.ndarray, eta_c: float,
                   lambda_1: float, n_steps: int) -> np.ndarray:
    """
    Carry out the local coding iterations (Algorithm 1, lines 2 to 4) in the Gram form.

    phi^T (phi c - s) is G c - b, so an iteration costs M^2 and never touches the input.

    Parameters
    ----------
    codes : ndarray of shape (n, M), float64
        Where the iterations start.
    b : ndarray of shape (n, M), float64
        Products s phi^T of inputs and atoms.
    gram : ndarray of shape (M, M), float64
        Products phi phi^T of the atoms.
    eta_c, lambda_1 : float
        Coding rate and weight of the l1 norm.
    n_steps : int
        Number of iterations N_c.

    Returns
    -------
    ndarray of shape (n, M), float64

    """
    for _ in range(n_steps):
        codes = soft_threshold(codes - eta_c * (codes @ gram - b), eta_c * lambda_1)
    return codes


def squared_errors(codes: np.ndarray, b: np.ndarray, gram: np.ndarray,
                   squared_inputs: np.ndarray) -> np.ndarray:
    """Return ||phi c - s||^2 per sample, shape (n,), from ||s||^2 of shape (n,)."""
    return np.einsum('nm,nm->n', codes, codes @ gram - 2.0 * b) + squared_inputs


def lasso(b: np.ndarray, gram: np.ndarray, lambda_1: float, step: float) -> np.ndarray:
    """
    Return the codes that minimise 1/2 ||phi c - s||^2 + lambda_1 ||c||_1 (paper, eq. problem).

    Accelerated proximal gradient (FISTA) from zero, restarted where the momentum turns against
    the gradient. Every sample stops by itself, when a step moves none of its gradient's entries
    by more than `TOLERANCE` times its largest |b|: its code depends on itself alone, not on an
    earlier frame nor on the rest of the batch.

    Parameters
    ----------
    b : ndarray of shape (n, M), float64
        Products s phi^T of inputs and atoms.
    gram : ndarray of shape (M, M), float64
        Products phi phi^T of the atoms.
    lambda_1 : float
        Weight of the l1 norm.
    step : float
        Step size, at most 1 / lambda_max(gram).

    Returns
    -------
    ndarray of shape (n, M), float64

    """
    smallest = TOLERANCE * step * np.abs(b).max(axis=1)
    codes = ahead = np.zeros_like(b)
    momentum = np.ones((len(b), 1))
    moving = np.ones((len(b), 1), bool)
    for _ in range(MAX_STEPS):
        proposed = soft_threshold(ahead - step * (ahead @ gram - b), step * lambda_1)
        change = np.where(moving, proposed - codes, 0.0)
        turned = np.einsum('nm,nm->n', ahead - proposed, change)[:, None] > 0.0
        codes = codes + change
        following = np.where(turned, 1.0, 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum ** 2)))
        ahead = codes + np.where(turned, 0.0, (momentum - 1.0) / following) * change
        momentum = following
        moving &= (np.abs(change).max(axis=1) > smallest)[:, None]
        if not moving.any():
            break
    return codes
