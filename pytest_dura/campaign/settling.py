"""Parameters of roles that a class resolves itself, such as the model that a server serves."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from pytest_dura.core.boundary import let_pass
from pytest_dura.core.episode import canonical
from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import Role


class ParameterResolver:
    """Resolves role specs, each class once for the same parameters, also where that fails."""

    def __init__(self) -> None:
        self._resolved: dict[tuple[Callable[..., Any], bytes], RoleSpec | ConfigurationError] = {}

    def resolve(self, spec: RoleSpec) -> RoleSpec:
        """The spec with the parameters that :meth:`pytest_dura.core.roles.Role.settled` returns.

        Bare instances and factories stay as they are, and so does a path that leads nowhere:
        building the role reports that. Resolved parameters resolve to themselves.

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
        if not _settles(factory):
            return spec
        key = factory, canonical([spec.path, dict(spec.params)])
        if key not in self._resolved:
            try:
                resolved = _asked(spec, factory)
                self._resolved[factory, canonical([spec.path, dict(resolved.params)])] = resolved
                self._resolved[key] = resolved
            except ConfigurationError as error:
                self._resolved[key] = error
        known = self._resolved[key]
        if isinstance(known, ConfigurationError):
            raise known.with_traceback(None)
        return known


def _settles(factory: Callable[..., Any]) -> bool:
    if not (inspect.isclass(factory) and issubclass(factory, Role)):
        return False
    return factory.settled.__func__ is not Role.settled.__func__  # type: ignore[attr-defined]


def _asked(spec: RoleSpec, factory: Callable[..., Any]) -> RoleSpec:
    settle: Callable[[Mapping[str, Any]], Any] = factory.settled  # type: ignore[attr-defined]
    try:
        params = settle(dict(spec.params))
        canonical(params)
    except ConfigurationError:
        raise
    except BaseException as error:  # a user's method may raise anything
        let_pass(error)
        raise ConfigurationError(
            f"{spec.path} cannot resolve its parameters: {describe_error(error)}",
            found=dict(spec.params),
            expected="plain data",
            remedy="correct its method `settled`",
        ) from error
    if not isinstance(params, Mapping):
        raise ConfigurationError(
            f"{spec.path} resolves its parameters to something else",
            found=params,
            expected="a mapping of the parameters",
            remedy="correct its method `settled`",
        )
    return spec.with_params(params)
