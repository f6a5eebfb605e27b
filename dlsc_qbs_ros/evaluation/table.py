"""One row per flight and encoder: for the screen and for metrics.json."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees
from typing import Any, Mapping, Sequence

from .metrics import Metrics
from .place_recognition import Recognition


@dataclass(frozen=True)
class Row:
    """
    One flight through one encoder.

    `metrics` is None where no frame has ground truth, `threshold`, in the units of the encoder's
    own measure, where it uses none, `false_closures` where nobody can tell. `n_codes` and
    `counts` are those of the run, `refused` the messages of each topic that the reader refused;
    `encode_s` and `map_s` are the wall times of the encoder and of the back end.
    """

    flight: str
    encoder: str
    metrics: Metrics | None
    threshold: float | None
    threshold_tuned: bool
    false_closures: int | None
    n_codes: int
    counts: Mapping[str, int]
    refused: Mapping[str, int]
    encode_s: float
    map_s: float

    @property
    def frames(self) -> int:
        """Return the frames behind the figures; without ground truth, those the map used."""
        return self.metrics.frames if self.metrics else self.n_codes

    def as_json(self) -> dict[str, Any]:
        """
        Return the row of metrics.json, with None where the flight has no ground truth.

        It holds nothing that is another the next time.
        """
        errors = ('mae_l', 'mae_m', 'odometry_mae_l', 'odometry_mae_m', 'ate_rmse_m',
                  'odometry_ate_rmse_m', 'within_95')
        counts = ('view_cells', 'experiences', 'closures', 'learning_frames', 'epochs')
        return {
            'flight': self.flight,
            'encoder': self.encoder,
            **{name: getattr(self.metrics, name, None) for name in errors},
            'threshold': self.threshold,
            'threshold_tuned': self.threshold_tuned,
            'frames': self.frames,
            **{name: self.counts[name] for name in counts},
            'false_closures': self.false_closures,
            'alignment': self.metrics and {
                'rotation_rad': self.metrics.alignment.rotation_rad,
                'translation_m': self.metrics.alignment.translation_m.tolist()},
        }

    def timing(self) -> dict[str, Any]:
        """Return the row of timing.json."""
        return {
            'flight': self.flight, 'encoder': self.encoder,
            'threshold_tuned': self.threshold_tuned,
            'encode_ms_per_frame': 1e3 * self.encode_s / max(self.counts['frames'], 1),
            'map_ms_per_code': 1e3 * self.map_s / max(self.n_codes, 1)}


@dataclass(frozen=True)
class Run:
    """A row and the run behind it, a pipeline.runner.RunResult."""

    row: Row
    result: Any


@dataclass(frozen=True)
class Outcome:
    """
    One flight through one encoder, mapped with one mu or several.

    `recognition` is as it flew, `under_last` with all codes under the last dictionary; both are
    None where no place can be told, and `under_last` where there is no dictionary.
    """

    runs: list[Run]
    recognition: Recognition | None
    under_last: Recognition | None

    def as_json(self, run: Run) -> dict[str, Any]:
        """Return the row of metrics.json of one of the runs."""
        return {**run.row.as_json(),
                'place_recognition': self.recognition and self.recognition.as_json(),
                'place_recognition_under_last_dictionary':
                    self.under_last and self.under_last.as_json()}


HEADER = ('flight', 'encoder', 'MAE_L | MAE_M [m]', 'odometry [m]', 'threshold', 'frames',
          'view cells', 'experiences', 'closures', 'false')
USUAL_COUNTS = {
    'frames', 'learning_frames', 'epochs', 'view_cells', 'experiences', 'closures',
    'dictionaries', 'code_books', 'codes_received', 'codes_used', 'odometry_accepted',
    'poses_ahead_of_codes'}


def format_table(rows: Sequence[Row]) -> str:
    """Return the table as aligned text, and below it what was done to get the figures."""
    cells = [HEADER, *map(_cells, rows)]
    widths = [max(map(len, column)) for column in zip(*cells)]
    lines = ['  '.join(_justified(line, widths)).rstrip() for line in cells]
    lines.insert(1, '  '.join('-' * width for width in widths))
    if any(row.threshold_tuned for row in rows):
        lines.append('* tuned on that very flight for the smallest MAE_L')
    lines += ['', 'Ground truth was moved into the SLAM frame (no scale) to minimise MAE_L:']
    lines += map(_alignment_note, rows)
    lines += [f'  {row.flight} {row.encoder}: {note}' for row in rows for note in _losses(row)]
    return '\n'.join(lines)


def _losses(row: Row) -> list[str]:
    """Return what the reader and the pipeline refused or gave up, so that nothing is silent."""
    return [*(f'{count} messages of {topic} refused' for topic, count in row.refused.items()),
            *(f'{name}: {count}' for name, count in row.counts.items()
              if count and name not in USUAL_COUNTS)]


def _cells(row: Row) -> tuple[str, ...]:
    metrics = row.metrics
    threshold = '-' if row.threshold is None else f'{row.threshold:.3f}'
    return (
        row.flight, row.encoder,
        _pair(metrics.mae_l, metrics.mae_m) if metrics else '-',
        _pair(metrics.odometry_mae_l, metrics.odometry_mae_m) if metrics else '-',
        threshold + '*' * row.threshold_tuned, str(row.frames),
        *(str(row.counts[name]) for name in ('view_cells', 'experiences', 'closures')),
        '-' if row.false_closures is None else str(row.false_closures))


def _pair(localisation_m: float, mapping_m: float) -> str:
    return f'{localisation_m:.3f} | {mapping_m:.3f}'


def _justified(line, widths):
    """Put the two names to the left and all figures to the right."""
    return [cell.ljust(width) if column < 2 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(line, widths))]


def _alignment_note(row: Row) -> str:
    name, metrics = f'  {row.flight} {row.encoder}', row.metrics
    if metrics is None:
        return f'{name}: no ground truth at any frame'
    x_m, y_m = metrics.alignment.translation_m
    return (f'{name}: turned by {degrees(metrics.alignment.rotation_rad):.2f} deg, then moved by '
            f'({x_m:.2f}, {y_m:.2f}) m; {metrics.frames} frames used, '
            f'{metrics.frames_left_out} without ground truth left out')
