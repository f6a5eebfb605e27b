"""The compiled kernel, where the package was built with one: a few loops of C in `_kernel.c`."""

from __future__ import annotations

from contextlib import contextmanager
import ctypes
from pathlib import Path
from typing import Iterator

import numpy as np


def _load() -> ctypes.CDLL | None:
    """Load the kernel, plain C that any Python can call."""
    try:
        library = ctypes.CDLL(str(Path(__file__).with_name('_kernel.so')))
    except OSError:  # not there, or of another machine
        return None
    size, (short, single, double) = ctypes.c_size_t, (
        np.ctypeslib.ndpointer(dtype, flags='C') for dtype in (np.int16, np.float32, float))
    library.project.argtypes = [short, size, size, single, double]
    library.quantise.argtypes = [single, size, size, short, double]
    library.project.restype = library.quantise.restype = None
    return library


LIBRARY = _load()


@contextmanager
def disabled() -> Iterator[None]:
    """Do without the kernel, in what is made meanwhile."""
    global LIBRARY
    library, LIBRARY = LIBRARY, None
    try:
        yield
    finally:
        LIBRARY = library


def project(rows: np.ndarray, n_rows: int, values: np.ndarray) -> np.ndarray:
    """Return products (n_rows,), float64, of the first rows (m, n), int16, and (n,) float32."""
    products = np.empty(n_rows)
    LIBRARY.project(rows, n_rows, rows.shape[1], values, products)
    return products


def quantise(values: np.ndarray, rows: np.ndarray, units: np.ndarray) -> None:
    """Write values (m, n), float32, as rows (m, n), int16, times their units (m,), float64."""
    LIBRARY.quantise(values, *values.shape, rows, units)
