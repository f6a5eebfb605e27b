"""Frame in, code out: preprocessing, Algorithm 1, the gate and epochs in their order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Protocol

import numpy as np

from .coder import Coder
from .stamps import StampOrder, Succession
from ..config import Config, ViewConfig
from ..core.dictionary import DictionaryLearner
from ..core.inputs import make_inputs
from ..core.patch_dictionary import PatchLearner
from ..core.preprocessing import make_view, PixelInput
from ..core.surprise import SurpriseGate
from ..core.types import Code, Dictionary, Frame, View
from ..errors import ConfigError, StampError


@dataclass(frozen=True)
class Encoded:
    """
    What one frame gave.

    `dictionary` is not None on the first frame of an epoch; it must go out before the code.
    """

    code: Code
    view: View
    dictionary: Dictionary | None = None
    reprojection_error: float = 0.0
    surprise: float = 0.0
    learned: bool = False
    ran_away: bool = False
    epoch: int = 0


class FrameEncoder(Protocol):
    """What turns a stream of frames into codes: DLSC-QBS, or a row of the table beside it."""

    def process(self, frame: Frame) -> Encoded:
        """Encode the next frame; raise ImageError or StampError, unchanged, where it cannot."""


class Encoder:
    """
    DLSC-QBS on a stream of frames.

    The learner runs Algorithm 1 as printed on its live dictionary. What is published are the
    converged codes under its last snapshot, held for an epoch, so that codes of one epoch can be
    compared; in `paper` mode, the learner's own codes. A learner that runs away goes back to the
    snapshot before anything of it goes out; without `protection`, as in the paper, it does not.
    """

    def __init__(self, config: Config):
        self._config = config
        self._inputs = make_inputs(config)
        self._learner = (
            PatchLearner(self._inputs.n_inputs, config.encoder, config.patches)
            if config.encoder.input == 'patches'
            else DictionaryLearner(self._inputs.n_inputs, config.encoder))
        self._gate = SurpriseGate(config.encoder.gate_window)
        self._order = StampOrder()
        self._coder: Coder | None = None
        self._epoch = 0
        if config.encoder.protection and not self._learner.is_stable:
            raise ConfigError(
                f'encoder.eta_c = {config.encoder.eta_c:g}: expected less than 2 / lambda_max = '
                f'{2.0 / self.lambda_max:.3g} of the first dictionary')

    @property
    def atoms(self) -> np.ndarray:
        """Make the live dictionary for the caller: (n_atoms, n_inputs), float32."""
        return self._learner.atoms_

    @property
    def atom_shape(self) -> tuple[int, int]:
        """Return height and width of an atom: those of the view, or of a patch."""
        return self._inputs.shape

    @property
    def lambda_max(self) -> float:
        """Return the largest eigenvalue of the live Gram matrix."""
        return self._learner.lambda_max

    @property
    def lambda_max_limit(self) -> float:
        """Return the `lambda_max` from which on the learner counts as run away."""
        return self._learner.lambda_max_limit

    def process(self, frame: Frame) -> Encoded:
        """
        Encode one frame, then learn from it when the gate is open.

        Raises
        ------
        ImageError
            When the image cannot be made into a view.
        StampError
            When the stamp is not after that of the frame before. A refused frame changes nothing.

        """
        view = _next_view(frame, self._config.view, self._order)
        inputs = self._inputs.of(view)
        error = self._learner.infer(inputs)
        dictionary = self._new_dictionary(frame.stamp_ns)
        values, dictionary_ns = self._published_code()
        learned = self._gate.is_open or not self._config.encoder.gate
        ran_away = learned and self._learn(inputs)
        self._gate.observe(error)
        if ran_away:
            self._learner.fall_back()
            self._gate = SurpriseGate(self._config.encoder.gate_window)
        return Encoded(
            code=Code(frame.stamp_ns, values.astype(np.float32), dictionary_ns),
            view=View(frame.stamp_ns, view), dictionary=dictionary, reprojection_error=error,
            surprise=self._gate.surprise, learned=learned, ran_away=ran_away,
            epoch=self._epoch)

    def _learn(self, inputs: PixelInput | np.ndarray) -> bool:
        """Learn from the frame just inferred; return whether it takes the learner back."""
        with np.errstate(over='ignore', invalid='ignore'):  # of a learner that runs away
            self._learner.learn(inputs)
            return self._config.encoder.protection and not self._learner.is_stable

    def _published_code(self) -> tuple[np.ndarray, int | None]:
        if self._coder is None:
            return self._inputs.pooled(self._learner.codes_)[0], None
        code, = self._coder.encode_products(self._learner.snapshot_products_)
        return code, self._coder.dictionary.stamp_ns

    def _new_dictionary(self, stamp_ns: int) -> Dictionary | None:
        """Start an epoch when the learner has taken a snapshot since the last one began."""
        atoms = self._learner.snapshot_
        if self._config.encoder.mode == 'paper' or (
                self._coder is not None and self._coder.dictionary.atoms is atoms):
            return None
        dictionary = Dictionary(stamp_ns, atoms)
        self._coder = Coder(dictionary, self._config, self._learner.snapshot_gram_)
        self._epoch += 1
        return dictionary


class DescriptorEncoder:
    """An encoder without dictionary or memory: each frame's code is a function of that frame."""

    def __init__(self, describe: Callable[[Frame], np.ndarray], config: ViewConfig):
        self._describe = describe
        self._config = config
        self._order = StampOrder()

    def process(self, frame: Frame) -> Encoded:
        """Describe one frame; see `FrameEncoder`."""
        view = _next_view(frame, self._config, self._order)
        return Encoded(Code(frame.stamp_ns, self._describe(frame), None),
                       View(frame.stamp_ns, view))


def _next_view(frame: Frame, config: ViewConfig, order: StampOrder) -> np.ndarray:
    """Return the view of a frame that comes after the ones before."""
    view = make_view(frame.grey, config)
    if order.take(frame.stamp_ns) is Succession.LATE:
        raise StampError(f'stamp {frame.stamp_ns} ns: expected one after {order.newest_ns} ns')
    return view
