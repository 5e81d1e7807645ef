"""Counterexamples: replay them, make them simpler, and write them as readable scenario files."""

from __future__ import annotations

import hashlib
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from pytest_dura.core.errors import ConfigurationError, combine_errors
from pytest_dura.core.fault import Fault
from pytest_dura.core.files import replace_file
from pytest_dura.library.cases import SearchedCase, expand_cases
from pytest_dura.library.checks import scenario_problems
from pytest_dura.library.documents import read_yaml
from pytest_dura.library.loading import FOUND
from pytest_dura.library.planned_faults import parse_fault
from pytest_dura.library.scenario import Scenario, check_world
from pytest_dura.requirements.campaign_verdicts import violation_text
from pytest_dura.requirements.checks import Check, check_name, is_function_path, load_function
from pytest_dura.requirements.episode_verdicts import SearchedEpisode
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.searches import SEARCHED_MARK, FoundCounterexample, Shrinking
from pytest_dura.search.portfolio import finite_or_none
from pytest_dura.search.shrinking import shrink
from pytest_dura.search.simplification import ABSENT, Keys, changes_of, value_at, with_value
from pytest_dura.search.trials import Objective, Trials


def _without_defaults(
    data: dict[str, Any], filled: Callable[[Any], Any], fixed: Iterable[str] = ()
) -> dict[str, Any]:
    """Remove the keys that hold their defaults.

    Args:
        data: Plain data.
        filled: Fills in the defaults.
        fixed: Keys that stay.
    """
    complete = filled(data)

    def is_equal(trial: Any) -> bool:
        try:
            return bool(filled(trial) == complete)
        except ConfigurationError:
            return False

    def pruned(whole: dict[str, Any], keys: Keys) -> dict[str, Any]:
        part = value_at(whole, keys)
        if isinstance(part, Mapping):
            for key in [key for key in part if key not in fixed]:
                without = with_value(whole, (*keys, key), ABSENT)
                whole = without if is_equal(without) else pruned(whole, (*keys, key))
        elif isinstance(part, (list, tuple)):
            for i in range(len(part)):
                whole = pruned(whole, (*keys, i))
        return whole

    return pruned(data, ())


_LINE_WIDTH = 98
_MAX_NAME_PART = 60
"""Characters of each part of a file's name: it has three, and room for 255 characters."""
_LAST_KEYS = ("world", "faults", "requirements")


@dataclass(frozen=True)
class StoredCounterexample:
    """A counterexample in a scenario file.

    Args:
        file: The file.
        scenario: The scenario that was read back from it.
        requirement: The requirement that it violates, as a file defines it.
    """

    file: Path
    scenario: Scenario
    requirement: Requirement


def write_counterexample(
    folder: Path,
    case: SearchedCase,
    requirement: Requirement,
    check: Check | None = None,
    *,
    defined: bool,
    heading: Sequence[str] = (),
) -> StoredCounterexample:
    """Write a counterexample to a scenario file, and read it back.

    A requirement that a file defines and that no episode may violate is named by its id. For any
    other, such as a rate, a requirement file is written: this very case may not violate its check.

    Args:
        folder: A folder of scenarios; the file goes into its folder ``found``.
        case: The counterexample.
        requirement: What it violates.
        check: In place of the requirement's own.
        defined: Whether a requirement file defines the requirement.
        heading: Lines on its origin, for comments at the head of the file.

    Raises:
        ConfigurationError: If the check has no name that a file could hold, the file cannot be
            written, or it reads as something else than the case.
    """
    named = requirement
    if not defined or check is not None or requirement.at_most is not None:
        named = _requirement_of_case(requirement, check)
        _write(folder / FOUND / "requirements" / f"{named.id}.yaml", _requirement_text(named))
    label = _label(named.id.removesuffix(f".{FOUND}"), _MAX_NAME_PART)
    digest = _slug(case.id.partition(SEARCHED_MARK)[2])
    name = f"{_slug(case.scenario.name)[:_MAX_NAME_PART]}-{label}-{digest}"
    data = _plain_scenario(case) | {"name": f"{FOUND}/{name}", "requirements": [named.id]}
    data = {
        key: data[key] for key in sorted(data, key=lambda key: (key in _LAST_KEYS, key != "name"))
    }
    file = folder / FOUND / f"{name}.yaml"
    _write(file, _comments(heading) + _yaml(data))
    try:
        scenario = Scenario.from_document(read_yaml(file))
        problems = scenario_problems(scenario)
        if problems:
            raise combine_errors(problems)
    except ConfigurationError:
        file.unlink()  # the next session would refuse the whole folder
        raise
    return StoredCounterexample(file, scenario, named)


