"""Errors that pytest-dura raises on purpose: what happened, where, and how to mend it.

An environment error is a failure of what the component rests on, such as a cassette without the
answer, that comes up within the component's own call. The component may pass it on or catch it, and
neither says anything about the component: the loop is told at the same time, and ends the episode
as missing.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pytest_dura.core.boundary import CallEnded, let_pass

_name_of: Any = vars(type)["__name__"].__get__
_traceback_of: Any = vars(BaseException)["__traceback__"].__get__

LONGEST_TEXT = 10_000
"""Characters that are kept of what a component, a role or a simulator says at once."""
_AROUND = 1_000


class DuraError(Exception):
    """Base of all deliberate errors; ``str(error)`` is the whole message for the user."""


class ConfigurationError(DuraError):
    """A scenario, requirement, option or role declaration that cannot be used.

    Args:
        problem: What is wrong, in one sentence.
        file: The file it stands in, where it came from a file.
        line: One-based line in that file.
        key: Dotted path of the offending key or the option's name.
        found: The offending value.
        expected: What would have been accepted.
        remedy: What to do about it.
    """

    def __init__(
        self,
        problem: str,
        *,
        file: str | None = None,
        line: int | None = None,
        key: str | None = None,
        found: object = None,
        expected: str | None = None,
        remedy: str | None = None,
    ) -> None:
        self.problem, self.file, self.line, self.key = problem, file, line, key
        self.found, self.expected, self.remedy = found, expected, remedy
        super().__init__(self._message())

    def _message(self) -> str:
        place = self.file or ""
        if self.file and self.line is not None:
            place += f":{self.line}"
        parts = [f"{place}: {self.problem}" if place else self.problem]
        if self.key is not None:
            parts.append(f"  key:      {self.key}")
        if self.found is not None:
            parts.append(f"  found:    {shorten(self.found)}")
        if self.expected is not None:
            parts.append(f"  expected: {self.expected}")
        if self.remedy is not None:
            parts.append(f"  remedy:   {self.remedy}")
        return "\n".join(parts)


class ActionError(DuraError):
    """The component proposed something that is not an action of this simulator."""


class InfrastructureError(DuraError):
    """A role other than the Generator, or the simulator, failed: the episode says nothing.

    The message starts with ``infrastructure:`` and names the role and the tick.
    """

    def __init__(self, role: str, tick: int, time: float, cause: str) -> None:
        self.role, self.tick, self.time, self.cause = role, tick, time, cause
        super().__init__(f"infrastructure: {role} at tick {tick} (t = {time:.1f} s): {cause}")


class ConformanceError(DuraError):
    """A simulator adapter or a role breaks its contract. The message lists every breach.

    Args:
        subject: What was checked.
        breaches: ``(what is wrong, how to mend it)``, in the order in which they were found.
    """

    def __init__(self, subject: str, breaches: Sequence[tuple[str, str]]) -> None:
        self.subject, self.breaches = subject, tuple(breaches)
        noun = "breach" if len(self.breaches) == 1 else "breaches"
        lines = [f"{subject}: {len(self.breaches)} {noun} of the contract"]
        for number, (problem, remedy) in enumerate(self.breaches, start=1):
            lines += [f"  {number}. {problem}", f"     remedy: {remedy}"]
        super().__init__("\n".join(lines))


def describe_error(error: BaseException) -> str:
    """Type, message and place of an error, without what changes from process to process.

    Memory addresses are blanked and the place is a file's name without its folder, because the
    text goes into the episode's digest. Errors raised by the loop itself have no place. The error
    may be of a class that does what it likes where it is looked at.
    """
    message = cut(read_text(str, error, "(its message cannot be read)"))
    text = f"{type_name(error)}: {message}" if message else type_name(error)
    text = re.sub(r"\b0x[0-9a-fA-F]{6,}", "0x…", text)
    trace = _traceback_of(error)
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None:
        return text
    file = Path(trace.tb_frame.f_code.co_filename)
    if file.parent == Path(__file__).parent:
        return text
    return f"{text} ({file.name}:{trace.tb_lineno})"


def type_name(value: object) -> str:
    """The name of a value's class, whatever its metaclass says."""
    return str.__str__(_name_of(type(value)))


def read_text(read: Any, value: object, instead: str) -> str:
    """The text that ``str`` or ``repr`` gives of a value, whatever the value does about it.

    Args:
        read: ``str`` or ``repr``.
        value: Of any class.
        instead: What is told of a value that gives no text.
    """
    try:
        text = str.__str__(read(value))
    except CallEnded:
        raise
    except BaseException as error:  # of a user's class, which may raise anything
        let_pass(error)
        return instead
    return text


def cut(text: str) -> str:
    """The text, or how it begins and how many characters were cut off.

    A text of which a part was cut already stays as it is, with what stands around that.
    """
    if len(text) <= LONGEST_TEXT + _AROUND:
        return text
    return f"{text[:LONGEST_TEXT]}… ({len(text) - LONGEST_TEXT} characters cut)"


def shorten(value: object, limit: int = 120) -> str:
    """A value's ``repr`` on one line of at most ``limit`` characters."""
    shown = read_text(repr, value, f"<{type_name(value)}>")
    text = " ".join(shown.split())
    return text if len(text) <= limit else text[: limit - 1] + "…"


class ComponentEnvironmentError(DuraError):
    """What the component rests on failed, not the component. Raise it as ``raise told(error)``.

    Args:
        source: What failed, in one word, such as ``cassette``.
        problem: What is wrong and how to mend it, in bounded length.
    """

    def __init__(self, source: str, problem: str) -> None:
        self.source = source
        super().__init__(problem)


_COLLECTORS: list[list[ComponentEnvironmentError]] = []


def report_environment_error(error: ComponentEnvironmentError) -> ComponentEnvironmentError:
    """Tell the loop, whatever the component makes of the error; returns it, to be raised."""
    if _COLLECTORS:
        _COLLECTORS[-1].append(error)
    return error


class environment_errors:  # noqa: N801 - reads like a statement
    """Context with a list that is filled with what is told meanwhile.

    Of nested ones the innermost hears it. A class, since it is entered at each tick.
    """

    def __enter__(self) -> list[ComponentEnvironmentError]:
        """Begin to listen."""
        heard: list[ComponentEnvironmentError] = []
        _COLLECTORS.append(heard)
        return heard

    def __exit__(self, *_: object) -> None:
        """Listen no more."""
        _COLLECTORS.pop()
