"""RoleSpec: how to build a role or a simulator, as plain data."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeGuard

from pytest_dura.core.boundary import CallEnded, let_pass
from pytest_dura.core.codec import LEFT_OUT, NOT_DATA
from pytest_dura.core.display import short_repr
from pytest_dura.core.errors import ConfigurationError, describe_error, import_error
from pytest_dura.core.roles import Role
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.trust import (
    check_buildable,
    check_function,
    check_import,
    check_own,
    import_checked,
)


def is_routine(value: object) -> TypeGuard[Callable[..., Any]]:
    """Whether it is a function or method; ``inspect`` counts partials, too, from Python 3.14 on."""
    return inspect.isroutine(value) and hasattr(value, "__qualname__")


@dataclass(frozen=True)
class RoleSpec:
    """How a role or a simulator is built: by an import path and parameters.

    ``instance`` holds a bare instance instead: it works in this process only, and is reset before
    each episode.
    """

    path: str
    """Import path `package.module:Name`, or `file.py:Name` for what a conftest.py defines."""
    params: Mapping[str, Any] = field(default_factory=dict)
    """Its keyword parameters, the user's own."""
    opaque: bool = field(default=False, metadata=LEFT_OUT)
    """Whether it was a bare instance, which no other process can build again; absent if not."""
    instance: Any = field(default=None, compare=False, repr=False, metadata=NOT_DATA)

    __repr__ = short_repr

    @classmethod
    def of(cls, value: object, params: Mapping[str, Any] | None = None) -> RoleSpec:
        """Make a spec of an import path, a class, an importable factory or an instance.

        Raises:
            ConfigurationError: If a fresh instance could not be built from it elsewhere.
        """
        if isinstance(value, RoleSpec):
            return value
        if isinstance(value, str):
            return cls(value, dict(params or {}))
        if inspect.isclass(value) or is_routine(value):
            path = f"{value.__module__}:{value.__qualname__}"
            home = sys.modules.get(value.__module__)
            if "<" in path or getattr(home, value.__qualname__, value) is not value:
                raise ConfigurationError(
                    "a role factory must be importable by name",
                    found=path,
                    expected="a class or function that this path leads to",
                    remedy="move it to a module of its own, at the top level there",
                )
            return cls(path, dict(params or {}))
        path = f"{type(value).__module__}:{type(value).__qualname__}"
        return cls(path, dict(params or {}), opaque=True, instance=value)

    @property
    def label(self) -> str:
        """Name of the component in cases, verdicts and reports."""
        return self.path.rsplit(":", 1)[-1]

    def with_params(self, params: Mapping[str, Any]) -> RoleSpec:
        """Copy with other parameters."""
        return RoleSpec(self.path, dict(params), self.opaque, self.instance)

    def resolve(self) -> Any:
        """Import the object at the path, without a call of it.

        Raises:
            ConfigurationError: If the path cannot be imported, or must not be: see
                :func:`pytest_dura.core.trust.check_import`.
        """
        module_name, _, qualname = self.path.partition(":")
        if not module_name or not qualname:
            raise ConfigurationError(
                "an import path has the form package.module:Name",
                found=self.path,
                expected="package.module:Name",
                remedy="put a colon between the module and the class or function",
            )
        check_import(self.path)
        try:
            target: Any = import_checked(self.path)
            for part in qualname.split("."):
                target = getattr(target, part)
        except BaseException as error:  # a module runs the user's code when it is imported
            let_pass(error)
            raise import_error(
                error,
                f"cannot import {self.path!r}",
                module=module_name,
                found=self.path,
                expected="an importable package.module:Name",
                remedy="check the spelling, and that the module is installed, or lies where pytest "
                "was started or in the project's root",
            ) from error
        return target

    def factory(self, *kinds: type) -> Callable[..., Any]:
        """Import the class or factory.

        Args:
            kinds: Base classes of what it may build; default: a role or a simulator.

        Raises:
            ConfigurationError: If the path cannot be imported, or leads to something else.
        """
        target: Callable[..., Any] = self.resolve()
        check_buildable(self.path, target, kinds or (Role, Simulator))
        return target

    def function(self) -> Callable[..., Any]:
        """Import a function, such as a check or a measure.

        Raises:
            ConfigurationError: If the path cannot be imported, or leads to something that is not
                the project's own: see :func:`pytest_dura.core.trust.check_function`.
        """
        check_own(self.path)
        target: Callable[..., Any] = self.resolve()
        check_function(self.path, target)
        return target

    def create(self, *kinds: type) -> Any:
        """Build a fresh object, or return the opaque instance.

        Args:
            kinds: See :meth:`factory`.

        Raises:
            ConfigurationError: If the path leads to nothing that may be built, or the parameters
                are refused.
        """
        if self.instance is not None:
            return self.instance
        self.check_rebuildable()
        factory = self.factory(*kinds)
        try:
            inspect.signature(factory).bind(**self.params)
        except TypeError as error:
            raise ConfigurationError(
                f"{self.path} does not take these parameters: {error}",
                found=dict(self.params),
                expected=f"{self.label}{inspect.signature(factory)}",
                remedy="correct the parameters",
            ) from None
        except ValueError:  # a builtin without a signature, which checks when it is called
            pass
        try:
            return factory(**self.params)
        except (ConfigurationError, CallEnded):
            raise
        except BaseException as error:
            let_pass(error)
            raise ConfigurationError(
                f"{self.path} cannot be built: {describe_error(error)}",
                found=dict(self.params),
                remedy="correct its parameters or its constructor",
            ) from error

    def check_rebuildable(self) -> None:
        """Refuse a bare instance of a process that is gone.

        Raises:
            ConfigurationError: For one.
        """
        if self.opaque and self.instance is None:
            raise ConfigurationError(
                f"{self.path} was given as a bare instance and cannot be built again",
                remedy="let the role fixture return the class or a RoleSpec",
            )
