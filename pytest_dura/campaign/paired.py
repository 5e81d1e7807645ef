"""PairedCampaign: runs of a case beside runs of equal seeds that lack something."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from pytest_dura.campaign.cases import NO_FAULTS, Case, expand_cases
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.campaigns import CampaignVerdict
from pytest_dura.requirements.checks import Check, check_name
from pytest_dura.requirements.episodes import EpisodeVerdict, JudgedEpisode, judge_episode
from pytest_dura.requirements.model import FAULTS, Method, Paired, Requirement
from pytest_dura.requirements.pair_verdicts import change_verdict, measured, pair_verdict
from pytest_dura.requirements.pairs import Pair, PairCounts, judge_pairs

if TYPE_CHECKING:
    from pytest_dura.campaign.campaigns import Campaign


class PairedCampaign:
    """Pairs of episodes: one of a campaign, and its twin of the same seed without something.

    Args:
        campaign: The campaign.
        without: ``faults``, or the name of a role that is switched off in the twins.

    Raises:
        ConfigurationError: If there is no such role, or there are no faults.
    """

    def __init__(self, campaign: Campaign, without: str) -> None:
        self.campaign, self.without = campaign, without
        self.case = twin_case(campaign.case, without)
        # Told before anything runs, where the role is not there to be switched off.
        self.case.roles(campaign.bench.roles)

    def __repr__(self) -> str:
        return f"PairedCampaign({self.campaign.case.id!r}, without={self.without!r})"

    def __iter__(self) -> Iterator[tuple[JudgedEpisode, JudgedEpisode]]:
        """The pairs of all planned runs."""
        for episode in self.campaign:
            yield episode, self.twin(episode)

    @cached_property
    def pairs(self) -> list[tuple[JudgedEpisode, JudgedEpisode]]:
        """The pairs of all planned runs: the episode, and its twin."""
        return list(self)

    def twin(self, episode: JudgedEpisode) -> JudgedEpisode:
        """The episode of the same run and seed without something."""
        return self.campaign.bench.episode(
            self.case, episode.spec.run, planned=self.campaign.planned
        )

    def judge(self, requirement: Requirement, check: Check | None = None) -> CampaignVerdict:
        """The verdict of a requirement on pairs; its counts are counts of pairs.

        Raises:
            ConfigurationError: For a check or measure that cannot be used.
        """
        campaign = self.campaign
        judge = campaign._judge(requirement)  # noqa: SLF001 - the other half of one campaign
        campaign.judged, counted = [], []
        for episode in campaign.enough_for(judge):
            twin = self.twin(episode)
            verdict, pair = self._pair(requirement, episode, twin, check)
            judge.add(verdict)
            counted.append(pair)
            campaign.judged += [episode, twin]
        found = judge.verdict()
        table = {} if None in counted else self._counts([one for one in counted if one]).to_json()
        return replace(found, pairs={"without": self.without, "case": self.case.id, **table})

    def require(
        self,
        check: Check = "",
        at_most: float | None = None,
        confidence: float = 0.95,
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
            ConfigurationError: For a check or measure that cannot be used.
        """
        __tracebackhide__ = True
        name = check_name(check) or measure
        requirement = replace(
            self.campaign.requirement or Requirement(id=name, kind="recovery"),
            check=check_name(check),
            at_most=at_most,
            confidence=confidence,
            method=method,
            p0=p0,
            paired=Paired(self.without, measure, change_at_most),
        )
        try:
            verdict = self.judge(requirement, check or None)
        except ConfigurationError as error:
            raise error.with_traceback(None) from None
        return self.campaign.decided(verdict, requirement)

    def counts(self, check: Check) -> PairCounts:
        """How many of all planned pairs violate a check in both runs, one of them, or neither."""
        requirement = Requirement(check_name(check), check=check_name(check))
        return self._counts(
            [
                _counted(episode, *_verdicts(requirement, episode, twin, check))
                for episode, twin in self
            ]
        )

    def _counts(self, pairs: list[Pair]) -> PairCounts:
        return judge_pairs(pairs)

    def _pair(
        self,
        requirement: Requirement,
        episode: JudgedEpisode,
        twin: JudgedEpisode,
        check: Check | None,
    ) -> tuple[EpisodeVerdict, Pair | None]:
        paired = requirement.paired
        assert paired is not None
        if paired.measure:
            values = measured(paired.measure, episode), measured(paired.measure, twin)
            return change_verdict(requirement, episode, twin, values), None
        verdicts = _verdicts(requirement, episode, twin, check)
        return pair_verdict(*verdicts), _counted(episode, *verdicts)


def twin_case(case: Case, without: str) -> Case:
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
    bare = expand_cases([case.scenario], [NO_FAULTS])[0]
    for role in case.without:
        bare = bare.switched_off(role)
    return bare


def _verdicts(
    requirement: Requirement, episode: JudgedEpisode, twin: JudgedEpisode, check: Check | None
) -> tuple[EpisodeVerdict, EpisodeVerdict]:
    return judge_episode(requirement, episode, check), judge_episode(requirement, twin, check)


def _counted(episode: JudgedEpisode, own: EpisodeVerdict, twin: EpisodeVerdict) -> Pair:
    acted: dict[str, Any] = {"acted": bool(episode.metrics.recoveries)}
    return Pair(own, twin, **acted)
