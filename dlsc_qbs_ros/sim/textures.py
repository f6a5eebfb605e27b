"""Seeded paint for shelves and walls: RGB strips in metres, as if unrolled along the plan."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

PIXELS_PER_M = 64

UPRIGHT_RGB = (45, 70, 140)
BEAM_RGB = (196, 98, 40)
GAP_RGB = (48, 44, 42)
CARTON_RGB = np.array([(172, 128, 84), (150, 108, 70), (190, 150, 104), (128, 96, 68)])
DISTINCT_RGB = np.array([
    (200, 40, 40), (40, 150, 70), (40, 90, 200), (225, 190, 40), (150, 60, 160), (235, 235, 230)])
WALL_RGB = np.array((176, 176, 170))
SKIRTING_RGB = np.array((112, 122, 130))
WIDEST_FEATURE_M = 2.6

BAY_M = 2.0
LEVELS_M = (0.12, 1.3, 2.48)
LEVEL_CLEARANCE_M = 1.02


class Carton(NamedTuple):
    """A carton in its bay: the left edge from the bay's, its size, and its place in CARTON_RGB."""

    left_m: float
    width_m: float
    height_m: float
    colour: int


class Canvas:
    """A texture painted in metres: x to the right, heights upward from the floor."""

    def __init__(self, width_m: float, height_m: float, colour):
        size = (round(height_m * PIXELS_PER_M), round(width_m * PIXELS_PER_M), 3)
        self.pixels = np.full(size, colour, np.uint8)

    def box(self, left_m: float, bottom_m: float, width_m: float, height_m: float, colour):
        """Fill a rectangle; what lies beyond the canvas is cut off."""
        top, bottom = (len(self.pixels) - round(z * PIXELS_PER_M)
                       for z in (bottom_m + height_m, bottom_m))
        left, right = (round(x * PIXELS_PER_M) for x in (left_m, left_m + width_m))
        self.pixels[max(top, 0):max(bottom, 0), max(left, 0):max(right, 0)] = colour

    def framed(self, left_m: float, bottom_m: float, width_m: float, height_m: float, colour,
               frame, border_m: float = 0.04):
        """Fill a rectangle with a border of another colour inside it."""
        self.box(left_m, bottom_m, width_m, height_m, frame)
        self.box(left_m + border_m, bottom_m + border_m,
                 width_m - 2 * border_m, height_m - 2 * border_m, colour)

    def text(self, left_m: float, bottom_m: float, text: str, height_m: float, colour):
        """Write one line of letters of the given height."""
        scale = height_m * PIXELS_PER_M / 22
        origin = (round(left_m * PIXELS_PER_M),
                  len(self.pixels) - round(bottom_m * PIXELS_PER_M))
        cv2.putText(self.pixels, text, origin, cv2.FONT_HERSHEY_SIMPLEX, scale,
                    tuple(map(int, colour)), max(1, round(2 * scale)), cv2.LINE_AA)


def bay_template(rng: np.random.Generator) -> list[list[Carton]]:
    """Return the cartons of each level of the one bay that every shelf repeats."""
    return [_carton_row(rng) for _ in LEVELS_M]


def _carton_row(rng) -> list[Carton]:
    cartons, left = [], 0.12
    while left < BAY_M - 0.45:
        width = min(rng.uniform(0.35, 0.8), BAY_M - 0.08 - left)
        cartons.append(Carton(left, width, rng.uniform(0.4, 0.95), rng.integers(len(CARTON_RGB))))
        left += width + rng.uniform(0.02, 0.12)
    return cartons


def paint_shelf(rng: np.random.Generator, template: list[list[Carton]], length_m: float,
                height_m: float, n_distinct: int) -> np.ndarray:
    """
    Paint a shelf face of repeated bays.

    Every bay holds the template's cartons, each a little moved, resized and toned, one in ten
    taken away and one in ten of another colour; `n_distinct` boxes like no other stand out.
    """
    canvas = Canvas(length_m, height_m, GAP_RGB)
    n_bays = round(length_m / BAY_M)
    for bay in range(n_bays):
        for level_m, row in zip(LEVELS_M, template):
            canvas.box(bay * BAY_M, level_m - 0.12, BAY_M, 0.12, BEAM_RGB)
            for carton in row:
                if rng.random() > 0.04:
                    _paint_carton(canvas, rng, bay * BAY_M, level_m, carton)
    for bay in rng.choice(n_bays, n_distinct, replace=False):
        _paint_distinct_box(canvas, rng, bay * BAY_M)
    for upright in range(n_bays + 1):
        canvas.box(upright * BAY_M - 0.05, 0.0, 0.1, height_m, UPRIGHT_RGB)
    return _weathered(rng, canvas.pixels)


def _paint_carton(canvas, rng, bay_m, level_m, carton):
    left = bay_m + carton.left_m + rng.normal(0.0, 0.02)
    width = carton.width_m * rng.uniform(0.95, 1.03)
    height = min(carton.height_m * rng.uniform(0.94, 1.06), LEVEL_CLEARANCE_M)
    colour = CARTON_RGB[rng.integers(len(CARTON_RGB)) if rng.random() < 0.05 else carton.colour]
    colour = colour * rng.uniform(0.94, 1.06)
    canvas.framed(left, level_m, width, height, colour, 0.7 * colour, 0.02)
    canvas.box(left + 0.45 * width, level_m, 0.05, height, np.minimum(1.2 * colour, 255))
    canvas.box(left + 0.08, level_m + 0.1, 0.14, 0.1, (215, 215, 210))


