"""
The pose cells: a continuous attractor network over (heading, y, x) on a torus.

RatSLAM's filter between the views and the map. One packet of activity moves with the odometry;
a recognised view injects activity where the packet stood when the view was new, and when that
outweighs the packet, it jumps there: after two fresh views at an injection of 0.3, one at 0.6.
"""

from __future__ import annotations

from math import pi

import numpy as np

from .types import Pose2
from ..config import PoseCellsConfig

N_HEADINGS = 36
EXCITATION = (7, 1.0)
INHIBITION = (5, 2.0)
GLOBAL_INHIBITION = 2e-5
READ_OUT_RADIUS = 3


class PoseCells:
    """
    The network's activity, of shape (N_HEADINGS, size_xy, size_xy), summing to 1.

    Positions in the network are (x, y, heading) in cells, ndarrays of shape (3,).
    """

    def __init__(self, config: PoseCellsConfig):
        self._cell_size_m = config.cell_size_m
        self.shape = (N_HEADINGS, config.size_xy, config.size_xy)
        self.activity = np.zeros(self.shape)
        self.activity[tuple(n // 2 for n in self.shape)] = 1.0
        excite, inhibit = (_transfer(self.shape, *kernel) for kernel in (EXCITATION, INHIBITION))
        self._attractor = excite * (1.0 - inhibit)
        rows, columns = (2 * pi * np.fft.fftfreq(config.size_xy),
                         2 * pi * np.fft.rfftfreq(config.size_xy))
        self._row_phase, self._column_phase = rows[None, :, None], columns[None, None, :]

    def place(self, position: np.ndarray) -> None:
        """Move the packet to a position, wherever it was."""
        self.activity[:] = 0.0
        self.inject(position, 1.0)

    def inject(self, position: np.ndarray, energy: float) -> None:
        """Add activity to the cell nearest to a position."""
        x, y, heading = np.rint(position).astype(int) % self.shape[::-1]
        self.activity[heading, y, x] += energy

    def step(self, motion: Pose2) -> None:
        """Let the attractor settle once, then move the activity along with the odometry."""
        self.activity = np.fft.irfftn(
            np.fft.rfftn(self.activity) * self._attractor, self.shape, axes=(0, 1, 2))
        self.activity = np.maximum(self.activity - GLOBAL_INHIBITION, 0.0)
        self._translate(motion)
        self._rotate(motion.yaw_rad * N_HEADINGS / (2 * pi))
        self.activity /= self.activity.sum()

    def _translate(self, motion: Pose2) -> None:
        """Shift each heading's layer along its own direction, bilinearly, on the exact torus."""
        headings = 2 * pi * np.arange(N_HEADINGS)[:, None, None] / N_HEADINGS
        c, s = np.cos(headings), np.sin(headings)
        x = (c * motion.x_m - s * motion.y_m) / self._cell_size_m
        y = (s * motion.x_m + c * motion.y_m) / self._cell_size_m
        spectrum = np.fft.rfft2(self.activity)
        spectrum *= _linear_shift(x, self._column_phase) * _linear_shift(y, self._row_phase)
        shifted = np.fft.irfft2(spectrum, self.shape[1:])
        self.activity = np.maximum(shifted, 0.0)

    def _rotate(self, cells: float) -> None:
        whole = int(np.floor(cells))
        rest = cells - whole
        self.activity = ((1.0 - rest) * np.roll(self.activity, whole, axis=0)
                         + rest * np.roll(self.activity, whole + 1, axis=0))

    def position(self) -> np.ndarray:
        """Return the centre of the strongest packet: a population vector around the peak."""
        peak = np.unravel_index(np.argmax(self.activity), self.shape)
        window = [np.arange(p - READ_OUT_RADIUS, p + READ_OUT_RADIUS + 1) % n
                  for p, n in zip(peak, self.shape)]
        packet = self.activity[np.ix_(*window)]
        centre = np.empty(3)
        for axis, n in enumerate(self.shape):
            angles = 2 * pi * window[axis] / n
            weights = packet.sum(axis=tuple(a for a in range(3) if a != axis))
            centre[2 - axis] = np.arctan2(weights @ np.sin(angles),
                                          weights @ np.cos(angles)) * n / (2 * pi) % n
        return centre

    def distance(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the distance in cells on the torus between positions of shape (..., 3)."""
        size = np.array(self.shape[::-1])
        difference = np.abs(a - b) % size
        return np.linalg.norm(np.minimum(difference, size - difference), axis=-1)

    def turned(self, position: np.ndarray, relative_heading_rad: float) -> np.ndarray:
        """Return a position with its heading turned."""
        turn = relative_heading_rad * N_HEADINGS / (2 * pi)
        return position + np.array([0.0, 0.0, turn])


def _transfer(shape: tuple, width: int, deviation: float) -> np.ndarray:
    """Return the transfer function of a Gaussian kernel of sum 1, `width` cells in each axis."""
    reach = np.arange(width) - width // 2
    profile = np.exp(-reach ** 2 / (2.0 * deviation ** 2))
    profile /= profile.sum()
    kernel = np.zeros(shape)
    kernel[np.ix_(*(reach % n for n in shape))] = np.einsum('i,j,k', profile, profile, profile)
    return np.fft.rfftn(kernel)


def _linear_shift(cells: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Return the transfer function of linear interpolation by a fractional shift."""
    whole = np.floor(cells)
    rest = cells - whole
    return np.exp(-1j * phase * whole) * ((1.0 - rest) + rest * np.exp(-1j * phase))
