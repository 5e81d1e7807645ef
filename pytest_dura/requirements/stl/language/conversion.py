"""From rtamt's syntax tree to nodes; values and formulas are told apart on the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NoReturn, cast

from pytest_dura.requirements.stl.language.nodes import (
    Arithmetic,
    ArithmeticOperator,
    BinaryTemporal,
    Boolean,
    BooleanOperator,
    Comparison,
    ComparisonOperator,
    Constant,
    Expression,
    Function,
    FunctionName,
    Node,
    Not,
    Signal,
    Step,
    StepOperator,
    Temporal,
    TemporalPair,
    UnaryTemporal,
    Window,
    walk,
)
from pytest_dura.requirements.stl.language.precedence import (
    check_arithmetic,
    check_connective,
    kind,
    place,
    word,
)
from pytest_dura.requirements.stl.language.tokens import refuse

MAX_DEPTH = 100

_TEMPORAL: dict[str, UnaryTemporal] = {
    "ExprAlwaysContext": "always",
    "ExprEvContext": "eventually",
    "ExprHistContext": "historically",
    "ExpreOnceContext": "once",
}
_STEPS: dict[str, StepOperator] = {
    "ExprNextContext": "next",
    "ExprPreviousContext": "prev",
    "ExprStrongNextContext": "strong_next",
    "ExprStrongPreviousContext": "strong_prev",
    "ExprRiseContext": "rise",
    "ExprFallContext": "fall",
}
_BOOLEAN: dict[str, BooleanOperator] = {
    "ExprAndContext": "and",
    "ExprOrContext": "or",
    "ExprImpliesContext": "implies",
    "ExprIffContext": "iff",
    "ExprXorContext": "xor",
}
_PAIRS: dict[str, BinaryTemporal] = {"ExprUntilContext": "until", "ExprSinceContext": "since"}
_ARITHMETIC: dict[str, ArithmeticOperator] = {
    "ExprAdditionContext": "+",
    "ExprSubtractionContext": "-",
    "ExprMultiplicationContext": "*",
    "ExprDivisionContext": "/",
}
_FUNCTION_VALUES: dict[FunctionName, Callable[[float], float]] = {
    "abs": math.fabs,
    "sqrt": math.sqrt,
    "exp": math.exp,
}
_FUNCTIONS = ("ExprAbsContext", "ExprSqrtContext", "ExprExpContext")
_VALUES = (*_ARITHMETIC, *_FUNCTIONS, "ExprPowContext", "ExprIdContext", "ExprLiteralContext")


class Conversion:
    """Converts the tree of one text.

    Args:
        text: The text, for messages.
        windows: The windows by the column of their ``[``.
    """

    def __init__(self, text: str, windows: Mapping[int, Window]) -> None:
        self._text, self._windows = text, windows

    def formula(self, tree: Any) -> Node:
        """The formula that a tree stands for.

        Raises:
            ConfigurationError: For a value, and for what :mod:`precedence` refuses.
        """
        tree, name = _bare(tree)
        if name in _VALUES:
            remedy = "compare it, as in `x > 0`"
            refuse(self._text, place(tree), "found a value", "a formula", remedy)
        if name == "ExprPredicateContext":
            return self._comparison(tree)
        if name == "ExprNotContext":
            return Not(self.formula(tree.children[-1]))
        if name in _TEMPORAL:
            operand = self.formula(tree.children[-1])
            return Temporal(_TEMPORAL[name], operand, self._window(tree), place(tree))
        if name in _STEPS:
            return Step(_STEPS[name], self.formula(tree.expression()), place(tree))
        return self._joined(tree, name)

    def _joined(self, tree: Any, name: str) -> Node:
        left, right = self.formula(tree.children[0]), self.formula(tree.children[-1])
        check_connective(self._text, tree, right)
        at = place(tree.children[1])
        if name in _BOOLEAN:
            return Boolean(_BOOLEAN[name], left, right)
        window = self._window(tree)
        if name in _PAIRS:
            return TemporalPair(_PAIRS[name], left, right, window, at)
        # `unless`: the left holds as long as the window may last, or until the right does.
        whole = None if window is None else Window(0.0, window.end, window.position)
        held = Temporal("always", left, whole, at)
        return Boolean("or", held, TemporalPair("until", left, right, window, at))

    def _window(self, tree: Any) -> Window | None:
        interval = tree.interval()
        return None if interval is None else self._windows[place(interval)]

    def _comparison(self, tree: Any) -> Comparison:
        operator, at = word(tree.children[1]), place(tree.children[1])
        for side in (tree.children[0], tree.children[2]):
            inner, name = _bare(side)
            if name == "ExprPredicateContext":
                remedy = "write `(a < b) and (b < c)` for `a < b < c`"
                at = max(at, place(inner.children[1]))
                refuse(self._text, at, "comparisons are compared", "one comparison", remedy)
        left, right = self.value(tree.children[0]), self.value(tree.children[2])
        if not (_reads_a_signal(left) or _reads_a_signal(right)):
            problem = "a comparison of constants is always the same"
            refuse(
                self._text, at, problem, "at least one signal", "compare a signal, as in `x > 0`"
            )
        operator = "!=" if operator == "!==" else operator
        return Comparison(cast("ComparisonOperator", operator), left, right)

    def value(self, tree: Any) -> Expression:
        """The expression that a tree stands for.

        Raises:
            ConfigurationError: For a formula, a constant without a finite value, and for what
                :mod:`precedence` refuses.
        """
        tree, name = _bare(tree)
        if name == "ExprIdContext":
            return Signal(word(tree), place(tree))
        if name == "ExprLiteralContext":
            return Constant(float(tree.getText()))
        if name not in _VALUES:
            at = place(tree if tree.children[0].getChildCount() == 0 else tree.children[1])
            problem = "a formula stands inside arithmetic or a comparison"
            remedy = "join formulas by and, or, implies; compare values only"
            refuse(self._text, at, problem, "a value", remedy)
        found: Expression
        if name in _FUNCTIONS:
            found = Function(cast("FunctionName", word(tree)), self.value(tree.expression()))
        elif name == "ExprPowContext":
            base, exponent = self.value(tree.expression(0)), self.value(tree.expression(1))
            found = Arithmetic("pow", base, exponent)
        else:
            check_arithmetic(self._text, tree)
            left, right = self.value(tree.children[0]), self.value(tree.children[2])
            found = Arithmetic(_ARITHMETIC[name], left, right)
        self._check_constant(found, tree)
        return found

    def _check_constant(self, expression: Expression, tree: Any) -> None:
        if isinstance(expression, Arithmetic) and expression.operator == "/":
            divisor = expression.right
            if not _reads_a_signal(divisor) and _constant(divisor) == 0.0:
                self._no_value(place(tree.children[1]), "division by zero")
        if _reads_a_signal(expression):
            return
        try:
            value = _constant(expression)
        except (ArithmeticError, ValueError):
            value = math.nan
        if not math.isfinite(value):
            self._no_value(place(tree), "this constant has no finite value")

    def _no_value(self, at: int, problem: str) -> NoReturn:
        refuse(self._text, at, problem, "a finite value")


def check_depth(text: str, tree: Any) -> None:
    """Refuse a tree that is too deep to be worked on by recursion.

    Raises:
        ConfigurationError: For more than :data:`MAX_DEPTH` levels, parentheses not counted.
    """
    stack = [(tree, 1)]
    while stack:
        one, depth = stack.pop()
        if depth > MAX_DEPTH:
            limit = f"at most {MAX_DEPTH} operators one inside the other, or in one chain"
            remedy = "split the formula, or group a long chain by parentheses"
            refuse(text, place(one), "it is nested too deeply", limit, remedy)
        below = depth + (kind(one).startswith("Expr") and kind(one) != "ExprParenContext")
        stack += [(child, below) for child in getattr(one, "children", None) or ()]


def _bare(tree: Any) -> tuple[Any, str]:
    """A tree without the parentheses around it, and its kind."""
    while kind(tree) == "ExprParenContext":
        tree = tree.children[1]
    return tree, kind(tree)


def _reads_a_signal(expression: Expression) -> bool:
    return any(isinstance(node, Signal) for node in walk(expression))


def _constant(expression: Expression) -> float:
    """The value of an expression without signals."""
    if isinstance(expression, Constant):
        return expression.value
    if isinstance(expression, Function):
        return _FUNCTION_VALUES[expression.name](_constant(expression.operand))
    assert isinstance(expression, Arithmetic)
    left, right = _constant(expression.left), _constant(expression.right)
    if expression.operator == "pow":
        return math.pow(left, right)
    if expression.operator == "/":
        return left / right
    return {"+": left + right, "-": left - right, "*": left * right}[expression.operator]
