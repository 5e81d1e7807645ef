"""Compose error messages: nearest names, several errors in one, an error at its place."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

from pytest_dura.core.errors import ConfigurationError

MAX_LISTED_NAMES = 50
"""Names that a message lists at most; a fault grid may have made tens of thousands."""

_MAX_LISTED_PROBLEMS = 20
"""Problems that a message lists at most; a file may have any number of them."""


def list_names(names: Sequence[str]) -> str:
    """The names, or the first of them and how many more there are."""
    left = len(names) - MAX_LISTED_NAMES
    return ", ".join([*names[:MAX_LISTED_NAMES], *([f"{left} more"] if left > 0 else [])])


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A remedy: the nearest of the known names, or all of them when none is near."""
    names = sorted(set(known))
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    if near:
        return f"did you mean {near[0]!r}?"
    return "use one of: " + list_names(names) if names else "remove it"


class CombinedError(ConfigurationError):
    """Several errors in one message: the first in full, each other one in one line below it."""

    def __init__(self, parts: Sequence[ConfigurationError]) -> None:
        self.parts = tuple(parts)
        first = self.parts[0]
        lines = [first.remedy or "correct this and what follows"]
        lines += [
            f"  also:     {_single_line(error)}" for error in self.parts[1:_MAX_LISTED_PROBLEMS]
        ]
        if len(self.parts) > _MAX_LISTED_PROBLEMS:
            lines.append(f"  and {len(self.parts) - _MAX_LISTED_PROBLEMS:,} more")
        super().__init__(
            f"{first.problem} (the first of {len(self.parts)} problems)",
            file=first.file,
            line=first.line,
            key=first.key,
            found=first.found,
            expected=first.expected,
            remedy="\n".join(lines),
        )


def combine_errors(errors: Sequence[ConfigurationError]) -> ConfigurationError:
    """One error from at least one; combined ones among them are taken apart first."""
    flat: list[ConfigurationError] = []
    for error in errors:
        flat += error.parts if isinstance(error, CombinedError) else [error]
    return flat[0] if len(flat) == 1 else CombinedError(flat)


def error_at(
    error: ConfigurationError, *, file: str, line: int | None, key: str | None = None
) -> ConfigurationError:
    """The same error, told at its place in a file; ``key`` replaces the error's own."""
    return ConfigurationError(
        error.problem,
        file=file,
        line=line,
        key=key if key is not None else error.key,
        found=error.found,
        expected=error.expected,
        remedy=error.remedy or "correct the value",
    )


def _single_line(error: ConfigurationError) -> str:
    place = f"{error.file}:{error.line}: " if error.file and error.line else ""
    key = f" ({error.key})" if error.key else ""
    remedy = f"; {error.remedy.splitlines()[0]}" if error.remedy else ""
    return f"{place}{error.problem.splitlines()[0]}{key}{remedy}"
