"""Texts for a user: lines on which no terminal and no CI acts, paths, commands to run again."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError, DuraError
from pytest_dura.plugin.options import Options

if TYPE_CHECKING:
    from pytest_dura.evidence.redaction import Redactor


def sibling_directory(evidence: Path, what: str) -> Path:
    """Name a directory beside the evidence, whose manifest lists all that is in it.

    Args:
        evidence: The evidence directory.
        what: Follows its name, as in ``dura-evidence-replay``.
    """
    place = evidence.resolve()
    return place.with_name(f"{place.name}-{what}")


def typed_path(file: Path, here: Path) -> str:
    """Return the path of a file as the user would type it.

    Args:
        file: The file, or folder.
        here: The directory in which pytest was started.
    """
    try:
        return os.path.relpath(file, here)
    except ValueError:  # it is on another drive of Windows
        return str(file)


def apply_code_places(config: pytest.Config) -> None:
    """Let files name code of the project, and none that lies beside a stranger's files.

    Strange are a bundle that is replayed or reduced, and files outside of pytest's root directory
    that the command line names. What was in force before comes back when the session ends.

    Args:
        config: Of the session.
    """
    from pytest_dura.core.trust import Places, use_places

    get, here = config.getoption, config.invocation_params.dir
    files = [here / path for path in get("dura_path")]
    files += [here / path for path in get("dura_faults") if path.endswith((".yaml", ".yml"))]
    foreign = [path if path.is_dir() else path.parent for path in files]
    foreign = [
        path for path in foreign if not path.resolve().is_relative_to(config.rootpath.resolve())
    ]
    one_episode = get("dura_replay") is not None or get("dura_reduce") is not None
    if one_episode or get("dura_replay_failures"):
        given = get("dura_evidence")
        foreign.append(here / given if given else config.rootpath / str(Options.evidence.default))
    trusting = get("dura_trust_code")
    places = Places.of([config.rootpath], [] if trusting else foreign, trusting=trusting)
    previous = use_places(places)

    def restore() -> None:
        use_places(previous)

    config.add_cleanup(restore)


_LONGEST_MESSAGE = 20_000
"""Characters of a message of our own."""
_LONGEST_LINE = 5000
"""Characters of a line in the terminal."""
_LONGEST_USER_TEXT = 200_000
"""Characters of a message of the user's own."""


def escape_error(error: BaseException) -> None:
    """Escape the texts of an error and of its causes, so that no terminal and no CI acts on them.

    Tests quote what components say, in messages of their own. A lone surrogate in a single one
    ends a session under xdist, and one that Allure reports.
    """
    for link in _error_chain(error):
        if isinstance(link, (pytest.fail.Exception, pytest.skip.Exception)):
            link.msg = printed(str(link.msg))
            link.args = (link.msg,)
        elif any(isinstance(text, str) and not _is_harmless(text) for text in link.args):
            link.args = tuple(
                printed(text, _LONGEST_USER_TEXT) if isinstance(text, str) else text
                for text in link.args
            )


def printed(text: str, limit: int = _LONGEST_MESSAGE) -> str:
    """Escape a text for terminals and for the logs of a CI."""
    from pytest_dura.evidence.text import visible, without_commands

    return without_commands(visible(text, limit))


def _is_harmless(text: str) -> bool:
    from pytest_dura.evidence.text import without_commands

    return text.isprintable() and without_commands(text) == text


Redact = Callable[[Any], Any]
"""Copies plain data without secrets."""


def redact_error(error: BaseException, redact: Redact) -> None:
    """Take secrets out of the messages of an error, of its causes and of what it groups.

    A report indents the lines of a message, so that a secret of several lines is no longer whole.
    """
    for link in _error_chain(error):
        for name in ("args", "msg", "__notes__"):
            known = getattr(link, name, None)
            if isinstance(known, (str, list, tuple)) and (safe := redact(known)) != known:
                setattr(link, name, safe)


def redact_report(report: pytest.TestReport | pytest.CollectReport, redactor: Redactor) -> None:
    """Take secrets out of what a report shows: the failure, captured output, properties.

    All of it is searched at once; in the report of a test that passes there is hardly ever a hint.
    """
    texts = _plain_texts(report)
    if texts is None:
        texts = found = list[Any]()

        def note(part: Any) -> Any:
            found.append(part)
            return part

        _redact_report(report, note)
    if texts and redactor.may_change(texts):
        _redact_report(report, redactor.redact)


