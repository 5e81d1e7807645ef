"""Formula: its nodes, its text, how far it looks ahead, and checks before it judges anything.

Expressions have a real value at each sample; formulas hold or do not, with a robustness as margin.
``position`` is the column in the text that a node was read from, for messages; it is not compared.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, TypeAlias

from pytest_dura.core.errors import ConfigurationError

UnaryTemporal = Literal["always", "eventually", "historically", "once"]
BinaryTemporal = Literal["until", "since"]
StepOperator = Literal["next", "prev", "strong_next", "strong_prev", "rise", "fall"]
BooleanOperator = Literal["and", "or", "implies", "iff", "xor"]
ComparisonOperator = Literal[">", ">=", "<", "<=", "==", "!="]
ArithmeticOperator = Literal["+", "-", "*", "/", "pow"]
FunctionName = Literal["abs", "sqrt", "exp"]

FUTURE = ("always", "eventually", "until", "next", "strong_next")
"""Operators that look ahead."""


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


def children(node: Node | Expression) -> tuple[Node | Expression, ...]:
    """The nodes directly below one, from left to right."""
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


def node_text(node: Node | Expression) -> str:
    """A formula or an expression as text that parses to equal nodes."""
    if isinstance(node, (Signal, Constant, Arithmetic, Function)):
        return _expression(node)
    if isinstance(node, Comparison):
        return f"{_expression(node.left)} {node.operator} {_expression(node.right)}"
    if isinstance(node, (Boolean, TemporalPair)):
        return _joined(node)
    return f"{_prefix(node)} ({node_text(node.operand)})"


def exact(number: float) -> str:
    """The shortest text that reads back as the same number."""
    return repr(float(number)).removesuffix(".0")


def seconds(window: Window) -> str:
    """A window in seconds, such as ``[0:2.5]``."""
    return f"[{exact(window.start)}:{exact(window.end)}]"


def _expression(node: Expression) -> str:
    if isinstance(node, Signal):
        return node.name
    if isinstance(node, Constant):
        return exact(node.value)
    if isinstance(node, Function):
        return f"{node.name}({_expression(node.operand)})"
    if node.operator == "pow":
        return f"pow({_expression(node.left)}, {_expression(node.right)})"
    right = _term(node.right)
    if node.operator == "-" and isinstance(node.right, Constant):
        # rtamt fails on `a - 5`, which it tries to read as a formula `a` and another, `-5`.
        right = f"({right})"
    return f"{_term(node.left)} {node.operator} {right}"


def _term(node: Expression) -> str:
    joined = isinstance(node, Arithmetic) and node.operator != "pow"
    return f"({_expression(node)})" if joined else _expression(node)


def _joined(node: Boolean | TemporalPair) -> str:
    left = node_text(node.left)
    # A chain of one operator associates to the left in rtamt and here.
    chain = node.operator in ("and", "or")
    if not (chain and isinstance(node.left, Boolean) and node.left.operator == node.operator):
        left = f"({left})"
    return f"{left} {_prefix(node)} ({node_text(node.right)})"


def _prefix(node: Node) -> str:
    """The operator as it is written, with its window if it has one."""
    if isinstance(node, (Temporal, TemporalPair)):
        return node.operator + (seconds(node.window) if node.window else "")
    if isinstance(node, (Boolean, Comparison)):
        return node.operator
    name = getattr(node, "operator", "not")
    return str(name).replace("strong_", "s_")


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
        return _horizon(self.root)

    @cached_property
    def future_operators(self) -> tuple[tuple[str, int], ...]:
        """Operators that look ahead with their columns from zero, in the order of the text.

        ``unless`` is read as ``always .. or .. until``: both stand here, at its column.
        """
        operators = [
            (node.operator, node.position)
            for node in walk(self.root)
            if isinstance(node, (Temporal, TemporalPair, Step)) and node.operator in FUTURE
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


def _horizon(node: Node | Expression) -> float | None:
    below = [seconds for child in children(node) if (seconds := _horizon(child)) is not None]
    deepest = max(below, default=None)
    if isinstance(node, (Temporal, TemporalPair)) and node.operator in FUTURE and node.window:
        return node.window.end + (deepest or 0.0)
    return deepest


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


def reach(node: Node | Expression, time_step: float) -> int | None:
    """Samples behind the first one that the verdict there may rest on.

    Whatever follows them changes neither the verdict nor which conditions held.

    Args:
        node: The formula; its windows are multiples of the time step.
        time_step: Seconds from sample to sample.

    Returns:
        ``None`` with an operator that looks ahead without a window: it has no such end.
    """
    farthest = 0
    for child in children(node):
        below = reach(child, time_step)
        if below is None:
            return None
        farthest = max(farthest, below)
    if isinstance(node, Step) and node.operator in FUTURE:
        return farthest + 1
    if isinstance(node, (Temporal, TemporalPair)) and node.operator in FUTURE:
        if node.window is None:
            return None
        return farthest + in_samples(node.window, time_step)[1]
    return farthest
