"""Hazard files: read them, and match their hazards with the requirements that mitigate them.

``python -m pytest_dura.library.hazards`` writes the JSON Schema of such files for editors.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from pytest_dura.core.errors import ConfigurationError, did_you_mean, list_names
from pytest_dura.library.documents import Document, validate
from pytest_dura.library.requirements import LocatedRequirement
from pytest_dura.library.scenario import DIALECT, Entry, not_empty
from pytest_dura.requirements.hazards import Hazard, Severity

SCHEMA_FILE = "hazards.schema.json"


class HazardEntry(Entry):
    """A hazard in a file: a state of the system that leads to a loss in worst-case conditions."""

    id: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    """Unique name, such as `H-1`."""
    text: str = Field(min_length=1)
    """The state of the system, in words: not its cause, and not the accident."""
    loss: str = Field(min_length=1)
    """The loss that it may lead to, such as `L-1: life and health`."""
    severity: Severity | None = None
    """Class of severity as you declare it, by the names of ISO 26262-3: `S0` no injuries to `S3`
    life-threatening or fatal ones; default: none is declared."""
    operating_condition: str = ""
    """Under which conditions of operation it leads to the loss."""
    triggering_condition: str = ""
    """Which conditions of a scene, or which attacks, may bring it about."""
    source: str = ""
    """Which analysis it comes from."""
    acceptance_criterion: str = ""
    """Which residual risk you accept, in words."""
    at_most: float | None = Field(default=None, gt=0, lt=1)
    """Greatest rate of runs that you accept to violate a requirement on it, in each case: what the
    bounds of the verdicts are held against."""

    def hazard(self) -> Hazard:
        """Make the hazard."""
        return Hazard(**self.model_dump())


class HazardFile(Entry):
    """A file of hazards."""

    hazards: Annotated[tuple[HazardEntry, ...], Field(strict=False), AfterValidator(not_empty)]
    """The hazards."""


@dataclass(frozen=True)
class LocatedHazard:
    """A hazard and the place where it is defined."""

    hazard: Hazard
    document: Document
    index: int

    @property
    def key(self) -> str:
        """Dotted key of its id."""
        return f"hazards.{self.index}.id"


def is_hazard_file(document: Document) -> bool:
    """Whether a file is named ``hazards*``, or lists hazards."""
    return Path(document.file).name.startswith("hazards") or "hazards" in document.data


def read_hazards(document: Document) -> list[LocatedHazard]:
    """Read the hazards of a file.

    Raises:
        ConfigurationError: One for all errors in the file.
    """
    entries = validate(HazardFile, document).hazards
    return [LocatedHazard(entry.hazard(), document, index) for index, entry in enumerate(entries)]


def mitigation_errors(
    names: Sequence[str], hazards: Collection[str]
) -> Iterator[tuple[int, ConfigurationError]]:
    """Yield the index and an error for each name that no hazard has, or that stands twice.

    Args:
        names: Hazards that a requirement mitigates.
        hazards: Ids of all hazards of the session.
    """
    for index, name in enumerate(names):
        if name not in hazards:
            yield (
                index,
                ConfigurationError(
                    f"unknown hazard {name!r}",
                    found=name,
                    expected=f"one of {list_names(sorted(hazards))}" if hazards else "a hazard",
                    remedy=did_you_mean(name, hazards)
                    if hazards
                    else "define it in a hazard file, hazards.yaml",
                ),
            )
        elif name in names[:index]:
            yield (
                index,
                ConfigurationError(
                    f"the hazard {name!r} stands here twice",
                    found=name,
                    expected="each hazard once",
                    remedy="remove one of them",
                ),
            )


def mitigation_problems(
    requirements: Mapping[str, LocatedRequirement], hazards: Collection[str]
) -> list[ConfigurationError]:
    """List what is wrong under ``mitigates`` of requirements, each error at its place."""
    return [
        located.error(error, f"mitigates.{index}")
        for located in requirements.values()
        for index, error in mitigation_errors(located.requirement.mitigates, hazards)
    ]


def hazard_schema() -> dict[str, Any]:
    """Make the JSON Schema of hazard files."""
    return {"$schema": DIALECT, **HazardFile.model_json_schema()}


def write_hazard_schema(path: Path) -> None:
    """Write the schema to a file; equal schemas give equal bytes."""
    path.write_text(json.dumps(hazard_schema(), indent=2, sort_keys=True) + "\n", "utf-8")


if __name__ == "__main__":
    _own = Path(__file__).resolve().parents[2] / "scenarios" / SCHEMA_FILE
    write_hazard_schema(Path(sys.argv[1]) if sys.argv[1:] else _own)
