"""Image messages of every encoding that drone cameras send ↔ grey arrays."""

from __future__ import annotations

from array import array
from typing import Callable, NamedTuple

import cv2
import numpy as np
from sensor_msgs.msg import CompressedImage, Image

from .stamps import ns_to_stamp, stamp_to_ns
from ..core.types import Frame
from ..errors import ImageError

MAX_SIDE_PX = 16384


class _Layout(NamedTuple):
    """
    How pixels lie in memory.

    `to_grey` takes an ndarray of shape (rows, columns, channels) or, for one channel,
    (rows, columns); `planes` is the size of all planes together, the first being 1.
    """

    channels: int
    to_grey: Callable[[np.ndarray], np.ndarray]
    dtype: type = np.uint8
    planes: float = 1.0


def _same(pixels: np.ndarray) -> np.ndarray:
    return pixels


def _cv(conversion: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda pixels: cv2.cvtColor(pixels, conversion)


def _of_yuv422(luma_byte: int) -> Callable[[np.ndarray], np.ndarray]:
    return lambda pixels: pixels[:, :, luma_byte]


_COLOUR = {
    'rgb': (3, _cv(cv2.COLOR_RGB2GRAY)),
    'bgr': (3, _cv(cv2.COLOR_BGR2GRAY)),
    'rgba': (4, _cv(cv2.COLOR_RGBA2GRAY)),
    'bgra': (4, _cv(cv2.COLOR_BGRA2GRAY)),
    # OpenCV names a Bayer pattern by the second pixels of its second row, ROS by its first row.
    'bayer_rggb': (1, _cv(cv2.COLOR_BayerBG2GRAY)),
    'bayer_bggr': (1, _cv(cv2.COLOR_BayerRG2GRAY)),
    'bayer_gbrg': (1, _cv(cv2.COLOR_BayerGR2GRAY)),
    'bayer_grbg': (1, _cv(cv2.COLOR_BayerGB2GRAY)),
    'mono': (1, _same),
}
_LAYOUTS: dict[str, _Layout] = {
    **{f'{name}8': _Layout(*layout) for name, layout in _COLOUR.items()},
    **{f'{name}16': _Layout(*layout, dtype=np.uint16) for name, layout in _COLOUR.items()},
    'uyvy': _Layout(2, _of_yuv422(1)),
    'yuyv': _Layout(2, _of_yuv422(0)),
    'nv12': _Layout(1, _same, planes=1.5),
    'nv21': _Layout(1, _same, planes=1.5),
    'nv24': _Layout(1, _same, planes=3.0),
}
_LAYOUTS.update({alias: _LAYOUTS[name] for alias, name in {
    '8UC1': 'mono8', '8UC3': 'bgr8', '8UC4': 'bgra8',
    '16UC1': 'mono16', '16UC3': 'bgr16', '16UC4': 'bgra16',
    'yuv422': 'uyvy', 'yuv422_yuy2': 'yuyv'}.items()})


def frame_from_msg(msg: Image | CompressedImage) -> Frame:
    """Return the grey frame of a raw or compressed image; raise ImageError as its parts do."""
    grey = image_to_grey(msg) if isinstance(msg, Image) else compressed_to_grey(msg)
    return Frame(stamp_to_ns(msg.header.stamp), grey)


def image_to_grey(msg: Image) -> np.ndarray:
    """
    Return the image as a contiguous uint8 ndarray of shape (height, width).

    16-bit values are scaled from their full range; of YUV images the luma is taken as it is.

    Raises
    ------
    ImageError
        When the encoding is unknown or size, step and data do not fit each other.

    """
    layout = _LAYOUTS.get(msg.encoding)
    if layout is None:
        raise ImageError(f'encoding {msg.encoding!r}: expected one of {", ".join(_LAYOUTS)}')
    for side in ('width', 'height'):
        if not 1 <= getattr(msg, side) <= MAX_SIDE_PX:
            raise ImageError(
                f'{side} {getattr(msg, side)}: expected a value in [1, {MAX_SIDE_PX}]')
    grey = layout.to_grey(_pixels(msg, layout))
    if layout.dtype is np.uint16:
        grey = cv2.convertScaleAbs(grey, alpha=1 / 257)
    return np.ascontiguousarray(grey)


def compressed_to_grey(msg: CompressedImage) -> np.ndarray:
    """
    Decode a JPEG or PNG image to a uint8 ndarray of shape (height, width).

    Raises
    ------
    ImageError
        When the data is no whole image.

    """
    data = np.frombuffer(msg.data, np.uint8)
    if data[:2].tobytes() == b'\xff\xd8' and not _ends_as_jpeg(data):
        raise ImageError(f'compressed image of {data.size} bytes is truncated: no end marker')
    try:
        grey = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        grey = None
    if grey is None:
        raise ImageError(
            f'compressed image of {data.size} bytes, format {msg.format!r}, cannot be decoded')
    return grey


def image_to_msg(stamp_ns: int, pixels: np.ndarray, encoding: str, frame_id: str) -> Image:
    """
    Return an image message without row padding.

    `pixels` has shape (rows, columns) or (rows, columns, channels) and the encoding's own dtype.
    """
    pixels = np.ascontiguousarray(pixels)
    msg = Image()
    msg.header.stamp = ns_to_stamp(stamp_ns)
    msg.header.frame_id = frame_id
    msg.height, msg.width = pixels.shape[:2]
    msg.encoding = encoding
    msg.is_bigendian = int(_is_bigendian(pixels.dtype))
    msg.step = pixels[0].nbytes
    data = array('B')  # the only type that the setter takes over without a copy
    data.frombytes(pixels.reshape(-1).view(np.uint8))
    msg.data = data
    return msg


def _pixels(msg: Image, layout: _Layout) -> np.ndarray:
    """Return the pixels, or the luma plane, as an array in the machine's own byte order."""
    item_size = np.dtype(layout.dtype).itemsize
    row_size = msg.width * layout.channels * item_size
    if msg.step < row_size:
        raise ImageError(f'step {msg.step}: expected at least {row_size} bytes, '
                         f'{msg.width} pixels of {msg.encoding}')
    height = _luma_rows(msg, layout)
    needed = int(msg.step * (height * layout.planes - 1)) + row_size
    if len(msg.data) < needed:
        raise ImageError(f'{len(msg.data)} bytes of data: expected at least {needed}, '
                         f'{msg.height} rows of {msg.step} bytes as {msg.encoding}')
    shape = (height, msg.width, layout.channels)
    pixels = np.ndarray(
        shape if layout.channels > 1 else shape[:2],
        np.dtype(layout.dtype).newbyteorder('>' if msg.is_bigendian else '<'),
        np.frombuffer(msg.data, np.uint8),
        strides=(msg.step, layout.channels * item_size, item_size)[:2 + (layout.channels > 1)])
    return pixels.astype(layout.dtype, copy=False)


def _luma_rows(msg: Image, layout: _Layout) -> int:
    """
    Return the rows of the first plane.

    Drivers disagree whether `height` counts the chroma rows below the picture; the amount of data
    tells.
    """
    rows = msg.height / layout.planes
    if layout.planes > 1 and len(msg.data) == msg.step * msg.height and rows.is_integer():
        return int(rows)
    return msg.height


def _ends_as_jpeg(data: np.ndarray) -> bool:
    """Look for the end marker before the zeros that some cameras pad their buffers with."""
    return data.tobytes().rstrip(b'\0').endswith(b'\xff\xd9')


def _is_bigendian(dtype: np.dtype) -> bool:
    return dtype == dtype.newbyteorder('>') and dtype.itemsize > 1
