"""The tables of the report as HTML."""

from __future__ import annotations

from html import escape
from math import degrees
from typing import Any, Callable, Iterable, Mapping, Sequence

from .paper_table import (
    contests, Errors, kind_of, mean_errors, ORACLE, OURS, PAPER, paper_errors)
from .place_recognition import Recognition
from .table import Outcome, Row


class Html(str):
    """Text that is HTML already."""


def table(header: Sequence[str], lines: Iterable[Sequence[Any]]) -> str:
    """Return a table; the first cell of each line is its name."""
    def row(tag: str, cells: Sequence[Any]) -> str:
        return '<tr>' + ''.join(
            f'<{tag}>{cell if isinstance(cell, Html) else escape(str(cell))}</{tag}>'
            for cell in cells) + '</tr>'
    body = '\n'.join(row('td', line) for line in lines)
    return (f'<div class="wide"><table><thead>{row("th", header)}</thead>'
            f'<tbody>\n{body}\n</tbody></table></div>')


def error_table(rows: Sequence[Row], left_out: Iterable[str] = ()) -> str:
    """
    Return the paper's table of some rows beside the paper's own numbers, the best in bold.

    An encoder that was left out stands there for the paper's numbers alone.
    """
    errors = mean_errors(rows)
    kinds = list(dict.fromkeys(kind for _, kind in errors))
    best = {kind: [min(values) for values in zip(*(
        found for (encoder, other), found in errors.items()
        if other == kind and encoder != ORACLE))] for kind in kinds}
    header = ['']
    for kind in kinds:
        header += [kind] + ['paper'] * has_paper(kind)
    lines = []
    for encoder in dict.fromkeys((*(name for name in left_out if name in PAPER),
                                  *(encoder for encoder, _ in errors))):
        line: list[Any] = [_named(encoder)]
        for kind in kinds:
            line.append(_pair(errors.get((encoder, kind)), best[kind]))
            if has_paper(kind):
                line.append(_muted(_pair(paper_errors(encoder, kind))))
        lines.append(line)
    return table(header, lines)


def has_paper(kind: str) -> bool:
    """Whether the paper has a flight of this kind."""
    return paper_errors(OURS, kind) is not None


def _named(encoder: str) -> Html:
    return Html(f'<b>{escape(encoder)}</b>' if encoder == OURS else escape(encoder))


def _pair(errors: Errors | None, best: Sequence[float] = ()) -> Html:
    if errors is None:
        return Html('–')
    cells = [f'<b>{value:.3f}</b>' if value in best[k:k + 1] else f'{value:.3f}'
             for k, value in enumerate(errors)]
    return Html(' | '.join(cells))


def _muted(cell: Html) -> Html:
    return Html(f'<span class="muted">{cell}</span>')


def contest_table(rows: Sequence[Row], tuned_rows: Sequence[Row], same: Iterable[str]) -> str:
    """Return our row at its one mu against the best other, tuned, and against the oracle."""
    return table(
        ('', OURS, 'best other row, tuned', 'won', ORACLE, 'ratio to it'),
        [(f'{contest.kind}, {contest.metric}', f'{contest.ours:.3f}',
          f'{contest.theirs:.3f} ({contest.rival})',
          'yes' if contest.is_won else f'no, by {contest.ours - contest.theirs:.3f} m',
          *(('–', '–') if contest.oracle is None else
            (f'{contest.oracle:.3f}', f'{contest.ours / contest.oracle:.2f}')))
         for contest in contests(rows, tuned_rows, same)])


def recognition_table(outcomes: Sequence[Outcome]) -> str:
    """Return top-1, R99 and R90 of each encoder, means over the flights of each kind."""
    groups: dict[tuple[str, str], dict[str, list[Recognition]]] = {}
    for outcome in outcomes:
        row = outcome.runs[0].row
        for name, found in ((row.encoder, outcome.recognition),
                            (f'{row.encoder}, under the last dictionary', outcome.under_last)):
            if found is not None:
                groups.setdefault(name, {}).setdefault(kind_of(row.flight), []).append(found)
    kinds = list(dict.fromkeys(kind_of(outcome.runs[0].row.flight) for outcome in outcomes))
    return table(
        ('', *(f'{kind}: top-1 / R99 / R90' for kind in kinds)),
        [(_named(name), *(_rates(of_kind.get(kind, [])) for kind in kinds))
         for name, of_kind in groups.items()])


def _rates(found: Sequence[Recognition]) -> str:
    def mean(figure: Callable[[Recognition], float]) -> str:
        return f'{sum(map(figure, found)) / len(found):.2f}'
    return ' / '.join((mean(lambda one: one.top_1), mean(lambda one: one.recall_at(0.99)),
                       mean(lambda one: one.recall_at(0.90)))) if found else '–'


def cost_table(rows: Sequence[Row]) -> str:
    """Return the time per frame of each encoder, the mean over all flights, with bars."""
    costs: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        timing = row.timing()
        costs.setdefault(row.encoder, []).append(
            (timing['encode_ms_per_frame'], timing['map_ms_per_code']))
    means = {encoder: [sum(part) / len(part) for part in zip(*parts)]
             for encoder, parts in costs.items()}
    most = max((sum(parts) for parts in means.values()), default=1.0)
    return table(
        ('', 'encode [ms]', 'match and map [ms]', 'together [ms]', ''),
        [(_named(encoder), f'{encode:.2f}', f'{match:.2f}', f'{encode + match:.2f}',
          Html(f'<span class="bar" style="width:{15 * encode / most:.2f}em"></span>'
               f'<span class="bar second" style="width:{15 * match / most:.2f}em"></span>'))
         for encoder, (encode, match) in means.items()])


def detail_table(outcomes: Sequence[Outcome]) -> str:
    """Return one line for each run of each flight and encoder: figures, mu, counts, alignment."""
    header = ('flight', 'encoder', 'MAE_L | MAE_M [m]', 'mu', 'ATE [m]', 'odometry [m]', 'frames',
              'view cells', 'experiences', 'closures', 'false', 'turned by [deg]',
              'moved by [m]')
    return table(header, [
        _detail(run.row) for outcome in outcomes for run in outcome.runs])


def _detail(row: Row) -> list[Any]:
    found = row.metrics
    counts = [row.counts[name] for name in ('view_cells', 'experiences', 'closures')]
    mu = '–' if row.threshold is None else f'{row.threshold:.3f}' + '*' * row.threshold_tuned
    false = '–' if row.false_closures is None else row.false_closures
    if found is None:
        return [row.flight, _named(row.encoder), '–', mu, '–', '–', row.frames, *counts, false,
                '–', '–']
    x_m, y_m = found.alignment.translation_m
    return [row.flight, _named(row.encoder), _pair(Errors(found.mae_l, found.mae_m)), mu,
            f'{found.ate_rmse_m:.3f}',
            _pair(Errors(found.odometry_mae_l, found.odometry_mae_m)), row.frames, *counts,
            false, f'{degrees(found.alignment.rotation_rad):.1f}', f'{x_m:.2f}, {y_m:.2f}']


def value_table(values: Mapping[str, Any]) -> str:
    """Return names and values."""
    return table(('', ''), [(name, str(value)) for name, value in values.items()])
