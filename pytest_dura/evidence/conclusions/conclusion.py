"""Conclusion: base of what follows from the episodes of a session, one table of the record each."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any

from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import RecordHead


class Conclusion(ABC):
    """What follows for one table of the record.

    It sees each episode once, in the order of the record, and keeps a few numbers of it.

    Args:
        head: Of the record, before anything is concluded.
    """

    def __init__(self, head: RecordHead) -> None:
        self.head = head

    @abstractmethod
    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode."""

    @abstractmethod
    def concluded(self, head: RecordHead) -> Mapping[str, Any]:
        """Return the keys of the head that it concludes.

        Args:
            head: With what those before it concluded.
        """

    def check(self, episode: EpisodeEntry) -> Iterator[str]:  # noqa: ARG002
        """Yield what an episode cannot say beside the head, of what this table rests on.

        ``verify`` asks for it, episode by episode; what a line cannot say by itself it says itself.
        """
        return iter(())

    def check_head(self) -> Iterator[str]:
        """Yield what the head cannot say beside itself and the episodes that were checked."""
        return iter(())
