"""What the encoder publishes and the code book re-encodes: the codes of an epoch."""

from __future__ import annotations

import numpy as np

from ..config import Config
from ..core.inputs import make_inputs
from ..core.projection import gram_of
from ..core.sparse_coding import Lasso, sparse_codes
from ..core.types import Dictionary


class Coder:
    """
    The codes under one dictionary: a pure function of the view.

    The code of a whole view is the converged one. Those of its many patches are what `n_coding`
    iterations from zero lead to, with the step 1 / lambda_max; they are sparse and nearly
    converged, and pooled over cells.
    """

    def __init__(self, dictionary: Dictionary, config: Config, gram: np.ndarray | None = None):
        """Prepare for a dictionary, whose Gram matrix the caller may know."""
        self.dictionary = dictionary
        self._inputs = make_inputs(config)
        self._gram = gram_of(dictionary.atoms) if gram is None else gram
        self._config = config.encoder
        if config.encoder.input == 'image':
            self._lasso = Lasso(self._gram, config.encoder.lambda_1)
        else:
            self._step = 1.0 / np.linalg.eigvalsh(self._gram)[-1]

    def encode_products(self, b: np.ndarray) -> np.ndarray:
        """Return the codes (n_views, n_values), float32, of products (n, n_atoms) with inputs."""
        if self._config.input == 'image':
            codes = self._lasso.solve(b)
        else:
            codes = sparse_codes(b, self._gram, self._step, self._config.lambda_1,
                                 self._config.n_coding)
        return self._inputs.pooled(codes).astype(np.float32)

    def encode_views(self, views: list[np.ndarray]) -> np.ndarray:
        """Return the codes (n, n_values), float32, of n stored views (height, width), uint8."""
        codes = np.empty((len(views), self._inputs.n_values), np.float32)
        for start in range(0, len(views), self._inputs.batch):
            # All batches are of one size, the last one padded, so that the code of a view is the
            # same to the last bit whatever other views are encoded beside it.
            batch = np.zeros((self._inputs.batch, *views[0].shape), np.uint8)
            batch[:len(views) - start] = views[start:start + self._inputs.batch]
            inputs = np.vstack([self._inputs.of(view) for view in batch])
            b = inputs @ self.dictionary.atoms.T
            codes[start:start + len(batch)] = self.encode_products(b)[:len(views) - start]
        return codes
