"""Plot kinds: what draws plots of a session, of this package and of others, for every format.

A kind is a class. One of this package is a module of this folder, one of another package an entry
point; nothing else names it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from typing import ClassVar

from pytest_dura.core.registry import Registry, modules_below
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import RecordHead, SessionRecord
from pytest_dura.reports.document import Level, Plot


class PlotKind(ABC):
    """Draws plots of a session from its record.

    It sees each episode once, in the order of the record, and keeps a few numbers of it.

    Args:
        head: Of the record.
    """

    weight: ClassVar[Level] = Level.SUMMARY
    """From which level of detail on it is made."""
    place: ClassVar[int] = 100
    """Sorts the kinds, the least first."""

    def __init__(self, head: RecordHead) -> None:
        self.head = head

    def add(self, episode: EpisodeEntry) -> None:  # noqa: B027 - verdicts may be enough
        """Add an episode."""

    @abstractmethod
    def plots(self) -> Iterable[Plot]:
        """Draw the plots, in order of importance; none where there is nothing to be drawn."""


PLOTS: Registry[type[PlotKind]] = Registry(
    "pytest_dura.plots",
    "plot",
    lambda value: isinstance(value, type) and issubclass(value, PlotKind),
    "a subclass of pytest_dura.reports.plots.plot.PlotKind",
)
"""Kinds of other packages by their names."""


def all_kinds() -> Iterator[type[PlotKind]]:
    """Import the kinds, those of this package first."""
    for module in modules_below(__package__ or ""):
        for value in vars(module).values():
            own = isinstance(value, type) and value.__module__ == module.__name__
            if own and issubclass(value, PlotKind) and value is not PlotKind:
                yield value
    yield from (kind for _, kind in PLOTS.items())


def plots_of(record: SessionRecord, level: Level) -> Iterator[Plot]:
    """Draw the plots of a session up to a level of detail, in one pass over its episodes."""
    known = sorted(all_kinds(), key=lambda kind: kind.place)
    kinds = [kind(record.head) for kind in known if kind.weight <= level]
    reading = [kind for kind in kinds if type(kind).add is not PlotKind.add]
    for episode in record.episodes() if reading else ():
        for kind in reading:
            kind.add(episode)
    for kind in kinds:
        yield from kind.plots()
