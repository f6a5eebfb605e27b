"""What a recorder says on a terminal: one line while it records, a table when it has ended."""

from __future__ import annotations

from datetime import timedelta
import shutil
import sys
from typing import Mapping

from .recorder_losses import Losses
from ..io.recordings.ledger import RecordingStatus, TopicCounts

CLEAR_LINE = '\x1b[K'


def status_line(seconds: float, status: RecordingStatus, losses: Mapping[str, Losses],
                is_paused: bool) -> str:
    """Return how a recording goes."""
    state = 'paused' if is_paused and not status.error else status.state
    return '  '.join(filter(None, [
        state, _duration(seconds), counted(len(losses), 'topic'), _total(status),
        f'{_lost(losses)} lost', status.error]))


def show(line: str) -> None:
    """Show a line on the terminal in place of the one before; what is printed next replaces it."""
    width = shutil.get_terminal_size().columns - 1
    print(f'{line[:width]}{CLEAR_LINE}\r', end='', file=sys.stderr, flush=True)


def summary(directory: object, seconds: float, status: RecordingStatus,
            losses: Mapping[str, Losses], refused: Mapping[str, str]) -> str:
    """Return what a recording holds and what it lacks, topic by topic."""
    rows = [('messages', 'lost', 'topic')]
    for topic in sorted(status.topics.keys() | losses):
        written = status.topics.get(topic, TopicCounts()).written
        lost = losses[topic].total if topic in losses else 0
        rows.append((str(written), str(lost), topic))
    return '\n'.join([
        *(f'{messages:>10s} {lost:>7s}  {topic}' for messages, lost, topic in rows),
        *(f'{topic} is not recorded: {reason}' for topic, reason in sorted(refused.items())),
        f'{directory}: {_total(status)} in {counted(status.n_files, "file")}, '
        f'{_duration(seconds)}, {_lost(losses)} lost'])


def counted(number: int, noun: str) -> str:
    """Return so many of a thing in words."""
    return f'{number} {noun}' if number == 1 else f'{number} {noun}s'


def _total(status: RecordingStatus) -> str:
    return f'{counted(status.total.written, "message")}, {_size(status.written_bytes)}'


def _lost(losses: Mapping[str, Losses]) -> int:
    return sum(topic.total for topic in losses.values())


def _duration(seconds: float) -> str:
    return str(timedelta(seconds=int(seconds)))


def _size(n_bytes: float) -> str:
    for unit in ('B', 'kB', 'MB'):
        if n_bytes < 999.5:
            return f'{n_bytes:.3g} {unit}'
        n_bytes /= 1000
    return f'{n_bytes:.3g} GB'