def _plain_scenario(case: SearchedCase) -> dict[str, Any]:
    """Return the case's scenario as plain data, without defaults."""
    data = dict(case.data)
    data |= {"description": f"A counterexample to a requirement on {case.scenario.name}."}
    if case.policy != Scenario.model_fields["policy"].default:
        data["policy"] = case.policy
    if not data["simulator"].get("params"):
        data["simulator"] = data["simulator"]["path"]
    if case.without:
        data["roles"] = {**data.get("roles", {}), **dict.fromkeys(case.without)}
    scenario = case.scenario
    simulator = scenario.simulator_spec()
    data["world"] = _without_defaults(
        dict(scenario.world), lambda world: check_world(scenario, simulator, world)
    )
    data["faults"] = [_written_fault(scenario, fault) for fault in case.faults]
    return {key: value for key, value in data.items() if key == "world" or value not in ([], {})}


def _written_fault(scenario: Scenario, fault: Fault) -> dict[str, Any]:
    return _without_defaults(
        fault.in_file(), lambda data: parse_fault(scenario, data), fixed=("type", "target")
    )


def _requirement_of_case(requirement: Requirement, check: Check | None) -> Requirement:
    """Make the requirement that this very case may not violate."""
    given = requirement.check if check is None else check
    text = check_name(given)
    if callable(given):
        function = None
        with suppress(ConfigurationError):
            function = load_function(text) if is_function_path(text) else None
        if function is not given:
            raise ConfigurationError(
                "no file can name this check",
                key="check",
                found=text,
                expected="a formula, or a function at the top of a module that can be imported",
                remedy="move the function to a module, and give its path package.module:function",
            )
    # Other checks have other names, however alike, so that no file overwrites another.
    name = f"{_slug(requirement.id)[:40]}-{_digest(f'{requirement.id}: {text}')}.{FOUND}"
    what = " ".join((requirement.text or text).split())
    return Requirement(
        name,
        f"In this very case: {what}",
        requirement.kind,
        source=requirement.source,
        check=text,
        reason=f"A counterexample to {requirement.id} was found here.",
    )


def _requirement_text(requirement: Requirement) -> str:
    keys = ("id", "text", "kind", "source", "check", "reason")
    entry = {key: value for key in keys if (value := getattr(requirement, key))}
    return _yaml({"requirements": [entry]}, flow=False)


def _yaml(data: Mapping[str, Any], *, flow: bool | None = None) -> str:
    return yaml.safe_dump(
        dict(data), sort_keys=False, default_flow_style=flow, allow_unicode=True, width=_LINE_WIDTH
    )


def _comments(texts: Sequence[str]) -> str:
    """Make comment lines; no text can end a line and so become a key."""
    lines = []
    for text in texts:
        plain = "".join(char if char.isprintable() else " " for char in text)
        lines += [f"# {line}\n" for line in textwrap.wrap(plain, _LINE_WIDTH) or [""]]
    return "".join(lines)


def _label(text: str, most: int) -> str:
    """Return the text if a name can hold it, else its beginning and its digest."""
    slug = _slug(text)
    return slug if slug == text and len(slug) <= most else f"{slug[:most]}-{_digest(text)}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "backslashreplace")).hexdigest()[:8]


def _slug(text: str) -> str:
    slug = re.sub(r"[^A-Za-z0-9_.-]+", "-", text).strip("-._")
    return slug or "case"


def _write(file: Path, text: str) -> None:
    """Write a whole file or none; another process may write the same file."""
    try:
        replace_file(file, [text.encode()], durable=True)
    except OSError as error:
        raise ConfigurationError(
            f"a counterexample cannot be kept: {error.strerror or error}",
            file=str(file),
            expected="a folder that can be written",
            remedy="make room for it, or set ini dura_scenario_paths to another folder",
        ) from None


