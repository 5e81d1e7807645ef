"""Cases: scenario x fault campaign, with stable ids, and the specs of their episodes.

A SearchedCase is a case without variation, chosen by a search or a strategy.
"""

from __future__ import annotations

import copy
import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any

from pytest_dura.core.display import Shown, short_repr
from pytest_dura.core.episode import EpisodeSpec, Policy, Termination, canonical
from pytest_dura.core.errors import ConfigurationError, did_you_mean, list_names
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import STANDARD_ROLES
from pytest_dura.core.seeding import derive_seed
from pytest_dura.domains import DEFAULT_INJECTOR, check_role_name, role_spec
from pytest_dura.library.fault_campaigns import (
    NO_FAULTS,
    FaultCampaign,
    Faults,
    ScenarioFaults,
    check_case_count,
    expand_campaign,
)
from pytest_dura.library.planned_faults import (
    check_chains,
    parse_fault,
    parse_scenario_fault,
    without_injector,
)
from pytest_dura.library.roles import ParameterResolver
from pytest_dura.library.scenario import (
    Scenario,
    check_world,
    draw_value,
    replace_value,
    split_path,
    world_of_run,
)
from pytest_dura.requirements.searches import SEARCHED_MARK


def may_match_scenario(scenario: str, globs: Sequence[str]) -> bool:
    """Whether a glob may match a case of the scenario."""
    return any(fnmatchcase(scenario, re.split(r"[+~]", glob, maxsplit=1)[0]) for glob in globs)


def _is_run(scenario: Scenario, globs: Sequence[str]) -> bool:
    """Whether a scenario is run; one on request where a glob names it, by parts of its name."""
    depth = scenario.name.count("/")
    deep = [glob for glob in globs if glob.count("/") >= depth]
    return not scenario.on_request or may_match_scenario(scenario.name, deep)


def select_cases(cases: list[Case], globs: Sequence[str]) -> list[Case]:
    """Select the cases whose id or scenario any of the globs matches; all without a glob.

    The id of a case selects that case alone, also where it is the name of its scenario.

    Raises:
        ConfigurationError: For a glob that matches nothing.
    """
    if not globs:
        return cases
    selected: set[str] = set()
    for glob in globs:
        ids = {case.id for case in cases if case.id == glob} or {
            case.id
            for case in cases
            if fnmatchcase(case.id, glob) or fnmatchcase(case.scenario.name, glob)
        }
        if not ids:
            raise no_match_error(glob, [case.id for case in cases], "case")
        selected |= ids
    return [case for case in cases if case.id in selected]


def no_match_error(glob: str, names: Sequence[str], what: str) -> ConfigurationError:
    """Make the error for a name or glob that matches nothing."""
    return ConfigurationError(
        f"no {what} matches {glob!r}",
        found=glob,
        expected=f"one of {list_names(names)}, or a glob of them" if names else f"a {what}",
        remedy=did_you_mean(glob, names),
    )


SWITCHED_OFF_MARK = "~"
"""In a case's id, before each role that is switched off."""


