"""Drawing of an argument: what is drawn, and in which shapes.

An argument of hundreds of verdicts is folded: violations stay to be seen, a few of each
requirement; everything else is folded by its verdict. Widths of texts are estimated on the large
side, without a font at hand.
"""

from __future__ import annotations

import unicodedata
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

from pytest_dura.reports.gsn.element import Argument, Element
from pytest_dura.reports.svg import Point, Svg, path_of, points_of, tag

_FONT_SIZE = 12.0
"""Height of the letters in units of the picture."""
_LINE_HEIGHT = 15.0
BOLD_SIZE = 1.12 * _FONT_SIZE
"""Bold letters take as much room as larger ones."""

_NARROW, _USUAL, _BROAD, _FULL = 0.38, 0.62, 0.9, 1.1
"""Widths of letters in units of their height; those of DejaVu Sans, which is a wide face."""


def text_width(text: str, size: float = _FONT_SIZE) -> float:
    """The estimated width of a line."""
    return size * sum(map(_letter, text))


def wrap_text(text: str, width: float, most: int, size: float = _FONT_SIZE) -> list[str]:
    """The text in lines of at most this width; what does not fit into ``most`` lines ends in …."""
    lines: list[str] = []
    line = ""
    for piece in _breakable_pieces(text, width, size):
        joined = f"{line} {piece}" if line else piece
        if line and text_width(joined, size) > width:
            lines.append(line)
            line = piece
        else:
            line = joined
    lines += [line] if line else []
    if len(lines) <= most:
        return lines
    last = lines[most - 1]
    while last and text_width(last + " …", size) > width:
        last = last[:-1]
    return [*lines[: most - 1], f"{last} …"]


def _breakable_pieces(text: str, width: float, size: float) -> list[str]:
    """The text split at spaces; parts wider than a line are broken, best after a separator."""
    pieces: list[str] = []
    for part in text.split():
        rest = part
        while text_width(rest, size) > width:
            fits = 1
            while text_width(rest[: fits + 1], size) <= width:
                fits += 1
            cut = max((rest.rfind(mark, 1, fits) + 1 for mark in "/+~-_.;,@#"), default=0)
            cut = cut if cut > fits // 2 else fits
            pieces.append(rest[:cut])
            rest = rest[cut:]
        pieces.append(rest)
    return pieces


@lru_cache(maxsize=1024)
def _letter(char: str) -> float:
    if char in "iljtfrI.,:;'|!()[] /-":
        return _NARROW
    if unicodedata.east_asian_width(char) in "WF":
        return _FULL
    return _BROAD if char in "mwMW@%+~=<>—…≤" or not char.isascii() else _USUAL


_PAD = 10.0
_DIAMOND = 14.0
_SKEW = 14.0
COLOURS = {"supported": "#1a7f37", "violated": "#b42318", "undecided": "#9a6700"}
_INK = "#1b1f24"


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
        verdict: Such as ``violated``; it gives the colour.
        counts: Verdicts and requirements that the shape stands for: ``{"supported": 12}``.
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
    verdict: str = ""
    counts: Mapping[str, object] = field(default_factory=dict)
    x: float = 0.0
    y: float = 0.0
    height: float = 0.0

    def __post_init__(self) -> None:
        text = len(self.lines) * _LINE_HEIGHT
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

    def svg(self, *, legend: bool = False) -> Svg:
        """One group with the outline, its decorations, and the text.

        Args:
            legend: It is a sample of its kind, and stands for no element.
        """
        size = " ".join(f"{value:.1f}" for value in (self.x, self.y, self.width, self.height))
        data: dict[str, object] = {"legend" if legend else "id": self.id, "kind": self.kind}
        data |= {"size" if legend else "box": size, **self.counts}
        for key in ("undeveloped", "defeated"):
            if getattr(self, key):
                data[key] = "true"
        colour = COLOURS.get(self.verdict, _INK)
        refutes = self.kind.startswith("Counter") and self.verdict == "violated"
        return tag(
            "g",
            tag("title", self.title or self.id),
            tag(
                "g",
                *self._outline(),
                *self._decorations(),
                class_=f"{self.kind} defeats" if refutes else self.kind,
                stroke=colour,
            ),
            *self._text(),
            **{f"data-{key}": value for key, value in data.items()},
        )

    def _outline(self) -> Iterator[Svg]:
        x, y, w, h = self.x, self.y, self.width, self.body
        if self.kind in {"Solution", "CounterSolution"}:
            yield tag("circle", cx=x + w / 2, cy=y + w / 2, r=w / 2)
        elif self.kind in {"Assumption", "Justification"}:
            yield tag("ellipse", cx=x + w / 2, cy=y + h / 2, rx=w / 2, ry=h / 2)
            yield tag("text", self.kind[0], class_="letter", x=x + w - 5, y=y + h)
        elif self.kind == "Strategy":
            points = [(x + _SKEW, y), (x + w, y), (x + w - _SKEW, y + h), (x, y + h)]
            yield tag("polygon", points=points_of(points))
        else:
            corner = round(min(h / 2, 16.0)) if self.kind == "Context" else 0
            yield tag("rect", x=x, y=y, width=w, height=h, rx=corner)

    def _decorations(self) -> Iterator[Svg]:
        x, y, w, h = self.x, self.y, self.width, self.body
        if self.undeveloped:
            middle, low, half = x + w / 2, y + h, _DIAMOND / 2
            points = [(middle, low), (middle + half, low + half), (middle, low + 2 * half),
                      (middle - half, low + half)]  # fmt: skip
            yield tag("polygon", class_="diamond", points=points_of(points))
        if self.defeated:
            cross = path_of([(x, y), (x + w, y + h)]) + path_of([(x + w, y), (x, y + h)])
            yield tag("path", class_="cross", d=cross)

    def _text(self) -> Iterator[Svg]:
        middle = self.x + self.width / 2
        top = self.y + (self.body - len(self.lines) * _LINE_HEIGHT) / 2 + _FONT_SIZE - 0.5
        for i, line in enumerate(self.lines):
            bold = "bold" if i < self.bold else None
            yield tag("text", line, x=middle, y=top + i * _LINE_HEIGHT, class_=bold)


