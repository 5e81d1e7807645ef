"""Which roles the episodes of a session run with.

Options and role fixtures choose them; which conftest files override a fixture is known before
any fixture is set up.
"""

from __future__ import annotations

import ast
import inspect
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.guests import default_domain
from pytest_dura.plugin.options import LONG_NAMES, short_names

if TYPE_CHECKING:
    from pytest_dura.campaign.runner import Runner
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.plugin.context import Planned, SessionContext


_OVERRIDABLE = (
    "simulator",
    "generator",
    "safety_monitor",
    "security_assessor",
    "performance_oracle",
    "fault_injector",
    "recovery_planner",
)


_PLAIN = (
    ast.Name, ast.Attribute, ast.Constant, ast.Call, ast.keyword, ast.Dict, ast.List, ast.Tuple,
    ast.expr_context,
)  # fmt: skip
"""Parts of an expression that does nothing but name things."""
_MAKES_A_SPEC = ("RoleSpec", "pytest_dura.RoleSpec")


def root_conftest_with(config: pytest.Config, role: str) -> str | None:
    """Return the root conftest's file name, if it defines the fixture of this role."""
    root = config.rootpath / "conftest.py"
    return root.name if (root, role) in _overrides(config) else None


def overrides_deeper_down(config: pytest.Config) -> list[tuple[str, str]]:
    """List ``(file, role)`` of overrides that scenario items do not see."""
    root = config.rootpath
    return [
        (os.path.relpath(file, root), role)
        for file, role in _overrides(config)
        if file.parent != root and root in file.parents
    ]


def none_in_root_conftest(config: pytest.Config) -> list[tuple[str, str]]:
    """List ``(file, role)`` of fixtures of the root conftest that plainly return ``None``."""
    root = config.rootpath / "conftest.py"
    roles = [role for file, role in _overrides(config) if file == root]
    if not roles:
        return []
    tree = ast.parse(root.read_bytes())
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    return [
        (root.name, role)
        for role in roles
        if any(_returns_none(functions.get(name)) for name in _names(config, role))
    ]


def _returns_none(function: ast.FunctionDef | None) -> bool:
    if function is None:
        return False
    nodes = list(ast.walk(function))
    values = [
        node.value for node in nodes if isinstance(node, ast.Return) and node.value is not None
    ]
    generates = any(isinstance(node, (ast.Yield, ast.YieldFrom)) for node in nodes)
    return not generates and all(isinstance(v, ast.Constant) and v.value is None for v in values)


def _plain_value(config: pytest.Config, role: str) -> object | None:
    """Return what the fixture of a role in the root conftest plainly returns; else ``None``.

    Plain is what can be looked up before any fixture is set up without doing anything: after
    imports, a name, or a RoleSpec whose parameters are written down. A fixture that every item
    uses, such as one that starts a server, may be what makes it work.
    """
    root = config.rootpath / "conftest.py"
    tree = ast.parse(root.read_bytes())
    if config.getini("usefixtures") or any(map(_is_of_every_item, ast.walk(tree))):
        return None
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    for name in _names(config, role):
        fixture = defined_in_conftest(config, root.name, name)
        if fixture is not None and name in functions and _is_plain(functions[name]):
            with suppress(Exception):  # of its imports: items set it up themselves, and report it
                value: object = inspect.unwrap(fixture)()
                return value
    return None


def _is_of_every_item(node: ast.AST) -> bool:
    """Whether a node may make a fixture one that every item uses."""
    if not isinstance(node, ast.keyword) or node.arg != "autouse":
        return False
    return not (isinstance(node.value, ast.Constant) and node.value.value is False)


def _is_plain(function: ast.FunctionDef) -> bool:
    """Whether a function takes nothing, imports, and returns a name or a RoleSpec."""
    *before, last = function.body
    if before and isinstance(before[0], ast.Expr) and isinstance(before[0].value, ast.Constant):
        before = before[1:]
    imports = all(isinstance(node, (ast.Import, ast.ImportFrom)) for node in before)
    is_decorated = len(function.decorator_list) != 1  # by more than `pytest.fixture`
    takes = ast.unparse(function.args)
    if not imports or is_decorated or takes or not isinstance(last, ast.Return):
        return False
    nodes = [] if last.value is None else list(ast.walk(last.value))
    return bool(nodes) and all(
        isinstance(node, _PLAIN)
        and (not isinstance(node, ast.Call) or ast.unparse(node.func) in _MAKES_A_SPEC)
        for node in nodes
    )


