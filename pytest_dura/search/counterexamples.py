"""Counterexamples: replayed, made simpler, and written as scenario files for people."""

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

from pytest_dura.campaign.falsification import FoundCounterexample, Shrinking
from pytest_dura.core.errors import ConfigurationError, combine_errors
from pytest_dura.core.files import replace_file
from pytest_dura.domains import simulator_spec
from pytest_dura.faults.catalogue import BY_CHANCE
from pytest_dura.library.cases import SEARCHED_MARK, SearchedCase, expand_cases
from pytest_dura.library.checks import scenario_problems
from pytest_dura.library.documents import read_yaml
from pytest_dura.library.planned_faults import parse_fault
from pytest_dura.library.scenario import Scenario, check_world
from pytest_dura.requirements.checks import Check, check_name, is_function_path, load_function
from pytest_dura.requirements.model import Requirement
from pytest_dura.search.differences import changes_of
from pytest_dura.search.portfolio import finite_or_none
from pytest_dura.search.shrinking import shrink
from pytest_dura.search.trials import Objective, Trials


def _without_defaults(
    data: dict[str, Any], filled: Callable[[Any], Any], fixed: Iterable[str] = ()
) -> dict[str, Any]:
    """The data without the keys that come back by themselves when it is filled in.

    Args:
        data: Plain data.
        filled: The data with defaults filled in.
        fixed: Keys that stay.
    """
    whole = filled(data)

    def same(trial: Any) -> bool:
        try:
            return bool(filled(trial) == whole)
        except ConfigurationError:
            return False

    def pruned(inner: Any, put: Any) -> Any:
        if isinstance(inner, Mapping):
            kept = dict(inner)
            for key in inner:
                if key in fixed:
                    continue
                without = {name: value for name, value in kept.items() if name != key}
                if same(put(without)):
                    kept = without
                else:
                    kept[key] = pruned(
                        kept[key], lambda value, kept=kept, key=key: put({**kept, key: value})
                    )
            return kept
        if isinstance(inner, (list, tuple)):
            items = list(inner)
            for number, item in enumerate(items):
                items[number] = pruned(
                    item,
                    lambda value, items=items, number=number: put(
                        [*items[:number], value, *items[number + 1 :]]
                    ),
                )
            return items
        return inner

    return dict(pruned(data, lambda value: value))


_FOLDER = "found"
"""Below the project's folder of scenarios, and before the names of what is kept there."""
_WIDTH = 98
_LONGEST = 60
"""Characters of a text within a name: of three together, a file's name has room for 255."""
_LAST = ("world", "faults", "requirements")


