"""
The compiled kernel, where the package was built with one: `_kernel.c`, plain C.

Whoever calls a function here has made sure that `LIBRARY` is there. Arrays must be contiguous.
"""

from __future__ import annotations

from contextlib import contextmanager
from ctypes import c_double, c_float, c_int, c_size_t, c_uint32, c_void_p, CDLL
from pathlib import Path
from typing import Iterator
from zlib import crc32

import numpy as np

SOURCE = Path(__file__).with_name('_kernel.c')


def _load() -> CDLL | None:
    array, size, number = c_void_p, c_size_t, c_double
    try:
        source, library = SOURCE.read_bytes(), CDLL(str(SOURCE.with_suffix('.so')))
        if c_uint32.in_dll(library, 'source_crc').value != crc32(source):
            return None
        for function, arguments in (
                (library.split, (array, size, size, array, array, array, array)),
                (library.join, (array, array, array, size, size, array, size)),
                (library.centre, (array, array, size, size, array, size)),
                (library.project, (array, array, array, array, array, array, size, size, size,
                                   array, size, number, number, number, array)),
                (library.sum_pixels, (array, size, array)),
                (library.infer, (array, size, array, size, array, size, number, number, size,
                                 array, array, array)),
                (library.sparse_codes, (array, size, array, size, c_float, c_float, size, array,
                                        array, array)),
                (library.active_set, (array, array, size, number, number, size, array))):
            function.argtypes, function.restype = arguments, None
    except (OSError, ValueError):  # not there, of another machine, or of before there was a sum
        return None
    library.active_set.restype, library.infer.restype = c_int, c_double
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


def split(values: np.ndarray, high: np.ndarray, low: np.ndarray, units: np.ndarray,
          sums: np.ndarray) -> None:
    """Write values (n_rows, width), float32, to the first columns of a block of two planes."""
    LIBRARY.split(values.ctypes.data, *values.shape, high.ctypes.data, low.ctypes.data,
                  units.ctypes.data, sums.ctypes.data)


def join(high: np.ndarray, low: np.ndarray, units: np.ndarray, values: np.ndarray) -> None:
    """Write the first columns of a block of two planes to values (n_rows, width), float32."""
    LIBRARY.join(high.ctypes.data, low.ctypes.data, units.ctypes.data, *values.shape,
                 values.ctypes.data, values.strides[0] // values.itemsize)


def centre(pixels: np.ndarray, affine: np.ndarray, values: np.ndarray) -> None:
    """Write the first columns of a block, its rows without their mean, to values."""
    LIBRARY.centre(pixels.ctypes.data, affine.ctypes.data, *values.shape, values.ctypes.data,
                   values.strides[0] // values.itemsize)


def addresses(*arrays: np.ndarray) -> list[int]:
    """Return where arrays lie that the caller holds; asked for every frame, it takes long."""
    return [array.ctypes.data for array in arrays]


def project(held: list[int], n_atoms: int, room: int, pixels: np.ndarray,
            affine: tuple[float, float, float], products: np.ndarray) -> None:
    """
    Write products (n_atoms + n_kept,), float64, of an input with atoms and kept inputs.

    `held` are the addresses of two planes, their units, the sums of their rows, the kept inputs
    and what these are affine by.
    """
    LIBRARY.project(*held, n_atoms, room, len(products) - n_atoms, pixels.ctypes.data,
                    len(pixels), *affine, products.ctypes.data)


def sum_pixels(pixels: np.ndarray) -> tuple[float, float]:
    """Return the sum of pixels (n,), uint8, and that of their squares."""
    sums = (c_double * 2)()
    LIBRARY.sum_pixels(pixels.ctypes.data, len(pixels), sums)
    return tuple(sums)


def infer(products: np.ndarray, mix: np.ndarray, code: np.ndarray, gram: np.ndarray,
          eta_c: float, threshold: float, n_steps: int
          ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return b, code and gradient (m,), float64, and code (gradient - b)."""
    m = len(code)
    b, gradient, code = np.empty(m), np.empty(m), code.copy()
    product = LIBRARY.infer(
        products.ctypes.data, len(products), mix.ctypes.data, mix.strides[0] // mix.itemsize,
        gram.ctypes.data, m, eta_c, threshold, n_steps, code.ctypes.data, b.ctypes.data,
        gradient.ctypes.data)
    return b, code, gradient, product


def sparse_codes(b: np.ndarray, gram: np.ndarray, eta_c: float, threshold: float, n_steps: int
                 ) -> np.ndarray:
    """Return codes (n, m) of products b (n, m), gram (m, m); all float32."""
    codes, descent = np.empty_like(b), np.empty(len(gram), np.float32)
    used = np.empty(len(gram), np.uint16)
    LIBRARY.sparse_codes(
        b.ctypes.data, len(b), gram.ctypes.data, len(gram), eta_c, threshold, n_steps,
        codes.ctypes.data, descent.ctypes.data, used.ctypes.data)
    return codes


def active_set(inverse: np.ndarray, b: np.ndarray, lambda_1: float, weight: float,
               max_sets: int) -> np.ndarray | None:
    """Return the code (m,), float64, of b (m,), or None."""
    m = len(b)
    work = np.empty(m * (m + 4))
    is_found = LIBRARY.active_set(inverse.ctypes.data, b.ctypes.data, m, lambda_1, weight,
                                  max_sets, work.ctypes.data)
    return work[:m] if is_found else None
