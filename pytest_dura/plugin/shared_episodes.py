"""SharedEpisodes: the shelf on which the processes of a session keep and find episodes."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
import uuid
from contextlib import suppress
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.places import from_here

if TYPE_CHECKING:
    from collections.abc import Mapping, MutableMapping

    from pytest_dura.campaign.episodes.shelf import Shelf
    from pytest_dura.campaign.episodes.store import EpisodeStore
    from pytest_dura.evidence.record.session_record import SessionRecord
    from pytest_dura.plugin.session import DuraSession

FOLDER = ".episodes"  # as `KEPT` of pytest_dura.evidence.bundle.directory
"""In the evidence directory, as long as a session runs, and after one that was not whole."""
_INPUT = "dura_session"
_LOST = "dura_lost"
"""Key of what a worker of pytest-xdist tells the controller at its end."""


class SharedEpisodes:
    """The episodes that all processes of a session share, and what is taken over from earlier ones.

    Args:
        session: The session of this process.
    """

    def __init__(self, session: DuraSession) -> None:
        self.session = session
        self.lines: list[str] = []
        """What the terminal says before anything runs."""
        self._store: EpisodeStore | None = None
        self._told = self._told_searched = 0
        self._lost = False
        self.is_whole = False
        """Whether the session came to its end, lost nothing, and left all of its evidence."""

    @cached_property
    def id(self) -> str:
        """Of the session, the same in all of its processes."""
        given = getattr(self.session.config, "workerinput", {}).get(_INPUT)
        return str(given or uuid.uuid4().hex)

    @cached_property
    def shelf(self) -> Shelf:
        """Where the episodes are."""
        from pytest_dura.campaign.episodes.shelf import Shelf

        options = self.session.options
        directory = options.reuse or self.session.evidence_directory / FOLDER
        return Shelf(directory, self.id, earlier=options.resume or options.reuse is not None)

    @property
    def mode(self) -> str:
        """What is taken over: ``none``, ``resume`` or ``reuse``, as the record has it."""
        options = self.session.options
        return "resume" if options.resume else "none" if options.reuse is None else "reuse"

    def to_json(self) -> dict[str, Any]:
        """What the record begins with; the rest follows from its episodes."""
        return {"mode": self.mode, "session": self.id}

    def store(self) -> EpisodeStore:
        """What the bench of this process asks for episodes."""
        from pytest_dura.campaign.episodes.store import EpisodeStore

        self._store = EpisodeStore(self.shelf, self.session.simulating.execution())
        return self._store

    @property
    def is_broken(self) -> bool:
        """Whether an episode closed the file descriptors of this process, which cannot go on."""
        return self._store is not None and self._store.is_broken

    def take_problems(self) -> list[str]:
        """Why episodes could not be shared, as far as it was not told yet."""
        known = [] if self._store is None else self._store.problems
        found, self._told = known[self._told :], len(known)
        return found

    def take_searched(self) -> list[dict[str, Any]]:
        """The origins of what searches used since the last call."""
        if self._store is None:
            return []
        earlier = self._store.earlier
        found = list(islice(earlier.searched, self._told_searched, None))
        self._told_searched += len(found)
        return [{"run": f"{key[0]} {key[1]}", "origin": earlier.origin(key)} for key in found]

    def first_to_repeat(self, case: str, component: str) -> bool:
        """Whether this process is the first of the session that repeats an episode of a case."""
        if not self.session.is_worker:
            return True
        name = hashlib.sha256(f"{case}\n{component}".encode()).hexdigest()
        with suppress(OSError):
            self._marks.mkdir(mode=0o700, exist_ok=True)
            try:
                (self._marks / name).touch(exist_ok=False)
            except FileExistsError:
                return False
        return True

    @property
    def _marks(self) -> Path:
        """Where workers note what they repeat, as long as the session runs."""
        return Path(tempfile.gettempdir()) / f"pytest-dura-{self.id}"

    def tell_worker(self, workerinput: MutableMapping[str, Any]) -> None:
        """Tell a worker which session it is of."""
        workerinput[_INPUT] = self.id

    def begin(self) -> None:
        """Keep the episodes of the session that is resumed; or remove what an earlier one left.

        To be called by the controller, before the record of the earlier session is replaced.

        Raises:
            ConfigurationError: If there is nothing to resume, or something cannot be removed.
        """
        options = self.session.options
        left = self.shelf.count()
        kept = f"{left} episode{'' if left == 1 else 's'}"
        # Removed once a session is whole, so that a session which was not has left it.
        begun = self.shelf.directory.is_dir()
        if options.reuse is not None:
            place = from_here(options.reuse, self.session.config.invocation_params.dir)
            self.lines = [f"reusing: {kept} of earlier sessions in {place}"]
            return
        # Reading a great record takes its time, and after most sessions there is nothing left.
        earlier = self._unfinished(begun=begun) if options.resume or left else None
        if options.resume:
            self.lines = [f"resuming: {kept} of {earlier}"]
            return
        if earlier is not None:
            what = f"dropped: {kept} of {earlier}"
            self.lines = [f"{what}; --dura-resume would have taken them over"]
        self._clear()

    @property
    def _lost_here(self) -> bool:
        return self._store is not None and self._store.lost

    def tell_controller(self, workeroutput: MutableMapping[str, Any]) -> None:
        """Tell the controller whether this worker lost an episode with whoever simulated it."""
        workeroutput[_LOST] = self._lost_here

    def hear_worker(self, workeroutput: Mapping[str, Any], error: object) -> None:
        """Take in what a worker tells at its end, and whether it came to its end at all."""
        self._lost |= bool(error) or bool(workeroutput.get(_LOST))

    def end(self, record: SessionRecord, *, written: bool) -> None:
        """Remove the episodes of a session that is whole; another one can be resumed.

        Args:
            record: Of the session.
            written: Whether all of its evidence could be written.
        """
        shutil.rmtree(self._marks, ignore_errors=True)
        lost = self._lost or self._lost_here or record["totals"]["missing"]
        self.is_whole = written and record["status"] == "complete" and not lost
        if self.session.options.reuse is not None:
            return
        # What cannot be removed is in nobody's way: the next session does it, or tells why not.
        with suppress(OSError):
            if self.is_whole:
                self.shelf.clear()
            else:  # so that it can be resumed, also if nothing was simulated
                self.shelf.directory.mkdir(exist_ok=True)

    def _clear(self) -> None:
        try:
            self.shelf.clear()
        except OSError as error:
            raise ConfigurationError(
                f"the episodes of an earlier session cannot be removed: {error.strerror or error}",
                key="--dura-evidence",
                found=str(error.filename or self.shelf.directory),
                expected="a directory whose files can be removed",
                remedy="remove it, or choose another directory",
            ) from None

    def _unfinished(self, *, begun: bool) -> str | None:
        """The session that the evidence is of, in words, unless it was whole.

        Args:
            begun: Whether it left the directory of its episodes.

        Raises:
            ConfigurationError: If it is to be resumed, and there is none that can be.
        """
        from pytest_dura.evidence.bundle.directory import RECORD, read_session_record

        options = self.session.options
        file = options.evidence / RECORD
        if begun and not file.exists():
            return "a session that was interrupted before it wrote a record"
        try:
            record = read_session_record(options.evidence)
        except ConfigurationError:
            if options.resume:
                raise
            return None
        if record["status"] != "complete":
            return f"the interrupted session of {record['created']}"
        if begun:
            return f"the session of {record['created']}, which was not whole"
        if options.resume:
            raise ConfigurationError(
                "there is nothing to resume: the session of this evidence was not interrupted, and "
                "lost nothing",
                file=str(file),
                key="--dura-resume",
                found="complete",
                expected="the evidence of a session that was interrupted, or lost a process",
                remedy="drop --dura-resume; to keep episodes from session to session, use "
                "--dura-reuse=DIR",
            )
        return None
