"""Qualifying: runs the gate of a suite on mutants, and says which requirement catches each.

A mutant is caught where the gate would fail by it and passes without it: a requirement that the
part as it is supports is violated with the mutant, or undecided since runs with it are no sample,
such as those of faults that never manifest. A run that an infrastructure error ended shows nothing
of the suite: such a mutant counts as not caught, and is named.

Monitors, recoveries and assessors are run with provokers besides, components that need them. There
the gate fails in any case: what counts is a run that satisfies a requirement with the part as it is
and violates it with the mutant, on the same seed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

from pytest_dura import guests
from pytest_dura.campaign.campaign import Campaign
from pytest_dura.campaign.events import EventStream, Progress
from pytest_dura.campaign.runner import Runner
from pytest_dura.core.episode import EpisodeSpec, canonical
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.domains import Domain
from pytest_dura.execution.task import EpisodeTask
from pytest_dura.library.cases import Case
from pytest_dura.library.scenario import simulator_class
from pytest_dura.qualification.mutant import SIMULATOR, Mutant, provoking, registered_mutants
from pytest_dura.qualification.requirement import RequirementMutant, requirement_mutants
from pytest_dura.qualification.results import (
    REPEATABILITY,
    VALIDITY,
    Kill,
    Margin,
    Qualified,
    Status,
)
from pytest_dura.requirements.campaign_verdicts import CampaignVerdict
from pytest_dura.requirements.checks import is_function_path, read_formula
from pytest_dura.requirements.episode_verdicts import JudgedEpisode, judge_run
from pytest_dura.requirements.model import Requirement

RUNS = 3
"""Runs of each case with a mutant, at most."""
_WHOLE = 0.999
"""Share of a margin from which on it is taken as whole."""
PROVOKED = ("safety_monitor", "recovery_planner", "security_assessor")
"""Parts that a sound component does not need."""


AnyMutant = Mutant | RequirementMutant


@dataclass(frozen=True)
class Gate:
    """A case and the requirements that judge it in the suite."""

    case: Case
    requirements: tuple[Requirement, ...]


class MutantCampaign(Campaign):
    """Runs of a case with a mutant, whose component may be another one than the case names."""

    @property
    def component(self) -> str:
        """Name of the component that the runs have."""
        return self.runner.task(self.case).spec.component


@dataclass
class Qualification:
    """Runs the gate of a suite on mutants.

    Args:
        runner: Of the session.
        gates: The cases, each with the requirements that judge it.
        runs: Runs of each case, at most.
    """

    runner: Runner
    gates: Sequence[Gate]
    runs: int = RUNS

    def __post_init__(self) -> None:
        """Order the gates: what has more requirements is more likely to catch something."""
        self.gates = sorted(self.gates, key=lambda gate: -len(gate.requirements))
        events = EventStream()
        events.subscribe(Progress, self.runner.events.emit)
        runs = self.runner.runs
        self.runs = self.runs if runs is None else min(self.runs, runs)
        self.runner = replace(self.runner, events=events, twins=False, recorded=False, runs=None)
        self._has_plan = False
        self._plain: dict[tuple[str, str, str], CampaignVerdict] = {}

    def qualify(self, mutant: AnyMutant) -> Qualified:
        """Run the gate on a mutant: one run of each case, then the others unless it is caught."""
        if isinstance(mutant, RequirementMutant):
            return self._qualify_requirement(mutant)
        fitting = self.arms(mutant)
        result = Qualified(mutant.name, mutant.role, mutant.described, "not run")
        if not fitting:
            return replace(result, problem=f"no case has a {mutant.role} that can be wrapped")
        for runs in sorted({1, self.runs}):
            self._simulate([task for arm in fitting for task in arm.tasks(runs)])
            for arm in fitting:
                arm.run(runs)
            kills = tuple(kill for arm in fitting for kill in arm.kills())
            if kills:
                break
        else:
            own = (arm for arm in fitting if not arm.provoker)
            again = (kill for arm in own for kill in arm.unrepeatable())
            kills = _undecided(fitting) or tuple(islice(again, 1))  # one is enough
        return replace(
            result,
            status=_status(fitting, kills),
            runs=sum(arm.episodes for arm in fitting),
            kills=kills,
            nearest=None if kills else _nearest(fitting),
            problem=next((arm.problem for arm in fitting if arm.problem), ""),
        )

    def _qualify_requirement(self, mutant: RequirementMutant) -> Qualified:
        """Judge the runs of the suite and of provokers by a requirement with a defect."""
        kills, judged, name = [], 0, mutant.changed.id
        for gate in self.gates:
            known = next((each for each in gate.requirements if each.id == name), None)
            if known is None:
                continue
            for provoker, runner in (("", self.runner), *self._provoked(gate.case)):
                plain = self._judged(provoker, runner, gate.case, known, self.runs)
                with_it = Campaign(runner, gate.case, self.runs).judge(mutant.changed)
                judged += with_it.run
                if provoker:  # runs that it lets pass
                    runs, why = _violating(plain) - _violating(with_it), "lets pass"
                    fails = bool(runs) and _is_whole(with_it)
                else:
                    runs, why = _violating(with_it), with_it.verdict
                    fails = with_it.verdict == "violated" or _no_sample(with_it)
                    fails &= plain.verdict == "supported"
                if fails:
                    first = min(runs, default=0)
                    kill = Kill(name, gate.case.id, provoker, first, with_it.run, len(runs), why)
                    kills.append(kill)
        status: Status = "caught" if kills else "survived"
        return Qualified(mutant.name, mutant.role, mutant.described, status, judged, tuple(kills))

    def _provoked(self, case: Case) -> Iterator[tuple[str, Runner]]:
        """Yield the provokers of a case with a runner for each."""
        for name, component in self._provokers(case):
            roles = {**self.runner.roles, "generator": component}
            yield name, replace(self.runner, roles=roles)

    def plan(self, mutants: Iterable[AnyMutant]) -> None:
        """Let idle processes begin what mutants need in any case; a second call does nothing.

        Args:
            mutants: All that will be qualified, in their order.
        """
        if not self._has_plan:
            self._has_plan = True
            later = [each for each in mutants if isinstance(each, Mutant)]
            self.runner.store.plan(
                task for mutant in later for arm in self.arms(mutant) for task in arm.tasks(1)
            )

    def _simulate(self, tasks: Sequence[EpisodeTask]) -> None:
        """Simulate episodes, as many at a time as the executor does."""
        with self.runner.store.steady():
            for number, task in enumerate(tasks, 1):
                self.runner.store.get(task, tasks[number:])

    def arms(self, mutant: Mutant) -> list[Arm]:
        """List the cases that have the part, each with the suite's component and with provokers."""
        return [arm for arm in self._arms(mutant) if arm.fits]

    def _arms(self, mutant: Mutant) -> Iterator[Arm]:
        provoked = mutant.role in PROVOKED
        for gate in self.gates:
            yield Arm(self, gate, mutant, "", self.runner)
            for name, runner in self._provoked(gate.case) if provoked else ():
                yield Arm(self, gate, mutant, name, runner)

    def _provokers(self, case: Case) -> Iterator[tuple[str, RoleSpec]]:
        """Yield components that need their monitor: the domain's, or mutants of the suite's."""
        domain = case.scenario.system
        names = () if domain is None else domain.provokers
        for name in names:
            assert domain is not None
            yield name, RoleSpec(domain.short_names["generator"][name])
        own = case.roles(self.runner.roles)["generator"]
        if not names and not guests.reason_to_stay(own):
            yield from provoking(domain, own)

    def plain(self, arm: Arm, requirement: Requirement, runs: int) -> CampaignVerdict:
        """Verdict without the mutant, on the same runs; the same for all mutants."""
        return self._judged(arm.provoker, arm.runner, arm.gate.case, requirement, runs)

    def _judged(
        self, provoker: str, runner: Runner, case: Case, requirement: Requirement, runs: int
    ) -> CampaignVerdict:
        key = provoker, case.id, f"{requirement.id} {runs}"
        if key not in self._plain:
            self._plain[key] = Campaign(runner, case, runs).judge(requirement)
        return self._plain[key]


