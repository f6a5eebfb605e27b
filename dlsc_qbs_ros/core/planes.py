"""Atoms in three bytes an entry, and their products with pixels; all needs the kernel."""

from __future__ import annotations

from typing import Iterator

import numpy as np

from . import kernel
from .preprocessing import PixelInput
from .projection import Projection, to_front

# Columns that are written or read at a time: those of all rows stay in the second-level cache.
# Entries of a row in such a block share a unit.
BLOCK = 2048
# Rows end with a whole group of columns.
GROUP = 256


class Planes:
    """
    A matrix of 24-bit integers: a plane of their high 16 bits, and one of their low 8.

    Each row of a block of columns has a unit of its own, a power of two. So an entry is a
    float32 to the last bit; it is off what was written by 2^-23 of the largest of them at most.
    """

    def __init__(self, n_rows: int, n_columns: int):
        n_blocks = -(-n_columns // BLOCK)
        self.shape = n_rows, n_columns
        self.high = mapped((n_rows, padded(n_columns)), np.int16)
        self.low = mapped((n_rows, padded(n_columns)), np.uint8)
        self.units = np.empty((n_blocks, n_rows))
        self._sums = np.empty((n_blocks, n_rows))

    def __setitem__(self, key: tuple[slice, slice], values: np.ndarray) -> None:
        """Write columns of all rows, float32: a block, or what there is of the last one."""
        start = key[1].start
        kernel.split(np.ascontiguousarray(values), self.high[:, start:], self.low[:, start:],
                     self.units[start // BLOCK], self._sums[start // BLOCK])

    def read(self, start: int, out: np.ndarray) -> None:
        """Write to `out`, float32, as many columns of all rows as it has, at most a block."""
        kernel.join(self.high[:, start:], self.low[:, start:], self.units[start // BLOCK], out)

    def blocks(self) -> Iterator[slice]:
        """Yield the columns of every block."""
        for start in range(0, self.shape[1], BLOCK):
            yield slice(start, min(start + BLOCK, self.shape[1]))

    def sums(self) -> np.ndarray:
        """Return the sums of the rows (n_rows,), float64."""
        return (self.units * self._sums).sum(axis=0)


class PlaneProjection(Projection):
    """
    The same for inputs that are affine in pixels, which are kept as these.

    Products are sums of integers, exact in any order. All reads less than float32 atoms alone
    would: three bytes an entry of an atom, one of a kept input.
    """

    def __init__(self, atoms: np.ndarray, room: int):
        self.n_inputs, self.n_kept = atoms.shape[1], 0
        self._kept = mapped((room, padded(self.n_inputs)), np.uint8)
        self._affine = np.empty((room, 3))
        self._rows = np.empty((len(atoms) + room, BLOCK), np.float32)
        self._work = np.zeros(padded(self.n_inputs), np.int16)
        self._atoms, self._spare = Planes(*atoms.shape), Planes(*atoms.shape)
        for columns in self._spare.blocks():
            self._spare[:, columns] = atoms[:, columns]
        self.replace(self._spare, 0)

    @property
    def atoms(self) -> np.ndarray:
        """Return the rows that are atoms, (n_atoms, n_inputs), float32; they are made once."""
        if self._made is None:
            self._made = np.empty(self._atoms.shape, np.float32)
            for columns in self._atoms.blocks():
                self._atoms.read(columns.start, self._made[:, columns])
        return self._made

    def new_atoms(self) -> Planes:
        """Return memory for other atoms, to be written in such columns as `combine` yields."""
        return self._spare

    def replace(self, atoms: Planes, n_forgotten: int) -> slice:
        """Do as `Projection.replace` does."""
        self._made, self._sums, self._spare = None, atoms.sums(), self._atoms
        return super().replace(atoms, n_forgotten)

    def products(self, vector: PixelInput) -> np.ndarray:
        """Multiply the rows and an input vector; return (n_atoms + n_kept,), float64."""
        products = np.empty(self._atoms.shape[0] + self.n_kept)
        kernel.project(self._atoms.high, self._atoms.low, self._atoms.units, self._sums,
                       self._kept, self._affine, vector.pixels, vector.affine, self._work,
                       products)
        return products

    def _store(self, slot: int, vector: PixelInput) -> None:
        self._kept[slot, :self.n_inputs] = vector.pixels
        self._affine[slot] = vector.affine

    def _move_to_front(self, slots: slice) -> None:
        to_front(self._kept, slots)
        to_front(self._affine, slots)

    def combine(self, weights: np.ndarray, start: int, stop: int
                ) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield columns of weights (m, n_atoms + n_kept) @ rows, float32, until the next ones."""
        n_atoms, weights = self._atoms.shape[0], weights.astype(np.float32)
        n_kept = weights.shape[1] - n_atoms
        weights[:, n_atoms:] *= self._affine[:n_kept, 0].astype(np.float32)
        for first in range(start, stop, BLOCK):
            columns = slice(first, min(first + BLOCK, stop))
            rows = self._rows[:weights.shape[1], :columns.stop - first]
            self._atoms.read(first, rows[:n_atoms])
            kernel.centre(self._kept[:, first:], self._affine, rows[n_atoms:])
            yield columns, weights @ rows


def mapped(shape: tuple[int, int], dtype: type) -> np.ndarray:
    """Return an array of zeros that is in memory already, and need not be mapped in flight."""
    array = np.empty(shape, dtype)
    array.fill(0)
    return array


def padded(n: int) -> int:
    """Return the entries of a row that has room for n."""
    return -(-n // GROUP) * GROUP
