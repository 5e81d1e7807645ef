"""The parser of rtamt, fed with terminals that carry their columns, without its noise."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import lru_cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any

from pytest_dura.requirements.stl.language.tokens import Token, refuse


@lru_cache(maxsize=1)
def rtamt_modules() -> SimpleNamespace:
    """What is used of rtamt and of ANTLR; the import takes about 0.05 s."""
    with warnings.catch_warnings():
        # The generated parser imports `typing.io`, which Python deprecated.
        warnings.simplefilter("ignore", DeprecationWarning)
        # By name, because ANTLR ships no types.
        return SimpleNamespace(
            rtamt=import_module("rtamt"),
            StlParser=import_module("rtamt.antlr.parser.stl.StlParser").StlParser,
            CommonToken=import_module("antlr4.Token").CommonToken,
            CommonTokenStream=import_module("antlr4").CommonTokenStream,
            ErrorListener=import_module("antlr4.error.ErrorListener").ErrorListener,
            ListTokenSource=import_module("antlr4.ListTokenSource").ListTokenSource,
        )


def syntax_tree(text: str, terminals: Sequence[Token]) -> Any:
    """The tree that rtamt's parser makes of the terminals of ``text``.

    Its nodes are contexts of rtamt's ``StlParser``; a token's ``column`` is its place in ``text``.

    Raises:
        ConfigurationError: If rtamt's grammar has no such sentence.
    """
    modules = rtamt_modules()
    tokens = []
    for terminal in [*terminals, Token("EOF", "", len(text.rstrip()))]:
        token = modules.CommonToken(type=getattr(modules.StlParser, terminal.kind))
        token.text, token.line, token.column = terminal.text, 1, terminal.position
        tokens.append(token)
    parser = modules.StlParser(modules.CommonTokenStream(modules.ListTokenSource(tokens)))
    parser.removeErrorListeners()
    listener = modules.ErrorListener()
    listener.syntaxError = lambda _parser, token, *_: _refused(text, token)
    parser.addErrorListener(listener)
    try:
        tree = parser.expression()
    except RecursionError:
        refuse(text, 0, "it is nested too deeply", "fewer parentheses", "split it")
    rest = parser.getCurrentToken()
    if rest.type != modules.StlParser.EOF:
        _refused(text, rest)
    return tree


def _refused(text: str, token: Any) -> None:
    refuse(text, token.column, f"rtamt finds `{token.text}`", "a formula of rtamt's grammar")
