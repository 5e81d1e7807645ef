"""The words, numbers and symbols of a formula's text, each with its column, and its windows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NoReturn

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl.language.formula import marked
from pytest_dura.requirements.stl.language.nodes import Window

MAX_LENGTH = 4000
EXAMPLE = "write for example `always (gap > 0)` or `always (gap < 5 implies speed <= 2)`"
MAX_SECONDS = 1e6
"""No window is longer: about eleven days."""

_UNITS = {
    "s": Fraction(1),
    "ms": Fraction(1, 10**3),
    "us": Fraction(1, 10**6),
    "ns": Fraction(1, 10**9),
}
_SHAPE = "[a:b] with 0 <= a <= b, in seconds, or each with its unit s, ms, us or ns"
_REMEDY = "write for example [0:2.5] or [0:500ms]; leave the window out for all samples"

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
    """A piece of text; ``kind`` is ``number``, ``word``, ``symbol``, or ``end`` behind the last."""

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
    """The tokens of a formula.

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


def read_window(text: str, tokens: Sequence[Token], at: int) -> tuple[Window, int]:
    """The window whose ``[`` is token ``at``, and the number of the token after its ``]``.

    A bound without a unit is in seconds. rtamt would lend ``[1:500ms]``'s unit to the ``1`` and
    fail on ``[1ms:5]``, so beside a bound with a unit only a zero may go without.

    Raises:
        ConfigurationError: For a bound that is no number or has no known unit, bounds that are not
            ordered, and windows longer than :data:`MAX_SECONDS`.
    """
    opening = tokens[at].position
    first, at = _bound(text, tokens, at + 1)
    if tokens[at].text not in (":", ","):
        _unexpected(text, tokens[at])
    last, at = _bound(text, tokens, at + 1)
    if tokens[at].text != "]":
        _unexpected(text, tokens[at])
    if (first.unit or last.unit) and any(one.unit is None and one.value for one in (first, last)):
        remedy = "give both bounds a unit, such as [500ms:2s]"
        refuse(text, opening, "only one bound of the window has a unit", _SHAPE, remedy)
    start, end = first.seconds, last.seconds
    if start > end:
        refuse(text, opening, "the window is not ordered", _SHAPE, _REMEDY)
    if end > MAX_SECONDS:
        limit = f"at most {MAX_SECONDS:g} seconds"
        refuse(text, opening, "the window is absurdly long", limit, _REMEDY)
    return Window(start, end, opening), at + 1


@dataclass(frozen=True, slots=True)
class _Bound:
    value: Fraction
    unit: str | None

    @property
    def seconds(self) -> float:
        return float(self.value * _UNITS[self.unit or "s"])


def _bound(text: str, tokens: Sequence[Token], at: int) -> tuple[_Bound, int]:
    number = tokens[at]
    if number.kind != "number":
        _unexpected(text, number)
    finite(text, number)
    value, unit = Fraction(number.text), tokens[at + 1]
    if unit.kind != "word":
        return _Bound(value, None), at + 1
    if unit.text not in _UNITS:
        refuse(text, unit.position, f"`{unit.text}` is no unit of time", "s, ms, us or ns", _REMEDY)
    return _Bound(value, unit.text), at + 2


def _unexpected(text: str, token: Token) -> NoReturn:
    problem = f"found {f'`{token.text}`' if token.text else 'the end'} in a window"
    if token.text == "-":
        problem = "a bound of the window is negative"
    refuse(text, token.position, problem, _SHAPE, _REMEDY)


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
