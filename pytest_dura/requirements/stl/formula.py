"""Formula: its nodes, the table of operators, its text, and checks before it judges anything.

Expressions have a real value at each sample; formulas hold or do not, with a robustness as margin.
``position`` is the column in the text that a node was read from, for messages; it is not compared.
"""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeAlias, TypeGuard

import numpy as np

from pytest_dura.core.errors import ConfigurationError

UnaryTemporal = Literal["always", "eventually", "historically", "once"]
BinaryTemporal = Literal["until", "since"]
StepOperator = Literal["next", "prev", "strong_next", "strong_prev", "rise", "fall"]
BooleanOperator = Literal["and", "or", "implies", "iff", "xor"]
ComparisonOperator = Literal[">", ">=", "<", "<=", "==", "!="]
ArithmeticOperator = Literal["+", "-", "*", "/", "pow"]
FunctionName = Literal["abs", "sqrt", "exp"]


@dataclass(frozen=True, slots=True)
class Signal:
    """A signal by its full name, such as ``gap`` or ``percept.gap``."""

    name: str
    position: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Constant:
    """A finite number."""

    value: float


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """Two expressions joined; ``pow`` raises the first to the second."""

    operator: ArithmeticOperator
    left: Expression
    right: Expression


@dataclass(frozen=True, slots=True)
class Function:
    """A function of one expression."""

    name: FunctionName
    operand: Expression


Expression: TypeAlias = Signal | Constant | Arithmetic | Function


@dataclass(frozen=True, slots=True)
class Window:
    """A closed interval of seconds, relative to the sample at hand; ``0 <= start <= end``."""

    start: float
    end: float
    position: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two expressions compared."""

    operator: ComparisonOperator
    left: Expression
    right: Expression


@dataclass(frozen=True, slots=True)
class Not:
    """Negation."""

    operand: Node


@dataclass(frozen=True, slots=True)
class Boolean:
    """Two formulas joined."""

    operator: BooleanOperator
    left: Node
    right: Node


@dataclass(frozen=True, slots=True)
class Temporal:
    """A formula at all or at some samples of a window; without one, to the trace's end or start."""

    operator: UnaryTemporal
    operand: Node
    window: Window | None = None
    position: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class TemporalPair:
    """``left until right``: right holds at a sample of the window, and left at all before it.

    ``left since right`` mirrors it: right held at a sample, and left at all after it.
    """

    operator: BinaryTemporal
    left: Node
    right: Node
    window: Window | None = None
    position: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Step:
    """A formula at the neighbouring sample; ``rise`` and ``fall`` compare it with this one.

    Where there is no such sample, the weak operators hold and the strong ones do not. A verdict
    says so of the past only: what follows the last sample is unknown to it, see ``evaluation``.
    """

    operator: StepOperator
    operand: Node
    position: int = field(default=0, compare=False)


Node: TypeAlias = Comparison | Not | Boolean | Temporal | TemporalPair | Step


class Operator(NamedTuple):
    """An operator of the language: a row of the table.

    Args:
        level: How tightly it binds; 0 for a function, which has parentheses.
        name: Its name in the nodes. ``unless`` has none: it is read as other operators.
        spellings: How it may be written.
        node: Class of its node.
        windowed: Whether it may have a window.
        ahead: Whether it looks ahead.
        compute: Result of an operator on values, margin of a comparison (positive where it holds);
            of numbers as of arrays.
    """

    level: int
    name: str
    spellings: str
    node: type
    windowed: bool = False
    ahead: bool = False
    compute: Any = None


