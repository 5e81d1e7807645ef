"""Requirement files: read them, and match their requirements with scenarios."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from pytest_dura.core.errors import ConfigurationError, combine_errors, did_you_mean, error_at
from pytest_dura.core.loop_signals import LOOP_SIGNALS, PROPOSAL_PREFIX
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.domains import Domain, check_role_name, role_spec
from pytest_dura.library.documents import Document, validate
from pytest_dura.library.scenario import (
    Entry,
    Scenario,
    not_empty,
)
from pytest_dura.requirements.campaign_judge import CampaignJudge, method_of
from pytest_dura.requirements.checks import Check, is_function_path, load_function, read_formula
from pytest_dura.requirements.model import FAULTS, Kind, Method, Paired, Requirement
from pytest_dura.requirements.pairs import RECOVERY, check_comparison
from pytest_dura.requirements.scaling import scaled_formula
from pytest_dura.requirements.stl.formula import Formula, check_time_step


class PairedEntry(Entry):
    """A requirement on pairs: the same seeds with something and without it."""

    without: str = ""
    """`faults`, or the role that is switched off in the second run of each pair."""
    measure: str = ""
    """Import path `package.module:function` of a function of an episode to a number."""
    change_at_most: float | None = None
    """Greatest acceptable growth of the measure, in its unit."""
    reference: str = ""
    """In place of `without`: registered name or import path of the component that takes the place
    of the component under test in the second run of each pair, where recovery does not act. Beside
    `without: recovery_planner`, in a third run: what it avoids, recovery has to prevent."""

    @model_validator(mode="after")
    def _complete(self) -> PairedEntry:
        if bool(self.measure) != (self.change_at_most is not None):
            raise ValueError("`measure` and `change_at_most` go together")
        both = self.without == RECOVERY and self.reference and not self.measure
        if bool(self.without) == bool(self.reference) and not both:
            raise ValueError(
                "one of `without` and `reference` says what the second run is; both go together "
                "for a check that `recovery_planner` has to keep from being violated"
            )
        return self


class RequirementEntry(Entry):
    """A requirement in a file."""

    id: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    """Unique name, such as `SAF-1`."""
    text: str = Field(min_length=1)
    """What is required, in words."""
    kind: Kind
    """The kind of dependability it belongs to."""
    source: str = ""
    """Where it comes from: a standard, a hazard analysis, a contract."""
    check: str = ""
    """Formula that an episode must satisfy, such as `always (gap > 0)`, or the import path
    `package.module:function` of a function of the episode; empty for test code."""
    reason: str = ""
    """Why the bound is what it is."""
    at_most: float | None = Field(default=None, gt=0, lt=1)
    """Greatest acceptable rate of episodes that violate it; without it none may."""
    confidence: float = Field(default=0.95, gt=0.5, lt=1)
    """One-sided confidence of the bound on that rate."""
    method: Method | None = None
    """How a rate is decided; default: `fixed`, or `e-process` for runs until it is decided."""
    p0: float | None = Field(default=None, gt=0, lt=1)
    """For `sprt`: the rate below `at_most` up to which a component is rarely rejected."""
    applies_to: Annotated[tuple[Annotated[str, Field(min_length=1)], ...], Field(strict=False)] = ()
    """Globs of the scenarios to which it applies besides those that name it."""
    paired: PairedEntry | None = None
    """For a requirement on pairs of runs: what the second run of each pair lacks."""
    mitigates: Annotated[tuple[Annotated[str, Field(min_length=1)], ...], Field(strict=False)] = ()
    """Ids of the hazards, of hazard files, that meeting it mitigates."""
    scale: dict[str, Annotated[float, Field(gt=0, allow_inf_nan=False)]] = Field(
        default_factory=dict
    )
    """Of signals of the check, how much of each counts as one unit of importance, in its own unit:
    searches compare the margins of signals and requirements in these. Verdicts do not change."""

    def requirement(self) -> Requirement:
        """Make the requirement."""
        data = self.model_dump()
        paired = data.pop("paired")
        return Requirement(**data, paired=None if paired is None else Paired(**paired))


class RequirementFile(Entry):
    """A file of requirements."""

    requirements: Annotated[
        tuple[RequirementEntry, ...], Field(strict=False), AfterValidator(not_empty)
    ]
    """The requirements."""


@dataclass(frozen=True)
class LocatedRequirement:
    """A requirement and the place where it is defined."""

    requirement: Requirement
    document: Document
    index: int

    @property
    def key(self) -> str:
        """Dotted key of its id."""
        return f"requirements.{self.index}.id"

    @property
    def line(self) -> int | None:
        """Line of its id."""
        return self.document.line_of(self.key)

    def error(self, error: ConfigurationError, key: str = "check") -> ConfigurationError:
        """Return an error of its check, or of another key, with its place in the file."""
        key = f"requirements.{self.index}.{key}"
        return error_at(error, file=self.document.file, line=self.document.line_of(key), key=key)


def is_requirement_file(document: Document) -> bool:
    """Whether a file is named ``requirements*`` or lists mappings with an id as requirements."""
    if Path(document.file).name.startswith("requirements"):
        return True
    entries = document.data.get("requirements")
    return isinstance(entries, list) and any(
        isinstance(entry, Mapping) and "id" in entry for entry in entries
    )


def read_requirements(document: Document) -> list[LocatedRequirement]:
    """Read the requirements of a file, and check that each can be judged.

    Raises:
        ConfigurationError: One for all errors in the file.
    """
    requirements, errors = [], []
    for index, entry in enumerate(validate(RequirementFile, document).requirements):
        located = LocatedRequirement(entry.requirement(), document, index)
        requirements.append(located)
        errors += _problems(located)
    if errors:
        raise combine_errors(errors)
    return requirements


def _problems(located: LocatedRequirement) -> list[ConfigurationError]:
    """List what keeps the requirement from being judged, each error at its place."""
    requirement = located.requirement
    paired = requirement.paired
    functions = {"paired.measure": paired.measure} if paired is not None else {}
    if is_function_path(requirement.check):
        functions["check"] = requirement.check
    errors = []
    try:
        CampaignJudge(requirement, "", planned=1)
        check_comparison(requirement)
    except ConfigurationError as error:
        errors.append(located.error(error, error.key or "at_most"))
    try:
        if requirement.check and "check" not in functions:
            read_formula(requirement.check)
    except ConfigurationError as error:
        errors.append(located.error(error))
    else:
        try:
            scaled_formula(requirement)
        except ConfigurationError as error:
            errors.append(located.error(error, "scale"))
    for key, path in functions.items():
        try:
            if path:
                load_function(path)
        except ConfigurationError as error:  # noqa: PERF203 - all errors are raised as one
            errors.append(located.error(error, key))
    return errors


def apply_requirements(
    scenarios: Mapping[str, Scenario], requirements: Mapping[str, LocatedRequirement]
) -> dict[str, Scenario]:
    """Add to each scenario, after its own, the requirements that name it in ``applies_to``."""
    applied = dict(scenarios)
    for name, located in requirements.items():
        for scenario in _matched(applied, located.requirement):
            applied[scenario.name] = _with_requirement(scenario, name)
    return applied


def apply_of_component(
    scenarios: Mapping[str, Scenario],
    of_component: Mapping[str, LocatedRequirement],
    requirements: Mapping[str, LocatedRequirement],
) -> dict[str, Scenario]:
    """Add to each scenario the component's requirements that name it, where it has their signals.

    Args:
        scenarios: By name.
        of_component: The requirements that come with the component.
        requirements: All of the session; one of these may stand in place of a component's.
    """
    applied = dict(scenarios)
    for name, located in of_component.items():
        for scenario in _matched(applied, located.requirement):
            if _has_signals(scenario, requirements[name].requirement.check):
                applied[scenario.name] = _with_requirement(scenario, name)
    return applied


def _matched(scenarios: Mapping[str, Scenario], requirement: Requirement) -> list[Scenario]:
    """The scenarios that a requirement names in ``applies_to``."""
    globs = requirement.applies_to
    return [
        scenario
        for scenario in scenarios.values()
        if any(fnmatchcase(scenario.name, glob) for glob in globs)
    ]


def _with_requirement(scenario: Scenario, name: str) -> Scenario:
    if name in scenario.requirements:
        return scenario
    return scenario.model_copy(update={"requirements": (*scenario.requirements, name)})


def _has_signals(scenario: Scenario, check: Check) -> bool:
    """Whether a scenario's domain declares all signals of a formula; a function reads any."""
    if not isinstance(check, str) or is_function_path(check):
        return True
    formula = read_formula(check)
    known = _known_signals(scenario.system, formula)
    return known is not None and set(formula.signals) <= set(known)


