"""Which requirements apply to which scenarios, and whether they can be judged there."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase

from pytest_dura.campaign.domains import Domain, check_role_name, domain_of
from pytest_dura.campaign.problems import did_you_mean, placed
from pytest_dura.campaign.requirement_files import Located
from pytest_dura.campaign.scenario import Scenario
from pytest_dura.campaign.worlds import (
    percept_signal_names,
    proposal_signal_names,
    signal_names,
)
from pytest_dura.core.accounts import PREFIX
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.loop_signals import LOOP_SIGNALS
from pytest_dura.requirements.checks import Check, is_function_path, read_formula
from pytest_dura.requirements.methods import method_of
from pytest_dura.requirements.model import FAULTS
from pytest_dura.requirements.stl.language.checks import check_time_step
from pytest_dura.requirements.stl.language.formula import Formula


def applied(
    scenarios: Mapping[str, Scenario], requirements: Mapping[str, Located]
) -> dict[str, Scenario]:
    """The scenarios, each with the requirements that name it in ``applies_to`` after its own."""
    found = dict(scenarios)
    for name, located in requirements.items():
        for glob in located.requirement.applies_to:
            for scenario in found.values():
                if fnmatchcase(scenario.name, glob) and name not in scenario.requirements:
                    added = (*scenario.requirements, name)
                    found[scenario.name] = scenario.model_copy(update={"requirements": added})
    return found


def idle_globs(
    scenarios: Mapping[str, Scenario], requirements: Mapping[str, Located], theirs: set[str]
) -> list[str]:
    """Globs under ``applies_to`` in ``theirs`` files that match no scenario: a misspelt one."""
    return [
        f"{one.document.file}:{one.document.line_of(f'requirements.{one.index}.applies_to.{i}')}: "
        f"the requirement {name!r} applies to {glob!r}, which matches no scenario"
        for name, one in requirements.items()
        if one.document.file in theirs
        for i, glob in enumerate(one.requirement.applies_to)
        if not any(fnmatchcase(scenario, glob) for scenario in scenarios)
    ]


def check_reference(scenario: Scenario, index: int, requirements: Mapping[str, Located]) -> None:
    """Refuse a requirement that does not exist, or cannot be judged in this scenario.

    Raises:
        ConfigurationError: At the place that has to be mended, in either file.
    """
    name = scenario.requirements[index]
    key = f"requirements.{index}"
    file, line = scenario.file, scenario.line_of(key)
    if name not in requirements:
        raise ConfigurationError(
            f"unknown requirement {name!r}",
            file=file,
            line=line,
            key=key,
            found=name,
            expected="one of " + ", ".join(requirements) if requirements else "a requirement",
            remedy=did_you_mean(name, requirements)
            if requirements
            else "define it in a requirement file, requirements.yaml",
        )
    located = requirements[name]
    requirement = located.requirement
    if not requirement.check and not (requirement.paired and requirement.paired.measure):
        raise ConfigurationError(
            f"requirement {name!r} has no check, so no scenario can be judged by it",
            file=file,
            line=line,
            key=key,
            found=name,
            expected="a requirement with a `check`",
            remedy=f"add a `check` in {located.document.file}:{located.line}",
        )
    try:
        _check_paired(scenario, located)
        method_of(requirement, until_decided=scenario.until_decided)
    except ConfigurationError as error:
        raise placed(error, file=file, line=line, key=key) from None
    try:
        check_formula(scenario, requirement.check)
    except ConfigurationError as error:
        raise located.error(error) from None


def _check_paired(scenario: Scenario, located: Located) -> None:
    paired = located.requirement.paired
    if paired is None:
        return
    if paired.without != FAULTS:
        check_role_name(paired.without, switched_off=True)
    elif not scenario.faults:
        raise ConfigurationError(
            f"the requirement {located.requirement.id!r} compares runs with faults to runs "
            "without, and this scenario has no faults",
            found=located.requirement.id,
            expected="a scenario with faults",
            remedy="leave the requirement out here",
        )


def check_formula(scenario: Scenario, check: Check) -> None:
    """Refuse a formula that could not be judged on this scenario's episodes; pass over functions.

    Raises:
        ConfigurationError: For a formula that cannot be read, a signal that the scenario's domain
            does not have, a window that is no multiple of the time step, and windows that reach
        beyond the scenario's duration: its episodes could not decide them.
    """
    if not isinstance(check, str) or not check or is_function_path(check):
        return
    formula = read_formula(check)
    known = _known_signals(domain_of(scenario.simulator.path), formula)
    if known is not None:
        read_formula(check, known)
    check_time_step(formula, scenario.time_step)
    ahead = formula.horizon
    if ahead is not None and ahead > scenario.lasts * (1 + 1e-9):
        raise ConfigurationError(
            f"the windows of the formula reach beyond the episodes of {scenario.name!r}",
            key="check",
            found=f"{formula}, which looks {ahead:g} s ahead",
            expected=f"windows that end within the scenario's duration of {scenario.lasts:g} s",
            remedy="shorten the windows, or lengthen the scenario's `duration`"
            + (" and its `iterations`" if scenario.lasts < scenario.duration else ""),
        )


def _known_signals(domain: Domain | None, formula: Formula) -> tuple[str, ...] | None:
    """Every signal that a formula may read; ``None`` where only the simulator will tell."""
    truth = None if domain is None else signal_names(domain)
    if domain is None or truth is None:
        return None
    later = {"percept.": percept_signal_names(domain), PREFIX: proposal_signal_names(domain)}
    named = [
        name
        for prefix, names in later.items()
        for name in (
            [one for one in formula.signals if one.startswith(prefix)]
            if names is None
            else [prefix + one for one in names]
        )
    ]
    return (*truth, *named, *LOOP_SIGNALS)


def unused_requirements(
    scenarios: Mapping[str, Scenario], requirements: Mapping[str, Located], theirs: set[str]
) -> dict[str, str]:
    """The ids of the requirements in ``theirs`` files that no scenario uses, with their places."""
    used = {name for scenario in scenarios.values() for name in scenario.requirements}
    return {
        name: f"{one.document.file}:{one.line}"
        for name, one in requirements.items()
        if name not in used and one.document.file in theirs
    }
