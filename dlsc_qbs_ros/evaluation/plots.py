"""One picture per flight and encoder: what the map made of the flight."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .table import Row
from ..core.geometry import between, compose
from ..core.types import Pose2
from ..errors import DlscQbsError

# The palette of Okabe and Ito: told apart with any colour vision, and in grey by line style.
TRUTH = {'color': '#000000', 'linewidth': 1.2, 'linestyle': '--'}
ODOMETRY = {'color': '#E69F00', 'linewidth': 1.2, 'linestyle': '-.'}
ONLINE = {'color': '#56B4E9', 'linewidth': 0.7}
FINAL = {'color': '#0072B2', 'linewidth': 1.8}
CLOSURE = {'color': '#D55E00', 'linewidth': 1.4, 'marker': 'o', 'markersize': 3.5}


def plot_run(path: Path, row: Row, result) -> None:
    """
    Write the picture of one run, a pipeline.runner.RunResult, as PNG.

    All is drawn in the SLAM frame: ground truth moved by the alignment of the row, odometry from
    the first pose of the estimate on. Ground truth breaks off where frames have none.

    Raises
    ------
    DlscQbsError
        matplotlib is missing.

    """
    figure, axes = new_figure(path, (10.0, 6.5))
    lines = [(result.poses, ONLINE, 'estimate, online'),
             (result.final_poses, FINAL, 'estimate, final map'),
             (anchored_odometry(result), ODOMETRY, 'odometry alone')]
    if row.metrics:
        lines.append((row.metrics.truth_m, TRUTH, 'ground truth'))
    lines.append((_closures(result), CLOSURE, f'loop closures ({len(result.closures)})'))
    for points, style, label in lines:
        axes.plot(points[:, 0], points[:, 1], label=label, **style)
    axes.plot(*result.poses[0, :2], 'D', color=FINAL['color'], label='start')
    axes.set(xlabel='x [m]', ylabel='y [m]', title=_title(row))
    axes.set_aspect('equal', adjustable='datalim')
    axes.grid(color='0.9')
    axes.legend(loc='upper left', bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, frameon=False)
    figure.savefig(path, dpi=150)


def new_figure(path: Path, size_inches: tuple[float, float], rows: int = 1, columns: int = 1):
    """
    Return a matplotlib figure and its axes, an array of them where there are several.

    Raises
    ------
    DlscQbsError
        matplotlib is missing, for the picture at a path.

    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise DlscQbsError(f'{path}: pictures need matplotlib: {error}') from error
    figure = Figure(figsize=size_inches, layout='constrained')
    return figure, figure.subplots(rows, columns)


def anchored_odometry(result) -> np.ndarray:
    """Return the odometry, shape (n, 3), moved to start where the estimate does."""
    start, *_ = poses = [Pose2(*pose) for pose in result.odometry]
    map_T_start = Pose2(*result.poses[0])
    return np.array([compose(map_T_start, between(start, pose)) for pose in poses])


def _closures(result) -> np.ndarray:
    """Return both ends of each closure and a row of NaN, where the pen lifts: (3 c, 2)."""
    ends = result.experiences[:, :2][result.closures]
    return np.concatenate([ends, np.full_like(ends[:, :1], np.nan)], axis=1).reshape(-1, 2)


def _title(row: Row) -> str:
    name, metrics = f'{row.flight}, {row.encoder}', row.metrics
    if metrics is None:
        return f'{name}\nno ground truth'
    return (f'{name}: MAE_L {metrics.mae_l:.3f} m | MAE_M {metrics.mae_m:.3f} m\n'
            f'odometry alone: {metrics.odometry_mae_l:.3f} m | {metrics.odometry_mae_m:.3f} m')
