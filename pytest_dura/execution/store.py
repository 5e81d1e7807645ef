"""EpisodeStore: each episode once, from memory, from the session's directory, or simulated."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from logging import getLogger
from threading import Event
from typing import Any

from pytest_dura.core.errors import describe_error
from pytest_dura.execution.address import Address, address_of, reason_unaddressed
from pytest_dura.execution.cache import EpisodeCache
from pytest_dura.execution.codec import pack, unpack
from pytest_dura.execution.earlier import EarlierEpisodes
from pytest_dura.execution.executors import IN_FLIGHT, Execution
from pytest_dura.execution.memory import EpisodeKey, EpisodeMemory, key_of
from pytest_dura.execution.replies import CallFailedError, ProcessLostError
from pytest_dura.execution.sources import SourceRules
from pytest_dura.execution.task import EpisodeTask, lost_episode
from pytest_dura.requirements.episode_verdicts import JudgedEpisode
from pytest_dura.requirements.second_engine import SecondEngine

_LOG = getLogger(__name__)
_SECONDS_TO_PUT = 60.0
"""Seconds to wait until the cache has an episode; then it is this process's alone."""
_MAX_CERTAIN = 256
"""Episodes of later items that are under way, or wait to be taken, at most."""


@dataclass
class _Flight:
    """An episode that is being simulated."""

    task: EpisodeTask
    address: Address
    future: Future[Any]
    changed: tuple[str, ...] | None = None
    is_certain: bool = False
    """Whether a later item needs it, whatever becomes of the present campaign."""
    is_beside_others: bool = False
    """Whether another episode was under way as well, at the cost of the wall clock of this one."""
    cached: bool = False
    put: Event = field(default_factory=Event)
    """Set when the episode is in the cache, or never will be."""