@dataclass(frozen=True)
class StoredCounterexample:
    """A counterexample that is kept.

    Args:
        file: The scenario file.
        scenario: What it reads as.
        requirement: The requirement that it is a counterexample to, as its file defines it.
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
    told: Sequence[str] = (),
) -> StoredCounterexample:
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
        named = _requirement_of_case(requirement, check)
        _write(folder / _FOLDER / "requirements" / f"{named.id}.yaml", _requirement_text(named))
    which = _label(named.id.removesuffix(f".{_FOLDER}"), _LONGEST)
    drawn = _slug(case.id.partition(SEARCHED_MARK)[2])
    name = f"{_slug(case.scenario.name)[:_LONGEST]}-{which}-{drawn}"
    data = _plain_scenario(case) | {"name": f"{_FOLDER}/{name}", "requirements": [named.id]}
    data = {key: data[key] for key in sorted(data, key=lambda key: (key in _LAST, key != "name"))}
    file = folder / _FOLDER / f"{name}.yaml"
    _write(file, _commented(told) + _yaml(data))
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
    data["world"] = _without_defaults(
        dict(scenario.world), lambda world: check_world(scenario, simulator, world)
    )
    data["faults"] = [_plain_fault(scenario, fault) for fault in case.faults]
    return {key: value for key, value in data.items() if key == "world" or value not in ([], {})}


def _plain_fault(scenario: Scenario, fault: Mapping[str, Any]) -> dict[str, Any]:
    given = {key: value for key, value in fault.items() if key != BY_CHANCE}
    return _without_defaults(
        given, lambda item: parse_fault(scenario, item), fixed=("type", "target")
    )


def _requirement_of_case(requirement: Requirement, check: Check | None) -> Requirement:
    """What this very case may not violate, for a requirement that no file defines like that."""
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
    # Other checks have other names, however alike: one file is never written over another.
    name = f"{_slug(requirement.id)[:40]}-{_digest(f'{requirement.id}: {text}')}.{_FOLDER}"
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
        dict(data), sort_keys=False, default_flow_style=flow, allow_unicode=True, width=_WIDTH
    )


def _commented(told: Sequence[str]) -> str:
    """Comment lines; no text can end one and so become a key."""
    lines = []
    for text in told:
        plain = "".join(item if item.isprintable() else " " for item in text)
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


CounterexampleStore = Callable[
    [SearchedCase, Objective, Sequence[str]], tuple[StoredCounterexample, str]
]
"""Keeps a counterexample; returns what was kept and its file as the project names it."""


@dataclass(frozen=True)
class ConfirmedCounterexample:
    """A violation with what came of replaying it.

    Args:
        case: The case, made simpler where that was asked for.
        found: What is told of it.
    """

    case: SearchedCase
    found: FoundCounterexample


def confirm_violation(
    trials: Trials, asked: Objective, case: SearchedCase, budget: int
) -> ConfirmedCounterexample:
    """Replay a violation, and make it simpler if the replay is equal.

    Args:
        trials: Runs it.
        asked: What it violates.
        case: The case.
        budget: Simulations for making it simpler.
    """
    episode, repeats = trials.repeated(case, asked)
    shrinking = None
    if repeats.confirmed and budget:

        def violates(trial: SearchedCase) -> bool:
            return asked.judge(trials.runner.searched(trial)).status == "violated"

        shrunk = shrink(
            trials.space.case, case, violates, budget=budget, simulator=trials.runner.simulator
        )
        simpler, again = trials.repeated(shrunk.case, asked)
        # A component that repeats itself here need not do so there: what is confirmed, stays.
        if again.confirmed:
            case, episode, repeats = shrunk.case, simpler, again
            shrinking = Shrinking(
                shrunk.before, shrunk.after, shrunk.simulations, budget, shrunk.finished
            )
    verdict = asked.judge(episode)
    counterexample = FoundCounterexample(
        case=case.id,
        scenario=case.data,
        seed=episode.spec.seed,
        digest=episode.digest,
        margin=None if verdict.margin is None else finite_or_none(verdict.margin),
        time=verdict.time,
        detail=verdict.detail,
        repeats=repeats,
        changes=changes_of(trials.space.case, case, simulator=trials.runner.simulator),
        shrinking=shrinking,
    )
    return ConfirmedCounterexample(case, counterexample)


def store_counterexample(
    trials: Trials,
    asked: Objective,
    confirmed: ConfirmedCounterexample,
    keep: CounterexampleStore,
    how: str,
) -> FoundCounterexample:
    """The counterexample with the file that keeps it, which was read back and run.

    Args:
        trials: Runs it.
        asked: What it violates.
        confirmed: The counterexample.
        keep: Writes the file.
        how: Where it comes from, in words.

    Raises:
        ConfigurationError: If it cannot be kept, or does not come up again from its file.
    """
    found = confirmed.found
    made, file = keep(confirmed.case, asked, _file_heading(trials, asked, found, how))
    (read,) = expand_cases([made.scenario])
    # A requirement of its own is not among those that this session has read.
    again = replace(read, requirements=confirmed.case.requirements)
    verdict = asked.judge(trials.runner.searched(again))
    if verdict.status != "violated" or verdict.margin != found.margin:
        made.file.unlink()
        raise ConfigurationError(
            f"a counterexample to {asked.requirement.id} does not come up again from its file",
            file=file,
            found=f"{verdict.status}, margin {verdict.margin}",
            expected=f"violated, margin {found.margin}",
            remedy="please report this with the scenario and the command",
        )
    return replace(found, file=file, name=made.scenario.name)


def _file_heading(
    trials: Trials, asked: Objective, counterexample: FoundCounterexample, how: str
) -> list[str]:
    """The head of the file."""
    case = trials.space.case
    component = case.roles(trials.runner.roles)["generator"].label
    when = "" if counterexample.time is None else f" at t = {counterexample.time:g} s"
    margin = "" if counterexample.margin is None else f", margin {counterexample.margin:.4g}"
    lines = [
        f"{component} violates {asked.requirement.id} here{when}{margin}: {asked.name}",
        f"From {case.id}, {how}; confirmed by replay.",
    ]
    if counterexample.shrinking is not None:
        shrinking = counterexample.shrinking
        lines.append(
            f"Made simpler from {shrinking.before} to {shrinking.after} parameters that"
            " differ from it."
        )
    return lines
