"""What drafts rest on and earn: recorded runs of scenarios, and seeded defects that they catch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase

from pytest_dura.campaign.runner import Runner
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.domains import DOMAINS, Domain
from pytest_dura.drafts.asking import Draft
from pytest_dura.drafts.checks import ENDINGS, RecordedRun
from pytest_dura.library.cases import Case, expand_cases
from pytest_dura.qualification import Gate, Mutant, Qualification, planned_mutants
from pytest_dura.qualification.results import REPEATABILITY, VALIDITY
from pytest_dura.requirements.checks import is_function_path, read_formula
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.stl.formula import Node

COMPONENT, EVERYTHING = "component", "all"
"""Parts whose defects are seeded."""
_ELSEWHERE = "*"
"""Stands for any requirement of the suite, on another case; no id of a requirement."""


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
    drafts: list[tuple[Requirement, Sequence[str]]] = field(default_factory=list, init=False)
    """Drafts that were kept, each with its scenarios: later ones have to catch something more."""

    def __post_init__(self) -> None:
        """Find the cases.

        Raises:
            ConfigurationError: If there is none.
        """
        self._whole: Qualification | None = None
        self._caught: dict[str, bool] = {}
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
        own = dict.fromkeys((REPEATABILITY, VALIDITY), "it stands for a rule of the gate")
        drafts = {each.id: "an earlier draft" for each, _ in self.drafts}
        return own | dict(self.runner.library().defined_in) | drafts

    @property
    def stated(self) -> dict[Node, str]:
        """Ids of the requirements on single runs, the drafts that were kept among them."""
        known = [*self.runner.library().requirements.values(), *(each for each, _ in self.drafts)]
        return {
            read_formula(each.check).root: each.id
            for each in reversed(known)
            if each.check and not is_function_path(each.check)
            and each.paired is None and each.at_most is None
        }  # fmt: skip

    def gate(self, case: Case, *drafts: Requirement) -> Gate:
        """Return a case with what judges it: the suite, the drafts that were kept, and others."""
        kept = (each for each, scenarios in self.drafts if case.scenario.name in scenarios)
        return Gate(case, (*self.runner.requirements_of(case), *kept, *drafts))

    def keep(self, draft: Requirement, scenarios: Sequence[str]) -> None:
        """Count a draft as part of the suite from now on."""
        self.drafts.append((draft, scenarios))
        self._whole = None
        self._caught.clear()

    def drivers(self) -> dict[str, Runner]:
        """Make runners by what drives: the suite's own component, of no name, and provokers."""
        drivers = {"": self.runner}
        for name in self.domain.provokers:
            path = self.domain.short_names["generator"][name]
            roles = {**self.runner.roles, "generator": RoleSpec(path)}
            drivers[name] = replace(self.runner, roles=roles)
        return drivers

    def recorded(self) -> list[RecordedRun]:
        """Run each case once with the suite's component and once with each provoker."""
        runs: list[RecordedRun] = []
        drivers = self.drivers()
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
        cases = [case for case in self.cases if case.scenario.name in names]
        if not cases:
            return {name: Earned((), 0, 0) for name in drafts}
        # Those of the suite alone: one of a signal that only a draft reads would be its own defect.
        mutants = [
            each for each in planned_mutants([self.gate(case) for case in cases])
            if isinstance(each, Mutant) and (parts == EVERYTHING or each.role == "generator")
        ]  # fmt: skip
        added = [each.requirement for each in drafts.values()]
        gates = [self.gate(case, *added) for case in cases]
        qualification = Qualification(self.runner, gates, runs)
        results = [qualification.qualify(each) for each in mutants]
        run = sum(each.status != "not run" for each in results)
        killers: dict[str, set[str]] = {}
        for mutant, result in zip(mutants, results, strict=True):
            # A draft that a defect makes vacuous, and so undecided, has not seen the defect.
            by = {kill.requirement for kill in result.kills if kill.violated}
            others = {kill.requirement for kill in result.kills} - drafts.keys()
            is_caught = bool(others) or (bool(by) and self._catches(mutant, runs))
            killers[mutant.name] = by | others | ({_ELSEWHERE} if is_caught else set())
        earned = {}
        for name in drafts:
            caught = [mutant for mutant, by in killers.items() if name in by]
            alone = tuple(mutant for mutant in caught if killers[mutant] <= drafts.keys())
            earned[name] = Earned(alone, len(caught) - len(alone), run)
        return earned

    def _catches(self, mutant: Mutant, runs: int) -> bool:
        """Whether the suite catches a mutant without the new drafts, on any of its cases."""
        if mutant.name not in self._caught:
            if self._whole is None:
                gates = [self.gate(case) for case in self.cases]
                self._whole = Qualification(self.runner, gates, runs)
            self._caught[mutant.name] = self._whole.qualify(mutant).status == "caught"
        return self._caught[mutant.name]


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