def unmatched_globs(
    scenarios: Mapping[str, Scenario],
    requirements: Mapping[str, LocatedRequirement],
    user_files: set[str],
) -> list[str]:
    """Make a warning for each glob under ``applies_to`` in the user's files without a match."""
    return [
        f"{located.document.file}:"
        f"{located.document.line_of(f'requirements.{located.index}.applies_to.{i}')}: "
        f"the requirement {name!r} applies to {glob!r}, which matches no scenario"
        for name, located in requirements.items()
        if located.document.file in user_files
        for i, glob in enumerate(located.requirement.applies_to)
        if not any(fnmatchcase(scenario, glob) for scenario in scenarios)
    ]


def check_references(
    scenario: Scenario, requirements: Mapping[str, LocatedRequirement]
) -> Iterator[ConfigurationError]:
    """Yield an error for each requirement that does not exist, or cannot be judged here.

    Args:
        scenario: Its domain is known to be one.
        requirements: All there are, by id.
    """
    domain = scenario.system if scenario.requirements else None
    for index in range(len(scenario.requirements)):
        try:
            _check_reference(scenario, domain, index, requirements)
        except ConfigurationError as error:  # noqa: PERF203 - all errors are raised as one
            yield error


def _check_reference(
    scenario: Scenario,
    domain: Domain | None,
    index: int,
    requirements: Mapping[str, LocatedRequirement],
) -> None:
    """Refuse a requirement that does not exist, or cannot be judged in this scenario.

    Raises:
        ConfigurationError: At the place of the mistake, in either file.
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
        _check_paired(scenario, domain, located)
        method_of(requirement, until_decided=scenario.until_decided)
    except ConfigurationError as error:
        raise error_at(error, file=file, line=line, key=key) from None
    try:
        _check_formula(scenario, domain, requirement.check)
    except ConfigurationError as error:
        raise located.error(error) from None


def _check_paired(scenario: Scenario, domain: Domain | None, located: LocatedRequirement) -> None:
    paired = located.requirement.paired
    if paired is None:
        return
    if paired.reference:
        role_spec("generator", RoleSpec(paired.reference), domain)
    if not paired.without:
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
    """Refuse a formula that this scenario's episodes cannot decide; functions are not checked.

    Raises:
        ConfigurationError: For a formula that cannot be read, a signal that the scenario's domain
            does not have, a window that is no multiple of the time step, and windows that reach
            beyond the scenario's duration.
    """
    _check_formula(scenario, scenario.system, check)


def _check_formula(scenario: Scenario, domain: Domain | None, check: Check) -> None:
    if not isinstance(check, str) or not check or is_function_path(check):
        return
    formula = read_formula(check)
    known = _known_signals(domain, formula)
    if known is not None:
        read_formula(check, known)
    check_time_step(formula, scenario.time_step)
    horizon = formula.horizon
    if horizon is not None and horizon > scenario.lasts * (1 + 1e-9):
        raise ConfigurationError(
            f"the windows of the formula reach beyond the episodes of {scenario.name!r}",
            key="check",
            found=f"{formula}, which looks {horizon:g} s ahead",
            expected=f"windows that end within the scenario's duration of {scenario.lasts:g} s",
            remedy="shorten the windows, or lengthen the scenario's `duration`"
            + (" and its `iterations`" if scenario.lasts < scenario.duration else ""),
        )


def _known_signals(domain: Domain | None, formula: Formula) -> tuple[str, ...] | None:
    """List every signal that a formula may read; ``None`` where only the simulator knows them."""
    truth = None if domain is None else domain.signals
    if domain is None or truth is None:
        return None
    prefixed = {
        "percept.": domain.percept_signals,
        PROPOSAL_PREFIX: domain.proposal_signals,
    }
    named = [
        name
        for prefix, names in prefixed.items()
        for name in (
            [read for read in formula.signals if read.startswith(prefix)]
            if names is None
            else [prefix + signal.name for signal in names]
        )
    ]
    return (*(signal.name for signal in truth), *named, *LOOP_SIGNALS)


def unused_requirements(
    scenarios: Mapping[str, Scenario],
    requirements: Mapping[str, LocatedRequirement],
    user_files: set[str],
) -> dict[str, str]:
    """Map the requirements in the user's files that no scenario uses to their ``file:line``."""
    used = {name for scenario in scenarios.values() for name in scenario.requirements}
    return {
        name: f"{located.document.file}:{located.line}"
        for name, located in requirements.items()
        if name not in used and located.document.file in user_files
    }
