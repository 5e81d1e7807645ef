"""EpisodeMemory: episodes of this process, the latest in memory, the others in a file."""

from __future__ import annotations

import pickle
import tempfile
import weakref
import zlib
from collections import OrderedDict
from dataclasses import fields
from typing import IO

from pytest_dura.core.episode import Episode
from pytest_dura.execution.codec import SERIES
from pytest_dura.execution.task import EpisodeTask
from pytest_dura.requirements.episode_verdicts import JudgedEpisode

EpisodeKey = tuple[str, int, tuple[int, ...]]

_MAX_EPISODES_IN_MEMORY = 256
"""Episodes in memory at most: all of a campaign, where many requirements look at it one after the
other. More of them are on disk."""
_MAX_MEMORY_BYTES = 64_000_000
"""Bytes that they may take, which is what as many of 15 s do."""
_NUMBER_BYTES = 32
"""Size of a number in a list."""
_STORED = tuple(each.name for each in fields(Episode) if each.name != "spec")


def key_of(task: EpisodeTask) -> EpisodeKey:
    """Key of an episode in this process.

    It holds the identities of bare instances, and of classes that only this process can reach:
    others of the same name are other ones.
    """
    return task.spec.key, task.again, tuple(map(id, task.local))


def size_of(episode: Episode) -> int:
    """Size of an episode in memory, in bytes: columns, what a viewer shows, measurements."""
    columns = [episode.time, *episode.signals.values(), *episode.decisions.values()]
    if episode.recording is not None:
        columns += episode.recording.flags.values()
        scene = episode.recording.scene
        columns += [] if scene is None else [scene.truth.poses, scene.percept.poses]
    series = (pair for name in SERIES for pair in getattr(episode.metrics, name).values())
    numbers = sum(len(values) for pair in series for values in pair)
    return sum(column.nbytes for column in columns) + _NUMBER_BYTES * numbers


class EpisodeMemory:
    """Episodes of this process: the latest used in memory, the others in a file without a name.

    The file is gone with the process. Episodes come back from it as other objects with the same
    digest. One that cannot be pickled, or that the disk has no room for, stays in memory, and so
    do the objects that exist in this process only: no others get their identities.

    Args:
        room: Bytes that those in memory may take, see :func:`size_of`.
        recent: How many are in memory at most.
    """

    def __init__(
        self, room: int = _MAX_MEMORY_BYTES, recent: int = _MAX_EPISODES_IN_MEMORY
    ) -> None:
        self._max_bytes, self._max_episodes = room, recent
        self._sizes: dict[EpisodeKey, int] = {}
        self._bytes = 0
        self._recent: OrderedDict[EpisodeKey, tuple[JudgedEpisode, bool]] = OrderedDict()
        self._spilled: dict[EpisodeKey, tuple[int, int]] = {}
        self._pinned: dict[EpisodeKey, JudgedEpisode] = {}
        self._file: IO[bytes] | None = None
        self._local_objects: dict[int, object] = {}

    def __len__(self) -> int:
        return len(self._spilled.keys() | self._recent.keys() | self._pinned.keys())

    def find(self, task: EpisodeTask) -> JudgedEpisode | None:
        """An episode that was put here; ``None`` for one that was dropped as kept elsewhere."""
        key = key_of(task)
        if key in self._pinned:
            return self._pinned[key]
        if key in self._recent:
            self._recent.move_to_end(key)
            return self._recent[key][0]
        if key not in self._spilled:
            return None
        assert self._file is not None
        place, size = self._spilled[key]
        self._file.seek(place)
        # Written by this process, into a file that no other one can name.
        stored = pickle.loads(zlib.decompress(self._file.read(size)))  # noqa: S301 - see above
        state, verdicts = stored
        episode = JudgedEpisode.of(Episode(spec=task.spec, **state))
        episode.check_verdicts.update(verdicts)
        self._put(key, episode, elsewhere=False)
        return episode

    def holds(self, task: EpisodeTask) -> bool:
        """Whether :meth:`find` returns an episode, which is not read for that."""
        key = key_of(task)
        return key in self._pinned or key in self._recent or key in self._spilled

    def put(self, task: EpisodeTask, episode: JudgedEpisode, *, elsewhere: bool) -> None:
        """Take in an episode.

        Args:
            task: Its task.
            episode: The episode.
            elsewhere: Whether it is kept elsewhere, too, and may be dropped here.
        """
        self._local_objects |= {id(each): each for each in task.local}
        self._put(key_of(task), episode, elsewhere=elsewhere)

    def _put(self, key: EpisodeKey, episode: JudgedEpisode, *, elsewhere: bool) -> None:
        if key not in self._recent:
            self._sizes[key] = size_of(episode)
            self._bytes += self._sizes[key]
        self._recent[key] = episode, elsewhere
        while self._bytes > self._max_bytes or len(self._recent) > self._max_episodes:
            oldest, (dropped, kept_elsewhere) = self._recent.popitem(last=False)
            self._bytes -= self._sizes.pop(oldest)
            if not kept_elsewhere:
                self._spill(oldest, dropped)

    def _spill(self, key: EpisodeKey, episode: JudgedEpisode) -> None:
        if key in self._spilled:
            return
        state = {name: getattr(episode, name) for name in _STORED}
        stored = state, episode.check_verdicts
        try:
            data = zlib.compress(pickle.dumps(stored, pickle.HIGHEST_PROTOCOL), 1)
            if self._file is None:
                self._file = tempfile.TemporaryFile(prefix="pytest-dura-")  # noqa: SIM115 - stays
                weakref.finalize(self, self._file.close)
            place = self._file.seek(0, 2)
            self._file.write(data)
            self._file.flush()
        except Exception:  # pickling runs the code of whatever is in an episode
            self._pinned[key] = episode
        else:
            self._spilled[key] = place, len(data)
