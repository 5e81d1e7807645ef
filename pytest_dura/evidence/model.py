"""The evidence record as renderers read it: plain data, with its episodes one at a time."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any


def plain_data(value: Any) -> Any:
    """Convert a value to builtins; tuples become lists, numbers that are not finite ``None``.

    Raises:
        TypeError: For an object that is no data.
    """
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain_data(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_data(entry) for entry in value]
    if hasattr(value, "tolist"):  # numpy's scalars and arrays
        return plain_data(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    raise TypeError(f"{type(value).__name__} is not plain data")


Data = Mapping[str, Any]


@dataclass(frozen=True)
class SessionRecord:
    """Content of ``evidence.json``. Its episodes may be many, and are never all in memory.

    Args:
        head: Every top-level key but ``episodes``.
        directory: The bundle's directory, in which the files of traces lie.
        read_episodes: Returns a new iterator over the episodes at each call, in their order.
    """

    head: Data
    directory: Path
    read_episodes: Callable[[], Iterator[Data]]

    def __getitem__(self, key: str) -> Any:
        """Value of a top-level key, ``episodes`` apart."""
        return self.head[key]

    def episodes(self) -> Iterator[Data]:
        """Iterate over the episodes, in the order of the record."""
        return self.read_episodes()

    @classmethod
    def of(cls, record: Data, directory: Path) -> SessionRecord:
        """Wrap a record that is in memory as a whole."""
        head = {key: value for key, value in record.items() if key != "episodes"}
        return cls(head, directory, lambda: iter(record["episodes"]))


def components_under_test(record: SessionRecord) -> list[Any]:
    """List the components under test that the record describes, the first one first."""
    first = record["component_under_test"]
    return [first, *first.get("others", ())]


@dataclass(frozen=True)
class Counts:
    """Counts that every format states. ``waived`` verdicts also count under their own status.

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
        """Convert to plain data."""
        return dict(vars(self))

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Counts:
        """Read what :meth:`to_json` gives.

        Raises:
            TypeError: If a count is missing, or there are others.
        """
        return cls(**data)

    @classmethod
    def of(cls, record: SessionRecord) -> Counts:
        """Count in the record itself, without its ``totals``."""
        validity = Counter(episode["validity"] for episode in record.episodes())
        statuses = Counter(verdict["verdict"] for verdict in record["verdicts"])
        return cls(
            gate=record["gate"]["result"],
            requirements=len(record["requirements"]),
            cases=len(record["cases"]),
            episodes=validity.total(),
            valid=validity["valid"],
            invalid=validity["invalid"],
            missing=validity["missing"],
            supported=statuses["supported"],
            violated=statuses["violated"],
            undecided=statuses["undecided"],
            waived=sum(verdict["waiver"] is not None for verdict in record["verdicts"]),
        )
