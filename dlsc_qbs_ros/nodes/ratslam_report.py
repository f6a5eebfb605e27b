"""What a ratslam node says about itself: counts, rates, latencies and whatever is amiss."""

from __future__ import annotations

from collections import Counter, deque
import time

from .odometry_topic import OdometryTopic
from ..core.types import OdometrySample, PoseEstimate
from ..pipeline.ratslam import RatSlam
from ..ros.diagnostics import ERROR, OK, PERIOD_S, SequenceGaps, WARN

# What is counted when all is well; any other count that rises is a problem.
USUAL = ('odometry_accepted', 'dictionaries', 'code_books', 'codes_received', 'codes_used',
         'poses')


class RatSlamReport:
    """Collects between two reports; called, it gives (level, message, values)."""

    def __init__(self, ratslam: RatSlam, odometry: OdometryTopic):
        self._ratslam = ratslam
        self._odometry = odometry
        self._gaps = {topic: SequenceGaps() for topic in ('dictionary', 'view', 'code')}
        self._counts: Counter[str] = Counter()
        self._reported: Counter[str] = Counter()
        self._waiting: deque[tuple[int, int]] = deque()
        self._latency_ns = 0

    def message_arrived(self, topic: str, info: dict) -> None:
        """Take in that a message came, and by its number what was lost before it."""
        self._gaps[topic].observe(info['publication_sequence_number'])

    def message_refused(self, topic: str) -> None:
        """Take in that a message could not be read."""
        self._counts[f'{topic}_malformed'] += 1

    def odometry_arrived(self, sample: OdometrySample) -> None:
        """Take in that a sample began to wait for its pose."""
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
            'closures_undone': self._ratslam.mapper.undone}
        problems = [f'no {missing}' for key, missing in (
            ('odometry_accepted', 'odometry'), ('codes_received', 'codes')) if not new[key]]
        problems += [f'{new[key]} {key.replace("_", " ")}' for key in sorted(new)
                     if key not in USUAL]
        if self._ratslam.codes_match:
            return WARN if problems else OK, ', '.join(problems) or 'mapping', values
        problems.insert(0, 'codes do not match their views: is the encoder configured alike?')
        return ERROR, ', '.join(problems), values
