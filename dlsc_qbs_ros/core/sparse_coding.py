"""
LASSO codes as pure functions of b = s phi^T and the Gram matrix G = phi phi^T.

Rows are samples or atoms: inputs s (n, N), atoms phi (M, N), codes c (n, M), b (n, M), G (M, M).
"""

from __future__ import annotations

import numpy as np

from . import kernel

TOLERANCE = 1e-6
MAX_STEPS = 2000
MAX_SETS = 20
REGULAR = 1e-8


def soft_threshold(x: np.ndarray, threshold: float) -> np.ndarray:
    """Return the proximal operator of threshold * ||x||_1 (paper, eq. proxop)."""
    return x - np.minimum(np.maximum(x, -threshold), threshold)


def infer(products: np.ndarray, mix: np.ndarray, code: np.ndarray, gram: np.ndarray,
          eta_c: float, lambda_1: float, n_steps: int
          ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """
    Carry out the local coding iterations (Algorithm 1, lines 2 to 4) in the Gram form.

    phi^T (phi c - s) is G c - b, so an iteration costs M^2 and never touches the input. The
    atoms are a mix of other rows, whose products with the input are known.

    Parameters
    ----------
    products : ndarray of shape (n_rows,), float64
        Products of the rows and the input.
    mix : ndarray of shape (M, n_rows), float64
        phi = mix @ rows
    code : ndarray of shape (M,), float64
        Where the iterations start.
    gram : ndarray of shape (M, M), float64
        Products phi phi^T of the atoms.
    eta_c, lambda_1 : float
        Coding rate and weight of the l1 norm.
    n_steps : int
        Number of iterations N_c.

    Returns
    -------
    b, code, gradient : ndarrays of shape (M,), float64
        The gradient g is G c - b.
    float
        c (g - b), which is ||phi c - s||^2 - ||s||^2.

    """
    if kernel.LIBRARY is not None:
        return kernel.infer(products, mix, code, gram, eta_c, eta_c * lambda_1, n_steps)
    b = mix @ products
    gradient = gram @ code - b
    for _ in range(n_steps):
        code = soft_threshold(code - eta_c * gradient, eta_c * lambda_1)
        gradient = gram @ code - b
    return b, code, gradient, float(code @ (gradient - b))


def sparse_codes(b: np.ndarray, gram: np.ndarray, eta_c: float, lambda_1: float, n_steps: int
                 ) -> np.ndarray:
    """
    Return the codes (n, M), float32, that the same iterations lead to from zero, one at least.

    Made for many inputs, b of shape (n, M), whose codes have few entries that are not 0: in
    float32 they take half the time, and the kernel leaves out zeros.
    """
    b = np.ascontiguousarray(b, np.float32)
    if kernel.LIBRARY is not None:
        return kernel.sparse_codes(
            b, gram.astype(np.float32), eta_c, eta_c * lambda_1, n_steps)
    # c - eta_c (c G - b) = c (I - eta_c G) + eta_c b
    kept = (np.eye(len(gram)) - eta_c * gram).astype(np.float32)
    added, threshold = np.float32(eta_c) * b, np.float32(eta_c * lambda_1)
    codes = np.zeros_like(b)
    for _ in range(n_steps):
        codes = codes @ kept
        codes += added
        codes -= codes.clip(-threshold, threshold)  # of so many, quicker than `soft_threshold`
    return codes


class Lasso:
    """
    Codes that minimise 1/2 ||phi c - s||^2 + lambda_1 ||c||_1 (paper, eq. problem), for one phi.

    A code is what it is whatever other codes are asked for, before it or beside it.

    Parameters
    ----------
    gram : ndarray of shape (M, M), float64
        Products phi phi^T of the atoms.
    lambda_1 : float
        Weight of the l1 norm.

    """

    def __init__(self, gram: np.ndarray, lambda_1: float):
        self._gram, self._lambda_1 = gram, lambda_1
        eigenvalues = np.linalg.eigvalsh(gram)
        self._step = 1.0 / eigenvalues[-1]
        # What a code's entry weighs beside its multiplier; small enough never to go in circles.
        self._weight = 0.1 * eigenvalues[0]
        is_regular = eigenvalues[0] > REGULAR * eigenvalues[-1]
        self._inverse = np.linalg.inv(gram) if is_regular else None

    def solve(self, b: np.ndarray) -> np.ndarray:
        """
        Return the codes (n, M), float64, of products b = s phi^T (n, M).

        Each is exact; where the atoms are all but dependent, or no guess confirms itself, it is
        exact to `TOLERANCE` times the largest |b|, or what `MAX_STEPS` of descent lead to.
        """
        codes = np.empty(b.shape)
        for i, row in enumerate(np.ascontiguousarray(b, np.float64)):
            code = None if self._inverse is None else self._by_active_set(row)
            codes[i] = self._by_descent(row) if code is None else code
        return codes

    def _by_active_set(self, b: np.ndarray) -> np.ndarray | None:
        """
        Return the exact code, or None if it is not found in `MAX_SETS` guesses.

        The primal-dual active set method (Hintermueller, Ito and Kunisch 2002): a guess of the
        signs, 0 included, gives code and multiplier q = b - G c by linear equations, and those
        two the next guess. A guess that confirms itself satisfies every condition of the
        minimum. Most entries are not 0 at the paper's lambda_1, so the equations are solved
        for the few multipliers of those that are, by the inverse of G.
        """
        inverse, lambda_1 = self._inverse, self._lambda_1
        if kernel.LIBRARY is not None:
            return kernel.active_set(inverse, b, lambda_1, self._weight, MAX_SETS)
        signs = np.sign(inverse @ b)
        for _ in range(MAX_SETS):
            multiplier = lambda_1 * signs
            code = inverse @ (b - multiplier)
            zero, = (signs == 0.0).nonzero()
            if len(zero):
                columns = inverse[:, zero]
                q = np.linalg.solve(columns[zero], code[zero])
                code -= columns @ q
                code[zero] = 0.0
                multiplier[zero] = q
            found = np.sign(soft_threshold(multiplier + self._weight * code, lambda_1))
            if (found == signs).all():
                return code
            signs = found
        return None

    def _by_descent(self, b: np.ndarray) -> np.ndarray:
        """
        Return the code by accelerated proximal gradient (FISTA) from zero.

        The momentum starts anew where it turns against the gradient; the end is reached when a
        step moves no entry of the gradient by more than `TOLERANCE` times the largest |b|.
        """
        smallest = TOLERANCE * self._step * np.abs(b).max()
        code = ahead = np.zeros_like(b)
        momentum = 1.0
        for _ in range(MAX_STEPS):
            proposed = soft_threshold(
                ahead - self._step * (self._gram @ ahead - b), self._step * self._lambda_1)
            change = proposed - code
            has_turned = (ahead - proposed) @ change > 0.0
            following = 1.0 if has_turned else 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum ** 2))
            code = proposed
            ahead = code if has_turned else code + (momentum - 1.0) / following * change
            momentum = following
            if np.abs(change).max() <= smallest:
                break
        return code