class Arm:
    """A case with a mutant, and with a provoker as its component or its own.

    Args:
        qualification: That it belongs to.
        gate: The case with its requirements.
        mutant: The mutant.
        provoker: Name of the provoker; empty for the suite's own component.
        runner: Runs the case without the mutant.
    """

    def __init__(
        self,
        qualification: Qualification,
        gate: Gate,
        mutant: Mutant,
        provoker: str,
        runner: Runner,
    ) -> None:
        self.qualification, self.gate, self.mutant = qualification, gate, mutant
        self.provoker, self.runner = provoker, runner
        self.problem = ""
        self.episodes = 0
        self._verdicts: dict[str, CampaignVerdict] = {}
        self._asked = 0
        self._mutated = replace(runner, mutation=self._changed)

    @property
    def fits(self) -> bool:
        """Whether the case has the part, and another process may build it anew."""
        part = self._part(self.runner.task(self.gate.case).spec)
        if part is None or part.opaque or not self._is_needed:
            return False
        if self.mutant.role == SIMULATOR:
            return getattr(simulator_class(part), "instances", "many") == "many"
        return not guests.reason_to_stay(part)

    @property
    def _is_needed(self) -> bool:
        """Whether the case has something for the part to do: an injector has faults to inject."""
        return self.mutant.role != "fault_injector" or bool(self.gate.case.faults)

    def _part(self, spec: EpisodeSpec) -> RoleSpec | None:
        role = self.mutant.role
        return spec.simulator if role == SIMULATOR else spec.roles.get(role)

    def _changed(self, case: Case, spec: EpisodeSpec) -> EpisodeSpec:
        """Put the mutant around the part; a case that lacks it, or has a reference, stays."""
        part, role = self._part(spec), self.mutant.role
        if part is None or (role == "generator" and case.reference):
            return spec
        mutated = self.mutant.around(part)
        if role == SIMULATOR:
            return replace(spec, simulator=mutated)
        return replace(spec, roles={**spec.roles, role: mutated})

    def run(self, runs: int) -> None:
        """Judge all requirements on so many runs with the mutant."""
        self._asked = runs
        campaign = MutantCampaign(self._mutated, self.gate.case, runs)
        for requirement in self.gate.requirements:
            try:
                self._verdicts[requirement.id] = campaign.judge(requirement)
            except ConfigurationError as error:  # noqa: PERF203 - of one requirement alone
                self.problem = str(error).partition("\n")[0]
        episodes = [*self.runs_of(self._mutated)]
        self.episodes = len(episodes)
        failed = next((each.failure for each in episodes if each.failure is not None), None)
        self.problem = failed or self.problem

    def tasks(self, runs: int) -> Iterator[EpisodeTask]:
        """Yield the tasks of the first runs, with those of their pairs and without the mutant."""
        campaign = MutantCampaign(self._mutated, self.gate.case, runs)
        cases = {self.gate.case.id: self.gate.case}
        for requirement in self.gate.requirements:
            if (pairs := requirement.paired) is not None:
                other = campaign.paired(pairs.without, reference=pairs.reference).case
                cases[other.id] = other
        for run in range(runs):
            for case in cases.values():
                for runner in (self._mutated, self.runner):
                    yield runner.task(case, run)

    def runs_of(self, runner: Runner) -> Iterator[JudgedEpisode]:
        """Iterate over the runs with the mutant, or those without it."""
        return (runner.fetch(self.gate.case, run) for run in range(self._asked))

    def kills(self) -> Iterator[Kill]:
        """Yield what catches the mutant, of the runs by now."""
        for requirement in self.gate.requirements:
            with_it = self._verdicts.get(requirement.id)
            if with_it is None or with_it.verdict == "supported":
                continue
            plain = self.qualification.plain(self, requirement, self._asked)
            worse = _violating(with_it) - _violating(plain)
            if plain.verdict == "supported":
                if with_it.verdict == "violated":
                    yield self._kill(requirement, with_it, _violating(with_it), "violated")
            elif self.provoker and worse and _is_own(requirement) and _is_whole(plain):
                yield self._kill(requirement, with_it, worse, "violated")

    def undecided(self) -> Iterator[Kill]:
        """Yield a kill by the gate's rule on validity, if the runs with the mutant are no sample.

        No requirement catches such a mutant, whatever it says: nothing was judged.
        """
        for requirement in self.gate.requirements:
            with_it = self._verdicts.get(requirement.id)
            if with_it is None or not _no_sample(with_it):
                continue
            if self.qualification.plain(self, requirement, self._asked).verdict == "supported":
                why = f"undecided: {with_it.reason}"
                yield Kill(VALIDITY, self.gate.case.id, self.provoker, 0, with_it.run, 0, why)
                return

    def _kill(
        self, requirement: Requirement, with_it: CampaignVerdict, runs: set[int], why: str
    ) -> Kill:
        return Kill(
            requirement.id,
            self.gate.case.id,
            self.provoker,
            min(runs, default=0),
            with_it.run,
            len(runs),
            why,
        )

    def unrepeatable(self) -> Iterator[Kill]:
        """Yield a kill by the gate's repetition, if the first run comes out differently again."""
        task = self._mutated.task(self.gate.case)
        first = self._mutated.fetch(self.gate.case)
        if first.failure is not None:
            return
        again = self._mutated.store.repeat(task)
        self.episodes += 1
        self.problem = again.failure or self.problem
        if again.failure is None and again.digest != first.digest:
            why = "undecided: not repeatable"
            yield Kill(REPEATABILITY, self.gate.case.id, self.provoker, 0, self._asked, 1, why)

    @property
    def missing(self) -> bool:
        """Whether no run with the mutant came to an end."""
        return all(each.failure is not None for each in self.runs_of(self._mutated))

    @property
    def differs(self) -> bool:
        """Whether a run with the mutant differs from that without it in anything but its spec."""
        pairs = zip(self.runs_of(self._mutated), self.runs_of(self.runner), strict=True)
        return any(_course(own) != _course(other) for own, other in pairs)

    def margins(self) -> Iterator[Margin]:
        """Yield how near each requirement came."""
        for requirement in self.gate.requirements:
            with_it = self._verdicts.get(requirement.id)
            if with_it is None or requirement.paired or with_it.margin is None:
                continue
            plain = self.qualification.plain(self, requirement, self._asked).margin
            if plain is not None and plain > 0 and with_it.margin >= 0:
                yield Margin(
                    requirement.id, self.gate.case.id, self.provoker, with_it.margin, plain
                )

    def counted(self, margin: Margin) -> Margin:
        """Count the runs in which a requirement comes nearer with the mutant than without it."""
        requirement = next(each for each in self.gate.requirements if each.id == margin.requirement)
        known = (judge_run(requirement, each).margin for each in self.runs_of(self._mutated))
        own = [each for each in known if each is not None]
        return replace(margin, runs=len(own), nearer=sum(each < margin.before for each in own))


