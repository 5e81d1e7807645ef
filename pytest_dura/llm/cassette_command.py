"""Command ``cassette``: what a language model was asked and answered."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from pytest_dura.core.errors import ConfigurationError

SUMMARY = "list what a language model was asked and answered, as lines of JSON"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("file", metavar="FILE", type=Path, help="what --dura-llm=record wrote")
    parser.add_argument(
        "--drop-failures",
        action="store_true",
        help="remove the exchanges whose server was unavailable, so that recording asks again",
    )
    parser.add_argument(
        "--class",
        dest="classes",
        metavar="CLASS",
        choices=("unavailable", "timeout", "empty", "refused", "truncated", "malformed"),
        action="append",
        help="with --drop-failures: a class of failures to remove instead (repeatable)",
    )


def run(options: argparse.Namespace) -> Iterator[str]:
    """Yield the exchanges, or what was removed.

    Raises:
        ConfigurationError: For a file that cannot be used.
    """
    from pytest_dura.llm.cassette import cassette_lines, drop_failures

    if options.drop_failures:
        classes = options.classes or ["unavailable"]
        dropped, left = drop_failures(options.file, classes)
        shown = ", ".join(f"{dropped[failure]} {failure}" for failure in dict.fromkeys(classes))
        exchanges = "1 exchange" if dropped.total() == 1 else f"{dropped.total()} exchanges"
        yield f"removed {exchanges} that failed ({shown}); {left} are left"
        return
    if options.classes:
        raise ConfigurationError(
            "--class says what is removed, and nothing is",
            key="--class",
            found=", ".join(options.classes),
            remedy="add --drop-failures",
        )
    yield from cassette_lines(options.file)
