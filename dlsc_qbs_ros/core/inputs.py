"""What of a view is coded, and what its codes are made into: one for each `encoder.input`."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .preprocessing import MIN_CONTRAST, PixelInput
from ..config import Config
from ..errors import ConfigError

# Added to a patch's variance, in that of the view: a flat patch is not blown up to one of detail.
FLAT = 1.0
# Added to the energy of a neighbourhood, as a share of the mean: so is a dark part of the view.
FLOOR = 0.1
# No feature counts for more in its neighbourhood.
CLIP = 0.2


class ImageInputs:
    """The paper's: a whole view is one input vector, its code the code of the frame."""

    batch = 32

    def __init__(self, config: Config):
        self._standardise = config.view.standardise
        self.shape = config.view.height, config.view.width
        self.n_inputs = config.view.height * config.view.width
        self.n_values = config.encoder.n_atoms

    def of(self, view: np.ndarray) -> PixelInput:
        """Return the input vector of a view (height, width), uint8."""
        return PixelInput(view, self._standardise)

    def pooled(self, codes: np.ndarray) -> np.ndarray:
        """Return the codes of the views (n_views, n_values): those of their inputs."""
        return codes


class PatchInputs:
    """
    All small patches of a view; the code of the frame pools theirs over cells.

    Patches have no mean, and their contrast is brought near to one. What is pooled is how
    strongly each atom is used in each part of the view, whatever its sign, relative to all
    atoms in the neighbourhood.
    """

    batch = 1

    def __init__(self, config: Config):
        self._size = config.patches.size
        self.shape = self._size, self._size
        self.n_inputs = self._size ** 2
        self.n_values = config.patches.cells_y * config.patches.cells_x * config.encoder.n_atoms
        rows, columns = (edge - self._size + 1 for edge in (config.view.height, config.view.width))
        cells_y, cells_x = config.patches.cells_y, config.patches.cells_x
        if rows < cells_y or columns < cells_x:
            raise ConfigError(
                f'patches.size = {self._size}: a view of {config.view.width}x'
                f'{config.view.height} has {max(columns, 0)}x{max(rows, 0)} of them, expected at '
                f'least the {cells_x}x{cells_y} cells they are pooled into')
        self._weights = pooling_weights(rows, columns, cells_y, cells_x)
        self._neighbours = neighbourhoods(cells_y, cells_x)

    def of(self, view: np.ndarray) -> np.ndarray:
        """Return the patches (n_patches, size * size), float32, of a view, row by row."""
        return patches_of(view, self._size)

    def pooled(self, codes: np.ndarray) -> np.ndarray:
        """Return the code of the view (1, n_cells * n_atoms), of length 1 or 0."""
        return pool(codes, self._weights, self._neighbours)[None]


def make_inputs(config: Config) -> ImageInputs | PatchInputs:
    """Return what `encoder.input` names."""
    return (PatchInputs if config.encoder.input == 'patches' else ImageInputs)(config)


def patches_of(view: np.ndarray, size: int) -> np.ndarray:
    """
    Return all patches of a view, at every pixel, without mean and of comparable contrast.

    Parameters
    ----------
    view : ndarray of shape (height, width), uint8
        It is first given zero mean and deviation 1.
    size : int
        Edge of a patch in pixels.

    Returns
    -------
    ndarray of shape ((height - size + 1) * (width - size + 1), size * size), float32
        Each of a length below 1.

    """
    pixels = view - view.mean(dtype=np.float32)
    pixels /= max(float(pixels.std()), MIN_CONTRAST)
    windows = np.lib.stride_tricks.sliding_window_view(pixels, (size, size))
    patches = windows.reshape(-1, size * size)
    patches = patches - patches.mean(axis=1, keepdims=True)
    variance = np.einsum('ij,ij->i', patches, patches)[:, None] / patches.shape[1]
    return patches / (size * np.sqrt(variance + FLAT))


@lru_cache(maxsize=8)
def pooling_weights(rows: int, columns: int, cells_y: int, cells_x: int) -> np.ndarray:
    """Return the (cells_y * cells_x, rows * columns) shares, summing to 1, of soft cells."""
    vertical, horizontal = _soft_cells(rows, cells_y), _soft_cells(columns, cells_x)
    return np.kron(vertical, horizontal).astype(np.float32)


def _soft_cells(n: int, n_cells: int) -> np.ndarray:
    """Return overlapping triangles (n_cells, n) about the cells' middles, each of sum 1."""
    middles = (np.arange(n_cells) + 0.5) * (n / n_cells) - 0.5
    distance = np.abs(np.arange(n) - middles[:, None]) * (n_cells / n)
    shares = np.maximum(1.0 - distance, 0.0)
    return shares / shares.sum(axis=1, keepdims=True)


@lru_cache(maxsize=8)
def neighbourhoods(cells_y: int, cells_x: int) -> np.ndarray:
    """Return the (n_cells, n_cells) shares, summing to 1, of the up to 3x3 cells around each."""
    y, x = np.divmod(np.arange(cells_y * cells_x), cells_x)
    near = ((np.abs(y[:, None] - y) <= 1) & (np.abs(x[:, None] - x) <= 1)).astype(np.float32)
    return near / near.sum(axis=1, keepdims=True)


def pool(codes: np.ndarray, weights: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """
    Pool the codes of a view's patches over cells.

    Parameters
    ----------
    codes : ndarray of shape (n, n_atoms)
        The patches' codes.
    weights : ndarray of shape (n_cells, n)
        What each patch counts in each cell (`pooling_weights`).
    neighbours : ndarray of shape (n_cells, n_cells)
        What each cell counts in the energy around each cell (`neighbourhoods`).

    Returns
    -------
    ndarray of shape (n_cells * n_atoms,), float32
        Root mean squares relative to the energy around, none above `CLIP`, together of length
        1; zeros where nothing was coded.

    """
    power = weights @ np.square(codes).astype(np.float32)
    energy = neighbours @ power.sum(axis=1)
    energy += FLOOR * energy.mean()
    if not energy.any():
        return np.zeros(power.size, np.float32)
    features = np.minimum(np.sqrt(power / energy[:, None]), CLIP)
    return (features / np.linalg.norm(features)).ravel()
