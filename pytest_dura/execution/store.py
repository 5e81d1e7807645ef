"""EpisodeStore: each episode once, from memory, from the shared cache, or simulated."""

from __future__ import annotations

import pickle
import tempfile
import time
import weakref
import zlib
from collections import OrderedDict, defaultdict
from collections.abc import Iterable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field, fields, replace
from threading import Event
from typing import IO, Any

from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import ConfigurationError, DuraError, describe_error
from pytest_dura.execution.address import Address, Addresses
from pytest_dura.execution.cache import MAX_ATTEMPTS, CacheEntry, Claim, EpisodeCache
from pytest_dura.execution.codec import SERIES, pack, unpack
from pytest_dura.execution.executors import MAX_SECONDS, Execution, time_limit_of
from pytest_dura.execution.task import EpisodeTask, missing_episode
from pytest_dura.execution.worker import CallFailedError, ProcessLostError
from pytest_dura.requirements.episode_verdicts import JudgedEpisode

EpisodeKey = tuple[str, int, tuple[int, ...]]

_MAX_EPISODES_IN_MEMORY = 256
"""Episodes in memory at most: all of a campaign, where many requirements look at it one after the
other. More of them are on disk."""
_MAX_MEMORY_BYTES = 64_000_000
"""Bytes that they may take, which is what as many of 15 s do."""
_NUMBER = 32
"""Bytes that a number in a list takes."""
_STORED = tuple(item.name for item in fields(Episode) if item.name != "spec")


def key_of(task: EpisodeTask) -> EpisodeKey:
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
    listed = sum(len(item) for two in series for item in two)
    return sum(column.nbytes for column in columns) + _NUMBER * listed


class EpisodeMemory:
    """The episodes that were asked for last are in memory, the others in a file without a name.

    The file is gone with the process. Episodes come back from it as other objects with the same
    digest. One that cannot be pickled, or that the disk has no room for, stays in memory, and so
    does whatever has a meaning in this process only, so that nothing takes over its identity.

    Args:
        room: Bytes that those in memory may take, as :func:`size_of` tells.
        recent: How many are in memory at most.
    """

    def __init__(
        self, room: int = _MAX_MEMORY_BYTES, recent: int = _MAX_EPISODES_IN_MEMORY
    ) -> None:
        self._room, self._most = room, recent
        self._sizes: dict[EpisodeKey, int] = {}
        self._taken = 0
        self._recent: OrderedDict[EpisodeKey, tuple[JudgedEpisode, bool]] = OrderedDict()
        self._spilt: dict[EpisodeKey, tuple[int, int]] = {}
        self._bound: dict[EpisodeKey, JudgedEpisode] = {}
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
        self._kept |= {id(item): item for item in task.local}
        self._put(key_of(task), episode, elsewhere=elsewhere)

    def _put(self, key: EpisodeKey, episode: JudgedEpisode, *, elsewhere: bool) -> None:
        if key not in self._recent:
            self._sizes[key] = size_of(episode)
            self._taken += self._sizes[key]
        self._recent[key] = episode, elsewhere
        while self._taken > self._room or len(self._recent) > self._most:
            oldest, (item, kept_elsewhere) = self._recent.popitem(last=False)
            self._taken -= self._sizes.pop(oldest)
            if not kept_elsewhere:
                self._spill(oldest, item)

    def _spill(self, key: EpisodeKey, episode: JudgedEpisode) -> None:
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

    def _read(self, key: EpisodeKey, spec: EpisodeSpec) -> JudgedEpisode:
        assert self._file is not None
        place, size = self._spilt[key]
        self._file.seek(place)
        # Written by this process, into a file that no other one can name.
        known = pickle.loads(zlib.decompress(self._file.read(size)))  # noqa: S301 - see above
        return JudgedEpisode.of(Episode(spec=spec, **known))


