"""EpisodeStore: each episode once, from memory, from the shared cache, or simulated."""

from __future__ import annotations

import pickle
import tempfile
import time
import weakref
import zlib
from collections import OrderedDict, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field, fields, replace
from threading import Event
from typing import IO, Any

from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import ConfigurationError, DuraError, describe_error
from pytest_dura.execution.address import Address, address_of, reason_unaddressed
from pytest_dura.execution.cache import MAX_ATTEMPTS, CacheEntry, Claim, EpisodeCache
from pytest_dura.execution.codec import SERIES, pack, unpack
from pytest_dura.execution.executors import IN_FLIGHT, MAX_SECONDS, Execution, time_limit_of
from pytest_dura.execution.replies import CallFailedError, ProcessLostError
from pytest_dura.execution.sources import (
    EpisodeFiles,
    LoadedModules,
    SourceRules,
    changed_meanwhile,
    changed_sources,
    differences,
    shortened,
)
from pytest_dura.execution.task import EpisodeTask, lost_episode
from pytest_dura.requirements.episode_verdicts import JudgedEpisode
from pytest_dura.requirements.second_engine import SecondEngine

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
        episode = self._read(key, task.spec)
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

    def _read(self, key: EpisodeKey, spec: EpisodeSpec) -> JudgedEpisode:
        assert self._file is not None
        place, size = self._spilled[key]
        self._file.seek(place)
        # Written by this process, into a file that no other one can name.
        stored = pickle.loads(zlib.decompress(self._file.read(size)))  # noqa: S301 - see above
        state, verdicts = stored
        episode = JudgedEpisode.of(Episode(spec=spec, **state))
        episode.check_verdicts.update(verdicts)
        return episode


class EarlierEpisodes:
    """Episodes that other sessions put into the shared cache.

    Args:
        cache: The shared cache, if there is one.
        rules: Which files are sources of the session.
    """

    def __init__(self, cache: EpisodeCache | None, rules: SourceRules | None = None) -> None:
        self._cache, self._rules, self._files = cache, rules, EpisodeFiles(rules)
        self._changes: dict[str, tuple[str, ...]] = {}
        self._compared, self._meanwhile = 0, ""
        self._index: dict[tuple[str, str], list[CacheEntry]] | None = None
        self.origins: dict[EpisodeKey, str] = {}
        """Ids of the sessions that simulated the episodes taken over."""
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
        known = self._indexed(self._cache).get((task.spec.id, task.spec.component))
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
        }

    def search_used(self, task: EpisodeTask) -> None:
        """Note that a search, which leaves no record of its episodes, used one."""
        if self._cache is not None and self._cache.earlier:
            self.searched[key_of(task)] = None

    def _indexed(self, cache: EpisodeCache) -> Mapping[tuple[str, str], list[CacheEntry]]:
        if self._index is None:
            self._index = defaultdict(list)
            for entry in cache.entries():
                if entry.session != cache.session:
                    self._index[entry.id, entry.component].append(entry)
        return self._index


MAX_WAIT = IN_FLIGHT * MAX_SECONDS
"""Seconds to wait for an episode of another process, beside its component's time budgets; then it
is simulated here. The other process may have begun another one before it."""
_SECONDS_TO_PUT = 60.0
"""Seconds to wait until the cache has an episode; then it is this process's alone."""
_MAX_CERTAIN = 256
"""Episodes of later items that are under way, or wait to be taken, at most."""
_FIRST_WAIT, _LONGEST_WAIT = 0.001, 0.05


class DescriptorsClosedError(DuraError):
    """Error for an episode whose code closed the file descriptors of the session's process.

    What the process writes from then on may end in another file, so that it cannot go on.
    """


@dataclass
class _Flight:
    """An episode that is being simulated for this process."""

    task: EpisodeTask
    address: Address
    claim: Claim | None
    future: Future[Any]
    changed: tuple[str, ...] | None = None
    is_certain: bool = False
    """Whether a later item needs it, whatever becomes of the present campaign."""
    cached: bool = False
    broken: DescriptorsClosedError | None = None
    put: Event = field(default_factory=Event)
    """Set when the episode is in the cache, or never will be."""


