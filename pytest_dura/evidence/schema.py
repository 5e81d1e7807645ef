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
    """The module ``jsonschema``.

    Whoever else checks formats with it in this process finds all of them: the parser is built when
    one of them is checked first.
    """
    with _grammars_on_demand():
        return import_module("jsonschema")


@contextmanager
def _grammars_on_demand() -> Iterator[None]:
    known = {"jsonschema", _GRAMMARS} & sys.modules.keys()
    if known or find_spec(_GRAMMARS) is None:
        yield
        return
    later = ModuleType(_GRAMMARS)
    later.is_valid_syntax = _is_valid_syntax  # type: ignore[attr-defined]
    sys.modules[_GRAMMARS] = later
    try:
        yield
    finally:
        del sys.modules[_GRAMMARS]


def _is_valid_syntax(*given: Any) -> Any:
    return import_module(_GRAMMARS).is_valid_syntax(*given)


SCHEMA_FILE = "evidence.schema.json"
MAX_PROBLEMS = 20
"""Problems that are told; a record of another form would have thousands."""
_SHOWN_CHARACTERS = 60


@cache
def schema_text() -> str:
    """The published schema, as it lies beside this module and in every bundle."""
    return Path(__file__).with_name(SCHEMA_FILE).read_text("utf-8")


@cache
def record_schema() -> dict[str, Any]:
    """The schema as data; not to be changed."""
    data: dict[str, Any] = json.loads(schema_text())
    return data


def check_record(record: SessionRecord | Mapping[str, Any]) -> list[str]:
    """What is wrong with a record, each with its JSON pointer; empty if nothing is.

    The episodes are looked at one at a time. At most :data:`MOST` problems are told.
    """
    if isinstance(record, SessionRecord):
        head, episodes = {**record.head, "episodes": []}, record.episodes()
    elif not isinstance(record, Mapping):
        return [f"/: found {_kind(record)}, expected object"]
    else:
        # An unusual list of episodes is the schema's business.
        listed = record.get("episodes")
        usual = isinstance(listed, list)
        head = {**record, "episodes": []} if usual else dict(record)
        episodes = iter(listed if isinstance(listed, list) else ())
    return list(
        islice(dict.fromkeys(islice(_problems(head, episodes), 50 * MAX_PROBLEMS)), MAX_PROBLEMS)
    )


def _problems(head: Mapping[str, Any], episodes: Iterable[Any]) -> Iterator[str]:
    yield from _error_lines(_validator("").iter_errors(head))
    of_episode = _validator("episode")
    for number, episode in enumerate(episodes):
        yield from _error_lines(of_episode.iter_errors(episode), f"/episodes/{number}")


def record_vocabulary() -> frozenset[str]:
    """The words that every record is written with: its keys, and what it chooses values from."""
    return _vocabulary()


@cache
def _vocabulary() -> frozenset[str]:
    found: set[str] = set()
    left: list[Any] = [record_schema()]
    while left:
        item = left.pop()
        if isinstance(item, list):
            left += item
        elif isinstance(item, dict):
            left += item.values()
            found.update(item.get("properties", {}))
            choices = [*item.get("enum", ()), item.get("const")]
            found.update(choice for choice in choices if isinstance(choice, str))
    return frozenset(found)


@cache
def _validator(definition: str) -> Any:
    """That of the whole record, or of one definition."""
    known = _load_jsonschema()
    # Python reads NaN from a file, and JSON has no such number. To it 2.0 is an integer, and to
    # whoever counts up to it in Python it is none.
    types = known.Draft202012Validator.TYPE_CHECKER.redefine_many(
        {"number": _is_number, "integer": _is_integer}
    )
    strict = known.validators.extend(known.Draft202012Validator, type_checker=types)
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
    """Of an error with alternatives, that of the one which was probably meant."""
    while error.context:
        branches: dict[Any, list[ValidationError]] = {}
        for item in error.context:
            branches.setdefault(item.relative_schema_path[0], []).append(item)
        # Null is an alternative to most, and meant by none that is something else.
        close = [
            branch
            for branch in branches.values()
            if not any(item.validator == "type" and not item.relative_path for item in branch)
        ]
        if not close:
            break
        error = min(close, key=len)[0]
    return error


