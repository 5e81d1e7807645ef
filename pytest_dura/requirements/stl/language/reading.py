"""From a formula's text to the terminals of rtamt's grammar, each with its column.

What passes here is a sentence of that grammar; what does not is refused where it goes wrong.
"""

from __future__ import annotations

from typing import NoReturn

from pytest_dura.requirements.stl.language import words
from pytest_dura.requirements.stl.language.formula import unknown_signal
from pytest_dura.requirements.stl.language.nodes import Window
from pytest_dura.requirements.stl.language.tokens import EXAMPLE, Token, finite, refuse, tokenize
from pytest_dura.requirements.stl.language.windowing import read_window

MAX_NESTING = 200
"""Open parentheses and operators before one operand; the tree has a stricter bound of its own."""

_OPERAND = "a signal, a number, `(` or an operator such as `always` or `not`"
_OPERATOR = "an operator such as `>`, `and`, `implies`, or the end of the formula"


class Reader:
    """Reads one text.

    Args:
        text: The text.
        signals: The known signals, where they are known.

    Attributes:
        terminals: The terminals, with the operators' own words as text.
        windows: The windows by the column of their ``[``.

    Raises:
        ConfigurationError: For a text that is no sentence of the grammar.
    """

    def __init__(self, text: str, signals: frozenset[str] | None) -> None:
        self.text, self.signals = text, signals
        self.terminals: list[Token] = []
        self.windows: dict[int, Window] = {}
        self._tokens = tokenize(text)
        self._at = 0
        # One entry per open parenthesis: the terminal before it, commas in it, prefixes before it.
        self._open: list[tuple[str, int, int]] = []
        self._commas = self._prefixes = 0
        if self._token.kind == "end":
            refuse(text, 0, "it is empty", "a formula")
        while True:
            self._operand()
            if not self._operator():
                break

    @property
    def _token(self) -> Token:
        return self._tokens[self._at]

    def _operand(self) -> None:
        """Prefix operators and opening parentheses, then a signal or a number."""
        while True:
            token = self._token
            self._bound_nesting()
            if token.kind == "number":
                return self._number()
            if token.text == "-":
                self._minus()
            elif token.text == "(":
                self._parenthesis()
            elif token.text == "!":
                self._prefix("NotOperator")
            elif token.kind == "word":
                kind = words.operand_kind(self.text, self._tokens, self._at, self.signals)
                if kind == "Identifier":
                    return self._signal()
                self._prefix(kind)
            else:
                self._wrong(_OPERAND)

    def _operator(self) -> bool:
        """Closing parentheses, then what joins this operand to the next; false at the end."""
        self._prefixes = 0
        while self._token.text == ")":
            self._close()
        token = self._token
        if token.kind == "end":
            if self._open:
                self._wrong("`)`")
            return False
        if token.text == "," and self._open and self._open[-1][0] == "POW" and not self._commas:
            self._commas += 1
            self._take("COMMA")
            return True
        joins = {**words.COMPARISONS, **words.ARITHMETIC, **words.CONNECTIVES}
        if token.text not in joins:
            self._no_operator()
        self._take(joins[token.text])
        self._window()
        return True

    def _number(self) -> None:
        number, after = self._token, self._tokens[self._at + 1]
        end = number.position + len(number.text)
        if after.position == end and after.kind in ("word", "number"):
            refuse(self.text, end, f"a number ends in `{after.text}`", "digits", "mend the number")
        finite(self.text, number)
        self._take("RealLiteral")

    def _minus(self) -> None:
        if self._tokens[self._at + 1].kind != "number":
            remedy = "write `0 - x` for the negative of x, `not` for the negation of a formula"
            refuse(
                self.text, self._token.position, "`-` stands before no number", "a number", remedy
            )
        self._take("MINUS")

    def _signal(self) -> None:
        name = self._token.text
        if self.signals is not None and name not in self.signals:
            raise unknown_signal(name, self.signals, self.text, self._token.position)
        self._take("Identifier")

    def _prefix(self, kind: str) -> None:
        self._prefixes += 1
        self._take(kind)
        self._window()

    def _window(self) -> None:
        if self._token.text != "[":
            return
        if self.terminals[-1].kind not in words.WINDOWED:
            self._no_window()
        opening = self._at
        window, self._at = read_window(self.text, self._tokens, opening)
        self.windows[window.position] = window
        # The value is kept aside: rtamt's parser needs a window's shape only.
        for kind, text in (
            ("LBRACK", "["), ("IntegerLiteral", "0"), ("COLON", ":"),
            ("IntegerLiteral", "0"), ("RBRACK", "]"),
        ):  # fmt: skip
            self.terminals.append(Token(kind, text, window.position))

    def _parenthesis(self) -> None:
        kind = self.terminals[-1].kind if self.terminals else ""
        self._open.append((kind, self._commas, self._prefixes))
        self._commas = self._prefixes = 0
        self._take("LPAREN")

    def _close(self) -> None:
        if not self._open:
            self._wrong(_OPERATOR)
        kind, commas, _ = self._open[-1]
        if kind == "POW" and not self._commas:
            self._wrong("`,` and the exponent, as in `pow(x, 2)`")
        self._open.pop()
        self._commas = commas
        self._take("RPAREN")

    def _bound_nesting(self) -> None:
        if len(self._open) + self._prefixes + sum(one[2] for one in self._open) > MAX_NESTING:
            limit = f"at most {MAX_NESTING} levels"
            refuse(self.text, self._token.position, "it is nested too deeply", limit, "split it")

    def _take(self, kind: str) -> None:
        self.terminals.append(Token(kind, self._token.text, self._token.position))
        self._at += 1

    def _no_window(self) -> NoReturn:
        remedy = "windows belong to always, eventually, until, unless, historically, once, since"
        problem = f"`{self.terminals[-1].text}` takes no window"
        refuse(self.text, self._token.position, problem, _OPERAND, remedy)

    def _no_operator(self) -> NoReturn:
        token, after = self._token, self._tokens[self._at + 1]
        if token.text == "[":
            self._no_window()
        if token.text == "not" or token.text in (*words.PREFIXES, *words.FUNCTIONS):
            self._wrong(_OPERATOR, "join two formulas with `and`, `or` or `implies`")
        if token.kind == "word" and after.text in ("(", "["):
            words.unknown_word(self.text, token)
        self._wrong(_OPERATOR)

    def _wrong(self, expected: str, remedy: str = EXAMPLE) -> NoReturn:
        found = f"`{self._token.text}`" if self._token.kind != "end" else "the end"
        refuse(self.text, self._token.position, f"found {found}", expected, remedy)
