"""Episodes that processes share, and what ``--dura-resume`` takes over from an earlier session."""

from __future__ import annotations

import shutil
import tempfile
import uuid
from collections import Counter
from contextlib import suppress
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.text import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, MutableMapping

    from pytest_dura.evidence.lines import SearchedRun
    from pytest_dura.evidence.model import SessionRecord
    from pytest_dura.execution.cache import EpisodeCache
    from pytest_dura.execution.sources import SourceRules, Sources
    from pytest_dura.execution.store import EpisodeStore
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.plugin.session.executor import SessionExecutor
    from pytest_dura.plugin.session.formula_engines import FormulaEngines

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
