"""The shapes of GSN as SVG: each kind of element has its own, with the notation's decorations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape

from pytest_dura.evidence.formats.gsn.wrapping import LINE, SIZE

_PAD = 10.0
_DIAMOND = 14.0
_SKEW = 14.0
COLOURS = {"supported": "#1a7f37", "violated": "#b42318", "undecided": "#9a6700"}
INK = "#1b1f24"


@dataclass
class Shape:
    """An element in the picture; ``x`` and ``y`` are those of its upper left corner.

    Args:
        id: Of the element.
        kind: ``Goal`` and so on, or ``Reference`` to an element that is drawn elsewhere.
        lines: Its text.
        width: Of the whole, decorations included.
        title: All of its text, for those who point at it or hear it read.
        bold: How many of the first lines are bold.
        undeveloped: Draw the diamond.
        defeated: Draw the cross.
        word: Of the verdict, which gives the colour.
        counts: What the shape stands for: ``{"supported": 12}``.
        height: Of the whole; set from the lines.
    """

    id: str
    kind: str
    lines: list[str]
    width: float
    title: str = ""
    bold: int = 0
    undeveloped: bool = False
    defeated: bool = False
    word: str = ""
    counts: Mapping[str, object] = field(default_factory=dict)
    x: float = 0.0
    y: float = 0.0
    height: float = 0.0

    def __post_init__(self) -> None:
        text = len(self.lines) * LINE
        if self.kind in {"Solution", "CounterSolution"}:
            self.height = self.width
        elif self.kind in {"Assumption", "Justification"}:
            self.height = text * 1.42 + _PAD
        else:
            self.height = text + 2 * _PAD - 2 + (_DIAMOND if self.undeveloped else 0)

    @property
    def body(self) -> float:
        """Height without the diamond below."""
        round_ = self.kind in {"Solution", "CounterSolution"}
        return self.height - (_DIAMOND if self.undeveloped and not round_ else 0)

    def svg(self) -> str:
        """One group with the outline, its decorations, and the text."""
        colour = COLOURS.get(self.word, INK)
        data = dict(self.counts)
        for key in ("undeveloped", "defeated"):
            if getattr(self, key):
                data[key] = "true"
        counts = "".join(f' data-{key}="{_attr(value)}"' for key, value in data.items())
        marks = self._decorations()
        return (
            f'<g data-id="{_attr(self.id)}" data-kind="{self.kind}" data-box="{self._box()}"'
            f"{counts}>"
            f"<title>{text_of(self.title or self.id)}</title>"
            f'<g class="{self.kind}" stroke="{colour}">{self._outline()}{marks}</g>'
            f"{self._text()}</g>"
        )

    def _box(self) -> str:
        return " ".join(f"{one:.1f}" for one in (self.x, self.y, self.width, self.height))

    def _outline(self) -> str:
        x, y, w, h = self.x, self.y, self.width, self.body
        if self.kind in {"Solution", "CounterSolution"}:
            return f'<circle cx="{x + w / 2:.1f}" cy="{y + w / 2:.1f}" r="{w / 2:.1f}"/>'
        if self.kind in {"Assumption", "Justification"}:
            return (
                f'<ellipse cx="{x + w / 2:.1f}" cy="{y + h / 2:.1f}" rx="{w / 2:.1f}" '
                f'ry="{h / 2:.1f}"/><text class="letter" x="{x + w - 5:.1f}" y="{y + h:.1f}">'
                f"{self.kind[0]}</text>"
            )
        if self.kind == "Strategy":
            points = [(x + _SKEW, y), (x + w, y), (x + w - _SKEW, y + h), (x, y + h)]
            return f'<polygon points="{_points(points)}"/>'
        round_ = min(h / 2, 16.0) if self.kind == "Context" else 0
        return f'<rect x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}" rx="{round_:.0f}"/>'

    def _decorations(self) -> str:
        x, y, w, h = self.x, self.y, self.width, self.body
        told = ""
        if self.undeveloped:
            middle, low, half = x + w / 2, y + h, _DIAMOND / 2
            points = [(middle, low), (middle + half, low + half), (middle, low + 2 * half),
                      (middle - half, low + half)]  # fmt: skip
            told += f'<polygon class="diamond" points="{_points(points)}"/>'
        if self.defeated:
            told += (
                f'<path class="cross" d="M{x:.1f} {y:.1f}L{x + w:.1f} {y + h:.1f}'
                f'M{x + w:.1f} {y:.1f}L{x:.1f} {y + h:.1f}"/>'
            )
        return told

    def _text(self) -> str:
        middle = self.x + self.width / 2
        top = self.y + (self.body - len(self.lines) * LINE) / 2 + SIZE - 0.5
        told = ""
        for i, line in enumerate(self.lines):
            weight = ' class="bold"' if i < self.bold else ""
            told += (
                f'<text x="{middle:.1f}" y="{top + i * LINE:.1f}"{weight}>{text_of(line)}</text>'
            )
        return told


@dataclass(frozen=True)
class Edge:
    """A relation: ``supportedBy``, ``inContextOf`` or ``challenges``, from corner to corner."""

    relation: str
    points: tuple[tuple[float, float], ...]

    def svg(self) -> str:
        """A line that ends in the arrow of its relation."""
        return (
            f'<polyline class="{self.relation}" points="{_points(self.points)}" '
            f'marker-end="url(#{self.relation})"/>'
        )


STYLE = (
    "text{font:12px Helvetica,Arial,'DejaVu Sans',sans-serif;text-anchor:middle;fill:#1b1f24}"
    ".left text,text.left{text-anchor:start}text.letter{font-weight:bold;stroke:none}"
    "text.bold{font-weight:bold}text.head{font-size:18px;font-weight:bold}text.warning{fill:#b42318;font-weight:bold}"
    "rect,circle,ellipse,polygon{fill:#fff;stroke-width:1.4}"
    ".Goal rect{fill:#f3f7fc}.Strategy polygon{fill:#f4f9f3}.Solution circle{fill:#fffdf2}"
    ".CounterGoal rect,.CounterSolution circle{fill:#fdf1ef;stroke-dasharray:5 3}"
    ".Reference rect{fill:#f3f3f3;stroke-dasharray:2 3}polygon.diamond{fill:#fff!important}"
    ".cross{stroke:#b42318;stroke-opacity:.35;stroke-width:2;fill:none}"
    "polyline{fill:none;stroke:#57606a;stroke-width:1.2}"
    "polyline.challenges{stroke:#b42318;stroke-dasharray:6 4}"
)
"""Colours are given with the picture's own background, so that it is the same in a dark page."""

MARKERS = (
    '<marker id="supportedBy" viewBox="0 0 10 10" refX="10" refY="5" markerWidth="8" '
    'markerHeight="8" orient="auto"><path d="M0 0L10 5L0 10z" fill="#57606a"/></marker>'
    '<marker id="inContextOf" viewBox="0 0 10 10" refX="10" refY="5" markerWidth="9" '
    'markerHeight="9" orient="auto"><path d="M0.7 0.8L9.5 5L0.7 9.2z" fill="#fff" '
    'stroke="#57606a"/></marker>'
    '<marker id="challenges" viewBox="0 0 10 10" refX="10" refY="5" markerWidth="9" '
    'markerHeight="9" orient="auto"><path d="M0 0.8L9.5 5L0 9.2" fill="none" '
    'stroke="#b42318"/></marker>'
)


def text_of(text: str) -> str:
    """Text for XML."""
    return escape(text, quote=False)


def _attr(value: object) -> str:
    return escape(str(value), quote=True)


def _points(points: object) -> str:
    assert isinstance(points, list | tuple)
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
