"""
VGG-11 (Simonyan and Zisserman, 2014), from the weights that torchvision publishes, to ONNX.

What classifies is left out: the descriptor is the output of the convolutional layers, the mean
over each quarter of the image. A whole mean would forget where things are, every cell by itself
would know it too exactly.
"""

from __future__ import annotations

from pathlib import Path
import pickle
import re
from typing import Any, Mapping

import numpy as np

from .onnx_graph import OnnxChain, train_extra
from ..errors import ModelError

# Channels of the 3x3 convolutions; after each group, the image is halved.
GROUPS = ((64,), (128,), (256, 256), (512, 512), (512, 512))
# Near the 224x224 of the training, in the shape of a camera's image: 6x8 cells at the end.
ROWS, COLUMNS = 192, 256
QUARTER = ROWS // 2 ** len(GROUPS) // 2, COLUMNS // 2 ** len(GROUPS) // 2
BATCH_NORM_EPSILON = 1e-5


def convert(weights: Path, out: Path) -> None:
    """
    Write VGG-11's convolutional layers as an ONNX file that `OnnxEncoder` takes.

    Parameters
    ----------
    weights : Path
        The state dictionary of torchvision's vgg11 or vgg11_bn (`vgg11-*.pth`).
    out : Path
        The ONNX file: image (1, 3, 192, 256) in, (1, 512, 2, 2) out.

    Raises
    ------
    ModelError
        When the file is missing or holds something else, or the other cannot be written.

    """
    layers = _convolutions(weights, _state(weights))
    chain = OnnxChain((3, ROWS, COLUMNS))
    for group in GROUPS:
        for _ in group:
            chain.conv(*next(layers))
            chain.relu()
        chain.max_pool(2)
    chain.mean_pool(*QUARTER)
    chain.save(out)


def _state(path: Path) -> Mapping[str, Any]:
    torch = train_extra('torch')
    try:
        state = torch.load(path, map_location='cpu', weights_only=True)
    except OSError as error:
        raise ModelError(f'{path}: cannot be read: {error.strerror}') from error
    except (RuntimeError, EOFError, ValueError, pickle.UnpicklingError) as error:
        raise ModelError(f'{path}: not a file of weights that PyTorch reads safely') from error
    if not isinstance(state, Mapping):
        raise ModelError(f'{path}: expected a state dictionary, found {type(state).__name__}')
    return {name: tensor.numpy() for name, tensor in state.items() if torch.is_tensor(tensor)}


def _convolutions(path: Path, state: Mapping[str, np.ndarray]):
    """Return the weights and biases of the convolutions, in order."""
    places = sorted(
        int(match[1]) for name, values in state.items()
        if (match := re.fullmatch(r'features\.(\d+)\.weight', name)) and values.ndim == 4)
    found = [state[f'features.{place}.weight'].shape for place in places]
    channels = [3, *(count for group in GROUPS for count in group)]
    wanted = [(after, before, 3, 3) for before, after in zip(channels, channels[1:])]
    if found != wanted:
        raise ModelError(f'{path}: not the weights of VGG-11: expected convolutions {wanted}, '
                         f'found {found}')
    try:
        return iter([_convolution(state, place) for place in places])
    except KeyError as error:
        raise ModelError(f'{path}: not the weights of VGG-11: {error} is missing') from error


def _convolution(state: Mapping[str, np.ndarray], place: int) -> tuple[np.ndarray, np.ndarray]:
    """Return weight and bias; a batch normalisation that follows is a scale and a shift of it."""
    weight, bias = state[f'features.{place}.weight'], state[f'features.{place}.bias']
    after = f'features.{place + 1}'
    if f'{after}.running_mean' not in state:
        return weight, bias
    scale = state[f'{after}.weight'] / np.sqrt(
        state[f'{after}.running_var'] + BATCH_NORM_EPSILON)
    return (weight * scale[:, None, None, None],
            (bias - state[f'{after}.running_mean']) * scale + state[f'{after}.bias'])
