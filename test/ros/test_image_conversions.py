"""Every encoding of a drone camera becomes the grey image it shows; all else is refused."""

from array import array

import cv2
from dlsc_qbs_ros.errors import ImageError
from dlsc_qbs_ros.ros.image_conversions import (
    compressed_to_grey, frame_from_msg, image_to_grey, image_to_msg)
import numpy as np
import pytest
from sensor_msgs.msg import CompressedImage, Image

RGB = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
LUMA = RGB @ np.array([0.299, 0.587, 0.114])  # ITU-R BT.601
GREY = np.random.default_rng(1).integers(0, 256, (6, 8), dtype=np.uint8)
OPAQUE = np.full((6, 8, 1), 255, np.uint8)


def message(pixels, encoding):
    return image_to_msg(7, pixels, encoding, 'camera')


def data_of(values):
    return array('B', bytes(values))


def padded(msg, padding):
    """Return the message with rows that are longer than their pixels, filled with rubbish."""
    rows = np.frombuffer(msg.data, np.uint8).reshape(-1, msg.step)
    rubbish = np.full((len(rows), padding), 0xA5, np.uint8)
    msg.data = data_of(np.hstack([rows, rubbish]).tobytes())
    msg.step += padding
    return msg


def big_endian(msg):
    msg.data = data_of(np.frombuffer(msg.data, np.uint16).byteswap().tobytes())
    msg.is_bigendian = 1 - msg.is_bigendian
    return msg


COLOUR = {
    'rgb8': RGB,
    'bgr8': RGB[:, :, ::-1],
    '8UC3': RGB[:, :, ::-1],
    'rgba8': np.dstack([RGB, OPAQUE]),
    'bgra8': np.dstack([RGB[:, :, ::-1], OPAQUE]),
    '8UC4': np.dstack([RGB[:, :, ::-1], OPAQUE]),
    'rgb16': RGB.astype(np.uint16) * 257,
    'bgr16': RGB[:, :, ::-1].astype(np.uint16) * 257,
    '16UC3': RGB[:, :, ::-1].astype(np.uint16) * 257,
}


@pytest.mark.parametrize('encoding', COLOUR)
def test_colour_becomes_its_luma(encoding):
    assert image_to_grey(message(COLOUR[encoding], encoding)) == pytest.approx(LUMA, abs=1)


@pytest.mark.parametrize('encoding', ['mono8', '8UC1'])
def test_grey_stays_as_it_is(encoding):
    grey = image_to_grey(message(GREY, encoding))
    assert grey.dtype == np.uint8
    np.testing.assert_array_equal(grey, GREY)


@pytest.mark.parametrize('encoding', ['mono16', '16UC1'])
def test_sixteen_bits_are_scaled_from_their_full_range(encoding):
    deep = np.array([[0, 257, 32768, 65535]], np.uint16)
    np.testing.assert_array_equal(image_to_grey(message(deep, encoding)), [[0, 1, 128, 255]])


@pytest.mark.parametrize('encoding', ['mono16', 'rgb16', 'bayer_rggb16'])
def test_the_byte_order_is_honoured(encoding):
    shape = (6, 8, 3) if encoding == 'rgb16' else (6, 8)
    deep = np.random.default_rng(2).integers(0, 65536, shape, dtype=np.uint16)
    np.testing.assert_array_equal(
        image_to_grey(big_endian(message(deep, encoding))),
        image_to_grey(message(deep, encoding)))


@pytest.mark.parametrize('depth', [8, 16])
@pytest.mark.parametrize('pattern', ['rggb', 'bggr', 'gbrg', 'grbg'])
def test_a_bayer_mosaic_of_one_colour_becomes_its_luma(pattern, depth):
    colour = {'r': 200, 'g': 100, 'b': 20}
    tile = np.array([colour[letter] for letter in pattern]).reshape(2, 2)
    mosaic = np.tile(tile, (3, 4)).astype(np.uint8)
    if depth == 16:
        mosaic = mosaic.astype(np.uint16) * 257
    grey = image_to_grey(message(mosaic, f'bayer_{pattern}{depth}'))
    assert grey == pytest.approx(np.full((6, 8), 0.299 * 200 + 0.587 * 100 + 0.114 * 20), abs=1)


@pytest.mark.parametrize('encoding, luma_byte', [
    ('yuv422', 1), ('uyvy', 1), ('yuv422_yuy2', 0), ('yuyv', 0)])
def test_of_yuv422_the_luma_is_taken(encoding, luma_byte):
    pixels = np.full((6, 8, 2), 77, np.uint8)
    pixels[:, :, luma_byte] = GREY
    np.testing.assert_array_equal(image_to_grey(message(pixels, encoding)), GREY)


@pytest.mark.parametrize('chroma_in_height', [True, False])
@pytest.mark.parametrize('encoding, chroma_rows', [('nv12', 3), ('nv21', 3), ('nv24', 12)])
def test_of_planar_yuv_the_luma_is_taken(encoding, chroma_rows, chroma_in_height):
    planes = np.vstack([GREY, np.full((chroma_rows, 8), 77, np.uint8)])
    msg = message(planes, encoding)
    if not chroma_in_height:
        msg.height = 6
    np.testing.assert_array_equal(image_to_grey(msg), GREY)


