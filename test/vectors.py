"""Input vectors as arrays, and arrays as input vectors."""

import numpy as np

from dlsc_qbs_ros.core.preprocessing import PixelInput


def vectors_of(views, standardise):
    """Return the input vectors (n, n_inputs), float32, of views (n, height, width), uint8."""
    return np.array([np.asarray(PixelInput(view, standardise)) for view in views])


class Vector:
    """Any values (n_inputs,), float32, as an input vector; not for the planes of the kernel."""

    def __init__(self, values):
        self._values = values
        with np.errstate(over='ignore'):
            self.squared_norm = float(values @ values)

    def __array__(self, dtype=None, copy=None):
        return self._values
