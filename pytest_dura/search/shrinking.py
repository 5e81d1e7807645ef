"""Shrink a counterexample with Hypothesis to the simplest one that still violates."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass, field
from functools import cache
from queue import SimpleQueue
from threading import Event, Thread
from typing import Any

from pytest_dura.campaign.falsification import ParameterChange, Shrinking
from pytest_dura.core.episode import canonical
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.library.cases import Case, SearchedCase, make_searched_case
from pytest_dura.search.differences import Nominal, changes_of, count_parameters
from pytest_dura.search.simplification import Simplification

Places = tuple[int, ...]

_PATIENCE = 100.0
"""Seconds after which a pass is begun again; Hypothesis itself gives up after 300."""


class _InterestingExample(Exception):  # noqa: N818 - no error: how Hypothesis is told that an example counts
    """The example is one of those that we look for."""


def minimise(start: Places, interesting: Callable[[Places], bool], seed: int) -> Places:
    """The least numbers, the first ones before the last ones, that Hypothesis comes to.

    None of them can be 0 or one less, all others being equal.

    Args:
        start: Where it starts, which is taken to be interesting; no number grows past it.
        interesting: Whether numbers count, asked at most once for each list of them. What it raises
            is raised here.
        seed: Of the order in which things are tried.
    """
    known = {start: True}

    def once(places: Places) -> bool:
        if places not in known:
            known[places] = interesting(places)
        return known[places]

    while True:
        asked = _Pass(start, once, known)
        shrunk = _shrunk(start, asked, seed)
        if asked.error is not None:
            raise asked.error
        if not asked.ended:
            # Hypothesis stops trying after a while, and so may have left something out.
            better = next((neighbour for neighbour in _neighbours(shrunk) if once(neighbour)), None)
            if better is None:
                return shrunk
            start = better


def _neighbours(places: Places) -> Iterator[Places]:
    for i, place in enumerate(places):
        for less in sorted({0, place - 1}) if place else ():
            yield (*places[:i], less, *places[i + 1 :])


class _Pass:
    """What Hypothesis asks in one pass. A pass that takes long ends by interest in nothing new.

    The next pass is the same one up to there, and takes no time for what is known by then. So what
    comes of it does not depend on how fast the machine is.
    """

    def __init__(
        self, start: Places, once: Callable[[Places], bool], known: Mapping[Places, bool]
    ) -> None:
        self._once, self._known, self._least = once, known, start
        self._end, self._before = time.monotonic() + _PATIENCE, len(known)
        self.error: BaseException | None = None

    @property
    def ended(self) -> bool:
        """Whether it was ended before everything was tried."""
        return len(self._known) > self._before and time.monotonic() > self._end

    def __call__(self, places: Places) -> bool:
        # Hypothesis also lets a number grow where an earlier one falls: seldom of use here.
        if any(place > least for place, least in zip(places, self._least, strict=True)):
            return False
        if places not in self._known and (self.error is not None or self.ended):
            return False
        try:
            once = self._once(places)
        except BaseException as error:  # Hypothesis would shrink it; it is raised after the pass.
            self.error = error
            return False
        if once:
            self._least = places
        return once


class _Worker:
    """A thread in which passes run, one after the other.

    Hypothesis searches the whole process for garbage when it comes to a new thread: so one is kept.
    """

    def __init__(self) -> None:
        self._passes: SimpleQueue[Callable[[], None]] = SimpleQueue()
        Thread(target=self._work, name="shrinking", daemon=True).start()

    def start(self, item: Callable[[], None]) -> None:
        """Begin a pass, which raises nothing."""
        self._passes.put(item)

    def _work(self) -> None:
        while True:
            self._passes.get()()


_SPARE_WORKERS: list[_Worker] = []
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        after_in_child=_SPARE_WORKERS.clear
    )  # a copy of the process has no such thread


def _shrunk(start: Places, asked: _Pass, seed: int) -> Places:
    """Where one pass of Hypothesis ends.

    It has a thread of its own, where it is in no test of ``@given``; it is answered in this one.
    """
    questions: SimpleQueue[Places | None] = SimpleQueue()
    answers: SimpleQueue[bool] = SimpleQueue()
    end: Future[Places] = Future()

    over = Event()

    def ask(places: Places) -> bool:
        if over.is_set():
            return False
        questions.put(places)
        return answers.get()

    def work() -> None:
        try:
            end.set_result(_pass(start, ask, seed))
        except BaseException as error:
            end.set_exception(error)
        finally:
            questions.put(None)

    try:
        worker = _SPARE_WORKERS.pop()
    except IndexError:
        worker = _Worker()
    worker.start(work)
    try:
        while (places := questions.get()) is not None:
            answers.put(asked(places))
    finally:
        # An interrupt leaves it without an answer.
        over.set()
        answers.put(False)
        wait([end])
        _SPARE_WORKERS.append(worker)
    return end.result()


def _pass(start: Places, interesting: Callable[[Places], bool], seed: int) -> Places:
    import hypothesis
    from hypothesis import HealthCheck, Phase, Verbosity, given, settings

    last: list[Places] = []

    # Not hypothesis.find: it takes either a database or a seed, and both are needed here.
    @settings(
        database=_starting_at(start),
        phases=[Phase.reuse, Phase.shrink],
        max_examples=2,
        derandomize=False,
        deadline=None,
        verbosity=Verbosity.quiet,
        print_blob=False,
        report_multiple_bugs=False,
        suppress_health_check=list(HealthCheck),
        backend="hypothesis",
    )
    @hypothesis.seed(seed)
    @given(_strategy(start))
    def look(nested: Any) -> None:
        places = tuple(_flat(nested))
        if interesting(places):
            last[:] = [places]
            raise _InterestingExample

    # As hypothesis.find does. Without it, no database is used under `--hypothesis-seed`.
    look._hypothesis_internal_database_key = b"start"  # noqa: SLF001 - as find does
    try:
        look()
    except _InterestingExample:
        return last[0]
    raise AssertionError(f"Hypothesis did not start at {start}")


@cache
def _database_class() -> Any:
    from hypothesis.database import ExampleDatabase

    class StartingPoint(ExampleDatabase):
        """A database of one example, whatever is asked for; it learns nothing."""

        def __init__(self, example: bytes) -> None:
            super().__init__()
            self.example = example

        def fetch(self, key: bytes) -> Any:
            del key
            return [self.example]

        def save(self, key: bytes, value: bytes) -> None:
            """Nothing is kept."""

        def delete(self, key: bytes, value: bytes) -> None:
            """Nothing is kept."""

    return StartingPoint


def _starting_at(start: Places) -> Any:
    from hypothesis.database import choices_to_bytes

    # With a number too many: what is stored as it was found is taken for shrunk already.
    return _database_class()(choices_to_bytes((*start, 0)))


def _strategy(start: Sequence[int]) -> Any:
    """One number for each, in pairs of pairs: Hypothesis tries halves at once."""
    from hypothesis import strategies

    if len(start) == 1:
        return strategies.integers(0, start[0])
    half = (len(start) + 1) // 2
    return strategies.tuples(_strategy(start[:half]), _strategy(start[half:]))


def _flat(nested: Any) -> list[int]:
    return (
        [item for each in nested for item in _flat(each)] if isinstance(nested, tuple) else [nested]
    )


Violates = Callable[[SearchedCase], bool]


@dataclass(frozen=True)
class Shrunk:
    """What shrinking came to.

    Args:
        case: The simplest violating case that was seen.
        changes: Its parameters that are not as the case has them.
        before: Parameters of what was found that were not as the case has them, with what its seed
            drew written out; see :func:`count_parameters`.
        after: Those that still are not.
        simulations: Calls of ``violates``.
        budget: Calls that were allowed.
        finished: Whether nothing simpler was left to try; not so when the budget ended before.
    """

    case: SearchedCase
    changes: tuple[ParameterChange, ...]
    before: int
    after: int
    simulations: int
    budget: int
    finished: bool

    @property
    def shrinking(self) -> Shrinking:
        """The counts, as they are reported."""
        return Shrinking(self.before, self.after, self.simulations, self.budget, self.finished)


def shrink(
    case: Case,
    found: SearchedCase,
    violates: Violates,
    *,
    budget: int,
    seed: int = 0,
    simulator: RoleSpec | None = None,
) -> Shrunk:
    """Make a counterexample as simple as a budget of simulations allows.

    Preferred are, in this order: fewer faults, fewer entries of lists (vehicles, pedestrians),
    fewer optional parts, later and shorter activation, smaller magnitudes, rounder numbers. What
    the seed draws is written out first where the domain can do that, so that single drawn vehicles
    can be left out.

    Args:
        case: The case whose values are the simplest.
        found: The counterexample; it is taken to violate.
        violates: Simulates a case; equal cases must have equal answers. A ``ConfigurationError``
            means that the case contradicts itself: it does not violate, and costs nothing.
        budget: Calls of ``violates``.
        seed: Of Hypothesis' own draws.
        simulator: In place of the scenario's.

    Raises:
        ConfigurationError: If ``found`` does not belong to ``case``.
    """
    nominal = Nominal.of(case, simulator)
    trials = _ViolationCache(violates, budget)
    trials.known[_key(found)] = True
    current = _concrete(nominal, found)
    if not trials(current):
        current = found
    before = count_parameters(changes_of(case, current, simulator=simulator))
    # From what is simpler other values come into reach: again, until nothing new comes of it.
    seen: set[bytes] = set()
    while _key(current) not in seen:
        seen.add(_key(current))
        current = _simplest(Simplification(nominal, current), trials, seed)
    changes = changes_of(case, current, simulator=simulator)
    return Shrunk(
        current,
        changes,
        before,
        count_parameters(changes),
        trials.simulations,
        budget,
        finished=not trials.refused,
    )


@dataclass
class _ViolationCache:
    """Which cases violate; each is simulated once, and none when the budget is used up."""

    violates: Violates
    budget: int
    simulations: int = 0
    refused: bool = False
    known: dict[bytes, bool] = field(default_factory=dict)

    def __call__(self, searched: SearchedCase) -> bool:
        key = _key(searched)
        if key in self.known:
            return self.known[key]
        if self.simulations >= self.budget:
            self.refused = True
            return False
        try:
            violates = self.violates(searched)
        except ConfigurationError:
            self.known[key] = False
            return False
        self.simulations += 1
        self.known[key] = violates
        return violates


def _key(searched: SearchedCase) -> bytes:
    return canonical(searched.data)


def _concrete(nominal: Nominal, case: SearchedCase) -> SearchedCase:
    """The same case with what its seed draws in the world written out."""
    world, seed = nominal.checked(case.scenario.world), case.scenario.seed or 0
    concrete = nominal.checked(nominal.concrete(world, seed))
    if concrete == world:
        return case
    return make_searched_case(nominal.case, concrete, case.faults, seed)


def _simplest(start: Simplification, trials: _ViolationCache, seed: int) -> SearchedCase:
    """The simplest violating case that Hypothesis comes to; the found one if there is none."""
    last = tuple(len(knob.values) - 1 for knob in start.knobs)
    if not last:
        return start.found

    def interesting(places: tuple[int, ...]) -> bool:
        if places == last:
            return True
        try:
            return trials(start.made(places))
        except ConfigurationError:
            return False

    places = minimise(last, interesting, seed)
    return start.found if places == last else start.made(places)
