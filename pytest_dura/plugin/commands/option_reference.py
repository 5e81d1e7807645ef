"""Reference page of options.

``python -m pytest_dura.plugin.commands.option_reference`` writes it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from shlex import quote
from typing import Any

from pytest_dura.options import Option
from pytest_dura.plugin.options import option_rows

PAGE = "options.md"
COMMAND = "pytest_dura.plugin.commands.option_reference"


def reference_page() -> str:
    """Render the page in Markdown."""
    flags = [row for row in option_rows() if row.flag is not None]
    settings = [row for row in option_rows() if row.ini is not None]
    lines = [
        "# Options",
        "",
        f"<!-- Written by `python -m {COMMAND}`; do not edit. -->",
        "",
        "## Command line",
        "",
        *_table(("option", "meaning", "default"), map(_flag_cells, flags)),
        "",
        "## Settings",
        "",
        "In pytest's ini file, or with `-o name=value`. The command line counts first.",
        "",
        *_table(("setting", "meaning", "default", "option"), map(_setting_cells, settings)),
        "",
        "## What an option bears on",
        "",
        "- record: a session with it leaves evidence, whatever its tests are.",
        "- episodes: an episode of the same case and run may be another one with it, and is not",
        "  [taken over](executors.md#what-is-compared) then.",
        "- repeated: the printed commands that repeat it.",
        "- shards: the `same` for all shards of a session; `free` where it may differ, or where",
        "  the merge compares what it leads to; or why it excludes `--dura-shard`.",
        "",
        *_table(("option", "record", "episodes", "repeated", "shards"), map(_use_cells, flags)),
        "",
    ]
    return "\n".join(lines)


def write_page(path: Path) -> None:
    """Write the page to a file."""
    path.write_text(reference_page(), "utf-8")


def _flag_cells(row: Option[Any]) -> Iterator[str]:
    values = "\\|".join(row.choices) or row.metavar
    forms = [f"`{row.flag}`" if row.is_switch else f"`{row.flag}={values}`"]
    yield ", ".join([*forms, *(f"`{row.flag}={value}`" for value in row.switch_values)])
    notes = ["Repeatable."] if row.repeatable else []
    notes += (
        [f"For example `{row.flag}={quote(row.example)}`."] if row.example and row.metavar else []
    )
    yield _meaning(row, *notes)
    yield row.shown_default


def _setting_cells(row: Option[Any]) -> Iterator[str]:
    yield f"`{row.ini}`"
    yield _meaning(row)
    yield row.shown_default
    yield "" if row.flag is None else f"`{row.flag}`"


def _meaning(row: Option[Any], *notes: str) -> str:
    text = f"{row.help[0].upper()}{row.help[1:]}."
    return " ".join(filter(None, [text, row.details, *notes]))


def _use_cells(row: Option[Any]) -> Iterator[str]:
    yield f"`{row.flag}`"
    yield "yes" if row.activates else ""
    yield "yes" if row.changes_episodes else ""
    yield ", ".join(row.repeated_in)
    if row.no_shard:
        yield f"no{f' `{row.no_shard_for}`' if row.no_shard_for else 'ne'}: {row.no_shard}"
    else:
        yield "same" if row.same_in_shards else "free"


def _table(names: tuple[str, ...], rows: Iterable[Iterable[str]]) -> Iterator[str]:
    yield f"| {' | '.join(names)} |"
    yield "|" + "---|" * len(names)
    yield from (f"| {' | '.join(cells)} |" for cells in rows)


if __name__ == "__main__":
    write_page(Path(__file__).resolve().parents[3] / "docs" / PAGE)
