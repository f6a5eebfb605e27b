"""Frame in, code out: preprocessing, Algorithm 1, the gate and epochs in their order."""

from __future__ import annotations

from dataclasses import dataclass

from ..config import Config
from ..core.types import Code, Dictionary, Frame, View


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
    epoch: int


class Encoder:
    """DLSC-QBS on a stream of frames."""

    def __init__(self, config: Config):
        self.config = config

    def process(self, frame: Frame) -> Encoded:
        """Encode one frame and learn from it when the gate is open."""
        raise RuntimeError('under construction')
