"""Coverage of the operating domain: which cells of pairs of parameters were drawn."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

from pytest_dura.evidence.case_model import CombinationsEntry, PairEntry
from pytest_dura.evidence.model import RecordHead
from pytest_dura.evidence.text import counted, name
from pytest_dura.reports.columns import Shown
from pytest_dura.reports.document import Level, Picture, Plot, not_drawn
from pytest_dura.reports.failure_modes import percent_text
from pytest_dura.reports.plots.plot import PlotKind
from pytest_dura.reports.plots.strips import picture_of, short_label
from pytest_dura.reports.svg import Svg, joined, points_of, tag

MAX_MAPS = 8
MAX_MAPPED = 8
"""Parameters of a scenario whose pairs are drawn."""
_MOST_NAMED = 5


def combination_text(known: CombinationsEntry) -> str:
    """Say how many cells of pairs of parameters were drawn."""
    share = percent_text(known.met / known.cells)
    text = (
        f"{known.met} of {known.cells} cells ({share} %) of {counted(known.pairs, 'pair')} of "
        "varied parameters were drawn, in fifths of ranges and single choices"
    )
    if known.unpaired:
        text += (
            f"; {counted(known.unpaired, 'parameter')} with no single value, or too many choices, "
        )
        text += "in no pair"
    return text + "."


def pair_lines(head: RecordHead) -> Iterator[str]:
    """Say what was drawn of pairs of parameters, and name those least covered."""
    known = head.coverage.combinations
    if known is None:
        return
    yield combination_text(known)
    for pair in [pair for pair in known.worst if pair.covered < 1][:_MOST_NAMED]:
        met = f"{pair.met} of {sum(map(len, pair.counts))} cells, by {counted(pair.drawn, 'draw')}"
        yield f"{pair.first} with {pair.second} of {pair.scenario}: {met}"


class PairPlots(PlotKind):
    """Draws a triangle of maps for each scenario whose parameters vary."""

    weight = Level.PAGE
    place = 4

    def plots(self) -> Iterator[Plot]:
        """Draw the maps."""
        known = self.head.coverage.combinations
        if known is None:
            return
        by_scenario: dict[str, list[PairEntry]] = defaultdict(list)
        for pair in known.worst:
            by_scenario[pair.scenario].append(pair)
        yield Plot(
            "Coverage of the operating domain",
            tuple(
                _picture(scenario, pairs, place)
                for place, (scenario, pairs) in enumerate(list(by_scenario.items())[:MAX_MAPS])
            ),
            f"{combination_text(known)} A cell with a stroke was never drawn; a number is how "
            "often a cell was. A pair of n draws can fill n cells at most.",
            left_out=not_drawn(len(list(by_scenario)[MAX_MAPS:]), "scenarios are"),
            shown=Shown.PAGE,
        )


def _picture(scenario: str, pairs: Sequence[PairEntry], place: int) -> Picture:
    names: dict[str, None] = {}
    for pair in sorted(pairs, key=lambda pair: (pair.first, pair.second)):
        names.update({pair.first: None, pair.second: None})
    parameters = sorted(names)[:MAX_MAPPED]
    shown = [pair for pair in pairs if {pair.first, pair.second} <= {*parameters}]
    title = f"Pairs of parameters of {name(scenario)}"
    return Picture(
        name(scenario),
        pair_plot(parameters, shown, f"pairs-{place}", title),
        left_out=not_drawn(len(pairs) - len(shown), "pairs are"),
        opened=place == 0,
    )


_MAP, _MAP_GAP = 74.0, 26.0


def pair_plot(parameters: Sequence[str], pairs: Sequence[PairEntry], ident: str, title: str) -> Svg:
    """Draw a triangle of maps, each of two parameters: a map of draws, and how many cells it met.

    Args:
        parameters: Names, in the order of rows and columns.
        pairs: A map for each two of them; the name that stands first among ``parameters`` first.
        ident: Begins the picture's anchors.
        title: What it shows.
    """
    left, top = 230.0, 22.0
    pitch = _MAP + _MAP_GAP
    place = {parameter: i for i, parameter in enumerate(parameters)}
    parts: list[Svg] = []
    for pair in pairs:
        x, y = left + place[pair.first] * pitch, top + (place[pair.second] - 1) * pitch
        parts.append(_pair_map(pair, x, y))
    for parameter, i in place.items():
        if i:
            y = top + (i - 1) * pitch + _MAP / 2 + 4
            parts.append(
                tag("text", short_label(parameter), class_="case", x=left - 8, y=y,
                    text_anchor="end")
            )  # fmt: skip
        if i < len(place) - 1:
            # Above the first map of its column, where the rows before it have none.
            corner = left + i * pitch, top + i * pitch - 6
            parts.append(
                tag("text", short_label(parameter), class_="case", x=corner[0], y=corner[1])
            )
    described = " ".join(
        f"{name(pair.first)} with {name(pair.second)}: {pair.met} of {_cells(pair)} cells."
        for pair in pairs
    )
    size = left + (len(place) - 1) * pitch + 160, top + (len(place) - 1) * pitch
    return picture_of(ident, title, described, size, joined(parts))


def _pair_map(pair: PairEntry, x: float, y: float) -> Svg:
    """Draw the cells, the least part of the first parameter at the left, of the second below."""
    columns, rows = len(pair.counts), len(pair.counts[0])
    width, height = _MAP / columns, _MAP / rows
    most = max(max(row) for row in pair.counts)
    parts: list[Svg] = []
    for i, column in enumerate(pair.counts):
        for j, count in enumerate(column):
            left, top = x + i * width, y + (rows - 1 - j) * height
            kind = f"met-{min(1 + 3 * count // (most + 1), 3)}" if count else "unmet"
            parts.append(
                tag("rect", class_=kind, x=left + 0.5, y=top + 0.5, width=width - 1.0,
                    height=height - 1.0)
            )  # fmt: skip
            if not count:
                corners = [(left + 2, top + height - 2), (left + width - 2, top + 2)]
                parts.append(tag("polyline", class_="stroke", points=points_of(corners)))
            elif width > 9 and height > 9:
                middle = left + width / 2, top + height / 2 + 3.2
                parts.append(
                    tag("text", str(count) if count < 100 else "+", class_=f"count {kind}-ink",
                        x=middle[0], y=middle[1], text_anchor="middle")
                )  # fmt: skip
    parts.append(
        tag("text", f"{pair.met} of {_cells(pair)}", class_="tick", x=x + _MAP / 2, y=y + _MAP + 13,
            text_anchor="middle")
    )  # fmt: skip
    return joined(parts)


def _cells(pair: PairEntry) -> int:
    return sum(map(len, pair.counts))
