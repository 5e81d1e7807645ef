"""Simulation of episodes in this process, sharing between processes, and repetition.

One episode per case is repeated. Sharing covers what ``--dura-resume`` takes over from earlier
sessions.
"""

from __future__ import annotations

import shutil
import tempfile
import uuid
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.evidence.text import counted
from pytest_dura.guests import AtOnce, reason_to_differ
from pytest_dura.plugin.context import draws_reason
from pytest_dura.plugin.items.outcomes import target_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, MutableMapping, Sequence

    import numpy as np
    import pytest
    from numpy.typing import NDArray

    from pytest_dura.campaign.events import EpisodeUsed
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.evidence.lines import RepeatedCase, SearchedRun
    from pytest_dura.evidence.model import SessionRecord
    from pytest_dura.execution.cache import EpisodeCache
    from pytest_dura.execution.executors import Execution, ExecutorChoice
    from pytest_dura.execution.sources import SourceRules, Sources
    from pytest_dura.execution.store import EpisodeStore
    from pytest_dura.execution.task import EpisodeTask
    from pytest_dura.plugin.context import Planned, SessionContext
    from pytest_dura.requirements.second_engine import SecondEngine


_SIMULATED_HERE_KEY = "dura_simulated_here"
"""Key in the output of a worker of pytest-xdist."""


