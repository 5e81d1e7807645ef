"""Checks of a record by its models, and the JSON Schema and tables generated from them.

``python -m pytest_dura.evidence.schema`` writes ``evidence.schema.json``, which lies beside this
module, and the tables of ``docs/record.md``.
"""

from __future__ import annotations

import ast
import json
import math
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from functools import cache
from inspect import cleandoc, getsource
from itertools import islice, pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

from pydantic import ValidationError
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import NullableSchema, WithDefaultSchema

from pytest_dura.core.codec import defaults_of, fields_of, shape_of
from pytest_dura.core.mismatches import (
    MAX_MISMATCHES,
    Mismatch,
    MismatchError,
    key_list,
    kind_of,
    pointer,
    shown,
)
from pytest_dura.evidence.entry import CODED, Entry, JsonObject
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
        return list(islice(_mismatches(WholeRecord, record, record_schema(), ""), MAX_MISMATCHES))
    head = {key: value for key, value in record.items() if key != "episodes"}
    return check_parts(head, episodes)


def check_parts(head: Mapping[str, Any], episodes: Iterable[Any]) -> list[Mismatch]:
    """List what is wrong with a record whose episodes are read one at a time.

    Args:
        head: Every top-level key but ``episodes``.
        episodes: The episodes, as plain data.
    """
    return list(islice(_mismatches_of_parts(head, episodes), MAX_MISMATCHES))


def _mismatches_of_parts(head: Mapping[str, Any], episodes: Iterable[Any]) -> Iterator[Mismatch]:
    yield from _mismatches(WholeRecord, {**head, "episodes": []}, record_schema(), "")
    schema = record_schema()["$defs"]["episode"]
    for number, episode in enumerate(episodes):
        yield from _mismatches(EpisodeEntry, episode, schema, f"/episodes/{number}")


_WRONG_KEYS = {"missing": "missing key", "extra_forbidden": "unknown key"}


def _mismatches(
    model: type[Entry], data: Any, schema: JsonObject, prefix: str
) -> Iterable[Mismatch]:
    try:
        model.model_validate(data)
    except ValidationError as error:
        problems: dict[Mismatch, list[str]] = {}
        for entry in error.errors(include_url=False, include_input=False):
            wrong_key = _WRONG_KEYS.get(entry["type"])
            location = entry["loc"][:-1] if wrong_key else entry["loc"]
            path, node, value = _place(location, schema, data)
            refused = entry.get("ctx", {}).get("error")
            if isinstance(refused, MismatchError):  # by the codec, from the place on
                for mismatch in refused.mismatches:
                    place = f"{_below(prefix, path)}{mismatch.pointer}".rstrip("/")
                    problems.setdefault(mismatch._replace(pointer=place), [])
                continue
            what = (wrong_key,) if wrong_key else _why(node, value) or (entry["msg"],)
            keys = problems.setdefault(Mismatch(_below(prefix, path), *what), [])
            keys += [str(entry["loc"][-1])] if wrong_key else []
        return [
            mismatch._replace(found=f"{mismatch.found} {key_list(keys)}".rstrip())
            for mismatch, keys in problems.items()
        ]
    return ()


def _below(prefix: str, path: Sequence[str | int]) -> str:
    return prefix + (pointer(path) if path else "") or "/"


def _place(
    location: Iterable[str | int], node: JsonObject, value: Any
) -> tuple[list[str | int], JsonObject, Any]:
    """Follow the location of an error through the data and the schema."""
    path: list[str | int] = []
    for part in location:
        node = _chosen(node, value)
        if isinstance(value, dict) and part in value:
            node = node.get("properties", {}).get(part, node.get("additionalProperties", {}))
        elif isinstance(value, list) and isinstance(part, int):
            node = node.get("items", {})
        else:
            continue  # the name of an alternative
        path.append(part)
        value, node = value[part], node if isinstance(node, dict) else {}
    return path, _chosen(node, value), value


def _chosen(node: JsonObject, value: Any) -> JsonObject:
    """Resolve a reference, and select the alternative that was probably meant."""
    if "$ref" in node:
        return _chosen(record_schema()["$defs"][node["$ref"].rpartition("/")[2]], value)
    if "anyOf" not in node:
        return node
    kinds = [_chosen(alternative, value) for alternative in node["anyOf"]]
    keys = set(value) if isinstance(value, dict) else set()
    best = max(kinds, key=lambda kind: len(keys.intersection(kind.get("properties", ()))))
    names = [name for kind in kinds for name in _listed(kind.get("type", []))]
    return best if keys.intersection(best.get("properties", ())) else {**best, "type": names}


_LIMITS: dict[str, tuple[str, Callable[[Any, Any], bool]]] = {
    "enum": ("", lambda value, expected: value in expected),
    "const": ("", lambda value, expected: value == expected),
    "pattern": ("a text like ", lambda value, expected: bool(re.search(expected, value))),
    "minimum": ("at least ", lambda value, expected: value >= expected),
    "maximum": ("at most ", lambda value, expected: value <= expected),
    "exclusiveMinimum": ("above ", lambda value, expected: value > expected),
    "exclusiveMaximum": ("below ", lambda value, expected: value < expected),
    "minItems": ("entries, at least ", lambda value, expected: len(value) >= expected),
}


