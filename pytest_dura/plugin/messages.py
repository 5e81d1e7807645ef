"""What is shown to a user and quotes files or components, in which there may be anything."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import pytest

LIMIT = 20_000
"""Characters of a message of our own."""
LINE = 5000
"""Characters of a line in the terminal."""
LONGEST = 200_000
"""Characters of a message of the user's own."""


def make_visible(error: BaseException) -> None:
    """Change the texts of an error, and of those that led to it, so that no terminal acts on them.

    Tests quote what components say, in messages of their own. A lone surrogate in a single one
    ends a session under xdist, and one that Allure reports.
    """
    from pytest_dura.evidence.text import visible

    for one in _chain(error):
        if isinstance(one, (pytest.fail.Exception, pytest.skip.Exception)):
            one.msg = visible(str(one.msg), LIMIT)
            one.args = (one.msg,)
        elif any(isinstance(text, str) and not text.isprintable() for text in one.args):
            one.args = tuple(
                visible(text, LONGEST) if isinstance(text, str) else text for text in one.args
            )


def _chain(error: BaseException) -> Iterator[BaseException]:
    """The error, what it was raised from, what was being handled, and so on."""
    seen: set[int] = set()
    left: list[BaseException | None] = [error]
    while left:
        one = left.pop()
        if one is not None and id(one) not in seen:
            seen.add(id(one))
            yield one
            left += [one.__cause__, one.__context__]


def make_reason_visible(marker: pytest.Mark) -> None:
    """Change the reason that a marker gives, likewise."""
    from pytest_dura.evidence.text import visible

    reason = marker.kwargs.get("reason")
    if isinstance(reason, str):
        # The dictionary is the marker's own, whatever its type says.
        marker.kwargs["reason"] = visible(reason, LIMIT)  # type: ignore[index]


def error_text(error: Exception) -> str:
    """The message of one of our own errors, on which no terminal acts."""
    from pytest_dura.evidence.text import visible

    return visible(str(error), LIMIT)


def shown_lines(text: str) -> Iterator[str]:
    """A text for a terminal, on which nothing in it acts; only its first line is not indented.

    So nothing that a component says reads as a line of ours.
    """
    from pytest_dura.evidence.text import visible

    first, *rest = visible(text, LINE).split("\n")
    yield first
    yield from (f"    {line}" for line in rest)


def apart(text: str) -> str:
    """A text that begins with a name of a user's, which must not read as a line of ours."""
    return f" {text}" if text.startswith(("|", "#", "gate:")) else text


def say(lines: Iterable[str]) -> None:
    """Print these lines."""
    for line in lines:
        for one in shown_lines(line):
            print(one)  # noqa: T201 - it is what a command was asked for


class Shown:
    """pytest's terminal, on which no text of a file or component acts.

    Args:
        terminal: pytest's own.
    """

    def __init__(self, terminal: Any) -> None:
        self._terminal = terminal

    def line(self, text: str, **colour: bool) -> None:
        """Write a line."""
        for one in shown_lines(text):
            self._terminal.line(one, **colour)

    def write(self, text: str, **colour: bool) -> None:
        """Write the beginning of a line."""
        self._terminal.write(next(shown_lines(text)), **colour)