@dataclass(frozen=True)
class Edge:
    """A relation from corner to corner: ``supportedBy``, ``inContextOf``, ``challenges``.

    A challenge that refutes what it challenges is ``defeats``.
    """

    relation: str
    points: tuple[Point, ...]

    def svg(self) -> Svg:
        """A line that ends in the arrow of its relation."""
        corners, arrow = points_of(self.points), f"url(#{self.relation})"
        return tag("polyline", class_=self.relation, points=corners, marker_end=arrow)


STYLE = Svg(
    "text{font:12px Helvetica,Arial,'DejaVu Sans',sans-serif;text-anchor:middle;fill:#1b1f24}"
    ".left text,text.left{text-anchor:start}text.right{text-anchor:end}"
    "text.letter{font-weight:bold;stroke:none}text.bold{font-weight:bold}text.head{font-size:18px;font-weight:bold}text.warning{fill:#b42318;font-weight:bold}"
    "rect,circle,ellipse,polygon{fill:#fff;stroke-width:1.4}"
    ".Goal rect{fill:#f3f7fc}.Strategy polygon{fill:#f4f9f3}.Solution circle{fill:#fffdf2}"
    ".CounterGoal rect,.CounterSolution circle{fill:#fff8e5;stroke-dasharray:5 3}"
    ".defeats rect,.defeats circle{fill:#fdf1ef}"
    ".Reference rect{fill:#f3f3f3;stroke-dasharray:2 3}polygon.diamond{fill:#fff!important}"
    ".cross{stroke:#b42318;stroke-opacity:.35;stroke-width:2;fill:none}"
    "polyline{fill:none;stroke:#57606a;stroke-width:1.2}"
    "polyline.challenges{stroke:#9a6700;stroke-dasharray:6 4}"
    "polyline.defeats{stroke:#b42318;stroke-dasharray:6 4}"
    ".page{fill:#fff;stroke:#d0d7de}"
)
"""Colours are given with the picture's own background, so that it is the same in a dark page."""

MARKERS = Svg(
    '<marker id="supportedBy" viewBox="0 0 10 10" refX="10" refY="5" markerWidth="8" '
    'markerHeight="8" orient="auto"><path d="M0 0L10 5L0 10z" fill="#57606a"/></marker>'
    '<marker id="inContextOf" viewBox="0 0 10 10" refX="10" refY="5" markerWidth="9" '
    'markerHeight="9" orient="auto"><path d="M0.7 0.8L9.5 5L0.7 9.2z" fill="#fff" '
    'stroke="#57606a"/></marker>'
    + "".join(
        f'<marker id="{relation}" viewBox="0 0 10 10" refX="10" refY="5" markerWidth="9" '
        'markerHeight="9" orient="auto"><path d="M0 0.8L9.5 5L0 9.2" fill="none" '
        f'stroke="{colour}"/></marker>'
        for relation, colour in (("challenges", "#9a6700"), ("defeats", "#b42318"))
    )
)


