"""Settling: role specs that state what determines the role and is found elsewhere."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from pytest_dura.core.boundary import let_pass
from pytest_dura.core.episode import canonical
from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import Role

_PLAIN: set[str] = set()
"""Paths whose classes settle nothing: most of them."""
_SETTLED: dict[tuple[Callable[..., Any], bytes], RoleSpec | ConfigurationError] = {}


def settled(spec: RoleSpec) -> RoleSpec:
    """The spec with the parameters that :meth:`pytest_dura.core.roles.Role.settled` returns.

    A class is asked once per process for the same parameters, also where that fails. Bare instances
    and factories stay as they are, and so does a path that leads nowhere: who builds the role tells
    that. What is settled settles to itself.

    Args:
        spec: Of any role.

    Raises:
        ConfigurationError: If the class cannot settle them, or not into plain data.
    """
    # A path of a conftest.py may lead to another class in the next session of this process.
    if spec.opaque or (type(spec) is RoleSpec and spec.path in _PLAIN):
        return spec
    try:
        factory = spec.factory()
    except ConfigurationError:
        return spec
    if not _settles(factory):
        if type(spec) is RoleSpec:
            _PLAIN.add(spec.path)
        return spec
    key = factory, canonical([spec.path, dict(spec.params)])
    if key not in _SETTLED:
        try:
            _SETTLED[key] = _asked(spec, factory)
        except ConfigurationError as error:
            _SETTLED[key] = error
    found = _SETTLED[key]
    if isinstance(found, ConfigurationError):
        raise found.with_traceback(None)
    return found


def forget() -> None:
    """Ask every class again, in a session that begins in a process that has had one before."""
    _PLAIN.clear()
    _SETTLED.clear()


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
            f"{spec.path} cannot settle its parameters: {describe_error(error)}",
            found=dict(spec.params),
            expected="plain data",
            remedy="correct its method `settled`",
        ) from error
    if not isinstance(params, Mapping):
        raise ConfigurationError(
            f"{spec.path} settles its parameters to something else",
            found=params,
            expected="a mapping of the parameters",
            remedy="correct its method `settled`",
        )
    found = spec.with_params(params)
    _SETTLED[factory, canonical([spec.path, dict(params)])] = found
    return found
