"""Units of work that the shards of a session share out, so that each is a part of one plan."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from heapq import heapreplace
from typing import Literal

from pytest_dura.core.codec import Count, Positive, Sha256

UnitKind = Literal["case", "test"]


@dataclass(frozen=True)
class ShardUnit:
    """Unit of work that no two shards share: items on the same episodes, or a test on its own.

    Args:
        kind: ``case`` for the items of cases, ``test`` for a test without one.
        name: The first of its cases, or its node id.
        items: How many items it has.
        episodes: How many episodes are planned for it, by which shards are balanced.
        digest: SHA-256 over the node ids of its items, sorted, as a list of JSON.
    """

    kind: UnitKind
    name: str
    items: Positive
    episodes: Count
    digest: Sha256

    @property
    def key(self) -> tuple[str, str]:
        """Key that is unique among the units of a session, and orders them."""
        return self.kind, self.name

    @classmethod
    def of(cls, kind: UnitKind, name: str, node_ids: Sequence[str], episodes: int) -> ShardUnit:
        """Build the unit of these items."""
        digest = hashlib.sha256(json.dumps(sorted(node_ids)).encode()).hexdigest()
        return cls(kind, name, len(node_ids), episodes, digest)


def plan_digest(units: Iterable[ShardUnit]) -> str:
    """SHA-256 over the units of a whole session, whatever order they are in.

    Shards with the same digest are parts of the same whole; the units of all of them together have
    to have it as well.
    """
    rows = [
        [unit.kind, unit.name, unit.items, unit.episodes, unit.digest]
        for unit in sorted(units, key=lambda unit: unit.key)
    ]
    return hashlib.sha256(json.dumps(rows).encode()).hexdigest()


def split_units(units: Iterable[ShardUnit], count: int) -> list[list[ShardUnit]]:
    """Split units into shards of about equal numbers of episodes; some may be empty.

    The largest unit first, each goes to the shard that has the fewest episodes so far, and among
    equals the fewest items: Graham's longest-processing-time rule, whose largest shard is at most
    4/3 - 1/(3 count) times that of the best split. It depends on the set of units alone.

    Args:
        units: All units of the session, each with a key of its own.
        count: How many shards.
    """
    shards: list[list[ShardUnit]] = [[] for _ in range(count)]
    loads = [(0, 0, index) for index in range(count)]  # a heap
    for unit in sorted(units, key=lambda unit: (-unit.episodes, -unit.items, unit.key)):
        episodes, items, index = loads[0]
        shards[index].append(unit)
        heapreplace(loads, (episodes + unit.episodes, items + unit.items, index))
    return [sorted(shard, key=lambda unit: unit.key) for shard in shards]
