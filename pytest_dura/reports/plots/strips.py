"""Strips: rows of numbers with boxes above one axis, as several plots draw them.

The page's style gives their colours, and shapes and texts say the same again: nothing is shown by
colour alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from pytest_dura.evidence.text import counted, name
from pytest_dura.reports.columns import number_text
from pytest_dura.reports.svg import Scale, Svg, joined, path_of, tag

MAX_ROWS = 48
"""Rows of a plot."""
MAX_DOTS = 60
"""Runs of a row that are drawn one by one; of more the box alone."""
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
    return picture_of(
        frame.ident,
        frame.title,
        " ".join(_described(strips)),
        (frame.width, y + _FOOT),
        joined([_axis(scale, frame, top, y), *parts]),
    )


def picture_of(
    ident: str, title: str, described: str, size: tuple[float, float], content: Svg
) -> Svg:
    """Draw a picture that reads without eyes.

    Args:
        ident: Begins its anchors, unique in the page.
        title: What it shows.
        described: What it shows, in words.
        size: Width and height.
        content: Its elements.
    """
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


def short_label(text: str) -> str:
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
        tag("text", short_label(strip.label), class_="case", x=frame.left, y=y + 4,
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


def dots_of(numbers: Sequence[float]) -> Sequence[float]:
    """The numbers of a row that are drawn one by one; none of too many."""
    return numbers if len(numbers) <= MAX_DOTS else ()


def bounded(rows: Sequence[Strip]) -> tuple[Sequence[Strip], int]:
    """The rows that are drawn, and how many are not."""
    return rows[:MAX_ROWS], len(rows[MAX_ROWS:])
