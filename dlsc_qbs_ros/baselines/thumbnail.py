"""The simplest opponent: a small grey image, compared by the correlation of its pixels."""

from __future__ import annotations

import numpy as np

from ..config import ViewConfig
from ..core.local_view import Cosine
from ..core.preprocessing import make_view


class Thumbnail:
    """The block means of the image without their mean; the cosine does the rest."""

    def __init__(self, width: int = 21, height: int = 16):
        self.measure = Cosine()
        self._size = ViewConfig(width=width, height=height)

    def describe(self, grey: np.ndarray) -> np.ndarray:
        """Return the pixels (height * width,), float32, of a grey image (rows, columns), uint8."""
        view = make_view(grey, self._size)
        return (view - view.mean()).astype(np.float32).ravel()
