"""Found: a counterexample as a scenario file that people can read, collected from then on."""

from __future__ import annotations

import hashlib
import re
import textwrap
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from pytest_dura.campaign.checks import problems_of
from pytest_dura.campaign.domains import simulator_spec
from pytest_dura.campaign.planned_faults import parsed
from pytest_dura.campaign.problems import combine
from pytest_dura.campaign.scenario import Scenario
from pytest_dura.campaign.search.pruning import needed
from pytest_dura.campaign.search.space.searched import MARK, SearchedCase
from pytest_dura.campaign.worlds import checked_world
from pytest_dura.campaign.yaml_source import read_yaml
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.whole_files import replace_file
from pytest_dura.faults.catalogue import BY_CHANCE
from pytest_dura.requirements.checks import Check, check_name, is_function_path, load_function
from pytest_dura.requirements.model import Requirement

FOLDER = "found"
"""Below the project's folder of scenarios, and before the names of what is kept there."""
_WIDTH = 98
_LONGEST = 60
"""Characters of a text within a name: of three together, a file's name has room for 255."""
_LAST = ("world", "faults", "requirements")


@dataclass(frozen=True)
class Kept:
    """A counterexample that is kept.

    Args:
        file: The scenario file.
        scenario: What it reads as.
        requirement: The requirement that it is a counterexample to, as its file defines it.
    """

    file: Path
    scenario: Scenario
    requirement: Requirement


def keep(
    folder: Path,
    case: SearchedCase,
    requirement: Requirement,
    check: Check | None = None,
    *,
    defined: bool,
    told: Sequence[str] = (),
) -> Kept:
    """Write a counterexample to a scenario file, and read it back.

    A requirement that a file defines and that no episode may violate is named as such. Any other
    one, such as a rate, gets a file of its own beside it, by which this very case may not violate
    its check.

    Args:
        folder: Where scenarios are found; the file goes into ``found`` below it.
        case: The counterexample.
        requirement: What it violates.
        check: In place of the requirement's own.
        defined: Whether a requirement file defines the requirement.
        told: Lines on where it comes from, for the head of the file.

    Raises:
        ConfigurationError: If the check has no name that a file could hold, the file cannot be
            written, or it reads as something else than the case.
    """
    named = requirement
    if not defined or check is not None or requirement.at_most is not None:
        named = _never_here(requirement, check)
        _write(folder / FOLDER / "requirements" / f"{named.id}.yaml", _requirement_text(named))
    which = _label(named.id.removesuffix(f".{FOLDER}"), _LONGEST)
    name = f"{_slug(case.scenario.name)[:_LONGEST]}-{which}-{_slug(case.id.partition(MARK)[2])}"
    data = plain_scenario(case) | {"name": f"{FOLDER}/{name}", "requirements": [named.id]}
    data = {key: data[key] for key in sorted(data, key=lambda key: (key in _LAST, key != "name"))}
    file = folder / FOLDER / f"{name}.yaml"
    _write(file, _commented(told) + _yaml(data))
    try:
        scenario = Scenario.from_document(read_yaml(file))
        problems = problems_of(scenario)
        if problems:
            raise combine(problems)
    except ConfigurationError:
        file.unlink()  # the next session would refuse the whole folder
        raise
    return Kept(file, scenario, named)


def plain_scenario(case: SearchedCase) -> dict[str, Any]:
    """The case's scenario as plain data, without what is so by default."""
    data = dict(case.data)
    data |= {"description": f"A counterexample to a requirement on {case.scenario.name}."}
    if case.policy != Scenario.model_fields["policy"].default:
        data["policy"] = case.policy
    if not data["simulator"].get("params"):
        data["simulator"] = data["simulator"]["path"]
    if case.without:
        data["roles"] = {**data.get("roles", {}), **dict.fromkeys(case.without)}
    scenario = case.scenario
    simulator = simulator_spec(scenario.simulator.path, scenario.simulator.params)
    data["world"] = needed(
        dict(scenario.world), lambda world: checked_world(scenario, simulator, world)
    )
    data["faults"] = [_plain_fault(scenario, fault) for fault in case.faults]
    return {key: value for key, value in data.items() if key == "world" or value not in ([], {})}


def _plain_fault(scenario: Scenario, fault: Mapping[str, Any]) -> dict[str, Any]:
    given = {key: value for key, value in fault.items() if key != BY_CHANCE}
    return needed(given, lambda one: parsed(scenario, one), fixed=("type", "target"))


def _never_here(requirement: Requirement, check: Check | None) -> Requirement:
    """What this very case may not violate, for a requirement that no file defines like that."""
    given = requirement.check if check is None else check
    text = check_name(given)
    if callable(given):
        found = None
        with suppress(ConfigurationError):
            found = load_function(text) if is_function_path(text) else None
        if found is not given:
            raise ConfigurationError(
                "no file can name this check",
                key="check",
                found=text,
                expected="a formula, or a function at the top of a module that can be imported",
                remedy="move the function to a module, and give its path package.module:function",
            )
    # Other checks have other names, however alike: one file is never written over another.
    name = f"{_slug(requirement.id)[:40]}-{_digest(f'{requirement.id}: {text}')}.{FOLDER}"
    what = " ".join((requirement.text or text).split())
    return Requirement(
        name,
        f"In this very case: {what}",
        requirement.kind,
        source=requirement.source,
        check=text,
        reason=f"A counterexample to {requirement.id} was found here.",
    )


def _requirement_text(one: Requirement) -> str:
    keys = ("id", "text", "kind", "source", "check", "reason")
    entry = {key: value for key in keys if (value := getattr(one, key))}
    return _yaml({"requirements": [entry]}, flow=False)


def _yaml(data: Mapping[str, Any], *, flow: bool | None = None) -> str:
    return yaml.safe_dump(
        dict(data), sort_keys=False, default_flow_style=flow, allow_unicode=True, width=_WIDTH
    )


def _commented(told: Sequence[str]) -> str:
    """Comment lines; no text can end one and so become a key."""
    lines = []
    for text in told:
        plain = "".join(one if one.isprintable() else " " for one in text)
        lines += [f"# {line}\n" for line in textwrap.wrap(plain, _WIDTH) or [""]]
    return "".join(lines)


def _label(text: str, most: int) -> str:
    """The text where a name can hold it, else as much of it as can, and its digest."""
    slug = _slug(text)
    return slug if slug == text and len(slug) <= most else f"{slug[:most]}-{_digest(text)}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "backslashreplace")).hexdigest()[:8]


def _slug(text: str) -> str:
    slug = re.sub(r"[^A-Za-z0-9_.-]+", "-", text).strip("-._")
    return slug or "case"


def _write(file: Path, text: str) -> None:
    """Whole or not at all; another process may be at the same."""
    try:
        replace_file(file, [text.encode()], durable=True)
    except OSError as error:
        raise ConfigurationError(
            f"a counterexample cannot be kept: {error.strerror or error}",
            file=str(file),
            expected="a folder that can be written",
            remedy="make room for it, or set ini dura_scenario_paths to another folder",
        ) from None
