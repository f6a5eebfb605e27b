"""The paper's figure on the encoder in three pictures: replay, run-away, atoms."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

import numpy as np

from .plots import new_figure
from ..core.mosaic import mosaic

# The palette of Okabe and Ito, as in plots.py; told apart in grey by line style.
WITH_QBS = {'color': '#0072B2', 'linestyle': '-', 'linewidth': 1.8}
WITHOUT_QBS = {'color': '#D55E00', 'linestyle': '--', 'linewidth': 1.8}
RANDOM = {'color': '#009E73', 'linestyle': '-.', 'linewidth': 0.9}

SMOOTHED_FRAMES = 25
# Errors beyond this many times the smallest median (replay) or the largest error in the stable
# range (run-away) are drawn at the upper edge: what explodes would flatten all the rest.
REPLAY_CEILING = 6.0
RUN_AWAY_CEILING = 1e2


def plot_replay(path: Path, gated: np.ndarray, always: np.ndarray,
                draws: Sequence[np.ndarray], note: str) -> None:
    """
    Write the replay errors as PNG: thin as they are, thick their moving average.

    Parameters
    ----------
    path : Path
        The picture to write.
    gated, always : ndarray of shape (n,)
        Errors after learning with QBS and without; NaN from the first that is not finite.
    draws : sequence of ndarray of shape (n,)
        Errors after learning from frames drawn at random, drawn as moving averages alone.
    note : str
        What the title says below its first line.

    Raises
    ------
    DlscQbsError
        matplotlib is missing.

    """
    figure, axes = new_figure(path, (10.0, 5.5))
    curves = [(errors, RANDOM, f'random frames, draw {k}') for k, errors in enumerate(draws, 1)]
    curves += [(always, WITHOUT_QBS, 'without QBS'), (gated, WITH_QBS, 'with QBS')]
    medians = [np.median(errors) for errors, _, _ in curves if not np.isnan(errors).any()]
    ceiling = REPLAY_CEILING * min(medians, default=np.inf)
    for errors, style, label in curves:
        drawn = np.minimum(errors, ceiling)
        if style is not RANDOM:
            axes.plot(drawn, alpha=0.35, linewidth=0.6, color=style['color'])
        axes.plot(_smoothed(drawn), label=label + _end(errors), **style)
    axes.set(title=f'Replay under the dictionary learned from the whole sequence\n{note}',
             xlim=(0, len(gated)), ylim=(0.0, None))
    _finish(figure, axes, path)


def plot_run_away(path: Path, gated, always, note: str) -> None:
    """
    Write the errors along continual learning, logarithmic, as PNG.

    `gated` and `always` are a pipeline.continual_learning.Learning. A cross ends a run whose next
    error is not finite; bars at the bottom mark frames outside the stable range.
    """
    figure, axes = new_figure(path, (10.0, 5.5))
    runs = [(always, WITHOUT_QBS, 'without QBS'), (gated, WITH_QBS, 'with QBS')]
    stable = np.concatenate([run.errors[run.stable] for run, _, _ in runs])
    ceiling = RUN_AWAY_CEILING * stable.max(initial=1.0)
    for height, (run, style, label) in enumerate(runs):
        errors = np.minimum(run.errors, ceiling)
        axes.semilogy(errors, label=label + _end(run.errors), **{**style, 'linewidth': 1.0})
        last = np.isfinite(errors).sum() - 1
        if last < len(errors) - 1:
            axes.plot(last, errors[last], 'X', markersize=10, color=style['color'])
        outside = np.flatnonzero(~run.stable & np.isfinite(run.errors))
        if len(outside):
            axes.plot(outside, np.full(len(outside), 0.03 + 0.04 * height), '|', markersize=8,
                      color=style['color'], transform=axes.get_xaxis_transform(),
                      label=f'{label}: outside the stable range')
    axes.set(title=f'Reprojection error along continual learning\n{note}',
             xlim=(0, len(gated.errors)))
    _finish(figure, axes, path)


def plot_atoms(path: Path, atoms: np.ndarray, height: int, width: int, note: str) -> None:
    """Write atoms of shape (n_atoms, height * width) as one PNG, each scaled by itself."""
    figure, axes = new_figure(path, (9.0, 7.5))
    axes.imshow(mosaic(atoms, height, width), cmap='gray', vmin=0, vmax=255,
                interpolation='nearest' if width < 100 else 'antialiased')
    axes.set_title(f'Atoms learned with QBS, zero in mid grey\n{note}')
    axes.set_axis_off()
    figure.savefig(path, dpi=150)


def _finish(figure, axes, path: Path) -> None:
    axes.set(xlabel='frame', ylabel='reprojection error $e_k$')
    axes.grid(color='0.9')
    axes.legend(loc='upper center', bbox_to_anchor=(0.5, -0.14), ncol=2, frameon=False)
    figure.savefig(path, dpi=150)


def _smoothed(errors: np.ndarray) -> np.ndarray:
    """Return the centred moving average over the frames there are, NaN where any is."""
    window = np.ones(min(SMOOTHED_FRAMES, len(errors)))
    sums = np.convolve(errors, window, 'same')
    return sums / np.convolve(np.ones(len(errors)), window, 'same')


def _end(errors: np.ndarray) -> str:
    """Say in a legend from which frame on there are no errors."""
    missing = np.isnan(errors)
    return f': not finite from frame {missing.argmax()}' if missing.any() else ''