def _plain_texts(report: pytest.TestReport | pytest.CollectReport) -> list[Any] | None:
    """List what a report without a failure shows; ``None`` where it shows more than plain texts."""
    shown = [*report.sections, *getattr(report, "user_properties", ())]
    if report.longrepr is not None or hasattr(report, "wasxfail"):
        return None
    if not all(type(entry) is tuple for entry in shown):
        return None
    texts = list(chain.from_iterable(shown))
    return texts if all(type(text) is str for text in texts) else None


def _redact_report(report: pytest.TestReport | pytest.CollectReport, redact: Redact) -> None:
    report.longrepr = _redacted_parts(report.longrepr, redact)
    report.sections = [_redacted_parts(section, redact) for section in report.sections]
    if isinstance(report, pytest.TestReport):
        properties = [_redacted_parts(entry, redact) for entry in report.user_properties]
        report.user_properties = properties
        if hasattr(report, "wasxfail"):
            report.wasxfail = redact(report.wasxfail)


def _redacted_parts(value: Any, redact: Redact) -> Any:
    """Redact a text, or the object of texts of which pytest makes one."""
    if isinstance(value, str):
        return redact(value)
    if isinstance(value, list) and value and all(isinstance(line, str) for line in value):
        return redact("\n".join(value)).split("\n")  # a secret may have several lines
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], str):
        ((name, part),) = redact({value[0]: value[1]}).items()
        return name, _redacted_parts(part, redact)
    if isinstance(value, (list, tuple)):
        return type(value)(_redacted_parts(part, redact) for part in value)
    if hasattr(value, "toterminal"):
        for name, part in vars(value).items():
            setattr(value, name, _redacted_parts(part, redact))
    return value


def _error_chain(error: BaseException) -> Iterator[BaseException]:
    """Yield the error, its causes, its contexts and what it groups, each once."""
    seen: set[int] = set()
    pending: list[BaseException | None] = [error]
    while pending:
        link = pending.pop()
        if link is not None and id(link) not in seen:
            seen.add(id(link))
            yield link
            pending += [link.__cause__, link.__context__, *getattr(link, "exceptions", ())]


def escape_reason(marker: pytest.Mark) -> None:
    """Escape the reason that a marker gives."""
    reason = marker.kwargs.get("reason")
    if isinstance(reason, str):
        # The dictionary is the marker's own, whatever its type says.
        marker.kwargs["reason"] = printed(reason)  # type: ignore[index]


def error_text(error: Exception) -> str:
    """Return the message of one of our own errors, escaped for terminals."""
    return printed(str(error))


def failure_text(error: DuraError) -> str:
    """Return the message of a test that fails by one of our own errors."""
    falsification = getattr(error, "falsification", None)
    if falsification is None:
        return str(error)
    from pytest_dura.reports.searches import failure_lines

    not_kept = [f"not kept: {reason}" for reason in getattr(error, "not_kept", ())]
    units = getattr(error, "units", {})
    return "\n".join([*failure_lines(falsification, units), *not_kept])


class usage_errors:  # noqa: N801 - reads like a statement
    """Context in which a configuration error becomes a usage error: one message, exit code 4."""

    def __enter__(self) -> None:
        """Nothing to prepare."""

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Translate."""
        if isinstance(error, ConfigurationError):
            raise pytest.UsageError(error_text(error)) from None


def safe_lines(text: str) -> Iterator[str]:
    """Yield the lines of a text, escaped for terminals; all but the first are indented.

    So nothing that a component says reads as a line of ours.
    """
    first, *rest = printed(text, _LONGEST_LINE).split("\n")
    yield first
    yield from (f"    {line}" for line in rest)


def print_lines(lines: Iterable[str], redact: Redact = str) -> None:
    """Print lines without secrets, escaped for terminals."""
    for line in map(redact, lines):
        for safe_line in safe_lines(line):
            print(safe_line)  # noqa: T201 - it is what a command was asked for


class SafeTerminal:
    """pytest's terminal, which escapes every text that is written.

    Args:
        terminal: pytest's own.
    """

    def __init__(self, terminal: Any) -> None:
        self._terminal = terminal

    def line(self, text: str, **colour: bool) -> None:
        """Write a line."""
        for safe_line in safe_lines(text):
            self._terminal.line(safe_line, **colour)

    def write(self, text: str, **colour: bool) -> None:
        """Write the beginning of a line."""
        self._terminal.write(next(safe_lines(text)), **colour)