@dataclass(frozen=True, slots=True)
class Case(Shown):
    """A scenario with the faults that are applied to it.

    Args:
        id: ``scenario``, ``scenario+fault+fault`` or ``scenario+none``.
        scenario: The scenario.
        faults: The planned faults, defaults filled in.
        requirements: Ids of the requirements that apply.
        without: Roles that are switched off, for the second run of each pair; ``generator`` where
            a reference takes its place.
        reference: Registered name or import path of that component; empty without one.
    """

    id: str
    scenario: Scenario
    faults: Faults
    requirements: tuple[str, ...]
    without: tuple[str, ...] = ()
    reference: str = ""

    __repr__ = short_repr

    def _figures(self) -> Iterator[tuple[str, object]]:
        """Yield what a notebook shows."""
        yield "case", self.id
        yield "description", self.scenario.description
        yield "file", self.scenario.file
        yield "faults", [fault.id for fault in self.faults] or None
        yield "without", self.without
        yield "requirements", self.requirements

    def switched_off(self, role: str) -> Case:
        """Return the case without a role, such as ``intersection/nominal~recovery_planner``.

        Raises:
            ConfigurationError: For an unknown role, and for the component under test.
        """
        check_role_name(role, switched_off=True)
        if role in self.without:
            raise ConfigurationError(
                f"the case {self.id!r} is already without {role!r}",
                key=role,
                found=self.id,
                expected="a case in which the role runs",
                remedy=f"take the case {self.id.partition(SWITCHED_OFF_MARK)[0]!r}",
            )
        if role == "generator":
            raise ConfigurationError(
                "the generator cannot be switched off",
                found=role,
                expected="another role",
                remedy="compare with another component: `paired: {reference: NAME}`",
            )
        return replace(
            self, id=f"{self.id}{SWITCHED_OFF_MARK}{role}", without=(*self.without, role)
        )

    def referred(self, reference: str) -> Case:
        """Return the case with another component, such as ``nominal~generator=careful_driver``.

        Recovery does not overrule it: what the reference avoids, it avoids by itself.

        Args:
            reference: Registered name or import path of the component.

        Raises:
            ConfigurationError: For an unknown component, and in a case that has a reference.
        """
        role_spec("generator", RoleSpec(reference), self.scenario.system)
        if self.reference:
            raise ConfigurationError(
                f"the case {self.id!r} has a reference already",
                key="reference",
                found=reference,
                expected="a case of the component under test",
                remedy=f"take the case {self.id.partition(SWITCHED_OFF_MARK)[0]!r}",
            )
        name = f"{self.id}{SWITCHED_OFF_MARK}generator={reference}"
        return replace(self, id=name, without=(*self.without, "generator"), reference=reference)

    def lacking(self, part: str) -> Case:
        """Return the case without a role, or with a reference: what follows ``~`` in an id.

        Args:
            part: Name of the role, or ``generator=`` and the reference.

        Raises:
            ConfigurationError: As :meth:`switched_off` and :meth:`referred`.
        """
        role, equals, reference = part.partition("=")
        if equals and role == "generator":
            return self.referred(reference)
        return self.switched_off(part)

    def with_role(self, role: str) -> Case:
        """Return the case of :meth:`switched_off`, in which the role runs."""
        name = "".join(self.id.rsplit(f"{SWITCHED_OFF_MARK}{role}", 1))
        return replace(self, id=name, without=tuple(each for each in self.without if each != role))

    def without_faults(self) -> Case:
        """Return the case without any fault, such as ``intersection/ghost-obstacle+none``."""
        bare = case_with_faults(self.scenario, NO_FAULTS)
        for role in self.without:
            bare = bare.referred(self.reference) if role == "generator" else bare.switched_off(role)
        return bare

    def seed(self, run: int, base_seed: int) -> int:
        """Derive the seed of a run; it is equal for all cases of a scenario, to make pairs."""
        own = self.scenario.seed
        if own is not None:
            return own if run == 0 else derive_seed(own, self.scenario.name, run)
        return derive_seed(base_seed, self.scenario.name, run)

    def spec(
        self,
        run: int,
        base_seed: int,
        roles: Mapping[str, RoleSpec | None] | None = None,
        *,
        simulator: RoleSpec | None = None,
        policy: str | None = None,
        seed: int | None = None,
        resolver: ParameterResolver | None = None,
    ) -> EpisodeSpec:
        """Make the spec of an episode: all that determines it.

        Args:
            run: Number of the run, from 0.
            base_seed: The session's seed.
            roles: Roles that replace the scenario's and the domain's; ``None`` switches one off.
            simulator: Replaces the scenario's simulator.
            policy: Replaces the scenario's policy.
            seed: Seed of the episode, instead of the one that follows from ``base_seed``.
            resolver: Resolves the parameters of roles; by default a new one.

        Raises:
            ConfigurationError: If a role is unknown or none is the component under test.
        """
        scenario = self.scenario
        seed = self.seed(run, base_seed) if seed is None else seed
        simulator = simulator or scenario.simulator_spec()
        world, faults = self._varied(simulator, seed)
        world = world_of_run(simulator, world, run)
        resolve = (resolver or ParameterResolver()).resolve
        read = {"name": scenario.name, "duration": scenario.duration}
        if scenario.iterations is not None:
            read["iterations"] = scenario.iterations
        return EpisodeSpec(
            case=self.id,
            run=run,
            seed=seed,
            simulator=simulator,
            roles={name: resolve(role) for name, role in self.roles(roles or {}).items()},
            scenario={**read, "world": world},
            faults=faults,
            policy=Policy.parse(policy or self.policy),
            termination=Termination(
                time_limit=scenario.duration,
                violation=scenario.end_at_violation,
                iterations=scenario.iterations,
                decided=scenario.end_when_decided,
            ),
            time_step=scenario.time_step,
            time_budget=scenario.time_budget,
            clock=scenario.pace,
        )

    @property
    def policy(self) -> str:
        """The scenario's policy; ``log_only`` for ``recover`` where nothing is to recover."""
        off = bool(self.reference) or "recovery_planner" in self.without
        return "log_only" if off and self.scenario.policy == "recover" else self.scenario.policy

    def roles_off(self, overrides: Mapping[str, RoleSpec | None]) -> list[str]:
        """List the roles that an override or the scenario switches off for all runs, sorted."""
        given: dict[str, object] = {**self.scenario.roles, **overrides}
        return sorted(role for role, chosen in given.items() if chosen is None)

    def roles(self, overrides: Mapping[str, RoleSpec | None]) -> dict[str, RoleSpec]:
        """Choose each role: an override, else the scenario's, else the domain's default.

        Raises:
            ConfigurationError: For an unknown name, and if there is no generator.
        """
        scenario = self.scenario
        domain = scenario.system
        # Faults need an injector wherever they are planned, by a file, an option or a search.
        chosen: dict[str, RoleSpec | None] = {"fault_injector": RoleSpec(DEFAULT_INJECTOR)}
        if domain is not None:
            chosen |= {role: RoleSpec(path) for role, path in domain.default_roles.items()}
        for role, entry in scenario.roles.items():
            chosen[role] = None if entry is None else RoleSpec(entry.path, entry.params)
        for role, spec in overrides.items():
            if role not in chosen:
                check_role_name(role, switched_off=spec is None)
            chosen[role] = spec
        if self.reference:
            chosen["generator"] = RoleSpec(self.reference)
        if self.faults and chosen["fault_injector"] is None:
            raise without_injector(scenario, self.id)
        absent = [role for role in self.without if chosen.get(role) is None]
        if absent:
            raise ConfigurationError(
                f"the case {self.id!r} has no role {absent[0]!r} to switch off",
                key=absent[0],
                found=", ".join(role for role, spec in chosen.items() if spec is not None),
                expected="a role that runs in this case",
                remedy="leave the comparison out, or give the case that role",
            )
        roles = {
            role: role_spec(role, spec, domain)
            for role, spec in chosen.items()
            if spec is not None and (role not in self.without or role == "generator")
        }
        if "generator" not in roles and domain is None:
            # A simulator may bring the component, such as a black box.
            simulator = scenario.simulator_spec()
            own = getattr(simulator.resolve(), "component_parameters", None)
            if own is not None:
                roles["generator"] = RoleSpec(simulator.path, dict(own))
        if "generator" not in roles:
            raise ConfigurationError(
                f"the case {self.id!r} has no component under test",
                file=scenario.file or None,
                line=scenario.line_of("roles"),
                key="roles.generator",
                expected="a generator from the scenario, a fixture or --dura-generator",
                remedy="add `roles: {generator: package.module:Name}` to the scenario, "
                "or define a `generator` fixture",
            )
        order = [*STANDARD_ROLES, *sorted(set(roles) - set(STANDARD_ROLES))]
        return {role: roles[role] for role in order if role in roles}

    def _varied(self, simulator: RoleSpec, seed: int) -> tuple[dict[str, Any], Faults]:
        """Draw the world and the faults of the run with this seed."""
        world = check_world(self.scenario, simulator, self.scenario.world)
        faults = {fault.id: fault for fault in self.faults}
        varied: dict[str, Any] = {}
        for path, spread in self.scenario.variation.items():
            # Each path has a stream of its own: a fault that this case leaves out shifts no other.
            fault, inner = split_path(path)
            value = draw_value(path, spread, seed)
            if not fault:
                world = replace_value(world, inner, value, create=True)
            elif fault in faults:
                before = varied.get(fault) or faults[fault].plain()
                varied[fault] = replace_value(before, inner, value)
        for fault, plain in sorted(varied.items()):
            # Values that are possible on their own may contradict each other.
            faults[fault] = parse_fault(self.scenario, plain)
        return copy.deepcopy(world), tuple(copy.deepcopy(list(faults.values())))


