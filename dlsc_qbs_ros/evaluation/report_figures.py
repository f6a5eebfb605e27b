"""The pictures of the report, as bytes of PNG."""

from __future__ import annotations

from io import BytesIO
from math import ceil
from pathlib import Path
from typing import Sequence

import numpy as np

from .paper_table import OURS
from .plots import anchored_odometry, FINAL, new_figure, ODOMETRY, ONLINE, TRUTH
from .table import Outcome

COLUMNS = 5
# The palette of Okabe and Ito; where it ends, lines are dashed.
COLOURS = ('#000000', '#E69F00', '#56B4E9', '#009E73', '#CC79A7', '#D55E00', '#F0E442')
STYLES = ('-', '--', ':', '-.')


def trajectories(outcomes: Sequence[Outcome]) -> bytes:
    """
    Draw what each encoder made of one flight, as the paper's figures do: truth and estimate.

    All is drawn turned so that ground truth lies the same way in every panel.
    """
    rows = ceil(len(outcomes) / COLUMNS)
    figure, axes = new_figure(
        Path('report.html'), (3.0 * COLUMNS, 2.9 * rows + 0.4), rows, COLUMNS)
    axes = np.array(axes).ravel()
    for panel, outcome in zip(axes, outcomes):
        _trajectory(panel, outcome)
    for panel in axes[len(outcomes):]:
        panel.axis('off')
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=len(labels), frameon=False)
    return _png(figure)


def _trajectory(panel, outcome: Outcome) -> None:
    row, result = outcome.runs[0].row, outcome.runs[0].result
    lines = [(anchored_odometry(result), {**ODOMETRY, 'linewidth': 0.6}, 'odometry alone'),
             (result.poses, ONLINE, 'estimate, online'),
             (result.final_poses, {**FINAL, 'linewidth': 1.1}, 'estimate, final map')]
    title = row.encoder
    if row.metrics:
        lines.append((row.metrics.truth_m, {**TRUTH, 'linewidth': 0.6}, 'ground truth'))
        title += f'\n{row.metrics.mae_l:.3f} | {row.metrics.mae_m:.3f} m'
    turn = _turn_back(row)
    for points, style, label in lines:
        panel.plot(*(points[:, :2] @ turn).T, label=label, **style)
    panel.set_title(title, fontsize=9, fontweight='bold' if row.encoder == OURS else 'normal')
    panel.set_aspect('equal', adjustable='datalim')
    panel.tick_params(labelsize=7)
    panel.grid(color='0.92')


def _turn_back(row) -> np.ndarray:
    """Return the matrix that undoes the turn of the alignment, for points as rows."""
    angle_rad = row.metrics.alignment.rotation_rad if row.metrics else 0.0
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]])


def precision_recall(outcomes: Sequence[Outcome]) -> bytes:
    """Draw precision over recall for one flight: our family of encoders, and all the others."""
    figure, (left, right) = new_figure(Path('report.html'), (12.0, 4.2), 1, 2)
    shown = [outcome for outcome in outcomes if outcome.recognition]
    family = [outcome for outcome in shown if _is_family(outcome)]
    ours = [outcome for outcome in shown if _name(outcome) == OURS]
    for panel, group, title in (
            (left, [outcome for outcome in shown if outcome not in family] + ours,
             f'{OURS} and the other encoders'),
            (right, family, f'{OURS}, its variants and controls')):
        for k, outcome in enumerate(group):
            _curve(panel, outcome, k)
        if group:
            panel.legend(loc='lower left', fontsize=8, frameon=False)
        panel.set(xlabel='recall', ylabel='precision', xlim=(0.0, 1.01), ylim=(0.4, 1.01))
        panel.set_title(title, fontsize=10)
        panel.grid(color='0.92')
    return _png(figure)


def _name(outcome: Outcome) -> str:
    return outcome.runs[0].row.encoder


def _is_family(outcome: Outcome) -> bool:
    return _name(outcome).startswith(('dlsc', 'image_', 'patches_'))


def _curve(panel, outcome: Outcome, number: int) -> None:
    style = {'color': COLOURS[number % len(COLOURS)],
             'linestyle': STYLES[number // len(COLOURS)], 'linewidth': 1.3}
    if _name(outcome) == OURS:
        style = {'color': FINAL['color'], 'linewidth': 2.6}
    recognition = outcome.recognition
    panel.plot(recognition.recall, recognition.precision, label=_name(outcome), **style)


def _png(figure) -> bytes:
    picture = BytesIO()
    figure.savefig(picture, format='png', dpi=90)
    return picture.getvalue()
