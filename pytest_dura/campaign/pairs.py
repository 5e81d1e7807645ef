"""PairedCampaign: runs beside runs of equal seeds that lack a fault or a role."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pytest_dura.campaign.events import MonitorsMeasured
from pytest_dura.core.display import Shown
from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.text import one_line
from pytest_dura.library.cases import Case
from pytest_dura.requirements.campaign_verdicts import CampaignVerdict
from pytest_dura.requirements.checks import Check, check_name
from pytest_dura.requirements.episode_verdicts import (
    EpisodeVerdict,
    JudgedEpisode,
    judge_episode,
    judge_run,
)
from pytest_dura.requirements.judgements import RunJudgement, finite_or_infinite
from pytest_dura.requirements.model import (
    FAULTS,
    Method,
    Paired,
    Requirement,
    finite_number,
    requirement_of_call,
)
from pytest_dura.requirements.monitoring.quality import (
    MonitorQuality,
    judge_alerts,
    judge_monitor,
    monitor_timeline,
)
from pytest_dura.requirements.pairs import (
    Change,
    Pair,
    PairCounts,
    check_comparison,
    judge_pairs,
    measured,
)

if TYPE_CHECKING:
    from pytest_dura.campaign.campaign import Campaign
    from pytest_dura.execution.task import EpisodeTask


def _monitor_qualities(
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


_RECOVERY = "recovery_planner"


class PairedCampaign(Shown):
    """Pairs of episodes: one of a campaign, and its twin of the same seed without something.

    Args:
        campaign: The campaign.
        without: ``faults``, or the name of a role that is switched off in the twins.

    Raises:
        ConfigurationError: If there is no such role, or there are no faults.
    """

    def __init__(self, campaign: Campaign, without: str) -> None:
        self.campaign, self.without = campaign, without
        self.case = _twin_case(campaign.case, without)
        # Raises before anything runs if there is no such role to switch off.
        self.case.roles(campaign.runner.roles)

    def __repr__(self) -> str:
        name = one_line(repr(self.campaign.case.id), 64)
        return f"PairedCampaign({name}, without={self.without!r})"

    def _figures(self) -> Iterator[tuple[str, object]]:
        """Yield what a notebook shows; nothing is simulated for it."""
        yield "case", self.campaign.case.id
        yield "twins without", self.without
        yield "component", self.campaign.component
        yield "pairs planned", str(self.campaign.planned)

    def __iter__(self) -> Iterator[tuple[JudgedEpisode, JudgedEpisode]]:
        """The pairs of all planned runs."""
        cases = [self.campaign.case, self.case]
        yield from self._with_twins(self.campaign.in_order(cases), cases)

    def twin(self, episode: JudgedEpisode, ahead: Iterable[EpisodeTask] = ()) -> JudgedEpisode:
        """The episode of the same run and seed without something.

        Args:
            episode: One of the campaign's.
            ahead: Tasks that come next.
        """
        return self.campaign.runner.episode(
            self.case, episode.spec.run, planned=self.campaign.planned, ahead=ahead
        )

    def _with_twins(
        self, episodes: Iterable[JudgedEpisode], cases: Sequence[Case]
    ) -> Iterator[tuple[JudgedEpisode, JudgedEpisode]]:
        """Each episode with its twin; a process that waits for one simulates the next ones."""
        ahead = self.campaign.upcoming(cases)
        for episode in episodes:
            ahead.reach(episode.spec.run)
            yield episode, self.twin(episode, ahead)

    def judge(self, requirement: Requirement, check: Check | None = None) -> CampaignVerdict:
        """The verdict of a requirement on pairs; its counts are counts of pairs.

        Raises:
            ConfigurationError: For a check or measure that cannot be used.
        """
        check_comparison(requirement)
        campaign, cases = self.campaign, [self.campaign.case, self.case]
        course = campaign.course_of(requirement, check, self.case.id)
        declared = campaign.is_declared(requirement, check)

        def judged() -> Iterator[tuple[RunJudgement, Sequence[JudgedEpisode]]]:
            for pair in self._with_twins(campaign.in_order(cases, course), cases):
                yield _judged_pair(requirement, check, pair, declared=declared), pair

        self._report_monitors(campaign.decide(course, judged()))
        return course.verdict()

    def monitors(self) -> list[MonitorQuality]:
        """Quality of the monitors on all planned runs without recovery, where they cannot act.

        Raises:
            ConfigurationError: If it is not the recovery that the twins lack.
        """
        if self.without != _RECOVERY:
            raise ConfigurationError(
                "monitors are judged where nobody acts on their word",
                key="without",
                found=self.without,
                expected=_RECOVERY,
                remedy=f'compare with campaign.paired(without="{_RECOVERY}")',
            )
        return self._monitors([episode.spec.run for episode, _ in self])

    def _monitors(self, runs: Sequence[int]) -> list[MonitorQuality]:
        def twins() -> Iterator[JudgedEpisode]:
            return (self.campaign.runner.fetch(self.case, run) for run in runs)

        return _monitor_qualities(twins, self.campaign.runner.requirements_of(self.case))

    def _report_monitors(self, runs: Sequence[int]) -> None:
        if self.without == _RECOVERY:
            measured = MonitorsMeasured(self.case, self._monitors(runs))
            self.campaign.runner.events.emit(measured)

    def require(
        self,
        check: Check = "",
        at_most: float | None = None,
        confidence: float | None = None,
        method: Method | None = None,
        p0: float | None = None,
        *,
        measure: str = "",
        change_at_most: float | None = None,
    ) -> CampaignVerdict:
        """The verdict on the pairs, if the campaign supports it.

        Args:
            check: No pair, or at most a share, may violate it only with what the twins lack.
            at_most: Greatest acceptable rate of such pairs; by default there may be none.
            confidence: As in :meth:`Campaign.require`.
            method: As there.
            p0: As there.
            measure: Import path of a function of an episode to a number, in place of a check.
            change_at_most: By how much the measure may grow in a pair.

        Raises:
            RequirementViolated: If it is violated or undecided.
            ConfigurationError: For a check or measure that cannot be used, and what is not as the
                requirement's file says.
        """
        __tracebackhide__ = True
        given: dict[str, Any] = {"at_most": at_most, "confidence": confidence}
        given |= {"method": method, "p0": p0}
        if check:
            given |= {"check": check_name(check)}
        own = self.campaign.requirement
        own = own or Requirement(check_name(check) or measure, kind="recovery")
        try:
            if change_at_most is not None:
                change_at_most = finite_number("change_at_most", change_at_most)
            paired = Paired(self.without, measure, change_at_most)
            if own.paired is not None and paired == Paired(self.without):
                paired = replace(own.paired, without=self.without)
            known = self.campaign.runner.library().requirements
            requirement = requirement_of_call(own, known, given | {"paired": paired})
            verdict = self.judge(requirement, check or None)
        except ConfigurationError as error:
            raise error.with_traceback(None) from None
        return self.campaign.report_verdict(verdict, requirement)

    def counts(self, check: Check) -> PairCounts:
        """How many of all planned pairs violate a check in both runs, one of them, or neither."""
        __tracebackhide__ = True
        requirement = Requirement(check_name(check), check=check_name(check))
        pairs = []
        try:
            for episode, twin in self:
                own = judge_episode(requirement, episode, check)
                other = judge_episode(requirement, twin, check)
                pairs.append(Pair(own, other, bool(episode.metrics.recoveries)))
        except ConfigurationError as error:
            raise error.with_traceback(None) from None
        return judge_pairs(pairs)

    def change(self, measure: str | Callable[[Episode], float]) -> Change:
        """By how much a measure differs in each of the planned pairs.

        Args:
            measure: A function of an episode to a number, or its import path. NaN is no value.
        """
        __tracebackhide__ = True
        try:
            values = {
                episode.id: (_measured_value(measure, episode), _measured_value(measure, twin))
                for episode, twin in self
            }
        except ConfigurationError as error:
            raise error.with_traceback(None) from None
        return Change.between(check_name(measure), values)


def _judged_pair(
    requirement: Requirement,
    check: Check | None,
    pair: tuple[JudgedEpisode, JudgedEpisode],
    *,
    declared: bool,
) -> RunJudgement:
    """What a requirement on pairs says of both runs of a pair, as far as they do not have it."""
    episode, twin = pair
    assert requirement.paired is not None
    measure = requirement.paired.measure
    if measure:
        own, other = (finite_or_infinite(_measured_value(measure, each)) for each in pair)
        return RunJudgement(episode.digest, episode.spec.run, twin.digest, values=(own, other))
    verdicts = [judge_run(requirement, each, check) for each in pair]
    stated = [None, None] if declared else verdicts
    return RunJudgement(episode.digest, episode.spec.run, twin.digest, *stated)


def _measured_value(measure: str | Callable[[Episode], float], episode: Episode) -> float | None:
    """The measure of a run; ``None`` of a run that is invalid, missing or ended early."""
    whole = episode.validity == "valid" and episode.termination != "decided"
    return measured(measure, episode) if whole else None


def _twin_case(case: Case, without: str) -> Case:
    """The case of the twins.

    Raises:
        ConfigurationError: If there is no such role, or there are no faults.
    """
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