_MOST_VERDICTS = 150
"""Verdicts that are drawn one by one."""
_SHOWN_VIOLATED = 3
_MOST_NAMES = 20


@dataclass(frozen=True)
class DrawnArgument:
    """An argument to draw.

    Args:
        argument: Its elements, folded ones in place of others.
        counts: By id, what an element stands for.
        folded: Sentences that say what was folded.
        against: By id, what challenges an element.
    """

    argument: Argument
    counts: dict[str, Counter[str]]
    folded: list[str] = field(default_factory=list)
    against: dict[str, list[str]] = field(default_factory=dict)


def drawn_argument(argument: Argument) -> DrawnArgument:
    """The argument, or what is drawn of a large one."""
    counts = {id_: _counts(element) for id_, element in argument.items()}
    view = DrawnArgument(dict(argument), counts)
    for id_, element in argument.items():
        if element.challenges:
            view.against.setdefault(element.challenges, []).append(id_)
    verdicts = sum(subject_of(element) == "verdict" for element in argument.values())
    _fold_cells(view, verdicts=verdicts > _MOST_VERDICTS)
    if verdicts > _MOST_VERDICTS:
        view.folded.append(f"{verdicts} verdicts are folded by requirement.")
    return view


def subject_of(element: Element) -> str:
    """Subject of an element, by its alias: ``verdict``, ``requirement``."""
    return element.alias.partition(":")[0]


def _counts(element: Element) -> Counter[str]:
    kind = subject_of(element)
    if kind == "verdict":
        return Counter({str(element.layers["verdict"]): 1})
    if kind in {"requirement", "waiver"}:
        return Counter({"requirements" if kind == "requirement" else "waived": 1})
    return Counter()


def _fold_cells(view: DrawnArgument, *, verdicts: bool) -> None:
    """Fold untested cells of each requirement, and verdicts where asked for."""
    for parent in list(view.argument.values()):
        groups: dict[str, list[Element]] = {}
        violated = 0
        for id_ in parent.supported_by:
            child = view.argument.get(id_)
            if child is None or subject_of(child) not in ("untested", "verdict"):
                continue
            status = str(child.layers.get("verdict", "untested"))
            violated += status == "violated"
            if status == "untested" or (
                verdicts and (status != "violated" or violated > _SHOWN_VIOLATED)
            ):
                groups.setdefault(status, []).append(child)
        for status, group in groups.items():
            if len(group) > 1:
                _fold(view, parent.id, status, group)


def _fold(view: DrawnArgument, parent: str, status: str, elements: list[Element]) -> None:
    """Put one goal in the place of several, with the counts of all that is below them."""
    id_ = f"G/{parent}/{status}"
    counts: Counter[str] = Counter()
    for element in elements:
        for below in _all_below(view, element.id):
            counts += view.counts.pop(below, Counter())
            view.argument.pop(below, None)
    several = len(elements)
    listed = _cells_text(elements)
    if status == "untested":
        text = f"The same in {several} cells that are untested: {listed}."
    else:
        text = f"{several} verdicts, each {status} and folded here: {listed}."
    view.argument[id_] = Element(
        id_,
        text,
        undeveloped=status in {"undecided", "untested"},
        defeated=status == "violated",
        alias=f"folded:{status}",
        layers={"verdict": status},
    )
    view.counts[id_] = counts
    folded = {element.id for element in elements}
    above = view.argument[parent]
    others = tuple(id_ for id_ in above.supported_by if id_ not in folded)
    view.argument[parent] = replace(above, supported_by=(*others, id_))


def _cells_text(elements: list[Element]) -> str:
    """The first cells of these elements by scenario, each with its faults in parentheses."""
    scenarios: dict[str, list[str]] = {}
    for element in elements[:_MOST_NAMES]:
        scenario, _, faults = element.alias.rpartition("@")[2].partition("+")
        scenarios.setdefault(scenario, []).append(faults)
    listed = [
        scenario + (f" ({', '.join(filter(None, faults))})" if any(faults) else "")
        for scenario, faults in scenarios.items()
    ]
    more = len(elements) - _MOST_NAMES
    return ", ".join(listed) + (f" and {more} more" if more > 0 else "")


def _all_below(view: DrawnArgument, start: str) -> Iterator[str]:
    """The element and all below it, with what challenges those."""
    waiting, seen = [start], set[str]()
    while waiting:
        id_ = waiting.pop()
        if id_ in seen or id_ not in view.argument:
            continue
        seen.add(id_)
        element = view.argument[id_]
        waiting += [*element.supported_by, *element.in_context_of, *view.against.get(id_, ())]
    yield from seen
