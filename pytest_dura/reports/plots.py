"""Plots of the report: strips of numbers with boxes, a flow of counts, and maps of pairs.

All are inline pictures of plain numbers. The page's style gives their colours, and shapes and
texts say the same again: nothing is told by colour alone.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

from pytest_dura.evidence.text import counted, name
from pytest_dura.reports.columns import number_text
from pytest_dura.reports.svg import Scale, Svg, joined, path_of, points_of, tag

_FAR = 1e100
"""Greatest number that is drawn where it belongs."""
_NAME = 44
"""Characters of a row's name."""

FiveNumbers = tuple[float, float, float, float, float]
"""Least, first quartile, median, third quartile, greatest."""


def five_numbers(numbers: Iterable[float]) -> FiveNumbers | None:
    """Compute the quartiles, by straight lines between neighbours; ``None`` of no numbers."""
    ordered = sorted(numbers)
    if not ordered:
        return None

    def quantile(share: float) -> float:
        place = share * (len(ordered) - 1)
        below = math.floor(place)
        above = min(below + 1, len(ordered) - 1)
        if ordered[below] == ordered[above]:
            return ordered[below]
        share_above = place - below
        return ordered[below] * (1 - share_above) + ordered[above] * share_above

    return ordered[0], quantile(0.25), quantile(0.5), quantile(0.75), ordered[-1]


@dataclass(frozen=True)
class Strip:
    """A row of a plot: its box, single numbers, and what has no number.

    Args:
        label: Name of the row.
        five: The box with its whiskers; ``None`` for none.
        dots: Single numbers, drawn as circles.
        crosses: Numbers of violations, drawn as crosses.
        note: Text in the margin, such as how many runs have no number.
        alarming: Whether the note is marked.
        group: Heading above the first row of a group.
        form: Of the box: ``plain`` without a fault, ``filled`` with one, ``dashed`` without a role.
    """

    label: str
    five: FiveNumbers | None
    dots: Sequence[float] = ()
    crosses: Sequence[float] = ()
    note: str = ""
    alarming: bool = False
    group: str = ""
    form: Literal["plain", "filled", "dashed"] = "plain"


@dataclass(frozen=True)
class Frame:
    """What a plot is called, and how wide its parts are.

    Args:
        ident: Begins its anchors, unique in the page.
        title: What it shows.
        axis: Name of the axis, with the unit.
        width: Of the picture, in its own units.
        left: Width of the names.
        right: Width of the notes.
        zero: Whether zero is marked.
        against: What stands left of zero, such as ``violated``; empty for nothing.
    """

    ident: str
    title: str
    axis: str
    width: float = 980.0
    left: float = 290.0
    right: float = 180.0
    zero: bool = False
    against: str = ""


_ROW, _GROUP, _TOP, _FOOT = 22.0, 24.0, 10.0, 38.0
_JITTER = (0.0, 3.5, -3.5, 1.8, -1.8)
"""Numbers that are nearly equal are shifted up and down in turn, so that each can be seen."""


def strip_plot(strips: Sequence[Strip], frame: Frame) -> Svg:
    """Draw rows of numbers above one axis.

    Args:
        strips: The rows, from above; those of a group together.
        frame: Title, axis and measures of the picture.
    """
    scale = _scale_of(strips, frame)
    parts: list[Svg] = []
    y, group = _TOP + (14.0 if frame.against else 0.0), ""
    top = y
    for strip in strips:
        if strip.group and strip.group != group:
            group = strip.group
            parts.append(tag("text", name(group, 90), class_="group", x=4.0, y=y + 16))
            y += _GROUP
        parts.append(_row(strip, y + _ROW / 2, scale, frame))
        y += _ROW
    return _picture(
        frame.ident,
        frame.title,
        " ".join(_described(strips)),
        (frame.width, y + _FOOT),
        joined([_axis(scale, frame, top, y), *parts]),
    )


