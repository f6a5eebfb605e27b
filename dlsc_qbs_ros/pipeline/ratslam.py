"""Codes and odometry in, poses out: everything in stamp order, whatever order it came in."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Executor
from math import inf
from typing import Callable

import numpy as np

from .live_map import LiveMap
from .mapper import Mapper
from .odometry import OdometryHistory
from .stamps import CLOCK_JUMP_NS, StampOrder, Succession
from ..config import Config
from ..core.local_view import Measure
from ..core.types import Code, Dictionary, OdometrySample, PoseEstimate, View


class RatSlam(LiveMap):
    """
    Feeds the mapper in stamp order and gives a pose for every odometry sample.

    A code is used once its view, odometry at or after its stamp and its dictionary are there,
    with all view cells re-encoded. One code per `sample_period_s` is used, so a sample before
    the next one is due has its pose at once, and a later sample waits for that code. Whatever
    waited longer than `max_wait_s` is given up and counted. The map is a function of the codes
    used and the odometry, not of when they came.

    Times of arrival are seconds of any steady clock.
    """

    # A camera's frames jitter: a code may come up to a quarter of a period early.
    EARLY_SHARE = 0.25
    MAX_VIEWS = 1000

    def __init__(self, config: Config, executor: Executor | None = None,
                 on_update: Callable[[Mapper], None] = lambda mapper: None,
                 measure: Measure | None = None):
        super().__init__(config, executor, measure)
        self._on_update = on_update
        self._history = OdometryHistory()
        self._codes: deque[tuple[Code, float]] = deque()
        self._samples: deque[tuple[OdometrySample, float]] = deque()
        self._views: dict[int, np.ndarray] = {}
        self._code_order = StampOrder()
        # The earliest stamp of the next code to be used; None before the first.
        self._due_ns: int | None = None
        self._codes_flow = False
        self.reconfigure(config)

    def reconfigure(self, config: Config) -> None:
        """Go on with other values of `live` parameters; the map stays."""
        super().reconfigure(config)
        self._period_ns = int(config.ratslam.sample_period_s * 1e9)
        self._max_wait_s = config.ratslam.max_wait_s

    def add_odometry(self, sample: OdometrySample, now_s: float = 0.0) -> None:
        """Take in the next odometry sample; one whose stamp falls back starts a new timeline."""
        newest_ns = self._history.newest_ns
        if newest_ns is not None and sample.stamp_ns <= newest_ns:
            self._restart_timeline(sample.stamp_ns)
        self._history.add(sample)
        self._samples.append((sample, now_s))

    def add_view(self, view: View) -> None:
        """Take in the view of a code; one of another shape is refused."""
        if view.pixels.shape != self._view_shape:
            self.counts['views_of_another_shape'] += 1
            return
        self._views[view.stamp_ns] = view.pixels
        if len(self._views) > self.MAX_VIEWS:
            self.counts['views_without_code'] += 1
            del self._views[next(iter(self._views))]

    def add_code(self, code: Code, now_s: float = 0.0) -> None:
        """Take in the next code; one of another length or not after the last is refused."""
        if self._code_shape is None:
            self._code_shape = code.values.shape  # of another encoder, whatever it be
        if code.values.shape != self._code_shape:
            self.counts['codes_of_another_length'] += 1
            return
        if not np.isfinite(code.values).all():
            self.counts['codes_not_finite'] += 1
            return
        succession = self._code_order.take(code.stamp_ns)
        if succession is Succession.LATE:
            self.counts['codes_out_of_order'] += 1
            return
        if succession is Succession.RESTART:
            self.counts['codes_clock_jumps'] += 1
            self._restart_timeline(code.stamp_ns)
            newest_ns = self._history.newest_ns
            if newest_ns is not None and newest_ns > code.stamp_ns + CLOCK_JUMP_NS:
                self._history = OdometryHistory()  # it is of the time before the jump
        self.counts['codes_received'] += 1
        self._codes_flow = True
        self._codes.append((code, now_s))

    def _restart_timeline(self, stamp_ns: int) -> None:
        """Give up codes of the time before a clock jumped back to a stamp; the map stays."""
        kept = [item for item in self._codes
                if item[0].stamp_ns <= stamp_ns + CLOCK_JUMP_NS]
        self.counts['codes_before_clock_jump'] += len(self._codes) - len(kept)
        self._codes = deque(kept)
        self._due_ns = None

    def _begin(self, mapper: Mapper, views: np.ndarray, dictionaries: list[Dictionary]) -> None:
        super()._begin(mapper, views, dictionaries)
        self._due_ns = None

    def advance(self, now_s: float) -> list[PoseEstimate]:
        """Process all that is ready, or waited too long, and return the poses in stamp order."""
        poses: list[PoseEstimate] = []
        while self._advance_code(now_s) or self._advance_sample(now_s, poses):
            pass
        return poses

    def _advance_code(self, now_s: float) -> bool:
        """Use or give up the oldest code, when that is due; return whether it was."""
        if not self._codes:
            return False
        code, arrived_s = self._codes[0]
        if self._samples and self._samples[0][0].stamp_ns < code.stamp_ns:
            return False
        if self._due_ns is None or code.stamp_ns >= self._due_ns:
            missing = self._missing(code)
            if missing == 'reencoding' and now_s == inf:
                missing = None  # nothing else is to come: to use the code is to wait for that
            if missing and (now_s - arrived_s <= self._max_wait_s or missing == 'reencoding'):
                return False
            if missing:
                self.counts[f'codes_without_{missing}'] += 1
            else:
                self._use(code)
        self._codes.popleft()
        for stamp_ns in [s for s in self._views if s <= code.stamp_ns]:
            del self._views[stamp_ns]
        return True

    def _missing(self, code: Code) -> str | None:
        """Return what the code still waits for."""
        if self._history.newest_ns is None or self._history.newest_ns < code.stamp_ns:
            return 'odometry'
        if code.stamp_ns not in self._views:
            return 'view'
        return None if code.dictionary_ns is None else self._book.missing(code)

    def _use(self, code: Code) -> None:
        odometry = self._history.at(code.stamp_ns)
        if odometry is None:
            self.counts['codes_before_odometry'] += 1
            return
        self._take_in(code, self._views[code.stamp_ns], odometry)
        self._history.forget_before(code.stamp_ns)
        self._due_ns = self._next_due_ns(code.stamp_ns)
        self._on_update(self.mapper)

    def _next_due_ns(self, used_ns: int) -> int:
        """Return the next stamp of a grid of one period, which starts anew after a silence."""
        early_ns = int(self.EARLY_SHARE * self._period_ns)
        if self._due_ns is None:
            return used_ns + self._period_ns - early_ns
        return max(self._due_ns + self._period_ns, used_ns + self._period_ns // 2)

    def _advance_sample(self, now_s: float, poses: list[PoseEstimate]) -> bool:
        """Give the oldest odometry sample its pose, when that is due; return whether it was."""
        if not self._samples:
            return False
        sample, arrived_s = self._samples[0]
        if self._awaits_code(sample):
            if now_s - arrived_s <= self._max_wait_s:
                return False
            self.counts['poses_ahead_of_codes'] += 1
            self._codes_flow = bool(self._codes)
        self._samples.popleft()
        poses.append(self._follower.follow(sample))
        return True

    def _awaits_code(self, sample: OdometrySample) -> bool:
        """Whether a code at or before this sample is there or may yet come and be used."""
        if self._codes:
            return (self._codes[0][0].stamp_ns <= sample.stamp_ns
                    and not self._book.is_restoring)
        if self._due_ns is None or not self._codes_flow:
            return False
        return sample.stamp_ns >= self._due_ns