class EarlierEpisodes:
    """Episodes on the shelf that other sessions put there.

    Args:
        shelf: The shelf, if there is one.
    """

    def __init__(self, shelf: EpisodeCache | None) -> None:
        self._shelf = shelf
        self._index: dict[tuple[str, str], list[Mapping[str, str]]] | None = None
        self.origins: dict[EpisodeKey, str] = {}
        """The sessions that simulated what was taken over."""
        self.searched: dict[EpisodeKey, None] = {}
        """What searches used, in this order, as far as earlier sessions may have had it."""
        self.outdated: dict[EpisodeKey, tuple[str, ...]] = {}
        """What changed since an earlier session simulated these; they are simulated again. Nothing
        did where the earlier one was missing."""

    def counts(self, task: EpisodeTask, episode: Episode, entry: CacheEntry) -> bool:
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
        self.outdated[key_of(task)] = change = min(
            changes, key=lambda change: (len(change), change)
        )
        return change

    def origin(self, key: EpisodeKey) -> dict[str, Any]:
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

    def _indexed(self, shelf: EpisodeCache) -> Mapping[tuple[str, str], list[Mapping[str, str]]]:
        if self._index is None:
            self._index = defaultdict(list)
            for entry in shelf.entries():
                if entry.session != shelf.session:
                    self._index[entry.id, entry.component].append(entry.parts)
        return self._index


IN_FLIGHT = 2
"""Episodes per worker that are under way, so that none has to wait for the next one."""
MAX_WAIT = IN_FLIGHT * MAX_SECONDS
"""Seconds that an episode of another process is waited for, beside its component's time budgets;
then it is simulated here. The other process may have begun another one before it."""
_SECONDS_TO_SETTLE = 60.0
"""Seconds that the shelf is waited for to take in an episode; then nobody else has it."""
_FIRST_WAIT, _LONGEST_WAIT = 0.001, 0.05


class DescriptorsClosedError(DuraError):
    """Code of an episode closed the file descriptors of the process that runs the session.

    What the process writes from now on may end in another file, so that it cannot go on.
    """


@dataclass
class _Flight:
    """An episode that is being simulated for this process."""

    task: EpisodeTask
    address: Address
    claim: Claim | None
    future: Future[Any]
    changed: tuple[str, ...] | None = None
    kept: bool = False
    broken: DescriptorsClosedError | None = None
    settled: Event = field(default_factory=Event)
    """Set when it lies on the shelf, or never will."""