class EpisodeStore:
    """Episodes by what determines them: from memory, from the shared cache, or simulated.

    An episode that no process has claimed is simulated, and with it the next ones, as many as the
    execution works on. One that another process has claimed is waited for; meanwhile this process
    simulates the next ones that are free.

    Args:
        cache: Shared with other processes, if there are any.
        execution: The executor; by default this process.
        memory: What this process keeps.
        second_engine: Evaluates the formulas of all its episodes as well.
        rules: Which files are sources of the session.
    """

    def __init__(
        self,
        cache: EpisodeCache | None = None,
        execution: Execution | None = None,
        memory: EpisodeMemory | None = None,
        second_engine: SecondEngine | None = None,
        rules: SourceRules | None = None,
    ) -> None:
        self.cache, self.second_engine = cache, second_engine
        self.execution = execution or Execution()
        self.memory = memory or EpisodeMemory()
        self.earlier = EarlierEpisodes(cache, rules)
        self.simulated = 0
        """Episodes that were simulated for this process."""
        self.problems: list[str] = []
        """Why episodes could not be shared; the first reason of each kind."""
        self.lost = False
        """Whether an episode is missing from the session since its executor was lost."""
        self.is_broken = False
        """Whether an episode closed files of this process; see :class:`DescriptorsClosedError`."""
        self._flights: dict[str, _Flight] = {}
        self._kept: set[str] = set()
        self._certain: Iterator[EpisodeTask] = iter(())
        self._has_plan = False
        self._repetitions: dict[EpisodeKey, Future[Any]] = {}

    def plan(self, tasks: Iterable[EpisodeTask]) -> None:
        """Begin these as well where the tasks ahead of an episode leave an executor idle.

        Args:
            tasks: Tasks that later items need in any case, in their order; iterated once.
        """
        self._certain, self._has_plan = iter(tasks), True

    @property
    def lacks_plan(self) -> bool:
        """Whether it would begin what later items need, if it knew that."""
        return not (self._has_plan or self.execution.inside)

    def get(self, task: EpisodeTask, ahead: Iterable[EpisodeTask] = ()) -> JudgedEpisode:
        """An episode, simulated unless it is in memory or in the cache.

        Args:
            task: Its task.
            ahead: Tasks of the next episodes, in their order; it is iterated again and again.

        Raises:
            ConfigurationError: If a part of it cannot be built.
            DescriptorsClosedError: If its code closed files of this process.
        """
        episode = self.memory.find(task)
        if episode is None:
            episode = self._new(task, ahead)
        else:
            self._begin_certain()
        episode.evaluate_also_by(self.second_engine)
        return episode

    def _new(self, task: EpisodeTask, ahead: Iterable[EpisodeTask]) -> JudgedEpisode:
        alone = self.cache is None and not self.execution.width_of(task)
        address = None if alone else self._address(task)
        if address is None:
            episode, cached = self.execution.run_here(task), False
            self.simulated += 1
        else:
            episode, cached = self._shared(task, address, ahead)
        self.memory.put(task, episode, elsewhere=cached)
        return episode

    def begin_repeats(self, tasks: Iterable[EpisodeTask]) -> None:
        """Begin what :meth:`repeat` will be called for, as far as other processes simulate it."""
        for task in map(_repetition, tasks):
            if task.portable and not (self.execution.inside or task.asks_model):
                self._repetitions[key_of(task)] = self._submit_repetition(task)

    def _submit_repetition(self, task: EpisodeTask) -> Future[Any]:
        return self.execution.submit(task)

    def repeat(self, task: EpisodeTask) -> JudgedEpisode:
        """An episode simulated once more, to be compared with itself; it is kept nowhere.

        Args:
            task: The task of the first one.

        Raises:
            ConfigurationError: If a part of it cannot be built.
        """
        task = _repetition(task)
        future = self._repetitions.pop(key_of(task), None) or self._submit_repetition(task)
        self._begin_certain()
        try:
            result = _shown_result(future)
        except ProcessLostError as error:
            result = lost_episode(task.spec, error)
        return unpack(result, task.spec) if isinstance(result, bytes) else result

    def holds(self, task: EpisodeTask) -> bool:
        """Whether an episode need not be simulated: it is in memory or in the cache."""
        if self.memory.find(task) is not None:
            return True
        if self.cache is None:
            return False
        address = self._address(task)
        return address is not None and self._is_kept(task, address)

    def _is_kept(self, task: EpisodeTask, address: Address) -> bool:
        """Whether there is an episode in the cache, whole or not, that counts in this session."""
        if address.name not in self._kept and self.cache is not None:
            entry = self.cache.entry(address)
            if entry is not None and self.earlier.may_count(task, entry):
                self._kept.add(address.name)  # what lies ahead is looked at again and again
        return address.name in self._kept

    def cancel(self) -> None:
        """Give up the episodes that were begun ahead, apart from what later items need."""
        for name, flight in list(self._flights.items()):
            if not flight.is_certain:
                flight.future.cancel()  # one that runs already ends by itself, and is kept
                del self._flights[name]

    def close(self) -> None:
        """Give up the episodes that were begun ahead, and end the executor."""
        self._give_up()
        self.execution.close()

    def _shared(
        self, task: EpisodeTask, address: Address, ahead: Iterable[EpisodeTask]
    ) -> tuple[JudgedEpisode, bool]:
        """The episode, and whether it is in the cache."""
        wait, end = _FIRST_WAIT, time.monotonic() + time_limit_of(task.spec, MAX_WAIT)
        while True:
            flight = self._flights.get(address.name)
            if flight is None:
                cached = self._cached(task, address)
                if cached is not None:
                    return cached, True
                flight = self._begin(task, address, wait=time.monotonic() < end)
            if flight is not None:
                self._begin_ahead(ahead)
                self._begin_certain()
                return self._land(flight)
            # Another process has claimed it.
            if not self._begin_ahead(ahead, most=1):
                time.sleep(wait)
                wait = min(2 * wait, _LONGEST_WAIT)

    def _cached(self, task: EpisodeTask, address: Address) -> JudgedEpisode | None:
        hit = None if self.cache is None else self.cache.find(address, task.spec)
        if self.cache is None or hit is None or not self.earlier.counts(task, *hit):
            return None
        episode, entry = hit
        if entry.session != self.cache.session:
            # Code that checks may have changed since then: it is judged again, in this process.
            episode.check_verdicts.clear()
        return episode

    def _begin(self, task: EpisodeTask, address: Address, *, wait: bool = True) -> _Flight | None:
        """Begin to simulate an episode.

        Args:
            task: Its task.
            address: Its address.
            wait: Whether to return ``None`` if another process has claimed it.
        """
        claim = None
        if self.cache is not None:
            try:
                claim = self.cache.claim(address)
            except OSError as error:
                self._note(error)
            else:
                if claim is None and wait:
                    return None
                if claim is not None and self._cached(task, address) is not None:
                    # Another process was quicker.
                    claim.release()
                    return None
        try:
            future = self._submit(task, 0 if claim is None else claim.attempts)
        except BaseException:  # also on ctrl-C others may claim it; it is raised again
            if claim is not None:
                claim.release()
            raise
        changed = self.earlier.miss(task, address)
        flight = self._flights[address.name] = _Flight(task, address, claim, future, changed)
        future.add_done_callback(lambda _: self._put(flight))
        return flight

    def _submit(self, task: EpisodeTask, attempts: int) -> Future[Any]:
        if attempts < MAX_ATTEMPTS:
            return self.execution.submit(task)
        future: Future[Any] = Future()
        future.set_exception(
            ProcessLostError(f"the episode ended {attempts} processes that simulated it")
        )
        return future

    def _begin_certain(self) -> None:
        """Begin what later items need, as long as an executor has room for it."""
        if self.execution.inside:
            return
        flights = self._flights.values()
        room = IN_FLIGHT * self.execution.width - sum(not each.future.done() for each in flights)
        room = min(room, _MAX_CERTAIN - sum(each.is_certain for each in flights))
        while room > 0 and (task := next(self._certain, None)) is not None:
            # A language model is asked where its answers are counted, and when they are needed.
            address = self._address(task) if task.portable and not task.asks_model else None
            if address is None or self.memory.holds(task):
                continue
            flight = self._flights.get(address.name)
            if flight is None and not self._is_kept(task, address):
                flight = self._begin(task, address)
                room -= 1
            if flight is not None:
                flight.is_certain = True

    def _give_up(self) -> None:
        """Give up all episodes that were begun ahead."""
        for flight in self._flights.values():
            flight.is_certain = False
        self._certain = iter(())
        self.cancel()

    def _begin_ahead(self, ahead: Iterable[EpisodeTask], most: int | None = None) -> bool:
        """Begin the next episodes, as far as there is room for them; returns whether any began.

        Args:
            ahead: Their tasks.
            most: How many this process may simulate by itself.
        """
        begun = here = 0
        for task in ahead:
            width = self.execution.width_of(task)
            if not width and not self.execution.inside:
                continue
            room = IN_FLIGHT * width - self._begun_ahead() if width else (most or 0) - here
            if room <= 0:
                break
            address = self._address(task)
            if address is None:
                continue
            if address.name in self._flights or self.memory.find(task) is not None:
                continue
            if self._is_kept(task, address):
                continue
            flight = self._begin(task, address)
            if flight is None:
                continue
            if not width:
                try:
                    episode, cached = self._land(flight)
                except ConfigurationError:  # raised again if this episode is needed after all
                    continue
                self.memory.put(task, episode, elsewhere=cached)
                here += 1
            begun += 1
        return begun > 0

    def _begun_ahead(self) -> int:
        """How many episodes are under way that only the present campaign may need."""
        return sum(not each.is_certain for each in self._flights.values())

    def _put(self, flight: _Flight) -> None:
        """Put an episode into the cache, if there is one, and release the claim."""
        try:
            if flight.claim is not None and not flight.claim.is_held:
                flight.broken = _descriptors_closed(flight.task)
            elif meanwhile := self.earlier.changed_meanwhile(self.execution.modules):
                self._note_text(f"episodes are not kept: {meanwhile} changed as the session ran")
            elif self.cache is not None and not flight.future.cancelled():
                packed = _packed(flight)
                if packed is not None:
                    files = self.earlier.files_of(flight.task)
                    self.cache.put(flight.address, flight.task.spec, packed, files, flight.changed)
                    flight.cached = True
        except Exception as problem:  # a disk may be full, an event no plain data
            self._note(problem)
        finally:
            try:
                if flight.claim is not None:
                    flight.claim.release()
            finally:  # whatever becomes of the claim, `_land` goes on
                flight.put.set()

    def _land(self, flight: _Flight) -> tuple[JudgedEpisode, bool]:
        """Wait for an episode; returns it, and whether it is in the cache."""
        try:
            result = _shown_result(flight.future)
        except ProcessLostError as error:
            result = lost_episode(flight.task.spec, error)
        except CallFailedError:
            self.lost = True
            raise
        finally:
            self._flights.pop(flight.address.name, None)
        flight.put.wait(_SECONDS_TO_PUT)
        if flight.broken is not None:
            self.is_broken = True
            raise flight.broken
        self.simulated += 1
        if isinstance(result, bytes):
            result = unpack(result, flight.task.spec)
        return result, flight.cached

    def _address(self, task: EpisodeTask) -> Address | None:
        """The address of a task, made once: `get` looks at it again and again while it waits."""
        known = vars(task)
        if "address" not in known:
            known["address"] = address_of(task)
            if known["address"] is None:
                self._note_unkept(task)
        address: Address | None = known["address"]
        return address

    def _note_unkept(self, task: EpisodeTask) -> None:
        component, reason = task.spec.component, reason_unaddressed(task)
        self._note_text(f"episodes of {component} are not kept for --dura-resume: {reason}")

    def _note(self, problem: Exception) -> None:
        # Without the file's name: it is another one for each episode.
        reason = problem.strerror if isinstance(problem, OSError) else None
        reason = reason or describe_error(problem)
        what = "episodes cannot be shared with other processes, nor with a later session"
        self._note_text(f"{what}: {reason}")

    def _note_text(self, text: str) -> None:
        if self.cache is not None and text not in self.problems:
            self.problems.append(text)


def _shown_result(future: Future[Any]) -> Any:
    """The result of an episode, after what it printed elsewhere was shown here."""
    try:
        return future.result()
    finally:
        captured = vars(future).get("captured")
        if captured is not None:
            captured.show()


def _repetition(task: EpisodeTask) -> EpisodeTask:
    return replace(task.repeated(), recorded=False)


def _descriptors_closed(task: EpisodeTask) -> DescriptorsClosedError:
    return DescriptorsClosedError(
        f"infrastructure: file descriptors of the session's process were closed in {task.spec.id} "
        f"({task.spec.component}), so that it cannot go on; with --dura-executor=processes the "
        "episode loses a process of its own"
    )


def _packed(flight: _Flight) -> bytes | None:
    """The bytes for the cache; ``None`` if the episode cannot be simulated at all."""
    error = flight.future.exception()
    if isinstance(error, ProcessLostError):
        return pack(lost_episode(flight.task.spec, error))
    if error is not None:
        return None
    result: JudgedEpisode | bytes = flight.future.result()
    return result if isinstance(result, bytes) else pack(result)
