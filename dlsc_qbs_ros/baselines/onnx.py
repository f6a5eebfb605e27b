"""Any network in an ONNX file as an encoder, run by OpenCV: VGG-11, LatentSLAM, one's own."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from .onnx_file import input_shape
from ..config import ViewConfig
from ..core.local_view import Cosine
from ..core.preprocessing import make_view
from ..errors import ConfigError, ModelError

# Of the networks of torchvision, for red, green and blue in [0, 1].
IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], np.float32).reshape(3, 1, 1)
IMAGENET_DEVIATION = np.array([0.229, 0.224, 0.225], np.float32).reshape(3, 1, 1)


class OnnxEncoder:
    """
    The output of a network, flattened; the cosine compares it.

    The network takes one image (1, channels, rows, columns) of a fixed size. Where it takes one
    channel, pixels are in [0, 1]. Where it takes three, each is that image, normalised by the
    mean and the deviation of ImageNet's red, green and blue.

    Parameters
    ----------
    path : Path
        The ONNX file.

    Raises
    ------
    ModelError
        When the file is missing, no ONNX file, beyond what OpenCV runs, or takes no such image.

    """

    def __init__(self, path: Path):
        self.measure = Cosine()
        self._channels, self._size = _image_taken(path)
        try:
            self._net = cv2.dnn.readNetFromONNX(str(path))
            self.describe(np.zeros((self._size.height, self._size.width), np.uint8))
        except cv2.error as error:
            reason = (error.err or str(error)).strip().splitlines()[-1]
            raise ModelError(
                f'{path}: OpenCV {cv2.__version__} cannot run it: {reason}') from error

    def describe(self, grey: np.ndarray) -> np.ndarray:
        """Return the output (n_values,), float32, for a grey image (rows, columns), uint8."""
        pixels = make_view(grey, self._size)[None, None].astype(np.float32) / 255.0
        if self._channels == 3:
            pixels = (pixels - IMAGENET_MEAN) / IMAGENET_DEVIATION
        self._net.setInput(pixels)
        return self._net.forward().ravel()


def _image_taken(path: Path) -> tuple[int, ViewConfig]:
    """Return the channels and the size of the image that a network takes."""
    try:
        shape = input_shape(path.read_bytes())
    except OSError as error:
        raise ModelError(f'{path}: cannot be read: {error.strerror}') from error
    except ValueError as error:
        raise ModelError(f'{path}: not the ONNX file of an encoder: {error}') from error
    refusal = (f'{path}: takes an input of shape {shape} (0: open); expected one image, '
               '(1, 1 or 3 channels, rows, columns)')
    if len(shape) != 4 or shape[0] > 1 or shape[1] not in (1, 3):
        raise ModelError(refusal)
    try:
        return shape[1], ViewConfig(width=shape[3], height=shape[2])
    except ConfigError as error:
        raise ModelError(f'{refusal}: {error}') from error
