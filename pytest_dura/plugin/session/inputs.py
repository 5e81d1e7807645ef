"""SessionInputs: the files that a session is run from, as they become known."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.trust import source_of
from pytest_dura.evidence.files import InputFiles
from pytest_dura.plugin.options import Options
from pytest_dura.plugin.session.roles import conftest_files
from pytest_dura.provenance import MAX_LISTED_FILES, imported_files, is_installed

if TYPE_CHECKING:
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.evidence.baseline import Baseline
    from pytest_dura.evidence.lines import Line
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.requirements.model import Requirement


Data = Mapping[str, Any]
BUILTIN = "pytest_dura/scenarios"
"""Folder of the built-in scenarios in an installed package, and their recorded name elsewhere."""


class SessionInputs:
    """Input files of one session; used by the controller.

    Args:
        context: The session's context.
        baseline: What the session is compared with, if it is.
    """

    def __init__(self, context: SessionContext, baseline: Baseline | None) -> None:
        from pytest_dura.library.loading import builtin_paths

        self.context = context
        self.inputs = InputFiles(context.config.rootpath, dict.fromkeys(builtin_paths(), BUILTIN))
        self._baseline = baseline
        self._seen: set[tuple[str, str]] = set()

    def begin(self) -> None:
        """Add what options and settings name, and what the planned scenarios rest on."""
        config = self.context.config
        here = config.invocation_params.dir
        if config.inipath is not None:
            self.inputs.add("configuration", config.inipath)
        for text in Options.faults.given(config) or ():
            if text.endswith((".yaml", ".yml")):
                self.inputs.add("faults", here / text)
        self.context.guests.add_inputs(self.inputs)
        if self._baseline is not None:
            from pytest_dura.evidence.bundle import RECORD_FILE

            file = here / self._baseline.session.path
            file = file / RECORD_FILE if file.is_dir() else file
            self.inputs.add("baseline", file, self._baseline.session.sha256)
        for planned in self.context.plan:
            self._add_scenario(planned.case.scenario.name)
            for requirement in planned.requirements:
                self._add_requirement(requirement)

    def add_item(self, node_id: str) -> None:
        """Add the test module of a node id, with the ``conftest.py`` files that it sees."""
        path = node_id.partition("::")[0]
        if not path.endswith(".py") or not self._is_new("item", path):
            # A scenario item sees the root's alone.
            self._add_conftests(self.context.config.rootpath)
            return
        file = self.context.config.rootpath / path
        self.inputs.add("test", file)
        self._add_conftests(file.parent)

    def add_line(self, line: Line) -> None:
        """Add what a line of an item names."""
        from pytest_dura.evidence.case_model import CasePlan
        from pytest_dura.evidence.lines import EpisodeLine, UsedComponent
        from pytest_dura.evidence.searches import RecordedSearch
        from pytest_dura.requirements.model import Requirement

        if isinstance(line, UsedComponent):
            self.inputs.add_reported("component", line.description["files"])
            self._add_imports("component", line.description["path"])
        elif isinstance(line, CasePlan):
            self._add_scenario(line.scenario)
        elif isinstance(line, Requirement):
            self._add_requirement(line.id, line)
        elif isinstance(line, EpisodeLine):
            spec = line.entry["spec"]
            roles = {name: role["path"] for name, role in spec["roles"].items()}
            self._add_roles(spec["simulator"]["path"], roles)
        elif isinstance(line, RecordedSearch):
            self._add_scenario(line.scenario)
            self._add_roles(line.simulator, line.roles)

    def _add_roles(self, simulator: str, roles: Mapping[str, str]) -> None:
        """Add simulator and roles by their import paths, without the component under test."""
        self._add_module("role", simulator)
        self._add_imports("role", simulator)
        for name, path in roles.items():
            if name != "generator":
                self._add_module("role", path)
                self._add_imports("role", path)

    def to_json(self) -> list[dict[str, Any]]:
        """The record's key ``inputs``, with the files as they are at the end."""
        return self.inputs.to_json()

    def _add_scenario(self, name: str) -> None:
        if self._is_new("scenario", name):
            scenario = self.context.library().scenarios.get(name)
            if scenario is not None and scenario.file:
                self.inputs.add("scenario", Path(scenario.file))
                for requirement in scenario.requirements:
                    self._add_requirement(requirement)

    def _add_requirement(self, name: str, definition: Requirement | None = None) -> None:
        if not self._is_new("requirement", name):
            return
        library = self.context.library()
        file = library.defined_in.get(name)
        if file is not None:
            self.inputs.add("requirements", Path(file))
            definition = library.requirements[name]
        for hazard in library.hazards_of(() if definition is None else definition.mitigates):
            if self._is_new("hazard", hazard.id):
                self.inputs.add("hazards", Path(library.hazards_in[hazard.id]))
        if definition is not None:
            self._add_module("check", definition.check)
            if definition.paired is not None:
                self._add_module("check", definition.paired.measure)

    def _add_module(self, kind: str, path: str) -> None:
        """Add the user's own file behind ``package.module:name`` or ``tests/conftest.py:name``."""
        from pytest_dura.requirements.checks import is_function_path

        module, _, _ = path.strip().rpartition(":")
        if module.startswith("pytest_dura.") or not module or not self._is_new(kind, module):
            return
        if module.endswith(".py"):
            self.inputs.add(kind, self.context.config.rootpath / module)
        elif is_function_path(path):
            file = source_of(module)
            if file is not None and not is_installed(file):
                self.inputs.add(kind, file)

    def _add_imports(self, kind: str, path: str) -> None:
        """Add the user's own files beside the one behind a path: package and imports."""
        module = path.strip().rpartition(":")[0]
        if not self._is_new(f"{kind} imports", module) or module.startswith("pytest_dura."):
            return
        if module.endswith(".py"):
            file: Path | None = self.context.config.rootpath / module
            module = Path(module).stem
        else:
            file = source_of(module)
        if file is None or is_installed(file):
            return
        files = imported_files(file, module, self.context.config.rootpath)
        for source in files if len(files) <= MAX_LISTED_FILES else ():
            self.inputs.add(kind, source)

    def _add_conftests(self, folder: Path) -> None:
        if not self._is_new("folder", str(folder)):
            return
        root = self.context.config.rootpath
        for parent in (folder, *folder.parents):
            if not parent.is_relative_to(root):
                break
            if self._is_new("conftest", str(parent)) and (parent / "conftest.py").is_file():
                self.inputs.add("conftest", parent / "conftest.py")

    def _is_new(self, kind: str, name: str) -> bool:
        if (kind, name) in self._seen:
            return False
        self._seen.add((kind, name))
        return True


def files_of_roles(context: SessionContext, simulator: RoleSpec | None) -> dict[str, Path]:
    """Find the modules of simulators and roles that the session may use, with their files.

    They are those of all scenarios, so that each shard of a session has the same, and what the
    ``conftest.py`` files define; nothing is imported for it.

    Args:
        context: The session's context.
        simulator: What takes the place of the scenarios' own simulators.
    """
    paths = [] if simulator is None else [simulator.path]
    try:
        scenarios = context.library().scenarios
    except ConfigurationError:  # it is raised where they are used, if they are
        scenarios = {}
    for scenario in scenarios.values():
        paths.append(scenario.simulator_spec().path)  # known: the library has checked it
        paths += [role.path for role in scenario.roles.values() if role is not None]
    modules = dict.fromkeys(path.partition(":")[0] for path in paths if ":" in path)
    files = {module: file for module in modules if (file := source_of(module)) is not None}
    return files | {f"conftest of {file.parent}": file for file in conftest_files(context.config)}
