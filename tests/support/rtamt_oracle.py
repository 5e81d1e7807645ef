"""rtamt, by which our formulas are judged: its syntax trees and its offline evaluation.

A module that imports this one is skipped where rtamt is not installed.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest

from pytest_dura.requirements import Boolean, Formula, Not, Signal, Window, in_samples, node_text

pytest.importorskip("rtamt", reason="rtamt's ANTLR 4.7 cannot be imported from Python 3.13 on")

with warnings.catch_warnings():
    # The generated parser imports `typing.io`, which Python deprecated.
    warnings.simplefilter("ignore", DeprecationWarning)
    import rtamt
    from antlr4 import CommonTokenStream, InputStream
    from antlr4.error.ErrorListener import ErrorListener
    from rtamt.antlr.parser.stl.StlLexer import StlLexer
    from rtamt.antlr.parser.stl.StlParser import StlParser

# The grammar's alternatives by the names of our nodes.
_KINDS = {
    "Paren": "(", "Id": "signal", "Literal": "number", "Predicate": "",
    "Always": "always", "Ev": "eventually", "Hist": "historically", "eOnce": "once",
    "Next": "next", "Previous": "prev",
    "StrongNext": "strong_next", "StrongPrevious": "strong_prev",
    "Addition": "+", "Subtraction": "-", "Multiplication": "*", "Division": "/",
}  # fmt: skip


class NoSentenceError(Exception):
    """A text that rtamt's grammar does not have."""


class _Refusing(ErrorListener):
    def syntaxError(self, *found: Any) -> None:  # noqa: N802 - ANTLR calls it
        raise NoSentenceError(str(found[4]))


def syntax_tree(text: str) -> Any:
    """The tree of a text by rtamt: kind, column, column of the window or ``None``, operands.

    Raises:
        NoSentenceError: If there is none.
    """
    lexer = StlLexer(InputStream(text))
    lexer.removeErrorListeners()
    lexer.addErrorListener(_Refusing())
    parser = StlParser(CommonTokenStream(lexer))
    parser.removeErrorListeners()
    parser.addErrorListener(_Refusing())
    tree = parser.expression()
    if parser.getCurrentToken().type != StlParser.EOF:
        raise NoSentenceError(parser.getCurrentToken().text)
    return _plain(tree)


def _plain(tree: Any) -> Any:
    alternative = type(tree).__name__.removeprefix("Expr").removesuffix("Context")
    kind = _KINDS.get(alternative, alternative.lower())
    if alternative == "Predicate":
        kind = tree.comparisonOp().getText().replace("!==", "!=")
    operands = [child for child in tree.children if isinstance(child, StlParser.ExpressionContext)]
    interval = getattr(tree, "interval", lambda: None)()
    window = None if interval is None else interval.start.column
    return kind, tree.start.column, window, tuple(map(_plain, operands))


def specified(kind: str, text: str, names: Sequence[str]) -> Any:
    """A parsed specification of rtamt, sampled once a second; ``kind`` is Offline or Online."""
    specification = getattr(rtamt, f"StlDiscreteTime{kind}Specification")()
    specification.set_sampling_period(1, "s", 0.1)
    for name in names:
        specification.declare_var(name, "float")
    specification.spec = text
    specification.parse()
    return specification


def raw_robustness(text: str, trace: Mapping[str, Sequence[float]]) -> list[float]:
    """What rtamt makes of a text as it stands, with a sample each second."""
    # Lists of our own: rtamt appends to its inputs.
    columns = {name: list(column) for name, column in trace.items()}
    time = list(range(len(next(iter(columns.values())))))
    found = specified("Offline", text, list(columns)).evaluate({"time": time, **columns})
    return [float(margin) for _, margin in found]


def robustness(
    formula: Formula, trace: Mapping[str, Sequence[float]], time_step: float
) -> list[float]:
    """Robustness at each sample by rtamt, for traces of at least two.

    ``iff`` is written out as two implications and ``xor`` as its negation: rtamt's own robustness
    of them, ``-|a - b|`` and ``|a - b|``, is never positive and never negative. Windows are given
    in samples, since 0.1 s is no exact number, and signals get names that rtamt allows.
    """
    names = {name: f"signal_{number}" for number, name in enumerate(formula.signals)}

    def rewritten(node: Any) -> Any:
        if isinstance(node, Signal):
            return Signal(names[node.name])
        changed = {
            name: rewritten(getattr(node, name))
            for name in ("left", "right", "operand")
            if hasattr(node, name)
        }
        if getattr(node, "window", None) is not None:
            changed["window"] = Window(*map(float, in_samples(node.window, time_step)))
        node = replace(node, **changed)
        if not (isinstance(node, Boolean) and node.operator in ("iff", "xor")):
            return node
        there = Boolean("implies", node.left, node.right)
        both = Boolean("and", there, Boolean("implies", node.right, node.left))
        return both if node.operator == "iff" else Not(both)

    text = node_text(rewritten(formula.root)).replace("!=", "!==")
    return raw_robustness(text, {names[name]: trace[name] for name in formula.signals})
