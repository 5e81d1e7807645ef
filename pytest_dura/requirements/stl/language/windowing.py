"""Windows in a formula's text: ``[a:b]`` or ``[a,b]``, in seconds or with units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NoReturn

from pytest_dura.requirements.stl.language.nodes import Window
from pytest_dura.requirements.stl.language.tokens import Token, finite, refuse

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