class SessionExecutor:
    """Simulates the episodes of this process, itself or through an executor.

    Args:
        choice: Who simulates, if it is not this process itself; ``auto`` leaves it to
            :meth:`choose`.
        at_once: What episodes that stay in this process do at the same time, in threads.
        is_worker: Whether this is a worker of pytest-xdist.
        alone: Whether it is the only one, if it is a worker.
        collect_only: Whether nothing is run.
    """

    def __init__(
        self,
        choice: ExecutorChoice | Literal["auto"] | None,
        *,
        at_once: Sequence[AtOnce] = (),
        is_worker: bool,
        alone: bool,
        collect_only: bool,
    ) -> None:
        self._alone = alone
        self._automatic = choice == "auto"
        self._choice = None if choice == "auto" else choice
        self._chosen: str | None = None
        """Why this executor simulates, where no option names it, once it is known."""
        self._is_notable = False
        self._at_once = at_once
        self._is_worker, self._collect_only = is_worker, collect_only
        self._execution: Execution | ConfigurationError | None = None
        self._in_test = False
        self._simulated_here: Counter[tuple[str, str]] = Counter()

    def execution(self) -> Execution:
        """Return what simulates, made at the first call.

        Raises:
            ConfigurationError: If it cannot be used; the same one at every call.
        """
        if self._execution is None:
            from pytest_dura.execution.executors import Execution

            try:
                chosen = self._choice
                self._execution = Execution() if chosen is None else chosen.execution()
                if not self._alone:
                    self._execution = replace(self._execution, alone=False)
                if self._at_once:
                    from pytest_dura.execution.threads import EpisodeThreads

                    threads = EpisodeThreads(max(limit.number for limit in self._at_once))
                    self._execution = replace(self._execution, threads=threads)
                self._execution.in_test = self._in_test
            except ConfigurationError as error:
                self._execution = error
        if isinstance(self._execution, ConfigurationError):
            raise self._execution.with_traceback(None)
        return self._execution

    def connect(self) -> None:
        """Check that a cluster is reachable, before anything is collected or written.

        Raises:
            ConfigurationError: If it is not.
        """
        if self._choice is not None and not self._is_worker:
            self._choice.connect()

    def item_begins(self, *, is_test: bool) -> None:
        """Note whether the item that begins is a test, which may replace what is simulated."""
        self._in_test = is_test
        if not (self._execution is None or isinstance(self._execution, ConfigurationError)):
            self._execution.in_test = is_test

    def choose(self, context: SessionContext, items: Sequence[pytest.Item]) -> None:
        """Choose an executor, where no option names it, once all is collected.

        Args:
            context: The session's context.
            items: Those that will ask for episodes.
        """
        if not self._automatic or self._chosen is not None:
            return
        from pytest_dura.plugin.session.automatic_executor import choose_for_items

        choice = choose_for_items(context, items)
        self._chosen, self._is_notable = choice.reason, choice.is_notable
        if choice.processes is not None:
            from pytest_dura.execution.executors import ExecutorChoice

            chosen = ExecutorChoice.parse(f"processes:{choice.processes}")
            if (limit := context.options.episode_timeout) is not None:
                chosen = replace(chosen, seconds=limit)
            if chosen.kind is not None:
                chosen.kind.memory = context.options.episode_memory
            self._choice, self._execution = chosen, None

    def start(self, plan: Sequence[Planned], chosen: Mapping[str, RoleSpec | None]) -> None:
        """Start the executor once all is collected: processes find what is found by then.

        Args:
            plan: The cases that scenario items look at.
            chosen: Roles that options choose, by name.

        Raises:
            ConfigurationError: If it cannot be used.
        """
        if self._choice is None or self._is_worker or self._collect_only:
            return
        executor = self.execution().executor
        if hasattr(executor, "preload"):
            cases = [planned.case for planned in plan]
            roles = [role for case in cases for role in case.roles(chosen).values()]
            parts = [*roles, *(case.scenario.simulator_spec() for case in cases)]
            executor.preload = sorted({part.path for part in parts if part is not None})

    @property
    def is_lost(self) -> bool:
        """Whether the executor is gone, so that no further test can come to a verdict."""
        execution = self._execution
        return (
            not (execution is None or isinstance(execution, ConfigurationError))
            and execution.is_lost
        )

    def close(self) -> None:
        """Cancel what is under way, and end the processes that simulate."""
        execution, self._execution = self._execution, None
        if execution is not None and not isinstance(execution, ConfigurationError):
            self._simulated_here += execution.here
            execution.close()
            self._note_needless(execution)

    def _note_needless(self, execution: Execution) -> None:
        """Note that this process simulated all, though processes had been chosen, and why."""
        is_needless = not getattr(execution.executor, "is_used", True)
        if self._automatic and self._choice is not None and is_needless and execution.here:
            _, reason = execution.here.most_common(1)[0][0]
            self._chosen, self._choice = f"auto: {reason}", None

    def to_json(self) -> dict[str, Any]:
        """The record's key ``execution``."""
        choice = self._choice
        limits = {limit.of: limit.number for limit in self._at_once}
        many: dict[str, Any] = {"at_once": limits} if limits else {}
        if self._automatic:
            if self._chosen is None:  # nothing is collected yet
                return {"executor": "auto", "processes": None, **many}
            many["chosen"] = self._chosen
        if choice is None:
            return {"executor": "in-process", "processes": None, **many}
        return {"executor": choice.name, "processes": choice.processes, **many}

    def header(self) -> list[str]:
        """Header lines, if another process or several threads simulate."""
        choice, lines = self._choice, []
        if choice is not None and choice.kind is not None and not self._automatic:
            lines.append(f"dura: episodes are simulated {choice.kind.where}")
        lines += [f"dura: at most {limit.number} {limit.of} at once" for limit in self._at_once]
        return lines

    def chosen(self, *, verbose: bool) -> list[str]:
        """Line on what was chosen where no option names it, if it is of interest.

        Args:
            verbose: Whether it is in any case.
        """
        if not self._automatic or self._chosen is None:
            return []
        kind = None if self._choice is None else self._choice.kind
        where = "in pytest's own process" if kind is None else kind.where
        text = f"dura: episodes are simulated {where} ({self._chosen})"
        return [text] if verbose or self._is_notable else []

    def notes(self) -> list[str]:
        """Lines on episodes that were simulated here although an executor was chosen."""
        return [
            f"{counted(number, 'episode')} of {component} simulated in pytest's own process: {why}"
            for (component, why), number in sorted(self._counts().items())
        ]

    def _counts(self) -> Counter[tuple[str, str]]:
        """Count the episodes simulated here, and by workers that have ended."""
        execution = self._execution
        if execution is None or isinstance(execution, ConfigurationError):
            return self._simulated_here
        return self._simulated_here + execution.here

    def send_to_controller(self, workeroutput: MutableMapping[str, Any]) -> None:
        """Add to a worker's output what it has simulated itself."""
        workeroutput[_SIMULATED_HERE_KEY] = [
            [*key, number] for key, number in self._counts().items()
        ]

    def receive_from_worker(self, workeroutput: MutableMapping[str, Any]) -> None:
        """Add the counts of a worker that has ended."""
        for component, why, number in workeroutput.get(_SIMULATED_HERE_KEY, ()):
            self._simulated_here[component, why] += number


