"""Requirement files: which files they are, and what they hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field

from pytest_dura.campaign.problems import combine, placed
from pytest_dura.campaign.scenario import Entry, not_empty
from pytest_dura.campaign.validation import validate
from pytest_dura.campaign.yaml_source import Document
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.bounds import parse
from pytest_dura.requirements.model import Kind, Requirement


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
    """Formula that each episode must satisfy, such as `always (gap > 0)`; empty for test code."""
    reason: str = ""
    """Why the bound is what it is."""


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

    def error(self, error: ConfigurationError) -> ConfigurationError:
        """An error of its check, told at the check's place in the file."""
        key = f"requirements.{self.index}.check"
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
        located = Located(Requirement(**entry.model_dump()), document, index)
        found.append(located)
        try:
            if entry.check:
                parse(entry.check)
        except ConfigurationError as error:
            errors.append(located.error(error))
    if errors:
        raise combine(errors)
    return found