def _why(error: Any) -> str:
    keyword, wanted, found = error.validator, error.validator_value, error.instance
    if keyword == "required":
        return f"missing key {_key_list([key for key in wanted if key not in found])}"
    if keyword == "additionalProperties" and wanted is False:
        return f"unknown key {_key_list(sorted(set(found) - set(error.schema['properties'])))}"
    if keyword == "type":
        return f"found {_kind(found)}, expected {_alternatives(wanted, str)}"
    if keyword == "anyOf":
        kinds = [item.validator_value for item in error.context if item.validator == "type"]
        return f"found {_kind(found)}, expected {_alternatives(kinds, str) or 'another form'}"
    limits = {"enum": "", "const": "", "pattern": "a text like ", "minimum": "at least "}
    told = limits.get(keyword, f"{keyword} ")
    return f"found {_shown(found)}, expected {told}{_alternatives(wanted, _shown)}"


def _alternatives(wanted: Any, told: Callable[[Any], str]) -> str:
    return " or ".join(map(told, wanted if isinstance(wanted, list) else [wanted]))


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
"""Definitions whose keys stand in the page already, under another name."""

Data = Mapping[str, Any]


def updated_page(page: str) -> str:
    """The page with its tables up to date.

    Raises:
        ValueError: If it lacks the lines between which they stand.
    """
    before, begin, rest = page.partition(TABLES_BEGIN)
    _, end, after = rest.partition(TABLES_END)
    if not (begin and end):
        raise ValueError(f"the page lacks the line {TABLES_END if begin else TABLES_BEGIN!r}")
    return f"{before}{TABLES_BEGIN}\n\n{schema_tables()}\n{TABLES_END}{after}"


def schema_tables() -> str:
    """A table of the record's keys, and one for each kind of entry, in Markdown."""
    whole = record_schema()
    lines = ["### The record", "", *_property_table(whole)]
    for name, item in whole["$defs"].items():
        if name not in _HIDDEN_DEFINITIONS:
            lines += ["", f"### {name}", "", item["description"]]
            lines += ["", *_property_table(item)] if list(_property_rows(item, "")) else []
    return "\n".join([*lines, ""])


def _property_table(part: Data) -> list[str]:
    return ["| key | value | meaning |", "|---|---|---|", *_property_rows(part, "")]


def _property_rows(part: Data, prefix: str) -> Iterator[str]:
    """A row for each property, and for those below it that have no table of their own."""
    for name, item in part.get("properties", {}).items():
        text = item.get("description", "").replace("|", "\\|")
        yield f"| `{prefix}{name}` | {_value_text(item)} | {text} |"
        yield from _property_rows(item, f"{prefix}{name}.")
    for key, mark in (("items", "[]."), ("additionalProperties", ".*.")):
        if isinstance(part.get(key), dict):
            yield from _property_rows(part[key], f"{prefix.removesuffix('.')}{mark}")
    for item in part.get("anyOf", ()):
        yield from _property_rows(item, prefix)


def _value_text(item: Data) -> str:
    """What a key may hold, in words."""
    if "$ref" in item:
        name = item["$ref"].rpartition("/")[2]
        return f"[{name}](#{name})" if name not in _HIDDEN_DEFINITIONS else "as a verdict"
    if "anyOf" in item:
        return " or ".join(_value_text(each) for each in item["anyOf"])
    if "const" in item:
        return f"`{item['const']}`"
    if "enum" in item:
        return ", ".join("null" if each is None else f"`{each}`" for each in item["enum"])
    kinds = item.get("type", "anything")
    text = " or ".join(
        _TYPE_NAMES.get(kind, kind) for kind in ([kinds] if isinstance(kinds, str) else kinds)
    )
    inner = item.get("items", item.get("additionalProperties"))
    if isinstance(inner, dict) and ("$ref" in inner or "type" in inner):
        text = text.replace("list", f"list of {_value_text(inner)}", 1)
        text = text.replace("mapping", f"mapping to {_value_text(inner)}", 1)
    return text


_TYPE_NAMES = {
    "object": "mapping", "array": "list", "string": "text", "integer": "whole number",
    "boolean": "true or false",
}  # fmt: skip


def _write_schema_page(path: Path) -> None:
    """Bring the tables of a page up to date."""
    path.write_text(updated_page(path.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    _write_schema_page(Path(__file__).resolve().parents[2] / "docs" / PAGE)
