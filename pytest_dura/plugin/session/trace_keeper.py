"""TraceKeeper: which episodes leave a trace in the evidence, written as they are met."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pytest_dura.core.errors import describe_error

if TYPE_CHECKING:
    from pytest_dura.campaign.events import EpisodeUsed
    from pytest_dura.core.episode import Episode
    from pytest_dura.evidence.lines import KeptTrace
    from pytest_dura.library.cases import Case

Reason = Literal["twin", "all", "sample", "missing", "violation"]

_REASON_RANK: dict[Reason, int] = {
    "twin": 0, "all": 1, "sample": 2, "missing": 3, "violation": 4,
}  # fmt: skip
"""Rank of the reasons to keep a trace; of several the highest is recorded."""
MAX_TWINS = 24
"""Traces that a process keeps only as twins."""


def twin_cases(case: Case) -> list[Case]:
    """Cases whose runs are the twins of a case's: without its faults, without recovery."""
    from pytest_dura.evidence.conclusions.effectiveness import RECOVERY_ROLE

    twins = [case.without_faults()] if case.faults else []
    if RECOVERY_ROLE not in case.without:
        twins.append(case.switched_off(RECOVERY_ROLE))
    return twins


class TraceKeeper:
    """Writes traces into ``episodes`` of the evidence directory, each of them once.

    A file holds what follows from the episode alone, so that two processes write the same one;
    what requirements say of it stands in the record.

    Args:
        level: ``--dura-evidence-level``.
        directory: The evidence directory.
        redact: Copies plain data without secrets.
    """

    def __init__(self, level: str, directory: Path, redact: Callable[[Any], Any]) -> None:
        self._level, self._directory, self._redact = level, directory, redact
        self._kept: dict[tuple[Any, ...], tuple[Reason, dict[str, Any] | None]] = {}
        self._samples: set[tuple[str, str, str]] = set()
        self._runs: set[tuple[str, str, int]] = set()
        self._wanted: set[tuple[str, str, int]] = set()
        self._twins = 0
        self._problem_reported = False
        self.traces: list[KeptTrace] = []
        """What was written and not yet taken."""
        self.problems: list[str] = []
        """Why a trace could not be written; only the first reason."""

    def episode_used(self, event: EpisodeUsed) -> None:
        """Keep the trace of an episode that an item looks at, if it is a sample of its case."""
        episode, case = event.episode, event.case
        if self._level == "all":
            self._keep(episode, "all")
        if event.planned:
            run = case.id, episode.spec.component, episode.spec.run
            self._runs.add(run)
            if run in self._wanted:
                self._keep_twin(episode)
        # What a reference arm shows is shown beside the case that it belongs to.
        sampled = self._level == "violations" and not case.without
        if sampled and episode.validity != "invalid":
            reason: Reason = "sample" if episode.validity == "valid" else "missing"
            kind = reason, episode.spec.case, episode.spec.component
            if kind not in self._samples:
                self._samples.add(kind)
                self._keep(episode, reason)

    def violated(self, episode: Episode) -> None:
        """Keep the trace of an episode that violates a requirement, or failed its test."""
        if self._level != "summary":
            self._keep(episode, "violation")

    def keep_twins(
        self, case: Case, episode: Episode, fetch: Callable[[Case, int], Episode]
    ) -> None:
        """Keep the traces of an episode's twins, now or once an item looks at them.

        Args:
            case: The case of the episode.
            episode: A counterexample.
            fetch: Returns a run of a case that was simulated before.
        """
        if self._level != "violations":
            return
        component, number = episode.spec.component, episode.spec.run
        for twin in twin_cases(case):
            run = twin.id, component, number
            if run in self._runs:
                self._keep_twin(fetch(twin, number))
            elif len(self._wanted) < MAX_TWINS:
                self._wanted.add(run)

    def _keep_twin(self, episode: Episode) -> None:
        if self._twins < MAX_TWINS and episode.validity != "missing":
            self._twins += self._keep(episode, "twin")

    def take(self) -> tuple[list[KeptTrace], list[str]]:
        """Return the traces and problems since the last call."""
        taken = self.traces, self.problems
        self.traces, self.problems = [], []
        return taken

    def _keep(self, episode: Episode, reason: Reason) -> bool:
        """Keep a trace for a reason; returns whether that wrote it."""
        about = self._redact(
            {
                "id": episode.id,
                "component": episode.spec.component,
                "seed": episode.spec.seed,
                "digest": episode.digest,
            }
        )
        key = tuple(about.values())
        earlier = self._kept.get(key)
        if earlier is not None and _REASON_RANK[earlier[0]] >= _REASON_RANK[reason]:
            return False
        written = self._write(episode, about) if earlier is None else earlier[1]
        self._kept[key] = reason, written
        if written is not None:
            from pytest_dura.evidence.lines import KeptTrace

            trace = {**written, "kept_for": reason}
            self.traces.append(KeptTrace(about["id"], about["component"], about["digest"], trace))
        return earlier is None and written is not None

    def _write(self, episode: Episode, about: dict[str, Any]) -> dict[str, Any] | None:
        """Write a trace; returns its file and digest, ``None`` if it cannot be written."""
        from pytest_dura.evidence.mcap import write_trace
        from pytest_dura.evidence.traces import TRACE_FOLDER, Trace, trace_path

        path, directory = trace_path(about), self._directory
        try:
            _check_inside(directory / TRACE_FOLDER)
            trace = Trace.of(episode).without_secrets(self._redact)
            return {"file": path, **write_trace(directory / path, trace)}
        except Exception as error:  # whatever it is, the verdicts do not need the trace
            if not self._problem_reported:
                self._problem_reported = True
                reason = error.strerror if isinstance(error, OSError) and error.strerror else None
                self.problems.append(
                    f"infrastructure: the trace of {episode.id} cannot be written: "
                    f"{reason or describe_error(error)}"
                )
            return None


def _check_inside(folder: Path) -> None:
    if folder.is_symlink():
        raise OSError(
            f"{folder.name} is a symbolic link, and traces stay in the evidence directory"
        )
