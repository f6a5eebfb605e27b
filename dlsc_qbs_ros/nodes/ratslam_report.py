"""What a ratslam node says about itself: counts, rates, latencies and whatever is amiss."""

from __future__ import annotations

from collections import Counter, deque
import time
from typing import Callable

from .stamp_offset import StampOffset
from ..core.types import OdometrySample, PoseEstimate
from ..pipeline.odometry import OdometrySource
from ..pipeline.ratslam import RatSlam
from ..ros.diagnostics import ERROR, OK, PERIOD_S, SequenceGaps, WARN

# What is counted when all is well; any other count that rises is a problem.
USUAL = ('odometry_accepted', 'dictionaries', 'code_books', 'codes_received', 'codes_used',
         'poses')
# What follows where codes or odometry do not come, or do not fit together.
SYMPTOMS = ('codes_without_odometry', 'codes_before_odometry', 'poses_ahead_of_codes')


class RatSlamReport:
    """Collects between two reports; called, it gives (level, message, values)."""

    def __init__(self, ratslam: RatSlam, odometry: OdometrySource):
        self._ratslam = ratslam
        self._odometry = odometry
        self._gaps = {topic: SequenceGaps() for topic in ('dictionary', 'view', 'code')}
        self._counts: Counter[str] = Counter()
        self._reported: Counter[str] = Counter()
        self._waiting: deque[tuple[int, int]] = deque()
        self._latency_ns = 0
        self._offset = StampOffset()
        self._heard: set[str] = set()

    def streams_begin(self, why_no_codes: Callable[[], str]) -> None:
        """Take in that the node listens anew: what came before is not lost."""
        self._why_no_codes = why_no_codes
        for gaps in self._gaps.values():
            gaps.restart()

    def message_arrived(self, topic: str, info: dict) -> None:
        """Take in that a message came, and by its number what was lost before it."""
        self._heard.add(topic)
        self._gaps[topic].observe(info['publication_sequence_number'])

    def message_refused(self, topic: str) -> None:
        """Take in that a message could not be read."""
        self._counts[f'{topic}_malformed'] += 1

    def code_arrived(self, stamp_ns: int) -> None:
        """Take in the stamp of a code, which is that of its image."""
        self._offset.image_at(stamp_ns)

    def odometry_arrived(self, sample: OdometrySample) -> None:
        """Take in that a sample began to wait for its pose."""
        self._offset.odometry_at(sample.stamp_ns)
        self._waiting.append((sample.stamp_ns, time.monotonic_ns()))

    def pose_published(self, estimate: PoseEstimate) -> None:
        """Take in that a sample has its pose."""
        self._counts['poses'] += 1
        while self._waiting:
            stamp_ns, arrived_ns = self._waiting.popleft()
            if stamp_ns == estimate.stamp_ns:
                self._latency_ns += time.monotonic_ns() - arrived_ns
                return

    def __call__(self) -> tuple[bytes, str, dict[str, object]]:
        """Report what there is and what has happened since the last report."""
        counts = self._counts + self._ratslam.counts + self._odometry.diagnostics() + Counter(
            {f'{topic}_lost': gaps.lost for topic, gaps in self._gaps.items()})
        new, self._reported = counts - self._reported, counts
        latency_ns, self._latency_ns = self._latency_ns, 0
        graph = self._ratslam.mapper.map
        values = {
            **dict.fromkeys(USUAL, 0), **counts,
            'pose_rate_hz': new['poses'] / PERIOD_S,
            'latency_ms': latency_ns * 1e-6 / max(new['poses'], 1),
            'experiences': len(graph), 'links': len(graph.links),
            'closures': int(graph.is_closure.sum()),
            'closures_undone': self._ratslam.mapper.undone,
            'localised': self._ratslam.is_localised,
            **self._odometry.state()}
        problems = self._problems(new)
        if self._ratslam.codes_match:
            return WARN if problems else OK, ', '.join(problems) or self._ratslam.activity, values
        problems.insert(0, 'codes do not match their views: is the encoder configured alike?')
        return ERROR, ', '.join(problems), values

    def _problems(self, new: Counter[str]) -> list[str]:
        """Return causes; symptoms only where there is no cause to name."""
        causes, offset = [], self._offset.in_words()
        if not any(key.startswith('odometry_') for key in new):
            causes.append(f'no odometry: {self._odometry.why_silent()}')
        elif new['odometry_out_of_order'] and not new['odometry_accepted']:
            causes.append('odometry stamps do not advance')
        elif offset:
            causes.append(offset)
        if 'code' not in self._heard:
            causes.append(f'no codes: {self._why_no_codes()}')
        self._heard.clear()
        quiet = (*USUAL, *SYMPTOMS) if causes else USUAL
        if not self._ratslam.is_localised:
            causes.append('not localised: no known place has been recognised yet')
        return causes + [f'{new[key]} {key.replace("_", " ")}' for key in sorted(new)
                         if key not in quiet]
