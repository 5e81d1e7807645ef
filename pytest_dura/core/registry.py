"""Registries: domains, simulators, roles, faults, executors and report formats by their names.

A package registers an object by an entry point in the group of the registry; a project, which is
not installed, by the decorator :meth:`Registry.register` in a module that pytest loads. The package
itself uses entry points, too. Entry points are read when a registry is first asked for something,
and each object is imported when it is used.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import Any, Generic, TypeVar

from pytest_dura.core.boundary import let_pass
from pytest_dura.core.errors import ConfigurationError, did_you_mean, import_error
from pytest_dura.core.trust import Offer, check_import, import_checked, offers

T = TypeVar("T")
V = TypeVar("V")
_OURS = "pytest-dura"


@dataclass(frozen=True)
class Entry:
    """A registered object.

    Args:
        name: Its name in the registry.
        path: Import path ``package.module:Name``, or ``package.module`` for a module.
        provider: The distribution with its version, or the module that registered it.
        value: The object, where a decorator registered it.
    """

    name: str
    path: str
    provider: str
    value: Any = None


@dataclass(frozen=True, eq=False)
class Registry(Generic[T]):
    """Objects of a kind by name.

    Args:
        group: Group of entry points.
        kind: What is registered, as messages call it.
        fits: Whether a loaded object is of that kind.
        expected: The kind in words, for messages.
        names: Pattern of names.
        reserved: Names of that pattern which mean something else.
    """

    group: str
    kind: str
    fits: Callable[[Any], bool]
    expected: str
    names: str = r"[A-Za-z][\w-]*"
    reserved: Collection[str] = ()
    _registered: dict[str, Entry] = field(default_factory=dict, init=False, repr=False)
    _memo: list[Any] = field(default_factory=list, init=False, repr=False)
    """What is offered and registered, and the names that follow from it."""

    def register(self, name: str) -> Callable[[V], V]:
        """Register the decorated object under a name; the same object may be registered again.

        Args:
            name: Its name.

        Raises:
            ConfigurationError: If the name is not allowed, or belongs to another object.
        """
        caller = str(sys._getframe(1).f_globals.get("__name__"))  # noqa: SLF001 - no other way

        def add(value: V) -> V:
            module = value.__module__ if hasattr(value, "__qualname__") else caller
            path = f"{module}:{getattr(value, '__qualname__', name)}"
            entry = Entry(name, path, f"the module {module}", value)
            self._check(name, [entry, *self._entries(name, registered=False)])
            former = self._registered.get(name, entry)
            if former.path != path:
                raise self._clash(name, [former, entry])
            self._registered[name] = entry
            return value

        return add

    def known(self) -> tuple[str, ...]:
        """Return the names that may be used, sorted; the same object until something changes."""
        offered = offers(self.group)
        if self._memo[:2] != [offered, [*self._registered]]:
            names = sorted({*self._registered, *offered})
            self._memo[:] = [offered, [*self._registered], tuple(filter(self._is_name, names))]
        names_known: tuple[str, ...] = self._memo[2]
        return names_known

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names that may be used, sorted."""
        return iter(self.known())

    def __len__(self) -> int:
        return len(self.known())

    def __contains__(self, name: object) -> bool:
        return name in self.known()

    def entry(self, name: str) -> Entry:
        """Return what is known of an object without importing it.

        Raises:
            ConfigurationError: For an unknown name, and one that two packages register.
        """
        entries = self._entries(name)
        if not entries:
            raise self.unknown(name)
        self._check(name, entries)
        return entries[0]

    def path(self, name: str) -> str:
        """Return the import path of an object without importing it; see :meth:`entry`."""
        return self.entry(name).path

    def name_of(self, path: str) -> str | None:
        """Return the first name of an import path; ``None`` if it is not registered."""
        return next((name for name in self if self._entries(name)[0].path == path), None)

    def is_ours(self, name: str) -> bool:
        """Whether this package itself registers a name."""
        return any(offer.distribution == _OURS for offer in self._offers(name))

    def portable(self, name: str) -> str:
        """Return a name that other processes know: the import path of what a decorator registers.

        Args:
            name: A registered name; any other text is returned as it is.
        """
        return self._registered[name].path if name in self._registered else name

    def __getitem__(self, name: str) -> T:
        """Import an object.

        Raises:
            ConfigurationError: See :meth:`entry`; also if it cannot be imported, or is of another
                kind.
        """
        entry = self.entry(name)
        value = self._load(entry) if entry.value is None else entry.value
        if not self.fits(value):
            raise ConfigurationError(
                f"the {self.kind} {name!r} of {entry.provider} is none",
                found=f"{entry.path}, a {type(value).__name__}",
                expected=self.expected,
                remedy=f"correct it, or uninstall {entry.provider}",
            )
        loaded: T = value
        return loaded

    def items(self) -> Iterator[tuple[str, T]]:
        """Import all objects, one at a time."""
        for name in self:
            yield name, self[name]

    def problems(self) -> Iterator[ConfigurationError]:
        """Yield what is wrong with names that are registered; nothing is imported."""
        for name in sorted({*self._registered, *offers(self.group)}):
            error = self._problem(name, self._entries(name))
            if error is not None:
                yield error

    def unknown(
        self, name: object, *, key: str | None = None, also: str = ""
    ) -> ConfigurationError:
        """Make the error for a name that is not registered.

        Args:
            name: The name.
            key: The key or option that gave it.
            also: What may be given in place of a name.
        """
        known = list(self)
        remedy = did_you_mean(str(name), known) if known else "install what registers it"
        if not any(map(self.is_ours, known)):
            remedy = f"install {_OURS} again: its entry points {self.group!r} are missing"
        return ConfigurationError(
            f"unknown {self.kind} {name!r}",
            key=key,
            found=name,
            expected=(f"{also}, or one of " if also else "one of ") + ", ".join(known),
            remedy=remedy,
        )

    def _offers(self, name: str) -> tuple[Offer, ...]:
        return offers(self.group).get(name, ())

    def _entries(self, name: str, *, registered: bool = True) -> list[Entry]:
        """List what is registered under a name: more than one object is an error."""
        own = [self._registered[name]] if registered and name in self._registered else []
        found = [Entry(name, offer.path, offer.provider) for offer in self._offers(name)]
        return own + [entry for entry in found if entry.path not in {known.path for known in own}]

    def _is_name(self, name: str) -> bool:
        return re.fullmatch(self.names, name) is not None and name not in self.reserved

    def _check(self, name: str, entries: list[Entry]) -> None:
        error = self._problem(name, entries)
        if error is not None:
            raise error

    def _problem(self, name: str, entries: list[Entry]) -> ConfigurationError | None:
        if not self._is_name(name):
            return ConfigurationError(
                f"{entries[0].provider} registers a {self.kind} under a name that is not allowed",
                found=name,
                expected=f"a name of the form {self.names}, and none of "
                f"{', '.join(sorted(self.reserved)) or 'ours'}",
                remedy="give it another name",
            )
        if len({entry.path for entry in entries}) > 1:
            return self._clash(name, entries)
        return None

    def _clash(self, name: str, entries: list[Entry]) -> ConfigurationError:
        places = " and ".join(f"{entry.provider} ({entry.path})" for entry in entries)
        return ConfigurationError(
            f"two packages register the {self.kind} {name!r}: {places}",
            found=name,
            expected=f"a name of its own for each {self.kind}",
            remedy="uninstall one of them, or give its object another name",
        )

    def _load(self, entry: Entry) -> Any:
        module, _, qualname = entry.path.partition(":")
        check_import(entry.path)
        try:
            target: Any = import_checked(entry.path)
            for part in filter(None, qualname.split(".")):
                target = getattr(target, part)
        except BaseException as error:  # a module runs its author's code when it is imported
            let_pass(error)
            raise import_error(
                error,
                f"the {self.kind} {entry.name!r} of {entry.provider} cannot be loaded",
                module=module,
                found=entry.path,
                expected="an entry point that can be imported",
                remedy=f"correct or uninstall {entry.provider}",
            ) from error
        return target


def objects_below(package: str, kind: type[T]) -> Iterator[T]:
    """Yield the objects of a kind that the modules of a package define, module by module.

    Args:
        package: Name of a package of this distribution.
        kind: Their class.
    """
    for module in modules_below(package):
        yield from (value for value in vars(module).values() if isinstance(value, kind))


@cache  # of our own packages, whose modules stay the same as long as this process runs
def modules_below(package: str) -> tuple[ModuleType, ...]:
    """Import the modules of a package, in the order of their names."""
    folder = import_module(package)
    found = sorted(module.name for module in iter_modules(folder.__path__))
    return tuple(import_module(f"{package}.{name}") for name in found)
