"""Pages of an argument's picture: each in landscape, as a sheet of A3 or A4.

The first page has the top goal, and the goals of its branches by their whole texts; each branch
follows with all below it, and shares a page with others where it fits. In a branch, requirements
stand in columns, each above its verdicts. What surrounds an element stands below it, indented.
Lines run in lanes of their own, left of what they lead to, so that nothing overlaps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product

from pytest_dura.reports.gsn.drawing import (
    BOLD_SIZE,
    DrawnArgument,
    Edge,
    Shape,
    subject_of,
    wrap_text,
)
from pytest_dura.reports.gsn.element import Element
from pytest_dura.reports.svg import Point

WIDTH, HEIGHT = 1587.0, 1122.0
"""Of a page, at 96 units to the inch: A3 in landscape."""
MARGIN = 24.0
BETWEEN = 20.0
"""Units between two pages of the picture."""
_COLUMNS = 3
_LANES = 44.0
"""Width of the lanes left of each column."""
_COLUMN = (WIDTH - 2 * MARGIN - _COLUMNS * _LANES) / _COLUMNS
_INDENT = 26.0
_GAP = 12.0
_CIRCLE = 82.0
_MOST_LINES = 24
_LEAVES = ("verdict", "untested", "folded", "monitor", "not-shown", "accepted")


@dataclass
class Block:
    """Shapes that stand together, and their relations, from a corner at 0, 0.

    The first shape is the one that others refer to.
    """

    shapes: list[Shape] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)
    height: float = 0.0
    foot: Shape | None = None
    """The shape that supports what follows; by default the first."""

    def at(self, x: float, y: float) -> Block:
        """Move all to a corner."""
        for shape in self.shapes:
            shape.x, shape.y = shape.x + x, shape.y + y
        self.edges = [
            Edge(edge.relation, tuple((px + x, py + y) for px, py in edge.points))
            for edge in self.edges
        ]
        return self


@dataclass
class Section:
    """A child of a branch with all that supports it, which may go on in a next column."""

    head: Block
    leaves: list[Block]


Columns = list[list[tuple[Block, str]]]
"""Blocks of each column: a ``section``, a ``leaf`` of the one above, or ``again`` for its head."""


@dataclass
class Pages:
    """Where all stands: shapes and relations of all pages, and the roots on each."""

    shapes: list[Shape] = field(default_factory=list)
    edges: list[Edge] = field(default_factory=list)
    titles: list[list[str]] = field(default_factory=list)


def page_top(number: int) -> float:
    """Where a page begins, by its number from 0 on."""
    return number * (HEIGHT + BETWEEN)


def layout_argument(view: DrawnArgument, top: str, y: float) -> Pages:
    """The argument from its root on, on its first page below a height that is taken."""
    return _Layout(view, y).all(top)


class _Layout:
    def __init__(self, view: DrawnArgument, first: float) -> None:
        self.view = view
        self.pages = Pages()
        self.first = first
        self.page = -1
        self.bottom = 0.0
        self.fresh = True
        self.place: dict[str, int] = {}
        """Pages of the elements that are drawn, from 1 on."""

    def all(self, top: str) -> Pages:
        """Draw the overview, then each branch, then contexts of strategies."""
        strategies = [id_ for id_ in self._below(top) if id_ in ("SHazards", "SKinds")]
        monitors = [
            id_ for id_ in self._below(top) if subject_of(self.view.argument[id_]) == "monitors"
        ]
        branches = [*(branch for id_ in strategies for branch in self._below(id_)), *monitors]
        marks = {
            branch: self._with_mark(branch, 0.0 if branch in monitors else _INDENT)
            for branch in branches
        }
        self._new_page()
        sections = [
            Section(marks[id_], [])
            if id_ in marks
            else self._section(id_, [marks[each] for each in self._below(id_) if each in marks])
            for id_ in self._below(top)
        ]
        self._branch(top, sections)
        for branch in branches:
            if branch == branches[0]:
                self._new_page()
            self.place[branch] = 0  # it is drawn whole although the first page has it
            self._branch(branch, [self._section(id_) for id_ in self._below(branch)])
            self.bottom += 2 * _GAP
        for id_ in strategies:
            contexts = [self._block(each) for each in self._contexts(id_)]
            if contexts:
                reference = self._reference(id_)
                self._place(reference, [Section(block, []) for block in contexts], "inContextOf")
        for branch, block in marks.items():
            block.shapes[0].lines[-1] = f"page {self.place[branch]}"
        return self.pages

    def _with_mark(self, branch: str, left: float) -> Block:
        """A branch's goal on the first page, with a line for its own page."""
        element = self.view.argument[branch]
        shape = self._shape(element, _COLUMN - left, brief=True, more=1)
        shape.counts = {}
        shape.x = left
        return Block([shape], height=shape.height)

    def _branch(self, root: str, sections: list[Section]) -> None:
        """A root with what surrounds it right of it, and its sections in columns below."""
        element = self.view.argument[root]
        shape = self._shape(element, _COLUMN)
        head = Block([shape], height=shape.height)
        sides = [*self._challengers(root), *self._contexts(root)]
        blocks = [(self._block(side, circles=True), side) for side in sides]
        ends = [0.0] * (_COLUMNS - 1)
        for block, side in blocks:
            column = ends.index(min(ends))
            left = (column + 1) * (_COLUMN + _LANES)
            block.at(left, ends[column])
            self._side_edge(
                head, shape, block.shapes[0], column, challenges=not self._is_context(side)
            )
            head.shapes += block.shapes
            head.edges += block.edges
            ends[column] += block.height + _GAP
        head.height = max(shape.height, *(end - _GAP for end in ends))
        self._place(head, sections, "supportedBy", ends)

    def _is_context(self, id_: str) -> bool:
        return self.view.argument[id_].kind in ("Context", "Assumption", "Justification")

    def _side_edge(
        self, head: Block, shape: Shape, other: Shape, column: int, *, challenges: bool
    ) -> None:
        """A relation of a branch's root to a shape right of it, along the lanes between columns."""
        lane, high = (-34.0, 6.0) if challenges else (-24.0, 16.0)
        middle = other.y + other.body / 2
        start = (shape.x + shape.width - (7 if shape.kind == "Strategy" else 0), shape.y + high)
        first = _COLUMN + _LANES + lane
        path = [start, (first, start[1]), (first, middle), (other.x, middle)]
        if column:
            over, inner = -_GAP / 2 - (3 if challenges else 0), other.x + lane
            path = [start, (first, start[1]), (first, over), (inner, over), (inner, middle),
                    (other.x, middle)]  # fmt: skip
        if challenges:
            path.reverse()
        head.edges.append(Edge(_challenge(other) if challenges else "inContextOf", tuple(path)))

    # Pages and columns.

    def _new_page(self) -> None:
        self.page, self.fresh = self.page + 1, True
        self.pages.titles.append([])
        self.bottom = page_top(self.page) + (self.first if self.page == 0 else MARGIN + 34.0)

    @property
    def _end(self) -> float:
        return page_top(self.page) + HEIGHT - MARGIN

    def _place(
        self, head: Block, sections: list[Section], relation: str, sides: Sequence[float] = ()
    ) -> None:
        """Put a branch on what is left of the page, or on the next, or on several."""
        while True:
            tops = self._tops(head, sides)
            lows = range(int(self.bottom + head.height), int(self._end) + 1, 12)
            for split, low in product((False, True), lows):
                columns = _columns(sections, tops, min(low + 12.0, self._end), split=split)
                if columns is not None:
                    self._draw(head, columns, tops, relation)
                    return
            if self.fresh:
                break
            self._new_page()
        while sections:
            columns, sections = _filled(sections, self._tops(head, sides), self._end)
            self._draw(head, columns, self._tops(head, sides), relation)
            if sections:
                self._new_page()
                head, sides = self._reference(head.shapes[0].id), ()

    def _tops(self, head: Block, sides: Sequence[float]) -> list[float]:
        """Where each column begins: below the root, and below what surrounds it."""
        below = self.bottom + head.shapes[0].height + 2 * _GAP
        ends = sides or [0.0] * (_COLUMNS - 1)
        return [below, *(max(self.bottom + end + _GAP, below) for end in ends)]

    def _draw(self, head: Block, columns: Columns, tops: list[float], relation: str) -> None:
        """Draw a head, its columns, and the relations between these."""
        self.fresh = False
        self._add(head.at(MARGIN + _LANES, self.bottom))
        root = trunk = head.shapes[0]
        again = ", continued" if root.kind == "Reference" else ""
        self.pages.titles[-1].append(root.id + again)
        bottom = self.bottom + head.height
        for column, (blocks, top) in enumerate(zip(columns, tops, strict=True)):
            left, y = MARGIN + _LANES + column * (_COLUMN + _LANES), top
            for block, role in blocks:
                block.at(left, y)
                shape = block.shapes[0]
                if role == "section":
                    self._root_edge(root, shape, relation, column=column, second=tops[1])
                elif role == "leaf":
                    x, low, middle = trunk.x + 8.0, trunk.y + trunk.body, shape.y + shape.body / 2
                    path = ((x, low), (x, middle), (shape.x, middle))
                    self.pages.edges.append(Edge("supportedBy", path))
                if role != "leaf":
                    trunk = block.foot or shape
                self._add(block)
                y += block.height + _GAP
            bottom = max(bottom, y - _GAP)
        self.bottom = bottom + _GAP

    def _root_edge(
        self, root: Shape, shape: Shape, relation: str, *, column: int, second: float
    ) -> None:
        """From the root's foot along a bus above each column, down a lane, to a section."""
        left = MARGIN + _LANES + column * (_COLUMN + _LANES)
        middle = shape.y + shape.body / 2
        foot, lane = root.y + root.body, left - 12.0
        bus = foot + _GAP
        path: list[Point] = [(root.x + 20.0, foot)]
        if column == 0:
            path += [(root.x + 20.0, bus), (lane, bus), (lane, middle)]
        else:
            first = MARGIN + _LANES + _COLUMN + _LANES - 12.0
            path += [(root.x + 20.0, bus), (first, bus)]
            if column > 1:
                path += [(first, second - _GAP), (lane, second - _GAP)]
            path += [(lane, middle)]
        path.append((shape.x + (7 if shape.kind == "Strategy" else 0), middle))
        self.pages.edges.append(Edge(relation, tuple(path)))

    def _add(self, block: Block) -> None:
        """Take in a block that has its place."""
        self.pages.shapes += block.shapes
        self.pages.edges += block.edges
        for shape in block.shapes:
            number = self.place.get(shape.id) or self.page + 1
            if shape.kind != "Reference":
                self.place[shape.id] = number
            elif not shape.lines[-1]:
                shape.lines[-1] = f"see page {number}"

    # Blocks.

    def _present(self, ids: Sequence[str]) -> list[str]:
        return [id_ for id_ in ids if id_ in self.view.argument]

    def _below(self, id_: str) -> list[str]:
        return self._present(self.view.argument[id_].supported_by)

    def _contexts(self, id_: str) -> list[str]:
        return self._present(self.view.argument[id_].in_context_of)

    def _challengers(self, id_: str) -> list[str]:
        return self._present(self.view.against.get(id_, []))

    def _section(self, id_: str, marks: list[Block] | None = None) -> Section:
        """A child of a branch: its goal and strategy, and the leaves that support these."""
        if id_ in self.place:
            return Section(self._reference(id_), [])
        self.place[id_] = 0
        element = self.view.argument[id_]
        if marks:
            return Section(self._block(id_, sides=False), marks)
        if subject_of(element) in _LEAVES:
            return Section(self._block(id_, circles=True), [])
        block, below = self._block(id_), self._below(id_)
        strategy = [child for child in below if self.view.argument[child].kind == "Strategy"]
        if strategy and len(below) == 1:
            shape = self._shape(self.view.argument[strategy[0]], _COLUMN - _INDENT)
            shape.x, shape.y = _INDENT, block.height + _GAP
            first, middle = block.shapes[0], shape.y + shape.body / 2
            block.edges.append(
                Edge("supportedBy", ((8, first.body), (8, middle), (shape.x + 7, middle)))
            )
            block.shapes.append(shape)
            block.height, block.foot = shape.y + shape.height, shape
            below = self._below(strategy[0])
        left = _INDENT * (1 if block.foot is None else 2)
        leaves = [
            self._block(child, left=left, circles=True)
            for child in below
            if self.view.argument[child].kind not in ("CounterGoal", "CounterSolution")
        ]
        return Section(block, leaves)

    def _reference(self, id_: str) -> Block:
        element = self.view.argument[id_]
        shape = Shape(id_, "Reference", [id_, ""], _COLUMN, title=element.text, bold=1)
        return Block([shape], height=shape.height)

    def _block(
        self, id_: str, left: float = 0.0, *, circles: bool = False, sides: bool = True
    ) -> Block:
        """An element, its first solution right of it, and below what surrounds or challenges it."""
        element = self.view.argument[id_]
        solutions = [
            child
            for child in self._below(id_)
            if self.view.argument[child].kind in ("Solution", "CounterSolution")
        ]
        room = _CIRCLE + 22.0 if circles and solutions else 0.0
        shape = self._shape(element, _COLUMN - left - room, brief=bool(left))
        shape.x = left
        block = Block([shape], height=shape.height)
        if room:
            circle = self._shape(self.view.argument[solutions[0]], _CIRCLE, brief=True)
            if element.challenges:
                circle.verdict = shape.verdict
            circle.x = _COLUMN - _CIRCLE
            circle.y = max(0.0, (shape.body - _CIRCLE) / 2)
            shape.y = max(0.0, (_CIRCLE - shape.body) / 2)
            middle = shape.y + shape.body / 2
            block.edges.append(
                Edge("supportedBy", ((left + shape.width, middle), (circle.x, middle)))
            )
            block.shapes.append(circle)
            block.height = max(shape.y + shape.height, circle.y + _CIRCLE)
        if sides:
            for side in (*self._contexts(id_), *self._challengers(id_)):
                self._add_side(block, side)
        return block

    def _add_side(self, block: Block, id_: str) -> None:
        """Put what surrounds or challenges the first shape of a block below it."""
        shape = block.shapes[0]
        challenges = not self._is_context(id_)
        other = self._block(id_, shape.x + 50.0, circles=challenges, sides=False)
        other.at(0.0, block.height + _GAP)
        first = other.shapes[0]
        x, middle = shape.x + (36.0 if challenges else 22.0), first.y + first.body / 2
        path = ((x, shape.y + shape.body), (x, middle), (first.x, middle))
        relation = _challenge(first) if challenges else "inContextOf"
        block.edges += [Edge(relation, path[::-1] if challenges else path), *other.edges]
        block.shapes += other.shapes
        block.height += other.height + _GAP

    def _shape(
        self, element: Element, width: float, *, brief: bool = False, more: int = 0
    ) -> Shape:
        round_ = element.kind in ("Solution", "CounterSolution")
        oval = element.kind in ("Assumption", "Justification")
        most = 4 if round_ else _MOST_LINES
        room = width * (0.86 if round_ else 0.76 if oval else 1.0) - (0 if round_ or oval else 26)
        texts = element.brief if brief and element.brief else (element.text,)
        lines = [part for text in texts for part in wrap_text(text, room, most)][:most]
        heading = [] if round_ else wrap_text(element.id, room, 2, BOLD_SIZE)
        verdict = str(element.layers.get("verdict", ""))
        if element.challenges:
            challenged = self.view.argument.get(element.challenges)
            verdict = "violated" if challenged and challenged.defeated else "undecided"
        return Shape(
            element.id,
            element.kind,
            [*heading, *lines, *[""] * more],
            width,
            title=f"{element.id}: {element.text}",
            bold=len(heading),
            undeveloped=element.undeveloped,
            defeated=element.defeated,
            verdict=verdict,
            counts=self.view.counts.get(element.id, {}),
        )


