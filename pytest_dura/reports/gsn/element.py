"""Element: a node of an argument, and the ids of elements."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

_PREFIXES = {
    "CG": "CounterGoal",
    "G": "Goal",
    "CSn": "CounterSolution",
    "Sn": "Solution",
    "S": "Strategy",
    "C": "Context",
    "A": "Assumption",
    "J": "Justification",
}
"""Kind of an element by the prefix of its id; the first prefix that fits counts."""

_LONGEST = 100
_PLAIN = re.compile(r"[A-Za-z0-9_./+~-]+")
"""Names that stand in an id as they are; none has the `@`, `:` and `=` that part an id."""


def kind_of(identifier: str) -> str | None:
    """The kind of an element by its id, ``None`` if the id begins with no known prefix."""
    return next((kind for start, kind in _PREFIXES.items() if identifier.startswith(start)), None)


def derived_id(prefix: str, *parts: str, what: str = "", apart: tuple[str, ...] = ()) -> str:
    """A readable id of an element about something named: ``G-SAF-1@intersection/nominal``.

    Different parts give different ids, in each session the same: names that do not stand in an
    id as they are, and what is only to tell apart, are kept as a short hash after ``=``. No id
    that is written by hand in this package has a dash.

    Args:
        prefix: Of the kind of element.
        parts: What the element is about.
        what: What it says of these, such as ``untested``.
        apart: Further parts, that go into the hash alone.
    """
    start = f"{prefix}-{what}:" if what else f"{prefix}-"
    text = "@".join(parts)
    if not apart and len(text) <= _LONGEST and all(map(_PLAIN.fullmatch, parts)):
        return start + text
    # A megabyte of prose costs no more than a name.
    readable = re.sub(r"[^A-Za-z0-9_./+~@-]+", "-", text[: 4 * _LONGEST])[:_LONGEST].strip("-")
    digest = hashlib.sha256(repr((what, parts, apart)).encode()).hexdigest()[:10]
    return f"{start}{readable}={digest}"


@dataclass(frozen=True)
class Element:
    """One node of an argument.

    Args:
        id: Unique; its prefix tells its kind.
        text: What it states.
        supported_by: Ids of the elements that support it.
        in_context_of: Ids of contexts, assumptions and justifications.
        challenges: Id of the element that this counter element challenges, or a relation as
            ``G1 -> G2``; empty if none.
        undeveloped: Nothing supports it yet.
        defeated: A challenge to it has been found right.
        url: Where the evidence lies, relative to the bundle.
        alias: A name that does not depend on how ids are made: ``requirement:SAF-1``.
        layers: Further keys, which gsn2x shows on demand.
        brief: The text in a few short lines, for a small shape of the picture.
    """

    id: str
    text: str
    supported_by: tuple[str, ...] = ()
    in_context_of: tuple[str, ...] = ()
    challenges: str = ""
    undeveloped: bool = False
    defeated: bool = False
    url: str = ""
    alias: str = ""
    layers: Mapping[str, Any] = field(default_factory=dict)
    brief: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """Kind by the prefix of the id, such as ``Goal``; empty if the prefix is none of GSN's."""
        return kind_of(self.id) or ""

    def to_yaml(self) -> dict[str, Any]:
        """Plain data under the keys of gsn2x; what is empty is left out."""
        data: dict[str, Any] = {
            "text": self.text,
            "supportedBy": list(self.supported_by),
            "inContextOf": list(self.in_context_of),
            "challenges": self.challenges,
            "undeveloped": self.undeveloped,
            "defeated": self.defeated,
            "url": self.url,
            "alias": self.alias,
        }
        return {key: value for key, value in data.items() if value} | dict(self.layers)


Argument = dict[str, Element]
"""Elements by id, the root first."""


def root_ids(elements: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Ids of the elements that no other refers to, and that challenge nothing."""
    referenced = {
        reference
        for node in elements.values()
        for reference in (*node.get("supportedBy", ()), *node.get("inContextOf", ()))
    }
    return [
        id_
        for id_, node in elements.items()
        if id_ not in referenced and not node.get("challenges")
    ]