# The loosest first. Each operator between two operands associates to the left.
_TABLE = (
    Operator(1, "xor", "xor", Boolean),
    Operator(2, "iff", "iff <->", Boolean),
    Operator(3, "implies", "implies ->", Boolean),
    Operator(4, "or", "or |", Boolean),
    Operator(5, "and", "and &", Boolean),
    Operator(6, "since", "since S", TemporalPair, windowed=True),
    Operator(7, "unless", "unless W", TemporalPair, windowed=True, ahead=True),
    Operator(8, "until", "until U", TemporalPair, windowed=True, ahead=True),
    Operator(9, "not", "not !", Not),
    Operator(9, "always", "always G", Temporal, windowed=True, ahead=True),
    Operator(9, "eventually", "eventually F", Temporal, windowed=True, ahead=True),
    Operator(9, "historically", "historically H", Temporal, windowed=True),
    Operator(9, "once", "once O", Temporal, windowed=True),
    Operator(9, "next", "next X", Step, ahead=True),
    Operator(9, "prev", "prev Y", Step),
    Operator(9, "strong_next", "s_next sX", Step, ahead=True),
    Operator(9, "strong_prev", "s_prev sY", Step),
    Operator(10, ">=", ">=", Comparison, compute=operator.sub),
    Operator(10, ">", ">", Comparison, compute=operator.sub),
    Operator(10, "<=", "<=", Comparison, compute=lambda left, right: right - left),
    Operator(10, "<", "<", Comparison, compute=lambda left, right: right - left),
    Operator(10, "==", "==", Comparison, compute=lambda left, right: -abs(left - right)),
    Operator(10, "!=", "!= !==", Comparison, compute=lambda left, right: abs(left - right)),
    Operator(11, "-", "-", Arithmetic, compute=operator.sub),
    Operator(12, "+", "+", Arithmetic, compute=operator.add),
    Operator(13, "/", "/", Arithmetic, compute=operator.truediv),
    Operator(14, "*", "*", Arithmetic, compute=operator.mul),
    Operator(0, "pow", "pow", Arithmetic, compute=np.power),
    Operator(0, "abs", "abs", Function, compute=abs),
    Operator(0, "sqrt", "sqrt", Function, compute=np.sqrt),
    Operator(0, "exp", "exp", Function, compute=np.exp),
    Operator(0, "rise", "rise", Step),
    Operator(0, "fall", "fall", Step),
)
OPERATORS = {row.name: row for row in _TABLE}
ON_BOUND = frozenset({">=", "<=", "=="})
"""Comparisons that hold at a margin of zero."""
FUTURE = frozenset(row.name for row in _TABLE if row.ahead)
"""Operators that look ahead."""


def operator_of(node: Any) -> Operator:
    """The row of a node that is neither a signal nor a constant."""
    return OPERATORS["not" if isinstance(node, Not) else getattr(node, "operator", "") or node.name]


def children(node: Node | Expression) -> tuple[Any, ...]:
    """The nodes directly below one, from left to right; those of an expression are expressions."""
    if isinstance(node, (Signal, Constant)):
        return ()
    if isinstance(node, (Not, Temporal, Step, Function)):
        return (node.operand,)
    return (node.left, node.right)


def walk(node: Node | Expression) -> Iterator[Node | Expression]:
    """The node and all below it, parents first, from left to right."""
    stack: list[Node | Expression] = [node]
    while stack:
        current = stack.pop()
        yield current
        stack.extend(reversed(children(current)))


def conjuncts(root: Node) -> list[Node]:
    """The parts of the conjunction at a formula's root, or the root alone."""
    if isinstance(root, Boolean) and root.operator == "and":
        return [*conjuncts(root.left), *conjuncts(root.right)]
    return [root]


def exact(number: float) -> str:
    """The shortest text that reads back as the same number."""
    return repr(float(number)).removesuffix(".0")


def node_text(node: Any) -> str:
    """A formula or an expression as text that parses to equal nodes."""
    if isinstance(node, Signal):
        return node.name
    if isinstance(node, Constant):
        return exact(node.value)
    row = operator_of(node)
    texts = [node_text(child) for child in children(node)]
    if row.node in (Function, Arithmetic) and not row.level:
        return f"{row.name}({', '.join(texts)})"
    if row.node is Comparison:
        return f"{texts[0]} {row.name} {texts[1]}"
    bare = [row.node is Arithmetic and not _is_joined(child) for child in children(node)]
    if row.name in ("and", "or") and getattr(node.left, "operator", "") == row.name:
        bare[0] = True  # a chain of one operator associates to the left in rtamt and here
    if row.name == "-" and isinstance(node.right, Constant):
        # rtamt fails on `a - 5`, which it tries to read as a formula `a` and another, `-5`.
        bare[1] = False
    *left, right = [text if as_is else f"({text})" for text, as_is in zip(texts, bare, strict=True)]
    window = getattr(node, "window", None)
    bounds = f"[{exact(window.start)}:{exact(window.end)}]" if window else ""
    return " ".join([*left, row.spellings.split()[0] + bounds, right])


