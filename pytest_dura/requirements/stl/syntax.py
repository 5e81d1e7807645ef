"""Syntax of formulas: tokens with their columns, and the syntax tree; refusals point at the place.

The place of a name decides what it is: a connective stands after an operand, a prefix operator
before one, a function before a parenthesis. Anywhere else it is a signal, so ``F (F > 2)`` is
``eventually`` over the signal ``F``. ``F - 3`` can be either and is refused.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple, NoReturn

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl.formula import (
    OPERATORS,
    Arithmetic,
    Comparison,
    Window,
    marked,
    unknown_signal,
)

_MAX_LENGTH = 4000
_EXAMPLE = "write for example `always (gap > 0)` or `always (gap < 5 implies speed <= 2)`"
MAX_SECONDS = 1e6
"""No window is longer: about eleven days."""

_SECONDS = {
    "h": Fraction(3600), "min": Fraction(60), "s": Fraction(1),
    "ms": Fraction(1, 10**3), "us": Fraction(1, 10**6), "ns": Fraction(1, 10**9),
}  # fmt: skip
"""Units of the bounds of windows, in seconds."""
_SHAPE = "[a:b] with 0 <= a <= b, in seconds, or each with its unit h, min, s, ms, us or ns"
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
_NO_FORMULA = {
    "comment": ("found a comment", "put the comment elsewhere"),
    "assignment": (
        "found an assignment",
        "leave out `name =` before a formula; to compare two values write `==`",
    ),
    "end": ("found `;`", "leave out `;`; join formulas with `and`"),
}
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


class Token(NamedTuple):
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
        kind, piece = (str(match.lastgroup), match.group()) if match else ("", text[position])
        if kind in _NO_FORMULA:
            expected = "one formula alone" if kind == "end" else "a formula alone"
            problem, remedy = _NO_FORMULA[kind]
            refuse(text, position, problem, expected, remedy)
        if piece in _OTHER_SYNTAXES:
            meant = _OTHER_SYNTAXES[piece]
            refuse(text, position, f"found `{piece}`", meant, f"write {meant}")
        if not kind:
            expected = "signals, numbers, operators and parentheses"
            expected += "" if piece.isascii() else " in ASCII letters"
            shown = piece if piece.isprintable() else piece.encode("unicode_escape").decode()
            refuse(text, position, f"this does not belong here: `{shown}`", expected)
        if kind != "space":
            tokens.append(Token(kind, piece, position))
        position += len(piece)
    return [*tokens, Token("end", "", len(text.rstrip()))]


# How operators may be written, and their names in the nodes.
_NAMES = {spelling: row.name for row in OPERATORS.values() for spelling in row.spellings.split()}
_LEVEL = {name: row.level for name, row in OPERATORS.items()}
_UNARY = tuple(name for name in _LEVEL if _LEVEL[name] == _LEVEL["not"])
_FUNCTIONS = tuple(name for name in _LEVEL if not _LEVEL[name])
_BINARY = {written: name for written, name in _NAMES.items() if name not in (*_UNARY, *_FUNCTIONS)}
_BETWEEN_VALUES = tuple(
    written for written, name in _BINARY.items() if OPERATORS[name].node in (Comparison, Arithmetic)
)
_CONNECTIVES = tuple(written for written in _BINARY if written not in _BETWEEN_VALUES)
_PREFIXES = {written: name for written, name in _NAMES.items() if name in _UNARY and name != "not"}

_TRUTH = ("true", "false", "TRUE", "FALSE", "True", "False")
_SHORT = ("U", "W", "S")
_KEYWORDS = tuple(
    written
    for written in ("not", *_PREFIXES, *_FUNCTIONS, *_CONNECTIVES)
    if len(written) > 1 and written.islower()
)
_OPERAND = "a signal, a number, `(` or an operator such as `always` or `not`"
_OPERATOR = "an operator such as `>`, `and`, `implies`, or the end of the formula"


@dataclass(frozen=True, slots=True)
class Tree:
    """A piece of a formula's syntax.

    Args:
        kind: ``signal``, ``number``, ``(`` for parentheses, or the operator by its name in the
            table.
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

    def _refuse(self, problem: str, expected: str, remedy: str = _EXAMPLE) -> NoReturn:
        refuse(self._text, self._token.position, problem, expected, remedy)

    def _wrong(self, expected: str, remedy: str = _EXAMPLE) -> NoReturn:
        unexpected = f"`{self._token.text}`" if self._token.kind != "end" else "the end"
        self._refuse(f"found {unexpected}", expected, remedy)

    def _operand(self) -> None:
        """Prefix operators and opening parentheses, then a signal or a number."""
        while True:
            token = self._token
            if token.kind == "number" or token.text == "-":
                return self._number()
            kind = self._kind_of_name() if token.kind == "name" else _NAMES.get(token.text, "(")
            if kind == "signal":
                return self._signal()
            if kind in _FUNCTIONS or token.text == "(":
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
            self._join(self._pending.pop())
        return self._pending[-1] if self._pending else None

    def _close(self) -> None:
        opened = self._reduce(1)
        if opened is None:
            self._wrong(_OPERATOR)
        if opened.kind == "pow" and not opened.commas:
            self._wrong("`,` and the exponent, as in `pow(x, 2)`")
        self._join(self._pending.pop())
        self._at += 1

    def _join(self, pending: _Pending) -> None:
        """Replace the last trees by the one of the operator that stands before or between them."""
        between = pending.kind in _BINARY.values()
        count = 2 if between or pending.kind == "pow" else 1
        operands = tuple(self._trees[-count:])
        del self._trees[-count:]
        start = operands[0].start if between else pending.token.position
        self._trees.append(Tree(pending.kind, pending.token, start, operands, pending.window))

    def _number(self) -> None:
        sign = None
        if self._token.text == "-":
            if self._after.kind != "number":
                remedy = "write `0 - x` for the negative of x, `not` for the negation of a formula"
                self._refuse("`-` stands before no number", "a number", remedy)
            sign = self._take()
        number = self._finite_number()
        if sign is not None:
            number = Token("number", "-" + number.text, sign.position)
        self._trees.append(Tree("number", number, number.position))
        after, end = self._token, self._tokens[self._at - 1].position + len(number.text.lstrip("-"))
        if after.position == end and after.kind in ("name", "number"):
            self._refuse(f"a number ends in `{after.text}`", "digits", "mend the number")

    def _finite_number(self) -> Token:
        """Take a number that is in the range of a float, and zero only if it says so."""
        text = self._token.text
        if float(text) == float("inf"):
            self._refuse("this number is too large", "a finite number")
        if float(text) == 0.0 and re.search("[1-9]", re.split("[eE]", text)[0]):
            self._refuse("this number is too small, it reads as 0", "a larger number")
        return self._take()

    def _signal(self) -> None:
        name = self._token.text
        if self._signals is not None and name not in self._signals:
            raise unknown_signal(name, self._signals, self._text, self._token.position)
        self._trees.append(Tree("signal", self._token, self._token.position))
        self._at += 1

    def _window(self, kind: str) -> Window | None:
        """The window of the operator that was taken last, if one follows.

        A bound without a unit is in seconds. rtamt would lend ``[1:500ms]``'s unit to the ``1`` and
        fail on ``[1ms:5]``, so beside a bound with a unit only a zero may go without.
        """
        if self._token.text != "[":
            return None
        if not OPERATORS[kind].windowed:
            self._no_window()
        opening = self._take().position
        first, first_unit = self._bound(":,")
        last, last_unit = self._bound("]")
        if (first and last_unit and not first_unit) or (last and first_unit and not last_unit):
            remedy = "give both bounds a unit, such as [500ms:2s]"
            problem = "only one bound of the window has a unit"
            refuse(self._text, opening, problem, _SHAPE, remedy)
        if first > last:
            refuse(self._text, opening, "the window is not ordered", _SHAPE, _REMEDY)
        if last > MAX_SECONDS:
            limit = f"at most {MAX_SECONDS:g} seconds"
            refuse(self._text, opening, "the window is absurdly long", limit, _REMEDY)
        return Window(first, last, opening)

    def _bound(self, ends: str) -> tuple[float, str]:
        """Take a bound of a window and the symbol behind it: its seconds, and its unit if any."""
        if self._token.kind != "number":
            self._not_in_window()
        value, unit = Fraction(self._finite_number().text), ""
        if self._token.kind == "name":
            unit = self._token.text
            if unit not in _SECONDS:
                self._refuse(f"`{unit}` is no unit of time", "h, min, s, ms, us or ns", _REMEDY)
            self._take()
        if self._token.text not in tuple(ends):
            self._not_in_window()
        self._take()
        return float(value * _SECONDS[unit or "s"]), unit

    def _not_in_window(self) -> NoReturn:
        text = self._token.text
        problem = f"found {f'`{text}`' if text else 'the end'} in a window"
        self._refuse(
            "a bound of the window is negative" if text == "-" else problem, _SHAPE, _REMEDY
        )

    def _kind_of_name(self) -> str:
        """What a name is where an operand begins."""
        name, after = self._token.text, self._after.text
        if name == "not":
            return "not"
        if name in _CONNECTIVES and (name not in _SHORT or after in ("(", "[")):
            self._refuse(f"found `{name}`", "a formula before it")
        if name in _FUNCTIONS:
            return name if after == "(" else "signal"
        if name in _PREFIXES:
            return _PREFIXES[name] if self._is_prefix() else "signal"
        if name in _TRUTH and not (self._signals and name in self._signals):
            problem = f"found the truth value `{name}`"
            remedy = "compare a signal, as in `flag > 0.5`"
            self._refuse(problem, "comparisons", remedy)
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
            self._refuse(problem, "parentheses", remedy)
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
        self._refuse(problem, expected, remedy)

    def _no_window(self) -> NoReturn:
        remedy = "windows belong to always, eventually, until, unless, historically, once, since"
        problem = f"`{self._tokens[self._at - 1].text}` takes no window"
        self._refuse(problem, _OPERAND, remedy)

    def _no_operator(self) -> NoReturn:
        token = self._token
        if token.text == "[":
            self._no_window()
        if token.text == "not" or token.text in (*_PREFIXES, *_FUNCTIONS):
            self._wrong(_OPERATOR, "join two formulas with `and`, `or` or `implies`")
        if token.kind == "name" and self._after.text in ("(", "["):
            self._unknown_name()
        self._wrong(_OPERATOR)
