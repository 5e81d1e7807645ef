"""Which episodes leave a trace in the evidence, and writing it, in whichever process runs them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pytest_dura.core.errors import describe_error

if TYPE_CHECKING:
    from pytest_dura.core.episode import Episode
    from pytest_dura.plugin.session import DuraSession

Level = Literal["summary", "violations", "all"]
Reason = Literal["all", "sample", "missing", "violation"]

_RANK: dict[Reason, int] = {"all": 0, "sample": 1, "missing": 2, "violation": 3}
"""Of several reasons to keep a trace the last one is told."""


class TraceKeeper:
    """Writes traces into ``episodes`` of the evidence directory, each of them once.

    A file holds what follows from the episode alone, so that two processes write the same one;
    what requirements say of it stands in the record.

    Args:
        session: The session of this process.
    """

    def __init__(self, session: DuraSession) -> None:
        self.session = session
        self._kept: dict[tuple[Any, ...], tuple[Reason, dict[str, Any] | None]] = {}
        self._samples: set[tuple[str, str, str]] = set()
        self._told_problem = False
        self.traces: list[dict[str, Any]] = []
        """``{id, component, digest, trace}`` of what was written and not yet taken."""
        self.problems: list[str] = []
        """Why a trace could not be written; the first reason alone is told."""

    def used(self, episode: Episode) -> None:
        """A test looked at an episode."""
        level = self.session.options.evidence_level
        if level == "all":
            self._keep(episode, "all")
        if level == "violations" and episode.validity != "invalid":
            reason: Reason = "sample" if episode.validity == "valid" else "missing"
            kind = reason, episode.spec.case, episode.spec.component
            if kind not in self._samples:
                self._samples.add(kind)
                self._keep(episode, reason)

    def violated(self, episode: Episode) -> None:
        """An episode violates a requirement, or failed its test."""
        if self.session.options.evidence_level != "summary":
            self._keep(episode, "violation")

    def take(self) -> tuple[list[dict[str, Any]], list[str]]:
        """What there is to tell since the last call: traces, and problems."""
        told = self.traces, self.problems
        self.traces, self.problems = [], []
        return told

    def _keep(self, episode: Episode, reason: Reason) -> None:
        about = self.session.redact(
            {
                "id": episode.id,
                "component": episode.spec.component,
                "seed": episode.spec.seed,
                "digest": episode.digest,
            }
        )
        key = tuple(about.values())
        before = self._kept.get(key)
        if before is not None and _RANK[before[0]] >= _RANK[reason]:
            return
        written = self._write(episode, about) if before is None else before[1]
        self._kept[key] = reason, written
        if written is not None:
            named = {name: about[name] for name in ("id", "component", "digest")}
            self.traces.append({**named, "trace": {**written, "kept_for": reason}})

    def _write(self, episode: Episode, about: dict[str, Any]) -> dict[str, Any] | None:
        """The file and its digest; ``None`` if it cannot be written, which is told."""
        from pytest_dura.evidence.traces.mcap_file import write_trace
        from pytest_dura.evidence.traces.names import FOLDER, trace_path
        from pytest_dura.evidence.traces.trace import Trace

        path, directory = trace_path(about), self.session.evidence_directory
        try:
            _check_inside(directory / FOLDER)
            trace = Trace.of(episode).without_secrets(self.session.redact)
            return {"file": path, **write_trace(directory / path, trace)}
        except Exception as error:  # whatever it is, the verdicts do not need the trace
            if not self._told_problem:
                self._told_problem = True
                why = error.strerror if isinstance(error, OSError) and error.strerror else None
                self.problems.append(
                    f"infrastructure: the trace of {episode.id} cannot be written: "
                    f"{why or describe_error(error)}"
                )
            return None


def _check_inside(folder: Path) -> None:
    if folder.is_symlink():
        raise OSError(
            f"{folder.name} is a symbolic link, and traces stay in the evidence directory"
        )
