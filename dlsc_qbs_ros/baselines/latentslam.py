"""
The encoder of LatentSLAM (Catal et al., ICRA 2021): a variational autoencoder, trained offline.

The paper says of it that it is a DNN of 11 layers, trained on 3998 frames of the same place, and
no more. Here six layers encode and five decode; the pixels have a normal distribution around
what is decoded, so that the loss is the negative evidence lower bound, up to a constant:

    L = ||s - s'||^2 / (2 sigma^2) + KL(N(mean, deviation) || N(0, 1))
"""

from __future__ import annotations

from pathlib import Path
from typing import Iterator, NamedTuple

import numpy as np

from .onnx_graph import OnnxChain, train_extra
from ..config import ViewConfig
from ..core.preprocessing import make_view
from ..errors import ConfigError

CHANNELS = (16, 32, 64, 128)
# Both sides of the image are halved once per entry of CHANNELS.
SIDE_STEP = 2 ** len(CHANNELS)
N_LATENT = 64  # as many as the paper's dictionary has atoms
PIXEL_SIGMA = 0.1
BATCH = 64
LEARNING_RATE = 1e-3


class Epoch(NamedTuple):
    """What one epoch left behind: means over the frames, in nats."""

    loss: float
    reconstruction: float
    divergence: float


class Vae:
    """
    The autoencoder for images of one size, on a GPU where there is one.

    Parameters
    ----------
    width, height : int
        Size of the images in pixels, multiples of 16.
    seed : int
        Of weights, order of images and samples. On a CPU, equal seeds give equal networks.

    Raises
    ------
    ConfigError
        When the size is no multiple of 16, or not one of a view.
    ModelError
        Without PyTorch.

    """

    def __init__(self, width: int, height: int, seed: int):
        if width % SIDE_STEP or height % SIDE_STEP:
            raise ConfigError(
                f'size {width}x{height}: expected multiples of {SIDE_STEP} on both sides')
        self._size = ViewConfig(width=width, height=height)
        self._torch = torch = train_extra('torch')
        torch.manual_seed(seed)
        self._device = torch.device('cuda' if torch.cuda.is_available() else 'cpu')
        inner = CHANNELS[-1], height // SIDE_STEP, width // SIDE_STEP
        self._encoder = _encoder(torch.nn, inner).to(self._device)
        self._decoder = _decoder(torch.nn, inner).to(self._device)

    def view(self, grey: np.ndarray) -> np.ndarray:
        """Return an image (rows, columns), uint8, at the size that the network takes."""
        return make_view(grey, self._size)

    def train(self, views: np.ndarray, epochs: int) -> Iterator[Epoch]:
        """Learn from views (n, height, width), uint8; yield the losses of each epoch."""
        torch = self._torch
        pixels = torch.from_numpy(views)[:, None].to(self._device)
        optimiser = torch.optim.Adam(
            [*self._encoder.parameters(), *self._decoder.parameters()], LEARNING_RATE)
        for _ in range(epochs):
            total = np.zeros(2)
            for batch in torch.randperm(len(pixels)).to(self._device).split(BATCH):
                errors = self._errors(pixels[batch] / 255.0)
                optimiser.zero_grad()
                (sum(errors) / len(batch)).backward()
                optimiser.step()
                total += [error.item() for error in errors]
            yield Epoch(total.sum() / len(pixels), *(total / len(pixels)))

    def _errors(self, images):
        """Return the two terms of the loss, summed over a batch (n, 1, rows, columns)."""
        torch = self._torch
        mean, log_variance = self._encoder(images).chunk(2, dim=1)
        sample = mean + torch.exp(log_variance / 2) * torch.randn_like(mean)
        difference = self._decoder(sample) - images
        reconstruction = (difference ** 2).sum() / (2 * PIXEL_SIGMA ** 2)
        divergence = (mean ** 2 + log_variance.exp() - 1 - log_variance).sum() / 2
        return reconstruction, divergence

    def encode(self, views: np.ndarray) -> np.ndarray:
        """Return the means (n, N_LATENT) of the codes of views (n, height, width), uint8."""
        torch = self._torch
        with torch.no_grad():
            pixels = torch.from_numpy(views)[:, None].to(self._device) / 255.0
            return self._encoder(pixels)[:, :N_LATENT].cpu().numpy()

    def save(self, path: Path) -> None:
        """Write what gives the mean of the code as an ONNX file that `OnnxEncoder` takes."""
        nn = self._torch.nn
        chain = OnnxChain((1, self._size.height, self._size.width))
        for layer in self._encoder:
            weights = [values.detach().cpu().numpy() for values in layer.parameters()]
            if isinstance(layer, nn.Conv2d):
                chain.conv(*weights, layer.stride[0], layer.padding[0])
            elif isinstance(layer, nn.ReLU):
                chain.relu()
            elif isinstance(layer, nn.Linear):
                chain.dense(*(values[:N_LATENT] for values in weights))
        chain.save(path)


def _encoder(nn, inner: tuple[int, int, int]):
    """Return five convolutions and one fully connected layer: image to mean, log variance."""
    layers = []
    for before, after in zip((1, *CHANNELS), CHANNELS):
        layers += [nn.Conv2d(before, after, 4, stride=2, padding=1), nn.ReLU()]
    layers += [nn.Conv2d(CHANNELS[-1], CHANNELS[-1], 3, padding=1), nn.ReLU(), nn.Flatten(),
               nn.Linear(int(np.prod(inner)), 2 * N_LATENT)]
    return nn.Sequential(*layers)


def _decoder(nn, inner: tuple[int, int, int]):
    """Return one fully connected layer and four transposed convolutions: code to image."""
    layers = [nn.Linear(N_LATENT, int(np.prod(inner))), nn.Unflatten(1, inner)]
    for before, after in zip(CHANNELS[::-1], (*CHANNELS[-2::-1], 1)):
        layers += [nn.ReLU(), nn.ConvTranspose2d(before, after, 4, stride=2, padding=1)]
    return nn.Sequential(*layers, nn.Sigmoid())
