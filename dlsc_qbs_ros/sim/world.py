"""
A seeded warehouse: vertical textured planes over a plan of 18 m by 13 m.

Three double-sided shelves stand along x. Two aisles between them look alike; corridors run
between the outer shelves and the walls. The ends of the hall, beyond the shelves, are bright::

    13 m +-----------------------------------------+
         |            north corridor               |
         |     +---------------------------+       |
         |     +---------------------------+       |   shelf 3
         |  W          aisle 2                 E   |
         |     +---------------------------+       |   shelf 2
         |  e  +---------------------------+   a   |
         |             aisle 1                     |
         |     +---------------------------+       |   shelf 1
         |     +---------------------------+       |
         |            south corridor               |
       0 +-----+---------------------------+-------+
         0     3                           15     18 m
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import textures

HALL_M = (18.0, 13.0)
WALL_HEIGHT_M = 5.5
SHELF_X_M = (3.0, 15.0)
SHELF_Y_M = ((2.125, 3.375), (5.875, 7.125), (9.625, 10.875))
SHELF_HEIGHT_M = 3.5
AISLE_LIGHT = 0.5
END_LIGHT = 1.0

# Places in the strips of the walls (clockwise from the south-east corner) and of the shelves
# (each anticlockwise from its south-west corner: south, east, north, west).
WEST, EAST = 1, 3
SHELF_1_NORTH, SHELF_2_SOUTH, SHELF_2_NORTH, SHELF_3_SOUTH = 2, 4, 6, 8


@dataclass(frozen=True)
class Layer:
    """
    Vertical planes of one height, textured from one strip.

    Attributes
    ----------
    starts, ends : ndarray of shape (n_planes, 2)
        The planes in the plan, in metres; seen from the visible side, start is on the left.
    height_m : float
        Height above the floor, that of the strip.
    texture : ndarray of shape (height, width, 3), uint8
        RGB, `textures.PIXELS_PER_M` to the metre, the planes one after the other.

    """

    starts: np.ndarray
    ends: np.ndarray
    height_m: float
    texture: np.ndarray

    @property
    def lengths_m(self) -> np.ndarray:
        """Return the length of each plane, shape (n_planes,)."""
        return np.linalg.norm(self.ends - self.starts, axis=1)

    @property
    def offsets_m(self) -> np.ndarray:
        """Return where each plane begins on the strip, shape (n_planes,)."""
        return np.concatenate(([0.0], np.cumsum(self.lengths_m)[:-1]))


@dataclass(frozen=True)
class World:
    """Layers from far to near: wherever both are seen, a shelf hides the wall."""

    layers: tuple[Layer, ...]


def light_at(x_m: np.ndarray) -> np.ndarray:
    """Return the light along the hall: AISLE_LIGHT in the middle, END_LIGHT beyond the shelves."""
    near_m, far_m = 4.5, 7.0
    share = (np.abs(x_m - HALL_M[0] / 2) - near_m) / (far_m - near_m)
    return AISLE_LIGHT + (END_LIGHT - AISLE_LIGHT) * np.clip(share, 0.0, 1.0)


def make_world(seed: int, twin_aisle: bool = False) -> World:
    """
    Return the warehouse of a seed; all flights of that seed share it.

    With `twin_aisle`, aisle 2 is aisle 1 turned by half a turn about the middle of the hall, and
    the west wall is the east wall. Shelf ends, corridors and the other walls stay as they are.
    """
    rng = np.random.default_rng([seed, 0])
    return World((_walls(rng, twin_aisle), _shelves(rng, twin_aisle)))


def _walls(rng, twin_aisle) -> Layer:
    width, depth = HALL_M
    starts, ends = _outline(width, 0.0, 0.0, depth)  # clockwise: seen from inside
    strips = [textures.paint_wall(rng, length, WALL_HEIGHT_M)
              for length in (width, depth, width, depth)]
    if twin_aisle:
        strips[WEST] = strips[EAST]
    return _lit(Layer(starts, ends, WALL_HEIGHT_M, np.concatenate(strips, axis=1)))


def _shelves(rng, twin_aisle) -> Layer:
    template = textures.bay_template(rng)
    west, east = SHELF_X_M
    outlines, strips = [], []
    for number, (south, north) in enumerate(SHELF_Y_M):
        outlines.append(_outline(west, south, east, north))
        for face in range(2):
            strips.append(textures.paint_shelf(
                rng, template, east - west, SHELF_HEIGHT_M, n_distinct=1))
            strips.append(textures.paint_shelf_end(
                rng, north - south, SHELF_HEIGHT_M, 2 * number + face + 1))
    if twin_aisle:
        strips[SHELF_3_SOUTH], strips[SHELF_2_NORTH] = strips[SHELF_1_NORTH], strips[SHELF_2_SOUTH]
    starts, ends = (np.concatenate(points) for points in zip(*outlines))
    return _lit(Layer(starts, ends, SHELF_HEIGHT_M, np.concatenate(strips, axis=1)))


def _outline(x0_m, y0_m, x1_m, y1_m) -> tuple[np.ndarray, np.ndarray]:
    """Return the four sides of a rectangle, along x first; anticlockwise when x0 < x1."""
    corners = np.array([(x0_m, y0_m), (x1_m, y0_m), (x1_m, y1_m), (x0_m, y1_m)])
    return corners, np.roll(corners, -1, axis=0)


def _lit(layer: Layer) -> Layer:
    """Return the layer with the light of the hall baked into its texture."""
    along_m = (np.arange(layer.texture.shape[1]) + 0.5) / textures.PIXELS_PER_M
    knots_m = np.append(layer.offsets_m, layer.offsets_m[-1] + layer.lengths_m[-1])
    x_m = np.interp(along_m, knots_m, np.append(layer.starts[:, 0], layer.ends[-1, 0]))
    texture = (layer.texture * light_at(x_m)[None, :, None]).astype(np.uint8)
    return Layer(layer.starts, layer.ends, layer.height_m, texture)