class EpisodeStore:
    """Episodes by what determines them.

    In the order in which they are looked for: those that this process has had, those on the shelf
    that it shares with others, and those that nobody has claimed. Of the latter, the ones that are
    wanted next are begun as well, as many as the execution works on. One that another process has
    claimed is waited for; meanwhile this process does what is wanted next and free.

    Args:
        shelf: Shared with other processes, if there are any.
        execution: Who simulates.
        memory: What this process keeps.
    """

    def __init__(
        self,
        shelf: EpisodeCache | None = None,
        execution: Execution | None = None,
        memory: EpisodeMemory | None = None,
    ) -> None:
        self.shelf = shelf
        self.execution = execution or Execution()
        self.memory = memory or EpisodeMemory()
        self.earlier = EarlierEpisodes(shelf)
        self.simulated = 0
        """Episodes that were simulated for this process."""
        self.problems: list[str] = []
        """Why episodes could not be shared; the first reason of each kind."""
        self.lost = False
        """Whether an episode could not be had since whoever was to simulate it was lost."""
        self.is_broken = False
        """Whether an episode closed what this process has open; see DescriptorsClosedError."""
        self._addresses = Addresses()
        self._flights: dict[str, _Flight] = {}

    def get(self, task: EpisodeTask, ahead: Iterable[EpisodeTask] = ()) -> JudgedEpisode:
        """An episode, simulated by whoever is the first to be asked for it.

        Args:
            task: What it is had by.
            ahead: What will be wanted next, in this order; it is looked at again and again.

        Raises:
            ConfigurationError: If a part of it cannot be built.
            DescriptorsClosedError: If its code closed what this process has open.
        """
        found = self.memory.find(task)
        if found is not None:
            return found
        alone = self.shelf is None and self.execution.inside
        address = None if alone else self._address(task)
        if address is None:
            episode, kept = JudgedEpisode.of(self.execution.run_here(task)), False
            self.simulated += 1
        else:
            episode, kept = self._had(task, address, ahead)
        self.memory.put(task, episode, elsewhere=kept)
        return episode

    def repeat(self, task: EpisodeTask) -> JudgedEpisode:
        """An episode simulated once more, to be compared with itself; it is kept nowhere.

        Args:
            task: What the first one was had by.

        Raises:
            ConfigurationError: If a part of it cannot be built.
        """
        task = replace(task.repeated(), recorded=False)
        address = None if self.execution.inside else self._address(task)
        try:
            result = self.execution.submit(task, address).result()
        except ProcessLostError as error:
            result = missing_episode(task.spec, str(error))
        return JudgedEpisode.of(unpack(result, task.spec) if isinstance(result, bytes) else result)

    def holds(self, task: EpisodeTask) -> bool:
        """Whether an episode need not be simulated: this process has it, or it is on the shelf."""
        if self.memory.find(task) is not None:
            return True
        address = None if self.shelf is None else self._address(task)
        return address is not None and self.shelf is not None and self.shelf.has(address)

    def cancel(self) -> None:
        """Give up what was begun ahead and nobody waits for: it is not wanted any more."""
        for flight in list(self._flights.values()):
            flight.future.cancel()  # one that runs already ends by itself, and is kept
        self._flights.clear()

    def close(self) -> None:
        """Nothing is wanted any more."""
        self.cancel()
        self.execution.close()

    def _had(
        self, task: EpisodeTask, address: Address, ahead: Iterable[EpisodeTask]
    ) -> tuple[JudgedEpisode, bool]:
        """The episode, and whether it lies on the shelf."""
        wait, end = _FIRST_WAIT, time.monotonic() + time_limit_of(task.spec, MAX_WAIT)
        while True:
            flight = self._flights.get(address.name)
            if flight is None:
                shelved = self._shelved(task, address)
                if shelved is not None:
                    return shelved, True
                flight = self._begun(task, address, wait=time.monotonic() < end)
            if flight is not None:
                self._begin_ahead(ahead)
                return self._landed(flight)
            # Another process is at it.
            if not self._begin_ahead(ahead, most=1):
                time.sleep(wait)
                wait = min(2 * wait, _LONGEST_WAIT)

    def _shelved(self, task: EpisodeTask, address: Address) -> JudgedEpisode | None:
        found = None if self.shelf is None else self.shelf.find(address, task.spec)
        if found is None or not self.earlier.counts(task, *found):
            return None
        return JudgedEpisode.of(found[0])

    def _begun(self, task: EpisodeTask, address: Address, *, wait: bool = True) -> _Flight | None:
        """The simulation of an episode, begun here.

        Args:
            task: What it is had by.
            address: Of the same.
            wait: Whether to return ``None`` if another process has it.
        """
        claim = None
        if self.shelf is not None:
            try:
                claim = self.shelf.claim(address)
            except OSError as error:
                self._note(error)
            else:
                if claim is None and wait:
                    return None
                if claim is not None and self._shelved(task, address) is not None:
                    # Another process was quicker.
                    claim.release()
                    return None
        try:
            future = self._submitted(task, address, 0 if claim is None else claim.attempts)
        except BaseException:  # also on ctrl-C others may have it; it is raised again
            if claim is not None:
                claim.release()
            raise
        changed = self.earlier.miss(task, address)
        flight = self._flights[address.name] = _Flight(task, address, claim, future, changed)
        future.add_done_callback(lambda _: self._keep(flight))
        return flight

    def _submitted(self, task: EpisodeTask, address: Address, attempts: int) -> Future[Any]:
        if attempts < MAX_ATTEMPTS:
            return self.execution.submit(task, address)
        future: Future[Any] = Future()
        future.set_exception(
            ProcessLostError(f"the episode ended {attempts} processes that simulated it")
        )
        return future

    def _begin_ahead(self, ahead: Iterable[EpisodeTask], most: int | None = None) -> bool:
        """Begin what is wanted next, as far as there is room for it; whether anything was.

        Args:
            ahead: What is wanted next.
            most: At most so many, also where this process simulates by itself.
        """
        room = IN_FLIGHT * self.execution.width - len(self._flights)
        if self.execution.inside:
            room = most or 0
        begun = 0
        for task in ahead if room > 0 else ():
            address = self._address(task)
            if address is None or not (self.execution.inside or task.portable):
                continue
            if address.name in self._flights or self.memory.find(task) is not None:
                continue
            if self.shelf is not None and self.shelf.has(address):
                continue
            flight = self._begun(task, address)
            if flight is None:
                continue
            if self.execution.inside:
                try:
                    episode, kept = self._landed(flight)
                except ConfigurationError:  # raised again if this episode is wanted after all
                    continue
                self.memory.put(task, episode, elsewhere=kept)
            begun += 1
            if begun >= room:
                break
        return begun > 0

    def _keep(self, flight: _Flight) -> None:
        """Put an episode on the shelf, if there is one, and let go of the claim."""
        try:
            if flight.claim is not None and not flight.claim.is_held:
                flight.broken = _descriptors_closed(flight.task)
            elif self.shelf is not None and not flight.future.cancelled():
                packed = _packed(flight)
                if packed is not None:
                    self.shelf.put(flight.address, flight.task.spec, packed, flight.changed)
                    flight.kept = True
        except Exception as problem:  # a disk may be full, an event no plain data: it is told
            self._note(problem)
        finally:
            try:
                if flight.claim is not None:
                    flight.claim.release()
            finally:  # whatever becomes of the claim, who waits goes on
                flight.settled.set()

    def _landed(self, flight: _Flight) -> tuple[JudgedEpisode, bool]:
        try:
            result = flight.future.result()
        except ProcessLostError as error:
            result = missing_episode(flight.task.spec, str(error))
        except CallFailedError:
            self.lost = True
            raise
        finally:
            self._flights.pop(flight.address.name, None)
        flight.settled.wait(_SECONDS_TO_SETTLE)
        if flight.broken is not None:
            self.is_broken = True
            raise flight.broken
        self.simulated += 1
        if isinstance(result, bytes):
            result = unpack(result, flight.task.spec)
        return JudgedEpisode.of(result), flight.kept

    def _address(self, task: EpisodeTask) -> Address | None:
        """Made once for a task, which is asked about again and again while it waits."""
        known = vars(task)
        if "address" not in known:
            known["address"] = self._addresses.of(task)
        address: Address | None = known["address"]
        return address

    def _note(self, problem: Exception) -> None:
        # Without the file's name: it is another one for each episode.
        why = problem.strerror if isinstance(problem, OSError) else None
        why = why or describe_error(problem)
        text = f"episodes cannot be shared with other processes, nor with a later session: {why}"
        if text not in self.problems:
            self.problems.append(text)


def _descriptors_closed(task: EpisodeTask) -> DescriptorsClosedError:
    return DescriptorsClosedError(
        f"infrastructure: file descriptors of the session's process were closed in {task.spec.id} "
        f"({task.spec.component}), so that it cannot go on; with --dura-executor=processes the "
        "episode loses a process of its own"
    )


def _packed(flight: _Flight) -> bytes | None:
    """What goes on the shelf; nothing if the episode cannot be simulated at all."""
    error = flight.future.exception()
    if isinstance(error, ProcessLostError):
        return pack(missing_episode(flight.task.spec, str(error)))
    if error is not None:
        return None
    result: Episode | bytes = flight.future.result()
    return result if isinstance(result, bytes) else pack(result)
