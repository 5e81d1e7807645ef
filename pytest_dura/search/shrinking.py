"""Shrink a counterexample with Hypothesis to the simplest one that still violates."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from queue import SimpleQueue
from threading import Event
from typing import Any

from pytest_dura.campaign.falsification import ParameterChange, Shrinking
from pytest_dura.core.episode import canonical
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.library.cases import Case, SearchedCase, make_searched_case
from pytest_dura.search.simplification import (
    Nominal,
    Simplification,
    changes_of,
    count_parameters,
)

Places = tuple[int, ...]

_PASS_SECONDS = 100.0
"""After so long a pass is begun again; Hypothesis itself gives up after 300 s."""
_KEY = b"start"
"""Key of the only example in a database."""


class _InterestingExample(Exception):  # noqa: N818 - no error: how Hypothesis learns that an example counts
    """The example is interesting."""


def minimise(start: Places, interesting: Callable[[Places], bool], seed: int) -> Places:
    """Find the least interesting numbers that Hypothesis comes to, earlier numbers weighing more.

    Of the result no number can be 0 or one less, all others being equal.

    Args:
        start: Interesting numbers; none of them grows.
        interesting: Whether numbers are interesting, called at most once for each tuple. What it
            raises is raised here.
        seed: Of the order in which things are tried.
    """
    known = {start: True}

    def is_interesting(places: Places) -> bool:
        if places not in known:
            known[places] = interesting(places)
        return known[places]

    # The caller may be in a test of `@given`, and Hypothesis allows one test in each thread.
    with ThreadPoolExecutor(1, "shrinking") as thread:
        while True:
            oracle = _Oracle(start, is_interesting, known)
            shrunk = _run_pass(thread, start, oracle, seed)
            if oracle.error is not None:
                raise oracle.error
            if not oracle.timed_out:
                # Hypothesis stops trying after a while, and so may have left something out.
                simpler = next(filter(is_interesting, _neighbours(shrunk)), None)
                if simpler is None:
                    return shrunk
                start = simpler


def _neighbours(places: Places) -> Iterator[Places]:
    for i, place in enumerate(places):
        for less in sorted({0, place - 1}) if place else ():
            yield (*places[:i], less, *places[i + 1 :])


class _Oracle:
    """Answers what Hypothesis asks in a pass; a pass that takes long finds nothing new interesting.

    The next pass is the same one up to there, and takes no time for what is known by then. So the
    result does not depend on how fast the machine is.
    """

    def __init__(
        self, start: Places, interesting: Callable[[Places], bool], known: Mapping[Places, bool]
    ) -> None:
        self._interesting, self._known, self._least = interesting, known, start
        self._end, self._known_before = time.monotonic() + _PASS_SECONDS, len(known)
        self.error: BaseException | None = None

    @property
    def timed_out(self) -> bool:
        """Whether the pass took too long, and learnt something."""
        return len(self._known) > self._known_before and time.monotonic() > self._end

    def __call__(self, places: Places) -> bool:
        # Hypothesis also lets a number grow where an earlier one falls: seldom of use here.
        if any(place > least for place, least in zip(places, self._least, strict=True)):
            return False
        if places not in self._known and (self.error is not None or self.timed_out):
            return False
        try:
            interesting = self._interesting(places)
        except BaseException as error:  # Hypothesis would shrink it; it is raised after the pass.
            self.error = error
            return False
        if interesting:
            self._least = places
        return interesting


def _run_pass(thread: ThreadPoolExecutor, start: Places, oracle: _Oracle, seed: int) -> Places:
    """Run one pass of Hypothesis in a thread; its questions are answered in this thread."""
    questions: SimpleQueue[Places | None] = SimpleQueue()
    answers: SimpleQueue[bool] = SimpleQueue()
    over = Event()

    def ask(places: Places) -> bool:
        if over.is_set():
            return False
        questions.put(places)
        return answers.get()

    result = thread.submit(_pass, start, ask, seed)
    result.add_done_callback(lambda _: questions.put(None))
    try:
        while (places := questions.get()) is not None:
            answers.put(oracle(places))
    finally:
        # An interrupt leaves it without an answer.
        over.set()
        answers.put(False)
        wait([result])
    return result.result()


def _pass(start: Places, interesting: Callable[[Places], bool], seed: int) -> Places:
    import hypothesis
    from hypothesis import HealthCheck, Phase, Verbosity, given, settings
    from hypothesis.database import InMemoryExampleDatabase, choices_to_bytes

    database = InMemoryExampleDatabase()
    # With a number too many: an example that reads back as it was stored counts as shrunk already.
    database.save(_KEY, choices_to_bytes((*start, 0)))
    least: list[Places] = []

    # Not hypothesis.find: it takes either a database or a seed, and both are needed here.
    @settings(
        database=database,
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
    def search(nested: Any) -> None:
        places = tuple(_flat(nested))
        if interesting(places):
            least[:] = [places]
            raise _InterestingExample

    # As hypothesis.find does. Without it, no database is used under `--hypothesis-seed`.
    search._hypothesis_internal_database_key = _KEY  # noqa: SLF001 - as find does
    try:
        search()
    except _InterestingExample:
        return least[0]
    raise AssertionError(f"Hypothesis did not start at {start}")


def _strategy(start: Sequence[int]) -> Any:
    """Draw the numbers in pairs of pairs, so that Hypothesis tries halves at once."""
    from hypothesis import strategies

    if len(start) == 1:
        return strategies.integers(0, start[0])
    half = (len(start) + 1) // 2
    return strategies.tuples(_strategy(start[:half]), _strategy(start[half:]))


def _flat(nested: Any) -> list[int]:
    if not isinstance(nested, tuple):
        return [nested]
    return [number for part in nested for number in _flat(part)]


Violates = Callable[[SearchedCase], bool]


@dataclass(frozen=True)
class Shrunk:
    """The result of shrinking.

    Args:
        case: The simplest violating case that was seen.
        changes: Its parameters that differ from the nominal case.
        shrinking: How many parameters differed before and after, and what that took.
    """

    case: SearchedCase
    changes: tuple[ParameterChange, ...]
    shrinking: Shrinking


def shrink(
    case: Case,
    counterexample: SearchedCase,
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
        case: The nominal case, whose values are the simplest.
        counterexample: A case that violates.
        violates: Simulates a case; equal cases must have equal answers. A ``ConfigurationError``
            means that the case contradicts itself: it does not violate, and costs nothing.
        budget: Calls of ``violates``.
        seed: Of Hypothesis' own draws.
        simulator: In place of the scenario's.

    Raises:
        ConfigurationError: If the counterexample does not belong to ``case``.
    """
    nominal = Nominal.of(case, simulator)
    trials = _ViolationCache(violates, budget)
    trials.known[_key(counterexample)] = True
    current = _concrete(nominal, counterexample)
    if not trials(current):
        current = counterexample
    before = count_parameters(changes_of(case, current, simulator=simulator))
    # From what is simpler other values come into reach: again, until nothing new comes of it.
    seen: set[bytes] = set()
    while _key(current) not in seen:
        seen.add(_key(current))
        current = _simplest(Simplification(nominal, current), trials, seed)
    changes = changes_of(case, current, simulator=simulator)
    after = count_parameters(changes)
    shrinking = Shrinking(before, after, trials.simulations, budget, not trials.refused)
    return Shrunk(current, changes, shrinking)


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
            violates = False
        else:
            self.simulations += 1
        self.known[key] = violates
        return violates


def _key(searched: SearchedCase) -> bytes:
    return canonical(searched.data)


def _concrete(nominal: Nominal, case: SearchedCase) -> SearchedCase:
    """Write out what the seed draws in the case's world."""
    world, seed = nominal.checked(case.scenario.world), case.scenario.seed or 0
    concrete = nominal.checked(nominal.concrete(world, seed))
    if concrete == world:
        return case
    return make_searched_case(nominal.case, concrete, case.faults, seed)


def _simplest(start: Simplification, trials: _ViolationCache, seed: int) -> SearchedCase:
    """Find the simplest violating case that Hypothesis comes to, maybe the one it starts with."""
    last = tuple(len(knob.values) - 1 for knob in start.knobs)
    if not last:
        return start.case

    def interesting(places: tuple[int, ...]) -> bool:
        if places == last:
            return True
        try:
            return trials(start.case_at(places))
        except ConfigurationError:
            return False

    places = minimise(last, interesting, seed)
    return start.case if places == last else start.case_at(places)
