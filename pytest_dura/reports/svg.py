"""SVG for every picture: elements whose texts are escaped, paths, and scales with their ticks."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from pytest_dura.evidence.text import html

NAMESPACE = "http://www.w3.org/2000/svg"
Point = tuple[float, float]


class Svg(str):
    """Markup made by :func:`tag`, or a constant of this package: it is not escaped again."""

    __slots__ = ()

    def _repr_svg_(self) -> str:
        """Return what a notebook shows."""
        return str(self)

    def __html__(self) -> Svg:
        """Return itself, by which Jinja knows that it is escaped."""
        return self


def tag(name: str, /, *content: str, **attributes: object) -> Svg:
    """Make an element.

    Args:
        name: Its name.
        content: Elements as they are, and texts, which are escaped.
        attributes: Values by name: ``text_anchor`` is ``text-anchor``, ``class_`` is ``class``.
            Floats have one decimal; ``None`` leaves an attribute out.
    """
    start = name + "".join(
        f' {key.rstrip("_").replace("_", "-")}="{_attribute(value)}"'
        for key, value in attributes.items()
        if value is not None
    )
    return Svg(f"<{start}>{joined(content)}</{name}>" if content else f"<{start}/>")


def joined(content: Iterable[str], between: str = "") -> Svg:
    """Join elements and texts; texts are escaped."""
    return Svg(
        between.join(part if isinstance(part, Svg) else html(part, quote=False) for part in content)
    )


def document(width: int, height: int, /, *content: str, **attributes: object) -> Svg:
    """Make a picture that stands alone, with one of these elements on a line.

    Its size is an attribute unless ``attributes`` say otherwise.
    """
    size = {"viewBox": f"0 0 {width} {height}", "width": width, "height": height}
    lines = joined(("", *content, ""), "\n")
    return tag("svg", lines, xmlns=NAMESPACE, **{**size, **attributes})


def path_of(points: Iterable[Point]) -> str:
    """Write the path of straight lines from point to point, broken where one is not finite."""
    pieces, command = [], "M"
    for x, y in points:
        if math.isfinite(x) and math.isfinite(y):
            pieces.append(f"{command}{x:.1f} {y:.1f}")
            command = "L"
        else:
            command = "M"
    return "".join(pieces)


def points_of(points: Iterable[Point]) -> str:
    """Write the corners of a polygon or a polyline."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


@dataclass(frozen=True)
class Scale:
    """Straight scale from values to places in a picture.

    Args:
        low: A value.
        high: Another one.
        start: Where the first stands.
        end: Where the other one stands.
        step: From tick to tick.
    """

    low: float
    high: float
    start: float
    end: float
    step: float = 1.0

    def __call__(self, value: float) -> float:
        """Return the place of a value."""
        return self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)

    @classmethod
    def between(cls, low: float, high: float, start: float, end: float) -> Scale:
        """Make a scale from the last tick up to a value to the first tick from another one on."""
        step = _tick_step(high - low if high > low else max(abs(high), 1.0))
        first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
        return cls(first * step, max(last, first + 1) * step, start, end, step)

    @property
    def ticks(self) -> list[float]:
        """Values from ``low`` to ``high``."""
        count = round((self.high - self.low) / self.step)
        return [self.low + i * self.step for i in range(count + 1)]


def _tick_step(greatest: float) -> float:
    """Return 1, 2 or 5 times a power of ten that gives five to ten ticks up to a value above 0."""
    power = 10.0 ** math.floor(math.log10(greatest / 5))
    return next(step for step in (power, 2 * power, 5 * power, 10 * power) if greatest / step < 10)


def _attribute(value: object) -> str:
    return html(f"{value:.1f}" if isinstance(value, float) else str(value))
