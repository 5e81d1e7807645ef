"""Errors that pytest-dura raises on purpose: what happened, where, and how to mend it.

An environment error is a failure of what the component rests on, such as a recording without the
answer, that comes up within the component's own call. It is reported to the loop where it is
raised, so that the episode ends as missing whether the component passes it on or catches it.
"""

from __future__ import annotations

import difflib
import linecache
import re
import sysconfig
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from types import CodeType
from typing import Any

from pytest_dura.core.boundary import CallEnded, let_pass, traceback_of

_name_of: Any = vars(type)["__name__"].__get__

LONGEST_TEXT = 10_000
"""Characters that are kept of one text of a component, a role or a simulator."""
_AROUND = 1_000
MAX_LISTED_NAMES = 50
"""Names that a message lists at most; a fault grid may have made tens of thousands."""
_MAX_LISTED_PROBLEMS = 20
"""Problems that a message lists at most; a file may have any number of them."""


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
    """Make one error of one or more; combined ones among them are taken apart first."""
    flat: list[ConfigurationError] = []
    for error in errors:
        flat += error.parts if isinstance(error, CombinedError) else [error]
    return flat[0] if len(flat) == 1 else CombinedError(flat)


def error_at(
    error: ConfigurationError, *, file: str, line: int | None, key: str | None = None
) -> ConfigurationError:
    """Give an error its place in a file; ``key`` replaces the error's own."""
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


def list_names(names: Sequence[str]) -> str:
    """Join the names, or the first :data:`MAX_LISTED_NAMES` and the number of the rest."""
    left = len(names) - MAX_LISTED_NAMES
    return ", ".join([*names[:MAX_LISTED_NAMES], *([f"{left} more"] if left > 0 else [])])


_TIME = re.compile(r"\s*(\d+(?:\.\d+)?)\s*(ms|s|min|h|d)\s*")
_SECONDS = {"ms": 0.001, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}


def corrected(value: object) -> str:
    """Say how to correct a value that should be a number; formulas take ``8h``, files seconds."""
    time = _TIME.fullmatch(value) if isinstance(value, str) else None
    if time is None:
        return "correct the value"
    return f"write it in seconds: {float(time[1]) * _SECONDS[time[2]]:.12g}"


