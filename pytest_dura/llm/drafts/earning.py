"""What drafts rest on and earn: recorded runs of scenarios, and seeded defects that they catch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

from pytest_dura.campaign.runner import Runner
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.domains import DOMAINS, Domain
from pytest_dura.library.cases import Case, expand_cases
from pytest_dura.llm.drafts.asking import Draft
from pytest_dura.llm.drafts.checks import ENDINGS, RecordedRun
from pytest_dura.qualification import Gate, Mutant, Qualification, planned_mutants

COMPONENT, EVERYTHING = "component", "all"
"""Parts whose defects are seeded."""


@dataclass(frozen=True)
class Earned:
    """What a draft catches that the suite does not.

    Args:
        alone: Names of the mutants that it catches and no requirement of the suite.
        also: Number of those that the suite catches as well.
        mutants: Number of mutants that were run.
    """

    alone: tuple[str, ...]
    also: int
    mutants: int

    @property
    def text(self) -> str:
        """A phrase that goes on from the draft."""
        beside = f", and {self.also} that it catches too" if self.also else ""
        return (
            f"catches {len(self.alone)} of {self.mutants} seeded defects that the suite does "
            f"not{beside}"
        )


@dataclass
class Suite:
    """Cases of a domain with the requirements that judge them.

    Args:
        runner: Runs them.
        domain: Their domain.
        chosen: Globs of scenarios; by default all of the domain.
    """

    runner: Runner
    domain: Domain
    chosen: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Find the cases.

        Raises:
            ConfigurationError: If there is none.
        """
        self.runner = replace(self.runner, end_when_decided=False, twins=False)
        library = self.runner.library()
        scenarios = [
            each for name, each in library.scenarios.items()
            if each.system is not None and each.system.name == self.domain.name
            and any(fnmatchcase(name, glob) for glob in self.chosen or ("*",))
        ]  # fmt: skip
        if not scenarios:
            raise ConfigurationError(
                f"no scenario of the domain {self.domain.name} is there to run",
                key="--scenario",
                found=", ".join(self.chosen) or "no scenario",
                expected="the name of a scenario, or a glob",
                remedy="name another one, or the folder of yours by --suite",
            )
        self.cases: list[Case] = []
        for scenario in scenarios:  # the first case of each
            self.cases += expand_cases([scenario], read=library.faults)[:1]

    @property
    def taken(self) -> dict[str, str]:
        """Where each id of a requirement is in use."""
        return dict(self.runner.library().defined_in)

    def recorded(self) -> list[RecordedRun]:
        """Run each case once with the suite's component and once with each provoker."""
        runs: list[RecordedRun] = []
        drivers = {"": self.runner}
        for name in self.domain.provokers:
            path = self.domain.short_names["generator"][name]
            roles = {**self.runner.roles, "generator": RoleSpec(path)}
            drivers[name] = replace(self.runner, roles=roles)
        for case in self.cases:
            for name, runner in drivers.items():
                episode = runner.fetch(case)
                if episode.failure is not None:
                    continue
                about = f"{episode.id} ({name})" if name else episode.id
                ending = ENDINGS.get(episode.termination, "time")
                columns = episode.time, episode.signals, episode.decisions
                runs.append(RecordedRun(about, *columns, ending, case.scenario, own=not name))
        if not runs:
            raise ConfigurationError(
                "no recorded run came to an end, so that no draft can be judged",
                found=episode.failure,
                remedy="run the scenarios by `pytest --dura-scenarios` first",
            )
        return runs

    def earned(
        self, drafts: Mapping[str, Draft], where: Iterable[str], parts: str, runs: int
    ) -> dict[str, Earned]:
        """Run the gate with the drafts on mutants; what each draft catches beyond the suite.

        Args:
            drafts: By id.
            where: Names of the scenarios.
            parts: ``component`` or ``all``.
            runs: Runs of each case with a mutant, at most.
        """
        names = set(where)
        gates = [
            Gate(case, (*self.runner.requirements_of(case),
                        *(each.requirement for each in drafts.values())))
            for case in self.cases if case.scenario.name in names
        ]  # fmt: skip
        if not gates:
            return {name: Earned((), 0, 0) for name in drafts}
        mutants = [
            each for each in planned_mutants(gates)
            if isinstance(each, Mutant) and (parts == EVERYTHING or each.role == "generator")
        ]  # fmt: skip
        qualification = Qualification(self.runner, gates, runs)
        results = [qualification.qualify(each) for each in mutants]
        killers = {each.name: {kill.requirement for kill in each.kills} for each in results}
        run = sum(each.status != "not run" for each in results)
        earned = {}
        for name in drafts:
            caught = [mutant for mutant, by in killers.items() if name in by]
            alone = tuple(mutant for mutant in caught if killers[mutant] <= drafts.keys())
            earned[name] = Earned(alone, len(caught) - len(alone), run)
        return earned


def domain_named(name: str) -> Domain:
    """Find a domain whose signals are declared.

    Raises:
        ConfigurationError: For an unknown one, and one that declares no signals.
    """
    if name not in DOMAINS:
        raise DOMAINS.unknown(name, key="--domain")
    domain = DOMAINS[name]
    if domain.signals is None:
        raise ConfigurationError(
            f"the domain {name} declares no signals, so that no draft can be checked",
            key="--domain",
            found=name,
            expected="a domain with `signals`",
            remedy="declare them, with unit and meaning",
        )
    return domain
