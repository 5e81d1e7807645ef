"""Bench: runs cases by name, each episode once, and asks campaigns for verdicts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from pytest_dura.campaign.campaigns import Campaign
from pytest_dura.campaign.cases import WITHOUT, Case, FaultCampaign, expand_cases, no_match
from pytest_dura.campaign.loading import Library
from pytest_dura.campaign.store import EpisodeStore
from pytest_dura.core.episode import Episode, EpisodeSpec
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.orchestrator import Orchestrator
from pytest_dura.core.roles import RoleSpec
from pytest_dura.core.state import NOTHING
from pytest_dura.requirements.judge import RequirementJudge
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.monitoring.quality import MonitorQuality
from pytest_dura.requirements.verdicts import JudgedEpisode
from pytest_dura.requirements.verdicts.campaigns import CampaignVerdict

Metrics = Mapping[str, Callable[[Episode], float]]


def _nobody_listens(*_: object) -> None:
    """What a bench tells when nobody asked."""


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
        on_monitors: Told how good the monitors of a case are, wherever that was measured.
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
    on_monitors: Callable[[Case, list[MonitorQuality]], None] = _nobody_listens
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
        name, *off = name.split(WITHOUT)
        scenario, plus, of_id = name.partition("+")
        scenarios = self.library().scenarios
        if scenario not in scenarios:
            raise no_match(scenario, list(scenarios), "scenario")
        if faults is None and plus:
            faults = of_id
        case = expand_cases([scenarios[scenario]], None if faults is None else [faults])[0]
        for role in off:
            case = case.switched_off(role)
        return case

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
        self,
        case: Case | str,
        runs: int | None = None,
        requirement: Requirement | None = None,
        *,
        until_decided: bool | None = None,
    ) -> Campaign:
        """All planned runs of a case.

        Args:
            case: The case, or its name.
            runs: Planned runs instead of the scenario's.
            requirement: What :meth:`Campaign.require` decides.
            until_decided: Whether runs end once the requirement is decided, instead of what the
                scenario says.
        """
        found = self.case(case) if isinstance(case, str) else case
        planned = self.runs or runs or found.scenario.planned
        if until_decided is None:
            until_decided = found.scenario.until_decided and runs is None
        return Campaign(self, found, planned, requirement, until_decided)

    def _simulate(self, case: Case, spec: EpisodeSpec) -> JudgedEpisode:
        judge = None
        if spec.termination.violation:
            judge = RequirementJudge(
                [self.library().requirements[name] for name in case.requirements]
            )
        return JudgedEpisode.of(run_episode(spec, judge, self.metrics))


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
