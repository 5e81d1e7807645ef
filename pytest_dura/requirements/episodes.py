"""What one requirement says of one episode, and episodes that answer to formulas."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal

import numpy as np

from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.bounds import Evaluation, Formula, evaluate, parse
from pytest_dura.requirements.formula import unknown_signal
from pytest_dura.requirements.model import Requirement

EpisodeWord = Literal["satisfied", "violated", "invalid", "missing"]


@dataclass(frozen=True, slots=True)
class EpisodeVerdict:
    """What one requirement says of one episode; plain data that crosses processes.

    Args:
        requirement: Id of the requirement.
        episode: Id of the episode, ``case#run``.
        component: Name of the component under test.
        verdict: ``satisfied``, ``violated``, ``invalid`` or ``missing``.
        margin: Robustness; ``None`` where there is no trace to measure it on.
        time: Seconds at which the requirement was violated first, for a violation.
        detail: Why, in words.
        proposals: How often the component was asked.
        valid_proposals: How often it answered with a valid action.
    """

    requirement: str
    episode: str
    component: str
    verdict: EpisodeWord
    margin: float | None
    time: float | None
    detail: str
    proposals: int
    valid_proposals: int

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> EpisodeVerdict:
        """The inverse of :meth:`to_json`."""
        return cls(**data)


def judge_episode(requirement: Requirement, episode: Episode) -> EpisodeVerdict:
    """The verdict of a requirement's check on an episode.

    Raises:
        ConfigurationError: If the requirement has no check, or its check cannot be read or names
            a signal that the episode does not have.
    """
    if not requirement.check:
        raise ConfigurationError(
            f"requirement {requirement.id!r} has no check",
            key="check",
            expected="a formula such as `always (gap > 0)`",
            remedy="add a check, or judge it in test code",
        )
    formula = parse(requirement.check)
    word, found, detail = _word(formula, episode)
    margin = found.margin if found is not None and math.isfinite(found.margin) else None
    return EpisodeVerdict(
        requirement=requirement.id,
        episode=episode.id,
        component=episode.spec.component,
        verdict=word,
        margin=margin,
        time=found.time if found is not None and word == "violated" else None,
        detail=detail,
        proposals=episode.metrics.proposals,
        valid_proposals=episode.metrics.valid_proposals,
    )


def _word(formula: Formula, episode: Episode) -> tuple[EpisodeWord, Evaluation | None, str]:
    found, gap = evaluate_episode(formula, episode)
    if found is not None and found.status == "violated":
        return "violated", found, found.detail
    if episode.failure is not None:
        return "missing", found, episode.failure
    if episode.validity == "invalid":
        return "invalid", found, episode.invalid_reason or "the episode is not valid"
    if found is None:
        return "missing", None, "the episode has no samples"
    if found.status == "undecided":
        return "invalid", found, gap or found.detail
    return "satisfied", found, found.detail


def evaluate_episode(formula: Formula, episode: Episode) -> tuple[Evaluation | None, str | None]:
    """The formula on the finite part of an episode's signals, and what cut it short, if anything.

    ``None`` stands for an episode without samples. After an infrastructure error the trace is a
    prefix: it can show a violation, but not that there was none.

    Raises:
        ConfigurationError: For a signal that the episode does not have.
    """
    missing = [name for name in formula.signals if name not in episode.signals]
    if missing and (episode.signals or episode.failure is None):
        raise unknown_signal(missing[0], episode.signals, str(formula), None)
    if missing or episode.ticks == 0:
        return None, None
    columns = {name: episode.signals[name] for name in formula.signals}
    finite = np.logical_and.reduce([np.isfinite(column) for column in columns.values()])
    samples = episode.ticks if finite.all() else int(np.argmin(finite))
    gap = None
    if samples < episode.ticks:
        bad = next(name for name, column in columns.items() if not np.isfinite(column[samples]))
        gap = f"the signal {bad!r} is not finite at t = {episode.time[samples]:g} s"
        if samples == 0:
            undecided = Evaluation("undecided", np.inf, -np.inf, np.inf, None, 0.0, gap)
            return undecided, gap
    complete = samples == episode.ticks and episode.failure is None
    cut = {name: column[:samples] for name, column in columns.items()}
    return evaluate(formula, episode.time[:samples], cut, complete=complete), gap


@dataclass
class JudgedEpisode(Episode):
    """An episode that answers to formulas; what test functions get."""

    @classmethod
    def of(cls, episode: Episode) -> JudgedEpisode:
        """The same episode, with the judging methods."""
        return cls(**{one.name: getattr(episode, one.name) for one in fields(Episode)})

    def robustness(self, formula: str) -> float:
        """How far the episode stays clear of violating a formula; below 0 it is violated.

        Where the trace ends before the formula is decided, this is the least value that is still
        possible, so that a test that compares it with a limit fails closed.

        Raises:
            ConfigurationError: If the formula cannot be read or names an unknown signal.
        """
        found, _ = evaluate_episode(parse(formula), self)
        return -math.inf if found is None else found.robustness

    def satisfies(self, formula: str) -> bool:
        """Whether a formula is decided and holds on this episode, which is itself valid.

        Raises:
            ConfigurationError: If the formula cannot be read or names an unknown signal.
        """
        return _word(parse(formula), self)[0] == "satisfied"
