"""Seeded defects of requirements: a bound that asks for less, a window that is cut, a negation.

Such a defect is caught where the gate fails by it on the suite's own component, or where it lets
pass a run of a provoker that the requirement as it is does not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from pytest_dura.requirements.checks import is_function_path, read_formula
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.stl.formula import (
    Boolean,
    Comparison,
    Constant,
    Node,
    Not,
    Temporal,
    TemporalPair,
    Window,
    node_text,
)

ROLE = "requirement"
LOOSER = 0.2
"""Share of a bound by which it is moved."""
_OF_ZERO = 0.5
"""Amount by which a bound of 0 is moved, in its unit."""


@dataclass(frozen=True)
class RequirementMutant:
    """A requirement with a defect.

    Args:
        name: Such as ``requirement.looser[id=SAF-2]``.
        described: What is wrong.
        changed: The requirement with it.
    """

    name: str
    described: str
    changed: Requirement
    role: str = ROLE


def requirement_mutants(requirements: Iterable[Requirement]) -> Iterator[RequirementMutant]:
    """Yield the defects of each requirement that a formula judges, run by run."""
    for requirement in requirements:
        check = requirement.check
        if not check or requirement.paired is not None or is_function_path(check):
            continue
        root = read_formula(check).root
        for kind, about, changed in (
            ("looser", f"asks for less by {LOOSER:.0%}", _looser(root, accepts=True)),
            ("shorter", "looks at the first half of each window alone", _shorter(root)),
            ("negated", "asks for the opposite", Not(root)),
        ):
            if changed != root:
                name, text = f"{ROLE}.{kind}[id={requirement.id}]", node_text(changed)
                mutated = replace(requirement, check=text)
                yield RequirementMutant(name, f"{about}: {text}", mutated)


def _looser(node: Node, *, accepts: bool) -> Node:
    """Move the bounds of a formula so that it holds more often.

    Args:
        node: The formula.
        accepts: Whether it is more often true then; else, below a negation, more often false.
    """
    if isinstance(node, Comparison):
        if not isinstance(node.right, Constant) or node.operator in ("==", "!="):
            return node
        amount = LOOSER * abs(node.right.value) or _OF_ZERO
        down = (node.operator in (">", ">=")) == accepts
        moved = node.right.value - amount if down else node.right.value + amount
        return replace(node, right=Constant(moved))
    if isinstance(node, Not):
        return replace(node, operand=_looser(node.operand, accepts=not accepts))
    if isinstance(node, Boolean):
        if node.operator in ("iff", "xor"):
            return node
        left = accepts != (node.operator == "implies")
        return replace(
            node,
            left=_looser(node.left, accepts=left),
            right=_looser(node.right, accepts=accepts),
        )
    return _within(node, lambda inner: _looser(inner, accepts=accepts))


def _shorter(node: Node) -> Node:
    """Cut each window in half."""
    if isinstance(node, (Temporal, TemporalPair)) and node.window is not None:
        middle = (node.window.start + node.window.end) / 2.0
        node = replace(node, window=Window(node.window.start, middle))
    return _within(node, _shorter)


def _within(node: Node, change: Callable[[Node], Node]) -> Node:
    """Change the operands of a node."""
    if isinstance(node, Comparison):
        return node
    if isinstance(node, (Boolean, TemporalPair)):
        return replace(node, left=change(node.left), right=change(node.right))
    return replace(node, operand=change(node.operand))
