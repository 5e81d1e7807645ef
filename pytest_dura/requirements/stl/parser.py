"""Parser of signal temporal logic, by rtamt's grammar; its errors point at the place in the text.

A text means here what it means to rtamt, which the tests hold it against, or it is refused. The
parser is our own: every message has a column, signals may have any name, nothing is ignored, and
rtamt need not be there. The precedence is rtamt's, tightest first::

    * / + -   > >= < <= == !=   not   always eventually historically once prev next s_prev s_next
    until unless since   and   or   implies   iff   xor

Each binary operator has a level of its own and associates to the left. What follows from this and
would surprise is refused, and parentheses are asked for:

- ``a - b + c`` and ``a / b * c``: rtamt reads ``a - (b + c)`` and ``a / (b * c)``.
- ``a -> b -> c``, ``a until b until c``, ``a iff b xor c``: rtamt starts from the left, logic
  usually from the right. So these, with ``since`` and ``unless``, never stand side by side, nor
  ``until``, ``unless`` and ``since`` beside ``and`` and ``or``.
- ``always (a) implies (b)`` and ``always (a) and (b)``: the ``always`` ends before the connective,
  and ``b`` is judged at the first sample only. ``always (a) and eventually (b)`` is accepted: where
  each side has an operator on time of its own, ``and`` and ``or`` need no parentheses.
- ``a < b < c`` would compare a formula.

Read as in rtamt and in most languages: ``not a > 1`` is ``not (a > 1)``; ``not a > 1 and b > 2``
is ``(not (a > 1)) and (b > 2)``; ``and`` before ``or`` before ``implies``; ``a - b - c`` and
``a / b / c`` from the left.

Beyond rtamt's text: ``!=`` for ``!==``; dotted signals; signals with the names of operators,
distinguished by their place (see :mod:`syntax`); ``a/b`` is a division; ``a - 5``, on which rtamt
fails because it looks for a second formula. Short of it: no comments, declarations, assignments,
truth values, named constants, nor numbers such as ``0x1F`` and ``1_000``. Windows are in seconds
without a unit; one bound alone has a unit only beside a zero.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, cast

import numpy as np

from pytest_dura.requirements.stl.formula import (
    OPERATORS,
    Arithmetic,
    Boolean,
    Comparison,
    Constant,
    Expression,
    Formula,
    Function,
    Node,
    Not,
    Signal,
    Step,
    Temporal,
    TemporalPair,
    Window,
    children,
    operator_of,
    walk,
)
from pytest_dura.requirements.stl.syntax import Tree, read_tree, refuse

__all__ = ["parse"]

MAX_DEPTH = 100

_LOGIC = ("and", "or")
_EDGED = ("implies", "iff", "xor", "until", "unless", "since")
# Prefix operators that could be meant to reach over a connective; `rise` and `fall` have
# parentheses.
_REACHING = tuple(
    row.name for row in OPERATORS.values() if row.node in (Temporal, Step) and row.level
)
# `+` binds tighter than `-`, and `*` tighter than `/`.
_SPLIT = {
    "-": ("+", "(a - b) + c", "a - (b + c)"),
    "/": ("*", "(a / b) * c", "a / (b * c)"),
}


@lru_cache(maxsize=512)
def parse(text: str, signals: tuple[str, ...] | None = None) -> Formula:
    """The formula in ``text``; ``signals`` are the known names, where they are known.

    Raises:
        ConfigurationError: For anything that is not a formula, with a mark under the place.
    """
    tree = read_tree(text, None if signals is None else frozenset(signals))
    _check_depth(text, tree)
    return Formula(_Conversion(text).formula(tree), text)


def _check_depth(text: str, tree: Tree) -> None:
    """Refuse a tree that is too deep to be worked on by recursion."""
    stack = [(tree, 0)]
    while stack:
        part, depth = stack.pop()
        if depth > MAX_DEPTH:
            limit = f"at most {MAX_DEPTH} operators one inside the other, or in one chain"
            remedy = "split the formula, or group a long chain by parentheses"
            refuse(text, part.start, "it is nested too deeply", limit, remedy)
        below = depth + (part.kind != "(")
        stack += [(operand, below) for operand in part.operands]


class _Conversion:
    """Converts the syntax tree of one text to nodes, values and formulas apart.

    Args:
        text: The text, for messages.
    """

    def __init__(self, text: str) -> None:
        self._text = text

    def formula(self, tree: Tree) -> Node:
        """The formula that a tree stands for."""
        tree = _bare(tree)
        kind, at, window = tree.kind, tree.token.position, tree.window
        made: Any = _node_of(tree)
        if made in (Signal, Constant, Arithmetic, Function):
            remedy = "compare it, as in `x > 0`"
            refuse(self._text, tree.start, "found a value", "a formula", remedy)
        if made is Comparison:
            return self._comparison(tree)
        operands = [self.formula(operand) for operand in tree.operands]
        if len(operands) == 2:
            self._check_connective(tree, operands[1])
        if kind == "unless":
            # The left holds as long as the window may last, or until the right does.
            whole = None if window is None else Window(0.0, window.end, window.position)
            held = Temporal("always", operands[0], whole, at)
            left, right = operands
            return Boolean("or", held, TemporalPair("until", left, right, window, at))
        about: dict[type, tuple[object, ...]] = {
            Not: tuple(operands),
            Boolean: (kind, *operands),
            Step: (kind, *operands, at),
            Temporal: (kind, *operands, window, at),
            TemporalPair: (kind, *operands, window, at),
        }
        node: Node = made(*about[made])
        return node

    def _comparison(self, tree: Tree) -> Comparison:
        at = tree.token.position
        for side in map(_bare, tree.operands):
            if _node_of(side) is Comparison:
                remedy = "write `(a < b) and (b < c)` for `a < b < c`"
                at = max(at, side.token.position)
                refuse(self._text, at, "comparisons are compared", "one comparison", remedy)
        left, right = (self._value(operand) for operand in tree.operands)
        if not (_reads_a_signal(left) or _reads_a_signal(right)):
            problem = "a comparison of constants is always the same"
            remedy = "compare a signal, as in `x > 0`"
            refuse(self._text, at, problem, "at least one signal", remedy)
        operator: Any = tree.kind
        return Comparison(operator, left, right)

    def _value(self, tree: Tree) -> Expression:
        """The expression that a tree stands for."""
        tree = _bare(tree)
        made: Any = _node_of(tree)
        if made is Signal:
            return Signal(tree.token.text, tree.start)
        if made is Constant:
            return Constant(float(tree.token.text))
        if made not in (Arithmetic, Function):
            problem = "a formula stands inside arithmetic or a comparison"
            remedy = "join formulas by and, or, implies; compare values only"
            refuse(self._text, tree.token.position, problem, "a value", remedy)
        self._check_arithmetic(tree)
        result: Any = made(tree.kind, *(self._value(operand) for operand in tree.operands))
        if tree.kind == "/" and not _reads_a_signal(result.right) and not _constant(result.right):
            refuse(self._text, tree.token.position, "division by zero", "a finite value")
        if not _reads_a_signal(result) and not math.isfinite(_constant(result)):
            refuse(self._text, tree.start, "this constant has no finite value", "a finite value")
        return cast("Expression", result)

    def _check_arithmetic(self, tree: Tree) -> None:
        """Refuse ``a - b + c`` and ``a / b * c``, which rtamt reads from the right."""
        tighter, usual, reading = _SPLIT.get(tree.kind, ("", "", ""))
        right = tree.operands[-1]
        if right.kind == tighter:
            plain = reading.replace("(", "").replace(")", "")
            problem = f"rtamt reads `{plain}` as `{reading}`,"
            remedy = f"write `{usual}` or `{reading}`"
            refuse(self._text, right.token.position, problem, "parentheses", remedy)

    def _check_connective(self, tree: Tree, right: Node) -> None:
        """Refuse operands that could be meant to reach further than they do."""
        mine = tree.token
        for operand in tree.operands:
            # Only `and` and `or` bind tighter as usual; below `until` they cannot stand at all.
            if operand.kind in _EDGED:
                inner = operand.token
                problem = f"`{inner.text}` and `{mine.text}` stand together without parentheses"
                at = max(inner.position, mine.position)
                remedy = "write `(a ... b) ... c` or `a ... (b ... c)`, as it is meant"
                refuse(self._text, at, problem, "parentheses", remedy)
        reaching = _right_edge(tree.operands[0])
        if reaching is not None and not (tree.kind in _LOGIC and _temporal(right)):
            name, joint = reaching.token.text, mine.text
            problem = f"`{name}` could be meant to reach over the `{joint}`"
            remedy = f"write `({name} (a)) {joint} (b)` or `{name} (a {joint} b)`, as it is meant"
            refuse(self._text, mine.position, problem, "parentheses", remedy)


def _node_of(tree: Tree) -> type:
    """The class of the node that a tree without parentheses around it becomes."""
    kinds = {"signal": Signal, "number": Constant}
    return kinds[tree.kind] if tree.kind in kinds else OPERATORS[tree.kind].node


def _bare(tree: Tree) -> Tree:
    """A tree without the parentheses around it."""
    while tree.kind == "(":
        tree = tree.operands[0]
    return tree


def _right_edge(tree: Tree) -> Tree | None:
    """The prefix operator whose scope ends, without parentheses, where the tree ends."""
    while tree.kind not in _REACHING:
        if tree.kind != "not" and tree.kind not in (*_LOGIC, *_EDGED):
            return None
        tree = tree.operands[-1]
    return tree


def _temporal(node: Node) -> bool:
    """Whether every branch of a formula is below an operator on time of its own."""
    if isinstance(node, (Temporal, TemporalPair, Step)):
        return True
    if isinstance(node, Not):
        return _temporal(node.operand)
    return isinstance(node, Boolean) and _temporal(node.left) and _temporal(node.right)


def _reads_a_signal(expression: Expression) -> bool:
    return any(isinstance(node, Signal) for node in walk(expression))


def _constant(expression: Expression) -> float:
    """The value of an expression without signals, not finite where it has none."""
    if isinstance(expression, Constant):
        return expression.value
    values = [np.float64(_constant(operand)) for operand in children(expression)]
    with np.errstate(all="ignore"):
        return float(operator_of(expression).compute(*values))
