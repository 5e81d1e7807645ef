"""Parser of the bounds language; its errors point at the place in the formula."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Literal, NoReturn

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.formula import Term, marked, unknown_signal

MAX_LENGTH = 4000
MAX_NESTING = 50

_TOKEN = re.compile(
    r"(?P<space>\s+)"
    r"|(?P<number>(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?(?![\w.]))"
    r"|(?P<name>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)"
    r"|(?P<symbol>>=|<=|[><()\[\]:+-])",
    re.ASCII,
)
_COMPARISONS = (">", ">=", "<", "<=")
_WORDS = ("always", "eventually", "and")
_OPERATORS: dict[str, Literal["always", "eventually"]] = {
    "always": "always",
    "eventually": "eventually",
}


def parse_terms(text: str, signals: Iterable[str] | None) -> tuple[Term, ...]:
    """The terms of a formula.

    Raises:
        ConfigurationError: See :func:`pytest_dura.requirements.bounds.parse`.
    """
    return _Parser(text, signals).formula()


class _Parser:
    """Recursive descent over the tokens of one formula."""

    def __init__(self, text: str, signals: Iterable[str] | None) -> None:
        self.text = text
        self.signals = None if signals is None else frozenset(signals)
        if len(text) > MAX_LENGTH:
            self._refuse("the formula is too long", 0, f"at most {MAX_LENGTH} characters")
        self.tokens = self._tokenize()
        self.next = 0

    def formula(self) -> tuple[Term, ...]:
        terms = self._conjunction(0)
        if self._kind() != "end":
            self._expected("`and` or the end of the formula")
        return tuple(terms)

    def _conjunction(self, depth: int) -> list[Term]:
        if depth > MAX_NESTING:
            self._refuse("too many parentheses", self._position(), f"at most {MAX_NESTING} levels")
        terms = self._operand(depth)
        while self._word() == "and":
            self.next += 1
            terms += self._operand(depth)
        return terms

    def _operand(self, depth: int) -> list[Term]:
        if self._word() == "(":
            self.next += 1
            terms = self._conjunction(depth + 1)
            self._take(")")
            return terms
        return [self._term()]

    def _term(self) -> Term:
        operator = _OPERATORS.get(self._word())
        if operator is None:
            self._expected("`always` or `eventually`")
        self.next += 1
        start, end = (0.0, None) if self._word() != "[" else self._interval()
        self._take("(")
        signal = self._signal()
        comparison = self._word()
        if comparison not in _COMPARISONS:
            self._expected("one of > >= < <=")
        self.next += 1
        bound = self._number("a number")
        self._take(")")
        return Term(operator, signal, comparison, bound, start, end)

    def _interval(self) -> tuple[float, float]:
        self._take("[")
        begin = self._position()
        start = self._number("seconds")
        self._take(":")
        end = self._number("seconds")
        self._take("]")
        if not 0.0 <= start <= end:
            self._refuse("the interval is not ordered", begin, "[a:b] seconds with 0 <= a <= b")
        return start, end

    def _signal(self) -> str:
        if self._kind() != "name" or self._word() in _WORDS:
            self._expected("the name of a signal")
        name, position = self._word(), self._position()
        if self.signals is not None and name not in self.signals:
            raise unknown_signal(name, self.signals, self.text, position)
        self.next += 1
        return name

    def _number(self, what: str) -> float:
        begin, sign = self._position(), 1.0
        if self._word() in ("+", "-"):
            sign = -1.0 if self._word() == "-" else 1.0
            self.next += 1
        if self._kind() != "number":
            self._expected(what)
        value = sign * float(self._word())
        if not abs(value) < float("inf"):
            self._refuse("this number is too large", begin, "a finite number")
        self.next += 1
        return value

    def _take(self, symbol: str) -> None:
        if self._word() != symbol:
            self._expected(f"`{symbol}`")
        self.next += 1

    def _kind(self) -> str:
        return self.tokens[self.next][0]

    def _word(self) -> str:
        return self.tokens[self.next][1]

    def _position(self) -> int:
        return self.tokens[self.next][2]

    def _tokenize(self) -> list[tuple[str, str, int]]:
        tokens, position = [], 0
        while position < len(self.text):
            match = _TOKEN.match(self.text, position)
            if match is None:
                self._refuse(
                    "this does not belong here", position, "signals, numbers and > >= < <="
                )
            if match.lastgroup != "space":
                tokens.append((str(match.lastgroup), match.group(), position))
            position = match.end()
        return [*tokens, ("end", "", len(self.text.rstrip()))]

    def _expected(self, what: str) -> NoReturn:
        found = f"`{self._word()}`" if self._kind() != "end" else "the end"
        self._refuse(f"found {found}", self._position(), what)

    def _refuse(self, problem: str, position: int, expected: str) -> NoReturn:
        text = self.text if len(self.text) <= MAX_LENGTH else self.text[:40] + "..."
        raise ConfigurationError(
            f"cannot read the formula, {problem} at column {position + 1}{marked(text, position)}",
            expected=expected,
            remedy="write for example `always (gap > 0) and eventually[0:10] (speed >= 1)`",
        )
