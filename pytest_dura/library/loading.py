"""Library: scenarios, requirements and hazards of files, and the library that a session uses."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Literal, TypeVar

from pytest_dura.core.display import short_repr
from pytest_dura.core.errors import ConfigurationError, combine_errors
from pytest_dura.library.cases import no_match_error
from pytest_dura.library.checks import check_scenario
from pytest_dura.library.documents import Document, read_yaml
from pytest_dura.library.fault_campaigns import ScenarioFaults
from pytest_dura.library.hazards import (
    LocatedHazard,
    is_hazard_file,
    mitigation_problems,
    read_hazards,
)
from pytest_dura.library.requirements import (
    LocatedRequirement,
    apply_of_component,
    apply_requirements,
    check_references,
    is_requirement_file,
    read_requirements,
    unmatched_globs,
    unused_requirements,
)
from pytest_dura.library.scenario import SCHEMA_FILE, Scenario
from pytest_dura.requirements.hazards import Hazard
from pytest_dura.requirements.model import Requirement

_SUFFIXES = (".yaml", ".yml")
FOUND = "found"
"""Folder below the project's folder of scenarios for counterexamples of searches, and prefix of
their names."""

T = TypeVar("T")
R = TypeVar("R")
L = TypeVar("L", LocatedRequirement, LocatedHazard)


@dataclass(frozen=True)
class Library:
    """All scenarios and requirements of a session, checked against each other.

    Args:
        scenarios: By name, each with the requirements that apply to it.
        requirements: By id.
        warnings: Messages on what is allowed but probably a slip.
        unused: Places ``file:line`` of the user's requirements that no scenario uses, by id.
        defined_in: The file of each requirement, by id.
        faults: The scenarios' faults as they were read for the checks, by the scenario's name.
        hazards: By id.
        own_hazards: Ids of those in the user's files.
        hazards_in: The file of each hazard, by id.
        builtin: Names of the built-in scenarios.
        recorded: Names of those of recorded logs.
    """

    scenarios: dict[str, Scenario]
    requirements: dict[str, Requirement]
    warnings: tuple[str, ...] = ()
    unused: Mapping[str, str] = field(default_factory=dict)
    defined_in: Mapping[str, str] = field(default_factory=dict)
    faults: Mapping[str, ScenarioFaults] = field(default_factory=dict, repr=False)
    hazards: Mapping[str, Hazard] = field(default_factory=dict)
    own_hazards: frozenset[str] = frozenset()
    hazards_in: Mapping[str, str] = field(default_factory=dict)
    builtin: frozenset[str] = frozenset()
    recorded: frozenset[str] = frozenset()

    __repr__ = short_repr

    @property
    def own(self) -> list[str]:
        """Names of the project's own scenarios, counterexamples of searches apart.

        In a checkout of this package, whose folder of scenarios is that of the built-in ones, none
        is the project's own.
        """
        others = self.scenarios.keys() - self.builtin - self.recorded
        return sorted(name for name in others if not name.startswith(f"{FOUND}/"))

    def gate(self, choice: Literal["project", "builtin"] | None) -> dict[str, Scenario]:
        """Return the scenarios of a gate, by name; those of recorded logs are always of it.

        Args:
            choice: ``builtin`` takes the built-in ones, ``project`` the project's own in place of
                them, if it has some. Counterexamples are beside either, so that the first one does
                not take the place of the built-in scenarios.
        """
        chosen = set(self.recorded)
        if choice == "builtin":
            chosen |= self.builtin
        elif choice == "project":
            chosen |= self.scenarios.keys() - (self.builtin if self.own else set())
        return {name: each for name, each in self.scenarios.items() if name in chosen}

    def hazards_of(self, named: Iterable[str]) -> list[Hazard]:
        """List the hazards that a session with requirements on the named ones has to answer for.

        These are all of the user's files, and of the built-in ones those that are named.
        """
        wanted = self.own_hazards.union(named)
        return [hazard for name, hazard in self.hazards.items() if name in wanted]


def builtin_paths() -> list[Path]:
    """Find the folder of the built-in scenarios, in a wheel and in an editable install alike.

    Raises:
        ConfigurationError: If the installation has none.
    """
    package = Path(__file__).resolve().parents[1]
    candidates = [package / "scenarios", package.parent / "scenarios"]
    folders = [folder for folder in candidates if (folder / SCHEMA_FILE).is_file()]
    if not folders:
        raise ConfigurationError(
            "the built-in scenarios are missing from this installation",
            found=", ".join(map(str, candidates)),
            expected=f"a folder with {SCHEMA_FILE}",
            remedy="install pytest-dura again",
        )
    return folders[:1]


def load_library(
    paths: Sequence[Path | str],
    *,
    builtin: bool = True,
    brought: Sequence[Path] = (),
    recorded: Sequence[Scenario] = (),
    judging: Sequence[Path] = (),
) -> Library:
    """Read everything below the given paths, and the built-in files.

    Args:
        paths: Files and folders of the user.
        builtin: Whether the built-in files are read.
        brought: Requirement files that come with the component. Each of their requirements applies
            to the scenarios of its globs whose domain has its signals; one of the same id in
            another file takes its place.
        recorded: Scenarios of recorded logs, which no file declares.
        judging: Requirement files whose requirements apply to these.

    Raises:
        ConfigurationError: One for all errors in all files.
    """
    own = [*map(Path, paths), *judging]
    # Without the guest that they are of there are none.
    ours = [folder for folder in builtin_paths() if any(folder.rglob("*.yaml"))] if builtin else []
    documents = _documents([*ours, *own], trusted=ours)
    scenarios, faults = _scenarios(documents)
    our_files = {str(file) for path in ours for file in _files(path)}
    hazards = _hazards(documents)
    own_requirements = _requirements(documents)
    of_component = _requirements(_documents(brought))
    located = dict(sorted({**of_component, **own_requirements}.items()))
    if problems := mitigation_problems(located, hazards):
        raise combine_errors(problems)
    judges = tuple(_requirements(_documents(judging)))
    for logs in recorded:
        if scenarios.setdefault(logs.name, logs) is not logs:
            raise _duplicate_error(
                "scenario", logs.name, (scenarios[logs.name].source, "name"), (logs.source, "name")
            )
        scenarios[logs.name] = logs.model_copy(update={"requirements": judges})
    scenarios = apply_requirements(scenarios, own_requirements)
    scenarios = apply_of_component(scenarios, of_component, located)
    problems = [
        each for scenario in scenarios.values() for each in check_references(scenario, located)
    ]
    if problems:
        raise combine_errors(problems)
    user_files = {str(file) for path in own for file in _files(path)}
    return Library(
        scenarios,
        requirements={name: each.requirement for name, each in located.items()},
        warnings=tuple(unmatched_globs(scenarios, located, user_files)),
        unused=unused_requirements(scenarios, located, user_files),
        defined_in={name: each.document.file for name, each in located.items()},
        faults=faults,
        hazards={name: each.hazard for name, each in hazards.items()},
        own_hazards=frozenset(
            name for name, each in hazards.items() if each.document.file in user_files
        ),
        hazards_in={name: each.document.file for name, each in hazards.items()},
        builtin=frozenset(name for name, each in scenarios.items() if each.file in our_files),
        recorded=frozenset(logs.name for logs in recorded),
    )


def load_scenarios(paths: Sequence[Path | str]) -> dict[str, Scenario]:
    """Read the scenarios in files and below folders, by name, sorted.

    Hidden files and folders, and files of requirements and hazards, are skipped.

    Raises:
        ConfigurationError: One for all errors in all files, two scenarios of the same name, a path
            that does not exist, and a folder without YAML files.
    """
    return _scenarios(_documents([Path(path) for path in paths]))[0]


def select_names(names: Iterable[str], globs: Sequence[str]) -> list[str]:
    """Select the names that match any of the globs, sorted; all of them without a glob.

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


