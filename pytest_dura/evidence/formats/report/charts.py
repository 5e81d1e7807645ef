"""The plot of clearance times: where everything stands; the template draws it as SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import floor, log10
from typing import Any

LEFT, RIGHT, TOP = 8.0, 712.0, 8.0
ROW = 46.0
"""Height of a case: its name, and its runs below."""
JITTER = (0.0, 4.0, -4.0, 2.0, -2.0)
"""Runs of nearly the same time are shifted up and down in turn, so that each can be seen."""


@dataclass(frozen=True)
class ClearanceRow:
    """A case of the plot.

    Args:
        case: Id of the case.
        times: Of single runs, in s.
        cleared: Runs that cleared, of which ``times`` may hold the first only.
        mean: Over all of them, in s.
        sd: Standard deviation, in s; ``None`` for a single run.
    """

    case: str
    times: Sequence[float]
    cleared: int
    mean: float | None
    sd: float | None


def clearance_chart(rows: Sequence[ClearanceRow]) -> Mapping[str, Any]:
    """The plot's lines, dots and labels, in its own coordinates.

    Args:
        rows: At least one, each with at least one run.
    """
    greatest = max(max(row.times) for row in rows)
    greatest = max([greatest, *((row.mean or 0.0) + (row.sd or 0.0) for row in rows)])
    step = tick_step(greatest)
    end = step * (floor(greatest / step + 1e-9) + 1)
    scale = (RIGHT - LEFT) / end
    ticks = [{"x": _x(i * step, scale), "value": i * step} for i in range(round(end / step) + 1)]
    height = TOP + ROW * len(rows)
    return {
        "width": RIGHT + 8.0,
        "height": height + 40.0,
        "left": LEFT,
        "right": RIGHT,
        "top": TOP,
        "bottom": height,
        "ticks": ticks,
        "rows": [_row(row, TOP + ROW * place, scale) for place, row in enumerate(rows)],
    }


def tick_step(greatest: float) -> float:
    """A step of 1, 2 or 5 times a power of ten that gives five to ten ticks up to ``greatest``."""
    if greatest <= 0:
        return 1.0
    power = 10.0 ** floor(log10(greatest / 5))
    return next(step for step in (power, 2 * power, 5 * power, 10 * power) if greatest / step < 10)


def _row(row: ClearanceRow, top: float, scale: float) -> Mapping[str, Any]:
    y = top + 31.0
    mean, sd = row.mean, row.sd or 0.0
    return {
        "case": row.case,
        "y": y,
        "label": top + 14.0,
        "dots": [
            {"x": _x(time, scale), "y": y + JITTER[place % len(JITTER)], "time": time}
            for place, time in enumerate(row.times)
        ],
        "times": sorted(row.times),
        "cleared": row.cleared,
        "mean": mean,
        "sd": row.sd,
        "x": None if mean is None else _x(mean, scale),
        "low": None if mean is None else _x(max(mean - sd, 0.0), scale),
        "high": None if mean is None else _x(mean + sd, scale),
    }


def _x(value: float, scale: float) -> float:
    return round(LEFT + value * scale, 1)
