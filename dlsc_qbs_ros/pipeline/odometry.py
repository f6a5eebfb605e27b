"""Odometry sources and the pose between two samples."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
from dataclasses import replace
from math import hypot, isfinite
from typing import Callable, Protocol

from .stamps import StampOrder, Succession
from ..config import OdometryConfig
from ..core.geometry import compose, interpolate, LARGEST_M
from ..core.types import IDENTITY, OdometrySample, Pose2, RawOdometry


class OdometrySource(Protocol):
    """Where odometry comes from: a topic, an autopilot's link, a log."""

    frame_id: str

    def start(self, deliver: Callable[[OdometrySample], None]) -> None:
        """Begin to deliver samples, in stamp order, until stopped."""

    def stop(self) -> None:
        """Stop delivering; no sample comes after this returns."""

    def diagnostics(self) -> dict[str, int]:
        """Return the counts of what was accepted and refused, by cause."""

    def state(self) -> dict[str, object]:
        """Return words and figures on where it comes from."""

    def why_silent(self) -> str:
        """Return in plain words why no odometry comes."""

    def reconfigure(self, config: OdometryConfig) -> None:
        """Go on with other limits."""


class OdometryNormaliser:
    """
    Puts raw odometry in order: stamps rise, poses are continuous within a segment.

    A sample that is not after its predecessor is refused and counted; a fall back of the clock
    far enough to be a restart (`StampOrder`), a reset of the source or an impossible step starts
    a new segment, and so does a silence when the twist is integrated.
    """

    def __init__(self, config: OdometryConfig):
        self._config = config
        self._order = StampOrder()
        self._last: RawOdometry | None = None
        self._integrated = IDENTITY
        self._segment = 0
        self.counts: Counter[str] = Counter()

    def reconfigure(self, config: OdometryConfig) -> None:
        """Go on with other limits."""
        self._config = config

    def accept(self, raw: RawOdometry) -> OdometrySample | None:
        """Return the normalised sample, or None when it is refused."""
        refusal = self._refusal(raw)
        if refusal:
            self.counts[refusal] += 1
            return None
        if self._order.take(raw.sample.stamp_ns) is Succession.LATE:
            self.counts['odometry_out_of_order'] += 1
            return None
        if self._last is not None:
            step_s = (raw.sample.stamp_ns - self._last.sample.stamp_ns) * 1e-9
            cause = self._discontinuity(raw, step_s)
            if cause:
                self.counts[cause] += 1
                self._segment += 1
            elif self._config.use_twist:
                self._integrated = compose(self._integrated, _motion(self._last, raw, step_s))
        self._last = raw
        self.counts['odometry_accepted'] += 1
        pose = self._integrated if self._config.use_twist else raw.sample.pose
        return replace(raw.sample, pose=pose, segment=self._segment)

    def _refusal(self, raw: RawOdometry) -> str | None:
        """Return what makes a sample one that no place in the world, or no drone, can give."""
        pose = raw.sample.pose
        if not all(abs(value) <= LARGEST_M for value in (pose.x_m, pose.y_m, raw.sample.z_m)):
            return 'odometry_malformed'
        if self._config.use_twist:
            if not all(map(isfinite, _twist(raw))):
                return 'odometry_without_twist'
            if hypot(raw.forward_m_s, raw.left_m_s) > self._config.max_speed_m_s:
                return 'odometry_too_fast'
        return None

    def _discontinuity(self, raw: RawOdometry, step_s: float) -> str | None:
        if step_s <= 0.0:
            return 'odometry_clock_jumps'
        if self._config.use_twist and step_s > self._config.max_gap_s:
            return 'odometry_gaps'
        if raw.sample.segment != self._last.sample.segment:
            return 'odometry_resets'
        a, b = self._last.sample.pose, raw.sample.pose
        allowed_m = self._config.max_speed_m_s * step_s
        if not self._config.use_twist and hypot(b.x_m - a.x_m, b.y_m - a.y_m) > allowed_m:
            return 'odometry_jumps'
        return None


def _twist(raw: RawOdometry) -> tuple[float, float, float]:
    return raw.forward_m_s, raw.left_m_s, raw.yaw_rate_rad_s


def _motion(a: RawOdometry, b: RawOdometry, step_s: float) -> Pose2:
    """Return the motion from a to b by the mean of their twists, at half the turn."""
    turn = 0.5 * (a.yaw_rate_rad_s + b.yaw_rate_rad_s) * step_s
    half_turn = Pose2(0.0, 0.0, 0.5 * turn)
    straight = Pose2(0.5 * (a.forward_m_s + b.forward_m_s) * step_s,
                     0.5 * (a.left_m_s + b.left_m_s) * step_s, 0.0)
    return compose(compose(half_turn, straight), half_turn)


class OdometryHistory:
    """The samples that a code may still need, to find the pose at a stamp between two of them."""

    # Ten minutes at 200 Hz: more is only held while codes lag farther behind than that.
    MAX_SAMPLES = 120_000

    def __init__(self):
        self._samples: list[OdometrySample] = []

    def add(self, sample: OdometrySample) -> None:
        """Append a sample; a stamp that falls back ends the history before it."""
        if self._samples and sample.stamp_ns <= self._samples[-1].stamp_ns:
            self._samples.clear()
        self._samples.append(sample)
        if len(self._samples) > self.MAX_SAMPLES:
            del self._samples[:self.MAX_SAMPLES // 2]

    def forget_before(self, stamp_ns: int) -> None:
        """Drop what no stamp from this one on needs."""
        del self._samples[:bisect_right(self._samples, stamp_ns, key=_stamp_ns) - 1]

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest sample."""
        return self._samples[-1].stamp_ns if self._samples else None

    def at(self, stamp_ns: int) -> OdometrySample | None:
        """Return the sample at a stamp, interpolated within a segment, None outside."""
        after = bisect_left(self._samples, stamp_ns, key=_stamp_ns)
        if after == len(self._samples):
            return None
        b = self._samples[after]
        if b.stamp_ns == stamp_ns:
            return b
        if after == 0:
            return None
        a = self._samples[after - 1]
        if a.segment != b.segment:
            return replace(a, stamp_ns=stamp_ns)
        fraction = (stamp_ns - a.stamp_ns) / (b.stamp_ns - a.stamp_ns)
        return replace(
            a, stamp_ns=stamp_ns, pose=interpolate(a.pose, b.pose, fraction),
            z_m=a.z_m + fraction * (b.z_m - a.z_m))


def _stamp_ns(sample: OdometrySample) -> int:
    return sample.stamp_ns
