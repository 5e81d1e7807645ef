"""JSON Schema of the evidence record: checks a record, and writes the reference tables.

``python -m pytest_dura.evidence.schema`` writes the tables of ``docs/evidence.md``.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from pytest_dura.evidence.model import SessionRecord

if TYPE_CHECKING:
    from jsonschema.exceptions import ValidationError


_GRAMMARS = "rfc3987_syntax"
"""Where this package is installed, jsonschema imports it; it builds a parser while it is imported,
for the formats ``iri`` and ``iri-reference``, which no schema of ours has."""


def _load_jsonschema() -> ModuleType:
    """Import ``jsonschema`` without its grammars.

    Other users of it in this process miss no format: the parser is built when it is first used.
    """
    with _grammars_on_demand():
        return import_module("jsonschema")


@contextmanager
def _grammars_on_demand() -> Iterator[None]:
    if {"jsonschema", _GRAMMARS} & sys.modules.keys() or find_spec(_GRAMMARS) is None:
        yield
        return
    placeholder = ModuleType(_GRAMMARS)
    placeholder.is_valid_syntax = _is_valid_syntax  # type: ignore[attr-defined]
    sys.modules[_GRAMMARS] = placeholder
    try:
        yield
    finally:
        del sys.modules[_GRAMMARS]


def _is_valid_syntax(*arguments: Any) -> Any:
    return import_module(_GRAMMARS).is_valid_syntax(*arguments)


SCHEMA_FILE = "evidence.schema.json"
MAX_PROBLEMS = 20
"""Problems that are reported; a record of another form would have thousands."""
_SHOWN_CHARACTERS = 60


@cache
def schema_text() -> str:
    """Read the published schema, which lies beside this module and in every bundle."""
    return Path(__file__).with_name(SCHEMA_FILE).read_text("utf-8")


@cache
def record_schema() -> dict[str, Any]:
    """Read the schema as data, which callers must not change."""
    data: dict[str, Any] = json.loads(schema_text())
    return data


def check_record(record: SessionRecord | Mapping[str, Any]) -> list[str]:
    """List what is wrong with a record, each with its JSON pointer.

    The episodes are checked one at a time. At most :data:`MAX_PROBLEMS` are listed.
    """
    if isinstance(record, SessionRecord):
        head, episodes = {**record.head, "episodes": []}, record.episodes()
    elif not isinstance(record, Mapping):
        return [f"/: found {_kind(record)}, expected object"]
    else:
        # An unusual list of episodes is the schema's business.
        listed = record.get("episodes")
        head = {**record, "episodes": []} if isinstance(listed, list) else dict(record)
        episodes = iter(listed if isinstance(listed, list) else ())
    return list(
        islice(dict.fromkeys(islice(_problems(head, episodes), 50 * MAX_PROBLEMS)), MAX_PROBLEMS)
    )


def _problems(head: Mapping[str, Any], episodes: Iterable[Any]) -> Iterator[str]:
    yield from _error_lines(_validator("").iter_errors(head))
    of_episode = _validator("episode")
    for number, episode in enumerate(episodes):
        yield from _error_lines(of_episode.iter_errors(episode), f"/episodes/{number}")


@cache
def record_vocabulary() -> frozenset[str]:
    """Collect the names that every record consists of: its keys and enumerated values."""
    names: set[str] = set()
    pending: list[Any] = [record_schema()]
    while pending:
        part = pending.pop()
        if isinstance(part, list):
            pending += part
        elif isinstance(part, dict):
            pending += part.values()
            names.update(part.get("properties", {}))
            choices = [*part.get("enum", ()), part.get("const")]
            names.update(choice for choice in choices if isinstance(choice, str))
    return frozenset(names)


@cache
def _validator(definition: str) -> Any:
    """Make the validator of the whole record, or of one definition."""
    jsonschema = _load_jsonschema()
    # Python reads NaN from a file, and JSON has no such number. JSON Schema takes 2.0 for an
    # integer, which range() does not.
    types = jsonschema.Draft202012Validator.TYPE_CHECKER.redefine_many(
        {"number": _is_number, "integer": _is_integer}
    )
    strict = jsonschema.validators.extend(jsonschema.Draft202012Validator, type_checker=types)
    if not definition:
        return strict(record_schema())
    part = {key: record_schema()[key] for key in ("$schema", "$defs")}
    return strict({**part, "$ref": f"#/$defs/{definition}"})


def _is_number(_: object, value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return isinstance(value, int) or math.isfinite(value)


def _is_integer(_: object, value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _error_lines(errors: Iterable[ValidationError], prefix: str = "") -> Iterator[str]:
    for error in errors:
        probable_error = _probable_error(error)
        pointer = _pointer(probable_error.absolute_path) or ("" if prefix else "/")
        yield f"{prefix}{pointer}: {_why(probable_error)}"


def _probable_error(error: ValidationError) -> ValidationError:
    """Select, of an error with alternatives, that of the alternative which was probably meant."""
    while error.context:
        branches: dict[Any, list[ValidationError]] = {}
        for alternative in error.context:
            branches.setdefault(alternative.relative_schema_path[0], []).append(alternative)
        # Null is an alternative to most, and meant by none that is something else.
        close = [
            branch
            for branch in branches.values()
            if not any(
                alternative.validator == "type" and not alternative.relative_path
                for alternative in branch
            )
        ]
        if not close:
            break
        error = min(close, key=len)[0]
    return error


def _why(error: Any) -> str:
    keyword, expected, value = error.validator, error.validator_value, error.instance
    if keyword == "required":
        return f"missing key {_key_list([key for key in expected if key not in value])}"
    if keyword == "additionalProperties" and expected is False:
        return f"unknown key {_key_list(sorted(set(value) - set(error.schema['properties'])))}"
    if keyword == "type":
        return f"found {_kind(value)}, expected {_alternatives(expected, str)}"
    if keyword == "anyOf":
        kinds = [
            alternative.validator_value
            for alternative in error.context
            if alternative.validator == "type"
        ]
        return f"found {_kind(value)}, expected {_alternatives(kinds, str) or 'another form'}"
    limits = {"enum": "", "const": "", "pattern": "a text like ", "minimum": "at least "}
    prefix = limits.get(keyword, f"{keyword} ")
    return f"found {_shown(value)}, expected {prefix}{_alternatives(expected, _shown)}"


def _alternatives(expected: Any, render: Callable[[Any], str]) -> str:
    return " or ".join(map(render, expected if isinstance(expected, list) else [expected]))


def _key_list(keys: Sequence[str]) -> str:
    more = f" and {len(keys) - 5} more" if len(keys) > 5 else ""
    return ", ".join(map(_shown, keys[:5])) + more


def _kind(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    kinds = {str: "string", int: "integer", float: "number", dict: "object", list: "array"}
    return kinds.get(type(value), type(value).__name__)


def _shown(value: Any) -> str:
    # ASCII: whatever stands in a damaged record, a terminal can show it.
    try:
        text = json.dumps(value)
    except (TypeError, ValueError):
        text = ascii(value)
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[: _SHOWN_CHARACTERS - 3]}..."


def _pointer(path: Iterable[str | int]) -> str:
    parts = (str(part).replace("~", "~0").replace("/", "~1") for part in path)
    return "".join(f"/{part if part.isprintable() else ascii(part)[1:-1]}" for part in parts)


PAGE = "evidence.md"
TABLES_BEGIN = "<!-- Written by `python -m pytest_dura.evidence.schema`; do not edit. -->"
TABLES_END = "<!-- Here the written part ends. -->"
_HIDDEN_DEFINITIONS = ("attempt",)
"""Definitions whose keys are in the page already, under another name."""

Data = Mapping[str, Any]


def updated_page(page: str) -> str:
    """Replace the tables of the page.

    Raises:
        ValueError: If it lacks the lines that enclose them.
    """
    before, begin, rest = page.partition(TABLES_BEGIN)
    _, end, after = rest.partition(TABLES_END)
    if not (begin and end):
        raise ValueError(f"the page lacks the line {TABLES_END if begin else TABLES_BEGIN!r}")
    return f"{before}{TABLES_BEGIN}\n\n{schema_tables()}\n{TABLES_END}{after}"


def schema_tables() -> str:
    """Write a table of the record's keys, and one for each kind of entry, in Markdown."""
    whole = record_schema()
    lines = ["### The record", "", *_property_table(whole)]
    for name, definition in whole["$defs"].items():
        if name not in _HIDDEN_DEFINITIONS:
            lines += ["", f"### {name}", "", definition["description"]]
            lines += (
                ["", *_property_table(definition)] if list(_property_rows(definition, "")) else []
            )
    return "\n".join([*lines, ""])


