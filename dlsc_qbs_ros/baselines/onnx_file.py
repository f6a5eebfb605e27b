"""The input of a network, as its ONNX file states it; read without the onnx package."""

from __future__ import annotations

from typing import Iterator

# Field numbers of onnx.proto3, by message.
MODEL_GRAPH = 7
GRAPH_INITIALIZER, GRAPH_INPUT, GRAPH_OUTPUT = 5, 11, 12
TENSOR_NAME, TENSOR_EXTERNAL_DATA = 8, 13
VALUE_NAME, VALUE_TYPE = 1, 2
TYPE_TENSOR, TENSOR_SHAPE, SHAPE_DIM, DIM_VALUE = 1, 2, 1, 1

# How a field is written: a number of any length, eight bytes, a count and as many bytes, four.
VARINT, FIXED_64, BYTES, FIXED_32 = 0, 1, 2, 5


def input_shape(model: bytes) -> tuple[int, ...]:
    """
    Return the shape that a network of one input and one output takes.

    Parameters
    ----------
    model : bytes
        The content of an ONNX file.

    Returns
    -------
    tuple of int
        0 stands for a size that the file leaves open.

    Raises
    ------
    ValueError
        When that is no ONNX file, does not hold its weights, or is of a network with more inputs
        or outputs.

    """
    graph = _message(memoryview(model), MODEL_GRAPH)
    tensors = _messages(graph, GRAPH_INITIALIZER)
    if any(_messages(tensor, TENSOR_EXTERNAL_DATA) for tensor in tensors):
        # OpenCV 4.6 does not refuse that: it ends the process.
        raise ValueError('its weights lie in another file; export it as a single one')
    # Up to version 3 of the format, weights are listed among the inputs.
    weights = {_message(tensor, TENSOR_NAME) for tensor in tensors}
    inputs = [value for value in _messages(graph, GRAPH_INPUT)
              if _message(value, VALUE_NAME) not in weights]
    n_outputs = len(_messages(graph, GRAPH_OUTPUT))
    if (len(inputs), n_outputs) != (1, 1):
        raise ValueError(
            f'expected one input and one output, found {len(inputs)} and {n_outputs}')
    tensor = _message(_message(inputs[0], VALUE_TYPE), TYPE_TENSOR)
    return tuple(map(_size, _messages(_message(tensor, TENSOR_SHAPE), SHAPE_DIM)))


def _size(dim: memoryview) -> int:
    for number, value in _fields(dim):
        if number == DIM_VALUE and isinstance(value, int) and value < 2 ** 63:  # else negative
            return value
    return 0


def _message(message: memoryview, number: int) -> memoryview:
    found = _messages(message, number)
    if not found:
        raise ValueError(f'field {number} is missing')
    return found[0]


def _messages(message: memoryview, number: int) -> list[memoryview]:
    return [value for name, value in _fields(message)
            if name == number and isinstance(value, memoryview)]


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Yield the number of each field of a message, and the number or the bytes that it holds."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        kind = key & 7
        if kind == VARINT:
            value, at = _varint(message, at)
            yield key >> 3, value
            continue
        if kind == BYTES:
            size, at = _varint(message, at)
        elif kind in (FIXED_32, FIXED_64):
            size = 4 if kind == FIXED_32 else 8
        else:
            raise ValueError(f'no field of kind {kind} is known')
        if at + size > len(message):
            raise ValueError('it ends within a field')
        yield key >> 3, message[at:at + size]
        at += size


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """Return a number, written seven bits a byte from the lowest on, and the place after it."""
    value = 0
    for place, byte in enumerate(message[at:at + 10]):
        value |= (byte & 0x7f) << 7 * place
        if byte < 0x80:
            return value, at + place + 1
    raise ValueError('it ends within a number')
