"""Where everything stands: a tree that grows downwards, indented, so that nothing overlaps.

An element stands above what supports it, and each of its children has rows of its own. What
surrounds or challenges it stands in a column to its right. Goals of verdicts and solutions, of
which there are many, stand side by side as small cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from pytest_dura.evidence.formats.gsn.element import Element
from pytest_dura.evidence.formats.gsn.folding import View, what
from pytest_dura.evidence.formats.gsn.shapes import Edge, Shape
from pytest_dura.evidence.formats.gsn.wrapping import BOLD, wrapped

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
class Picture:
    """Shapes and relations, and how high they reach."""

    shapes: list[Shape] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)
    height: float = 0.0


def laid_out(view: View, top: str, y: float) -> Picture:
    """The argument from its root on, below a height that something else takes."""
    layout = _Layout(view)
    layout.picture.height = layout.tree(top, MARGIN, y)
    return layout.picture


class _Layout:
    def __init__(self, view: View) -> None:
        self.view = view
        self.picture = Picture()
        self.drawn: set[str] = set()

    def tree(self, id_: str, x: float, y: float) -> float:
        """Draw an element with all that belongs to it, and return where the next may begin.

        Not recursive: a user's argument may be deeper than Python's stack.
        """
        waiting: list[tuple[str, float, Shape | None]] = [(id_, x, None)]
        while waiting:
            one, x, parent = waiting.pop()
            if parent is not None:
                # The trunk of a deep tree would leave the picture: it stays within it.
                x = min(x, MARGIN + 12 * _INDENT)
            shape, bottom = self._node(one, x, y)
            if parent is not None:
                trunk = parent.x + 12
                middle = shape.y + shape.body / 2
                low = parent.y + parent.body
                self._edge("supportedBy", (trunk, low), (trunk, middle), (shape.x, middle))
            y = bottom + _GAP
            if shape.kind == "Reference":
                continue
            element = self.view.argument[one]
            children = [child for child in element.supported_by if child in self.view.argument]
            small = [child for child in children if self._is_small(child)]
            if small:
                y = self._cells(shape, small, y)
            large = [child for child in children if not self._is_small(child)]
            waiting += [(child, x + _INDENT, shape) for child in reversed(large)]
        return y

    def _is_small(self, id_: str) -> bool:
        one = self.view.argument[id_]
        return one.kind in {"Solution", "CounterSolution"} or what(one) in _SMALL

    def _node(self, id_: str, x: float, y: float) -> tuple[Shape, float]:
        """The element and its column, or a reference to where it stands."""
        element = self.view.argument[id_]
        if id_ in self.drawn:
            lines = wrapped(f"see {element.id} above", _TREE_WIDTH - 20, 2)
            shape = Shape(id_, "Reference", lines, _TREE_WIDTH, title=element.text)
            self._put(shape, x, y)
            return shape, y + shape.height
        shape = self._shape(element, _TREE_WIDTH)
        self._put(shape, x, y)
        bottom = self._column(element, shape, x + _TREE_WIDTH + _SIDE_GAP, y)
        return shape, max(bottom, y + shape.height)

    def _column(self, element: Element, shape: Shape, x: float, y: float) -> float:
        """What challenges and surrounds an element, to its right, in as many columns as fit."""
        against = self.view.against.get(element.id, [])
        beside = [*against, *element.in_context_of]
        beside = [one for one in beside if one in self.view.argument and one not in self.drawn]
        fit = max(1, int((WIDTH - MARGIN - x + _SIDE_GAP) // (_SIDE_WIDTH + _SIDE_GAP)))
        columns = min(fit, 1 if len(beside) <= 2 else 2)
        width = _SIDE_WIDTH if columns > 1 else min(_SINGLE_WIDTH, WIDTH - MARGIN - x)
        ends = [y] * columns
        for one in beside:
            column = ends.index(min(ends))
            other = self._shape(self.view.argument[one], width)
            left = x + column * (_SIDE_WIDTH + _SIDE_GAP)
            self._put(other, left, ends[column])
            self._beside(shape, other, challenges=one in against, first=column == 0)
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
        return [one for one in ids if one in self.view.argument and one not in self.drawn]

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
        for one in waivers:
            other = self._shape(self.view.argument[one], _WAIVER_WIDTH, small=True)
            self._put(other, x, lane)
            middle = other.y + other.height / 2
            self._edge("inContextOf", (shape.x, middle), (other.x + other.width, middle))
            lane += other.height + _GAP
        left, height = shape.x + _CELL_GOAL + 2 * _GAP, y
        for one in self._present(self.view.against.get(id_, [])):
            other = self._shape(self.view.argument[one], _COUNTER_WIDTH, small=True)
            self._put(other, left, height)
            end = (shape.x + shape.width, min(other.y + 12, shape.y + shape.body))
            self._edge("challenges", (other.x, other.y + 12), end)
            height = self._under(other, self.view.argument[one].supported_by) + _GAP
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
        told = element.brief if small and element.brief else (element.text,)
        most = 4 if round_ else _MOST_LINES
        lines = [part for one in told for part in wrapped(one, room, most)][:most]
        heading = [] if small else wrapped(element.id, room, 2, BOLD)
        return Shape(
            element.id,
            element.kind,
            heading + lines,
            width,
            title=f"{element.id}: {element.text}",
            bold=len(heading),
            undeveloped=element.undeveloped,
            defeated=element.defeated,
            word=str(element.layers.get("verdict", "")),
            counts=self.view.counts.get(element.id, {}),
        )

    def _put(self, shape: Shape, x: float, y: float) -> None:
        shape.x, shape.y = x, y
        self.drawn.add(shape.id)
        self.picture.shapes.append(shape)

    def _edge(self, relation: str, *points: tuple[float, float]) -> None:
        self.picture.edges.append(Edge(relation, points))
