"""The plan of a session: which cases it runs as a gate, and which requirements judge each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pytest_dura.core.errors import ConfigurationError

if TYPE_CHECKING:
    from pytest_dura.campaign.cases import Case
    from pytest_dura.plugin.scenario_arguments import Chosen
    from pytest_dura.plugin.session import DuraSession


@dataclass(frozen=True, slots=True)
class Planned:
    """A case whose requirements become scenario items."""

    case: Case
    requirements: tuple[str, ...]


def make_plan(session: DuraSession, chosen: Mapping[str, Chosen]) -> list[Planned]:
    """The cases of the scenarios, or those that arguments name, with their requirements.

    Args:
        session: The session, which takes in each case.
        chosen: What the arguments name, if any do.

    Raises:
        ConfigurationError: For a scenario that nothing would judge, and options that match none.
    """
    from pytest_dura.campaign.cases import expand_cases
    from pytest_dura.campaign.selection import selected

    options, library, plan = session.options, session.library(), []
    if chosen:
        # A case of our own arguments may have other faults than its scenario.
        named = {name: session.bench.case(name) for name, _ in chosen.values()}
        found = selected(list(named.values()), options.select)
    else:
        found = expand_cases(library.scenarios, options.faults, options.select, library.faults)
    cases = {case.id: case for case in found}
    for name in sorted(cases):
        case = cases[name]
        if not (case.requirements or chosen or options.list_only):
            raise ConfigurationError(
                f"the scenario {name!r} has no requirements, so nothing would judge it",
                file=case.scenario.file or None,
                key="requirements",
                expected="at least one requirement where a scenario is run as a gate",
                remedy="name requirements, or leave the scenario out with --dura-select",
            )
        requirements = case.requirements
        if chosen:
            requirements = tuple(
                requirement
                for requirement in case.requirements
                if any(_names(one, name, requirement) for one in chosen.values())
            )
        if requirements:
            session.take_case(case)
            plan.append(Planned(case, requirements))
    return plan


def _names(chosen: Chosen, case: str, requirement: str) -> bool:
    return chosen[0] == case and chosen[1] in ("", requirement)
