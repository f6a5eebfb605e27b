"""Networks in ONNX files as encoders: what is read off the file, and what OpenCV makes of it."""

import cv2
import numpy as np
import pytest

from dlsc_qbs_ros.baselines.onnx import IMAGENET_DEVIATION, IMAGENET_MEAN, OnnxEncoder
from dlsc_qbs_ros.baselines.onnx_file import input_shape
from dlsc_qbs_ros.baselines.onnx_graph import OnnxChain, train_extra
from dlsc_qbs_ros.errors import ImageError, ModelError

ROWS, COLUMNS = 6, 8


def picture(seed=0, rows=ROWS, columns=COLUMNS):
    return np.random.default_rng(seed).integers(0, 256, (rows, columns), dtype=np.uint8)


# A protobuf written by hand: (field number, number or bytes or nested fields).

def field(number, content):
    if isinstance(content, int):
        return varint(number << 3) + varint(content)
    if isinstance(content, list):
        content = b''.join(field(*part) for part in content)
    return varint(number << 3 | 2) + varint(len(content)) + content


def varint(value):
    low, rest = value & 0x7f, value >> 7
    return bytes([low | 0x80]) + varint(rest) if rest else bytes([low])


def tensor(name, *dims):
    """Return the fields of a ValueInfoProto; a word in place of a size leaves it open."""
    shape = [(1, [(1, dim) if isinstance(dim, int) else (2, dim)]) for dim in dims]
    return [(1, name), (2, [(1, [(1, 1), (2, shape)])])]


def model(*graph):
    return field(1, 8) + field(7, list(graph))


OUTPUT = 12, tensor(b'code', 1, 4)


class TestInputShape:
    """What the file says, without the onnx package."""

    def test_the_shape_is_that_of_the_only_input(self):
        assert input_shape(model((11, tensor(b'image', 1, 3, 192, 256)), OUTPUT)) == (
            1, 3, 192, 256)

    def test_an_open_size_is_0(self):
        graph = (11, tensor(b'image', b'batch', 1, 48, 2 ** 64 - 1))
        assert input_shape(model(graph, OUTPUT)) == (0, 1, 48, 0)

    def test_weights_among_the_inputs_are_no_input(self):
        """As the format asked for up to its version 3."""
        weights = 5, [(1, 4), (8, b'w'), (9, b'\0' * 300)]
        shape = input_shape(model(weights, (11, tensor(b'w', 4)), (11, tensor(b'x', 1, 2)),
                                  OUTPUT))
        assert shape == (1, 2)

    def test_weights_in_another_file_are_refused(self):
        weights = 5, [(1, 4), (8, b'w'), (13, [(1, b'location'), (2, b'w.data')]), (14, 1)]
        with pytest.raises(ValueError, match='weights lie in another file'):
            input_shape(model(weights, (11, tensor(b'x', 1, 2)), OUTPUT))

    def test_other_fields_of_every_kind_are_passed_over(self):
        other = (varint(20 << 3 | 1) + b'8 bytes.' + varint(21 << 3 | 5) + b'4...'
                 + field(7000, 2 ** 60) + field(22, b'text'))
        graph = model((11, tensor(b'x', 1, 2)), OUTPUT)
        assert input_shape(other + graph + other) == (1, 2)

    @pytest.mark.parametrize('inputs, outputs', [(0, 1), (2, 1), (1, 0), (1, 2)])
    def test_more_or_fewer_than_one_input_and_one_output_are_refused(self, inputs, outputs):
        graph = [(11, tensor(b'x%d' % k, 1, 2)) for k in range(inputs)] + [OUTPUT] * outputs
        with pytest.raises(ValueError, match=f'one input and one output, found {inputs} and '
                                             f'{outputs}'):
            input_shape(model(*graph))

    def test_a_file_that_ends_anywhere_is_refused_or_reads_as_before(self):
        whole = model((11, tensor(b'image', 1, 3, 192, 256)), OUTPUT)
        for end in range(len(whole)):
            with pytest.raises(ValueError, match='ends|missing'):
                input_shape(whole[:end])

    def test_no_bytes_lead_to_anything_but_a_refusal(self):
        rng = np.random.default_rng(0)
        whole = np.frombuffer(model((11, tensor(b'image', 1, 3, 192, 256)), OUTPUT), np.uint8)
        for _ in range(2000):
            broken = whole.copy()
            broken[rng.integers(0, len(whole), 3)] = rng.integers(0, 256, 3)
            try:
                assert isinstance(input_shape(broken.tobytes()), tuple)
            except ValueError:
                pass


# What OpenCV makes of a file; networks are written with the onnx package.

def write(path, shape, *layers):
    """Write a chain of (layer name, *arguments)."""
    pytest.importorskip('onnx', reason='the extra [train] is not installed')
    chain = OnnxChain(shape)
    for name, *arguments in layers:
        getattr(chain, name)(*arguments)
    chain.save(path)
    return path


def identity(n_channels):
    weight = np.eye(n_channels, dtype=np.float32)[:, :, None, None]
    return 'conv', weight, np.zeros(n_channels, np.float32), 1, 0


def test_one_channel_is_the_image_between_0_and_1(tmp_path):
    encoder = OnnxEncoder(write(tmp_path / 'x.onnx', (1, ROWS, COLUMNS), identity(1)))
    np.testing.assert_allclose(
        encoder.describe(picture()), picture().ravel() / 255, atol=1e-6)


