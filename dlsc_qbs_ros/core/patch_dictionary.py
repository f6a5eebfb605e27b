"""The learner of patches: many short inputs a frame, atoms of length 1."""

from __future__ import annotations

import numpy as np

from .learner import Learner
from .projection import gram_of
from .sparse_coding import sparse_codes
from ..config import EncoderConfig, PatchesConfig


class PatchLearner(Learner):
    """
    Dictionary phi of the patches of a stream of frames.

    Algorithm 1 with what many short inputs allow: codes start from zero, steps are 1 / lambda_max,
    and the dictionary follows the mean gradient over patches drawn at random, after which its
    atoms get back to length 1. All is small enough to be done as it is written.

    Atoms start at random, but without a mean, as patches have none. Places are told apart less
    well by young atoms: so the rate begins at a multiple of `eta_d` and falls to it, as 1 / k
    with the k frames learned from, and what is learned early is soon as good as what comes late.

    Attributes
    ----------
    atoms_ : ndarray of shape (n_atoms, n_inputs), float32
        The live dictionary, the paper's phi transposed.
    gram_ : ndarray of shape (n_atoms, n_atoms), float64
        atoms_ @ atoms_.T
    codes_ : ndarray of shape (n, n_atoms), float32
        The codes of the last frame.
    snapshot_, snapshot_gram_ : ndarray
        As they were when `atoms_` last had moved by `epoch_change`; never written to.
    snapshot_products_ : ndarray of shape (n, n_atoms), float32
        Products of the last frame's patches with the snapshot's atoms.

    """

    # The rate is eta_d * (1 + EXCESS * SETTLING / (SETTLING + k)).
    EXCESS, SETTLING = 3.0, 30

    def __init__(self, n_inputs: int, config: EncoderConfig, patches: PatchesConfig):
        super().__init__(1.0 / config.n_atoms)  # no lambda_max of unit atoms is more than n_atoms
        self._config, self._patches = config, patches
        self._rng = np.random.default_rng(config.seed)
        self._n_frames_learned = 0
        atoms = np.random.default_rng(config.seed).normal(size=(config.n_atoms, n_inputs))
        self.restart(atoms - atoms.mean(axis=1, keepdims=True))

    def restart(self, atoms: np.ndarray) -> None:
        """Go on from these atoms (n_atoms, n_inputs), brought to length 1."""
        self._set(np.asarray(atoms, np.float32))
        self._take_snapshot()

    def fall_back(self) -> None:
        """Go on from the atoms of the snapshot."""
        self._set(self.snapshot_)

    def infer(self, inputs: np.ndarray) -> float:
        """
        Infer the codes of patches (lines 2 to 4) and return their mean reprojection error e_k.

        Parameters
        ----------
        inputs : ndarray of shape (n, n_inputs), float32
            The patches s_k of one frame.

        """
        change = np.linalg.norm(self.atoms_ - self.snapshot_) / np.linalg.norm(self.snapshot_)
        if change > self._config.epoch_change:
            self._take_snapshot()
        self.snapshot_products_ = inputs @ self.snapshot_.T
        b = inputs @ self.atoms_.T
        self.codes_ = sparse_codes(
            b, self.gram_, self._step, self._config.lambda_1, self._config.n_coding)
        self._residuals = self.codes_ @ self.atoms_ - inputs
        return float(np.vdot(self._residuals, self._residuals)) / len(inputs)

    def learn(self, inputs: np.ndarray) -> None:
        """Take `n_learning` gradient steps from patches of the frame just inferred (5 to 11)."""
        n = min(self._patches.n_learned, len(inputs))
        chosen = self._rng.choice(len(inputs), n, replace=False)
        codes, inputs, residuals = self.codes_[chosen], inputs[chosen], self._residuals[chosen]
        atoms, rate = self.atoms_, np.float32(self._rate / n)
        for _ in range(self._config.n_learning):
            atoms = atoms - rate * codes.T @ residuals
            residuals = codes @ atoms - inputs
        self._set(atoms)
        self._n_frames_learned += 1

    @property
    def _rate(self) -> float:
        """Return the learning rate: the next frame's."""
        excess = self.EXCESS * self.SETTLING / (self.SETTLING + self._n_frames_learned)
        return self._patches.eta_d * (1.0 + excess)

    def _set(self, atoms: np.ndarray) -> None:
        self.atoms_ = atoms / np.linalg.norm(atoms, axis=1, keepdims=True)
        self.gram_ = gram_of(self.atoms_)
        self._step = 1.0 / self.lambda_max

    def _take_snapshot(self) -> None:
        self.snapshot_, self.snapshot_gram_ = self.atoms_, self.gram_
        self.snapshot_.flags.writeable = False