def _picture(
    ident: str, title: str, described: str, size: tuple[float, float], content: Svg
) -> Svg:
    width, height = size
    return tag(
        "svg",
        tag("title", name(title, 200), id=f"{ident}-title"),
        tag("desc", described, id=f"{ident}-desc"),
        content,
        class_="chart plot",
        viewBox=f"0 0 {width:.0f} {height:.0f}",
        width=f"{width:.0f}",
        role="img",
        aria_labelledby=f"{ident}-title {ident}-desc",
    )


def _short(text: str) -> str:
    """Write a name with an ellipsis in its middle, where it is too long for the margin."""
    shown = name(text)
    half = _NAME // 2
    return shown if len(shown) <= _NAME else f"{shown[:half]}\N{HORIZONTAL ELLIPSIS}{shown[-half:]}"


_MAX_DESCRIBED = 30


def _described(strips: Sequence[Strip]) -> Iterator[str]:
    for strip in strips[:_MAX_DESCRIBED]:
        median = "no number" if strip.five is None else f"median {number_text(strip.five[2])}"
        crosses = f", {counted(len(strip.crosses), 'violation')} marked" if strip.crosses else ""
        note = f", {strip.note}" if strip.note else ""
        yield f"{name(strip.group)} {name(strip.label)}: {median}{crosses}{note}.".strip()
    if len(strips) > _MAX_DESCRIBED:
        yield f"And {len(strips) - _MAX_DESCRIBED} more."


def _scale_of(strips: Sequence[Strip], frame: Frame) -> Scale:
    numbers = [
        min(max(number, -_FAR), _FAR)
        for strip in strips
        for number in (*(strip.five or ()), *strip.dots, *strip.crosses)
        if math.isfinite(number)
    ]
    start, end = frame.left + 8, frame.width - frame.right - 8
    if not numbers:
        return Scale(0.0, 1.0, start, end)
    low, high = min(numbers), max(numbers)
    # An axis of durations begins at zero as long as that leaves room for the numbers.
    if frame.zero or (low >= 0 and high - low > high / 4):
        low, high = min(low, 0.0), max(high, 0.0)
    return Scale.between(low, high, start, end)


def _axis(scale: Scale, frame: Frame, top: float, bottom: float) -> Svg:
    parts: list[Svg] = []
    zero = scale(0.0)
    if frame.against and scale.low < 0:
        parts.append(
            tag("rect", class_="against", x=scale.start, y=top, width=zero - scale.start,
                height=bottom - top)
        )  # fmt: skip
        parts.append(
            tag("text", f"\N{LEFTWARDS ARROW} {frame.against}", class_="tick", x=zero - 4,
                y=top - 4, text_anchor="end")
        )  # fmt: skip
    for tick in scale.ticks:
        x = scale(tick)
        parts.append(tag("line", class_="grid", x1=x, y1=top, x2=x, y2=bottom))
        # Steps that add up may miss zero by a rounding.
        shown = 0.0 if abs(tick) < scale.step / 1e6 else tick
        parts.append(
            tag("text", number_text(shown), class_="tick", x=x, y=bottom + 14, text_anchor="middle")
        )
    if frame.zero:
        parts.append(tag("line", class_="zero", x1=zero, y1=top - 3, x2=zero, y2=bottom + 3))
    middle = (scale.start + scale.end) / 2
    parts.append(
        tag("text", frame.axis, class_="tick", x=middle, y=bottom + 30, text_anchor="middle")
    )
    return joined(parts)