@pytest.mark.parametrize('encoding', [*COLOUR, 'mono8', 'yuyv', 'nv12', 'bayer_grbg8'])
def test_row_padding_is_no_part_of_the_image(encoding):
    pixels = COLOUR.get(encoding, GREY)
    if encoding == 'yuyv':
        pixels = np.dstack([GREY, GREY])
    np.testing.assert_array_equal(
        image_to_grey(padded(message(pixels, encoding), 6)),
        image_to_grey(message(pixels, encoding)))


def test_the_last_row_needs_no_padding():
    msg = padded(message(GREY, 'mono8'), 4)
    msg.data = msg.data[:-4]
    np.testing.assert_array_equal(image_to_grey(msg), GREY)


def test_the_frame_has_the_stamp_of_the_image():
    frame = frame_from_msg(message(GREY, 'mono8'))
    assert frame.stamp_ns == 7
    np.testing.assert_array_equal(frame.grey, GREY)


@pytest.mark.parametrize('field, value, error', [
    ('encoding', 'jpeg2000', "encoding 'jpeg2000': expected one of .*mono8"),
    ('encoding', '', "encoding ''"),
    ('width', 0, r'width 0: expected a value in \[1, 16384\]'),
    ('height', 0, r'height 0: expected'),
    ('width', 2**32 - 1, 'width 4294967295: expected'),
    ('height', 2**31, 'height 2147483648: expected'),
    ('step', 23, 'step 23: expected at least 24 bytes, 8 pixels of rgb8'),
    ('step', 2**32 - 1, '144 bytes of data: expected at least'),
    ('height', 7, '144 bytes of data: expected at least 168, 7 rows of 24 bytes'),
    ('data', array('B'), '0 bytes of data'),
    ('data', array('B', bytes(143)), '143 bytes of data: expected at least 144'),
])
def test_a_malformed_image_is_refused(field, value, error):
    msg = message(RGB, 'rgb8')
    setattr(msg, field, value)
    with pytest.raises(ImageError, match=error):
        image_to_grey(msg)


@pytest.mark.parametrize('encoding', ['nv12', 'nv24'])
def test_planar_yuv_without_its_chroma_is_refused(encoding):
    msg = message(np.zeros((8, 8), np.uint8), encoding)
    with pytest.raises(ImageError, match='64 bytes of data: expected at least'):
        image_to_grey(msg)


def compressed(pixels, extension):
    _, data = cv2.imencode(extension, pixels)
    return CompressedImage(format=extension[1:], data=data_of(data.tobytes()))


@pytest.mark.parametrize('pixels, luma', [(GREY, GREY), (RGB[:, :, ::-1], LUMA)])
def test_a_png_is_decoded_as_its_raw_image(pixels, luma):
    # OpenCV makes files from blue, green and red.
    assert compressed_to_grey(compressed(pixels, '.png')) == pytest.approx(luma, abs=1)


def test_a_jpeg_is_decoded_up_to_its_own_loss():
    smooth = np.add.outer(np.arange(64), np.arange(80)).astype(np.uint8)
    assert compressed_to_grey(compressed(smooth, '.jpg')) == pytest.approx(smooth, abs=4)


def test_zeros_after_a_jpeg_are_no_harm():
    msg = compressed(GREY, '.jpg')
    expected = compressed_to_grey(msg)
    msg.data = msg.data + data_of(100)
    np.testing.assert_array_equal(compressed_to_grey(msg), expected)


@pytest.mark.parametrize('extension', ['.jpg', '.png'])
@pytest.mark.parametrize('share', [0.0, 0.1, 0.5, 0.95])
def test_a_truncated_compressed_image_is_refused(extension, share):
    noise = np.random.default_rng(3).integers(0, 256, (64, 80), dtype=np.uint8)
    msg = compressed(noise, extension)
    msg.data = msg.data[:int(share * len(msg.data))]
    with pytest.raises(ImageError, match=f'compressed image of {len(msg.data)} bytes'):
        compressed_to_grey(msg)


def test_rubbish_is_refused():
    with pytest.raises(ImageError, match="format 'jpeg', cannot be decoded"):
        compressed_to_grey(CompressedImage(format='jpeg', data=data_of(b'no image at all')))


@pytest.mark.parametrize('pixels, encoding, step', [
    (GREY, 'mono8', 8), (RGB, 'rgb8', 24), (GREY.astype(np.uint16), 'mono16', 16),
    (RGB[:, ::2], 'rgb8', 12), (GREY.astype(np.float32), '32FC1', 32)])
def test_a_message_holds_the_pixels_row_after_row(pixels, encoding, step):
    msg = message(pixels, encoding)
    assert isinstance(msg, Image)
    assert (msg.height, msg.width, msg.step) == (*pixels.shape[:2], step)
    assert (msg.encoding, msg.header.frame_id, msg.header.stamp.nanosec) == (encoding, 'camera', 7)
    assert bytes(msg.data) == pixels.tobytes()
