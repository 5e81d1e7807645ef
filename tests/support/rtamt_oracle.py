"""rtamt, by which our formulas are judged: its syntax trees and its offline evaluation.

A module that imports this one is skipped where rtamt is not installed.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from pytest_dura.requirements import Formula, SecondEngine

pytest.importorskip("rtamt", reason="rtamt's ANTLR 4.7 cannot be imported from Python 3.13 on")

with warnings.catch_warnings():
    # The generated parser imports `typing.io`, which Python deprecated.
    warnings.simplefilter("ignore", DeprecationWarning)
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


ENGINE = SecondEngine()


def raw_robustness(text: str, trace: Mapping[str, Sequence[float]]) -> list[float]:
    """What rtamt makes of a text as it stands, with a sample each second."""
    return ENGINE.evaluated(text, trace)


def robustness(
    formula: Formula, trace: Mapping[str, Sequence[float]], time_step: float
) -> list[float]:
    """Robustness at each sample by rtamt, for traces of at least two."""
    return ENGINE.robustness(formula.root, trace, time_step)
