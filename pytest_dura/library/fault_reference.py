"""Reference page of the catalogue; ``python -m pytest_dura.library.fault_reference`` writes it."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from pytest_dura.core.percepts import NOTHING
from pytest_dura.domains import DOMAINS
from pytest_dura.faults.activation import Activation, After, Intermittent, Sampled, Until
from pytest_dura.faults.catalogue import FAULT_TYPES, FaultForm, fault_class
from pytest_dura.faults.conditions import parse_condition
from pytest_dura.faults.model import FaultEffect, kind_meaning
from pytest_dura.faults.parts import (
    PARAMETERS,
    Span,
    Target,
    declared_span,
    parameters_of,
    spans_of,
)

PAGE = "faults.md"
_ANY = "any channel, any field, `command`"
_DURATIONS: tuple[type[BaseModel], ...] = (Sampled, Until, Intermittent)


def reference_page(targets: Mapping[str, str] = NOTHING) -> str:
    """Render the page in Markdown, the same text for the same catalogue.

    Args:
        targets: A domain's default target of each kind that a type can act on.
    """
    families: dict[str, list[str]] = {}
    for name in FAULT_TYPES:
        families.setdefault(FAULT_TYPES.path(name).partition(":")[0], []).append(name)
    lines = [
        "# Faults",
        "",
        "<!-- Written by `python -m pytest_dura.library.fault_reference`; do not edit. -->",
        "",
        "A fault is a type, an `id`, a `target`, an `activation`, a `duration` and `parameters`.",
        "At magnitude 0 a fault leaves everything as it is; types without a magnitude, such as",
        "`freeze`, always change something. A channel delivers one message per tick; a receiver",
        "that gets none keeps showing the last one that it got.",
        "",
        "`search` says what a search or a strategy gives a parameter of a fault that it adds, in",
        "the unit that its meaning states; `each` is one of its values.",
    ]
    for module, names in sorted(families.items()):
        lines += ["", *_family(module, names, targets)]
    return "\n".join([*lines, "", *_when_and_where(), ""])


def write_page(path: Path, targets: Mapping[str, str] = NOTHING) -> None:
    """Write the page to a file; see :func:`reference_page`."""
    path.parent.mkdir(exist_ok=True)
    path.write_text(reference_page(targets), "utf-8")


def _family(module: str, names: list[str], targets: Mapping[str, str]) -> Iterator[str]:
    title = inspect.getdoc(importlib.import_module(module)) or module
    yield f"## {_cell(title.partition(chr(10))[0].rstrip('.'))}"
    kinds = {name: fault_class(name) for name in names}
    columns = ["type", "acts on", "default target", "effect"]
    referenced = any(kind.reference for kind in kinds.values())
    yield from ("", *_head([*columns, "reference"] if referenced else columns))
    for name, kind in kinds.items():
        target = targets.get(kind.acts_on, kind.default_target)
        acts_on = _ANY if kind.acts_on == "any" else kind_meaning(kind.acts_on)
        row = [f"`{name}`", acts_on, f"`{target}`" if target else ""]
        row.append(_cell(inspect.getdoc(kind) or ""))
        yield _row([*row, kind.reference] if referenced else row)
    rows = [row for name, kind in kinds.items() for row in _parameters(name, kind)]
    if rows:
        yield from ("", *_head(["type", "parameter", "values", "default", "search", "meaning"]))
        yield from rows


def _parameters(name: str, kind: type[FaultEffect]) -> Iterator[str]:
    model: Any = parameters_of(kind)
    for (parameter, field), row in zip(model.model_fields.items(), _fields(model), strict=True):
        search = _search(declared_span(field), f"{PARAMETERS}.{parameter}" in spans_of(kind))
        yield _row([f"`{name}`", *row[:-1], search, row[-1]])


def _search(span: Span | None, chosen: bool) -> str:
    """Describe the values that a search tries."""
    if span is None:
        return "each" if chosen else "as it is"
    return f"{span.low:g} to {span.high:g}, neutral {span.neutral:g}"


def _fields(model: type[BaseModel]) -> Iterator[list[str]]:
    schema = model.model_json_schema()
    required = schema.get("required", ())
    for name, field in schema.get("properties", {}).items():
        default = "required" if name in required else _value(field.get("default"))
        values = _values(field, schema.get("$defs", {}))
        yield [f"`{name}`", values, default, _cell(field.get("description", ""))]


def _values(schema: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    """Describe the values of a field from its JSON Schema."""
    if "$ref" in schema:
        named = definitions[schema["$ref"].rpartition("/")[2]]
        return "{" + ", ".join(named.get("properties", {})) + "}"
    if "anyOf" in schema:
        return ", ".join(dict.fromkeys(_values(option, definitions) for option in schema["anyOf"]))
    if "enum" in schema or "const" in schema:
        choices = schema.get("enum") or [schema["const"]]
        return ", ".join(f"`{choice}`" for choice in choices)
    if schema.get("type") == "array":
        entries = schema.get("prefixItems") or [schema.get("items", {})]
        inner = ", ".join(dict.fromkeys(_values(entry, definitions) for entry in entries))
        count = f"{schema['maxItems']} of " if "maxItems" in schema else "list of "
        return count + inner
    if schema.get("type") == "object":
        return "mapping"
    return _TYPES.get(str(schema.get("type")), "anything") + _range(schema)


_TYPES = {
    "number": "number",
    "integer": "whole number",
    "string": "text",
    "boolean": "true or false",
    "null": "null",
}
_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


def _range(schema: Mapping[str, Any]) -> str:
    bounds = [f"{sign} {schema[key]:g}" for key, sign in _BOUNDS.items() if key in schema]
    return " " + ", ".join(bounds) if bounds else ""


def _when_and_where() -> Iterator[str]:
    """Describe activation, duration, targets and conditions from their models."""
    yield from ("## Targets", "")
    yield _text(FaultForm.model_fields["target"].description)
    yield _text(Target.__doc__)
    yield from ("", "## Activation", "", _text(Activation.__doc__), "", *_table(Activation))
    yield from ("", "`after`: " + _text(After.__doc__), "", *_table(After))
    yield from ("", "## Duration", "", _text(FaultForm.model_fields["duration"].description))
    for model in _DURATIONS:
        keys = ", ".join(model.model_fields)
        yield from ("", f"`{{{keys}}}`: " + _text(model.__doc__), "", *_table(model))
    yield from ("", "## Conditions", "")
    yield from (_text(part) for part in _described(parse_condition))


def _described(function: Any) -> list[str]:
    text = (inspect.getdoc(function) or "").partition("\nRaises:")[0]
    return text.strip().split("\n")


def _table(model: type[BaseModel]) -> Iterator[str]:
    yield from _head(["key", "values", "default", "meaning"])
    for row in _fields(model):
        yield _row(row)


def _head(names: list[str]) -> list[str]:
    return [_row(names), "|" + "---|" * len(names)]


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _value(default: Any) -> str:
    if isinstance(default, (bool, type(None))):
        return {True: "true", False: "false", None: "null"}[default]
    if isinstance(default, (int, float)):
        return f"{default:g}"
    if isinstance(default, str):
        return _cell(f"“{default}”")
    return "`{}`" if default == {} else f"`{default}`"


def _text(docstring: str | None) -> str:
    return inspect.cleandoc(docstring or "").replace("``", "`")


def _cell(text: str) -> str:
    """Put a text on one line, with breaks between paragraphs and no end of the table's cell."""
    paragraphs = inspect.cleandoc(text).split("\n\n")
    return "<br>".join(" ".join(_text(paragraph).split()) for paragraph in paragraphs).replace(
        "|", "\\|"
    )


if __name__ == "__main__":
    _own = [DOMAINS[name] for name in DOMAINS if DOMAINS.is_ours(name)]
    _targets = {
        kind: target for each in reversed(_own) for kind, target in each.fault_targets.items()
    }
    write_page(Path(__file__).resolve().parents[2] / "docs" / PAGE, _targets)