_COMPARED_KEY = "dura_formulas_compared"
"""Key in the output of a worker of pytest-xdist."""


class FormulaEngines:
    """The second engine for formulas, if the session has one, and what it was compared on.

    Args:
        both: Whether it has one.
    """

    def __init__(self, *, both: bool) -> None:
        self._both = both
        self._of_workers: list[dict[str, str]] = []

    @cached_property
    def second_engine(self) -> SecondEngine | None:
        """Engine that evaluates the formulas of this process as well.

        Raises:
            ConfigurationError: If it cannot be imported.
        """
        if not self._both:
            return None
        from pytest_dura.requirements.second_engine import SecondEngine

        return SecondEngine()

    def check(self) -> None:
        """Check that the second engine can be imported, before anything is collected or written.

        Raises:
            ConfigurationError: If it cannot.
        """
        _ = self.second_engine

    def take_differences(self) -> list[str]:
        """Return where the two engines differed since the last call."""
        engine = self.second_engine
        if engine is None:
            return []
        differences, engine.differences = engine.differences, []
        return differences

    def to_json(self) -> dict[str, Any]:
        """The record's key ``second_engine``, which is absent without one."""
        engine = self.second_engine
        return {} if engine is None else {"second_engine": engine.counts(*self._of_workers)}

    def send_to_controller(self, workeroutput: MutableMapping[str, Any]) -> None:
        """Add to a worker's output what it has compared."""
        engine = self.second_engine
        workeroutput[_COMPARED_KEY] = {} if engine is None else engine.results

    def receive_from_worker(self, workeroutput: Mapping[str, Any]) -> None:
        """Add the counts of a worker that has ended."""
        self._of_workers.append(workeroutput.get(_COMPARED_KEY, {}))


EPISODES_FOLDER = ".episodes"  # as `KEPT` of pytest_dura.evidence.bundle
"""Folder in the evidence directory while a session runs, and after one that was not whole."""
_SESSION_KEY = "dura_session"
_BEFORE_RECORD = "a session that was interrupted before it wrote a record"
_LOST_KEY = "dura_lost"
"""Key in the output of a worker of pytest-xdist."""