def _conftest_defining(config: pytest.Config, value: object) -> str | None:
    """Return the ``conftest.py`` at whose top level a class or function is defined, if any.

    pytest may have loaded several modules of the name ``conftest``, of which ``sys.modules`` holds
    one, so the class itself does not identify its file.
    """
    name = getattr(value, "__qualname__", None)
    for file, module in _conftests(config):
        is_own = getattr(value, "__module__", None) == module.__name__
        if name is not None and is_own and vars(module).get(name) is value:
            return Path(os.path.relpath(file, config.rootpath)).as_posix()
    return None


def defined_in_conftest(config: pytest.Config, file: str, name: str) -> Any:
    """Return what a ``conftest.py`` defines under a name; ``None`` if it is not loaded."""
    conftest = config.rootpath / file
    return next(
        (vars(module).get(name) for path, module in _conftests(config) if path == conftest), None
    )


def conftest_files(config: pytest.Config) -> list[Path]:
    """List the ``conftest.py`` files that pytest has loaded."""
    return [file for file, _ in _conftests(config)]


def _overrides(config: pytest.Config) -> list[tuple[Path, str]]:
    return [
        (file, role)
        for file, module in _conftests(config)
        for role in _OVERRIDABLE
        if any(_is_fixture(module, name) for name in _names(config, role))
    ]


def _names(config: pytest.Config, role: str) -> tuple[str, ...]:
    """Names of the fixture of a role."""
    return (role, LONG_NAMES + role) if short_names(config) else (LONG_NAMES + role,)


def _conftests(config: pytest.Config) -> list[tuple[Path, ModuleType]]:
    modules = []
    for plugin in config.pluginmanager.get_plugins():
        file = getattr(plugin, "__file__", None)
        if isinstance(plugin, ModuleType) and file and Path(file).name == "conftest.py":
            modules.append((Path(file), plugin))
    return sorted(modules, key=lambda entry: entry[0])


def _is_fixture(module: ModuleType, name: str) -> bool:
    """Whether the module defines a fixture of this name, by what pytest 8 and 9 make of one."""
    value = vars(module).get(name)
    made_of = type(value).__name__
    return made_of == "FixtureFunctionDefinition" or hasattr(value, "_pytestfixturefunction")


OF_THE_SCENARIO = "of the scenario"
"""In place of the path of a role that the project's domain has no default for."""


