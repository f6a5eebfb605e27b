"""What a camera's driver makes of an RGB picture: the encodings of sensor_msgs/Image by name."""

from __future__ import annotations

from typing import Callable

import cv2
import numpy as np

# ITU-R BT.601, studio range: rows Y, U, V; the last column is the offset.
BT601 = np.array([
    (0.257, 0.504, 0.098, 16.0),
    (-0.148, -0.291, 0.439, 128.0),
    (0.439, -0.368, -0.071, 128.0)])


def _same(rgb: np.ndarray) -> np.ndarray:
    return rgb


def _cv(conversion: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda rgb: cv2.cvtColor(rgb, conversion)


def _mono16(rgb: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.uint16) * 257


def _bayer_rggb(rgb: np.ndarray) -> np.ndarray:
    mosaic = rgb[:, :, 1].copy()
    mosaic[0::2, 0::2] = rgb[0::2, 0::2, 0]
    mosaic[1::2, 1::2] = rgb[1::2, 1::2, 2]
    return mosaic


def _yuyv(rgb: np.ndarray) -> np.ndarray:
    yuv = cv2.transform(rgb, BT601)
    packed = yuv[:, :, :2].copy()
    packed[:, 1::2, 1] = yuv[:, 0::2, 2]
    return packed


# Each takes RGB, uint8 of shape (height, width, 3).
ENCODINGS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    'rgb8': _same,
    'bgr8': _cv(cv2.COLOR_RGB2BGR),
    'rgba8': _cv(cv2.COLOR_RGB2RGBA),
    'bgra8': _cv(cv2.COLOR_RGB2BGRA),
    'mono8': _cv(cv2.COLOR_RGB2GRAY),
    'mono16': _mono16,
    'bayer_rggb8': _bayer_rggb,
    'yuv422_yuy2': _yuyv,
}