class SharedEpisodes:
    """Takes over episodes of earlier sessions, and keeps those of this one.

    Args:
        context: The session's context.
        executor: Who simulates.
        formulas: Who evaluates the formulas of the episodes.
    """

    def __init__(
        self, context: SessionContext, executor: SessionExecutor, formulas: FormulaEngines
    ) -> None:
        self.context = context
        self._executor, self._formulas = executor, formulas
        self.lines: list[str] = []
        """What the terminal says before anything runs."""
        self._store: EpisodeStore | None = None
        self._problems_reported = self._searches_reported = 0
        self._lost = self._was_killed = False
        self.is_whole = False
        """Whether the session came to its end, lost nothing, and left all of its evidence."""

    @cached_property
    def id(self) -> str:
        """Id of the session, the same in all of its processes."""
        given = self.context.worker_input.get(_SESSION_KEY)
        return str(given or uuid.uuid4().hex)

    @cached_property
    def cache(self) -> EpisodeCache:
        """Cache that holds the episodes."""
        from pytest_dura.execution.cache import EpisodeCache

        options = self.context.options
        return EpisodeCache(
            options.evidence / EPISODES_FOLDER,
            self.id,
            earlier=options.resume,
            read_sources=self._read_sources,
        )

    @cached_property
    def rules(self) -> SourceRules:
        """Rules for which files the episodes of the session rest on."""
        from pytest_dura.execution.sources import SourceRules

        config, root = self.context.config, self.context.config.rootpath
        return SourceRules(
            root,
            config.getini("norecursedirs"),
            config.getini("python_files"),
            (self.context.options.evidence,),
        )

    def _read_sources(self) -> Sources | None:
        """Read what all episodes of the session rest on; ``None`` if those are too many files.

        Raises:
            ConfigurationError: If they are, and an earlier session is to be compared with them.
        """
        from pytest_dura.execution.address import describe_interpreter
        from pytest_dura.execution.sources import MAX_FILES, Sources, TooManyFilesError

        try:
            return Sources.of(self.rules, describe_interpreter())
        except TooManyFilesError:
            if not self.context.options.resume:
                return None
        raise ConfigurationError(
            f"more than {MAX_FILES} Python files, or ten times as many others, lie below the root "
            "directory, so that they cannot be compared with those of the session to resume",
            key="--dura-resume",
            found=str(self.context.config.rootpath),
            expected="a root directory with the code of one project",
            remedy="name the folders in `norecursedirs` that no component is imported from",
        )

    def to_json(self) -> dict[str, Any]:
        """The record's key ``resume`` at its beginning; the rest follows from its episodes."""
        sources = self.cache.sources(self.id)
        covered = (
            None
            if sources is None
            else {
                "digest": sources.digest,
                "files": len(sources.files),
                "versions": len(sources.versions),
            }
        )
        return {
            "resumed": self.context.options.resume,
            "session": self.id,
            "sources": covered,
        }

    def store(self) -> EpisodeStore:
        """Make the store from which the runner of this process takes episodes."""
        from pytest_dura.execution.store import EpisodeStore

        self._store = EpisodeStore(
            self.cache,
            self._executor.execution(),
            second_engine=self._formulas.second_engine,
            rules=self.rules,
            repeatable=self.context.options.repeatable,
        )
        return self._store

    def executor_chosen(self) -> None:
        """Let a store that was made before the executor was chosen use it.

        Raises:
            ConfigurationError: If it cannot be used.
        """
        if self._store is not None:
            self._store.execution = self._executor.execution()

    def take_problems(self) -> list[str]:
        """Return why episodes could not be kept, as far as not returned yet."""
        problems = [] if self._store is None else self._store.problems
        new, self._problems_reported = problems[self._problems_reported :], len(problems)
        return new

    def take_searched(self) -> list[SearchedRun]:
        """Return the origins of the runs that searches used since the last call."""
        if self._store is None:
            return []
        from pytest_dura.evidence.lines import SearchedRun

        earlier = self._store.earlier
        searched = list(islice(earlier.searched, self._searches_reported, None))
        self._searches_reported += len(searched)
        return [SearchedRun(f"{key[0]} {key[1]}", earlier.origin(key)) for key in searched]

    @property
    def worker_folder(self) -> Path:
        """Folder in which workers note what items look at, as long as the session runs."""
        return Path(tempfile.gettempdir()) / f"pytest-dura-{self.id}"

    def send_to_worker(self, workerinput: MutableMapping[str, Any]) -> None:
        """Add the session's id to a worker's input."""
        workerinput[_SESSION_KEY] = self.id

    def look_around(self) -> None:
        """Note what a killed session left, before this session makes or locks the directory.

        Raises:
            ConfigurationError: If no session was ever there that could be resumed.
        """
        from pytest_dura.evidence.bundle import RECORD_FILE, open_record
        from pytest_dura.evidence.files import LOCK_FILE

        directory = self.context.options.evidence
        self._was_killed = (directory / LOCK_FILE).exists()
        if self.context.options.resume and not directory.is_dir():
            open_record(directory / RECORD_FILE)

    def begin(self) -> None:
        """Keep the episodes of the session that is resumed, or remove what an earlier one left.

        To be called by the controller, before the record of the earlier session is replaced.

        Raises:
            ConfigurationError: If there is nothing to resume, or something cannot be removed.
        """
        options = self.context.options
        count = self.cache.count()
        episodes = counted(count, "episode")
        # It is removed once a session is whole, so that only other sessions leave it.
        unfinished = self.cache.directory.is_dir()
        # Reading a great record takes its time, and after most sessions there is nothing left.
        session = self._unfinished(left_episodes=unfinished) if options.resume or count else None
        if options.resume:
            anew = "; it begins anew" if session == _BEFORE_RECORD and not count else ""
            self.lines = [f"resuming: {episodes} of {session}{anew}", *self._changes()]
            return
        if session is not None:
            dropped = f"dropped: {episodes} of {session}"
            self.lines = [f"{dropped}; --dura-resume would have taken them over"]
        self._clear()

    def put_sources(self) -> None:
        """Store what the episodes rest on, so that no worker has to read it."""
        with suppress(OSError):  # it is tried again with the first episode, which says why not
            self.cache.put_sources()

    def _changes(self) -> Iterator[str]:
        """Say what changed since the session that is resumed, and for how many episodes."""
        from pytest_dura.execution.sources import changed_sources

        now = self.cache.sources(self.id)
        sessions = Counter(entry.session for entry in self.cache.entries())
        for session, number in sessions.items():
            changed = ", ".join(changed_sources(now, self.cache.sources(session)))
            if changed:
                are = "is" if number == 1 else "are"
                yield f"{counted(number, 'episode')} {are} simulated anew: {changed} changed since"

    @property
    def _lost_here(self) -> bool:
        return self._store is not None and self._store.lost

    def send_to_controller(self, workeroutput: MutableMapping[str, Any]) -> None:
        """Add to a worker's output whether it lost an episode with its executor."""
        workeroutput[_LOST_KEY] = self._lost_here

    def receive_from_worker(self, workeroutput: Mapping[str, Any]) -> None:
        """Note whether a worker lost an episode."""
        self._lost |= bool(workeroutput.get(_LOST_KEY))

    def worker_ended(self, error: object) -> None:
        """Note that a worker ended, with an error if it did not come to its end."""
        self._lost |= bool(error)

    def end(self, record: SessionRecord, *, written: bool) -> None:
        """Note whether the session is whole; any other one can be resumed.

        Args:
            record: Of the session.
            written: Whether all of its evidence could be written.
        """
        shutil.rmtree(self.worker_folder, ignore_errors=True)
        lost = self._lost or self._lost_here or record.head.totals.missing
        self.is_whole = written and record.head.status == "complete" and not lost
        if not self.is_whole:
            with suppress(OSError):  # so that it can be resumed, also if nothing was simulated
                self.cache.directory.mkdir(exist_ok=True)

    def remove_if_whole(self) -> None:
        """Remove the episodes of a session that is whole."""
        if self.is_whole:
            # What cannot be removed does no harm: the next session removes it, or says why not.
            with suppress(OSError):
                self.cache.clear()

    def _clear(self) -> None:
        try:
            self.cache.clear()
        except OSError as error:
            raise ConfigurationError(
                f"the episodes of an earlier session cannot be removed: {error.strerror or error}",
                key="--dura-evidence",
                found=str(error.filename or self.cache.directory),
                expected="a directory whose files can be removed",
                remedy="remove it, or choose another directory",
            ) from None

    def _unfinished(self, *, left_episodes: bool) -> str | None:
        """Describe the session that the evidence is of, unless it was whole.

        Args:
            left_episodes: Whether it left the directory of its episodes.

        Raises:
            ConfigurationError: If it is to be resumed, and there is none that can be.
        """
        from pytest_dura.evidence.bundle import RECORD_FILE, open_record

        options = self.context.options
        file = options.evidence / RECORD_FILE
        if not file.exists():
            return _BEFORE_RECORD
        try:
            record = open_record(file)
        except ConfigurationError:
            if options.resume:
                raise
            return None
        if record.head.status != "complete":
            return f"the interrupted session of {record.head.created}"
        if left_episodes:
            return f"the session of {record.head.created}, which was not whole"
        if self._was_killed:  # the record is that of the session before it
            return _BEFORE_RECORD
        if options.resume:
            raise ConfigurationError(
                "there is nothing to resume: the session of this evidence was not interrupted, and "
                "lost nothing",
                file=str(file),
                key="--dura-resume",
                found="complete",
                expected="the evidence of a session that was interrupted, or lost a process",
                remedy="drop --dura-resume",
            )
        return None


