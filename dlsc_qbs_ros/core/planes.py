"""Atoms in three bytes an entry, and their products with pixels; all needs the kernel."""

from __future__ import annotations

from typing import Iterator

import numpy as np

from . import kernel
from .preprocessing import PixelInput
from .projection import Projection, to_front

# Columns that are written or read at a time: those of all rows stay in the second-level cache.
BLOCK = 2048


class Planes:
    """
    A matrix of 24-bit integers: a plane of their high 16 bits, and one of their low 8.

    They are held in blocks of columns, each of which lies in memory as one piece. Each row of a
    block has a unit of its own, a power of two. So an entry is a float32 to the last bit; it is
    off what was written by 2^-23 of the largest of them at most.
    """

    def __init__(self, n_rows: int, n_columns: int):
        self.shape = n_rows, n_columns
        self.high, self.low = (in_blocks(n_rows, n_columns, of) for of in (np.int16, np.uint8))
        self.units, self._sums = np.empty((2, *self.high.shape[:2]))

    def __setitem__(self, key: tuple[slice, slice], values: np.ndarray) -> None:
        """Write columns of all rows, float32: a block, or what there is of the last one."""
        block = key[1].start // BLOCK
        kernel.split(np.ascontiguousarray(values), self.high[block], self.low[block],
                     self.units[block], self._sums[block])

    def read(self, start: int, out: np.ndarray) -> None:
        """Write to `out`, float32, as many columns of all rows as it has, at most a block."""
        block = start // BLOCK
        kernel.join(self.high[block], self.low[block], self.units[block], out)

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
        self._kept = in_blocks(room, self.n_inputs, np.uint8)
        self._affine = np.empty((room, 3))
        self._rows = np.empty((len(atoms) + room, BLOCK), np.float32)
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
        self._held = kernel.addresses(
            atoms.high, atoms.low, atoms.units, self._sums, self._kept, self._affine)
        return super().replace(atoms, n_forgotten)

    def products(self, vector: PixelInput) -> np.ndarray:
        """Multiply the rows and an input vector; return (n_atoms + n_kept,), float64."""
        n_atoms, room = self._atoms.shape[0], len(self._affine)
        products = np.empty(n_atoms + self.n_kept)
        kernel.project(self._held, n_atoms, room, vector.pixels, vector.affine, products)
        return products

    def _store(self, slot: int, vector: PixelInput) -> None:
        n_whole, rest = divmod(self.n_inputs, BLOCK)
        in_whole = n_whole * BLOCK
        self._kept[:n_whole, slot] = vector.pixels[:in_whole].reshape(n_whole, BLOCK)
        self._kept[n_whole:, slot, :rest] = vector.pixels[in_whole:]
        self._affine[slot] = vector.affine

    def _move_to_front(self, slots: slice) -> None:
        to_front(self._kept.swapaxes(0, 1), slots)
        to_front(self._affine, slots)

    def combine(self, weights: np.ndarray, start: int, stop: int
                ) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield columns of weights (m, n_atoms + n_kept) @ rows, float32, until the next ones."""
        n_atoms, weights = self._atoms.shape[0], weights.astype(np.float32)
        n_kept = weights.shape[1] - n_atoms
        weights[:, n_atoms:] *= self._affine[:n_kept, 0].astype(np.float32)
        combined = np.empty((len(weights), BLOCK), np.float32)
        for first in range(start, stop, BLOCK):
            columns = slice(first, min(first + BLOCK, stop))
            rows = self._rows[:weights.shape[1], :columns.stop - first]
            self._atoms.read(first, rows[:n_atoms])
            kernel.centre(self._kept[first // BLOCK], self._affine, rows[n_atoms:])
            yield columns, np.matmul(weights, rows, out=combined[:, :columns.stop - first])


def in_blocks(n_rows: int, n_columns: int, dtype: type) -> np.ndarray:
    """
    Return zeros (n_blocks, n_rows, BLOCK) for a matrix of so many columns.

    They are in memory already, and need not be mapped in flight.
    """
    array = np.empty((-(-n_columns // BLOCK), n_rows, BLOCK), dtype)
    array.fill(0)
    return array
