"""The continual dictionary learner: Algorithm 1's two inner loops on a live dictionary."""

from __future__ import annotations

import numpy as np

from .preprocessing import input_scale
from .sparse_coding import proximal_steps, squared_errors
from ..config import EncoderConfig


class DictionaryLearner:
    """
    Dictionary phi and warm-started codes of a stream of inputs.

    A step takes a batch of n inputs that belong to one frame: one whole view in the paper's
    algorithm, or the patches of one. The dictionary follows the mean gradient of the batch.

    Attributes
    ----------
    atoms_ : ndarray of shape (n_atoms, n_inputs), float32
        The live dictionary, the paper's phi transposed.
    gram_ : ndarray of shape (n_atoms, n_atoms), float64
        atoms_ @ atoms_.T, updated beside it.
    codes_ : ndarray of shape (n, n_atoms), float64
        The codes of the last frame, where the next frame's iterations start.

    """

    def __init__(self, n_inputs: int, config: EncoderConfig):
        self._config = config
        deviation = config.sigma_w * input_scale(n_inputs)
        self.atoms_ = np.random.default_rng(config.seed).normal(
            0.0, deviation, (config.n_atoms, n_inputs)).astype(np.float32)
        self.refresh_gram()
        self.codes_ = np.zeros((1, config.n_atoms))
        self._b = np.zeros_like(self.codes_)

    @property
    def is_stable(self) -> bool:
        """Whether coding converges, eta_c < 2 / lambda_max(G): learning has not run away."""
        limit = 2.0 / self._config.eta_c
        if np.linalg.norm(self.gram_) < limit:  # a bound on lambda_max, at a fraction of its cost
            return True
        return bool(np.isfinite(self.gram_).all() and np.linalg.eigvalsh(self.gram_)[-1] < limit)

    def restart(self, atoms: np.ndarray) -> None:
        """Go on from these atoms (n_atoms, n_inputs) and zero codes."""
        self.atoms_ = atoms.copy()
        self.refresh_gram()
        self.codes_ = np.zeros_like(self.codes_)

    def refresh_gram(self) -> None:
        """Recompute the Gram matrix from the atoms, which ends its rounding drift."""
        self.gram_ = (self.atoms_ @ self.atoms_.T).astype(np.float64)

    def infer(self, inputs: np.ndarray) -> float:
        """
        Infer the codes of a batch (lines 2 to 4) and return its mean reprojection error e_k.

        Parameters
        ----------
        inputs : ndarray of shape (n, n_inputs), float32
            The input vectors s_k of one frame.

        """
        if len(self.codes_) != len(inputs):
            self.codes_ = np.zeros((len(inputs), self._config.n_atoms))
        self._b = (inputs @ self.atoms_.T).astype(np.float64)
        self.codes_ = proximal_steps(
            self.codes_, self._b, self.gram_,
            self._config.eta_c, self._config.lambda_1, self._config.n_coding)
        energy = np.einsum('nk,nk->n', inputs, inputs, dtype=np.float64)
        return float(np.mean(squared_errors(self.codes_, self._b, self.gram_, energy)))

    def learn(self, inputs: np.ndarray) -> None:
        """
        Take `n_learning` gradient steps on the dictionary from the batch just inferred.

        Lines 5 to 11. With residuals r = c phi - s and the mean gradient D = c^T r / n, phi
        becomes phi - eta_d D, and in M x M alone G becomes
        G - eta_d (D phi^T + phi D^T) + eta_d^2 D D^T, where D phi^T = c^T (c G - b) / n.
        """
        rate = self._config.eta_d / len(inputs)
        codes = self.codes_
        for _ in range(self._config.n_learning):
            residuals = codes.astype(np.float32) @ self.atoms_ - inputs
            cross = codes.T @ (codes @ self.gram_ - self._b)
            among = codes.T @ (residuals @ residuals.T).astype(np.float64) @ codes
            self.atoms_ -= (rate * codes.T).astype(np.float32) @ residuals
            self.gram_ += rate * rate * among - rate * (cross + cross.T)
            self._b -= rate * (inputs @ residuals.T).astype(np.float64) @ codes