CounterexampleStore = Callable[
    [SearchedCase, Objective, Sequence[str]], tuple[StoredCounterexample, str]
]
"""Stores a case that violates an objective under some heading; returns it, and its file's path from
the project's root."""


@dataclass(frozen=True)
class ConfirmedCounterexample:
    """A violating case that was replayed.

    Args:
        case: The case, made simpler if there was a budget for that.
        counterexample: Its report.
    """

    case: SearchedCase
    counterexample: FoundCounterexample


def confirm_violation(
    trials: Trials,
    objective: Objective,
    case: SearchedCase,
    budget: int,
    also: Callable[[SearchedEpisode], bool] = lambda _: True,
) -> ConfirmedCounterexample:
    """Replay a violation, and make it simpler if the replay is equal.

    Args:
        trials: Runs it.
        objective: The requirement that it violates.
        case: The case.
        budget: Greatest number of simulations for making it simpler.
        also: What else has to hold of the episode of a simpler case.
    """
    nominal, simulator = trials.space.case, trials.runner.simulator
    episode, repeats = trials.replay(case, objective)
    shrinking: Shrinking | None = None
    if repeats.confirmed and budget:
        with trials.phase(f"simpler {objective.requirement.id}", budget) as simulated:

            def violates(trial: SearchedCase) -> bool:
                episode = trials.runner.searched(trial)
                simulated()
                return objective.judge(episode).status == "violated" and also(episode)

            shrunk = shrink(nominal, case, violates, budget=budget, simulator=simulator)
        simpler, simpler_repeats = trials.replay(shrunk.case, objective)
        # A component may repeat itself in the case that was found, and not in the simpler one.
        if simpler_repeats.confirmed:
            case, episode, repeats = shrunk.case, simpler, simpler_repeats
            shrinking = shrunk.shrinking
    verdict = objective.judge(episode)
    counterexample = FoundCounterexample(
        case=case.id,
        scenario=case.data,
        seed=episode.spec.seed,
        digest=episode.digest,
        margin=None if verdict.margin is None else finite_or_none(verdict.margin),
        time=verdict.time,
        detail=verdict.detail,
        repeats=repeats,
        changes=changes_of(nominal, case, simulator=simulator),
        shrinking=shrinking,
    )
    return ConfirmedCounterexample(case, counterexample)


def store_counterexample(
    trials: Trials,
    objective: Objective,
    confirmed: ConfirmedCounterexample,
    store: CounterexampleStore,
    origin: str,
) -> FoundCounterexample:
    """Store a counterexample, and run it from its file; return its report with the file.

    Args:
        trials: Runs it.
        objective: The requirement that it violates.
        confirmed: The counterexample.
        store: Writes the file.
        origin: Where it comes from, in words.

    Raises:
        ConfigurationError: If it cannot be stored, or its file does not violate the requirement by
            the same margin.
    """
    counterexample = confirmed.counterexample
    heading = _file_heading(trials, objective, counterexample, origin)
    stored, file = store(confirmed.case, objective, heading)
    (read,) = expand_cases([stored.scenario])
    # A requirement that was written for this case is not in the session's library.
    again = replace(read, requirements=confirmed.case.requirements)
    verdict = objective.judge(trials.runner.searched(again))
    if verdict.status != "violated" or verdict.margin != counterexample.margin:
        stored.file.unlink()
        raise ConfigurationError(
            f"a counterexample to {objective.requirement.id} does not come up again from its file",
            file=file,
            found=f"{verdict.status}, margin {verdict.margin}",
            expected=f"violated, margin {counterexample.margin}",
            remedy="please report this with the scenario and the command",
        )
    return replace(counterexample, file=file, name=stored.scenario.name)


def _file_heading(
    trials: Trials, objective: Objective, counterexample: FoundCounterexample, origin: str
) -> list[str]:
    case = trials.space.case
    component = case.roles(trials.runner.roles)["generator"].label
    when = violation_text(counterexample.time, counterexample.margin)
    lines = [
        f"{component} violates {objective.requirement.id} here{when}: {objective.name}",
        f"From {case.id}, {origin}; confirmed by replay.",
    ]
    if counterexample.shrinking is not None:
        shrinking = counterexample.shrinking
        lines.append(
            f"Made simpler from {shrinking.before} to {shrinking.after} parameters that"
            " differ from it."
        )
    return lines
