"""SharedEpisodes: the shelf on which the processes of a session keep and find episodes."""

from __future__ import annotations

import uuid
from contextlib import suppress
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.places import from_here

if TYPE_CHECKING:
    from collections.abc import MutableMapping

    from pytest_dura.campaign.episodes.shelf import Shelf
    from pytest_dura.campaign.episodes.store import EpisodeStore
    from pytest_dura.plugin.session import DuraSession

FOLDER = ".episodes"  # as `KEPT` of pytest_dura.evidence.bundle.directory
"""In the evidence directory, as long as a session runs, and after one that was interrupted."""
_INPUT = "dura_session"


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
        if options.reuse is not None:
            place = from_here(options.reuse, self.session.config.invocation_params.dir)
            self.lines = [f"reusing: {kept} of earlier sessions in {place}"]
            return
        # Reading a great record takes its time, and after most sessions there is nothing left.
        when = self._interrupted_at() if options.resume or left else None
        if options.resume:
            self.lines = [f"resuming: {kept} of the interrupted session of {when}"]
            return
        if when is not None:
            what = f"dropped: {kept} of the interrupted session of {when}"
            self.lines = [f"{what}; --dura-resume would have taken them over"]
        self._clear()

    def end(self, *, complete: bool) -> None:
        """Remove the episodes of a session that has come to its end; nobody will resume it."""
        if complete and self.session.options.reuse is None:
            # What stays is in nobody's way: the next session removes it, or says that it cannot.
            with suppress(OSError):
                self.shelf.clear()

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

    def _interrupted_at(self) -> str | None:
        """When the session began that the evidence is of, unless it came to its end.

        Raises:
            ConfigurationError: If it is to be resumed, and there is none that can be.
        """
        from pytest_dura.evidence.bundle.directory import RECORD, read_session_record

        options = self.session.options
        try:
            record = read_session_record(options.evidence)
        except ConfigurationError:
            if options.resume:
                raise
            return None
        if record["status"] != "complete":
            return str(record["created"])
        if options.resume:
            raise ConfigurationError(
                "there is nothing to resume: the session of this evidence was not interrupted",
                file=str(options.evidence / RECORD),
                key="--dura-resume",
                found="complete",
                expected="the evidence of a session that was killed or interrupted",
                remedy="drop --dura-resume; to keep episodes from session to session, use "
                "--dura-reuse=DIR",
            )
        return None
