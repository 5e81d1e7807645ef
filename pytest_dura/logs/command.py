"""Command ``logs``: what a recorded log holds, and a first mapping of it."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.text import one_line

SUMMARY = "look into a recorded log, and write a first mapping"
_LONGEST = 2000
"""Characters of a line, which may quote a damaged log."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("action", choices=("inspect",), help="what to do")
    parser.add_argument("file", metavar="FILE", help="the log")
    parser.add_argument("--mapping", metavar="FILE", type=Path, help="write a first mapping there")


def run(options: argparse.Namespace) -> Iterator[str]:
    """Yield what the log holds, and write the mapping.

    Raises:
        ConfigurationError: For a log that cannot be read, and a mapping that is there already.
    """
    from pytest_dura.logs.inspection import first_mapping, inspected

    for line in inspected(options.file):
        indent = line[: len(line) - len(line.lstrip())]
        yield indent + one_line(line, _LONGEST)
    if options.mapping is not None:
        if options.mapping.exists():
            raise ConfigurationError(
                "the mapping is there already",
                file=str(options.mapping),
                expected="a new file",
                remedy="name another one, or remove it",
            )
        options.mapping.write_text(first_mapping(options.file), "utf-8")
        yield f"a first mapping: {options.mapping}"
