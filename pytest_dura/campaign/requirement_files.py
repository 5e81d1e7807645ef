"""Requirement files: which files they are, and what they hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from pytest_dura.campaign.problems import combine, placed
from pytest_dura.campaign.scenario import Entry, not_empty
from pytest_dura.campaign.validation import validate
from pytest_dura.campaign.yaml_source import Document
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.checks import is_function_path, load_function, read_formula
from pytest_dura.requirements.model import Kind, Method, Paired, Requirement
from pytest_dura.requirements.pairs.verdicts import check_comparison
from pytest_dura.requirements.verdicts.judging import CampaignJudge


class PairedEntry(Entry):
    """A requirement on pairs: the same seeds with something and without it."""

    without: str = Field(min_length=1)
    """`faults`, or the role that is switched off in the second run of each pair."""
    measure: str = ""
    """Import path `package.module:function` of a function of an episode to a number."""
    change_at_most: float | None = None
    """Greatest acceptable growth of the measure, in its unit."""

    @model_validator(mode="after")
    def _complete(self) -> PairedEntry:
        if bool(self.measure) != (self.change_at_most is not None):
            raise ValueError("`measure` and `change_at_most` go together")
        return self


class RequirementEntry(Entry):
    """One requirement."""

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

    def requirement(self) -> Requirement:
        """The requirement."""
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
class Located:
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
        """An error of its check, or of another key, told at its place in the file."""
        key = f"requirements.{self.index}.{key}"
        return placed(error, file=self.document.file, line=self.document.line_of(key), key=key)


def is_requirement_file(document: Document) -> bool:
    """Whether a file is named ``requirements*`` or lists mappings with an id as requirements."""
    if Path(document.file).name.startswith("requirements"):
        return True
    entries = document.data.get("requirements")
    return isinstance(entries, list) and any(
        isinstance(entry, Mapping) and "id" in entry for entry in entries
    )


def read_requirements(document: Document) -> list[Located]:
    """The requirements of a file, each with a check that can be read.

    Raises:
        ConfigurationError: One for all that is wrong with the file.
    """
    found, errors = [], []
    for index, entry in enumerate(validate(RequirementFile, document).requirements):
        located = Located(entry.requirement(), document, index)
        found.append(located)
        errors += _problems(located)
    if errors:
        raise combine(errors)
    return found


def _problems(located: Located) -> list[ConfigurationError]:
    """What would keep the requirement from being judged, each at its place."""
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
    for key, path in functions.items():
        try:
            if path:
                load_function(path)
        except ConfigurationError as error:  # noqa: PERF203 - all errors are told at once
            errors.append(located.error(error, key))
    return errors
