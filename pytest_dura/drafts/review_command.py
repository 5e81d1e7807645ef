"""Command ``review``: the decision of a person on drafted requirements."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

SUMMARY = "write a person's decision into a file of drafted requirements, which count from then on"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("file", metavar="FILE", type=Path, help="what `draft -o FILE` wrote")
    parser.add_argument(
        "review", metavar="REVIEW", type=Path,
        help="a YAML file with who, when, what and decision, as `sign --review` takes it",
    )  # fmt: skip
    parser.add_argument(
        "--only", metavar="ID", action="append", default=[],
        help="the draft that was reviewed (repeatable); by default all that wait for it",
    )  # fmt: skip


def run(options: argparse.Namespace) -> Iterator[str]:
    """Yield what was decided, and write it.

    Raises:
        ConfigurationError: For a file or a review that cannot be used.
    """
    from pytest_dura.core.files import replace_file
    from pytest_dura.core.text import one_line
    from pytest_dura.drafts.files import read_review, sign_drafts

    review = read_review(options.review)
    text, chosen = sign_drafts(options.file, review, options.only)
    replace_file(options.file, [text], durable=True)
    for name in chosen:
        yield one_line(f"{name}: {review.decision} by {review.who} on {review.when}", 500)
