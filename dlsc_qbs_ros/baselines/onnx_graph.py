"""Write a plain chain of layers as an ONNX file."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Sequence

import numpy as np

from ..errors import ModelError

# The oldest that can say what is needed here: OpenCV 4.6 reads it.
OPSET, IR_VERSION = 13, 7


def train_extra(name: str) -> ModuleType:
    """Import a library of the extra [train], or say that it is missing."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ModelError(
            f'the Python package {name!r} is missing: install the extra [train]') from error


class OnnxChain:
    """
    A network in which each layer takes what the one before it gives.

    Parameters
    ----------
    shape : sequence of int
        Of the image that it takes: channels, rows, columns.

    """

    def __init__(self, shape: Sequence[int]):
        self._onnx = train_extra('onnx')
        self._shape = (1, *shape)
        self._nodes: list = []
        self._weights: list = []
        self._last = 'image'

    def conv(self, weight: np.ndarray, bias: np.ndarray, stride: int = 1, padding: int = 1
             ) -> None:
        """Add a convolution; `weight` is (channels out, channels in, rows, columns)."""
        self._add('Conv', weight, bias, strides=[stride] * 2, pads=[padding] * 4,
                  kernel_shape=weight.shape[2:])

    def relu(self) -> None:
        """Add max(x, 0)."""
        self._add('Relu')

    def max_pool(self, size: int) -> None:
        """Add the greatest of each block of size x size."""
        self._add('MaxPool', kernel_shape=[size] * 2, strides=[size] * 2)

    def mean_pool(self, rows: int, columns: int) -> None:
        """Add the mean of each block of rows x columns."""
        self._add('AveragePool', kernel_shape=[rows, columns], strides=[rows, columns])

    def dense(self, weight: np.ndarray, bias: np.ndarray) -> None:
        """Add a fully connected layer to all that is there; `weight` is (out, in)."""
        self._add('Flatten')
        self._add('Gemm', weight, bias, transB=1)

    def save(self, path: Path) -> None:
        """
        Write the file.

        Raises
        ------
        ModelError
            When it cannot be written.

        """
        helper, float32 = self._onnx.helper, self._onnx.TensorProto.FLOAT
        graph = helper.make_graph(
            self._nodes, 'encoder',
            [helper.make_tensor_value_info('image', float32, self._shape)],
            [helper.make_tensor_value_info(self._last, float32, None)], self._weights)
        model = helper.make_model(graph, ir_version=IR_VERSION,
                                  opset_imports=[helper.make_opsetid('', OPSET)])
        # Layers that do not fit each other are found here, not in flight.
        model = self._onnx.shape_inference.infer_shapes(model, strict_mode=True, data_prop=True)
        try:
            path.write_bytes(model.SerializeToString())
        except OSError as error:
            raise ModelError(f'{path}: cannot be written: {error.strerror}') from error

    def _add(self, operator: str, *weights: np.ndarray, **attributes) -> None:
        name = f'{operator.lower()}_{len(self._nodes)}'
        inputs = [self._last]
        for kind, values in zip(('weight', 'bias'), weights):
            inputs.append(f'{name}_{kind}')
            self._weights.append(self._onnx.numpy_helper.from_array(
                np.ascontiguousarray(values, np.float32), inputs[-1]))
        self._nodes.append(self._onnx.helper.make_node(
            operator, inputs, [name], name, **attributes))
        self._last = name
