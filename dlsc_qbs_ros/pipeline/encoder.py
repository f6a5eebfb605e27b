"""Frame in, code out: preprocessing, Algorithm 1, the gate and epochs in their order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .coder import Coder
from .stamps import StampOrder, Succession
from ..config import Config
from ..core.dictionary import DictionaryLearner
from ..core.preprocessing import make_view, view_to_inputs
from ..core.surprise import SurpriseGate
from ..core.types import Code, Dictionary, Frame, View
from ..errors import StampError


@dataclass(frozen=True)
class Encoded:
    """
    What one frame gave.

    `dictionary` is not None on the first frame of an epoch; it must go out before the code.
    """

    code: Code
    view: View
    dictionary: Dictionary | None
    reprojection_error: float
    surprise: float
    learned: bool
    ran_away: bool
    epoch: int


class Encoder:
    """
    DLSC-QBS on a stream of frames.

    The learner runs Algorithm 1 as printed on its live dictionary. What is published are the
    converged codes under a snapshot of it that is held for an epoch, so that codes of one epoch
    can be compared; in `paper` mode, the learner's own codes. A learner that runs away starts
    again from the last snapshot, except in `paper` mode, where the paper has nothing against it.
    """

    def __init__(self, config: Config):
        self._config = config
        self._learner = DictionaryLearner(config.view.width * config.view.height, config.encoder)
        self._gate = SurpriseGate(config.encoder.gate_window)
        self._order = StampOrder()
        self._coder: Coder | None = None
        self._epoch = 0

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
        view = make_view(frame.grey, self._config.view)
        if self._order.take(frame.stamp_ns) is Succession.LATE:
            raise StampError(f'stamp {frame.stamp_ns} ns: expected one after '
                             f'{self._order.newest_ns} ns')
        inputs = view_to_inputs(view[None], self._config.view.standardise)
        dictionary = self._start_epoch(frame.stamp_ns) if self._is_epoch_over() else None
        error = self._learner.infer(inputs)
        values, dictionary_ns = self._published_code(inputs)
        learned = self._gate.is_open or not self._config.encoder.gate
        if learned:
            self._learner.learn(inputs)
        self._gate.observe(error)
        ran_away = not self._learner.is_stable
        if ran_away and self._coder is not None:
            self._learner.restart(self._coder.dictionary.atoms)
            self._gate = SurpriseGate(self._config.encoder.gate_window)
        return Encoded(
            code=Code(frame.stamp_ns, values.astype(np.float32), dictionary_ns),
            view=View(frame.stamp_ns, view), dictionary=dictionary, reprojection_error=error,
            surprise=self._gate.surprise, learned=learned, ran_away=ran_away,
            epoch=self._epoch)

    def _published_code(self, inputs: np.ndarray) -> tuple[np.ndarray, int | None]:
        if self._coder is None:
            return self._learner.codes_[0], None
        return self._coder.encode(inputs)[0], self._coder.dictionary.stamp_ns

    def _is_epoch_over(self) -> bool:
        """Whether the live dictionary has moved too far from the one that codes refer to."""
        if self._config.encoder.mode == 'paper':
            return False
        if self._coder is None:
            return True
        held = self._coder.dictionary.atoms
        change = np.linalg.norm(self._learner.atoms_ - held)
        return change > self._config.encoder.epoch_change * np.linalg.norm(held)

    def _start_epoch(self, stamp_ns: int) -> Dictionary:
        self._learner.refresh_gram()
        dictionary = Dictionary(stamp_ns, self._learner.atoms_.copy())
        self._coder = Coder(dictionary, self._config)
        self._epoch += 1
        return dictionary
