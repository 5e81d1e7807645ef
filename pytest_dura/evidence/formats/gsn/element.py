"""Element: one node of an argument, and the ids that elements have."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

PREFIXES = {
    "CG": "CounterGoal",
    "G": "Goal",
    "CSn": "CounterSolution",
    "Sn": "Solution",
    "S": "Strategy",
    "C": "Context",
    "A": "Assumption",
    "J": "Justification",
}
"""What an id begins with, in the order in which it is looked at, and the kind of its element."""

_READABLE = 60


def kind_of(identifier: str) -> str | None:
    """The kind of an element by its id, ``None`` if the id begins with no known prefix."""
    return next((kind for start, kind in PREFIXES.items() if identifier.startswith(start)), None)


def derived_id(prefix: str, *parts: str, apart: tuple[str, ...] = ()) -> str:
    """A readable id of an element about something named, such as ``G-SAF-1``.

    Different parts give different ids: what the readable form loses is kept as a short hash, after
    a dot, which no readable form has. No id that is written by hand in this package has a dash.

    Args:
        prefix: Of the kind of element.
        parts: What the element is about.
        apart: Further parts, that go into the hash alone.
    """
    told = ".".join(parts)
    head = told[: 4 * _READABLE]  # a megabyte of prose costs no more than a name
    readable = re.sub(r"[^A-Za-z0-9_]+", "-", head).strip("-")[:_READABLE].strip("-")
    if len(parts) == 1 and not apart and readable == told:
        return f"{prefix}-{readable}"
    digest = hashlib.sha256(repr((parts, apart)).encode()).hexdigest()[:10]
    return f"{prefix}-{readable}.{digest}"


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
        """Such as ``Goal``; empty if the prefix is none of GSN's."""
        return kind_of(self.id) or ""

    def to_yaml(self) -> dict[str, Any]:
        """Plain data under the keys of gsn2x; what is empty is left out."""
        told: dict[str, Any] = {
            "text": self.text,
            "supportedBy": list(self.supported_by),
            "inContextOf": list(self.in_context_of),
            "challenges": self.challenges,
            "undeveloped": self.undeveloped,
            "defeated": self.defeated,
            "url": self.url,
            "alias": self.alias,
        }
        return {key: value for key, value in told.items() if value} | dict(self.layers)


Argument = dict[str, Element]
"""Elements by id, the root first."""
