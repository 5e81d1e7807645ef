"""The nodes of a formula: frozen, plain, and equal if they mean the same text.

Expressions have a real value at each sample; formulas hold or do not, with a robustness as margin.
``position`` is the column in the text that a node was read from, for messages; it is not compared.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

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
        one = stack.pop()
        yield one
        stack.extend(reversed(children(one)))


def conjuncts(root: Node) -> list[Node]:
    """The parts of the conjunction at a formula's root, or the root alone."""
    if isinstance(root, Boolean) and root.operator == "and":
        return [*conjuncts(root.left), *conjuncts(root.right)]
    return [root]