def _row(strip: Strip, y: float, scale: Scale, frame: Frame) -> Svg:
    def at(number: float) -> float:
        return scale(min(max(number, scale.low), scale.high))

    parts = [
        tag("text", _short(strip.label), class_="case", x=frame.left, y=y + 4,
            text_anchor="end")
    ]  # fmt: skip
    if strip.five is not None:
        low, first, median, third, high = map(at, strip.five)
        parts += [
            tag("line", class_="whisker", x1=low, y1=y, x2=high, y2=y),
            tag("rect", class_=f"box {strip.form}", x=first, y=y - 6, height=12.0,
                width=max(third - first, 1.0)),
        ]  # fmt: skip
    parts += [
        tag("circle", cx=at(number), cy=y + _JITTER[place % len(_JITTER)], r=2.2)
        for place, number in enumerate(strip.dots)
    ]
    if strip.five is not None:
        parts.append(tag("line", class_="median", x1=median, y1=y - 8, x2=median, y2=y + 8))
    parts += [_cross(at(number), y) for number in strip.crosses]
    if strip.note:
        parts.append(
            tag("text", strip.note, class_="note alarm" if strip.alarming else "note",
                x=frame.width - frame.right + 4, y=y + 4)
        )  # fmt: skip
    return joined(parts)


def _cross(x: float, y: float) -> Svg:
    size = 4.0
    strokes = [[(x - size, y - size), (x + size, y + size)],
               [(x - size, y + size), (x + size, y - size)]]  # fmt: skip
    return tag("path", class_="cross", d="".join(map(path_of, strokes)))


Step = tuple[str, ...]
"""States of a run from the first column to the one at which its way ends."""


@dataclass
class Flow:
    """Ways of runs through the steps of a chain.

    Args:
        columns: Headings of the steps.
        ways: How many runs took which way; a way may end before the last column.
        order: States from above to below; others follow by name.
        bad: States that are marked as violations.
        good: States that are the "yes" of their step.
    """

    columns: Sequence[str]
    ways: Mapping[Step, int]
    order: Sequence[str]
    bad: frozenset[str] = frozenset()
    good: frozenset[str] = frozenset()
    _places: dict[tuple[int, str], tuple[float, float]] = field(default_factory=dict, init=False)
    """Upper end and height of each node, by column and state."""

    def nodes(self) -> list[dict[str, int]]:
        """Count the runs in each state of each column, states from above to below."""
        counts: list[Counter[str]] = [Counter() for _ in self.columns]
        for way, runs in self.ways.items():
            for column, state in enumerate(way):
                counts[column][state] += runs
        return [dict(sorted(column.items(), key=lambda each: self._rank(each[0])))
                for column in counts]  # fmt: skip

    def links(self) -> dict[tuple[int, str, str], int]:
        """Count the runs from each state to each of the next column."""
        counts: Counter[tuple[int, str, str]] = Counter()
        for way, runs in self.ways.items():
            for column, (state, after) in enumerate(pairwise(way)):
                counts[column, state, after] += runs
        order = sorted(counts, key=lambda key: (key[0], self._rank(key[1]), self._rank(key[2])))
        return {key: counts[key] for key in order}

    def _rank(self, state: str) -> tuple[int, str]:
        known = self.order.index(state) if state in self.order else len(self.order)
        return known, state


_NODE = 12.0
_FLOW_WIDTH, _FLOW_HEIGHT, _FLOW_GAP = 1060.0, 90.0, 26.0


