"""Roles: make RoleSpecs of names, classes and fixtures, and resolve their parameters."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from pytest_dura.core.boundary import let_pass
from pytest_dura.core.episode import canonical
from pytest_dura.core.errors import ConfigurationError, describe_error, did_you_mean, error_at
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.role_spec import RoleSpec, is_routine
from pytest_dura.core.roles import STANDARD_ROLES, Generator, Role
from pytest_dura.core.simulator import SIMULATORS, Simulator
from pytest_dura.domains import ROLES, names_of_role

_TARGETS: dict[int, Callable[..., Any]] = {}
"""Classes and factories that no import path leads to, by their identity, which a copy of this
process shares. They are kept, so that no other object takes it."""


class LocalRole(RoleSpec):
    """A RoleSpec that holds its class or factory, which no import path leads to.

    Several ``conftest.py`` may be loaded, all as the module ``conftest``. So the path of a class in
    such a file names the file, relative to the project's root: ``tests/conftest.py:Planner``.
    """

    target: Callable[..., Any]

    def __init__(
        self, path: str, target: Callable[..., Any], params: Mapping[str, Any] = NOTHING
    ) -> None:
        super().__init__(path, dict(params))
        object.__setattr__(self, "target", target)
        _TARGETS[id(target)] = target

    @property
    def label(self) -> str:
        """The name, and the folder unless it is the root: two files may hold the same name."""
        file, _, name = self.path.rpartition(":")
        folder = file.rpartition("/")[0]
        return f"{name} ({folder})" if folder else name

    def resolve(self) -> Callable[..., Any]:
        """Return the class or factory."""
        return self.target

    def with_params(self, params: Mapping[str, Any]) -> LocalRole:
        """Return the spec with other parameters."""
        return LocalRole(self.path, self.target, params)


def local_role(spec: RoleSpec, identity: int) -> LocalRole | None:
    """The role of a session again in a copy of its process; ``None`` for a younger class.

    Args:
        spec: Path and parameters.
        identity: Of its class or factory in the session's process.
    """
    target = _TARGETS.get(identity)
    return None if target is None else LocalRole(spec.path, target, spec.params)


def local_object(spec: RoleSpec) -> Any:
    """Return the object that binds a spec to this process; ``None`` for a portable spec."""
    return spec.target if isinstance(spec, LocalRole) else spec.instance


RoleGiven: TypeAlias = str | RoleSpec | type[Role] | type[Simulator] | Callable[..., Any] | None
"""A class, an importable factory, an import path or a RoleSpec; ``None`` where none is given."""


def role_of_fixture(role: str, value: Any, file: str | None = None) -> RoleSpec | None:
    """Make the RoleSpec of what a role's fixture returned; ``None`` switches the role off.

    Args:
        role: Name of the role, or ``simulator``.
        value: A RoleSpec, a class, an importable factory, an import path, a bare instance or None.
        file: The ``conftest.py`` that defines the class or factory, relative to the project's
            root, if no import path leads to it.

    Raises:
        ConfigurationError: If it cannot serve as this role.
    """
    base: type[Role | Simulator] = Simulator if role == "simulator" else STANDARD_ROLES[role]
    if value is None:
        if role in ("generator", "simulator"):
            raise ConfigurationError(
                f"the {role} cannot be switched off",
                key=role,
                found="None",
                expected=f"a subclass of pytest_dura.{base.__name__}, or a RoleSpec",
                remedy=f"return one from the fixture `{role}`, or remove the fixture",
            )
        return None
    if isinstance(value, (str, RoleSpec)):
        return RoleSpec.of(value)
    if inspect.isclass(value):
        fits = issubclass(value, base)
    else:
        fits = is_routine(value) or isinstance(value, base)
    if not fits:
        raise ConfigurationError(
            f"what the fixture `{role}` returned is not a {base.__name__}",
            key=role,
            found=value,
            expected=f"a subclass of pytest_dura.{base.__name__}, a factory, or a RoleSpec",
            remedy=f"derive it from pytest_dura.{base.__name__}",
        )
    if file is not None and callable(value):
        spec: RoleSpec = LocalRole(f"{file}:{value.__name__}", value)
    else:
        spec = RoleSpec.of(value)
    if is_routine(value):
        spec.factory(base)  # refused now, rather than by the first episode
    return spec


def generator_of_option(text: str) -> RoleSpec:
    """Make the RoleSpec that ``--dura-generator`` names: a short name or an import path.

    Raises:
        ConfigurationError: If there is none, or it is no Generator.
    """
    key = "--dura-generator"
    short = names_of_role("generator")
    if ":" not in text and text not in short:
        raise ConfigurationError(
            f"unknown generator {text!r}",
            key=key,
            found=text,
            expected=", ".join(sorted(short)) + ", or an import path package.module:Name",
            remedy=did_you_mean(text, short),
        )
    spec = RoleSpec(ROLES.path(short[text]) if text in short else text)
    try:
        target = spec.resolve()
        if inspect.isclass(target):
            _check_class(target, spec)
        else:
            spec.factory()
    except ConfigurationError as error:
        raise error_at(error, file="", line=None, key=key) from None
    return spec


def simulator_of_option(text: str) -> RoleSpec:
    """Make the RoleSpec that ``--dura-simulator`` names.

    It is a registered name, such as ``lift.fast``, its last part, or an import path.

    Raises:
        ConfigurationError: If there is none, or it is no Simulator.
    """
    key = "--dura-simulator"
    short: dict[str, str] = {}
    for name in SIMULATORS:
        short[name.rpartition(".")[2]] = "" if name.rpartition(".")[2] in short else name
    name = text if text in SIMULATORS else short.get(text, "")
    if ":" not in text and not name:
        raise SIMULATORS.unknown(text, key=key, also="an import path package.module:Class")
    spec = RoleSpec(SIMULATORS.path(name) if name else text)
    try:
        spec.factory(Simulator)
    except ConfigurationError as error:
        raise error_at(error, file="", line=None, key=key) from None
    return spec


def _check_class(factory: type[Any], spec: RoleSpec) -> None:
    if not issubclass(factory, Generator):
        raise ConfigurationError(
            f"{spec.path} is not a Generator",
            found=spec.path,
            expected="a subclass of pytest_dura.Generator",
            remedy="derive it from pytest_dura.Generator, or name another class",
        )
    missing = sorted(getattr(factory, "__abstractmethods__", ()))
    if missing:
        raise ConfigurationError(
            f"{spec.path} lacks {', '.join(missing)}",
            found=spec.path,
            expected="a class with `propose(self, view) -> Proposal`",
            remedy=f"define {missing[0]} in {spec.label}",
        )
    try:
        inspect.signature(factory).bind()
    except TypeError as error:
        raise ConfigurationError(
            f"{spec.path} cannot be built without parameters: {error}",
            found=f"{spec.label}{inspect.signature(factory)}",
            expected="a constructor without required parameters",
            remedy="return a RoleSpec with `params` from a fixture `generator` in your conftest.py",
        ) from None


class ParameterResolver:
    """Resolves the parameters of role specs, once for the same class and parameters.

    A session owns it: resolving may be slow, and an error that is raised again is the same error.
    """

    def __init__(self) -> None:
        self._resolved: dict[tuple[Callable[..., Any], bytes], RoleSpec | ConfigurationError] = {}

    def resolve(self, spec: RoleSpec) -> RoleSpec:
        """The spec with the parameters that the class's ``resolve_parameters`` returns.

        Bare instances and factories without such a method stay as they are, and so does a path that
        leads nowhere: building the role reports that. Resolved parameters resolve to themselves.

        Args:
            spec: Of any role.

        Raises:
            ConfigurationError: If the class cannot resolve them, or not into plain data.
        """
        if spec.opaque:
            return spec
        try:
            factory = spec.factory()
        except ConfigurationError:
            return spec
        if not _has_resolver(factory):
            return spec
        key = factory, canonical([spec.path, dict(spec.params)])
        if key not in self._resolved:
            try:
                resolved = _resolve(spec, factory)
                self._resolved[factory, canonical([spec.path, dict(resolved.params)])] = resolved
                self._resolved[key] = resolved
            except ConfigurationError as error:
                self._resolved[key] = error
        known = self._resolved[key]
        if isinstance(known, ConfigurationError):
            raise known.with_traceback(None)
        return known


def _has_resolver(factory: Callable[..., Any]) -> bool:
    if not inspect.isclass(factory):  # a factory may have one, such as a black box
        return callable(getattr(factory, "resolve_parameters", None))
    if not issubclass(factory, Role):
        return False
    return factory.resolve_parameters.__func__ is not Role.resolve_parameters.__func__  # type: ignore[attr-defined]


def _resolve(spec: RoleSpec, factory: Callable[..., Any]) -> RoleSpec:
    resolve: Callable[[Mapping[str, Any]], Any] = factory.resolve_parameters  # type: ignore[attr-defined]
    try:
        params = resolve(dict(spec.params))
        canonical(params)
    except ConfigurationError:
        raise
    except BaseException as error:  # a user's method may raise anything
        let_pass(error)
        raise ConfigurationError(
            f"{spec.path} cannot resolve its parameters: {describe_error(error)}",
            found=dict(spec.params),
            expected="plain data",
            remedy="correct its method `resolve_parameters`",
        ) from error
    if not isinstance(params, Mapping):
        raise ConfigurationError(
            f"{spec.path} resolves its parameters to something else",
            found=params,
            expected="a mapping of the parameters",
            remedy="correct its method `resolve_parameters`",
        )
    return spec.with_params(params)
