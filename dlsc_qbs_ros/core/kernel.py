"""
The compiled kernel, where the package was built with one: `_kernel.c`, plain C.

Whoever calls a function here has made sure that `LIBRARY` is there. Arrays must be contiguous.
"""

from __future__ import annotations

from contextlib import contextmanager
from ctypes import c_double, c_int, c_size_t, c_void_p, CDLL
from pathlib import Path
from typing import Iterator

import numpy as np


def _load() -> CDLL | None:
    array, size, number = c_void_p, c_size_t, c_double
    try:
        library = CDLL(str(Path(__file__).with_name('_kernel.so')))
        for function, arguments in (
                (library.project, (array, size, size, array, array)),
                (library.shorten, (array, size, array)),
                (library.standardise, (array, size, number, number, array)),
                (library.proximal_steps, (array, array, array, size, number, number, size, array)),
                (library.active_set, (array, array, size, number, number, size, array, array)),
                (library.subtract_product, (array, size, size, size, size, array, array))):
            function.argtypes, function.restype = arguments, None
    except (OSError, AttributeError):  # not there, of another machine, or of an earlier version
        return None
    library.shorten.restype, library.active_set.restype = c_double, c_int
    return library


LIBRARY = _load()


@contextmanager
def disabled() -> Iterator[None]:
    """Do without the kernel, in what is made meanwhile; a learner made before needs it still."""
    global LIBRARY
    library, LIBRARY = LIBRARY, None
    try:
        yield
    finally:
        LIBRARY = library


def project(rows: np.ndarray, n_rows: int, values: np.ndarray) -> np.ndarray:
    """Return products (n_rows,), float64, of the first rows (m, n), int16, and (n,) float32."""
    products = np.empty(n_rows)
    LIBRARY.project(
        rows.ctypes.data, n_rows, rows.shape[1], values.ctypes.data, products.ctypes.data)
    return products


def shorten(values: np.ndarray, row: np.ndarray) -> float:
    """Write values (n,), float32, as a row (n,), int16; return the unit it is in."""
    return LIBRARY.shorten(values.ctypes.data, len(values), row.ctypes.data)


def standardise(views: np.ndarray, deviation: float, min_contrast: float, inputs: np.ndarray
                ) -> None:
    """Write views (n_views, n), uint8, with zero mean and this deviation as float32 inputs."""
    for view, row in zip(views, inputs):
        LIBRARY.standardise(view.ctypes.data, len(view), deviation, min_contrast, row.ctypes.data)


def proximal_steps(codes: np.ndarray, b: np.ndarray, gram: np.ndarray, eta_c: float,
                   threshold: float, n_steps: int) -> np.ndarray:
    """Return codes (n, m), float64, after so many iterations."""
    codes, work = codes.copy(), np.empty(len(gram))
    for code, row in zip(codes, b):
        LIBRARY.proximal_steps(code.ctypes.data, row.ctypes.data, gram.ctypes.data, len(gram),
                               eta_c, threshold, n_steps, work.ctypes.data)
    return codes


def active_set(inverse: np.ndarray, b: np.ndarray, lambda_1: float, weight: float,
               max_sets: int) -> np.ndarray | None:
    """Return the code (m,), float64, of b (m,), or None."""
    m = len(b)
    code, work = np.empty(m), np.empty(m * (m + 3))
    is_found = LIBRARY.active_set(inverse.ctypes.data, b.ctypes.data, m, lambda_1, weight,
                                  max_sets, code.ctypes.data, work.ctypes.data)
    return code if is_found else None


def subtract_product(matrix: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
    """Take x.T @ y from a matrix (m, k), whose rows are contiguous; x (n, m) and y (n, k)."""
    LIBRARY.subtract_product(matrix.ctypes.data, matrix.strides[0] // matrix.itemsize,
                             *x.shape, y.shape[1], x.ctypes.data, y.ctypes.data)