class EpisodeStore:
    """Episodes by what determines them: from memory, from the cache, or simulated.

    With an episode that is simulated the next ones are begun, as many as the execution works on.

    Args:
        cache: Keeps them for a later session, if there is one.
        execution: The executor; by default this process.
        memory: What this process keeps.
        second_engine: Evaluates the formulas of all its episodes as well.
        rules: Which files are sources of the session.
        repeatable: Whether equal specs give equal episodes, as far as the session declares.
    """

    def __init__(
        self,
        cache: EpisodeCache | None = None,
        execution: Execution | None = None,
        memory: EpisodeMemory | None = None,
        second_engine: SecondEngine | None = None,
        rules: SourceRules | None = None,
        *,
        repeatable: bool = True,
    ) -> None:
        self.repeatable = repeatable
        self.cache, self.second_engine = cache, second_engine
        self.execution = execution or Execution()
        self.memory = memory or EpisodeMemory()
        self.earlier = EarlierEpisodes(cache, rules)
        self.simulated = 0
        """Episodes that were simulated for this process."""
        self.problems: list[str] = []
        """Why episodes could not be kept; the first reason of each kind."""
        self.lost = False
        """Whether an episode is missing from the session since its executor was lost."""
        self._flights: dict[str, _Flight] = {}
        self._kept: set[str] = set()
        self._asked: set[EpisodeKey] = set()
        """Runs whose twins without recovery are simulated."""
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
        """
        episode = self.memory.find(task) or self._unaided(task)
        if episode is None:
            episode = self._new(task, ahead)
        else:
            self._begin_certain()
        episode.evaluate_also_by(self.second_engine)
        return episode

    def _unaided(self, task: EpisodeTask) -> JudgedEpisode | None:
        """An episode without recovery that is known, since recovery was not asked in its run."""
        aided = task.with_recovery
        if aided is None or not self.repeatable or key_of(aided) in self._asked:
            return None
        first = self.memory.find(aided)
        if first is None:
            return None
        episode = task.unaided(first)
        if episode is None:
            self._asked.add(key_of(aided))
        else:
            self.earlier.same_run(task, aided)
            self.memory.put(task, episode, elsewhere=False)
        return episode

    def _new(self, task: EpisodeTask, ahead: Iterable[EpisodeTask]) -> JudgedEpisode:
        """An episode that is not in memory, from the cache or simulated."""
        alone = self.cache is None and not self.execution.width_of(task)
        address = None if alone else self._address(task)
        if address is None:
            episode, cached = self._landed(task, self.execution.submit(task)), False
            self.simulated += 1
        else:
            flight = self._flights.get(address.name)
            known = self._cached(task, address) if flight is None else None
            if known is not None:
                episode, cached = known, True
            else:
                flight = flight or self._begin(task, address)
                self._begin_ahead(ahead)
                self._begin_certain()
                episode, cached = self._land(flight)
        self.memory.put(task, episode, elsewhere=cached)
        return episode

    def begin_repeats(self, tasks: Iterable[EpisodeTask]) -> None:
        """Begin what :meth:`repeat` will be called for, as far as other processes simulate it."""
        for task in map(_repetition, tasks):
            if not (self.execution.inside or task.stays) and self.execution.width_of(task):
                self._repetitions[key_of(task)] = self.execution.submit(task)

    def repeat(self, task: EpisodeTask) -> JudgedEpisode:
        """An episode simulated once more, to be compared with itself; it is kept nowhere.

        Args:
            task: The task of the first one.

        Raises:
            ConfigurationError: If a part of it cannot be built.
        """
        task = _repetition(task)
        future = self._repetitions.pop(key_of(task), None) or self.execution.submit(task)
        self._begin_certain()
        return self._landed(task, future)

    def _landed(self, task: EpisodeTask, future: Future[Any]) -> JudgedEpisode:
        """Wait for an episode; one whose process ended is all that is known of it."""
        try:
            result = self.execution.result_of(task, future)
        except ProcessLostError as error:
            return lost_episode(task.spec, error)
        except CallFailedError:
            self.lost = True
            raise
        return unpack(result, task.spec) if isinstance(result, bytes) else result

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

    @contextmanager
    def steady(self) -> Iterator[None]:
        """Context of a campaign or a search; in the end, what was begun ahead is given up."""
        with self.execution.steady():
            try:
                yield
            finally:
                self.cancel()

    def _cached(self, task: EpisodeTask, address: Address) -> JudgedEpisode | None:
        hit = None if self.cache is None else self.cache.find(address, task.spec)
        if self.cache is None or hit is None or not self.earlier.counts(task, *hit):
            return None
        episode, entry = hit
        if entry.session != self.cache.session:
            # Code that checks may have changed since then: it is judged again, in this process.
            episode.check_verdicts.clear()
        return episode

    def _begin(self, task: EpisodeTask, address: Address) -> _Flight:
        """Begin to simulate an episode."""
        others = [each for each in self._flights.values() if not each.future.done()]
        future = self.execution.submit(task)
        changed = self.earlier.miss(task, address)
        flight = self._flights[address.name] = _Flight(task, address, future, changed)
        for each in (flight, *others) if others else ():
            each.is_beside_others = True
        future.add_done_callback(lambda _: self._put(flight))
        return flight

    def _begin_certain(self) -> None:
        """Begin what later items need, as long as an executor has room for it."""
        if self.execution.inside or self.execution.in_test:
            return
        flights = self._flights.values()
        room = IN_FLIGHT * self.execution.width - sum(not each.future.done() for each in flights)
        room = min(room, _MAX_CERTAIN - sum(each.is_certain for each in flights))
        while room > 0 and (task := next(self._certain, None)) is not None:
            # What stays in this process is asked for when it is needed.
            address = None if task.stays else self._address(task)
            if address is None or self._is_known(task):
                continue
            flight = self._flights.get(address.name)
            if flight is None and not self._is_kept(task, address):
                flight = self._begin(task, address)
                room -= 1
            if flight is not None:
                flight.is_certain = True

    def _begin_ahead(self, ahead: Iterable[EpisodeTask]) -> None:
        """Begin the next episodes, as far as an executor has room for them."""
        for task in ahead:
            width = self.execution.width_of(task)
            if not width and not self.execution.inside:
                continue
            # Only the present campaign may need those that are not certain.
            begun = sum(not each.is_certain for each in self._flights.values())
            if begun >= self.execution.most_of(task):
                break
            address = self._address(task)
            if address is None or address.name in self._flights or self._is_known(task):
                continue
            if not self._is_kept(task, address):
                self._begin(task, address)

    def _is_known(self, task: EpisodeTask) -> bool:
        """Whether it is in memory, or may turn out to be once its run with recovery is over."""
        if self.memory.holds(task) or self._unaided(task) is not None:
            return True
        first = task.with_recovery
        address = self._address(first) if first is not None and self.repeatable else None
        return address is not None and address.name in self._flights

    def _put(self, flight: _Flight) -> None:
        """Put an episode into the cache, if there is one."""
        try:
            if meanwhile := self.earlier.changed_meanwhile(self.execution.modules):
                self._note_text(f"episodes are not kept: {meanwhile} changed as the session ran")
            elif self.cache is not None and not flight.future.cancelled():
                packed = _packed(flight)
                if packed is not None:
                    files = self.earlier.files_of(flight.task)
                    self.cache.put(flight.address, flight.task.spec, packed, files, flight.changed)
                    flight.cached = True
        except Exception as problem:  # a disk may be full, an event no plain data
            # Without the file's name: it is another one for each episode.
            reason = problem.strerror if isinstance(problem, OSError) else None
            reason = reason or describe_error(problem)
            self._note_text(f"episodes are not kept for --dura-resume: {reason}")
        finally:
            flight.put.set()

    def _land(self, flight: _Flight) -> tuple[JudgedEpisode, bool]:
        """Wait for an episode; returns it, and whether it is in the cache.

        One that overran its time budget beside others is simulated again once nothing else is under
        way, which counts instead: the wall clock was that of a machine that simulated others, too.
        """
        try:
            episode = self._landed(flight.task, flight.future)
        finally:
            self._flights.pop(flight.address.name, None)
        flight.put.wait(_SECONDS_TO_PUT)
        self.simulated += 1
        if not (episode.timeouts and flight.is_beside_others and not flight.task.stays):
            return episode, flight.cached
        wait([each.future for each in self._flights.values()])
        _LOG.warning(
            "%s overran its time budget beside others: repeated alone", flight.task.spec.id
        )
        episode = self._landed(flight.task, self.execution.submit(flight.task))
        if self.cache is not None and flight.cached:
            files = self.earlier.files_of(flight.task)
            spec, packed = flight.task.spec, pack(episode)
            self.cache.put(flight.address, spec, packed, files, flight.changed)
        return episode, flight.cached

    def _address(self, task: EpisodeTask) -> Address | None:
        """The address of a task, made once: what lies ahead is looked at again and again."""
        known = vars(task)
        if "address" not in known:
            known["address"] = address_of(task)
            if known["address"] is None:
                whose, reason = task.spec.component, reason_unaddressed(task)
                self._note_text(f"episodes of {whose} are not kept for --dura-resume: {reason}")
        address: Address | None = known["address"]
        return address

    def _note_text(self, text: str) -> None:
        if self.cache is not None and text not in self.problems:
            self.problems.append(text)


def _repetition(task: EpisodeTask) -> EpisodeTask:
    return replace(task.repeated(), recorded=False)


def _packed(flight: _Flight) -> bytes | None:
    """The bytes for the cache; ``None`` if the episode cannot be simulated at all."""
    error = flight.future.exception()
    if isinstance(error, ProcessLostError):
        return pack(lost_episode(flight.task.spec, error))
    if error is not None:
        return None
    result: JudgedEpisode | bytes = flight.future.result()
    return result if isinstance(result, bytes) else pack(result)
