"""Syntax of formulas: tokens with their columns, and the syntax tree; refusals point at the place.

The place of a name decides what it is: a connective stands after an operand, a prefix operator
before one, a function before a parenthesis. Anywhere else it is a signal, so ``F (F > 2)`` is
``eventually`` over the signal ``F``. ``F - 3`` can be either and is refused.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NoReturn

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl.formula import Window, marked, unknown_signal

_MAX_LENGTH = 4000
_EXAMPLE = "write for example `always (gap > 0)` or `always (gap < 5 implies speed <= 2)`"
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
    r"|(?P<name>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)"
    r"|(?P<symbol>!==|===|<->|<=>|==|!=|>=|<=|->|=>|&&|\|\||\*\*|[-+*/()\[\]:,<>!&|])"
    r"|(?P<assignment>=)"
    r"|(?P<end>;)",
    re.ASCII,
)
_OTHER_SYNTAXES = {
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
    """A piece of text; ``kind`` is ``number``, ``name``, ``symbol``, or ``end`` behind the last."""

    kind: str
    text: str
    position: int


def refuse(
    text: str, position: int, problem: str, expected: str | None, remedy: str = _EXAMPLE
) -> NoReturn:
    """Raise the error for a text that is no formula, with a mark under the place."""
    raise ConfigurationError(
        f"cannot read the formula, {problem} at column {position + 1}{marked(text, position)}",
        expected=expected,
        remedy=remedy,
    )


def _tokenize(text: str) -> list[Token]:
    """The tokens of a formula.

    Raises:
        ConfigurationError: For a text that is too long, and whatever is no token of the language.
    """
    if len(text) > _MAX_LENGTH:
        short = text[:40] + "..."
        refuse(short, 0, "it is too long", f"at most {_MAX_LENGTH} characters", "split it")
    tokens: list[Token] = []
    position = 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            _foreign(text, position)
        kind: str = str(match.lastgroup)
        if kind in ("comment", "assignment", "end"):
            _no_specification(text, position, kind)
        if kind == "symbol" and match.group() in _OTHER_SYNTAXES:
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


def _read_window(text: str, tokens: Sequence[Token], at: int) -> tuple[Window, int]:
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
    if (first.unit or last.unit) and any(
        bound.unit is None and bound.value for bound in (first, last)
    ):
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
    if unit.kind != "name":
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
    if symbol in _OTHER_SYNTAXES:
        meant = _OTHER_SYNTAXES[symbol]
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


# How operators may be written, and their names in the nodes.
_PREFIXES = {
    "always": "always", "G": "always",
    "eventually": "eventually", "F": "eventually",
    "historically": "historically", "H": "historically",
    "once": "once", "O": "once",
    "next": "next", "X": "next",
    "prev": "prev", "Y": "prev",
    "s_next": "strong_next", "sX": "strong_next",
    "s_prev": "strong_prev", "sY": "strong_prev",
}  # fmt: skip
_UNARY = ("not", *_PREFIXES.values())
_FUNCTIONS = ("abs", "sqrt", "exp", "pow", "rise", "fall")
_CONNECTIVES = {
    "and": "and", "&": "and",
    "or": "or", "|": "or",
    "implies": "implies", "->": "implies",
    "iff": "iff", "<->": "iff",
    "xor": "xor",
    "until": "until", "U": "until",
    "unless": "unless", "W": "unless",
    "since": "since", "S": "since",
}  # fmt: skip
_BETWEEN_VALUES = {
    **{operator: operator for operator in ("+", "-", "*", "/", ">=", ">", "<=", "<", "==", "!=")},
    "!==": "!=",
}
_BINARY = {**_BETWEEN_VALUES, **_CONNECTIVES}
_WINDOWED = (
    "always", "eventually", "historically", "once", "until", "unless", "since",
)  # fmt: skip
# The loosest first. Each operator between two operands associates to the left.
_LEVELS = (
    ("xor",), ("iff",), ("implies",), ("or",), ("and",), ("since",), ("unless",), ("until",),
    _UNARY,
    (">=", ">", "<=", "<", "==", "!="), ("-",), ("+",), ("/",), ("*",),
)  # fmt: skip
_LEVEL = {operator: level for level, row in enumerate(_LEVELS, 1) for operator in row}

_TRUTH = ("true", "false", "TRUE", "FALSE", "True", "False")
_SHORT = ("U", "W", "S")
_KEYWORDS = tuple(
    prefix
    for prefix in ("not", *_PREFIXES, *_FUNCTIONS, *_CONNECTIVES)
    if len(prefix) > 1 and prefix.islower()
)
_OPERAND = "a signal, a number, `(` or an operator such as `always` or `not`"
_OPERATOR = "an operator such as `>`, `and`, `implies`, or the end of the formula"


@dataclass(frozen=True, slots=True)
class Tree:
    """A piece of a formula's syntax.

    Args:
        kind: ``signal``, ``number``, ``(`` for parentheses, or the operator by its name in the
            nodes (``unless`` has none there).
        token: The operator, the signal or the number; a number's with its sign.
        start: The column of the first token.
        operands: What the operator stands before or between.
        window: The operator's window.
    """

    kind: str
    token: Token
    start: int
    operands: tuple[Tree, ...] = ()
    window: Window | None = None


@dataclass(slots=True)
class _Pending:
    """An operator, or a parenthesis with the function before it, whose operand is still to come."""

    kind: str
    token: Token
    window: Window | None = None
    commas: int = 0

    @property
    def level(self) -> int:
        return _LEVEL.get(self.kind, 0)


def read_tree(text: str, signals: frozenset[str] | None) -> Tree:
    """The syntax tree of a text.

    Args:
        text: The text.
        signals: The known signals, where they are known.

    Raises:
        ConfigurationError: For a text that is no sentence of the language.
    """
    return _Reader(text, signals).tree()


class _Reader:
    """Reads one text by the precedence of its operators, without recursion."""

    def __init__(self, text: str, signals: frozenset[str] | None) -> None:
        self._text, self._signals = text, signals
        self._tokens = _tokenize(text)
        self._at = 0
        self._pending: list[_Pending] = []
        self._trees: list[Tree] = []

    def tree(self) -> Tree:
        if self._token.kind == "end":
            refuse(self._text, 0, "it is empty", "a formula")
        while True:
            self._operand()
            if not self._operator():
                return self._trees.pop()

    @property
    def _token(self) -> Token:
        return self._tokens[self._at]

    @property
    def _after(self) -> Token:
        return self._tokens[self._at + 1]

    def _take(self) -> Token:
        self._at += 1
        return self._tokens[self._at - 1]

    def _operand(self) -> None:
        """Prefix operators and opening parentheses, then a signal or a number."""
        while True:
            token = self._token
            if token.kind == "number" or token.text == "-":
                return self._number()
            kind = "not" if token.text == "!" else token.text
            if token.kind == "name":
                kind = self._kind_of_name()
            if kind == "signal":
                return self._signal()
            if kind in _FUNCTIONS or kind == "(":
                self._pending.append(_Pending(kind, self._take()))
                if kind != "(":
                    self._at += 1  # its parenthesis
            elif kind in _UNARY:
                self._pending.append(_Pending(kind, self._take(), self._window(kind)))
            else:
                self._wrong(_OPERAND)

    def _operator(self) -> bool:
        """Closing parentheses, then what joins this operand to the next; false at the end."""
        while self._token.text == ")":
            self._close()
        token = self._token
        if token.text == ",":
            opened = self._reduce(1)
            if opened is not None and opened.kind == "pow" and not opened.commas:
                opened.commas += 1
                self._at += 1
                return True
        if token.kind == "end":
            if self._reduce(1) is not None:
                self._wrong("`)`")
            return False
        if token.text not in _BINARY:
            self._no_operator()
        kind = _BINARY[token.text]
        self._reduce(_LEVEL[kind])
        self._pending.append(_Pending(kind, self._take(), self._window(kind)))
        return True

    def _reduce(self, level: int) -> _Pending | None:
        """Apply pending operators that bind as tightly as ``level``; return the last that stays."""
        while self._pending and self._pending[-1].level >= level:
            last = self._pending.pop()
            count = 1 if last.kind in _UNARY else 2
            operands = tuple(self._trees[-count:])
            del self._trees[-count:]
            start = last.token.position if count == 1 else operands[0].start
            self._trees.append(Tree(last.kind, last.token, start, operands, last.window))
        return self._pending[-1] if self._pending else None

    def _close(self) -> None:
        opened = self._reduce(1)
        if opened is None:
            self._wrong(_OPERATOR)
        count = 2 if opened.kind == "pow" else 1
        if opened.commas < count - 1:
            self._wrong("`,` and the exponent, as in `pow(x, 2)`")
        self._pending.pop()
        operands = tuple(self._trees[-count:])
        del self._trees[-count:]
        self._trees.append(Tree(opened.kind, opened.token, opened.token.position, operands))
        self._at += 1

    def _number(self) -> None:
        sign = None
        if self._token.text == "-":
            if self._after.kind != "number":
                problem = "`-` stands before no number"
                remedy = "write `0 - x` for the negative of x, `not` for the negation of a formula"
                refuse(self._text, self._token.position, problem, "a number", remedy)
            sign = self._take()
        number, after = self._take(), self._token
        end = number.position + len(number.text)
        if after.position == end and after.kind in ("name", "number"):
            problem = f"a number ends in `{after.text}`"
            refuse(self._text, end, problem, "digits", "mend the number")
        finite(self._text, number)
        if sign is not None:
            number = Token("number", "-" + number.text, sign.position)
        self._trees.append(Tree("number", number, number.position))

    def _signal(self) -> None:
        name = self._token.text
        if self._signals is not None and name not in self._signals:
            raise unknown_signal(name, self._signals, self._text, self._token.position)
        self._trees.append(Tree("signal", self._token, self._token.position))
        self._at += 1

    def _window(self, kind: str) -> Window | None:
        """The window of the operator that was taken last, if one follows."""
        if self._token.text != "[":
            return None
        if kind not in _WINDOWED:
            self._no_window()
        window, self._at = _read_window(self._text, self._tokens, self._at)
        return window

    def _kind_of_name(self) -> str:
        """What a name is where an operand begins."""
        name, after = self._token.text, self._after.text
        if name == "not":
            return "not"
        if name in _CONNECTIVES and (name not in _SHORT or after in ("(", "[")):
            refuse(self._text, self._token.position, f"found `{name}`", "a formula before it")
        if name in _FUNCTIONS:
            return name if after == "(" else "signal"
        if name in _PREFIXES:
            return _PREFIXES[name] if self._is_prefix() else "signal"
        if name in _TRUTH and not (self._signals and name in self._signals):
            problem = f"found the truth value `{name}`"
            remedy = "compare a signal, as in `flag > 0.5`"
            refuse(self._text, self._token.position, problem, "comparisons", remedy)
        if after in ("(", "["):
            self._unknown_name()
        return "signal"

    def _is_prefix(self) -> bool:
        """Whether the name of a prefix operator is meant as such, and not as a signal."""
        name, after = self._token.text, self._after
        in_value = self._at > 0 and self._tokens[self._at - 1].text in _BETWEEN_VALUES
        if after.text in ("(", "[", "!"):
            return True
        if after.text == "-" and not in_value and self._tokens[self._at + 2].kind == "number":
            number = self._tokens[self._at + 2].text
            problem = f"`{name} - {number}` can be read in two ways"
            remedy = (
                f"write `({name}) - {number}` for the signal `{name}`, or "
                f"`{name} (-{number} ...)` for the operator"
            )
            refuse(self._text, self._token.position, problem, "parentheses", remedy)
        operand = after.kind == "number" or (
            after.kind == "name" and (after.text not in _CONNECTIVES or after.text in _SHORT)
        )
        return operand and not in_value

    def _unknown_name(self) -> NoReturn:
        """Refuse a name that is used as an operator, with the nearest known one."""
        name = self._token.text
        near = difflib.get_close_matches(name.lower(), _KEYWORDS, n=1)
        remedy = f"did you mean `{near[0]}`?" if near else "check its spelling"
        problem, expected = f"`{name}` is no operator or function", "one of " + ", ".join(_KEYWORDS)
        refuse(self._text, self._token.position, problem, expected, remedy)

    def _no_window(self) -> NoReturn:
        remedy = "windows belong to always, eventually, until, unless, historically, once, since"
        problem = f"`{self._tokens[self._at - 1].text}` takes no window"
        refuse(self._text, self._token.position, problem, _OPERAND, remedy)

    def _no_operator(self) -> NoReturn:
        token = self._token
        if token.text == "[":
            self._no_window()
        if token.text == "not" or token.text in (*_PREFIXES, *_FUNCTIONS):
            self._wrong(_OPERATOR, "join two formulas with `and`, `or` or `implies`")
        if token.kind == "name" and self._after.text in ("(", "["):
            self._unknown_name()
        self._wrong(_OPERATOR)

    def _wrong(self, expected: str, remedy: str = _EXAMPLE) -> NoReturn:
        unexpected = f"`{self._token.text}`" if self._token.kind != "end" else "the end"
        refuse(self._text, self._token.position, f"found {unexpected}", expected, remedy)
