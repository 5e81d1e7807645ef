"""Command ``logs``: what a recorded log holds, a first mapping of it, and scenarios from it."""

from __future__ import annotations

import argparse
import math
from collections.abc import Generator, Iterator
from pathlib import Path

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.text import one_line

SUMMARY = "look into a recorded log, write a first mapping, or make a scenario of it"
_LONGEST = 2000
"""Characters of a line, which may quote a damaged log."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "action", choices=("inspect", "judge", "watch", "scenario-from-log"), help="what to do",
    )  # fmt: skip
    parser.add_argument("file", metavar="FILE", help="the log; of watch: -, standard input")
    parser.add_argument(
        "--mapping", metavar="FILE", type=Path,
        help="inspect: write a first mapping there; scenario-from-log: the mapping of the log",
    )  # fmt: skip
    parser.add_argument(
        "--check", metavar="FORMULA", action="append", default=[],
        help="formula to judge by, or that the log violates; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--requirements", metavar="FILE", type=Path, help="requirements to judge by"
    )
    parser.add_argument(
        "--time-step", metavar="SECONDS", type=float, help="seconds from sample to sample"
    )
    parser.add_argument("--output", metavar="FILE", type=Path, help="write the scenario there")
    parser.add_argument(
        "--before", metavar="SECONDS", type=float, help="how long before the violation it begins"
    )
    parser.add_argument("--road", metavar="NAME", help="built-in road on which it takes place")


def run(options: argparse.Namespace) -> Generator[str, None, int]:
    """Yield what the log holds or how it is judged, and write the mapping or the scenario.

    Returns:
        The exit code: 1 if a log that is judged does not satisfy each formula.

    Raises:
        ConfigurationError: For a log that cannot be read, and a mapping that is there already.
    """
    from pytest_dura.logs.inspection import first_mapping, inspected

    if options.action == "scenario-from-log":
        yield from _scenario(options)
        return 0
    if options.action in ("judge", "watch"):
        return (yield from _judged(options))
    for line in inspected(options.file):
        indent = line[: len(line) - len(line.lstrip())]
        yield indent + one_line(line, _LONGEST)
    if options.mapping is not None:
        _refuse_old(options.mapping, "mapping")
        _write(options.mapping, "mapping", first_mapping(options.file))
        yield f"a first mapping: {options.mapping}"
    return 0


def _write(file: Path, what: str, text: str) -> None:
    try:
        file.write_text(text, "utf-8")
    except OSError as error:
        raise ConfigurationError(
            f"the {what} cannot be written: {error.strerror or error}",
            file=str(file),
            expected="a new file in a folder that is there",
            remedy="make the folder, or name another file",
        ) from None


def _refuse_old(file: Path, what: str) -> None:
    if file.exists():
        raise ConfigurationError(
            f"the {what} is there already",
            file=str(file),
            expected="a new file",
            remedy="name another one, or remove it",
        )


def _judged(options: argparse.Namespace) -> Generator[str, None, int]:
    """Judge a log block by block, or what comes from standard input."""
    from pytest_dura.logs.judging import checks_of, judged_lines, watched_lines

    checks = checks_of(options.requirements, options.check)
    if options.action == "watch":
        if options.file != "-":
            raise ConfigurationError(
                "a live stream is read from standard input",
                found=options.file,
                expected="-",
                remedy="write `COMMAND | python -m pytest_dura logs watch -`, or `logs judge FILE`",
            )
        lines = watched_lines(options.mapping, checks, options.time_step, None)
    else:
        lines = judged_lines(options.file, options.mapping, checks, options.time_step)
    code = 0

    def found() -> Iterator[str]:
        nonlocal code
        code = yield from lines

    for line in found():
        yield one_line(line, _LONGEST)
    return code


def _scenario(options: argparse.Namespace) -> Iterator[str]:
    """Write the scenario of what a log shows before it violates a formula."""
    from pytest_dura.logs.scenarios import scenario_file

    for name in ("check", "output"):
        if not getattr(options, name):
            raise ConfigurationError(
                f"a scenario from a log needs --{name}",
                expected="--check FORMULA --output FILE",
                remedy="give both, and the mapping by --mapping",
            )
    before = options.before
    if before is not None and not (math.isfinite(before) and before >= 0):
        raise ConfigurationError(
            "a scenario begins a finite number of seconds before the violation",
            key="--before",
            found=before,
            expected="a number of at least 0",
            remedy="write for example `--before 4`",
        )
    _refuse_old(options.output, "scenario")
    how = {"before": before, "road": options.road}
    given = {name: value for name, value in how.items() if value is not None}
    text, notes = scenario_file(
        options.file, options.mapping, options.check[-1], options.output.stem, **given
    )
    _write(options.output, "scenario", text)
    yield from (one_line(note, _LONGEST) for note in notes)
    yield f"a scenario: {options.output}"
