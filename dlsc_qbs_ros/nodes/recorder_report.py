"""What a recorder says of itself, in diagnostics and on a terminal."""

from __future__ import annotations

import time
from typing import Sequence

from .recorder_files import Repairs
from .recorder_text import counted, status_line, summary
from .recorder_topics import RecorderTopics
from ..io.recordings.recording import Recording
from ..ros.diagnostics import ERROR, OK, WARN


class RecorderReport:
    """Puts together what the parts of a recorder know."""

    def __init__(self, recording: Recording, topics: RecorderTopics, repairs: Repairs):
        self._begun_s = time.monotonic()
        self._recording = recording
        self._topics = topics
        self._repairs = repairs

    def diagnostics(self, awaited: Sequence[str], is_paused: bool
                    ) -> tuple[bytes, str, dict[str, object]]:
        """Return level, message and values: how it goes, what is missing and waited for."""
        status = self._recording.status()
        losses = {name: topic.total for name, topic in self._topics.losses(status).items()}
        total, refused = status.total, self._topics.refused
        values = {
            'topics': len(losses), 'messages': total.written, 'bytes': status.written_bytes,
            'lost': sum(losses.values()), 'overflowed': total.overflowed,
            'not_written': total.not_written, 'queued_bytes': status.queued_bytes,
            'files': status.n_files, 'output': str(self._recording.directory),
            'repaired_files': self._repairs.n_repaired,
            'refused_topics': ' '.join(sorted(refused)),
            **{f'lost {name}': lost for name, lost in losses.items() if lost}}
        if status.error:
            return ERROR, status.error, values
        problems = [problem for problem, is_there in (
            (f'waiting for {", ".join(awaited)}', awaited),
            ('losses', any(losses.values())),
            (f'{counted(len(refused), "topic")} refused', refused),
            (f'{counted(self._repairs.n_failed, "earlier file")} not repaired',
             self._repairs.n_failed),
        ) if is_there]
        state = 'paused' if is_paused else status.state
        return WARN if problems else OK, ', '.join(problems) or state, values

    def line(self, is_paused: bool) -> str:
        """Return one line for a terminal."""
        status = self._recording.status()
        return status_line(self._seconds(), status, self._topics.losses(status), is_paused)

    def summary(self) -> str:
        """Return what the recording holds, and what it lacks, topic by topic."""
        status = self._recording.status()
        return summary(self._recording.directory, self._seconds(), status,
                       self._topics.losses(status), self._topics.refused)

    def _seconds(self) -> float:
        return time.monotonic() - self._begun_s
