"""Drawing of an argument: what is drawn, where it stands, and in which shapes.

An argument of hundreds of verdicts is folded: violations stay to be seen, a few of each
requirement; everything else is folded by its verdict. The tree grows downwards, indented, so
that nothing overlaps: an element stands above what supports it, and each of its children has
rows of its own; what surrounds or challenges it stands in a column to its right. Goals of
verdicts and solutions, of which there are many, stand side by side as small cells. Widths of
texts are estimated on the large side, without a font at hand.
"""

from __future__ import annotations

import unicodedata
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

from pytest_dura.reports.gsn.element import Argument, Element
from pytest_dura.reports.svg import Point, Svg, path_of, points_of, tag

_FONT_SIZE = 12.0
"""Height of the letters in units of the picture."""
_LINE_HEIGHT = 15.0
_BOLD_SIZE = 1.12 * _FONT_SIZE
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
        return tag(
            "g",
            tag("title", self.title or self.id),
            tag("g", *self._outline(), *self._decorations(), class_=self.kind, stroke=colour),
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
    """A relation: ``supportedBy``, ``inContextOf`` or ``challenges``, from corner to corner."""

    relation: str
    points: tuple[Point, ...]

    def svg(self) -> Svg:
        """A line that ends in the arrow of its relation."""
        corners, arrow = points_of(self.points), f"url(#{self.relation})"
        return tag("polyline", class_=self.relation, points=corners, marker_end=arrow)


STYLE = Svg(
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

MARKERS = Svg(
    '<marker id="supportedBy" viewBox="0 0 10 10" refX="10" refY="5" markerWidth="8" '
    'markerHeight="8" orient="auto"><path d="M0 0L10 5L0 10z" fill="#57606a"/></marker>'
    '<marker id="inContextOf" viewBox="0 0 10 10" refX="10" refY="5" markerWidth="9" '
    'markerHeight="9" orient="auto"><path d="M0.7 0.8L9.5 5L0.7 9.2z" fill="#fff" '
    'stroke="#57606a"/></marker>'
    '<marker id="challenges" viewBox="0 0 10 10" refX="10" refY="5" markerWidth="9" '
    'markerHeight="9" orient="auto"><path d="M0 0.8L9.5 5L0 9.2" fill="none" '
    'stroke="#b42318"/></marker>'
)


_MOST_CELLS = 150
"""Verdicts and untested cells that are drawn one by one."""
_MOST_REQUIREMENTS = 60
_SHOWN_VIOLATED = 3
_SHOWN_REQUIREMENTS = 8
_COUNTED = ("supported", "violated", "undecided", "waived", "requirements")
_CELLS = ("verdict", "untested")


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
    cells = sum(_subject_of(element) in _CELLS for element in argument.values())
    if cells > _MOST_CELLS:
        _fold_cells(view)
        view.folded.append(f"{cells} verdicts and untested cells are folded by requirement.")
    requirements = sum(_subject_of(element) == "requirement" for element in argument.values())
    if requirements > _MOST_REQUIREMENTS:
        _fold_requirements(view)
        view.folded.append(f"{requirements} requirements are folded by kind, violated ones last.")
    return view


def _subject_of(element: Element) -> str:
    """Subject of an element, by its alias: ``verdict``, ``requirement``."""
    return element.alias.partition(":")[0]


def _counts(element: Element) -> Counter[str]:
    kind = _subject_of(element)
    if kind == "verdict":
        return Counter({str(element.layers["verdict"]): 1})
    if kind in {"requirement", "waiver"}:
        return Counter({"requirements" if kind == "requirement" else "waived": 1})
    return Counter()


def _fold_cells(view: DrawnArgument) -> None:
    for parent in list(view.argument.values()):
        groups: dict[str, list[Element]] = {}
        violated = 0
        for id_ in parent.supported_by:
            child = view.argument.get(id_)
            if child is None or _subject_of(child) not in _CELLS:
                continue
            status = str(child.layers.get("verdict", "untested"))
            violated += status == "violated"
            if status != "violated" or violated > _SHOWN_VIOLATED:
                groups.setdefault(status, []).append(child)
        for status, group in groups.items():
            if len(group) > 1:
                _fold(view, parent.id, status, group)


def _fold_requirements(view: DrawnArgument) -> None:
    for parent in list(view.argument.values()):
        children = [view.argument[id_] for id_ in parent.supported_by if id_ in view.argument]
        requirements = [child for child in children if _subject_of(child) == "requirement"]
        requirements.sort(key=lambda element: not element.defeated)
        rest = requirements[_SHOWN_REQUIREMENTS:]
        if len(rest) > 1:
            _fold(view, parent.id, "requirements", rest)


def _fold(view: DrawnArgument, parent: str, status: str, elements: list[Element]) -> None:
    """Put one goal in the place of several, with the counts of all that is below them."""
    id_ = f"G/{parent}/{status}"
    counts: Counter[str] = Counter()
    for element in elements:
        for below in _all_below(view, element.id):
            counts += view.counts.pop(below, Counter())
            view.argument.pop(below, None)
    counted = ", ".join(f"{counts[key]} {key}" for key in _COUNTED[:3] if counts[key])
    several = len(elements)
    text = f"{several} {status}" if status == "requirements" else f"{several} cells, {status}"
    detail = (counted,) if status == "requirements" and counted else ()
    view.argument[id_] = Element(
        id_,
        f"{text}: folded here, each is in assurance-case.gsn.yaml. {counted}",
        undeveloped=status in {"undecided", "untested"},
        defeated=status == "violated",
        alias=f"folded:{status}",
        layers={"verdict": status},
        brief=(text, *detail, "folded"),
    )
    view.counts[id_] = counts
    folded = {element.id for element in elements}
    for other in list(view.argument.values()):
        if folded & set(other.supported_by):
            others = tuple(id_ for id_ in other.supported_by if id_ not in folded)
            view.argument[other.id] = replace(other, supported_by=(*others, id_))


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


WIDTH = 1480.0
MARGIN = 24.0
_INDENT = 34.0
_GAP = 18.0
_TREE_WIDTH = 430.0
_SIDE_GAP = 44.0
_SIDE_WIDTH = 300.0
_SINGLE_WIDTH = 520.0
_CELL_GOAL = 188.0
_CIRCLE = 92.0
_COUNTER_WIDTH = 150.0
_WAIVER_WIDTH = 84.0
_MOST_LINES = 9
_SHOWN_CIRCLES = 1
_SMALL = ("verdict", "untested", "folded", "monitor")


@dataclass
class ArgumentPicture:
    """Shapes and relations, and how high they reach."""

    shapes: list[Shape] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)
    height: float = 0.0


def layout_argument(view: DrawnArgument, top: str, y: float) -> ArgumentPicture:
    """The argument from its root on, below a height that something else takes."""
    layout = _Layout(view)
    layout.picture.height = layout.tree(top, MARGIN, y)
    return layout.picture


class _Layout:
    def __init__(self, view: DrawnArgument) -> None:
        self.view = view
        self.picture = ArgumentPicture()
        self.drawn: set[str] = set()

    def tree(self, id_: str, x: float, y: float) -> float:
        """Draw an element with all that belongs to it, and return where the next may begin."""
        waiting: list[tuple[str, float, Shape | None]] = [(id_, x, None)]
        while waiting:
            current, x, parent = waiting.pop()
            if parent is not None:
                # The trunk of a deep tree would leave the picture: it stays within it.
                x = min(x, MARGIN + 12 * _INDENT)
            shape, bottom = self._node(current, x, y)
            if parent is not None:
                trunk = parent.x + 12
                middle = shape.y + shape.body / 2
                low = parent.y + parent.body
                self._edge("supportedBy", (trunk, low), (trunk, middle), (shape.x, middle))
            y = bottom + _GAP
            if shape.kind == "Reference":
                continue
            element = self.view.argument[current]
            children = [child for child in element.supported_by if child in self.view.argument]
            small = [child for child in children if self._is_small(child)]
            if small:
                y = self._cells(shape, small, y)
            large = [child for child in children if not self._is_small(child)]
            waiting += [(child, x + _INDENT, shape) for child in reversed(large)]
        return y

    def _is_small(self, id_: str) -> bool:
        element = self.view.argument[id_]
        return element.kind in {"Solution", "CounterSolution"} or _subject_of(element) in _SMALL

    def _node(self, id_: str, x: float, y: float) -> tuple[Shape, float]:
        """The element and its column, or a reference to where it stands."""
        element = self.view.argument[id_]
        if id_ in self.drawn:
            lines = wrap_text(f"see {element.id} above", _TREE_WIDTH - 20, 2)
            shape = Shape(id_, "Reference", lines, _TREE_WIDTH, title=element.text)
            self._put(shape, x, y)
            return shape, y + shape.height
        shape = self._shape(element, _TREE_WIDTH)
        self._put(shape, x, y)
        bottom = self._column(element, shape, x + _TREE_WIDTH + _SIDE_GAP, y)
        return shape, max(bottom, y + shape.height)

    def _column(self, element: Element, shape: Shape, x: float, y: float) -> float:
        """Draw what challenges and surrounds an element, right of it, in as many columns as fit."""
        against = self.view.against.get(element.id, [])
        beside = [*against, *element.in_context_of]
        beside = [id_ for id_ in beside if id_ in self.view.argument and id_ not in self.drawn]
        fit = max(1, int((WIDTH - MARGIN - x + _SIDE_GAP) // (_SIDE_WIDTH + _SIDE_GAP)))
        columns = min(fit, 1 if len(beside) <= 2 else 2)
        width = _SIDE_WIDTH if columns > 1 else min(_SINGLE_WIDTH, WIDTH - MARGIN - x)
        ends = [y] * columns
        for id_ in beside:
            column = ends.index(min(ends))
            other = self._shape(self.view.argument[id_], width)
            left = x + column * (_SIDE_WIDTH + _SIDE_GAP)
            self._put(other, left, ends[column])
            self._beside(shape, other, challenges=id_ in against, first=column == 0)
            ends[column] += other.height + _GAP
        return max(ends) - _GAP if beside else y

    def _beside(self, shape: Shape, other: Shape, *, challenges: bool, first: bool) -> None:
        """An edge between an element and one in its columns, along the gap before the first."""
        middle = other.y + other.body / 2
        right = shape.x + shape.width
        if shape.kind == "Strategy":
            right -= 7
        height = shape.y + shape.body / 2 + (-8 if challenges else 8)
        trunk = shape.x + shape.width + (14 if challenges else 26)
        path = [(right, height), (trunk, height), (trunk, middle), (other.x, middle)]
        if not first:
            # Over the first column and down the gap between the two.
            lane = shape.y - _GAP / 2
            inner = other.x - _SIDE_GAP / 2
            path = [(right, height), (trunk, height), (trunk, lane), (inner, lane),
                    (inner, middle), (other.x, middle)]  # fmt: skip
        if challenges:
            path.reverse()
        self._edge("challenges" if challenges else "inContextOf", *path)

    def _cells(self, parent: Shape, ids: Sequence[str], y: float) -> float:
        """Small elements side by side under a bus; a second row begins where the first is full."""
        left = parent.x + _INDENT
        x, bus, bottom = left, y, y
        for id_ in ids:
            width = self._cell_width(id_)
            if x > left and x + width > WIDTH - MARGIN:
                bus, x = bottom + _GAP, left
            shape, end = self._cell(id_, x, bus + _GAP)
            trunk, low = parent.x + 12, parent.y + parent.body
            middle = shape.x + shape.width / 2
            self._edge("supportedBy", (trunk, low), (trunk, bus), (middle, bus), (middle, shape.y))
            bottom = max(bottom, end)
            x += width + _GAP
        return bottom + _GAP

    def _cell_width(self, id_: str) -> float:
        element = self.view.argument[id_]
        if id_ in self.drawn:
            return _CELL_GOAL
        if element.kind in {"Solution", "CounterSolution"}:
            return _CIRCLE
        waiver = _WAIVER_WIDTH + _GAP if self._present(element.in_context_of) else 0.0
        counter = _COUNTER_WIDTH + 2 * _GAP if self.view.against.get(id_) else 0.0
        return waiver + _CELL_GOAL + counter

    def _present(self, ids: Sequence[str]) -> list[str]:
        return [id_ for id_ in ids if id_ in self.view.argument and id_ not in self.drawn]

    def _cell(self, id_: str, x: float, y: float) -> tuple[Shape, float]:
        """A goal with its solution below, its waiver to the left, its challenge to the right."""
        element = self.view.argument[id_]
        if id_ in self.drawn:
            shape = Shape(id_, "Reference", [f"see {id_}"[:24]], _CELL_GOAL, title=element.text)
            self._put(shape, x, y)
            return shape, y + shape.height
        waivers = self._present(element.in_context_of)
        round_ = element.kind in {"Solution", "CounterSolution"}
        shape = self._shape(element, _CIRCLE if round_ else _CELL_GOAL, small=True)
        self._put(shape, x + (_WAIVER_WIDTH + _GAP if waivers else 0), y)
        bottom = self._under(shape, element.supported_by)
        lane = y
        for waiver in waivers:
            other = self._shape(self.view.argument[waiver], _WAIVER_WIDTH, small=True)
            self._put(other, x, lane)
            middle = other.y + other.height / 2
            self._edge("inContextOf", (shape.x, middle), (other.x + other.width, middle))
            lane += other.height + _GAP
        left, height = shape.x + _CELL_GOAL + 2 * _GAP, y
        for challenger in self._present(self.view.against.get(id_, [])):
            other = self._shape(self.view.argument[challenger], _COUNTER_WIDTH, small=True)
            self._put(other, left, height)
            end = (shape.x + shape.width, min(other.y + 12, shape.y + shape.body))
            self._edge("challenges", (other.x, other.y + 12), end)
            height = self._under(other, self.view.argument[challenger].supported_by) + _GAP
        return shape, max(bottom, lane - _GAP, height - _GAP)

    def _under(self, shape: Shape, ids: Sequence[str]) -> float:
        """The first solution in a circle below; its element's text tells of the others."""
        bottom = shape.y + shape.height
        for id_ in self._present(ids)[:_SHOWN_CIRCLES]:
            other = self._shape(self.view.argument[id_], _CIRCLE, small=True)
            self._put(other, shape.x + (shape.width - _CIRCLE) / 2, bottom + _GAP)
            middle = other.x + _CIRCLE / 2
            self._edge("supportedBy", (middle, shape.y + shape.height), (middle, other.y))
            bottom = other.y + other.height
        return bottom

    def _shape(self, element: Element, width: float, *, small: bool = False) -> Shape:
        round_ = element.kind in {"Solution", "CounterSolution"}
        oval = element.kind in {"Assumption", "Justification"}
        room = width * (0.8 if round_ else 0.74 if oval else 1.0) - (0 if round_ or oval else 26)
        brief = element.brief if small and element.brief else (element.text,)
        most = 4 if round_ else _MOST_LINES
        lines = [part for text in brief for part in wrap_text(text, room, most)][:most]
        heading = [] if small else wrap_text(element.id, room, 2, _BOLD_SIZE)
        return Shape(
            element.id,
            element.kind,
            heading + lines,
            width,
            title=f"{element.id}: {element.text}",
            bold=len(heading),
            undeveloped=element.undeveloped,
            defeated=element.defeated,
            verdict=str(element.layers.get("verdict", "")),
            counts=self.view.counts.get(element.id, {}),
        )

    def _put(self, shape: Shape, x: float, y: float) -> None:
        shape.x, shape.y = x, y
        self.drawn.add(shape.id)
        self.picture.shapes.append(shape)

    def _edge(self, relation: str, *points: Point) -> None:
        self.picture.edges.append(Edge(relation, points))
