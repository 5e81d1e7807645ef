"""What a session takes over from earlier ones, and why it does not take over the rest."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

from pytest_dura.campaign.episodes.address import Address
from pytest_dura.campaign.episodes.memory import Key, key_of
from pytest_dura.campaign.episodes.shelf import Entry, Shelf
from pytest_dura.campaign.episodes.task import EpisodeTask
from pytest_dura.core.episode import Episode


class Earlier:
    """Episodes on the shelf that other sessions put there.

    Args:
        shelf: The shelf, if there is one.
    """

    def __init__(self, shelf: Shelf | None) -> None:
        self._shelf = shelf
        self._index: dict[tuple[str, str], list[Mapping[str, str]]] | None = None
        self.origins: dict[Key, str] = {}
        """The sessions that simulated what was taken over."""
        self.searched: dict[Key, None] = {}
        """What searches used, in this order, as far as earlier sessions may have had it."""
        self.outdated: dict[Key, tuple[str, ...]] = {}
        """What changed since an earlier session simulated these; they are simulated again. Nothing
        did where the earlier one was missing."""

    def counts(self, task: EpisodeTask, episode: Episode, entry: Entry) -> bool:
        """Whether an episode on the shelf counts in this session.

        One of another session does if that was asked for, and if it was not missing there: what
        was wrong may be mended. A repetition does not: it is to show that this session, too, comes
        to the same.
        """
        if self._shelf is None or entry.session == self._shelf.session:
            if entry.changed is not None:
                self.outdated[key_of(task)] = entry.changed
            return True
        if not self._shelf.earlier or episode.failure is not None or task.again:
            return False
        self.origins[key_of(task)] = entry.session
        return True

    def miss(self, task: EpisodeTask, address: Address) -> tuple[str, ...] | None:
        """Note why an episode has to be simulated, if an earlier session had one of its name.

        Returns:
            What changed since the earlier one that it is closest to.
        """
        if self._shelf is None or not self._shelf.earlier or task.again:
            return None
        known = self._indexed(self._shelf).get((task.spec.id, task.spec.component))
        if not known:
            return None
        changes = [tuple(address.changed(parts)) for parts in known]
        self.outdated[key_of(task)] = found = min(changes, key=lambda one: (len(one), one))
        return found

    def origin(self, key: Key) -> dict[str, Any]:
        """Where an episode comes from, as the record tells it; see :meth:`miss`."""
        changed = self.outdated.get(key)
        return {
            "session": self.origins.get(key),
            "changed": None if changed is None else list(changed),
        }

    def search_used(self, task: EpisodeTask) -> None:
        """A search, which leaves no record of its episodes, used one."""
        if self._shelf is not None and self._shelf.earlier:
            self.searched[key_of(task)] = None

    def _indexed(self, shelf: Shelf) -> Mapping[tuple[str, str], list[Mapping[str, str]]]:
        if self._index is None:
            self._index = defaultdict(list)
            for entry in shelf.entries():
                if entry.session != shelf.session:
                    self._index[entry.id, entry.component].append(entry.parts)
        return self._index
