"""
The package beside the literal Algorithm 1, frame by frame over a whole flight.

Both see the same frames. The literal algorithm decides for itself, but learns when the package
learns: a decision that rounding flips then shows as that, not as two dictionaries that drift
apart. Where the step-size condition eta_c < 2 / lambda_max(G) is broken the comparison ends:
there the coding iteration of the paper expands, and doubles any rounding error within a frame.
"""

from typing import NamedTuple

from algorithm_1 import Literal
import numpy as np

from dlsc_qbs_ros.core.dictionary import DictionaryLearner
from dlsc_qbs_ros.core.preprocessing import PixelInput
from dlsc_qbs_ros.core.surprise import SurpriseGate
from dlsc_qbs_ros.pipeline.encoder import Encoder

# The paper's parameters; its Fig. a and b show the effect of the surprise on the dictionary.
SETS = {
    'SLAM': {'encoder.eta_c': 5e-3, 'encoder.eta_d': 1.4e-3, 'encoder.lambda_1': 0.2},
    'Fig. a': {'encoder.eta_c': 5e-3, 'encoder.eta_d': 2e-3, 'encoder.lambda_1': 0.5},
    'Fig. b': {'encoder.eta_c': 1e-2, 'encoder.eta_d': 4e-3, 'encoder.lambda_1': 0.25},
}


class Difference(NamedTuple):
    """
    How far the package is from the literal algorithm on one frame.

    Codes and dictionaries are compared by their largest difference, relative to the largest
    entry of the literal algorithm's; S_2 in units of the largest reprojection error it was made
    of. The dictionary and eta_c lambda_max(G) cost much to look at: NaN on the frames left out.
    """

    code: float
    dictionary: float
    error: float
    surprise: float
    margin: float  # |S_2| of the literal algorithm: how close its decision is to the other one
    agrees: bool
    learned: bool
    rate: float


def deviation(a, b):
    """Return the largest difference of two arrays relative to the largest entry of b."""
    return np.max(np.abs(a - b)) / np.max(np.abs(b))


def step_size(dictionary, config):
    """Return eta_c lambda_max(G) of an N x M dictionary: coding converges below 2."""
    return config.encoder.eta_c * np.linalg.eigvalsh(dictionary.T @ dictionary)[-1]


def literal_beside(learner, config):
    """Return the literal algorithm from where a learner stands."""
    return Literal(learner.atoms_.T, **{name: getattr(config.encoder, name) for name in (
        'eta_c', 'eta_d', 'lambda_1', 'n_coding', 'n_learning')})


def compared(config, frames, **changes):
    """Return the columns of `differences`."""
    return Difference(*map(np.array, zip(*differences(config, frames, **changes))))


def differences(config, frames, literal_config=None, stride=10):
    """
    Yield a `Difference` for every frame, until learning has run away.

    The encoder, and a learner and gate beside it, are held against the literal algorithm;
    whichever is further off counts. Dictionaries are compared on every `stride`-th frame.
    Giving the literal algorithm another configuration shows that a flaw is found.
    """
    encoder, gate = Encoder(config), SurpriseGate(config.encoder.gate_window)
    learner = DictionaryLearner(config.view.width * config.view.height, config.encoder)
    literal = literal_beside(learner, literal_config or config)
    for k, frame in enumerate(frames):
        margin, decisions = abs(literal.s_2) / literal.largest_error, [gate.is_open]
        decisions.append(literal.s_2 > 0.0)
        result = encoder.process(frame)
        inputs = PixelInput(result.view.pixels, config.view.standardise)
        error = learner.infer(inputs)
        gate.observe(error)
        step = literal.step(np.asarray(inputs), result.learned)
        is_looked_at = k % stride == 0
        yield Difference(
            code=max(deviation(code, step.code)
                     for code in (learner.codes_[0], result.code.values)),
            dictionary=deviation(learner.atoms_.T, step.dictionary) if is_looked_at else np.nan,
            error=max(abs(e / step.error - 1.0) for e in (error, result.reprojection_error)),
            surprise=max(abs(s - literal.s_2) for s in (gate.surprise, result.surprise)
                         ) / literal.largest_error,
            margin=margin, agrees=set(decisions) == {result.learned}, learned=result.learned,
            rate=step_size(step.dictionary, config) if is_looked_at else np.nan)
        if result.learned:
            learner.learn(inputs)
        if not learner.is_stable:
            return
