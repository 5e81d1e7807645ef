"""Plot of a qualification: which requirement catches which mutant."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pytest_dura.qualification.results import Qualified
from pytest_dura.qualification.table import caught_text, results_of
from pytest_dura.reports.columns import Shown
from pytest_dura.reports.document import Level, Picture, Plot, not_drawn
from pytest_dura.reports.plots.plot import PlotKind
from pytest_dura.reports.plots.strips import picture_of, short_label
from pytest_dura.reports.svg import Svg, joined, points_of, tag

MAX_ROWS, MAX_COLUMNS = 120, 40
_CELL, _LEFT, _TOP = 16.0, 270.0, 96.0


class KillMatrix(PlotKind):
    """Draws a row for each mutant and a column for each requirement."""

    weight = Level.PAGE
    place = 90

    def plots(self) -> Iterator[Plot]:
        """Draw it; nothing without a qualification."""
        results = results_of(self.head)
        if not results:
            return
        killing = {kill.requirement for result in results for kill in result.kills}
        known = dict.fromkeys([*(each.id for each in self.head.requirements), *sorted(killing)])
        columns, rows = list(known)[:MAX_COLUMNS], results[:MAX_ROWS]
        left_out = [
            not_drawn(len(results) - len(rows), "defects are"),
            not_drawn(len(known) - len(columns), "requirements are"),
        ]
        title = "Which requirement catches which seeded defect"
        yield Plot(
            title,
            (Picture("Matrix", matrix(rows, columns, "kill-matrix", title), opened=True),),
            f"{caught_text(results).capitalize()}. A dark cell: the requirement catches the "
            "defect with the suite's own component; a light one: with a provoker alone. A row with "
            "strokes: nothing catches it. A defect that one run reveals is run no further.",
            left_out=" ".join(filter(None, left_out)),
            shown=Shown.PAGE,
        )


def matrix(rows: Sequence[Qualified], columns: Sequence[str], ident: str, title: str) -> Svg:
    """Draw the matrix.

    Args:
        rows: The results.
        columns: Ids of requirements.
        ident: Begins the picture's anchors.
        title: What it shows.
    """
    parts: list[Svg] = []
    for number, requirement in enumerate(columns):
        x = _LEFT + (number + 0.7) * _CELL
        turned = f"rotate(-60 {x:g} {_TOP - 6:g})"
        parts.append(
            tag("text", short_label(requirement), class_="tick", x=x, y=_TOP - 6, transform=turned)
        )
    for number, result in enumerate(rows):
        y = _TOP + number * _CELL
        label = short_label(result.name)
        parts.append(tag("text", label, class_="case", x=_LEFT - 8, y=y + 12, text_anchor="end"))
        for place, requirement in enumerate(columns):
            parts += _cell(result, requirement, _LEFT + place * _CELL, y)
    described = " ".join(
        f"{result.name}: {', '.join(_killers(result)) or result.status}." for result in rows
    )
    size = _LEFT + len(columns) * _CELL + 60, _TOP + len(rows) * _CELL + 6
    return picture_of(ident, title, described, size, joined(parts))


def _killers(result: Qualified) -> list[str]:
    return list(dict.fromkeys(kill.requirement for kill in result.kills))


def _cell(result: Qualified, requirement: str, x: float, y: float) -> Iterator[Svg]:
    provoked = [bool(kill.provoker) for kill in result.kills if kill.requirement == requirement]
    kind = "unmet" if not provoked else "met-1" if all(provoked) else "met-3"
    side = _CELL - 1.0
    yield tag("rect", class_=kind, x=x + 0.5, y=y + 0.5, width=side, height=side)
    if result.status != "caught":
        corners = [(x + 3, y + _CELL - 3), (x + _CELL - 3, y + 3)]
        yield tag("polyline", class_="stroke", points=points_of(corners))
