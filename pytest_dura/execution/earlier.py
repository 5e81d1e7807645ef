"""EarlierEpisodes: which episodes of earlier sessions count in this one, and what changed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

from pytest_dura.core.episode import Episode
from pytest_dura.execution.address import Address
from pytest_dura.execution.cache import CacheEntry, EpisodeCache
from pytest_dura.execution.memory import EpisodeKey, key_of
from pytest_dura.execution.sources import (
    EpisodeFiles,
    LoadedModules,
    SourceRules,
    changed_meanwhile,
    changed_sources,
    differences,
    shortened,
)
from pytest_dura.execution.task import EpisodeTask


class EarlierEpisodes:
    """Episodes that other sessions put into the cache.

    Args:
        cache: The cache, if there is one.
        rules: Which files are sources of the session.
    """

    def __init__(self, cache: EpisodeCache | None, rules: SourceRules | None = None) -> None:
        self._cache, self._rules, self._files = cache, rules, EpisodeFiles(rules)
        self._changes: dict[str, tuple[str, ...]] = {}
        self._compared, self._meanwhile = 0, ""
        self._index: dict[tuple[str, str], list[CacheEntry]] | None = None
        self.origins: dict[EpisodeKey, str] = {}
        """Ids of the sessions that simulated the episodes taken over."""
        self.same_as: dict[EpisodeKey, str] = {}
        """Ids of the runs with recovery that episodes without it are, which were not simulated."""
        self.searched: dict[EpisodeKey, None] = {}
        """Episodes that searches used, in this order, where earlier sessions may have had them."""
        self.outdated: dict[EpisodeKey, tuple[str, ...]] = {}
        """What changed since an earlier session simulated these, which are simulated again.
        Nothing did where the earlier episode was missing."""

    def files_of(self, task: EpisodeTask) -> Mapping[str, str]:
        """Files that an episode rests on beside the sources of the session."""
        sources = None if self._cache is None else self._cache.sources(self._cache.session)
        return self._files.of(task, () if sources is None else sources.files)

    def may_count(self, task: EpisodeTask, entry: CacheEntry) -> bool:
        """Whether an episode of the cache counts in this session, unless it is missing.

        One of another session does if such are taken over, and all that it rests on is equal. A
        repetition does not: it is to show that this session, too, comes to the same.
        """
        if self._cache is None or entry.session == self._cache.session:
            return True
        return self._cache.earlier and not task.again and not self._changed(task, entry)

    def counts(self, task: EpisodeTask, episode: Episode, entry: CacheEntry) -> bool:
        """Whether an episode of the cache counts in this session; it is noted where it does.

        One that was missing in another session does not: what was wrong may be mended.
        """
        if not self.may_count(task, entry):
            return False
        if self._cache is None or entry.session == self._cache.session:
            if entry.changed is not None:
                self.outdated[key_of(task)] = entry.changed
            return True
        if episode.failure is not None:
            return False
        self.origins[key_of(task)] = entry.session
        return True

    def miss(self, task: EpisodeTask, address: Address) -> tuple[str, ...] | None:
        """Note why an episode has to be simulated, if an earlier session had one of its name.

        Returns:
            What changed since the earlier one that it is closest to.
        """
        if self._cache is None or not self._cache.earlier or task.again:
            return None
        if self._index is None:
            self._index = defaultdict(list)
            for entry in self._cache.entries():
                if entry.session != self._cache.session:
                    self._index[entry.id, entry.component].append(entry)
        known = self._index.get((task.spec.id, task.spec.component))
        if not known:
            return None
        changes = [(*address.changed(each.parts), *self._changed(task, each)) for each in known]
        least = min(changes, key=lambda change: (len(change), change))
        self.outdated[key_of(task)] = least
        return least

    def _changed(self, task: EpisodeTask, entry: CacheEntry) -> tuple[str, ...]:
        """What changed of all that an earlier episode rests on, but for what it was run from."""
        assert self._cache is not None
        if entry.session not in self._changes:
            now, then = map(self._cache.sources, (self._cache.session, entry.session))
            self._changes[entry.session] = changed_sources(now, then)
        files = shortened(differences(entry.files, self.files_of(task)))
        return (*self._changes[entry.session], *files)

    def changed_meanwhile(self, modules: LoadedModules) -> str:
        """Name what changed since the session began, of what this process imported; or nothing."""
        sources = None if self._cache is None else self._cache.sources(self._cache.session)
        count = len(modules.digests())
        if sources is not None and self._rules is not None and count != self._compared:
            names = changed_meanwhile(modules, sources, self._rules.root)
            self._compared, self._meanwhile = count, ", ".join(shortened(sorted(names)))
        return self._meanwhile

    def origin(self, key: EpisodeKey) -> dict[str, Any]:
        """Where an episode comes from, as the record has it; see :meth:`miss`."""
        changed = self.outdated.get(key)
        return {
            "session": self.origins.get(key),
            "changed": None if changed is None else list(changed),
            **({"same_as": self.same_as[key]} if key in self.same_as else {}),
        }

    def same_run(self, task: EpisodeTask, aided: EpisodeTask) -> None:
        """Note that an episode is that of the run with recovery, and comes from where it does."""
        key, other = key_of(task), key_of(aided)
        self.same_as[key] = aided.spec.id
        if other in self.origins:
            self.origins[key] = self.origins[other]
        if other in self.outdated:
            self.outdated[key] = self.outdated[other]

    def search_used(self, task: EpisodeTask) -> None:
        """Note that a search, which leaves no record of its episodes, used one."""
        if self._cache is not None and self._cache.earlier:
            self.searched[key_of(task)] = None
