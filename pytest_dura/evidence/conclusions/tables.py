"""Tables: further tables of a session, of this package and of others, which every format shows.

A table is a class with columns and rows. One of this package is a module of this folder, one of
another package an entry point; nothing else names it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from itertools import chain
from typing import Any, ClassVar, NamedTuple

from pytest_dura.core.classes import is_subclass
from pytest_dura.core.registry import Registry, modules_below
from pytest_dura.evidence.conclusions.conclusion import Conclusion
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import CellValue, ConcludedColumn, ConcludedTable, RecordHead

__all__ = ["TABLES", "Claim", "ConcludedColumn", "Table", "Tables", "unknown_tables"]


class Claim(NamedTuple):
    """Proposition of a table, for the argument."""

    about: str
    """What it is about, part of the goal's id; empty for that of the whole table."""
    text: str
    shown: bool
    """Whether the table supports it; otherwise it stays undeveloped."""


class Table(Conclusion):
    """A table of a session, concluded from its episodes.

    Its rows follow from the episodes and the head of the record alone, in an order of their own.
    """

    name: ClassVar[str]
    """Its key in ``conclusions``."""
    title: ClassVar[str]
    """Its heading."""
    about: ClassVar[str] = ""
    """What it shows, in one sentence."""
    columns: ClassVar[Sequence[ConcludedColumn]]
    """The first one names the row."""
    detail: bool = False
    """Whether the terminal shows it with ``-v`` alone."""

    @abstractmethod
    def rows(self) -> Iterable[Sequence[CellValue]]:
        """Return its rows, each with a value for each column; ``head`` has verdicts by now."""

    def lines(self) -> Iterable[str]:
        """Return what it comes to, in sentences for the terminal; called after :meth:`rows`."""
        return ()

    @classmethod
    def alike(cls, head: RecordHead) -> Iterable[tuple[str, Any, str]]:  # noqa: ARG003
        """Yield what has to be equal in all parts that are merged: key, value and remedy.

        Args:
            head: Of the record of a part.
        """
        return ()

    @classmethod
    def claims(cls, head: RecordHead) -> Sequence[Claim]:  # noqa: ARG003 - for overrides
        """Return what it claims in the argument: of the whole, and of its parts; default: nothing.

        Args:
            head: Of the record, with this table.
        """
        return ()

    def concluded(self, head: RecordHead) -> Mapping[str, Any]:
        """Return its entry of ``conclusions``; nothing without rows."""
        self.head = head
        rows = tuple(map(tuple, self.rows()))
        columns = tuple(self.columns)
        if not rows:
            return {}
        lines = tuple(self.lines())
        table = ConcludedTable(self.title, self.about, columns, rows, self.detail, lines)
        return {self.name: table}


TABLES: Registry[type[Table]] = Registry(
    "pytest_dura.conclusions",
    "table of a session",
    lambda value: is_subclass(value, Table),
    "a subclass of pytest_dura.evidence.Table",
)
"""Tables of other packages by their names."""


def all_tables() -> Iterator[type[Table]]:
    """Import the tables, those of this package first."""
    yield from _own_tables()
    yield from (table for _, table in TABLES.items())


@cache
def _own_tables() -> tuple[type[Table], ...]:
    """Import those of this package."""
    values = chain.from_iterable(vars(module).values() for module in modules_below(__package__))
    return tuple(each for each in values if is_subclass(each, Table) and each is not Table)


class Tables(Conclusion):
    """Concludes the key ``conclusions``."""

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        self._tables = [table(head) for table in all_tables()]

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode."""
        for table in self._tables:
            table.add(episode)

    def check(self, episode: EpisodeEntry) -> Iterator[str]:
        """Yield what an episode cannot say beside what a table rests on."""
        for table in self._tables:
            yield from table.check(episode)

    def check_head(self) -> Iterator[str]:
        """Yield what the head cannot say beside what a table rests on."""
        for table in self._tables:
            yield from table.check_head()

    def concluded(self, head: RecordHead) -> Mapping[str, Any]:
        """Conclude them; those that only the record knows stay as they are."""
        known = {name: head.conclusions[name] for name in unknown_tables(head)}
        for table in self._tables:
            known.update(table.concluded(head))
        return {"conclusions": dict(sorted(known.items()))}


def unknown_tables(head: RecordHead) -> list[str]:
    """List the tables of a record that cannot be concluded here, as they are not installed."""
    return sorted(head.conclusions.keys() - {table.name for table in all_tables()})