@dataclass(frozen=True)
class _DueRepetition:
    """An episode that is to be repeated."""

    task: EpisodeTask
    digest: str
    declared: str
    """What declares that it may differ; empty if nothing does."""
    skipped: bool
    """Whether a guest declares it, so that repeating it would say nothing."""
    signals: Mapping[str, NDArray[np.float64]]
    """To be compared within :attr:`tolerances`; empty where the digest is."""
    tolerances: Mapping[str, float] | None
    """Those of a simulator that is not deterministic; ``None`` for another one."""


class Repeats:
    """Repeats the first episode of each case once this process has run the last item on it.

    By then the process has run other episodes, so that what they left in classes or modules shows.

    Args:
        context: The session's context.
        executor: Who simulates.
    """

    def __init__(
        self,
        context: SessionContext,
        executor: SessionExecutor,
    ) -> None:
        self._context, self._executor = context, executor
        self._due: dict[tuple[str, str], _DueRepetition] = {}
        self._done: set[tuple[str, str]] = set()

    def episode_used(self, event: EpisodeUsed) -> None:
        """Note the first planned episode of a case, which is to be repeated."""
        case, episode = event.case, event.episode
        key = case.id, episode.spec.component
        known = key in self._due or key in self._done
        if not event.planned or known or episode.failure is not None:
            return
        from pytest_dura.library.scenario import tolerances_of

        task = self._context.runner.task(case, episode.spec.run)
        declared = draws_reason(self._context, case)
        skipped = bool(declared) and declared == reason_to_differ(task.spec.roles.values())
        tolerances = tolerances_of(task.spec)
        signals = {} if tolerances is None else episode.signals
        self._due[key] = _DueRepetition(
            task, episode.digest, declared, skipped, signals, tolerances
        )

    def item_ends(self, item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[RepeatedCase]:
        """Repeat what is due, unless the next item is on the same case.

        Yields:
            What came of each repetition.
        """
        stopped = bool(item.session.shouldstop or item.session.shouldfail)
        if stopped or self._executor.is_lost:
            self._due.clear()
        if not self._due or (
            nextitem is not None and _case_id_of(nextitem) == _case_id_of(item) != ""
        ):
            return
        from pytest_dura.evidence.lines import RepeatedCase

        # The last case first: a component that behaves by turns, one way in a run and another way
        # in its twin, would otherwise meet the turn of the first time.
        in_turn = list(reversed(self._due.items()))
        due_tasks = [due.task for _, due in in_turn if not due.skipped]
        self._context.runner.store.begin_repeats(due_tasks)
        for (case, component), due in in_turn:
            self._done.add((case, component))
            about = {"case": case, "component": component, "episode": due.task.spec.id}
            about |= {"digest": due.digest, "declared": due.declared}
            yield RepeatedCase.from_data({**about, **self._repeated(due)})
        self._due.clear()

    def _repeated(self, due: _DueRepetition) -> Mapping[str, Any]:
        """Repeat an episode."""
        if due.skipped:
            return {"result": "skipped", "repeated_digest": None, "detail": due.declared}
        try:
            with self._context.guests.uncounted():
                repetition = self._context.runner.store.repeat(due.task)
        except Exception as error:  # whatever user code raises, which it did not the first time
            return {
                "result": "failed",
                "repeated_digest": None,
                "detail": f"infrastructure: {describe_error(error)}",
            }
        result = "equal" if repetition.digest == due.digest else "different"
        detail = repetition.failure or ""
        if repetition.failure is not None:
            result = "failed"
        elif result == "different" and due.tolerances is not None:
            from pytest_dura.core.simulator import beyond_tolerance, describe_tolerances

            beyond = beyond_tolerance(due.tolerances, due.signals, repetition.signals)
            result = "within tolerances" if beyond is None else result
            detail = beyond or describe_tolerances(due.tolerances)
        return {"result": result, "repeated_digest": repetition.digest, "detail": detail}


def _case_id_of(item: pytest.Item) -> str:
    """Id of the case that an item looks at; empty where it chooses its episodes itself."""
    target = target_of(item)
    return "" if target is None else str(target.case.id)