def _why(node: JsonObject, value: Any) -> tuple[str, str] | None:
    """Describe a value and what the schema expects instead; ``None`` if it accepts the value."""
    types = _listed(node.get("type", []))
    if types and not any(_is_of(value, name) for name in types):
        return kind_of(value), " or ".join(dict.fromkeys(types))
    for keyword, (words, accepts) in _LIMITS.items():
        if keyword in node and value is not None and not accepts(value, node[keyword]):
            expected = " or ".join(map(shown, _listed(node[keyword])))
            return shown(value), f"{words}{expected}"
    return None


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _is_of(value: Any, name: str) -> bool:
    if name == "number" and isinstance(value, float):
        return math.isfinite(value)
    return kind_of(value) in {"boolean": ("true", "false"), "number": ("integer",)}.get(
        name, (name,)
    )


class _Generator(GenerateJsonSchema):
    """Writes a nullable type as a list of types, and no defaults, which stand for absent keys."""

    def nullable_schema(self, schema: NullableSchema) -> JsonSchemaValue:
        inner = self.generate_inner(schema["schema"])
        if "type" not in inner:
            return {"anyOf": [inner, {"type": "null"}]}
        choices = {"enum": [*inner["enum"], None]} if "enum" in inner else {}
        return {**inner, "type": [*_listed(inner["type"]), "null"], **choices}

    def default_schema(self, schema: WithDefaultSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])


def generate_schema() -> JsonObject:
    """Generate the JSON Schema of the record from its models."""
    made = WholeRecord.model_json_schema(schema_generator=_Generator)
    models = {model.__name__: model for model in _subclasses(Entry)}
    coded = _class_definitions(_coded_classes(made))
    definitions = {
        _definition_name(name): _described(definition, models[name])
        for name, definition in made.pop("$defs").items()
    }
    twice = coded.keys() & definitions.keys()
    if twice:
        raise TypeError(f"two classes of the record have one name: {', '.join(sorted(twice))}")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "urn:pytest-dura:evidence:1",
        "title": "Evidence record of pytest-dura",
        **_described(made, WholeRecord),
        "$defs": dict(sorted({**definitions, **coded}.items())),
    }


def json_schema(type_: Any) -> JsonObject:
    """Generate the JSON Schema of a type that the codec reads."""
    shape = shape_of(type_)
    return {**_tidy(shape.schema), "$defs": _class_definitions(shape.classes)}


def recorded_classes() -> tuple[type, ...]:
    """List the dataclasses of the record, those inside others apart."""
    made = WholeRecord.model_json_schema(schema_generator=_Generator)
    return tuple(dict.fromkeys(_coded_classes(made)))


def _coded_classes(part: Any) -> Iterator[type]:
    """Yield the dataclasses that stand in the schema of the models."""
    if isinstance(part, dict) and CODED in part:
        yield part[CODED]
    elif isinstance(part, (dict, list)):
        for each in part.values() if isinstance(part, dict) else part:
            yield from _coded_classes(each)


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


def _subclasses(model: type[Entry]) -> Iterator[type[Entry]]:
    for subclass in model.__subclasses__():
        yield subclass
        yield from _subclasses(subclass)


def _definition_name(model: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", model.removesuffix("Entry")).lower()


def _described(definition: JsonObject, model: type[Entry]) -> JsonObject:
    """Put the docstrings of a model and its fields into its schema."""
    docstrings = {
        name: text
        for each in reversed(model.__mro__)
        if issubclass(each, Entry)
        for name, text in _field_docstrings(sys.modules[each.__module__]).get(each.__name__, ())
    }
    properties = {
        name: {"description": docstrings[name], **_tidy(part)}
        for name, part in definition.pop("properties").items()
    }
    text = " ".join((model.__doc__ or "").split())
    return {"description": text, "type": "object", "properties": properties, **_tidy(definition)}


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
    """Remove what pydantic adds: titles, and descriptions that stand elsewhere."""
    if isinstance(part, list):
        return [_tidy(each) for each in part]
    if not isinstance(part, dict):
        return part
    if CODED in part:
        return _tidy(shape_of(part[CODED]).schema)
    tidy = {
        "anyOf" if key == "oneOf" else key: _tidy(value)
        for key, value in part.items()
        if key not in ("title", "description", "discriminator")
    }
    if isinstance(part.get("$ref"), str):
        tidy["$ref"] = "#/$defs/" + _definition_name(part["$ref"].rpartition("/")[2])
    for pattern, value in tidy.pop("patternProperties", {}).items():
        tidy |= {"propertyNames": {"pattern": pattern}, "additionalProperties": value}
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
