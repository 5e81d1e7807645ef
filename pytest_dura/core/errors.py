"""Every error that pytest-dura raises on purpose: what happened, where, and how to mend it."""

from __future__ import annotations


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


def shorten(value: object, limit: int = 120) -> str:
    """A value's ``repr`` on one line of at most ``limit`` characters."""
    text = " ".join(repr(value).split())
    return text if len(text) <= limit else text[: limit - 1] + "…"
