"""What all learners of a dictionary have: whether their codes still converge."""

from __future__ import annotations

import numpy as np


class Learner:
    """
    A learner whose coding iterations take steps of eta_c at most.

    Attributes
    ----------
    gram_ : ndarray of shape (n_atoms, n_atoms), float64
        Products of the live atoms with each other.

    """

    gram_: np.ndarray

    def __init__(self, eta_c: float):
        self._eta_c = eta_c

    @property
    def lambda_max(self) -> float:
        """Return the largest eigenvalue of the Gram matrix; infinite when it is not finite."""
        finite = np.isfinite(self.gram_).all()
        return float(np.linalg.eigvalsh(self.gram_)[-1]) if finite else np.inf

    @property
    def lambda_max_limit(self) -> float:
        """Return 2 / eta_c: coding converges while lambda_max is below."""
        return 2.0 / self._eta_c

    @property
    def is_stable(self) -> bool:
        """Whether eta_c < 2 / lambda_max(G): learning has not run away."""
        limit = self.lambda_max_limit
        power = self.gram_
        for exponent in (1, 2, 4):  # ||G^p||^(1/p) bounds lambda_max from above, ever closer
            if np.vdot(power, power) < limit ** (2 * exponent):
                return True
            power = power @ power
        return self.lambda_max < limit