def _is_joined(node: Node | Expression) -> bool:
    return isinstance(node, Arithmetic) and node.operator != "pow"


@dataclass(frozen=True)
class Formula:
    """A formula of signal temporal logic; ``str`` gives text that parses to an equal formula.

    Args:
        root: Its nodes; two formulas are equal if these are.
        text: The text it was read from, which the positions in the nodes refer to.
    """

    root: Node
    text: str = field(compare=False)

    def __str__(self) -> str:
        return self._canonical

    @cached_property
    def _canonical(self) -> str:
        return node_text(self.root)

    @cached_property
    def signals(self) -> tuple[str, ...]:
        """The signals it reads, sorted."""
        return tuple(sorted({node.name for node in walk(self.root) if isinstance(node, Signal)}))

    @property
    def percept_signals(self) -> tuple[str, ...]:
        """Those of its signals that are percepts, not ground truth."""
        return tuple(name for name in self.signals if name.startswith("percept."))

    @cached_property
    def horizon(self) -> float | None:
        """Seconds that a trace must last to decide every bounded window at its start.

        Nested windows add up, and a window below an operator without one counts for itself.
        ``next`` looks one sample ahead, which is no number of seconds, and adds nothing.
        ``None`` without an operator that looks ahead through a window.
        """
        timed = [n for n in walk(self.root) if _looks_ahead(n) and getattr(n, "window", None)]
        return _longest(self.root, _seconds_ahead) if timed else None

    @cached_property
    def future_operators(self) -> tuple[tuple[str, int], ...]:
        """Operators that look ahead with their columns from zero, in the order of the text.

        ``unless`` is read as ``always .. or .. until``: both stand here, at its column.
        """
        operators = [
            (node.operator, node.position) for node in walk(self.root) if _looks_ahead(node)
        ]
        return tuple(sorted(operators, key=lambda operator: operator[1]))

    @property
    def past_only(self) -> bool:
        """Whether no operator looks ahead."""
        return not self.future_operators