def test_three_channels_are_each_normalised_as_imagenet_s(tmp_path):
    encoder = OnnxEncoder(write(tmp_path / 'x.onnx', (3, ROWS, COLUMNS), identity(3)))
    red, green, blue = encoder.describe(picture()).reshape(3, ROWS, COLUMNS)
    grey = picture() / 255
    np.testing.assert_allclose(red, (grey - 0.485) / 0.229, atol=1e-5)
    np.testing.assert_allclose(green, (grey - 0.456) / 0.224, atol=1e-5)
    np.testing.assert_allclose(blue, (grey - 0.406) / 0.225, atol=1e-5)
    assert IMAGENET_MEAN.shape == IMAGENET_DEVIATION.shape == (3, 1, 1)


def test_an_image_of_another_size_is_brought_to_that_of_the_network(tmp_path):
    encoder = OnnxEncoder(write(tmp_path / 'x.onnx', (1, ROWS, COLUMNS), identity(1)))
    large = picture().repeat(30, axis=0).repeat(40, axis=1)
    np.testing.assert_allclose(encoder.describe(large), picture().ravel() / 255, atol=1e-6)


def test_descriptors_do_not_change_with_the_next_image(tmp_path):
    encoder = OnnxEncoder(write(tmp_path / 'x.onnx', (1, ROWS, COLUMNS), identity(1)))
    first = encoder.describe(picture(0))
    kept = first.copy()
    encoder.describe(picture(1))
    np.testing.assert_array_equal(first, kept)


def test_layers_of_a_chain_do_what_they_say(tmp_path):
    """Against the same in plain numpy: correlation, max(x, 0), blocks, a matrix."""
    rng = np.random.default_rng(0)
    kernel, bias = rng.normal(size=(2, 1, 4, 4)), rng.normal(size=2)
    matrix, offset = rng.normal(size=(5, 2)), rng.normal(size=5)
    encoder = OnnxEncoder(write(
        tmp_path / 'x.onnx', (1, 8, 16), ('conv', kernel, bias, 2, 1), ('relu',),
        ('max_pool', 2), ('mean_pool', 2, 4), ('dense', matrix, offset)))
    grey = picture(0, 8, 16)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(grey / 255, 1), (4, 4))[::2, ::2]
    maps = np.maximum(np.einsum('yxij,cij->cyx', windows, kernel[:, 0])
                      + bias[:, None, None], 0)
    assert maps.shape == (2, 4, 8)
    maxima = maps.reshape(2, 2, 2, 4, 2).max(axis=(2, 4))
    expected = matrix @ maxima.mean(axis=(1, 2)) + offset
    np.testing.assert_allclose(encoder.describe(grey), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize('shape', [
    (2, 8, 8), (4, 8, 8), (3, 2, 8), (1, 8, 5000), (8,)])
def test_a_network_that_takes_no_such_image_is_refused_with_what_it_takes(tmp_path, shape):
    path = tmp_path / 'other.onnx'
    path.write_bytes(model((11, tensor(b'x', 1, *shape)), OUTPUT))
    with pytest.raises(ModelError, match=r'other.onnx: takes an input of shape \(1, .*expected '
                                         r'one image, \(1, 1 or 3 channels, rows, columns\)'):
        OnnxEncoder(path)


@pytest.mark.parametrize('dims', [(1, 3, b'rows', b'columns'), (2, 3, 8, 8), (1, b'c', 8, 8)])
def test_an_open_size_of_image_or_a_batch_is_refused(tmp_path, dims):
    path = tmp_path / 'open.onnx'
    path.write_bytes(model((11, tensor(b'x', *dims)), OUTPUT))
    with pytest.raises(ModelError, match='open.onnx: takes an input of shape'):
        OnnxEncoder(path)


def test_a_missing_file_a_folder_and_what_is_no_onnx_file_are_told_apart(tmp_path):
    with pytest.raises(ModelError, match='none.onnx: cannot be read: No such file'):
        OnnxEncoder(tmp_path / 'none.onnx')
    with pytest.raises(ModelError, match='cannot be read: Is a directory'):
        OnnxEncoder(tmp_path)
    (tmp_path / 'text.onnx').write_text('a letter')
    with pytest.raises(ModelError, match='text.onnx: not the ONNX file of an encoder: '):
        OnnxEncoder(tmp_path / 'text.onnx')


def test_what_opencv_cannot_run_is_refused_when_it_is_loaded(tmp_path):
    operator = 1, [(1, b'image'), (2, b'code'), (4, b'NoSuchOperator')]
    path = tmp_path / 'odd.onnx'
    path.write_bytes(field(1, 8) + field(8, [(1, b''), (2, 13)]) + field(7, [
        operator, (2, b'graph'), (11, tensor(b'image', 1, 1, 8, 8)), OUTPUT]))
    with pytest.raises(ModelError, match=f'odd.onnx: OpenCV {cv2.__version__} cannot run it: '):
        OnnxEncoder(path)


def test_what_is_no_grey_image_is_refused(tmp_path):
    encoder = OnnxEncoder(write(tmp_path / 'x.onnx', (1, ROWS, COLUMNS), identity(1)))
    with pytest.raises(ImageError, match='expected a grey uint8 image, got float64'):
        encoder.describe(np.zeros((ROWS, COLUMNS)))


def test_a_chain_that_cannot_be_written_says_where(tmp_path):
    with pytest.raises(ModelError, match='gone/x.onnx: cannot be written: No such file'):
        write(tmp_path / 'gone' / 'x.onnx', (1, ROWS, COLUMNS), identity(1))


def test_a_missing_library_names_the_extra_that_brings_it():
    with pytest.raises(ModelError, match=r"'no_such_library' is missing: install .*\[train\]"):
        train_extra('no_such_library')