def _property_table(part: Data) -> list[str]:
    return ["| key | value | meaning |", "|---|---|---|", *_property_rows(part, "")]


def _property_rows(part: Data, prefix: str) -> Iterator[str]:
    """Yield a row for each property, and for those below it that have no table of their own."""
    for name, property_schema in part.get("properties", {}).items():
        text = property_schema.get("description", "").replace("|", "\\|")
        yield f"| `{prefix}{name}` | {_value_text(property_schema)} | {text} |"
        yield from _property_rows(property_schema, f"{prefix}{name}.")
    for key, mark in (("items", "[]."), ("additionalProperties", ".*.")):
        if isinstance(part.get(key), dict):
            yield from _property_rows(part[key], f"{prefix.removesuffix('.')}{mark}")
    for alternative in part.get("anyOf", ()):
        yield from _property_rows(alternative, prefix)


def _value_text(part: Data) -> str:
    """Describe what a key may hold."""
    if "$ref" in part:
        name = part["$ref"].rpartition("/")[2]
        return f"[{name}](#{name})" if name not in _HIDDEN_DEFINITIONS else "as a verdict"
    if "anyOf" in part:
        return " or ".join(_value_text(each) for each in part["anyOf"])
    if "const" in part:
        return f"`{part['const']}`"
    if "enum" in part:
        return ", ".join("null" if each is None else f"`{each}`" for each in part["enum"])
    kinds = part.get("type", "anything")
    text = " or ".join(
        _TYPE_NAMES.get(kind, kind) for kind in ([kinds] if isinstance(kinds, str) else kinds)
    )
    inner = part.get("items", part.get("additionalProperties"))
    if isinstance(inner, dict) and ("$ref" in inner or "type" in inner):
        text = text.replace("list", f"list of {_value_text(inner)}", 1)
        text = text.replace("mapping", f"mapping to {_value_text(inner)}", 1)
    return text


_TYPE_NAMES = {
    "object": "mapping", "array": "list", "string": "text", "integer": "whole number",
    "boolean": "true or false",
}  # fmt: skip


if __name__ == "__main__":
    _path = Path(__file__).resolve().parents[2] / "docs" / PAGE
    _path.write_text(updated_page(_path.read_text("utf-8")), "utf-8")
