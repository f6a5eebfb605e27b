"""What the encoder publishes and the code book re-encodes: converged codes of an epoch."""

from __future__ import annotations

import numpy as np

from ..config import Config
from ..core.preprocessing import view_to_inputs
from ..core.sparse_coding import lasso
from ..core.types import Dictionary

# Stored views are encoded in batches of one size, the last one padded, so that the code of a
# view is the same to the last bit whatever other views are encoded beside it.
BATCH = 32


class Coder:
    """The converged LASSO codes under one dictionary."""

    def __init__(self, dictionary: Dictionary, config: Config):
        self.dictionary = dictionary
        self._lambda_1 = config.encoder.lambda_1
        self._standardise = config.view.standardise
        self._gram = (dictionary.atoms @ dictionary.atoms.T).astype(np.float64)
        self._step = 1.0 / np.linalg.eigvalsh(self._gram)[-1]

    def encode(self, inputs: np.ndarray) -> np.ndarray:
        """Return the codes (n, n_atoms), float32, of input vectors (n, n_inputs), float32."""
        b = (inputs @ self.dictionary.atoms.T).astype(np.float64)
        return lasso(b, self._gram, self._lambda_1, self._step).astype(np.float32)

    def encode_views(self, views: list[np.ndarray]) -> np.ndarray:
        """Return the codes (n, n_atoms), float32, of n stored views (height, width), uint8."""
        codes = np.empty((len(views), len(self._gram)), np.float32)
        for start in range(0, len(views), BATCH):
            batch = np.zeros((BATCH, *views[0].shape), np.uint8)
            batch[:len(views) - start] = views[start:start + BATCH]
            encoded = self.encode(view_to_inputs(batch, self._standardise))
            codes[start:start + BATCH] = encoded[:len(views) - start]
        return codes
