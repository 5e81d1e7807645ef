"""Mutants: named defects with parameters, each a wrapper around one part of a suite.

A mutation is a class that is registered in the group ``pytest_dura.mutants``; each choice of its
parameters is a mutant. It wraps whatever part a case has, so that it fits anybody's.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any, ClassVar, Generic, TypeVar

from pytest_dura.core.classes import is_subclass
from pytest_dura.core.display import short_repr
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.registry import Registry
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import STANDARD_ROLES, RoleContext
from pytest_dura.core.simulator import Simulator
from pytest_dura.domains import Domain
from pytest_dura.library.roles import LocalRole, local_role

Part = TypeVar("Part")


@dataclass(frozen=True)
class Parameter:
    """A parameter of a mutation.

    Args:
        name: Its name, an attribute of the mutation.
        values: Each of them makes a mutant.
        unit: Of its numbers; empty for a choice.
    """

    name: str
    values: tuple[Any, ...]
    unit: str = ""


SIMULATOR = "simulator"


class Mutation(Generic[Part]):
    """A defect in one part: the part with something wrong.

    A subclass derives from the base class of the part as well, such as
    :class:`~pytest_dura.Generator`, and calls ``self.part``.

    Args:
        of: How to build the part: its import path as ``path``, its parameters as ``params``.
        parameters: Of the mutant; each becomes an attribute.
    """

    about: ClassVar[str]
    """What is wrong, in a few words that go on from the mutant's name."""
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    provokes: ClassVar[bool] = False
    """Whether a component with it needs its monitor: with the first of its parameters it is a
    provoker where the domain names none."""

    def __init__(self, of: Mapping[str, Any], **parameters: Any) -> None:
        spec = RoleSpec(of["path"], of["params"])
        local = local_role(spec, of["local"]) if "local" in of else None
        self.part: Part = (local or spec).create()
        for name in ("after", "reassess", "repeatable"):
            if hasattr(self.part, name):
                setattr(self, name, getattr(self.part, name))
        for name, value in parameters.items():
            setattr(self, name, value)

    def reset(self, context: RoleContext) -> None:
        """Begin an episode; the base resets the part."""
        self.part.reset(context)  # type: ignore[attr-defined]

    def trigger(self, view: Any) -> bool:
        """Whether it runs at this tick: as the part."""
        return bool(self.part.trigger(view))  # type: ignore[attr-defined]

    @classmethod
    def choices(cls, signals: Collection[str]) -> Iterator[Mapping[str, Any]]:  # noqa: ARG003
        """Yield the parameters of each mutant; default: all values with all.

        Args:
            signals: Those that the requirements of the suite read.
        """
        for values in product(*(parameter.values for parameter in cls.parameters)):
            yield dict(zip((each.name for each in cls.parameters), values, strict=True))


def _fits(value: Any) -> bool:
    bases: tuple[type[Any], ...] = (Simulator, *STANDARD_ROLES.values())
    return is_subclass(value, Mutation) and any(is_subclass(value, base) for base in bases)


MUTANTS: Registry[type[Mutation[Any]]] = Registry(
    "pytest_dura.mutants",
    "mutation",
    _fits,
    "a subclass of pytest_dura.qualification.Mutation and of the part's base class",
    names=r"([A-Za-z_]\w*\.)?[a-z_]+\.[A-Za-z_]\w*",
)
"""Mutations by ``role.name``, or ``domain.role.name`` where a domain brings them."""


@dataclass(frozen=True)
class Mutant:
    """A mutation with its parameters.

    Args:
        mutation: Its registered name.
        role: Name of the part that it wraps: a role, or ``simulator``.
        path: Import path of the class.
        about: What is wrong.
        params: Its parameters.
        units: Their units.
    """

    mutation: str
    role: str
    path: str
    about: str
    params: Mapping[str, Any] = field(default_factory=lambda: NOTHING)
    units: Mapping[str, str] = field(default_factory=lambda: NOTHING)

    __repr__ = short_repr

    @property
    def name(self) -> str:
        """Such as ``generator.stale[ticks=5]``."""
        given = ",".join(f"{name}={_text(value)}" for name, value in self.params.items())
        return f"{self.mutation}[{given}]" if given else self.mutation

    @property
    def described(self) -> str:
        """What is wrong, with the parameters in their units."""
        given = ", ".join(
            f"{name} {_text(value)} {self.units.get(name, '')}".rstrip()
            for name, value in self.params.items()
        )
        return f"{self.about} ({given})" if given else self.about

    def around(self, part: RoleSpec) -> RoleSpec:
        """Return the part with this defect."""
        of: dict[str, Any] = {"path": part.path, "params": dict(part.params)}
        if isinstance(part, LocalRole):  # a copy of this process knows the class, no other does
            of["local"] = id(part.target)
        return RoleSpec(self.path, {**self.params, "of": of})


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def provoking(domain: Domain | None, component: RoleSpec) -> Iterator[tuple[str, RoleSpec]]:
    """Yield the mutants of a component that need their monitor: one of each mutation that says so.

    Args:
        domain: Of the suite; ``None`` where its simulators have none.
        component: The suite's own.
    """
    known = {
        each.mutation: each for each in reversed(registered_mutants(domain))
        if MUTANTS[each.mutation].provokes
    }  # fmt: skip
    for mutant in reversed(known.values()):
        yield mutant.name, mutant.around(component)


def registered_mutants(domain: Domain | None, signals: Collection[str] = ()) -> list[Mutant]:
    """List the mutants that fit a domain, those of no domain first, by their parts and names.

    Args:
        domain: Of the suite; ``None`` where its simulators have none.
        signals: Those that its requirements read.
    """
    order = [*STANDARD_ROLES, SIMULATOR]
    known: list[tuple[bool, int, Mutant]] = []
    for name in MUTANTS:
        *domains, role, _ = name.split(".")
        if domains and (domain is None or domains != [domain.name]):
            continue
        mutation = MUTANTS[name]
        units = {each.name: each.unit for each in mutation.parameters}
        path = f"{mutation.__module__}:{mutation.__qualname__}"
        for params in mutation.choices(signals):
            mutant = Mutant(name, role, path, mutation.about, dict(params), units)
            known.append((bool(domains), order.index(role), mutant))
    return [mutant for *_, mutant in sorted(known, key=lambda each: (each[1], each[0]))]
