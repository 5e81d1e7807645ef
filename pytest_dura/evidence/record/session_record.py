"""SessionRecord: the evidence record as renderers read it, with its episodes one at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