def _challenge(shape: Shape) -> str:
    """The relation of a counter goal: one that refutes what it challenges has its own colour."""
    return "defeats" if shape.verdict == "violated" else "challenges"


def _filled(
    sections: list[Section], tops: list[float], end: float
) -> tuple[Columns, list[Section]]:
    """Fill the columns of a page, and return what does not fit."""
    columns: Columns = [[] for _ in tops]
    column, y = 0, tops[0]
    for number, section in enumerate(sections):
        head = section.head
        whole = sum(block.height + _GAP for block in (head, *section.leaves)) - _GAP
        apart = column + 1 < len(tops) and tops[column + 1] + whole > end
        for place, block in enumerate([head, *section.leaves]):
            together = block.height
            if not place and section.leaves:
                together = head.height + _GAP + section.leaves[0].height if apart else whole
            if y + together > end and (columns[column] or column):
                column += 1
                if column == len(tops):
                    rest = (
                        section if not place else Section(_again(head), section.leaves[place - 1 :])
                    )
                    return columns, [rest, *sections[number + 1 :]]
                y = tops[column]
                if place:
                    columns[column].append((again := _again(head), "again"))
                    y += again.height + _GAP
            columns[column].append((block, "leaf" if place else "section"))
            y += block.height + _GAP
    return columns, []


def _again(head: Block) -> Block:
    """What stands for a head above those of its leaves that have another column."""
    shape = head.foot or head.shapes[0]
    again = Shape(shape.id, "Reference", [shape.id, "continued"], _COLUMN, shape.title, bold=1)
    return Block([again], height=again.height)


def _columns(
    sections: list[Section], tops: list[float], end: float, *, split: bool
) -> Columns | None:
    """The columns if all fits above an end, and else nothing; ``split``: also parts of sections."""
    columns, left = _filled(sections, tops, end)
    for blocks, top in zip(columns, tops, strict=True):
        if blocks and top + sum(block.height + _GAP for block, _ in blocks) - _GAP > end:
            return None
        if not split and any(role == "again" for _, role in blocks):
            return None
    return None if left else columns