def same_name(name: str) -> ConfigurationError:
    """Make the error for two cases of one id that are about different worlds."""
    return ConfigurationError(
        f"the case {name!r} stands for another world elsewhere in this session",
        key="name",
        found=name,
        expected="a name of its own for each world, and each set of logs with its mapping",
        remedy="rename one of them, or judge it in a session of its own",
    )


def expand_cases(
    scenarios: Mapping[str, Scenario] | Iterable[Scenario],
    faults: Sequence[FaultCampaign] | None = None,
    select: Sequence[str] = (),
    read: Mapping[str, ScenarioFaults] = NOTHING,
) -> list[Case]:
    """Make the cases of scenarios, sorted by scenario, then in the order of fault campaigns.

    Args:
        scenarios: The scenarios. Of a mapping, which is a whole library, those on request are left
            out unless a glob names them.
        faults: Fault campaigns that replace the scenarios' own; ``None`` keeps those. See
            ``pytest_dura.library.fault_campaigns`` for what an entry may be.
        select: Globs of case ids or scenario names; cases that match none are left out.
        read: Faults of scenarios that have been read before, by the scenario's name.

    Raises:
        ConfigurationError: For an unknown fault, and for a glob that matches nothing.
    """
    chosen = list(scenarios.values() if isinstance(scenarios, Mapping) else scenarios)
    if isinstance(scenarios, Mapping):
        chosen = [each for each in chosen if _is_run(each, select)]
    if faults is not None and select:
        # The given faults need to fit the selected scenarios only.
        chosen = [each for each in chosen if may_match_scenario(each.name, select)] or chosen
    cases: dict[str, Case] = {}
    for scenario in sorted(chosen, key=lambda each: each.name):
        known = read.get(scenario.name)
        if known is None:
            own = tuple(parse_scenario_fault(scenario, i) for i in range(len(scenario.faults)))
        else:
            own = known.own
        by_id = {fault.id: fault for fault in own}
        for planned in _planned(scenario, own, faults, known):
            acting = {fault.id: fault for fault in planned}
            if acting == by_id:
                name, in_order = scenario.name, tuple(by_id.values())
            else:
                name, in_order = "+".join([scenario.name, *(acting or [NO_FAULTS])]), planned
            case = Case(name, scenario, in_order, scenario.requirements)
            before = cases.setdefault(case.id, case)
            if before.scenario.world != scenario.world:
                raise same_name(case.id)
            if before.faults != case.faults:
                raise ConfigurationError(
                    f"two fault campaigns make the same case {case.id!r} with different faults",
                    key="faults",
                    found=case.id,
                    expected="an id of its own for each fault",
                    remedy="give one of the faults another `id`",
                )
    return select_cases(list(cases.values()), select)