class SessionRoles:
    """Roles of a session: from options, role fixtures and the domain's defaults.

    Args:
        config: The session's configuration.
        generator: ``--dura-generator``, if it is given.
        domain: Name of the project's domain.
        simulator: ``--dura-simulator``, if it is given.
    """

    def __init__(
        self, config: pytest.Config, generator: str | None, domain: str, simulator: str | None
    ) -> None:
        self._config, self._generator, self._domain = config, generator, domain
        self._simulator = simulator
        self._defaults: dict[str, RoleSpec] = {}
        self._checked: set[pytest.Item | pytest.Collector | None] = set()
        """Modules, classes and others whose items see each role under one name alone."""

    def default(self, role: str) -> RoleSpec:
        """Return what a role's fixture returns unless overridden: the same object at every call.

        A role that the project's domain has no default for stands for that of each scenario, as
        all do in a project without a domain.
        """
        if role not in self._defaults:
            from pytest_dura.core.role_spec import RoleSpec
            from pytest_dura.domains import DOMAINS
            from pytest_dura.library.roles import generator_of_option, simulator_of_option

            option = self._generator
            if role == "simulator" and self._simulator is not None:
                spec = simulator_of_option(self._simulator)
            elif role == "generator" and option is not None:
                spec = generator_of_option(option)
            elif not self._domain:
                spec = RoleSpec(OF_THE_SCENARIO)
            elif role == "simulator":
                spec = RoleSpec(DOMAINS[self._domain].simulator)
            else:
                roles = DOMAINS[self._domain].default_roles
                spec = RoleSpec(roles.get(role, OF_THE_SCENARIO))
            self._defaults[role] = spec
        return self._defaults[role]

    def chosen(self) -> dict[str, RoleSpec | None]:
        """Return the roles that options put in place of the scenarios' and domains' own."""
        if self._generator is None:
            return {}
        return {"generator": self.default("generator")}

    def chosen_simulator(self) -> RoleSpec | None:
        """Return the simulator of the option, which takes the place of the scenarios' own."""
        return None if self._simulator is None else self.default("simulator")

    def use(self, given: dict[str, Any], runner: Runner) -> None:
        """Let the runner use what the role fixtures of an item returned.

        Args:
            given: What they returned, by role.
            runner: The runner of episodes.

        Raises:
            ConfigurationError: For something that is no such role, and for a generator that is
                given twice.
        """
        from pytest_dura.library.roles import role_of_fixture

        overridden = {
            role: role_of_fixture(role, value, _conftest_defining(self._config, value))
            for role, value in given.items()
            if value is not self.default(role)
        }
        if "generator" in overridden and self._generator is not None:
            raise _given_twice("a fixture")
        if "simulator" in overridden and self._simulator is not None:
            raise _given_twice("a fixture", "simulator")
        runner.simulator = overridden.pop("simulator", self.chosen_simulator())
        runner.roles = self.chosen() | overridden

    def check(self) -> None:
        """Check generator and simulator, as far as options give them.

        Raises:
            ConfigurationError: For one that cannot be used, for one that is given twice, and for an
                unknown domain of the project.
        """
        self._check_domain()
        for role, given in (("generator", self._generator), ("simulator", self._simulator)):
            if given is None:
                continue
            self.default(role)
            conftest = root_conftest_with(self._config, role)
            if conftest is not None:
                raise _given_twice(f"the fixture `{role}` in {conftest}", role)

    def resolve(self, context: SessionContext) -> None:
        """Resolve the components that are known before anything runs, to fail early.

        Raises:
            ConfigurationError: If one cannot be settled, such as for a server that does not answer.
        """
        if context.is_worker or self._config.option.collectonly:
            return
        for spec in self._components(context):
            context.resolver.resolve(spec)

    def _components(self, context: SessionContext) -> list[RoleSpec]:
        if self._generator is not None:
            return [self.default("generator")]
        if not context.plan:
            return []
        if root_conftest_with(self._config, "generator") is not None:
            return self._of_conftest()
        role_specs: list[RoleSpec] = []
        for planned in context.plan:
            spec = planned.case.roles({})["generator"]
            if spec not in role_specs:
                role_specs.append(spec)
        return role_specs

    def _of_conftest(self) -> list[RoleSpec]:
        """Return the component of the root conftest, if it is plain to see."""
        from pytest_dura.library.roles import role_of_fixture

        value = _plain_value(self._config, "generator")
        if value is not None:
            with suppress(ConfigurationError):  # of what is no component: its items report it
                file = _conftest_defining(self._config, value)
                spec = role_of_fixture("generator", value, file)
                return [] if spec is None else [spec]
        return []

    def check_names(self, request: pytest.FixtureRequest) -> None:
        """Check that no role is overridden under both of its names.

        Args:
            request: Of a fixture of the item that uses the roles.

        Raises:
            ConfigurationError: For a role whose fixture cannot be determined.
        """
        known = request.session._fixturemanager  # noqa: SLF001 - pytest asks it in no public way
        if request.node.parent in self._checked:
            return
        for role in _OVERRIDABLE:
            names = _names(self._config, role)
            given = [known.getfixturedefs(name, request.node) for name in names]
            if len(names) > 1 and all(
                definitions and len(definitions) > 1 for definitions in given
            ):
                where = " and ".join(f"the fixture `{name}`" for name in names)
                raise _given_twice(where, role, option=False)
        self._checked.add(request.node.parent)

    def check_plan(self, plan: Iterable[Planned]) -> None:
        """Check that the simulator of the option can simulate what is planned.

        Raises:
            ConfigurationError: For each scenario that it cannot, all as one.
        """
        simulator = self.chosen_simulator()
        if simulator is None:
            return
        from pytest_dura.core.errors import combine_errors
        from pytest_dura.library.checks import check_simulator_fits

        problems: dict[str, ConfigurationError] = {}
        for planned in plan:
            try:
                check_simulator_fits(planned.case, simulator)
            except ConfigurationError as error:  # noqa: PERF203 - all errors are raised as one
                problems.setdefault(str(error), error)
        if problems:
            raise combine_errors(list(problems.values()))

    def _check_domain(self) -> None:
        if self._domain == default_domain():
            return  # a guest's, and nothing of it need be imported
        from pytest_dura.domains import DOMAINS

        if self._domain not in DOMAINS:
            raise DOMAINS.unknown(self._domain, key="ini dura_domain")


def _given_twice(where: str, role: str = "generator", *, option: bool = True) -> ConfigurationError:
    names = {"generator": "the component under test", "simulator": "the simulator"}
    return ConfigurationError(
        f"{names.get(role, f'the role {role}')} is given twice",
        key=f"--dura-{role}" if option else role,
        found=f"--dura-{role} and {where}" if option else where,
        expected="one of them",
        remedy="drop the option, or the fixture" if option else "override one of the two names",
    )
