"""Forgeries of a record, made from its JSON Schema: one field each, and each fits the schema."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

Node = Mapping[str, Any]
Place = tuple["str | int", ...]
_DIGEST = re.compile(r"[0-9a-f]{32,}")
FAR = 10**6
"""By how much a count is forged, beside one more and one less."""


@dataclass(frozen=True)
class Forgery:
    """Another value at one place of a record.

    Args:
        field: The place without its indices and free keys, such as ``verdicts[].bound.upper``.
        kind: ``other`` value, ``null``, or ``fewer`` entries.
        place: Keys and indices from the top.
        value: What is put there.
    """

    field: str
    kind: str
    place: Place
    value: Any

    def apply(self, record: Any) -> None:
        """Put it into a record."""
        *way, last = self.place
        for key in way:
            record = record[key]
        record[last] = copy.deepcopy(self.value)


def forgeries(schema: Node, record: Any) -> Iterator[Forgery]:
    """All forgeries of a record, place by place: of each place a few other values."""
    yield from _forged(schema, schema, record, "", ())


def _forged(schema: Node, node: Node, value: Any, field: str, place: Place) -> Iterator[Forgery]:
    nodes = list(_alternatives(schema, node))
    if place and value is not None and any("null" in _types(option) for option in nodes):
        yield Forgery(field, "null", place, None)
    for other in _others(nodes, value):
        yield Forgery(field, "other", place, other)
    if isinstance(value, Mapping):
        for key in value:
            inner, name = _property(nodes, key)
            if name == "*":
                fewer = {other: rest for other, rest in value.items() if other != key}
                yield Forgery(field, "fewer", place, fewer)
            below = f"{field}.{name}" if field else name
            yield from _forged(schema, inner, value[key], below, (*place, key))
    if isinstance(value, list) and value:
        yield from (Forgery(field, "fewer", place, fewer) for fewer in (value[1:], value[:-1]))
        items = next((option["items"] for option in nodes if "items" in option), {})
        for index, entry in enumerate(value):
            yield from _forged(schema, items, entry, f"{field}[]", (*place, index))


def _alternatives(schema: Node, node: Node) -> Iterator[Node]:
    if "$ref" in node:
        name = node["$ref"].rpartition("/")[2]
        yield from _alternatives(schema, schema["$defs"][name])
    for option in node.get("anyOf", ()):
        yield from _alternatives(schema, option)
    if "$ref" not in node and "anyOf" not in node:
        yield node


def _types(node: Node) -> list[str]:
    kinds = node.get("type", [])
    return [kinds] if isinstance(kinds, str) else list(kinds)


def _property(nodes: Sequence[Node], key: str) -> tuple[Node, str]:
    """The schema of a key, and its name in fields: ``*`` for a key that is chosen freely."""
    for node in nodes:
        if key in node.get("properties", {}):
            return node["properties"][key], key
    for node in nodes:
        if isinstance(node.get("additionalProperties"), Mapping):
            return node["additionalProperties"], "*"
    return {}, "*"


def _others(nodes: Sequence[Node], value: Any) -> Iterator[Any]:
    """Other values that the schema allows in place of a plain one."""
    choices = [choice for node in nodes for choice in node.get("enum", ())]
    if choices or any("const" in node for node in nodes):
        yield from (choice for choice in choices if choice not in (value, None))
    elif isinstance(value, bool):
        yield not value
    elif isinstance(value, int | float):
        least = max((node["minimum"] for node in nodes if "minimum" in node), default=value - FAR)
        most = min((node["maximum"] for node in nodes if "maximum" in node), default=value + FAR)
        steps = (1, FAR) if isinstance(value, int) else (0.5,)
        moved = (value + sign * step for step in steps for sign in (1, -1))
        yield from (other for other in moved if least <= other <= most)
    elif isinstance(value, str):
        digest = _DIGEST.fullmatch(value)
        yield ("0" if value[0] != "0" else "1") + value[1:] if digest else value + "x"
    elif value is None:
        kinds = {kind for node in nodes for kind in _types(node)}
        examples = {"boolean": True, "integer": 1, "number": 1, "string": "x"}
        yield from (examples[kind] for kind in sorted(kinds & examples.keys()))
