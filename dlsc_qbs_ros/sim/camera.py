"""
The camera: 346x260 pixels, 80 degrees wide, ray cast over the plan and painted by one remap.

All surfaces are vertical, so one ray per image column finds what stands there: for each layer of
the world, a column gets a depth d (along the optical axis) and a place u on the texture strip. A
pixel with slope t above the optical axis then shows the height z = h + t d, h being the camera's.
That holds for a level camera; roll and pitch of a few degrees turn and shift the level image,
drawn with a margin, as a whole (first order: the shift is f tan(pitch)).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, degrees, radians, sin, tan

import cv2
import numpy as np

from .textures import PIXELS_PER_M
from .world import Layer, light_at, World

WIDTH, HEIGHT = 346, 260
FIELD_OF_VIEW_RAD = radians(80.0)
FOCAL_PX = WIDTH / 2 / tan(FIELD_OF_VIEW_RAD / 2)

MARGIN_PX = 20
MIP_LEVELS = 5
NO_HIT_M = 1e6
FLOOR_RGB, CEILING_RGB = (118, 116, 110), (74, 76, 80)
CEILING_M = 5.5
HAZE_M = 14.0

TARGET_GREY = 105.0
EXPOSURE_LAG = 0.12
EXPOSURE_GAINS = (0.6, 3.0)
VIGNETTE = 0.25
NOISE_GREY = 3.0
NOISE_BANK = 16


@dataclass(frozen=True)
class _Strip:
    """A layer in the atlas: the rows at which its mip levels begin."""

    layer: Layer
    tops: np.ndarray


class Camera:
    """
    A camera with auto exposure and sensor noise, in one world.

    The exposure follows the mean grey of the images so far, EXPOSURE_LAG of the (logarithmic) way
    per frame: at 10 Hz it needs about a second, in which the drone leaves a dark aisle blinded.
    """

    def __init__(self, world: World, seed):
        self._atlas, self._strips = _make_atlas(world)
        self._rng = np.random.default_rng(seed)
        self._gain = 1.0
        rows, cols = HEIGHT + 2 * MARGIN_PX, WIDTH + 2 * MARGIN_PX
        right = (np.arange(cols, dtype=np.float32) - (cols - 1) / 2) / FOCAL_PX
        up = ((rows - 1) / 2 - np.arange(rows, dtype=np.float32)) / FOCAL_PX
        self._right, self._up = right, up[:, None]
        radius_2 = right[None, :] ** 2 + self._up ** 2
        self._vignette = 1.0 - VIGNETTE * radius_2 / radius_2.max()
        noise = self._rng.normal(0.0, NOISE_GREY, (NOISE_BANK, HEIGHT, WIDTH, 3))
        self._noise = np.rint(noise).astype(np.int16)

    def render(self, pose: np.ndarray, lamps: float = 1.0) -> np.ndarray:
        """
        Take the next picture.

        Parameters
        ----------
        pose : ndarray of shape (6,)
            x, y, z in metres; roll, pitch, yaw in radians (ENU, FLU: pitch up is negative).
        lamps : float
            The share of the hall's lamps that is on.

        Returns
        -------
        ndarray of shape (HEIGHT, WIDTH, 3), uint8
            RGB.

        """
        x_m, y_m, z_m, roll, pitch, yaw = pose.tolist()
        map_x, map_y, light = self._trace(x_m, y_m, z_m, yaw)
        level = cv2.remap(self._atlas, map_x, map_y, cv2.INTER_LINEAR)
        light *= self._vignette
        light *= lamps * self._gain
        level = cv2.multiply(level, cv2.merge((light, light, light)), dtype=cv2.CV_8U)
        image = _tilt(level, roll, pitch)
        self._adapt(image)
        return cv2.add(image, self._draw_noise(), dtype=cv2.CV_8U)

    def _trace(self, x_m, y_m, z_m, yaw) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return where each pixel of a level camera lies in the atlas, and its light."""
        up = self._up
        below, above = np.minimum(up, -1e-3), np.maximum(up, 1e-3)
        flat_depth = np.where(up < 0.0, -z_m / below, (CEILING_M - z_m) / above)
        shape = (up.size, self._right.size)
        map_x = np.full(shape, 1.0, np.float32)
        map_y = np.broadcast_to(np.where(up < 0.0, 1.0, 5.0), shape).astype(np.float32)
        directions = np.stack((cos(yaw) + self._right * sin(yaw),
                               sin(yaw) - self._right * cos(yaw)), axis=1)
        light = light_at(x_m + flat_depth * directions[:, 0]) * np.exp(-flat_depth / HAZE_M)
        for strip in self._strips:
            depth, along = cast(strip.layer, np.array((x_m, y_m)), directions)
            seen = (up >= -z_m / depth) & (up <= (strip.layer.height_m - z_m) / depth)
            level = _mip_level(depth, along)
            scale = PIXELS_PER_M / 2.0 ** level
            top = strip.tops[level] - 0.5 + (strip.layer.height_m - z_m) * scale
            np.copyto(map_x, (along * scale - 0.5).astype(np.float32), where=seen)
            np.copyto(map_y, top.astype(np.float32)
                      - (depth * scale).astype(np.float32) * up, where=seen)
            np.copyto(light, np.exp(-depth / HAZE_M).astype(np.float32), where=seen)
        return map_x, map_y, light

    def _adapt(self, image: np.ndarray):
        """Move the gain towards the target brightness, as auto exposure does: late."""
        grey = max(float(image[::4, ::4].mean()), 1.0)
        self._gain = float(np.clip(
            self._gain * (TARGET_GREY / grey) ** EXPOSURE_LAG, *EXPOSURE_GAINS))

    def _draw_noise(self) -> np.ndarray:
        noise = self._noise[self._rng.integers(NOISE_BANK)]
        flip = self._rng.integers(4)
        return noise[::1 - 2 * (flip & 1), ::1 - (flip & 2)]