def case_with_faults(scenario: Scenario, faults: FaultCampaign) -> Case:
    """Make the case of a scenario with these faults.

    Raises:
        ConfigurationError: For an unknown fault, and for a campaign of several cases.
    """
    cases = expand_cases([scenario], [faults])
    if len(cases) > 1:
        raise ConfigurationError(
            f"these faults make {len(cases)} cases, and one is asked for",
            key="faults",
            found=faults,
            expected="the faults of one case, such as ghost-obstacle",
            remedy=f"for example {cases[0].id!r}",
        )
    return cases[0]


def _planned(
    scenario: Scenario,
    own: Faults,
    campaigns: Sequence[FaultCampaign] | None,
    known: ScenarioFaults | None,
) -> list[Faults]:
    """List the faults of each case: of the given campaigns, else of the scenario's own."""
    chosen = campaigns if campaigns is not None else scenario.campaigns
    if campaigns is None and not chosen:
        return [own]
    if campaigns is None and known is not None:
        return [faults for campaign in known.campaigns for faults in campaign]
    planned: list[Faults] = []
    for campaign in chosen:
        planned += expand_campaign(scenario, own, campaign)
        check_case_count(len(planned), "faults")
    return planned


@dataclass(frozen=True, slots=True)
class SearchedCase(Case):
    """A case without variation, with a seed of its own. Campaigns refuse it: it gives no rate."""

    def __repr__(self) -> str:
        """Show what differs between the searched cases of a scenario."""
        faults = [
            {key: _without_none(part) for key, part in fault.in_file().items()}
            for fault in self.faults
        ]
        scenario = self.scenario
        return (
            f"SearchedCase({self.id!r}, seed={scenario.seed}, world={scenario.world}, "
            f"faults={faults})"
        )

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:  # noqa: ARG002 - a protocol
        """Have Hypothesis print the repr in place of the fields of the dataclass."""
        printer.text(repr(self))

    @property
    def data(self) -> dict[str, Any]:
        """The scenario as plain data, of which a scenario file can be made."""
        return self.scenario.plain()


def make_searched_case(
    case: Case, world: Mapping[str, Any], faults: Iterable[Mapping[str, Any]], seed: int
) -> SearchedCase:
    """Make a case with this world and these faults instead of what its scenario varies.

    Args:
        case: Gives everything else: simulator, roles, duration, requirements.
        world: The world, with nothing left to draw but what follows from the seed.
        faults: The planned faults, as in a scenario file.
        seed: Seed of the episode.

    Raises:
        ConfigurationError: If the faults cannot be used, or not together. An invalid world is
            refused when the episode's spec is made.
    """
    own = case.scenario.plain()
    planned = [parse_fault(case.scenario, fault) for fault in faults]
    check_chains(planned)
    given = []
    for fault in planned:
        written = fault.in_file()
        if fault.id == fault.type:  # which need not be a valid name
            del written["id"]
        given.append(written)
    own |= {"world": dict(world), "faults": given, "seed": seed, "runs": 1}
    own["requirements"] = list(case.requirements)
    for key in ("variation", "campaigns"):
        own.pop(key, None)
    digest = hashlib.sha256(canonical([own, list(case.without)])).hexdigest()[:10]
    return SearchedCase(
        f"{case.scenario.name}{SEARCHED_MARK}{digest}",
        Scenario.model_validate(own),
        tuple(planned),
        case.requirements,
        case.without,
    )


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: inner for key, inner in value.items() if inner is not None}
    return value
