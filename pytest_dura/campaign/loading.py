"""Finding and reading scenario and requirement files."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TypeVar

from pytest_dura.campaign.cases import no_match
from pytest_dura.campaign.checks import problems_of
from pytest_dura.campaign.domains import domain_of
from pytest_dura.campaign.problems import combine, did_you_mean
from pytest_dura.campaign.requirement_files import Located, is_requirement_file, read_requirements
from pytest_dura.campaign.scenario import Scenario
from pytest_dura.campaign.worlds import signal_names
from pytest_dura.campaign.yaml_source import Document, read_yaml
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.bounds import check_time_step, parse
from pytest_dura.requirements.model import Requirement

SUFFIXES = (".yaml", ".yml")
SCHEMA_FILE = "scenario.schema.json"

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class Library:
    """All scenarios and requirements of a session, checked against each other.

    ``warnings`` are messages on what is allowed but probably not meant.
    """

    scenarios: dict[str, Scenario]
    requirements: dict[str, Requirement]
    warnings: tuple[str, ...] = ()


def builtin_paths() -> list[Path]:
    """The folder of the built-in scenarios, in a wheel and in an editable install alike.

    Raises:
        ConfigurationError: If the installation has none.
    """
    package = Path(__file__).resolve().parents[1]
    candidates = [package / "scenarios", package.parent / "scenarios"]
    found = [folder for folder in candidates if (folder / SCHEMA_FILE).is_file()]
    if not found:
        raise ConfigurationError(
            "the built-in scenarios are missing from this installation",
            found=", ".join(map(str, candidates)),
            expected=f"a folder with {SCHEMA_FILE}",
            remedy="install pytest-dura again",
        )
    return found[:1]


def load_library(paths: Sequence[Path | str], *, builtin: bool = True) -> Library:
    """Everything below the given paths, and the built-in files.

    Raises:
        ConfigurationError: One for all that is wrong in any file.
    """
    own = [Path(path) for path in paths]
    everything = [*builtin_paths(), *own] if builtin else own
    documents = _documents(everything)
    scenarios = _scenarios(documents)
    requirements = _requirements(documents)
    _check_references(scenarios, requirements)
    theirs = {str(file) for path in own for file in _files(path)}
    warnings = [*_unused(scenarios, requirements, theirs), *_too_long(scenarios, requirements)]
    plain = {name: one.requirement for name, one in requirements.items()}
    return Library(scenarios, plain, tuple(warnings))


def load_scenarios(paths: Sequence[Path | str]) -> dict[str, Scenario]:
    """The scenarios in files and below folders, by name, sorted.

    Hidden files and folders, and requirement files, are passed over.

    Raises:
        ConfigurationError: One for all that is wrong in any file, two scenarios of one name, a
            path that does not exist, and a folder without YAML files.
    """
    return _scenarios(_documents([Path(path) for path in paths]))


def load_requirements(paths: Sequence[Path | str]) -> dict[str, Requirement]:
    """The requirements in files and below folders, by id, sorted; scenario files are passed over.

    Raises:
        ConfigurationError: One for all that is wrong in any requirement file, and two
            requirements of one id.
    """
    found = _requirements(_documents([Path(path) for path in paths]))
    return {name: one.requirement for name, one in found.items()}


def select(names: Iterable[str], globs: Sequence[str]) -> list[str]:
    """The names that match any of the globs, sorted; all of them without a glob.

    Raises:
        ConfigurationError: For a glob that matches nothing.
    """
    known = sorted(names)
    if not globs:
        return known
    for glob in globs:
        if not any(fnmatchcase(name, glob) for name in known):
            raise no_match(glob, known, "scenario")
    return [name for name in known if any(fnmatchcase(name, glob) for glob in globs)]


def _documents(paths: Sequence[Path]) -> list[Document]:
    """Each YAML file once, sorted by path below each given path."""
    files: dict[Path, Path] = {}
    for path in paths:
        found = _files(path)
        for file in found:
            files.setdefault(file.resolve(), file)
    return _all(read_yaml, files.values())


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]  # reading it tells what is wrong with it
    found = []
    for folder, inner, names in os.walk(path):
        inner[:] = sorted(name for name in inner if not name.startswith("."))
        found += [
            Path(folder, name)
            for name in sorted(names)
            if name.endswith(SUFFIXES) and not name.startswith(".")
        ]
    if not found:
        raise ConfigurationError(
            "there is no scenario file in this folder",
            file=str(path),
            expected="files that end in .yaml or .yml",
            remedy="check the path, or remove it from the options",
        )
    return found


def _scenarios(documents: Sequence[Document]) -> dict[str, Scenario]:
    files = [document for document in documents if not is_requirement_file(document)]
    scenarios: dict[str, Scenario] = {}

    def add(document: Document) -> None:
        scenario = Scenario.from_document(document)
        before = scenarios.setdefault(scenario.name, scenario)
        if before is not scenario:
            raise _twice("scenario", scenario.name, (before.source, "name"), (document, "name"))
        problems = problems_of(scenario)
        if problems:
            raise combine(problems)

    _all(add, files)
    return dict(sorted(scenarios.items()))


def _requirements(documents: Sequence[Document]) -> dict[str, Located]:
    found: dict[str, Located] = {}

    def add(document: Document) -> None:
        for one in read_requirements(document):
            name = one.requirement.id
            before = found.setdefault(name, one)
            if before is not one:
                raise _twice(
                    "requirement", name, (before.document, before.key), (document, one.key)
                )

    _all(add, [document for document in documents if is_requirement_file(document)])
    return dict(sorted(found.items()))


def _twice(
    what: str, name: str, first: tuple[Document, str], second: tuple[Document, str]
) -> ConfigurationError:
    places = [f"{document.file}:{document.line_of(key)}" for document, key in (first, second)]
    document, key = second
    return ConfigurationError(
        f"the {what} {name!r} is defined twice",
        file=document.file,
        line=document.line_of(key),
        key=key,
        found=" and ".join(places),
        expected=f"one {what} of this name",
        remedy="rename one of them, or leave one file out",
    )


def _check_references(
    scenarios: Mapping[str, Scenario], requirements: Mapping[str, Located]
) -> None:
    """Every requirement that a scenario names exists and can be judged on its signals."""

    def check(reference: tuple[Scenario, int, str]) -> None:
        scenario, index, name = reference
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
        if not located.requirement.check:
            raise ConfigurationError(
                f"requirement {name!r} has no check, so no scenario can be judged by it",
                file=file,
                line=line,
                key=key,
                found=name,
                expected="a requirement with a `check`",
                remedy=f"add a `check` in {located.document.file}:{located.line}",
            )
        domain = domain_of(scenario.simulator.path)
        known = signal_names(domain) if domain is not None else None
        try:
            formula = parse(located.requirement.check)
            if known is not None:
                parse(located.requirement.check, (*known, *formula.percept_signals))
            check_time_step(formula, scenario.time_step)
        except ConfigurationError as error:
            raise located.error(error) from None

    _all(
        check,
        [
            (scenario, index, name)
            for scenario in scenarios.values()
            for index, name in enumerate(scenario.requirements)
        ],
    )


def _unused(
    scenarios: Mapping[str, Scenario], requirements: Mapping[str, Located], theirs: set[str]
) -> list[str]:
    used = {name for scenario in scenarios.values() for name in scenario.requirements}
    return [
        f"{one.document.file}:{one.line}: no scenario uses the requirement {name!r}"
        for name, one in requirements.items()
        if name not in used and one.document.file in theirs
    ]


def _too_long(scenarios: Mapping[str, Scenario], requirements: Mapping[str, Located]) -> list[str]:
    """Formulas that look further ahead than the longest episode: undecided unless violated."""
    found = []
    for scenario in scenarios.values():
        for name in scenario.requirements:
            horizon = parse(requirements[name].requirement.check).horizon
            if horizon is not None and horizon > scenario.duration:
                found.append(
                    f"{scenario.file}:{scenario.line_of('duration')}: the requirement {name!r} "
                    f"looks {horizon:g} s ahead, but {scenario.name!r} ends after "
                    f"{scenario.duration:g} s"
                )
    return found


def _all(action: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """The action's result for every item; all errors are collected into one."""
    results, errors = [], []
    for item in items:
        try:
            results.append(action(item))
        except ConfigurationError as error:  # noqa: PERF203 - all errors are told at once
            errors.append(error)
    if errors:
        raise combine(errors)
    return results