def unknown_signal(
    name: str,
    known: Iterable[str],
    formula_text: str,
    position: int | None,
    remedy: str | None = None,
) -> ConfigurationError:
    """The error for an unknown signal; another ``remedy`` replaces the usual ones."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1)
    mark = marked(formula_text, position) if position is not None else f"\n    {formula_text}"
    return ConfigurationError(
        f"unknown signal {name!r} in the formula{mark}",
        found=name,
        expected="one of " + ", ".join(names),
        remedy=remedy
        or (f"did you mean {near[0]!r}?" if near else "use a signal of the simulator"),
    )


def marked(text: str, position: int) -> str:
    """The formula on one line, with a caret below the position."""
    line = "".join(letter if letter.isprintable() else " " for letter in text)
    return f"\n    {line}\n    {' ' * position}^"


def _looks_ahead(node: Node | Expression) -> TypeGuard[Temporal | TemporalPair | Step]:
    return isinstance(node, (Temporal, TemporalPair, Step)) and node.operator in FUTURE


def _longest(node: Node | Expression, own: Callable[[Node | Expression], float]) -> float:
    """The greatest sum of what nodes add, over all ways from a node to a leaf."""
    below = max((_longest(child, own) for child in children(node)), default=0)
    return own(node) + below


def _seconds_ahead(node: Node | Expression) -> float:
    window = getattr(node, "window", None)
    return window.end if _looks_ahead(node) and window else 0.0


def reach(node: Node | Expression, time_step: float) -> int | None:
    """Samples behind the first one that the verdict there may rest on.

    Whatever follows them changes neither the verdict nor which conditions held.

    Args:
        node: The formula; its windows are multiples of the time step.
        time_step: Seconds from sample to sample.

    Returns:
        ``None`` with an operator that looks ahead without a window: it has no such end.
    """

    def ahead(node: Node | Expression) -> float:
        if not _looks_ahead(node):
            return 0
        if isinstance(node, Step):
            return 1
        return math.inf if node.window is None else in_samples(node.window, time_step)[1]

    samples = _longest(node, ahead)
    return None if samples == math.inf else int(samples)


_RANGING = ("always", "eventually", "until")
"""Operators that range over the samples from the one at hand on."""

_TIME_TOLERANCE = 1e-6
"""Seconds by which a bound may miss a sample: time steps such as 1/15 s have no exact text."""


def check_time_step(formula: Formula, time_step: float) -> None:
    """Refuse a window with a bound between two samples of a trace sampled every ``time_step``.

    Raises:
        ConfigurationError: For such a window, or a time step that is no positive number.
    """
    for node in walk(formula.root):
        if isinstance(node, (Temporal, TemporalPair)) and node.window is not None:
            for bound in (node.window.start, node.window.end):
                if not _on_a_sample(bound, time_step):
                    raise _between_samples(formula, node.window, bound, time_step)


def in_samples(window: Window, time_step: float) -> tuple[int, int]:
    """The bounds of a window that :func:`check_time_step` let pass, as numbers of samples."""
    return round(window.start / time_step), round(window.end / time_step)


def past_only_or_refuse(formula: Formula, what: str) -> None:
    """Refuse a formula that looks ahead.

    Args:
        formula: The formula.
        what: Its user, which cannot look ahead, such as ``the monitor 'gap'``.

    Raises:
        ConfigurationError: For an operator that looks ahead, with a mark under the first.
    """
    if formula.past_only:
        return
    name, position = formula.future_operators[0]
    # As the text writes it: `G` and `unless` have other names in the nodes.
    match = re.compile(r"[A-Za-z_]\w*", re.ASCII).match(formula.text, position)
    written = match.group() if match else name
    raise ConfigurationError(
        f"{what} cannot know the future: `{written}` looks ahead at column {position + 1}"
        f"{marked(formula.text, position)}",
        found=written,
        expected="operators that look back: once, historically, since, prev, rise, fall. Rewriting "
        "a formula into the past (pastification) is not done: it was measured to flip verdicts",
        remedy="say it with once, historically or since, as `historically[0:2] (gap > 1)`, or "
        "give the formula to a requirement, which judges the finished episode",
    )


def ranging_or_refuse(formula: Formula) -> None:
    """Refuse a formula of which a part reads the trace's beginning alone.

    An episode is judged at its first sample. What stands under no ``always``, ``eventually`` or
    ``until`` is never asked about the rest of it, and an operator that looks back from the first
    sample sees that sample only.

    Raises:
        ConfigurationError: Naming the first such part, with a mark under it.
    """
    bare = _bare(formula.root)
    if not bare:
        return
    text = node_text(bare[0])
    position = min(node.position for node in walk(bare[0]) if isinstance(node, Signal))
    raise ConfigurationError(
        f"`{text}` is judged at the beginning of the episode alone{marked(formula.text, position)}",
        found=text,
        expected="each part of the formula under always, eventually or until",
        remedy=f"write `always ({text})`, or `eventually ({text})`, as it is meant",
    )


def _bare(node: Node) -> list[Node]:
    """The greatest parts that stand under no operator of ``_RANGING`` and have none below."""
    if isinstance(node, Comparison):
        return [node]
    if isinstance(node, (Temporal, TemporalPair)) and node.operator in _RANGING:
        return []
    if isinstance(node, (Boolean, TemporalPair)):
        left, right = _bare(node.left), _bare(node.right)
        return [node] if (left, right) == ([node.left], [node.right]) else [*left, *right]
    below = _bare(node.operand)
    return [node] if below == [node.operand] or (below and not isinstance(node, Not)) else below


def _on_a_sample(bound: float, time_step: float) -> bool:
    if not (math.isfinite(time_step) and time_step > 0.0):
        raise ConfigurationError(
            "the time step is no positive number",
            found=time_step,
            expected="seconds from one sample to the next, such as 0.1",
        )
    tolerance = min(_TIME_TOLERANCE, time_step / 1000.0)
    ratio = bound / time_step
    return math.isfinite(ratio) and abs(round(ratio) * time_step - bound) <= tolerance


def _between_samples(
    formula: Formula, window: Window, bound: float, time_step: float
) -> ConfigurationError:
    below = math.floor(bound / time_step) if math.isfinite(bound / time_step) else 0
    near = " or ".join(f"{tick * time_step:.12g}" for tick in (below, below + 1))
    return ConfigurationError(
        f"a bound of the window at column {window.position + 1} falls between two samples"
        f"{marked(formula.text, window.position)}",
        found=f"{bound:g} s with a sample every {time_step:g} s",
        expected="bounds that are multiples of the time step",
        remedy=f"write {near} for {bound:g}",
    )
