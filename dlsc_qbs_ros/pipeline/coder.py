"""What the encoder publishes and the code book re-encodes: converged codes of an epoch."""

from __future__ import annotations

import numpy as np

from ..config import Config
from ..core.preprocessing import view_to_inputs
from ..core.projection import gram_of
from ..core.sparse_coding import Lasso
from ..core.types import Dictionary

# Stored views are encoded in batches of one size, the last one padded, so that the code of a
# view is the same to the last bit whatever other views are encoded beside it.
BATCH = 32


class Coder:
    """The converged LASSO codes under one dictionary."""

    def __init__(self, dictionary: Dictionary, config: Config, gram: np.ndarray | None = None):
        """Prepare for a dictionary, whose Gram matrix the caller may know."""
        self.dictionary = dictionary
        self._standardise = config.view.standardise
        self._lasso = Lasso(gram_of(dictionary.atoms) if gram is None else gram,
                            config.encoder.lambda_1)

    def encode_products(self, b: np.ndarray) -> np.ndarray:
        """Return the codes (n, n_atoms), float32, of products (n, n_atoms) of inputs and atoms."""
        return self._lasso.solve(b).astype(np.float32)

    def encode_views(self, views: list[np.ndarray]) -> np.ndarray:
        """Return the codes (n, n_atoms), float32, of n stored views (height, width), uint8."""
        atoms = self.dictionary.atoms
        codes = np.empty((len(views), len(atoms)), np.float32)
        for start in range(0, len(views), BATCH):
            batch = np.zeros((BATCH, *views[0].shape), np.uint8)
            batch[:len(views) - start] = views[start:start + BATCH]
            b = view_to_inputs(batch, self._standardise) @ atoms.T
            codes[start:start + BATCH] = self.encode_products(
                b[:len(views) - start].astype(np.float64))
        return codes
