"""The episodes that this process has had in its hands, so that it need not ask for them again."""

from __future__ import annotations

import pickle
import tempfile
import weakref
import zlib
from collections import OrderedDict
from dataclasses import fields
from typing import IO

from pytest_dura.campaign.episodes.codec import SERIES
from pytest_dura.campaign.episodes.task import EpisodeTask
from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.requirements.verdicts import JudgedEpisode

Key = tuple[str, int, tuple[int, ...]]

RECENT = 256
"""Episodes in memory at most: all of a campaign, where many requirements look at it one after the
other. More of them are on disk."""
ROOM = 64_000_000
"""Bytes that they may take, which is what as many of 15 s do."""
_NUMBER = 32
"""Bytes that a number in a list takes."""
_STORED = tuple(one.name for one in fields(Episode) if one.name != "spec")


def key_of(task: EpisodeTask) -> Key:
    """What tells an episode apart in this process.

    A bare instance, or a class that only this process can reach, is told apart from others of the
    same name by its identity.
    """
    return task.spec.key, task.again, tuple(map(id, task.local))


def size_of(episode: Episode) -> int:
    """Bytes that an episode takes in memory: its columns, what a viewer shows, its measurements."""
    columns = [episode.time, *episode.signals.values(), *episode.decisions.values()]
    if episode.recording is not None:
        columns += episode.recording.flags.values()
        scene = episode.recording.scene
        columns += [] if scene is None else [scene.truth.poses, scene.percept.poses]
    series = (two for name in SERIES for two in getattr(episode.metrics, name).values())
    listed = sum(len(one) for two in series for one in two)
    return sum(one.nbytes for one in columns) + _NUMBER * listed


class EpisodeMemory:
    """The episodes that were asked for last are in memory, the others in a file without a name.

    The file is gone with the process. Episodes come back from it as other objects with the same
    digest. One that cannot be pickled, or that the disk has no room for, stays in memory, and so
    does whatever has a meaning in this process only, so that nothing takes over its identity.

    Args:
        room: Bytes that those in memory may take, as :func:`size_of` tells.
        recent: How many are in memory at most.
    """

    def __init__(self, room: int = ROOM, recent: int = RECENT) -> None:
        self._room, self._most = room, recent
        self._sizes: dict[Key, int] = {}
        self._taken = 0
        self._recent: OrderedDict[Key, tuple[JudgedEpisode, bool]] = OrderedDict()
        self._spilt: dict[Key, tuple[int, int]] = {}
        self._bound: dict[Key, JudgedEpisode] = {}
        self._file: IO[bytes] | None = None
        self._kept: dict[int, object] = {}

    def __len__(self) -> int:
        return len(self._spilt.keys() | self._recent.keys() | self._bound.keys())

    def find(self, task: EpisodeTask) -> JudgedEpisode | None:
        """An episode that was put here, unless it was left to others to keep."""
        key = key_of(task)
        if key in self._bound:
            return self._bound[key]
        if key in self._recent:
            self._recent.move_to_end(key)
            return self._recent[key][0]
        if key not in self._spilt:
            return None
        found = self._read(key, task.spec)
        self._put(key, found, elsewhere=False)
        return found

    def put(self, task: EpisodeTask, episode: JudgedEpisode, *, elsewhere: bool) -> None:
        """Take in an episode.

        Args:
            task: What it was had by.
            episode: The episode.
            elsewhere: Whether it is kept elsewhere, too, and may be forgotten here.
        """
        self._kept |= {id(one): one for one in task.local}
        self._put(key_of(task), episode, elsewhere=elsewhere)

    def _put(self, key: Key, episode: JudgedEpisode, *, elsewhere: bool) -> None:
        if key not in self._recent:
            self._sizes[key] = size_of(episode)
            self._taken += self._sizes[key]
        self._recent[key] = episode, elsewhere
        while self._taken > self._room or len(self._recent) > self._most:
            oldest, (one, kept_elsewhere) = self._recent.popitem(last=False)
            self._taken -= self._sizes.pop(oldest)
            if not kept_elsewhere:
                self._spill(oldest, one)

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
