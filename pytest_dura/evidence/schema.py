"""Checks of a record by its models, and the JSON Schema and tables generated from them.

``python -m pytest_dura.evidence.schema`` writes ``evidence.schema.json``, which lies beside this
module, and the tables of ``docs/record.md``.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import is_dataclass
from functools import cache
from inspect import cleandoc, getsource
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

from pytest_dura.core.codec import decode, defaults_of, fields_of, shape_of
from pytest_dura.core.mismatches import MAX_MISMATCHES, Mismatch, MismatchError, kind_of
from pytest_dura.evidence.entry import Entry, JsonObject
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import WholeRecord

SCHEMA_FILE = "evidence.schema.json"


@cache
def record_schema() -> JsonObject:
    """Read the published schema, which lies beside this module; callers must not change it."""
    data: JsonObject = json.loads(Path(__file__).with_name(SCHEMA_FILE).read_text("utf-8"))
    return data


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


def check_record(record: Any) -> list[Mismatch]:
    """List what is wrong with plain data that is to be a record; empty for a record.

    At most :data:`~pytest_dura.core.mismatches.MAX_MISMATCHES` are listed.
    """
    if not isinstance(record, Mapping):
        return [Mismatch("/", kind_of(record), "object")]
    episodes = record.get("episodes")
    if not isinstance(episodes, list):
        return _mismatches(WholeRecord, dict(record))
    head = {key: value for key, value in record.items() if key != "episodes"}
    return check_parts(head, episodes)


def check_parts(head: Mapping[str, Any], episodes: Iterable[Any]) -> list[Mismatch]:
    """List what is wrong with a record whose episodes are read one at a time.

    Args:
        head: Every top-level key but ``episodes``.
        episodes: The episodes, as plain data.
    """
    mismatches = _mismatches(WholeRecord, {**head, "episodes": []})
    for number, episode in enumerate(episodes):
        if len(mismatches) >= MAX_MISMATCHES:
            break
        mismatches += [
            each._replace(pointer=f"/episodes/{number}{each.pointer}".rstrip("/"))
            for each in _mismatches(EpisodeEntry, episode)
        ]
    return mismatches[:MAX_MISMATCHES]


def _mismatches(kind: type[Entry], data: Any) -> list[Mismatch]:
    try:
        decode(kind, data)
    except MismatchError as error:
        return list(error.mismatches)
    return []


def generate_schema() -> JsonObject:
    """Generate the JSON Schema of the record from its entries."""
    definitions = _class_definitions([WholeRecord])
    whole = definitions.pop(_definition_name(WholeRecord.__name__))
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "urn:pytest-dura:evidence:1",
        "title": "Evidence record of pytest-dura",
        **whole,
        "$defs": dict(sorted(definitions.items())),
    }


def json_schema(type_: Any) -> JsonObject:
    """Generate the JSON Schema of a type that the codec reads."""
    shape = shape_of(type_)
    return {**_tidy(shape.schema), "$defs": _class_definitions(shape.classes)}


def recorded_classes() -> tuple[type, ...]:
    """List the dataclasses of the record, which is itself none of them."""
    known: dict[type, None] = {}
    pending: list[type] = [WholeRecord]
    while pending:
        inner = [each for shape in fields_of(pending.pop()).values() for each in shape.classes]
        pending += [each for each in inner if each not in known]
        known.update(dict.fromkeys(inner))
    return tuple(known)


def _class_definitions(classes: Iterable[type]) -> dict[str, JsonObject]:
    """Write a definition of each class, and of those in its fields."""
    definitions: dict[str, JsonObject] = {}
    pending = list(classes)
    while pending:
        kind = pending.pop()
        name = _definition_name(kind.__name__)
        if name in definitions:
            continue
        shapes = fields_of(kind)
        text, texts = _class_docs(kind)
        definitions[name] = {
            "description": text,
            "type": "object",
            "properties": {
                field: {"description": texts[field], **_tidy(shape.schema)}
                for field, shape in shapes.items()
            },
            "additionalProperties": False,
            "required": [field for field in shapes if field not in defaults_of(kind)],
        }
        pending += [each for shape in shapes.values() for each in shape.classes]
    return definitions


def _class_docs(kind: type) -> tuple[str, dict[str, str]]:
    """Read the docstring of a dataclass, and those of its fields, below them or in ``Args:``."""
    texts: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        if is_dataclass(each):
            _, _, arguments = cleandoc(each.__doc__ or "").partition("\nArgs:\n")
            entries = re.findall(r"^    (\w+): (.+(?:\n {5,}.+)*)", arguments, re.MULTILINE)
            texts |= {name: _plain(text) for name, text in entries}
            texts |= dict(_field_docstrings(sys.modules[each.__module__]).get(each.__name__, ()))
    return _plain(cleandoc(kind.__doc__ or "").partition("\nArgs:\n")[0]), texts


def _plain(text: str) -> str:
    """Write a docstring on one line, without the roles of its names."""
    return re.sub(r":\w+:`[~.]*([^`]*)`", r"`\1`", " ".join(text.split())).replace("``", "`")


def _definition_name(model: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", model.removesuffix("Entry")).lower()


@cache
def _field_docstrings(module: ModuleType) -> dict[str, list[tuple[str, str]]]:
    """Read the docstrings below the fields of the classes of a module."""
    return {
        node.name: [
            (field.target.id, " ".join(text.value.value.split()))
            for field, text in pairwise(node.body)
            if isinstance(field, ast.AnnAssign)
            and isinstance(field.target, ast.Name)
            and isinstance(text, ast.Expr)
            and isinstance(text.value, ast.Constant)
            and isinstance(text.value.value, str)
        ]
        for node in ast.parse(getsource(module)).body
        if isinstance(node, ast.ClassDef)
    }


def _tidy(part: Any) -> Any:
    """Name the definitions to which a schema refers as the published one does."""
    if isinstance(part, list):
        return [_tidy(each) for each in part]
    if not isinstance(part, dict):
        return part
    tidy = {key: _tidy(value) for key, value in part.items()}
    if isinstance(part.get("$ref"), str):
        tidy["$ref"] = "#/$defs/" + _definition_name(part["$ref"].rpartition("/")[2])
    return tidy


PAGE = "record.md"
TABLES_BEGIN = "<!-- Written by `python -m pytest_dura.evidence.schema`; do not edit. -->"
TABLES_END = "<!-- Here the written part ends. -->"
_HIDDEN_DEFINITIONS = ("attempt",)
"""Definitions whose keys are in the page already, under another name."""


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


def _property_table(part: JsonObject) -> list[str]:
    return ["| key | value | meaning |", "|---|---|---|", *_property_rows(part, "")]


def _property_rows(part: JsonObject, prefix: str) -> Iterator[str]:
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


def _value_text(part: JsonObject) -> str:
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
    _text = json.dumps(generate_schema(), indent=1, ensure_ascii=False)
    Path(__file__).with_name(SCHEMA_FILE).write_text(f"{_text}\n", "utf-8")
    _path = Path(__file__).resolve().parents[2] / "docs" / PAGE
    _path.write_text(updated_page(_path.read_text("utf-8")), "utf-8")
