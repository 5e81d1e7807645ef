"""The words, numbers and symbols of a formula's text, each with its column."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NoReturn

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl.language.formula import marked

MAX_LENGTH = 4000
EXAMPLE = "write for example `always (gap > 0)` or `always (gap < 5 implies speed <= 2)`"

_TOKEN = re.compile(
    r"(?P<space>\s+)"
    r"|(?P<comment>//|/\*|\#)"
    r"|(?P<number>(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)"
    r"|(?P<word>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)"
    r"|(?P<symbol>!==|===|<->|<=>|==|!=|>=|<=|->|=>|&&|\|\||\*\*|[-+*/()\[\]:,<>!&|])"
    r"|(?P<assignment>=)"
    r"|(?P<end>;)",
    re.ASCII,
)
_OTHER_TONGUES = {
    "&&": "`and`",
    "||": "`or`",
    "=>": "`implies` or `->`",
    "<=>": "`iff` or `<->`",
    "===": "`==`",
    "**": "`pow(x, 2)`",
    "^": "`pow(x, 2)`, or `xor` between formulas",
    "~": "`not`",
    "{": "parentheses",
    "}": "parentheses",
}


@dataclass(frozen=True, slots=True)
class Token:
    """A piece of text. ``kind`` is its sort, or later the name of a terminal of rtamt's grammar."""

    kind: str
    text: str
    position: int


def refuse(
    text: str, position: int, problem: str, expected: str | None, remedy: str = EXAMPLE
) -> NoReturn:
    """Raise the error for a text that is no formula, with a mark under the place."""
    raise ConfigurationError(
        f"cannot read the formula, {problem} at column {position + 1}{marked(text, position)}",
        expected=expected,
        remedy=remedy,
    )


def tokenize(text: str) -> list[Token]:
    """The tokens of a formula: kinds ``number``, ``word``, ``symbol``, and ``end`` at the end.

    Raises:
        ConfigurationError: For a text that is too long, and whatever is no token of the language.
    """
    if len(text) > MAX_LENGTH:
        short = text[:40] + "..."
        refuse(short, 0, "it is too long", f"at most {MAX_LENGTH} characters", "split it")
    tokens: list[Token] = []
    position = 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            _foreign(text, position)
        kind: str = str(match.lastgroup)
        if kind in ("comment", "assignment", "end"):
            _no_specification(text, position, kind)
        if kind == "symbol" and match.group() in _OTHER_TONGUES:
            _foreign(text, position, match.group())
        if kind != "space":
            tokens.append(Token(kind, match.group(), position))
        position = match.end()
    return [*tokens, Token("end", "", len(text.rstrip()))]


def finite(text: str, number: Token) -> float:
    """The value of a number, which must be in the range of a float.

    Raises:
        ConfigurationError: For one that would become infinite, or zero without being it.
    """
    value = float(number.text)
    if value == float("inf"):
        refuse(text, number.position, "this number is too large", "a finite number")
    if value == 0.0 and re.search("[1-9]", re.split("[eE]", number.text)[0]):
        refuse(text, number.position, "this number is too small, it reads as 0", "a larger number")
    return value


def _foreign(text: str, position: int, symbol: str | None = None) -> NoReturn:
    symbol = symbol or text[position]
    if symbol in _OTHER_TONGUES:
        meant = _OTHER_TONGUES[symbol]
        refuse(text, position, f"found `{symbol}`", meant, f"write {meant}")
    expected = "signals, numbers, operators and parentheses"
    if not symbol.isascii():
        expected += " in ASCII letters"
    shown = symbol if symbol.isprintable() else symbol.encode("unicode_escape").decode()
    refuse(text, position, f"this does not belong here: `{shown}`", expected)


def _no_specification(text: str, position: int, kind: str) -> NoReturn:
    if kind == "comment":
        refuse(text, position, "found a comment", "a formula alone", "put the comment elsewhere")
    if kind == "assignment":
        remedy = "leave out `name =` before a formula; to compare two values write `==`"
        refuse(text, position, "found an assignment", "a formula alone", remedy)
    remedy = "leave out `;`; join formulas with `and`"
    refuse(text, position, "found `;`", "one formula alone", remedy)