def cast(layer: Layer, origin: np.ndarray, directions: np.ndarray
         ) -> tuple[np.ndarray, np.ndarray]:
    """
    Find the nearest plane of a layer along each ray.

    Parameters
    ----------
    layer : Layer
        The planes.
    origin : ndarray of shape (2,)
        In metres.
    directions : ndarray of shape (n_rays, 2)
        Of any length; depth counts in this length.

    Returns
    -------
    depth : ndarray of shape (n_rays,)
        NO_HIT_M where a ray meets nothing.
    along_m : ndarray of shape (n_rays,)
        Where on the layer's texture strip.

    """
    sides = layer.ends - layer.starts
    to_start = layer.starts - origin
    crossing = directions[:, :1] * sides[:, 1] - directions[:, 1:] * sides[:, 0]
    with np.errstate(divide='ignore', invalid='ignore'):
        depth = (to_start[:, 0] * sides[:, 1] - to_start[:, 1] * sides[:, 0]) / crossing
        share = (to_start[:, 0] * directions[:, 1:] - to_start[:, 1] * directions[:, :1]
                 ) / crossing
    hit = (depth > 0.02) & (share >= 0.0) & (share <= 1.0)
    depth = np.where(hit, depth, NO_HIT_M)
    nearest = depth.argmin(axis=1)
    rays = np.arange(len(directions))
    share = np.clip(np.nan_to_num(share[rays, nearest]), 0.0, 1.0)
    return depth[rays, nearest], layer.offsets_m[nearest] + share * layer.lengths_m[nearest]


def _mip_level(depth: np.ndarray, along_m: np.ndarray) -> np.ndarray:
    """Return the texture level whose pixels are about as large as the image's, per column."""
    tall = depth * (PIXELS_PER_M / FOCAL_PX)
    wide = np.abs(np.gradient(along_m)) * PIXELS_PER_M
    footprint = np.sqrt(tall * np.clip(wide, tall, 8 * tall))
    return np.clip(np.rint(np.log2(footprint)), 0, MIP_LEVELS - 1).astype(int)


def _make_atlas(world: World) -> tuple[np.ndarray, list[_Strip]]:
    """Stack floor, ceiling and every layer's texture at every mip level, with a seam around."""
    width = max(layer.texture.shape[1] for layer in world.layers)
    flat = np.empty((8, width, 3), np.uint8)
    flat[:4], flat[4:] = FLOOR_RGB, CEILING_RGB
    rows, top, strips = [flat], len(flat), []
    for layer in world.layers:
        tops = []
        for level in range(MIP_LEVELS):
            height, length = (size >> level for size in layer.texture.shape[:2])
            texture = cv2.resize(layer.texture, (length, height), interpolation=cv2.INTER_AREA)
            rows.append(cv2.copyMakeBorder(
                texture, 2, 2, 0, width - length, cv2.BORDER_REPLICATE))
            tops.append(top + 2)
            top += height + 4
        strips.append(_Strip(layer, np.array(tops)))
    return np.concatenate(rows), strips


def _tilt(level: np.ndarray, roll: float, pitch: float) -> np.ndarray:
    """Turn and shift the level image and cut off its margin."""
    rows, cols = level.shape[:2]
    turn = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), degrees(roll), 1.0)
    turn[0, 2] -= MARGIN_PX
    turn[1, 2] -= MARGIN_PX + FOCAL_PX * tan(pitch)
    return cv2.warpAffine(level, turn, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR,
                          borderMode=cv2.BORDER_REPLICATE)
