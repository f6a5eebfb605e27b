"""The rows of the table: every way to tell places apart, in front of one and the same back end."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Callable, Iterable, Mapping

import numpy as np

from ..baselines.hog import Hog
from ..baselines.onnx import OnnxEncoder
from ..baselines.orb import Orb
from ..baselines.sad import RawTemplate
from ..baselines.thumbnail import Thumbnail
from ..config import Config
from ..core.types import Frame, GroundTruthSample
from ..evaluation.oracle import Oracle

THRESHOLD = 'ratslam.threshold'
TRACKING = 'ratslam.tracking_threshold'

# What describes a frame, and the measure (core.local_view.Measure) of what it returns.
Description = tuple[Callable[[Frame], np.ndarray], Any]


@dataclass(frozen=True)
class Source:
    """What a method may need before the first frame: its network, a look through the flight."""

    network: Path | None
    events: Callable[[], Iterable]


def _grid(first: float, last: float, n: int = 13) -> tuple[float, ...]:
    """Return n values of mu, the strictest first."""
    return tuple(np.linspace(first, last, n).round(4).tolist())


@dataclass(frozen=True)
class Method:
    """
    One row of the table.

    Attributes
    ----------
    name, meaning : str
    overrides : mapping
        The parameters that make the row what it is.
    threshold : float or None
        Its mu for all flights, in the units of its own measure; None: that of the configuration.
    tracking_gap : float
        How much looser mu is while tracking, unless mu is that of the configuration.
    grid : tuple of float
        The values of mu to tune over, the strictest first; none where no mu is used.
    make : callable or None
        From a `Source` to what describes a frame and the measure of that; None: DLSC.
    has_network : bool
        Whether the row runs a network that the user brings.

    """

    name: str
    meaning: str
    overrides: Mapping[str, Any] = field(default_factory=dict)
    threshold: float | None = None
    tracking_gap: float = 0.0
    grid: tuple[float, ...] = _grid(0.95, 0.35)
    make: Callable[[Source], Description] | None = None
    has_network: bool = False

    def decides(self) -> dict[str, Any]:
        """Return the parameters that are the row's, whatever the configuration says."""
        if self.threshold is None:
            return dict(self.overrides)
        return {**self.overrides, THRESHOLD: self.threshold}

    def configured(self, config: Config, direction: int, threshold: float | None) -> Config:
        """
        Return the configuration of a run.

        Parameters
        ----------
        config : Config
            The user's.
        direction : int
            That of the row's measure: the back end takes mu of a distance with a minus sign.
        threshold : float or None
            mu, in the units of the row's measure; None: the row's own. mu while tracking
            moves along.

        """
        config = config.override(self.overrides)
        gap = self.tracking_gap
        if self.threshold is None:
            gap = config.ratslam.threshold - config.ratslam.tracking_threshold
        wanted = self.threshold if threshold is None else threshold
        if wanted is None or not self.grid:
            return config
        return config.override({
            THRESHOLD: direction * wanted, TRACKING: max(direction * wanted - gap, -1.0)})


def _by(descriptor: Callable[[], Any]):
    """Return how to make the descriptor of a grey image ready for frames."""
    def make(source: Source) -> Description:
        made = descriptor()
        return lambda frame: made.describe(frame.grey), made.measure
    return make


def _network(source: Source) -> Description:
    return _by(lambda: OnnxEncoder(source.network))(source)


def _oracle(source: Source) -> Description:
    stamps_ns: list[int] = []
    truth: list[GroundTruthSample] = []
    for event in source.events():
        if isinstance(event, Frame):
            stamps_ns.append(event.stamp_ns)
        elif isinstance(event, GroundTruthSample):
            truth.append(event)
    oracle = Oracle(stamps_ns, truth)
    return oracle.describe, oracle.measure


def _blind(source: Source) -> Description:
    """Return what describes no frame, so that no place is met again."""
    return lambda frame: np.zeros(1, np.float32), Thumbnail().measure


_QBS = {'encoder.mode': 'epochs', 'encoder.gate': True}
_IMAGE = {'encoder.input': 'image', **_QBS}
_PATCHES = {'encoder.input': 'patches', **_QBS}

METHODS = {method.name: method for method in (
    Method('odometry', 'no place is met again', grid=(), make=_blind),
    Method('oracle', 'true revisits, from ground truth: the ceiling of the back end',
           threshold=0.3, tracking_gap=0.15, grid=_grid(0.15, 0.75), make=_oracle),
    Method('ratslam', 'raw template, sum of absolute differences over horizontal shifts',
           threshold=0.06, tracking_gap=0.03, grid=_grid(0.01, 0.13), make=_by(RawTemplate)),
    Method('orb', 'ORB features, ratio test, 1 - N_m / max_m',
           threshold=0.7, tracking_gap=0.1, grid=_grid(0.5, 0.98), make=_by(Orb)),
    Method('vgg11', 'VGG-11 pre-trained on ImageNet, cosine',
           threshold=0.9, tracking_gap=0.05, grid=_grid(0.98, 0.5), make=_network,
           has_network=True),
    Method('latentslam', 'LatentSLAM, trained on other flights, cosine',
           threshold=0.9, tracking_gap=0.1, grid=_grid(0.98, 0.5), make=_network,
           has_network=True),
    Method('onnx', 'a network of the user, cosine',
           threshold=0.9, tracking_gap=0.1, grid=_grid(0.98, 0.5), make=_network,
           has_network=True),
    Method('thumbnail', 'standardised small image, cosine',
           threshold=0.8, tracking_gap=0.15, grid=_grid(0.98, 0.5), make=_by(Thumbnail)),
    Method('hog', 'histograms of oriented gradients, cosine',
           threshold=0.95, tracking_gap=0.1, grid=_grid(0.99, 0.75), make=_by(Hog)),
    Method('dlsc', 'whole-image atoms, learning from every frame',
           {**_IMAGE, 'encoder.gate': False}),
    Method('dlsc_qbs_paper', "Algorithm 1's own codes of whole images, nothing re-encoded",
           {**_IMAGE, 'encoder.mode': 'paper'}, threshold=0.85, tracking_gap=0.15,
           grid=_grid(0.98, 0.5)),
    Method('dlsc_qbs_image', 'whole-image atoms', _IMAGE),
    Method('image_frozen', 'whole-image atoms, never learning',
           {**_IMAGE, 'encoder.n_learning': 0}),
    Method('image_no_gate', 'whole-image atoms, learning from every frame',
           {**_IMAGE, 'encoder.gate': False}),
    Method('dlsc_qbs_patches', 'patch atoms', _PATCHES),
    Method('patches_frozen', 'patch atoms, never learning', {**_PATCHES, 'encoder.n_learning': 0}),
    Method('patches_no_gate', 'patch atoms, learning from every frame',
           {**_PATCHES, 'encoder.gate': False}),
    Method('dlsc_qbs', 'what the nodes run', _QBS),
)}