def did_you_mean(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """Suggest the nearest of the known names.

    Args:
        name: What was found.
        known: What could stand there.
        otherwise: Remedy where none is near; by default a list of them.
    """
    names = sorted(set(known))
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    if near:
        return f"did you mean {near[0]!r}?"
    if otherwise:
        return otherwise
    return "use one of: " + list_names(names) if names else "remove it"


class ActionError(DuraError):
    """The component proposed something that is not an action of this simulator."""


class InfrastructureError(DuraError):
    """A role other than the Generator, or the simulator, failed: the episode says nothing.

    The message starts with ``infrastructure:`` and names the role and the tick.
    """

    def __init__(self, role: str, tick: int, time: float, cause: str, traceback: str = "") -> None:
        self.role, self.tick, self.time, self.cause = role, tick, time, cause
        self.traceback = traceback
        super().__init__(f"infrastructure: {role} at tick {tick} (t = {time:.1f} s): {cause}")


class ConformanceError(DuraError):
    """A simulator adapter or a role breaks its contract. The message lists every breach.

    Args:
        subject: What was checked.
        breaches: ``(problem, remedy)``, in the order of the checks.
    """

    def __init__(self, subject: str, breaches: Sequence[tuple[str, str]]) -> None:
        self.subject, self.breaches = subject, tuple(breaches)
        noun = "breach" if len(self.breaches) == 1 else "breaches"
        lines = [f"{subject}: {len(self.breaches)} {noun} of the contract"]
        for number, (problem, remedy) in enumerate(self.breaches, start=1):
            lines += [f"  {number}. {problem}", f"     remedy: {remedy}"]
        super().__init__("\n".join(lines))


_ADDRESS = re.compile(r"\b0x[0-9a-fA-F]{6,}")


def describe_error(error: BaseException) -> str:
    """Type, message and place of an error, without what changes from process to process.

    The place is the innermost frame of the user's own files, or else the innermost one: what a
    library raises is called somewhere. Memory addresses are blanked and the place is a file's name
    without its folder, because the text goes into the episode's digest. Errors raised by the loop
    itself have no place. The error's class may override anything, ``__str__`` included.
    """
    message = cut(read_text(str, error, "(its message cannot be read)"))
    text = f"{type_name(error)}: {message}" if message else type_name(error)
    text = _ADDRESS.sub("0x…", text)
    trace = traceback_of(error)
    place: tuple[CodeType, int] | None = None
    while trace is not None:
        code = trace.tb_frame.f_code
        if trace.tb_next is None and Path(code.co_filename).parent == Path(__file__).parent:
            return text
        own = _is_own_file(code.co_filename)
        if own or place is None or not _is_own_file(place[0].co_filename):
            place = code, trace.tb_lineno
        trace = trace.tb_next
    if place is None:
        return text
    code, line = place
    function = "" if code.co_name == "<module>" else f" in {code.co_name}"
    return f"{text} ({Path(code.co_filename).name}:{line}{function})"


_MOST_LINKS, _MOST_FRAMES, _LONGEST_LINE = 3, 20, 300
_below_error: Any = {
    name: vars(BaseException)[name].__get__
    for name in ("__cause__", "__context__", "__suppress_context__", "args")
}


def traceback_text(error: BaseException) -> str:
    """Whole traceback of an error and of what led to it, as Python writes it, in bounded length.

    The frames of this package that come before any others are left out, and of very many frames
    those in the middle. No code of the error's class runs. The text is no part of a digest.
    """
    parts: list[str] = []
    link: BaseException | None = error
    while link is not None and len(parts) < 2 * _MOST_LINKS:
        frames = [f"  {line}" for line in _frame_lines(link)]
        head = ["Traceback (most recent call last):"] if frames else []
        parts.insert(0, "\n".join([*head, *frames, _plain_message(link)]))
        cause = _below_error["__cause__"](link)
        hidden = _below_error["__suppress_context__"](link)
        link = cause if cause is not None or hidden else _below_error["__context__"](link)
        if link is not None:
            how = (
                "During handling of the above exception, another exception occurred:"
                if cause is None
                else "The above exception was the direct cause of the following exception:"
            )
            parts.insert(0, how)
    while len(text := "\n\n".join(parts)) > LONGEST_TEXT and len(parts) > 1:
        del parts[0]
    return cut(text)


def _frame_lines(error: BaseException) -> Iterator[str]:
    """Two lines for each frame: its place, and its source as far as that is known."""
    places: list[tuple[CodeType, int]] = []
    trace = traceback_of(error)
    while trace is not None:
        places.append((trace.tb_frame.f_code, trace.tb_lineno))
        trace = trace.tb_next
    core = Path(__file__).parent
    outer = 0
    while outer < len(places) and Path(places[outer][0].co_filename).parent == core:
        outer += 1
    places = places[outer:] or places
    half = _MOST_FRAMES // 2
    for number, (code, line) in enumerate(places):
        if half <= number < len(places) - half:
            if number == half:
                yield f"({len(places) - 2 * half} frames are left out)"
            continue
        yield f'File "{_shown_file(code.co_filename)}", line {line}, in {code.co_name}'
        source = linecache.getline(code.co_filename, line).strip()
        if source:
            long = len(source) > _LONGEST_LINE
            yield f"  {f'(a line of {len(source)} characters)' if long else source}"


def _shown_file(file: str) -> str:
    """A file's path, from the current directory where it is below that."""
    try:
        return str(Path(file).relative_to(Path.cwd()))
    except (OSError, ValueError):  # it is elsewhere, or that directory was removed
        return file


def _plain_message(error: BaseException) -> str:
    """Type of an error and those of its arguments that are of Python's own types."""
    args = _below_error["args"](error)
    plain = [str(each) for each in args if type(each) in (str, int, float)]
    message = cut(_ADDRESS.sub("0x…", ", ".join(plain)))
    return f"{type_name(error)}: {message}" if message else type_name(error)


_LIBRARIES = ("stdlib", "platstdlib", "purelib", "platlib")


@lru_cache(maxsize=1024)
def _is_own_file(file: str) -> bool:
    """Whether a file is a user's: of no package that is installed, this one and Python included."""
    if file.startswith("<"):
        return False
    path = Path(file).resolve()
    paths = sysconfig.get_paths()
    known = [Path(__file__).parents[1], *(Path(paths[key]) for key in _LIBRARIES)]
    installed = {"site-packages", "dist-packages"}.intersection(path.parts)
    return not installed and not any(path.is_relative_to(each.resolve()) for each in known)


def import_error(
    error: BaseException, problem: str, *, module: str, found: str, expected: str, remedy: str
) -> ConfigurationError:
    """Make the error of an import that failed.

    A refused declaration of the module says itself what was expected and what to do about it, and
    stands at the line of that module.

    Args:
        error: What the import raised.
        problem: What cannot be done without it.
        module: Name of the imported module.
        found: The import path.
        expected: What would have been accepted, of any other error.
        remedy: What to do about any other error.
    """
    if not isinstance(error, ConfigurationError):
        return ConfigurationError(
            f"{problem}: {describe_error(error)}", found=found, expected=expected, remedy=remedy
        )
    package, place, trace = module.partition(".")[0], "", traceback_of(error)
    while trace is not None:
        code = trace.tb_frame.f_code
        if str(trace.tb_frame.f_globals.get("__name__", "")).partition(".")[0] == package:
            place = f" ({Path(code.co_filename).name}:{trace.tb_lineno})"
        trace = trace.tb_next
    declared = None if error.found in (None, "") else error.found
    return ConfigurationError(
        f"{problem}: {error.problem}{place}",
        found=declared,
        expected=error.expected,
        remedy=error.remedy or remedy,
    )


def type_name(value: object) -> str:
    """Name of a value's class, read past its metaclass."""
    return str.__str__(_name_of(type(value)))


def read_text(read: Any, value: object, instead: str) -> str:
    """Text that ``str`` or ``repr`` gives of a value of any class.

    Args:
        read: ``str`` or ``repr``.
        value: Of any class.
        instead: Returned for a value that raises in place of giving a text.
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
    """Shorten a text beyond :data:`LONGEST_TEXT` to its beginning and the number of the rest.

    A text that was cut before stays as it is, also with what was added around it.
    """
    if len(text) <= LONGEST_TEXT + _AROUND:
        return text
    return f"{text[:LONGEST_TEXT]}… ({len(text) - LONGEST_TEXT} characters cut)"


def shorten(value: object, limit: int = 120) -> str:
    """``repr`` of a value, on one line of at most ``limit`` characters."""
    text = " ".join(read_text(repr, value, f"<{type_name(value)}>").split())
    return text if len(text) <= limit else text[: limit - 1] + "…"


class ComponentEnvironmentError(DuraError):
    """What the component rests on failed, not the component.

    Raise it as ``raise report_environment_error(error)``; one that is only raised counts as the
    component's own error.

    Args:
        source: What failed, in one word, such as ``recording``.
        problem: What is wrong and how to mend it, in bounded length.
    """

    def __init__(self, source: str, problem: str) -> None:
        self.source = source
        super().__init__(problem)


_Report = list[ComponentEnvironmentError]
_own_report: ContextVar[_Report | None] = ContextVar("dura_environment_errors", default=None)
_open_reports: dict[int, list[_Report]] = {}
"""Lists of the contexts that are open by thread, the innermost last. A thread that a component
starts of its own has an empty context, or that of an earlier call, and reports to every thread that
calls a component."""


def report_environment_error(error: ComponentEnvironmentError) -> ComponentEnvironmentError:
    """Report a failure to the loop, whatever the component makes of the error, from any thread.

    Returns:
        The error, to be raised.
    """
    own, threads = _own_report.get(), list(_open_reports.values())
    if own is not None and any(own is report for reports in threads for report in reports):
        own.append(error)
        return error
    for reports in threads:
        reports[-1].append(error)
    return error


class environment_errors:  # noqa: N801 - used as a function
    """Context with the list of errors that are reported in it, and in no context within it."""

    __slots__ = ("_thread", "_token")

    def __enter__(self) -> list[ComponentEnvironmentError]:
        """Open the list; not by a generator, since it happens at each tick."""
        reported: _Report = []
        thread = self._thread = threading.get_ident()
        outer = _open_reports.get(thread)
        _open_reports[thread] = [reported] if outer is None else [*outer, reported]
        self._token = _own_report.set(reported)
        return reported

    def __exit__(self, *_: object) -> None:
        """Close it."""
        _own_report.reset(self._token)
        outer = _open_reports.pop(self._thread)
        if len(outer) > 1:
            _open_reports[self._thread] = outer[:-1]
