"""The episodes of this process, so that each one is simulated once, however many there are."""

from __future__ import annotations

import pickle
import tempfile
import weakref
import zlib
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import fields
from typing import IO, Any

from pytest_dura.campaign.components import local_object
from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.requirements.verdicts import JudgedEpisode

Simulate = Callable[[EpisodeSpec], JudgedEpisode]
Key = tuple[str, tuple[int, ...]]

RECENT = 64
"""Episodes in memory. More of them are on disk."""
_STORED = tuple(one.name for one in fields(Episode) if one.name != "spec")


class EpisodeStore:
    """Episodes by what determines them.

    A bare instance, or a class that only this process can reach, is told apart from others of the
    same name by its identity; the store keeps a reference to it, so that no other object can
    take over its identity.

    The episodes that were asked for last are in memory, the others in a temporary file without a
    name, which is gone with the process. They come back as other objects with the same digest. One
    that cannot be pickled, or that the disk has no room for, stays in memory.

    Args:
        recent: How many are in memory.
    """

    def __init__(self, recent: int = RECENT) -> None:
        self._most = recent
        self._recent: OrderedDict[Key, JudgedEpisode] = OrderedDict()
        self._spilt: dict[Key, tuple[int, int]] = {}
        self._bound: dict[Key, JudgedEpisode] = {}
        self._file: IO[bytes] | None = None
        self._kept: dict[int, Any] = {}

    def __len__(self) -> int:
        return len(self._spilt.keys() | self._recent.keys() | self._bound.keys())

    @staticmethod
    def key(spec: EpisodeSpec) -> Key:
        """What tells the episode of a spec apart, as long as the store knows it."""
        return spec.key, tuple(map(id, _local(spec)))

    def get(self, spec: EpisodeSpec, simulate: Simulate) -> JudgedEpisode:
        """The episode of a spec, simulated at the first call."""
        key = self.key(spec)
        if key in self._bound:
            return self._bound[key]
        found = self._recent.pop(key, None)
        if found is None and key in self._spilt:
            found = self._read(key, spec)
        if found is None:
            found = simulate(spec)
            self._kept |= {id(one): one for one in _local(spec)}
        self._recent[key] = found
        while len(self._recent) > self._most:
            self._spill(*self._recent.popitem(last=False))
        return found

    def _spill(self, key: Key, episode: JudgedEpisode) -> None:
        if key in self._spilt:
            return
        known = {name: getattr(episode, name) for name in _STORED}
        try:
            data = zlib.compress(pickle.dumps(known, pickle.HIGHEST_PROTOCOL), 1)
            if self._file is None:
                self._file = tempfile.TemporaryFile(prefix="pytest-dura-")  # noqa: SIM115 - stays
                weakref.finalize(self, self._file.close)
            place = self._file.seek(0, 2)
            self._file.write(data)
            self._file.flush()
        except Exception:  # pickling runs the code of whatever is in an episode
            self._bound[key] = episode
        else:
            self._spilt[key] = place, len(data)

    def _read(self, key: Key, spec: EpisodeSpec) -> JudgedEpisode:
        assert self._file is not None
        place, size = self._spilt[key]
        self._file.seek(place)
        # Written by this process, into a file that no other one can name.
        known = pickle.loads(zlib.decompress(self._file.read(size)))  # noqa: S301 - see above
        return JudgedEpisode.of(Episode(spec=spec, **known))


def _local(spec: EpisodeSpec) -> list[Any]:
    """What makes a spec mean something in this process only."""
    parts = [spec.simulator, *(role for _, role in sorted(spec.roles.items()))]
    return [one for one in map(local_object, parts) if one is not None]