def flow_plot(flow: Flow, ident: str, title: str) -> Svg:
    """Draw ways of runs as bands between columns, as wide as their counts.

    Args:
        flow: The ways; at least one run.
        ident: Begins the picture's anchors.
        title: What it shows.
    """
    nodes, links = flow.nodes(), flow.links()
    total = sum(nodes[0].values())
    unit = _FLOW_HEIGHT / total
    step = (_FLOW_WIDTH - 170) / max(len(flow.columns) - 1, 1)
    places: dict[tuple[int, str], float] = {}
    drawn: list[Svg] = []
    bottom = 0.0
    for column, states in enumerate(nodes):
        x, y = 4 + column * step, 34.0
        drawn.append(tag("text", flow.columns[column], class_="group", x=x, y=16.0))
        for state, runs in states.items():
            places[column, state] = y
            height = max(runs * unit, 1.5)
            kind = "bad" if state in flow.bad else "yes" if state in flow.good else "no"
            drawn.append(tag("rect", class_=f"node {kind}", x=x, y=y, width=_NODE, height=height))
            shown = f"{state}: {runs}" if column else f"{runs}"
            mark = "\N{MULTIPLICATION X} " if kind == "bad" else ""
            drawn.append(
                tag("text", mark + shown, class_="halo", x=x + _NODE + 4, y=y + height / 2 + 4)
            )
            y += height + _FLOW_GAP * (0.6 if len(states) > 3 else 1.0)
        bottom = max(bottom, y - 8)
    bands = list(_bands(flow, links, places, unit, step))
    described = "; ".join(
        f"{flow.columns[column]} {state} to {flow.columns[column + 1]} {after}: {runs}"
        for (column, state, after), runs in links.items()
    )
    return _picture(ident, title, f"{counted(total, 'run')}. {described}.",
                    (_FLOW_WIDTH, bottom), joined([*bands, *drawn]))  # fmt: skip


def _bands(
    flow: Flow,
    links: Mapping[tuple[int, str, str], int],
    places: Mapping[tuple[int, str], float],
    unit: float,
    step: float,
) -> Iterator[Svg]:
    out, into = dict(places), dict(places)
    for (column, state, after), runs in links.items():
        x1, x2 = 4 + column * step + _NODE, 4 + (column + 1) * step
        y1, y2, height = out[column, state], into[column + 1, after], max(runs * unit, 1.0)
        out[column, state] += height
        into[column + 1, after] += height
        middle = (x1 + x2) / 2
        kind = "bad" if after in flow.bad else "yes" if after in flow.good else "no"
        curve = (
            f"M{x1:.1f} {y1:.1f}C{middle:.1f} {y1:.1f} {middle:.1f} {y2:.1f} {x2:.1f} {y2:.1f}"
            f"L{x2:.1f} {y2 + height:.1f}C{middle:.1f} {y2 + height:.1f} {middle:.1f} "
            f"{y1 + height:.1f} {x1:.1f} {y1 + height:.1f}Z"
        )
        yield tag("path", class_=f"band {kind}", d=curve)


@dataclass(frozen=True)
class PairMap:
    """Draws of two parameters.

    Args:
        first: Name of the one, whose parts are the rows.
        second: Name of the other one, whose parts are the columns.
        counts: Draws by row and column.
        met: Cells with any.
    """

    first: str
    second: str
    counts: Sequence[Sequence[int]]
    met: int

    @property
    def cells(self) -> int:
        """Number of cells."""
        return sum(map(len, self.counts))


_MAP, _MAP_GAP = 74.0, 26.0


def pair_plot(parameters: Sequence[str], pairs: Sequence[PairMap], ident: str, title: str) -> Svg:
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
                tag("text", _short(parameter), class_="case", x=left - 8, y=y,
                    text_anchor="end")
            )  # fmt: skip
        if i < len(place) - 1:
            # Above the first map of its column, where the rows before it have none.
            corner = left + i * pitch, top + i * pitch - 6
            parts.append(tag("text", _short(parameter), class_="case", x=corner[0], y=corner[1]))
    described = " ".join(
        f"{name(pair.first)} with {name(pair.second)}: {pair.met} of {pair.cells} cells."
        for pair in pairs
    )
    size = left + (len(place) - 1) * pitch + 160, top + (len(place) - 1) * pitch
    return _picture(ident, title, described, size, joined(parts))


def _pair_map(pair: PairMap, x: float, y: float) -> Svg:
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
        tag("text", f"{pair.met} of {pair.cells}", class_="tick", x=x + _MAP / 2, y=y + _MAP + 13,
            text_anchor="middle")
    )  # fmt: skip
    return joined(parts)
