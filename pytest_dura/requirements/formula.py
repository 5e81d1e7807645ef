"""The nodes of a formula, and the messages that point into its text."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from pytest_dura.core.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class Term:
    """``always`` or ``eventually`` over one comparison. ``end`` is ``None`` without an interval."""

    operator: Literal["always", "eventually"]
    signal: str
    comparison: str
    bound: float
    start: float = 0.0
    end: float | None = None

    def __str__(self) -> str:
        interval = "" if self.end is None else f"[{_exact(self.start)}:{_exact(self.end)}]"
        return f"{self.operator}{interval} ({self.signal} {self.comparison} {_exact(self.bound)})"


@dataclass(frozen=True)
class Formula:
    """A conjunction of terms; ``str`` gives text that parses to an equal formula."""

    terms: tuple[Term, ...]

    def __str__(self) -> str:
        return " and ".join(map(str, self.terms))

    @cached_property
    def signals(self) -> tuple[str, ...]:
        """The signals it reads, sorted."""
        return tuple(sorted({term.signal for term in self.terms}))

    @property
    def percept_signals(self) -> tuple[str, ...]:
        """Those of its signals that are percepts, not ground truth."""
        return tuple(name for name in self.signals if name.startswith("percept."))

    @property
    def horizon(self) -> float | None:
        """Seconds that a trace must last to decide every bounded term; ``None`` without one."""
        ends = [term.end for term in self.terms if term.end is not None]
        return max(ends) if ends else None


def unknown_signal(
    name: str, known: Iterable[str], formula: str, position: int | None
) -> ConfigurationError:
    """The error for a signal that nobody computes."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1)
    mark = marked(formula, position) if position is not None else f"\n    {formula}"
    return ConfigurationError(
        f"unknown signal {name!r} in the formula{mark}",
        found=name,
        expected="one of " + ", ".join(names),
        remedy=f"did you mean {near[0]!r}?" if near else "use a signal of the simulator",
    )


def marked(text: str, position: int) -> str:
    """The formula on one line, with a caret below the position."""
    line = "".join(" " if letter.isspace() else letter for letter in text)
    return f"\n    {line}\n    {' ' * position}^"


def _exact(number: float) -> str:
    """The shortest text that reads back as the same number."""
    return repr(number).removesuffix(".0")
