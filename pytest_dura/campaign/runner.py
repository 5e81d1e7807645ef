"""Bench: runs cases by name, each episode once, and asks campaigns for verdicts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from pytest_dura.campaign.cases import Case, FaultCampaign, expand_cases, no_match
from pytest_dura.campaign.loading import Library
from pytest_dura.campaign.store import EpisodeStore
from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import ConfigurationError, DuraError
from pytest_dura.core.orchestrator import Orchestrator
from pytest_dura.core.roles import RoleSpec
from pytest_dura.core.state import NOTHING
from pytest_dura.requirements.campaigns import CampaignVerdict, judge_campaign
from pytest_dura.requirements.episodes import judge_episode
from pytest_dura.requirements.judge import RequirementJudge
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.verdicts import JudgedEpisode

EXTRA_SHARE = 0.2
"""Further runs that may follow invalid ones, as a share of the planned runs."""

Metrics = Mapping[str, Callable[[Episode], float]]


def _nobody_listens(*_: object) -> None:
    """What a bench tells when nobody asked."""


class RequirementViolated(DuraError):  # noqa: N818 - it is an outcome, not an error
    """A campaign does not support a requirement. ``verdict`` holds the counts it rests on."""

    def __init__(self, message: str, verdict: CampaignVerdict) -> None:
        self.verdict = verdict
        super().__init__(message)


@dataclass(repr=False)
class Bench:
    """What the ``orchestrator`` fixture returns.

    Args:
        library: All scenarios and requirements, read at the first call.
        base_seed: From which the seed of each run follows.
        roles: Roles that replace those of the scenarios and domains; ``None`` switches one off.
        simulator: Replaces the scenarios' simulators.
        runs: Replaces the planned runs of every campaign.
        metrics: User-defined metrics by name.
        on_episode: Told of every use of an episode: the case, the episode, and how many were
            planned of this case; 0 if the episode's seed was chosen by hand.
        on_progress: Told how many runs of a case are done and planned.
        on_verdict: Told of every verdict of :meth:`Campaign.require`, and what it decides.
    """

    library: Callable[[], Library]
    base_seed: int = 0
    roles: Mapping[str, RoleSpec | None] = field(default_factory=dict)
    simulator: RoleSpec | None = None
    runs: int | None = None
    metrics: Metrics = NOTHING
    on_episode: Callable[[Case, JudgedEpisode, int], None] = _nobody_listens
    on_progress: Callable[[Case, int, int], None] = _nobody_listens
    on_verdict: Callable[[CampaignVerdict, Requirement], None] = _nobody_listens
    store: EpisodeStore = field(default_factory=EpisodeStore)

    def __repr__(self) -> str:
        return f"Bench(base_seed={self.base_seed})"

    def run(
        self,
        name: str,
        seed: int | None = None,
        run: int = 0,
        faults: FaultCampaign | None = None,
    ) -> JudgedEpisode:
        """One episode of a scenario or case, by its name.

        Args:
            name: Such as ``intersection/nominal`` or ``intersection/nominal+ghost-obstacle``.
            seed: Seed of the episode; by default that of the run within the case.
            run: Number of the run.
            faults: Replaces the scenario's faults; ``none`` strips them.

        Raises:
            ConfigurationError: For an unknown name or fault.
        """
        __tracebackhide__ = True
        try:
            return self.episode(self.case(name, faults), run, seed)
        except ConfigurationError as error:
            raise error.with_traceback(None) from None

    def case(self, name: str, faults: FaultCampaign | None = None) -> Case:
        """The case of this id, or of a scenario's name with these faults.

        Raises:
            ConfigurationError: For an unknown scenario or fault.
        """
        scenario, plus, of_id = name.partition("+")
        scenarios = self.library().scenarios
        if scenario not in scenarios:
            raise no_match(scenario, list(scenarios), "scenario")
        if faults is None and plus:
            faults = of_id
        return expand_cases([scenarios[scenario]], None if faults is None else [faults])[0]

    def episode(
        self, case: Case, run: int = 0, seed: int | None = None, planned: int = 1
    ) -> JudgedEpisode:
        """One run of a case; simulated once per process.

        Args:
            case: The case.
            run: Number of the run.
            seed: Seed of the episode; by default that of the run within the case.
            planned: How many runs of this case are planned.

        Raises:
            ConfigurationError: If a role or the simulator cannot be built.
        """
        __tracebackhide__ = True
        spec = case.spec(run, self.base_seed, self.roles, simulator=self.simulator, seed=seed)
        try:
            episode = self.store.get(spec, lambda spec: self._simulate(case, spec))
        except ConfigurationError as error:
            raise error.with_traceback(None) from None
        self.on_episode(case, episode, planned if seed is None else 0)
        return episode

    def campaign(
        self, case: Case | str, runs: int | None = None, requirement: Requirement | None = None
    ) -> Campaign:
        """All planned runs of a case.

        Args:
            case: The case, or its name.
            runs: Planned runs instead of the scenario's.
            requirement: What :meth:`Campaign.require` decides.
        """
        found = self.case(case) if isinstance(case, str) else case
        planned = self.runs or runs or found.scenario.runs
        return Campaign(self, found, planned, requirement)

    def _simulate(self, case: Case, spec: EpisodeSpec) -> JudgedEpisode:
        judge = None
        if spec.termination.violation:
            judge = RequirementJudge(
                [self.library().requirements[name] for name in case.requirements]
            )
        return JudgedEpisode.of(run_episode(spec, judge, self.metrics))


@dataclass(repr=False)
class Campaign:
    """All episodes of a case that a verdict rests on."""

    bench: Bench
    case: Case
    planned: int
    requirement: Requirement | None = None

    def __repr__(self) -> str:
        return f"Campaign({self.case.id!r}, {self.planned} runs planned)"

    @property
    def component(self) -> str:
        """Name of the component under test."""
        return self.case.roles(self.bench.roles)["generator"].label

    @property
    def episodes(self) -> list[JudgedEpisode]:
        """The planned runs, and a further run for each invalid one as far as the budget goes."""
        return list(self)

    def __iter__(self) -> Iterator[JudgedEpisode]:
        budget = math.ceil(EXTRA_SHARE * self.planned)
        run, end = 0, self.planned
        while run < end:
            self.bench.on_progress(self.case, run, end)
            episode = self.bench.episode(self.case, run, planned=self.planned)
            yield episode
            if episode.validity == "invalid" and end < self.planned + budget:
                end += 1
            run += 1
        self.bench.on_progress(self.case, run, end)

    def judge(
        self, requirement: Requirement, at_most: float | None = None, confidence: float = 0.95
    ) -> CampaignVerdict:
        """The verdict of a requirement's check on all episodes.

        Raises:
            ConfigurationError: For a check that cannot be read, or a rate outside (0, 1).
        """
        verdicts = [judge_episode(requirement, episode) for episode in self]
        return judge_campaign(
            requirement.id,
            self.case.id,
            verdicts,
            planned=self.planned,
            component=self.component,
            at_most=at_most,
            confidence=confidence,
        )

    def require(
        self, check: str, at_most: float | None = None, confidence: float = 0.95
    ) -> CampaignVerdict:
        """The verdict of a formula, if the campaign supports it.

        Args:
            check: Formula over signals.
            at_most: Greatest acceptable rate of episodes that violate it; by default none may.
            confidence: One-sided confidence of the bound on that rate.

        Raises:
            RequirementViolated: If it is violated or undecided.
            ConfigurationError: For a formula that cannot be read, or a rate outside (0, 1).
        """
        __tracebackhide__ = True
        named = self.requirement or Requirement(id=check)
        requirement = Requirement(
            named.id, named.text, named.kind, named.source, check, named.reason
        )
        try:
            verdict = self.judge(requirement, at_most, confidence)
        except ConfigurationError as error:
            raise error.with_traceback(None) from None
        self.bench.on_verdict(verdict, requirement)
        if verdict.verdict != "supported":
            message = "\n".join(reasons(verdict, requirement, self.episodes))
            raise RequirementViolated(message, verdict)
        return verdict


def run_episode(
    spec: EpisodeSpec, judge: RequirementJudge | None = None, metrics: Metrics = NOTHING
) -> Episode:
    """The episode of a spec: the same spec gives the same trace, on any machine, in any order.

    Raises:
        ConfigurationError: If a part cannot be built.
    """
    orchestrator = Orchestrator.build(spec, judge, metrics)
    try:
        return orchestrator.run(spec)
    finally:
        if not spec.simulator.opaque:
            orchestrator.simulator.close()


def reasons(
    verdict: CampaignVerdict, requirement: Requirement, episodes: Sequence[Episode]
) -> list[str]:
    """Why a verdict is not "supported": what, in which run, when and by how much, line by line."""
    what = f"{verdict.verdict}: {verdict.requirement} on {verdict.case} ({verdict.component})"
    lines = [f"{what}: {verdict.reason}"]
    failures = [episode for episode in episodes if episode.failure is not None]
    if failures and verdict.verdict == "undecided":
        lines.insert(0, f"{failures[0].failure} (in {failures[0].id})")
    if requirement.text:
        lines.append(f"required: {requirement.text}")
    if requirement.check and requirement.check != verdict.requirement:
        lines.append(f"check:    {requirement.check}")
    if verdict.counterexamples:
        worst = verdict.counterexamples[0]
        lines.append(f"worst:    {describe_counterexample(asdict(worst))}")
        others = [one.episode.rpartition("#")[2] for one in verdict.counterexamples[1:]]
        if others:
            lines.append(f"also in:  {_runs(others)}")
    invalid = [one for one in episodes if one.validity == "invalid"]
    if invalid and verdict.verdict == "undecided":
        lines.append(f"invalid:  {invalid[0].id}: {invalid[0].invalid_reason}")
    failed = component_failure(episodes)
    if failed:
        lines.append(f"component: {failed}")
    return lines


def describe_counterexample(example: Mapping[str, Any]) -> str:
    """In which run, when, and by how much; from a counterexample's plain data."""
    time, margin = example["time"], example["margin"]
    when = "" if time is None else f" at t = {time:.2f} s"
    by = ""
    if margin is not None:
        by = f", by {abs(margin):.3g}" if margin else ", right at the bound"
    return f"{example['episode']}{when}{by}"


def component_failure(episodes: Sequence[Episode]) -> str | None:
    """The first failure of the component itself, and in how many episodes there was one."""
    first, count = None, 0
    for episode in episodes:
        for event in episode.events:
            if event.kind == "component_failure":
                first = first or f"{event.subject} {event.detail} (t = {event.time:.2f} s)"
                count += 1
                break
    return None if first is None else f"{first}; in {count} of {len(episodes)} episodes"


def _runs(numbers: Sequence[str]) -> str:
    shown = ", ".join(f"#{number}" for number in numbers[:8])
    return shown + (f" and {len(numbers) - 8} more" if len(numbers) > 8 else "")