def _documents(paths: Sequence[Path], *, trusted: Collection[Path] = ()) -> list[Document]:
    """Read each YAML file once, sorted by path below each given path.

    Args:
        paths: The files and folders.
        trusted: Those of this package.
    """
    files: dict[Path, tuple[Path, bool]] = {}
    for path in paths:
        for file in _files(path):
            files.setdefault(file.resolve(), (file, path in trusted))
    return _map_collecting_errors(
        lambda known: read_yaml(known[0], trusted=known[1]), files.values()
    )


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]  # reading it raises the error of a missing file
    files: list[Path] = []
    for folder, inner, names in os.walk(path):
        inner[:] = sorted(name for name in inner if not name.startswith("."))
        files += [
            Path(folder, name)
            for name in sorted(names)
            if name.lower().endswith(_SUFFIXES) and not name.startswith(".")
        ]
    if not files:
        raise ConfigurationError(
            "there is no scenario file in this folder",
            file=str(path),
            expected="files that end in .yaml or .yml",
            remedy="check the path, or remove it from the options",
        )
    return files


def _scenarios(
    documents: Sequence[Document],
) -> tuple[dict[str, Scenario], dict[str, ScenarioFaults]]:
    files = [
        document
        for document in documents
        if not is_requirement_file(document) and not is_hazard_file(document)
    ]
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
    files = filter(is_requirement_file, documents)
    return _located("requirement", files, read_requirements, lambda each: each.requirement.id)


def _hazards(documents: Sequence[Document]) -> dict[str, LocatedHazard]:
    files = filter(is_hazard_file, documents)
    return _located("hazard", files, read_hazards, lambda each: each.hazard.id)


def _located(
    what: str,
    documents: Iterable[Document],
    read: Callable[[Document], Iterable[L]],
    id_of: Callable[[L], str],
) -> dict[str, L]:
    """Read what files define, by id; each id once."""
    known: dict[str, L] = {}

    def add(document: Document) -> None:
        for located in read(document):
            before = known.setdefault(id_of(located), located)
            if before is not located:
                places = (before.document, before.key), (document, located.key)
                raise _duplicate_error(what, id_of(located), *places)

    _map_collecting_errors(add, documents)
    return dict(sorted(known.items()))


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


def _map_collecting_errors(action: Callable[[T], R], arguments: Iterable[T]) -> list[R]:
    """Call the action with every argument; raise all errors as one."""
    results, errors = [], []
    for argument in arguments:
        try:
            results.append(action(argument))
        except ConfigurationError as error:  # noqa: PERF203 - all errors are raised as one
            errors.append(error)
    if errors:
        raise combine_errors(errors)
    return results


_sources: list[Callable[[], Library]] = []
"""Where the library in use comes from, the innermost session last: strategies are made while
modules of tests are imported, and have no session at hand. They are of the process and not of a
``ContextVar``, since a test that another thread runs belongs to the same session."""


@contextmanager
def use_library(source: Callable[[], Library]) -> Iterator[None]:
    """Within it, :func:`current_library` returns what the source returns."""
    _sources.append(source)
    try:
        yield
    finally:
        _sources.remove(source)


def current_library() -> Library:
    """Return the library of the running session; without one, the built-in files alone.

    Raises:
        ConfigurationError: For files that cannot be used.
    """
    return _sources[-1]() if _sources else _builtin_library()


@cache
def _builtin_library() -> Library:
    return load_library([])
