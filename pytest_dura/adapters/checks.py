"""Checks of a server by hand: a line each, with the remedy where one fails."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from pytest_dura.core.errors import ConfigurationError, describe_error

Check = tuple[Callable[..., str], str]
"""A function that says what it found, and what to do where it raises."""


def lines_of(checks: Sequence[Check], **where: Any) -> Iterator[str]:
    """Yield a line of each check, named by its function; none follows one that failed.

    Args:
        checks: In order.
        where: Arguments of each.
    """
    for check, remedy in checks:
        passed, text = _tried(check, where)
        name = check.__name__.removeprefix("_")
        yield f"ok    {name}: {text}" if passed else f"FAIL  {name}: {text}; remedy: {remedy}"
        if not passed:
            return


def print_lines(lines: Iterable[str], close: Callable[[], None]) -> int:
    """Print lines as they come; returns 1 if a check failed, 2 for a wrong call."""
    failed = False
    try:
        for line in lines:
            print(line, flush=True)  # noqa: T201 - a command prints
            failed |= line.startswith("FAIL")
    except ConfigurationError as error:
        print(error, file=sys.stderr)  # noqa: T201 - a command prints
        return 2
    finally:
        close()
    return int(failed)


def _tried(check: Callable[..., str], where: dict[str, Any]) -> tuple[bool, str]:
    try:
        return True, check(**where)
    except Exception as error:
        return False, " ".join(describe_error(error).split())
