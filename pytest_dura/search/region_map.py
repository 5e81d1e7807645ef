"""Plot of the regions in which a search's violations lie."""

from __future__ import annotations

from collections.abc import Iterator

from pytest_dura.reports.columns import Shown, number_text
from pytest_dura.reports.document import Level, Picture, Plot, not_drawn
from pytest_dura.reports.plots.plot import PlotKind
from pytest_dura.reports.plots.strips import picture_of, short_label
from pytest_dura.reports.svg import Scale, Svg, joined, path_of, tag
from pytest_dura.search.region_data import Axis, Map, Region
from pytest_dura.search.region_table import (
    example_text,
    numbered,
    probability_text,
    region_name,
    regions_of,
    where_text,
)

MAX_MAPS = 8
_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _FOOT = 620.0, 380.0, 76.0, 16.0, 14.0, 44.0
_CROSS = 3.5


class RegionMaps(PlotKind):
    """Draws a map for each region: the two numbers that tell most, its box, and the points."""

    weight = Level.PAGE
    place = 80

    def plots(self) -> Iterator[Plot]:
        """Draw them; nothing without a region."""
        known = [
            (number, region, region.map)
            for number, region in numbered(regions_of(self.head))
            if region.map is not None
        ]
        if not known:
            return
        pictures = [
            Picture(
                region_name(number, region),
                region_map(region, map_, f"region-{place}"),
                about_text(region),
            )
            for place, (number, region, map_) in enumerate(known[:MAX_MAPS])
        ]
        yield Plot(
            "Where failures lie",
            tuple(pictures),
            "A cross is a point of the search that violates with the region's event, a circle one "
            "that does not: those with the least margins. The frame is the region. The axes are "
            "the two numbers that separate violations best. The search looked where violations "
            "were expected, so that the density of points shows no probability.",
            left_out=not_drawn(len(known) - len(pictures), "regions are"),
            shown=Shown.PAGE,
        )


def about_text(region: Region) -> str:
    """Say what a map shows: where, what, how probable, and the example."""
    texts = [where_text(region), region.event]
    if region.mass is not None:
        texts.append(f"probability of a violation there {probability_text(region.mass)}")
    if region.example is not None:
        texts.append(f"example {example_text(region.example)}")
    return "; ".join(texts) + "."


def region_map(region: Region, map_: Map, ident: str) -> Svg:
    """Draw a map.

    Args:
        region: The region.
        map_: Its map.
        ident: Begins the picture's anchors.
    """
    x = Scale(map_.x.low, _above(map_.x), _LEFT, _WIDTH - _RIGHT)
    y = _vertical(map_)
    parts = [_axis_of(map_.x, x), _axis_of(map_.y, y, upright=True), _frame(region, map_, x, y)]
    parts += [tag("circle", cx=x(a), cy=y(b), r=2.2) for a, b in map_.others]
    parts += [_cross(x(a), y(b)) for a, b in map_.violating]
    described = (
        f"{len(map_.violating)} violating points and {len(map_.others)} others over "
        f"{map_.x.name} and {'the margin' if map_.y is None else map_.y.name}. {about_text(region)}"
    )
    return picture_of(ident, f"Map: {region.event}", described, (_WIDTH, _HEIGHT), joined(parts))


def _above(axis: Axis) -> float:
    """Return the upper end of an axis, above its lower one."""
    return axis.high if axis.high > axis.low else axis.low + 1.0


def _vertical(map_: Map) -> Scale:
    bottom, top = _HEIGHT - _FOOT, _TOP
    if map_.y is not None:
        return Scale(map_.y.low, _above(map_.y), bottom, top)
    margins = [b for _, b in (*map_.violating, *map_.others)] or [0.0]
    return Scale.between(min(0.0, *margins), max(0.0, *margins), bottom, top)


def _axis_of(axis: Axis | None, scale: Scale, *, upright: bool = False) -> Svg:
    """Draw an axis with its ticks and its name; without one, that of margins."""
    name = "margin" if axis is None else short_label(axis.name)
    unit = "" if axis is None or axis.unit in ("", "1") else f", {axis.unit}"
    parts: list[Svg] = []
    for place, text in _ticks(axis, scale):
        if upright:
            parts += [
                tag("line", class_="grid", x1=_LEFT, y1=place, x2=_WIDTH - _RIGHT, y2=place),
                tag("text", text, class_="tick", x=_LEFT - 6, y=place + 4, text_anchor="end"),
            ]
        else:
            foot = _HEIGHT - _FOOT
            parts += [
                tag("line", class_="grid", x1=place, y1=_TOP, x2=place, y2=foot),
                tag("text", text, class_="tick", x=place, y=foot + 14, text_anchor="middle"),
            ]
    middle = (scale.start + scale.end) / 2
    at = (14.0, middle) if upright else (middle, _HEIGHT - 10)
    turned = f"rotate(-90 {at[0]:g} {at[1]:g})" if upright else None
    label = tag(
        "text", name + unit, class_="tick", x=at[0], y=at[1], text_anchor="middle", transform=turned
    )
    return joined([*parts, label])


def _ticks(axis: Axis | None, scale: Scale) -> Iterator[tuple[float, str]]:
    if axis is not None and axis.choices:
        for number, choice in enumerate(axis.choices):
            yield scale((number + 0.5) / len(axis.choices)), short_label(choice)
        return
    even = Scale.between(scale.low, scale.high, 0.0, 1.0)
    for tick in even.ticks:
        if scale.low <= tick <= scale.high:
            yield scale(tick), number_text(0.0 if abs(tick) < even.step / 1e6 else tick)


def _frame(region: Region, map_: Map, x: Scale, y: Scale) -> Svg:
    """Draw the box of the region on both axes; an axis that it does not bound is spanned."""
    bounds = {bound.axis.name: bound for bound in region.bounds}
    across, up = bounds.get(map_.x.name), bounds.get(map_.y.name if map_.y else "")
    left, right = (x.start, x.end) if across is None else (x(across.low), x(across.high))
    bottom, top = (y.start, y.end) if up is None else (y(up.low), y(up.high))
    return tag(
        "rect", class_="box dashed", x=left, y=top, width=max(right - left, 1.0),
        height=max(bottom - top, 1.0), fill_opacity="0.15",
    )  # fmt: skip


def _cross(x: float, y: float) -> Svg:
    strokes = [[(x - _CROSS, y - _CROSS), (x + _CROSS, y + _CROSS)],
               [(x - _CROSS, y + _CROSS), (x + _CROSS, y - _CROSS)]]  # fmt: skip
    return tag("path", class_="cross", d="".join(map(path_of, strokes)))
