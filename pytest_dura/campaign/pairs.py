"""Pairs of runs of equal seeds: twins, what a check or a measure says of both, and monitors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.library.cases import Case
from pytest_dura.requirements.checks import Check
from pytest_dura.requirements.episode_verdicts import (
    EpisodeVerdict,
    JudgedEpisode,
    judge_episode,
    judge_run,
)
from pytest_dura.requirements.judgements import RunJudgement, finite_or_infinite
from pytest_dura.requirements.model import FAULTS, Requirement
from pytest_dura.requirements.monitoring.quality import (
    MonitorQuality,
    judge_alerts,
    judge_monitor,
    monitor_timeline,
)
from pytest_dura.requirements.pairs import measured


def monitor_qualities(
    episodes: Callable[[], Iterable[Episode]], requirements: Sequence[Requirement]
) -> list[MonitorQuality]:
    """The quality of every monitor against each safety requirement, and of alerts against faults.

    Args:
        episodes: Gives the episodes of one case without recovery, at each call anew: they may be
            many, and are never all in memory.
        requirements: Of any kind; those on safety that a single episode can violate are used.

    Returns:
        Nothing if an alarm changed an action in any of the episodes (under ``halt`` and
        ``refine``): a violation that was averted would make its true alarm a false one. Nor if
        an episode ended once all was decided: its false alarms were still to come.
    """
    timelines = []
    for episode in episodes():
        if episode.termination == "decided":
            return []
        timelines.append(monitor_timeline(episode))
    if any(timeline.intervention is not None for timeline in timelines):
        return []
    monitors = sorted({name for timeline in timelines for name in timeline.alarms})
    judged = [
        requirement
        for requirement in requirements
        if requirement.kind == "safety" and not requirement.paired and requirement.check
    ]
    verdicts: list[list[EpisodeVerdict]] = [[] for _ in judged]
    for episode in episodes() if judged and monitors else ():
        for verdict, requirement in zip(verdicts, judged, strict=True):
            verdict.append(judge_episode(requirement, episode))
    qualities = [
        judge_monitor(monitor, list(zip(verdict, timelines, strict=True)))
        for verdict in verdicts
        for monitor in monitors
    ]
    if any(
        timeline.manifested_at is not None and timeline.alerts is not None for timeline in timelines
    ):
        qualities.append(judge_alerts(timelines))
    return qualities


def judged_pair(
    requirement: Requirement,
    check: Check | None,
    pair: Sequence[JudgedEpisode],
    *,
    declared: bool,
) -> RunJudgement:
    """What a requirement on pairs says of the runs of a pair, as far as they do not have it."""
    episode, twin = pair[:2]
    assert requirement.paired is not None
    measure = requirement.paired.measure
    if measure:
        own, other = (finite_or_infinite(measured_value(measure, each)) for each in pair)
        return RunJudgement(episode.digest, episode.spec.run, twin.digest, values=(own, other))
    verdicts = [judge_run(requirement, each, check) for each in pair]
    stated = [None] * len(pair) if declared else verdicts
    judged = RunJudgement(episode.digest, episode.spec.run, twin.digest, *stated[:2])
    if len(pair) == 2:
        return judged
    return replace(judged, reference=pair[2].digest, reference_verdict=stated[2])


def measured_value(measure: str | Callable[[Episode], float], episode: Episode) -> float | None:
    """The measure of a run; ``None`` of a run that is invalid, missing or ended early."""
    whole = episode.validity == "valid" and episode.termination != "decided"
    return measured(measure, episode) if whole else None


def twin_case(case: Case, without: str, reference: str = "") -> Case:
    """The case of the twins.

    Args:
        case: That of the first runs.
        without: What the twins lack; empty with a reference.
        reference: The component that drives them; empty without one. Where the twins lack
            something, it drives third runs.

    Raises:
        ConfigurationError: If there is no such role or component, or there are no faults.
    """
    if reference and not without:
        return case.referred(reference)
    if without != FAULTS:
        return case.switched_off(without)
    if not case.faults:
        raise ConfigurationError(
            f"the case {case.id!r} has no faults to leave out",
            key="paired.without",
            found=without,
            expected="a case with faults",
            remedy="compare only cases with faults with their runs without faults",
        )
    return case.without_faults()
