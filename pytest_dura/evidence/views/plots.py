"""Signals over time as a small SVG: no script, nothing from outside, readable light and dark."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray

from pytest_dura.evidence.text import one_line

Column = NDArray[np.float64]
Place = Callable[[float], float]

WIDTH, LEFT, RIGHT = 720, 64, 16
HEIGHT, GAP, TOP, BOTTOM = 96, 30, 34, 44
POINTS = 500
"""Points of a curve at most; a longer one is drawn by the least and greatest value of each part."""

LARGEST = 1e300

STYLE = """
text{font:12px system-ui,sans-serif;fill:#1f2328}.small{font-size:10px;fill:#57606a}
.back{fill:#fff}.frame{fill:none;stroke:#d0d7de}.bound{stroke:#57606a;stroke-dasharray:2 3}
.line{fill:none;stroke-width:1.6}.c0{stroke:#0550ae}.c1{stroke:#bc4c00;stroke-dasharray:5 3}
.mark{stroke:#cf222e;stroke-width:1.4}.told{fill:#cf222e}
@media(prefers-color-scheme:dark){text{fill:#e6edf3}.small{fill:#9198a1}.back{fill:#0d1117}
.frame{stroke:#3d444d}.bound{stroke:#9198a1}.c0{stroke:#6cb6ff}.c1{stroke:#f0883e}
.mark{stroke:#ff7b72}.told{fill:#ff7b72}}
"""


@dataclass(frozen=True)
class Panel:
    """One plot of several below each other.

    Args:
        name: What it shows.
        curves: Up to two columns of shape ``(ticks,)`` by name; the second one is dashed.
        bound: A value to draw a line at.
    """

    name: str
    curves: Mapping[str, Column]
    bound: float | None = None


def signal_plot(
    title: str,
    description: str,
    time: Column,
    panels: Sequence[Panel],
    mark: tuple[float, str] | None = None,
) -> str:
    """An SVG of panels over one axis of time.

    Args:
        title: Its title, which screen readers read first.
        description: What is to be seen, in words.
        time: Seconds, shape ``(ticks,)``.
        panels: What is drawn, from top to bottom.
        mark: A time and what happened there, drawn through all panels.
    """
    height = TOP + len(panels) * (HEIGHT + GAP) - GAP + BOTTOM
    start, end = (float(time[0]), float(time[-1])) if len(time) else (0.0, 0.0)
    span = (end - start) or 1.0

    def x(seconds: float) -> float:
        return LEFT + (seconds - start) / span * (WIDTH - LEFT - RIGHT)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}"',
        f'  width="{WIDTH}" height="{height}" role="img" aria-labelledby="title desc">',
        f'<title id="title">{_text(title)}</title><desc id="desc">{_text(description)}</desc>',
        f'<style>{STYLE}</style><rect class="back" width="100%" height="100%"/>',
        f'<text x="{LEFT}" y="18">{_text(title)}</text>',
    ]
    for index, panel in enumerate(panels):
        parts += _panel(panel, TOP + index * (HEIGHT + GAP), time, x)
    base = height - BOTTOM
    for seconds in (start, start + span / 2, end):
        parts.append(
            f'<text class="small" x="{x(seconds):.1f}" y="{base + 16}" text-anchor="middle">'
            f"{seconds:.3g} s</text>"
        )
    if mark is not None and math.isfinite(mark[0]):
        at = x(min(max(mark[0], start), end))
        anchor = "end" if at > WIDTH / 2 else "start"
        parts.append(f'<line class="mark" x1="{at:.1f}" x2="{at:.1f}" y1="{TOP}" y2="{base}"/>')
        parts.append(
            f'<text class="told" x="{at:.1f}" y="{base + 34}" text-anchor="{anchor}">'
            f"{_text(mark[1])}</text>"
        )
    return "\n".join([*parts, "</svg>"]) + "\n"


def _panel(panel: Panel, top: int, time: Column, x: Place) -> list[str]:
    least, greatest = _range(panel)
    room = (greatest - least) * 0.05 or max(abs(greatest) * 0.05, 0.5)
    low, high = least - room, greatest + room

    def y(value: float) -> float:
        return top + HEIGHT - (value - low) / (high - low) * HEIGHT

    right = WIDTH - RIGHT
    parts = [
        f'<rect class="frame" x="{LEFT}" y="{top}" width="{right - LEFT}" height="{HEIGHT}"/>',
        f'<text class="small" x="{right}" y="{top - 5}" text-anchor="end">{_legend(panel)}</text>',
        *(
            f'<text class="small" x="{LEFT - 6}" y="{y(value) + 3:.1f}" text-anchor="end">'
            f"{value:.4g}</text>"
            for value in sorted({least, greatest})
        ),
    ]
    if panel.bound is not None:
        level = y(panel.bound)
        parts.append(
            f'<line class="bound" x1="{LEFT}" x2="{right}" y1="{level:.1f}" y2="{level:.1f}"/>'
        )
    for index, column in enumerate(panel.curves.values()):
        path = _path(*_thinned(time, column), x, y)
        if path:
            parts.append(f'<path class="line c{min(index, 1)}" d="{path}"/>')
    return parts


def _legend(panel: Panel) -> str:
    others = [f"dashed: {name}" for name in list(panel.curves)[1:]]
    return _text(", ".join([panel.name, *others]))


def _range(panel: Panel) -> tuple[float, float]:
    """The least and greatest finite value, that of the bound included."""
    columns = [column[np.isfinite(column)] for column in panel.curves.values()]
    values = np.concatenate([*columns, [] if panel.bound is None else [panel.bound]])
    if not len(values):
        return 0.0, 1.0
    # Of values near the greatest float no number is left for their difference.
    low, high = np.clip([values.min(), values.max()], -LARGEST, LARGEST)
    return float(low), float(high)


def _thinned(time: Column, column: Column) -> tuple[Column, Column]:
    """At most :data:`POINTS` samples that keep every part's extremes."""
    if len(column) <= POINTS:
        return time, column
    chosen = {0, len(column) - 1}
    for part in np.array_split(np.arange(len(column)), POINTS // 3):
        values = column[part]
        gaps = part[~np.isfinite(values)]
        chosen.update(gaps[:1].tolist())
        if np.isfinite(values).any():
            chosen.add(int(part[np.nanargmin(np.where(np.isfinite(values), values, np.nan))]))
            chosen.add(int(part[np.nanargmax(np.where(np.isfinite(values), values, np.nan))]))
    kept = np.array(sorted(chosen))
    return time[kept], column[kept]


def _path(time: Column, column: Column, x: Place, y: Place) -> str:
    """Straight lines from sample to sample, broken where a sample is not finite."""
    found, broken = [], True
    for seconds, value in zip(time.tolist(), column.tolist(), strict=True):
        if not math.isfinite(value):
            broken = True
            continue
        step = "M" if broken else "L"
        found.append(f"{step}{x(seconds):.1f} {y(min(max(value, -LARGEST), LARGEST)):.1f}")
        broken = False
    return "".join(found)


def _text(text: str) -> str:
    return escape(one_line(text, 200))