def _status(arms: Sequence[Arm], kills: Sequence[Kill]) -> Status:
    if kills:
        return "caught"
    if all(arm.missing for arm in arms):
        return "not run"
    return "survived" if any(arm.differs for arm in arms) else "no difference"


def _undecided(arms: Iterable[Arm]) -> tuple[Kill, ...]:
    return tuple(kill for arm in arms for kill in arm.undecided())


def _nearest(arms: Iterable[Arm]) -> Margin | None:
    margins = [(arm, margin) for arm in arms for margin in arm.margins() if margin.share < _WHOLE]
    if not margins:
        return None
    arm, margin = min(margins, key=lambda each: each[1].share)
    return arm.counted(margin)


def _is_whole(verdict: CampaignVerdict) -> bool:
    """Whether each run decided a requirement: none of them is missing, invalid or open."""
    return not (verdict.missing or verdict.invalid or verdict.open)


def _is_own(requirement: Requirement) -> bool:
    """Whether a defect of a guard cannot make the second run of a pair better.

    It might where that run has the guard as well: the pair would then violate by its better half.
    """
    return requirement.paired is None or bool(requirement.paired.reference)


def _violating(verdict: CampaignVerdict) -> set[int]:
    """Numbers of the runs that violate a requirement."""
    return {int(each.episode.rpartition("#")[2]) for each in verdict.counterexamples}


