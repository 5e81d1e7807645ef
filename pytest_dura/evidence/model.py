"""The evidence record as renderers read it: plain data, with its episodes one at a time."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any


def plain_data(value: Any) -> Any:
    """The value as builtins; tuples become lists, and a number that is not finite becomes ``None``.

    Raises:
        TypeError: For an object that is no data.
    """
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain_data(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_data(item) for item in value]
    if hasattr(value, "tolist"):  # numpy's scalars and arrays
        converted = value.tolist()
        return plain_data(converted)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    raise TypeError(f"{type(value).__name__} is not plain data")


Data = Mapping[str, Any]


@dataclass(frozen=True)
class SessionRecord:
    """All that ``evidence.json`` holds. Its episodes may be many, and are never all in memory.

    Args:
        head: Every top-level key but ``episodes``.
        directory: The bundle's directory, in which the files of traces lie.
        read_episodes: Gives the episodes anew at each call, in the order of the record.
    """

    head: Data
    directory: Path
    read_episodes: Callable[[], Iterator[Data]]

    def __getitem__(self, key: str) -> Any:
        """A top-level key, ``episodes`` apart."""
        return self.head[key]

    def episodes(self) -> Iterator[Data]:
        """The episodes, in the order of the record."""
        return self.read_episodes()

    @classmethod
    def of(cls, record: Data, directory: Path) -> SessionRecord:
        """That of a record which is in memory as a whole."""
        head = {key: value for key, value in record.items() if key != "episodes"}
        return cls(head, directory, lambda: iter(record["episodes"]))


def components_under_test(record: SessionRecord) -> list[Any]:
    """The components under test that the record describes, the first one first."""
    first = record["component_under_test"]
    return [first, *first.get("others", ())]


@dataclass(frozen=True)
class Counts:
    """Counts that every format states. ``waived`` verdicts are counted by their word as well.

    Args:
        gate: ``passed``, ``failed`` or ``incomplete``.
        requirements: Requirements of the session.
        cases: Cases with one component each.
        episodes: Episodes that were run.
        valid: Those that are valid.
        invalid: Those whose planned fault never manifested.
        missing: Those that an infrastructure error ended.
        supported: Verdicts.
        violated: Verdicts.
        undecided: Verdicts.
        waived: Verdicts that a waiver excuses.
    """

    gate: str
    requirements: int
    cases: int
    episodes: int
    valid: int
    invalid: int
    missing: int
    supported: int
    violated: int
    undecided: int
    waived: int

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return dict(vars(self))

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Counts:
        """The inverse of :meth:`to_json`.

        Raises:
            TypeError: If a count is missing, or there are others.
        """
        return cls(**data)

    @classmethod
    def of(cls, record: SessionRecord) -> Counts:
        """Counted in the record itself, and not taken from its ``totals``."""
        validity = Counter(episode["validity"] for episode in record.episodes())
        words = Counter(verdict["verdict"] for verdict in record["verdicts"])
        return cls(
            gate=record["gate"]["result"],
            requirements=len(record["requirements"]),
            cases=len(record["cases"]),
            episodes=validity.total(),
            valid=validity["valid"],
            invalid=validity["invalid"],
            missing=validity["missing"],
            supported=words["supported"],
            violated=words["violated"],
            undecided=words["undecided"],
            waived=sum(verdict["waiver"] is not None for verdict in record["verdicts"]),
        )
