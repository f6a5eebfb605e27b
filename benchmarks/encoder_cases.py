"""The cases of bench_encoder: our encoder in its forms, its floor, the literal form, peers."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any, Callable

import cv2
from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core import kernel
from dlsc_qbs_ros.core.dictionary import DictionaryLearner
from dlsc_qbs_ros.core.sparse_coding import soft_threshold
from dlsc_qbs_ros.core.surprise import SurpriseGate
from dlsc_qbs_ros.core.types import Frame
from dlsc_qbs_ros.pipeline.encoder import Encoded, Encoder
from dlsc_qbs_ros.profiles import load_profile
import numpy as np
from vgg11 import to_blob, vgg11

try:
    from sklearn.decomposition import MiniBatchDictionaryLearning
except ImportError:
    MiniBatchDictionaryLearning = None

ROOT = Path(__file__).parent.parent

# One step on a frame and its input vector s_k, (n_inputs,), float32.
Task = Callable[[Frame, np.ndarray], Any]


def with_view(width: int, height: int, **encoder: int) -> Config:
    """Return the configuration for whole views of this size, with other encoder values."""
    return Config().override({
        'encoder.input': 'image', 'view.width': width, 'view.height': height,
        **{f'encoder.{name}': value for name, value in encoder.items()}})


def profile(name: str) -> Config:
    """Return the configuration of a profile of the package, for whole views."""
    return Config().override({
        **load_profile(ROOT / 'config' / f'{name}.yaml'), 'encoder.input': 'image'})


def variants() -> dict[str, Callable]:
    """Return the ways our step can run here, as the contexts it runs in."""
    if kernel.LIBRARY is None:
        return {'dlsc_qbs': nullcontext}
    return {'dlsc_qbs': kernel.disabled, 'dlsc_qbs_compiled': nullcontext}


def ours(config: Config, variant: Callable) -> Task:
    """Return the encoder as the node runs it: image in, code out."""
    with variant():
        encoder = Encoder(config)

    def process(frame: Frame, _: np.ndarray) -> Encoded:
        with variant():
            return encoder.process(frame)
    return process


def floor(config: Config) -> Task:
    """Return one product of a dictionary and an input vector."""
    shape = config.encoder.n_atoms, config.view.width * config.view.height
    atoms = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    return lambda _, inputs: atoms @ inputs


def literal(config: Config) -> Task:
    """Return Algorithm 1 as printed, N_d = 1: the dictionary is read at every iteration."""
    options = config.encoder
    atoms = DictionaryLearner(config.view.width * config.view.height, options).atoms_.copy()
    code = np.zeros(options.n_atoms, np.float32)
    gate = SurpriseGate(options.gate_window)

    def step(_: Frame, inputs: np.ndarray) -> np.ndarray:
        nonlocal atoms, code
        for _ in range(options.n_coding):
            gradient = atoms @ (code @ atoms - inputs)
            code = soft_threshold(
                code - options.eta_c * gradient, options.eta_c * options.lambda_1)
        residual = code @ atoms - inputs
        if gate.is_open:
            atoms -= np.outer(options.eta_d * code, residual)
        gate.observe(float(residual @ residual))
        return code
    return step


def peers(config: Config) -> dict[str, Task]:
    """Return other encoders of the same frames; scikit-learn's only where it is installed."""
    orb, network = cv2.ORB_create(500), vgg11()

    def forward(frame: Frame, _: np.ndarray) -> np.ndarray:
        network.setInput(to_blob(frame.grey))
        return network.forward()

    tasks = {'orb': lambda frame, _: orb.detectAndCompute(frame.grey, None),
             'vgg11_forward': forward}
    if MiniBatchDictionaryLearning is not None:
        learner = MiniBatchDictionaryLearning(
            config.encoder.n_atoms, alpha=config.encoder.lambda_1, batch_size=1, random_state=0)
        tasks['sklearn_partial_fit'] = lambda _, inputs: learner.partial_fit(inputs[None])
    return tasks


def all_tasks(config: Config) -> dict[str, Task]:
    """Return the floor, our encoder and its profiles, the literal form and the peers."""
    profiles = {'43x32': with_view(43, 32), '87x65': with_view(87, 65), 'patches': Config(),
                'small_board': profile('small_board'), 'paper': profile('paper')}
    tasks = {'floor': floor(config)}
    for name, variant in variants().items():
        tasks[name] = ours(config, variant)
        tasks.update({f'{name}_{other}': ours(settings, variant)
                      for other, settings in profiles.items()})
    return {**tasks, 'literal': literal(config), **peers(config)}
