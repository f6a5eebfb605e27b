"""Algorithm 1 over a whole sequence with nothing to protect it, and the replay afterwards."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Collection, Iterable

import numpy as np

from .stamps import StampOrder, Succession
from ..config import Config, ViewConfig
from ..core.dictionary import DictionaryLearner
from ..core.preprocessing import make_view, PixelInput
from ..core.surprise import SurpriseGate
from ..core.types import Frame
from ..errors import ImageError


@dataclass(frozen=True)
class Learning:
    """
    What became of a dictionary along a sequence of n frames.

    A run ends with the first frame whose error is not finite; from there on errors are NaN,
    nothing is learned and nothing is stable.

    Attributes
    ----------
    errors : ndarray of shape (n,), float64
        The reprojection errors e_k, each before that frame was learned from.
    learned : ndarray of shape (n,), bool
        Whether the frame was learned from.
    stable : ndarray of shape (n,), bool
        Whether eta_c < 2 / lambda_max(G) after the frame.
    atoms : ndarray of shape (n_atoms, n_inputs), float32
        The dictionary at the end.

    """

    errors: np.ndarray
    learned: np.ndarray
    stable: np.ndarray
    atoms: np.ndarray


def views_of(frames: Iterable[Frame], config: ViewConfig, refused: Counter[str]
             ) -> list[np.ndarray]:
    """Return the views of frames in their order; refuse and count what an encoder refuses."""
    order = StampOrder()
    views = []
    for frame in frames:
        try:
            view = make_view(frame.grey, config)
        except ImageError:
            refused['frames'] += 1
            continue
        if order.take(frame.stamp_ns) is Succession.LATE:
            refused['frames'] += 1
        else:
            views.append(view)
    return views


def learn(views: Collection[np.ndarray], config: Config,
          schedule: np.ndarray | None = None) -> Learning:
    """
    Learn continually from views in their order (Algorithm 1), whatever comes of it.

    Parameters
    ----------
    views : collection of n ndarrays of shape (config.view.height, config.view.width), uint8
        The sequence in its natural order.
    config : Config
        View and encoder; `encoder.gate` is not asked.
    schedule : ndarray of shape (n,), bool, optional
        The frames to learn from; left out, the Quadratic Bayesian Surprise decides.

    Returns
    -------
    Learning

    """
    learner = DictionaryLearner(config.view.width * config.view.height, config.encoder)
    gate = SurpriseGate(config.encoder.gate_window)
    errors = np.full(len(views), np.nan)
    learned, stable = np.zeros((2, len(views)), bool)
    with np.errstate(all='ignore'):  # a dictionary may run away here: that is the experiment
        for k, view in enumerate(views):
            vector = PixelInput(view, config.view.standardise)
            error = learner.infer(vector)
            if not np.isfinite(error):
                break
            errors[k] = error
            learned[k] = gate.is_open if schedule is None else schedule[k]
            if learned[k]:
                learner.learn(vector)
            gate.observe(error)
            stable[k] = learner.is_stable
        return Learning(errors, learned, stable, learner.atoms_)


def replay(views: Collection[np.ndarray], config: Config, atoms: np.ndarray) -> np.ndarray:
    """
    Return the errors e_k, shape (n,), of views under a dictionary that learns no more.

    Codes are Algorithm 1's: `n_coding` iterations a frame, from the code of the frame before and
    from zero at first. Errors are NaN from the first that is not finite.
    """
    learner = DictionaryLearner(atoms.shape[1], config.encoder)
    errors = np.full(len(views), np.nan)
    with np.errstate(all='ignore'):
        learner.restart(atoms)
        for k, view in enumerate(views):
            error = learner.infer(PixelInput(view, config.view.standardise))
            if not np.isfinite(error):
                break
            errors[k] = error
    return errors


def random_schedule(n_frames: int, n_learned: int, seed: int) -> np.ndarray:
    """Return a mask (n_frames,) of `n_learned` frames to learn from, drawn without surprise."""
    schedule = np.zeros(n_frames, bool)
    schedule[np.random.default_rng(seed).choice(n_frames, n_learned, replace=False)] = True
    return schedule