def _no_sample(verdict: CampaignVerdict) -> bool:
    """Whether a verdict is undecided by what its runs are, not by how many or by their loss."""
    return verdict.verdict == "undecided" and not (verdict.too_few or verdict.missing)


def _course(episode: JudgedEpisode) -> bytes:
    """Hash all that happened in a run, whatever parts it was run with."""
    events = [replace(each, traceback="") for each in episode.events if not each.wall_clock]
    rest = canonical([events, episode.metrics.deterministic()])
    return hashlib.sha256(episode.trajectory.encode() + rest).digest()


def planned_mutants(gates: Sequence[Gate]) -> list[AnyMutant]:
    """List the mutants of the domains and the parts of some cases, each once.

    Roles that fixtures replace are other parts, and no others; an injector counts where faults are
    planned.
    """
    component = {"generator": RoleSpec("any:Component")}
    parts = {SIMULATOR, *(role for gate in gates for role in gate.case.roles(component))}
    if not any(gate.case.faults for gate in gates):
        parts -= {"fault_injector"}
    domains: dict[int, tuple[Domain | None, set[str]]] = {}
    for gate in gates:
        system = gate.case.scenario.system
        signals = domains.setdefault(id(system), (system, set()))[1]
        checks = [each.check for each in gate.requirements if not is_function_path(each.check)]
        signals.update(name for check in checks if check for name in read_formula(check).signals)
    known = [mutant for each in domains.values() for mutant in registered_mutants(*each)]
    requirements = {each.id: each for gate in gates for each in gate.requirements}
    of_parts = {each.name: each for each in known if each.role in parts}
    return [*of_parts.values(), *requirement_mutants(requirements.values())]
