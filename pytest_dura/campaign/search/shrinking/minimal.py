"""Minimal: Hypothesis shrinks a list of whole numbers of fixed length, starting where it is told.

It runs wherever we are: in a test, in a test of ``@given``, under any profile. It keeps to itself:
no database on disk, no seed of the session, nothing printed.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, wait
from functools import cache
from queue import SimpleQueue
from threading import Event, Thread
from typing import Any

Places = tuple[int, ...]

_PATIENCE = 100.0
"""Seconds after which a pass is begun again; Hypothesis itself gives up after 300."""


class _Found(Exception):  # noqa: N818 - no error: how Hypothesis is told that an example counts
    """The example is one of those that we look for."""


def minimal(start: Places, interesting: Callable[[Places], bool], seed: int) -> Places:
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
        found = _shrunk(start, asked, seed)
        if asked.error is not None:
            raise asked.error
        if not asked.ended:
            # Hypothesis stops trying after a while, and so may have left something out.
            better = next((one for one in _neighbours(found) if once(one)), None)
            if better is None:
                return found
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
        if any(one > least for one, least in zip(places, self._least, strict=True)):
            return False
        if places not in self._known and (self.error is not None or self.ended):
            return False
        try:
            found = self._once(places)
        except BaseException as error:  # Hypothesis would shrink it; it is raised after the pass.
            self.error = error
            return False
        if found:
            self._least = places
        return found


class _Worker:
    """A thread in which passes run, one after the other.

    Hypothesis searches the whole process for garbage when it comes to a new thread: so one is kept.
    """

    def __init__(self) -> None:
        self._passes: SimpleQueue[Callable[[], None]] = SimpleQueue()
        Thread(target=self._work, name="shrinking", daemon=True).start()

    def start(self, one: Callable[[], None]) -> None:
        """Begin a pass, which raises nothing."""
        self._passes.put(one)

    def _work(self) -> None:
        while True:
            self._passes.get()()


_IDLE: list[_Worker] = []
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_IDLE.clear)  # a copy of the process has no such thread


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
        worker = _IDLE.pop()
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
        _IDLE.append(worker)
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
            raise _Found

    # As hypothesis.find does. Without it, no database is used under `--hypothesis-seed`.
    look._hypothesis_internal_database_key = b"start"  # noqa: SLF001 - as find does
    try:
        look()
    except _Found:
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
        [one for each in nested for one in _flat(each)] if isinstance(nested, tuple) else [nested]
    )
