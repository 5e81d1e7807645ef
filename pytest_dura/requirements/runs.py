"""Run: what a run says of itself, and what the requirements of its case say of it.

Every verdict on a campaign rests on runs alone, whether they have just been simulated or are read
from a record.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.episode_verdicts import (
    EARLY_ENDS,
    CheckVerdict,
    EpisodeVerdict,
    judge_run,
)
from pytest_dura.requirements.model import Requirement


@dataclass(frozen=True, slots=True)
class Run:
    """A run of a case, without its signals.

    Args:
        episode: Id of the episode, ``case#run``.
        case: Id of its case.
        number: Number of the run.
        component: Name of the component under test.
        digest: Of the episode.
        validity: ``valid``, ``invalid`` or ``missing``.
        termination: What ended it.
        failure: Message of the infrastructure error, if there was one.
        invalid_reason: Which planned fault never manifested, if one did not.
        proposals: How often the component was asked.
        valid_proposals: How often it answered with a valid action.
        not_manifested: Ids of planned faults that never manifested.
        recovered: Whether recovery acted.
        trajectory: SHA-256 of the course of the run.
        drawn: Whether a random number was drawn from a stream of its seed.
        verdicts: On the requirements that its case declares, by id; none on a requirement without
            a check, and on one whose check cannot be judged on this run.
        violates: Whether it violates one of these that a single run can violate.
    """

    episode: str
    case: str
    number: int
    component: str
    digest: str
    validity: str
    termination: str
    failure: str | None
    invalid_reason: str | None
    proposals: int
    valid_proposals: int
    not_manifested: tuple[str, ...]
    recovered: bool
    trajectory: str
    drawn: bool
    verdicts: Mapping[str, CheckVerdict]
    violates: bool

    @classmethod
    def of(cls, episode: Episode, requirements: Iterable[Requirement] = ()) -> Run:
        """Take it from an episode.

        Args:
            episode: The episode.
            requirements: Those that its case declares.
        """
        declared = list(requirements)
        verdicts = declared_verdicts(episode, declared)
        return cls(
            episode.id,
            episode.spec.case,
            episode.spec.run,
            episode.spec.component,
            episode.digest,
            episode.validity,
            episode.termination,
            episode.failure,
            episode.invalid_reason,
            episode.metrics.proposals,
            episode.metrics.valid_proposals,
            episode.not_manifested,
            bool(episode.metrics.recoveries),
            episode.trajectory,
            episode.drawn,
            verdicts,
            violates_alone(verdicts, declared),
        )

    @property
    def is_unseen_crash(self) -> bool:
        """Whether it ended critical and violates no requirement on single runs of its case."""
        return self.termination == "critical" and not self.violates

    def verdict(self, requirement: str, stated: CheckVerdict | None = None) -> EpisodeVerdict:
        """Make the verdict of a requirement on this run.

        Args:
            requirement: Its id.
            stated: What its check says; by default the run's own verdict on it.

        Raises:
            KeyError: If the run has no verdict on it.
        """
        judged = self.verdicts[requirement] if stated is None else stated
        return EpisodeVerdict(
            requirement=requirement,
            episode=self.episode,
            component=self.component,
            verdict=judged.status,
            margin=judged.margin,
            time=judged.time,
            detail=judged.detail,
            proposals=self.proposals,
            valid_proposals=self.valid_proposals,
            vacuous=judged.vacuous,
            not_manifested=self.not_manifested,
            without_effect=judged.status == "violated" and self.validity == "invalid",
            ended=self.termination if self.termination in EARLY_ENDS else "",
        )


def declared_verdicts(
    episode: Episode, requirements: Iterable[Requirement]
) -> dict[str, CheckVerdict]:
    """Verdicts of an episode on the requirements that its case declares.

    Args:
        episode: The episode.
        requirements: Those of its case. One without a check has no verdict; nor has one whose
            check cannot be judged, which is an error once an item asks for it.
    """
    verdicts = {}
    for requirement in requirements:
        if requirement.check:
            try:
                verdicts[requirement.id] = judge_run(requirement, episode)
            except ConfigurationError:
                continue
    return verdicts


def violates_alone(
    verdicts: Mapping[str, CheckVerdict], requirements: Iterable[Requirement]
) -> bool:
    """Whether a run violates a requirement that sees the crash of a run, and not of pairs alone."""
    return any(
        requirement.judges_crashes
        and requirement.id in verdicts
        and verdicts[requirement.id].status == "violated"
        for requirement in requirements
    )
