"""Library: find and read scenario and requirement files; the library in use."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import TypeVar

from pytest_dura.core.error_messages import combine_errors
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.library.cases import no_match_error
from pytest_dura.library.checks import check_scenario
from pytest_dura.library.documents import Document, read_yaml
from pytest_dura.library.fault_campaigns import ScenarioFaults
from pytest_dura.library.requirements import (
    LocatedRequirement,
    apply_requirements,
    check_reference,
    is_requirement_file,
    read_requirements,
    unmatched_globs,
    unused_requirements,
)
from pytest_dura.library.scenario import SCHEMA_FILE, Scenario
from pytest_dura.requirements.model import Requirement

_SUFFIXES = (".yaml", ".yml")

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class Library:
    """All scenarios and requirements of a session, checked against each other.

    Args:
        scenarios: By name, each with the requirements that apply to it.
        requirements: By id.
        warnings: Messages on what is allowed but probably not meant.
        unused: Ids of the user's requirements that no scenario uses, and where each is defined.
        defined_in: The file of each requirement, by id.
        faults: Of the scenarios, by their names, as they were read to be checked.
    """

    scenarios: dict[str, Scenario]
    requirements: dict[str, Requirement]
    warnings: tuple[str, ...] = ()
    unused: Mapping[str, str] = field(default_factory=dict)
    defined_in: Mapping[str, str] = field(default_factory=dict)
    faults: Mapping[str, ScenarioFaults] = field(default_factory=dict, repr=False)


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
    scenarios, faults = _scenarios(documents)
    requirements = _requirements(documents)
    scenarios = apply_requirements(scenarios, requirements)
    _map_collecting_errors(
        lambda reference: check_reference(*reference, requirements),
        [
            (scenario, index)
            for scenario in scenarios.values()
            for index in range(len(scenario.requirements))
        ],
    )
    theirs = {str(file) for path in own for file in _files(path)}
    plain = {name: requirement.requirement for name, requirement in requirements.items()}
    unused = unused_requirements(scenarios, requirements, theirs)
    warnings = [
        *unmatched_globs(scenarios, requirements, theirs),
    ]
    defined_in = {name: requirement.document.file for name, requirement in requirements.items()}
    return Library(scenarios, plain, tuple(warnings), unused, defined_in, faults)


def load_scenarios(paths: Sequence[Path | str]) -> dict[str, Scenario]:
    """The scenarios in files and below folders, by name, sorted.

    Hidden files and folders, and requirement files, are passed over.

    Raises:
        ConfigurationError: One for all that is wrong in any file, two scenarios of one name, a
            path that does not exist, and a folder without YAML files.
    """
    return _scenarios(_documents([Path(path) for path in paths]))[0]


def load_requirements(paths: Sequence[Path | str]) -> dict[str, Requirement]:
    """The requirements in files and below folders, by id, sorted; scenario files are passed over.

    Raises:
        ConfigurationError: One for all that is wrong in any requirement file, and two
            requirements of one id.
    """
    requirements = _requirements(_documents([Path(path) for path in paths]))
    return {name: verdict.requirement for name, verdict in requirements.items()}


def select_names(names: Iterable[str], globs: Sequence[str]) -> list[str]:
    """The names that match any of the globs, sorted; all of them without a glob.

    Raises:
        ConfigurationError: For a glob that matches nothing.
    """
    known = sorted(names)
    if not globs:
        return known
    for glob in globs:
        if not any(fnmatchcase(name, glob) for name in known):
            raise no_match_error(glob, known, "scenario")
    return [name for name in known if any(fnmatchcase(name, glob) for glob in globs)]


def _documents(paths: Sequence[Path]) -> list[Document]:
    """Each YAML file once, sorted by path below each given path."""
    files: dict[Path, Path] = {}
    for path in paths:
        found = _files(path)
        for file in found:
            files.setdefault(file.resolve(), file)
    return _map_collecting_errors(read_yaml, files.values())


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]  # reading it tells what is wrong with it
    found = []
    for folder, inner, names in os.walk(path):
        inner[:] = sorted(name for name in inner if not name.startswith("."))
        found += [
            Path(folder, name)
            for name in sorted(names)
            if name.endswith(_SUFFIXES) and not name.startswith(".")
        ]
    if not found:
        raise ConfigurationError(
            "there is no scenario file in this folder",
            file=str(path),
            expected="files that end in .yaml or .yml",
            remedy="check the path, or remove it from the options",
        )
    return found


def _scenarios(
    documents: Sequence[Document],
) -> tuple[dict[str, Scenario], dict[str, ScenarioFaults]]:
    files = [document for document in documents if not is_requirement_file(document)]
    scenarios: dict[str, Scenario] = {}
    read: dict[str, ScenarioFaults] = {}

    def add(document: Document) -> None:
        scenario = Scenario.from_document(document)
        before = scenarios.setdefault(scenario.name, scenario)
        if before is not scenario:
            raise _duplicate_error(
                "scenario", scenario.name, (before.source, "name"), (document, "name")
            )
        problems, faults = check_scenario(scenario)
        if problems:
            raise combine_errors(problems)
        if faults is not None:
            read[scenario.name] = faults

    _map_collecting_errors(add, files)
    return dict(sorted(scenarios.items())), read


def _requirements(documents: Sequence[Document]) -> dict[str, LocatedRequirement]:
    found: dict[str, LocatedRequirement] = {}

    def add(document: Document) -> None:
        for requirement in read_requirements(document):
            name = requirement.requirement.id
            before = found.setdefault(name, requirement)
            if before is not requirement:
                raise _duplicate_error(
                    "requirement", name, (before.document, before.key), (document, requirement.key)
                )

    _map_collecting_errors(
        add, [document for document in documents if is_requirement_file(document)]
    )
    return dict(sorted(found.items()))


def _duplicate_error(
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


def _map_collecting_errors(action: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """The action's result for every item; all errors are collected into one."""
    results, errors = [], []
    for item in items:
        try:
            results.append(action(item))
        except ConfigurationError as error:  # noqa: PERF203 - all errors are told at once
            errors.append(error)
    if errors:
        raise combine_errors(errors)
    return results


_sources: list[Callable[[], Library]] = []
"""Where it comes from, the innermost session last."""


@contextmanager
def use_library(source: Callable[[], Library]) -> Iterator[None]:
    """Within it, :func:`current_library` is what the source gives."""
    _sources.append(source)
    try:
        yield
    finally:
        _sources.remove(source)


def current_library() -> Library:
    """The library of the session that runs; without one, the built-in files alone.

    Raises:
        ConfigurationError: For files that cannot be used.
    """
    return _sources[-1]() if _sources else _builtin_library()


@cache
def _builtin_library() -> Library:

    return load_library([])
