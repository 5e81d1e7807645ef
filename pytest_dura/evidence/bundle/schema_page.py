"""The tables of the record's keys; this module, run with ``python -m``, writes them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pytest_dura.evidence.bundle.schema import schema

PAGE = "evidence.md"
BEGIN = "<!-- Written by `python -m pytest_dura.evidence.bundle.schema_page`; do not edit. -->"
END = "<!-- Here the written part ends. -->"
HIDDEN = ("attempt",)
"""Definitions whose keys stand in the page already, under another name."""

Data = Mapping[str, Any]


def page_of(page: str) -> str:
    """The page with its tables up to date.

    Raises:
        ValueError: If it lacks the lines between which they stand.
    """
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"the page lacks the line {END if begin else BEGIN!r}")
    return f"{before}{BEGIN}\n\n{tables()}\n{END}{after}"


def tables() -> str:
    """A table of the record's keys, and one for each kind of entry, in Markdown."""
    whole = schema()
    lines = ["### The record", "", *_table(whole)]
    for name, one in whole["$defs"].items():
        if name not in HIDDEN:
            lines += ["", f"### {name}", "", one["description"]]
            lines += ["", *_table(one)] if list(_rows(one, "")) else []
    return "\n".join([*lines, ""])


def _table(part: Data) -> list[str]:
    return ["| key | value | meaning |", "|---|---|---|", *_rows(part, "")]


def _rows(part: Data, prefix: str) -> Iterator[str]:
    """A row for each property, and for those below it that have no table of their own."""
    for name, one in part.get("properties", {}).items():
        said = one.get("description", "").replace("|", "\\|")
        yield f"| `{prefix}{name}` | {_value(one)} | {said} |"
        yield from _rows(one, f"{prefix}{name}.")
    for key, mark in (("items", "[]."), ("additionalProperties", ".*.")):
        if isinstance(part.get(key), dict):
            yield from _rows(part[key], f"{prefix.removesuffix('.')}{mark}")
    for one in part.get("anyOf", ()):
        yield from _rows(one, prefix)


def _value(one: Data) -> str:
    """What a key may hold, in words."""
    if "$ref" in one:
        name = one["$ref"].rpartition("/")[2]
        return f"[{name}](#{name})" if name not in HIDDEN else "as a verdict"
    if "anyOf" in one:
        return " or ".join(_value(each) for each in one["anyOf"])
    if "const" in one:
        return f"`{one['const']}`"
    if "enum" in one:
        return ", ".join("null" if each is None else f"`{each}`" for each in one["enum"])
    kinds = one.get("type", "anything")
    told = " or ".join(
        _TYPES.get(kind, kind) for kind in ([kinds] if isinstance(kinds, str) else kinds)
    )
    inner = one.get("items", one.get("additionalProperties"))
    if isinstance(inner, dict) and ("$ref" in inner or "type" in inner):
        told = told.replace("list", f"list of {_value(inner)}", 1)
        told = told.replace("mapping", f"mapping to {_value(inner)}", 1)
    return told


_TYPES = {
    "object": "mapping", "array": "list", "string": "text", "integer": "whole number",
    "boolean": "true or false",
}  # fmt: skip


def write_page(path: Path) -> None:
    """Bring the tables of a page up to date."""
    path.write_text(page_of(path.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    write_page(Path(__file__).resolve().parents[3] / "docs" / PAGE)
