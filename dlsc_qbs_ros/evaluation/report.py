"""The report of all rows on all flights: one page that needs nothing else, and its figures."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import dataclass
from html import escape
from typing import Any, Mapping, Sequence

from . import report_tables as tables
from .paper_table import contests, OURS, PAPER
from .report_figures import precision_recall, trajectories
from .table import Outcome, Row

STYLE = '''
body {font: 15px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff;
      max-width: 76rem; margin: 2rem auto; padding: 0 1.5rem}
h1 {font-size: 1.7rem; line-height: 1.2} h2 {margin-top: 2.5rem; font-size: 1.25rem}
table {border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums}
th, td {padding: .25rem .7rem; text-align: right; white-space: nowrap;
        border-bottom: 1px solid #e3e3e3}
th {border-bottom: 2px solid #888} th:first-child, td:first-child {text-align: left}
tbody tr:hover {background: #f4f8fb}
.wide {overflow-x: auto} .muted {color: #888} figure {margin: 1rem 0} img {max-width: 100%}
.bar {display: inline-block; height: .8em; background: #0072B2} .second {background: #E69F00}
details {margin: .7rem 0} summary {cursor: pointer; font-weight: 600}
.lead {font-size: 1.1rem}
'''


@dataclass(frozen=True)
class Report:
    """
    All there is to tell.

    Attributes
    ----------
    outcomes : sequence of Outcome
        Flight by flight; the first run of each is at the mu of all flights, the last one at that
        of its flight, where there is any.
    meanings : mapping
        What each encoder is.
    same : mapping
        The encoders that are another by a second name, and that other's name.
    left_out : mapping
        The encoders that could not run, and why.
    config : mapping
        The effective configuration.
    decided : sequence of str
        What the encoders decide otherwise.
    facts : mapping
        Versions, seeds and whatever else it takes to make the same again.

    """

    outcomes: Sequence[Outcome]
    meanings: Mapping[str, str]
    same: Mapping[str, str]
    left_out: Mapping[str, str]
    config: Mapping[str, Any]
    decided: Sequence[str]
    facts: Mapping[str, Any]

    @property
    def rows(self) -> list[Row]:
        """Return the rows at one mu for all flights."""
        return [outcome.runs[0].row for outcome in self.outcomes]

    @property
    def tuned_rows(self) -> list[Row]:
        """Return the rows with mu tuned to each flight; where none is used, the same."""
        return [outcome.runs[-1].row for outcome in self.outcomes]

    @property
    def our_names(self) -> list[str]:
        """Return the names of the rows that are the same as ours."""
        us = self.same.get(OURS, OURS)
        return [OURS, us, *(name for name, other in self.same.items() if other == us)]

    def document(self) -> dict[str, Any]:
        """Return report.json; rows at one mu and tuned ones stand apart."""
        return {
            'rows': [outcome.as_json(outcome.runs[0]) for outcome in self.outcomes],
            'rows_tuned': [outcome.as_json(outcome.runs[-1]) for outcome in self.outcomes],
            'timing': [row.timing() for row in self.rows],
            'contests': [contest._asdict() for contest in contests(
                self.rows, self.tuned_rows, self.our_names)],
            'paper': {name: [errors._asdict() for errors in flights]
                      for name, flights in PAPER.items()},
            'encoders': dict(self.meanings), 'same': dict(self.same),
            'left_out': dict(self.left_out), 'decided': list(self.decided),
            'config': dict(self.config), 'facts': dict(self.facts)}

    def page(self) -> str:
        """Return report.html."""
        return (f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
                f'<title>DLSC-QBS: every row on every flight</title><style>{STYLE}</style></head>'
                f'<body>\n<h1>DLSC-QBS: every row on every flight</h1>\n'
                + '\n'.join((*self._results(), *self._pictures(), *self._conditions()))
                + '\n</body></html>\n')

    def _results(self) -> list[str]:
        return [
            _paragraph(self._summary(), 'lead'),
            *(_paragraph(f'Left out: {name}: {reason}') for name, reason in self.left_out.items()),
            _section('MAE_L | MAE_M in metres, one μ per row for all flights'),
            _paragraph('Means over the flights of a kind; the best in bold, the oracle apart. '
                       "The paper's numbers are of its own three flights, in its own warehouse: "
                       'they stand beside, not against.'),
            tables.error_table(self.rows, self.left_out),
            _section('The same with μ tuned to each flight for the least MAE_L, as in the paper'),
            tables.error_table(self.tuned_rows, self.left_out),
            _section(f'{OURS} at its one μ against every other row with μ tuned'),
            tables.contest_table(self.rows, self.tuned_rows, self.our_names),
            _section('Place recognition'),
            _paragraph('The best view at least 15 s old, right within 1 m and 0.5 rad; R99 and '
                       'R90: the share of revisits found at 99 % and 90 % precision. As it flew, '
                       'each code under the dictionary of its time; beside it, everything under '
                       'the last dictionary.'),
            tables.recognition_table(self.outcomes)]

    def _summary(self) -> str:
        found = contests(self.rows, self.tuned_rows, self.our_names)
        flights = len(self._by_flight())
        false = sum(row.false_closures or 0 for row in self.rows if row.encoder == OURS)
        return (f'{OURS}, with one configuration and one μ, is ahead of every other row, each '
                f'with its μ tuned to each flight, in {sum(one.is_won for one in found)} of '
                f'{len(found)} cells, over {flights} flight{"s" * (flights != 1)}; '
                f'its final maps hold {false} false closure{"s" * (false != 1)}.')

    def _pictures(self) -> list[str]:
        parts = [_section('Trajectories, one μ per row')]
        for flight, outcomes in self._drawn().items():
            parts.append(_picture(trajectories(outcomes), f'Trajectories of {flight} in metres'))
        parts.append(_section('Precision and recall of places, as it flew'))
        for flight, outcomes in self._drawn().items():
            if any(outcome.recognition for outcome in outcomes):
                parts.append(_picture(precision_recall(outcomes), f'Recognition in {flight}'))
        return parts

    def _drawn(self) -> dict[str, list[Outcome]]:
        """Return the outcomes to draw by flight: what has two names once, and ours as ours."""
        twins = {*self.same, *self.our_names} - {OURS}
        return {flight: [outcome for outcome in outcomes
                         if outcome.runs[0].row.encoder not in twins]
                for flight, outcomes in self._by_flight().items()}

    def _by_flight(self) -> dict[str, list[Outcome]]:
        flights: dict[str, list[Outcome]] = {}
        for outcome in self.outcomes:
            flights.setdefault(outcome.runs[0].row.flight, []).append(outcome)
        return flights

    def _conditions(self) -> list[str]:
        return [
            _section('Cost per frame'),
            _paragraph('Wall time on one core; blue the encoder, orange the back end.'),
            tables.cost_table(self.rows),
            _section('Every run'),
            _paragraph('* tuned on that very flight. Ground truth was moved into the SLAM frame '
                       '(no scale) to minimise MAE_L, ATE is after a least-squares alignment.'),
            _folded('Figures, counts and alignments', tables.detail_table(self.outcomes)),
            _section('How to make the same again'),
            tables.value_table(self.facts),
            _folded('The rows', tables.value_table({
                **self.meanings, **{name: f'the same here as {other}'
                                    for name, other in self.same.items()}})),
            _folded('What the rows decide otherwise',
                    '<br>'.join(map(escape, self.decided))),
            _folded('Effective configuration', tables.value_table(self.config))]


def _section(title: str) -> str:
    return f'<h2>{escape(title)}</h2>'


def _paragraph(text: str, kind: str = '') -> str:
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f'<p>{escape(text)}</p>'


def _folded(title: str, content: str) -> str:
    return f'<details><summary>{escape(title)}</summary>{content}</details>'


def _picture(png: bytes, caption: str) -> str:
    return (f'<figure><img alt="{escape(caption)}" '
            f'src="data:image/png;base64,{b64encode(png).decode()}">'
            f'<figcaption class="muted">{escape(caption)}</figcaption></figure>')
