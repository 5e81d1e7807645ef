"""Command ``logs``: what a recorded log holds, a first mapping of it, and scenarios from it."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.text import one_line

SUMMARY = "look into a recorded log, write a first mapping, or make a scenario of it"
_LONGEST = 2000
"""Characters of a line, which may quote a damaged log."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("action", choices=("inspect", "scenario-from-log"), help="what to do")
    parser.add_argument("file", metavar="FILE", help="the log")
    parser.add_argument(
        "--mapping", metavar="FILE", type=Path,
        help="inspect: write a first mapping there; scenario-from-log: the mapping of the log",
    )  # fmt: skip
    parser.add_argument("--check", metavar="FORMULA", help="formula that the log violates")
    parser.add_argument("--output", metavar="FILE", type=Path, help="write the scenario there")
    parser.add_argument(
        "--before", metavar="SECONDS", type=float, help="how long before the violation it begins"
    )
    parser.add_argument("--road", metavar="NAME", help="built-in road on which it takes place")


def run(options: argparse.Namespace) -> Iterator[str]:
    """Yield what the log holds, and write the mapping or the scenario.

    Raises:
        ConfigurationError: For a log that cannot be read, and a mapping that is there already.
    """
    from pytest_dura.logs.inspection import first_mapping, inspected

    if options.action == "scenario-from-log":
        yield from _scenario(options)
        return
    for line in inspected(options.file):
        indent = line[: len(line) - len(line.lstrip())]
        yield indent + one_line(line, _LONGEST)
    if options.mapping is not None:
        _refuse_old(options.mapping, "mapping")
        options.mapping.write_text(first_mapping(options.file), "utf-8")
        yield f"a first mapping: {options.mapping}"


def _refuse_old(file: Path, what: str) -> None:
    if file.exists():
        raise ConfigurationError(
            f"the {what} is there already",
            file=str(file),
            expected="a new file",
            remedy="name another one, or remove it",
        )


def _scenario(options: argparse.Namespace) -> Iterator[str]:
    """Write the scenario of what a log shows before it violates a formula."""
    from pytest_dura.logs.scenarios import scenario_file

    for name in ("check", "output"):
        if getattr(options, name) is None:
            raise ConfigurationError(
                f"a scenario from a log needs --{name}",
                expected="--check FORMULA --output FILE",
                remedy="give both, and the mapping by --mapping",
            )
    _refuse_old(options.output, "scenario")
    how = {"before": options.before, "road": options.road}
    given = {name: value for name, value in how.items() if value is not None}
    text, notes = scenario_file(
        options.file, options.mapping, options.check, options.output.stem, **given
    )
    options.output.write_text(text, "utf-8")
    yield from (one_line(note, _LONGEST) for note in notes)
    yield f"a scenario: {options.output}"