def _paint_distinct_box(canvas, rng, bay_m):
    level_m = LEVELS_M[rng.integers(len(LEVELS_M))]
    base, mark = DISTINCT_RGB[rng.choice(len(DISTINCT_RGB), 2, replace=False)]
    width = rng.uniform(0.9, 1.6)
    left = bay_m + rng.uniform(0.1, BAY_M - 0.1 - width)
    canvas.framed(left, level_m, width, rng.uniform(0.6, 1.0), base, 0.6 * base)
    canvas.box(left + 0.2 * width, level_m + 0.2, 0.5 * width, 0.2, mark)


def paint_shelf_end(rng: np.random.Generator, length_m: float, height_m: float,
                    number: int) -> np.ndarray:
    """Paint the end panel of a shelf with its number and a hazard stripe."""
    canvas = Canvas(length_m, height_m, rng.uniform(90, 130) * np.array([0.9, 1.0, 1.1]))
    canvas.box(0.0, 0.0, length_m, 0.4, (210, 180, 40))
    sign = DISTINCT_RGB[rng.integers(len(DISTINCT_RGB) - 1)]
    canvas.framed(0.2, 1.9, length_m - 0.4, 0.9, (235, 235, 230), sign, 0.06)
    canvas.text(0.35, 2.15, f'{number:02d}', 0.45, (20, 20, 20))
    return _weathered(rng, canvas.pixels)


def paint_wall(rng: np.random.Generator, length_m: float, height_m: float) -> np.ndarray:
    """Paint an outer wall: doors, gates, windows, pipes, posters and cabinets at random."""
    canvas = Canvas(length_m, height_m, rng.uniform(0.85, 1.1) * WALL_RGB)
    canvas.box(0.0, 0.0, length_m, rng.uniform(0.7, 1.5), rng.uniform(0.7, 1.1) * SKIRTING_RGB)
    left = rng.uniform(0.2, 0.8)
    while left < length_m - WIDEST_FEATURE_M:
        paint = FEATURES[rng.integers(len(FEATURES))]
        left += paint(canvas, rng, left) + rng.uniform(0.2, 0.9)
    for height in rng.uniform(3.6, height_m - 0.3, 2):
        canvas.box(0.0, height, length_m, 0.12, rng.uniform(80, 150))
    return _weathered(rng, canvas.pixels)


def _paint_door(canvas, rng, left_m) -> float:
    width, colour = rng.uniform(0.9, 1.4), DISTINCT_RGB[rng.integers(len(DISTINCT_RGB))]
    canvas.framed(left_m, 0.0, width, 2.1, 0.75 * colour, (70, 70, 72), 0.08)
    canvas.box(left_m + 0.75 * width, 1.0, 0.1, 0.06, (220, 220, 220))
    return width


def _paint_gate(canvas, rng, left_m) -> float:
    width, height = rng.uniform(2.0, WIDEST_FEATURE_M), rng.uniform(2.6, 3.4)
    tone = rng.uniform(120, 200) * np.array([0.95, 1.0, 1.0])
    canvas.framed(left_m, 0.0, width, height, tone, (200, 170, 40), 0.12)
    for slat in np.arange(0.3, height - 0.2, 0.3):
        canvas.box(left_m + 0.12, slat, width - 0.24, 0.05, 0.75 * tone)
    return width


def _paint_window(canvas, rng, left_m) -> float:
    width, bottom = rng.uniform(1.0, 2.2), rng.uniform(1.6, 2.8)
    canvas.framed(left_m, bottom, width, 1.2, (236, 244, 250), (90, 90, 92), 0.07)
    canvas.box(left_m + width / 2, bottom, 0.06, 1.2, (90, 90, 92))
    return width


def _paint_pipe(canvas, rng, left_m) -> float:
    colour = rng.uniform(60, 210) * np.array([1.0, 0.95, 0.9])
    canvas.box(left_m, 0.0, 0.16, 9.0, colour)
    canvas.box(left_m + 0.05, 0.0, 0.04, 9.0, np.minimum(1.25 * colour, 255))
    return 0.2


def _paint_poster(canvas, rng, left_m) -> float:
    width, height, bottom = rng.uniform(0.6, 1.4), rng.uniform(0.7, 1.4), rng.uniform(0.9, 1.8)
    base, mark = DISTINCT_RGB[rng.choice(len(DISTINCT_RGB), 2, replace=False)]
    canvas.framed(left_m, bottom, width, height, base, (240, 240, 240))
    canvas.box(left_m + 0.2 * width, bottom + rng.uniform(0.1, 0.6) * height,
               0.6 * width, 0.25 * height, mark)
    return width


def _paint_cabinet(canvas, rng, left_m) -> float:
    width, bottom = rng.uniform(0.5, 0.9), rng.uniform(0.6, 1.3)
    colour = rng.uniform(70, 140) * np.array([1.0, 1.0, 1.05])
    canvas.framed(left_m, bottom, width, rng.uniform(0.8, 1.2), colour, 0.6 * colour)
    canvas.box(left_m + 0.3 * width, bottom + 0.5, 0.12, 0.12, (240, 210, 40))
    return width


FEATURES = (_paint_door, _paint_gate, _paint_window, _paint_pipe, _paint_poster, _paint_cabinet)


def _weathered(rng, pixels: np.ndarray) -> np.ndarray:
    """Return the paint with soft stains of some per cent."""
    rows, cols = pixels.shape[:2]
    stains = rng.normal(1.0, 0.03, (max(2, rows // 24), max(2, cols // 24))).astype(np.float32)
    stains = cv2.resize(stains, (cols, rows), interpolation=cv2.INTER_CUBIC)
    return np.clip(pixels * stains[..., None], 0, 255).astype(np.uint8)
