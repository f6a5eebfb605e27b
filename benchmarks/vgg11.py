"""
VGG-11's convolutions with random weights, as an OpenCV network.

OpenCV reads ONNX, a protobuf of a few fields, so the model is written here rather than with a
package that nothing else needs. VGG-11's three fully connected layers are left out: they hold
93 % of its parameters, but do under 2 % of its work.
"""

from __future__ import annotations

import cv2
import numpy as np

SIZE = 224
# Output channels of the 3x3 convolutions (configuration A); 0 is a 2x2 max-pooling.
LAYERS = (64, 0, 128, 0, 256, 256, 0, 512, 512, 0, 512, 512, 0)

FLOAT = 1  # TensorProto.DataType
INTS = 7  # AttributeProto.AttributeType


def varint(number: int) -> bytes:
    """Return a non-negative integer, seven bits to a byte, the lowest first."""
    low, rest = number & 127, number >> 7
    return bytes([low | 128]) + varint(rest) if rest else bytes([low])


def field(number: int, value: int | str | bytes) -> bytes:
    """Return one protobuf field: a varint, or anything that has a length."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    content = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(content)) + content


def node(operator: str, inputs: tuple[str, ...], output: str, **attributes) -> bytes:
    """Return a NodeProto, as a field of its graph; the attributes are lists of integers."""
    content = b''.join(field(1, name) for name in inputs)
    content += field(2, output) + field(4, operator)
    for name, values in attributes.items():
        integers = b''.join(field(8, value) for value in values)
        content += field(5, field(1, name) + integers + field(20, INTS))
    return field(1, content)


def tensor(name: str, values: np.ndarray) -> bytes:
    """Return a float32 TensorProto, as an initializer of its graph."""
    dimensions = b''.join(field(1, length) for length in values.shape)
    return field(5, dimensions + field(2, FLOAT) + field(8, name) + field(9, values.tobytes()))


def value_info(name: str, shape: tuple[int, ...]) -> bytes:
    """Return a ValueInfoProto: the type and shape of an input or output."""
    dimensions = b''.join(field(1, field(1, length)) for length in shape)
    return field(1, name) + field(2, field(1, field(1, FLOAT) + field(2, dimensions)))


def model() -> bytes:
    """Return the network as ONNX: `input` (1, 3, SIZE, SIZE) to (1, 512, SIZE/32, SIZE/32)."""
    rng = np.random.default_rng(0)
    graph, previous, depth, size = field(2, 'vgg11'), 'input', 3, SIZE
    for i, channels in enumerate(LAYERS):
        if channels:
            weights = rng.normal(0.0, np.sqrt(2 / (9 * depth)), (channels, depth, 3, 3))
            graph += tensor(f'weights{i}', weights.astype(np.float32))
            graph += tensor(f'bias{i}', np.zeros(channels, np.float32))
            graph += node('Conv', (previous, f'weights{i}', f'bias{i}'), f'conv{i}',
                          kernel_shape=(3, 3), pads=(1, 1, 1, 1))
            graph += node('Relu', (f'conv{i}',), f'layer{i}')
            depth = channels
        else:
            graph += node('MaxPool', (previous,), f'layer{i}',
                          kernel_shape=(2, 2), strides=(2, 2))
            size //= 2
        previous = f'layer{i}'
    graph += field(11, value_info('input', (1, 3, SIZE, SIZE)))
    graph += field(12, value_info(previous, (1, depth, size, size)))
    opset = field(1, '') + field(2, 13)
    return field(1, 8) + field(7, graph) + field(8, opset)  # 8: the version of the format


def vgg11() -> cv2.dnn.Net:
    """Return the network, ready to run."""
    return cv2.dnn.readNetFromONNX(np.frombuffer(model(), np.uint8))


def to_blob(grey: np.ndarray) -> np.ndarray:
    """Return a grey uint8 image as the network's input (1, 3, SIZE, SIZE), float32."""
    rgb = cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)
    return cv2.dnn.blobFromImage(rgb, 1 / 255, (SIZE, SIZE))
