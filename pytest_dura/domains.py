"""Domains: what each kind of system declares, and the registries of domains, simulators and roles.

A scenario names a simulator, such as ``lift``; the first part of the name is its domain.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, get_args

from pytest_dura.core.display import short_repr
from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.core.loop_signals import TRUTH
from pytest_dura.core.metrics import COMMAND
from pytest_dura.core.registry import Registry
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import STANDARD_ROLES, Role
from pytest_dura.core.simulator import SIMULATORS, checked_aliases
from pytest_dura.core.trust import check_registered
from pytest_dura.faults.model import Channel

if TYPE_CHECKING:
    from pydantic import BaseModel

    from pytest_dura.core.measures import Measure


DEFAULT_INJECTOR = "campaign"
"""Short name of the fault injector of every system whose domain and scenarios name no other."""


@dataclass(frozen=True)
class _Quantity:
    """A number with a unit; what each field is says the class that is made of it."""

    name: str
    unit: str = ""
    meaning: str = ""
    least: float | None = None
    greatest: float | None = None

    __repr__ = short_repr


@dataclass(frozen=True, repr=False)
class Signal(_Quantity):
    """A signal that requirements read.

    Args:
        name: As formulas name it.
        unit: Such as ``m/s``; ``1`` for a plain number, :data:`TRUTH` for 0 or 1.
        meaning: What it says, and its sign or axis where that is not plain.
        least: Least value that it ever has, such as 0 of a distance; ``None`` for none.
        greatest: Greatest one, such as that at which it saturates.

    Raises:
        ConfigurationError: For one without a unit, for a name that no formula could read, and for a
            least value that is not below the greatest.
    """

    def __post_init__(self) -> None:
        _check_quantity("signal", self.name, self.unit)
        low, high = self.range
        if not low < high:
            raise ConfigurationError(
                f"the signal {self.name!r} has no value between its ends",
                key="least",
                found=f"{low:g} to {high:g}",
                expected="a least value below the greatest",
                remedy="correct one of them, or leave it out",
            )

    @property
    def range(self) -> tuple[float, float]:
        """Least and greatest value, infinite where none is declared."""
        ends = (0.0, 1.0) if self.unit == TRUTH else (-math.inf, math.inf)
        return (
            ends[0] if self.least is None else self.least,
            ends[1] if self.greatest is None else self.greatest,
        )


@dataclass(frozen=True, repr=False)
class Action(_Quantity):
    """A number of the command, which the component proposes at each tick.

    Args:
        name: As faults and conditions name it, after ``command.``.
        unit: Such as ``m/s2``; ``1`` for a plain number.
        meaning: What it does, and its sign.
        least: Least value that the plant carries out; ``None`` for none.
        greatest: Greatest one.

    Raises:
        ConfigurationError: For one without a unit.
    """

    def __post_init__(self) -> None:
        _check_quantity("action", self.name, self.unit)

    @property
    def range(self) -> tuple[float, float] | None:
        """Least and greatest value, if both are declared."""
        if self.least is None or self.greatest is None or self.least >= self.greatest:
            return None
        return self.least, self.greatest


@dataclass(frozen=True)
class Unit:
    """Unit of a number of a world; it stands in the ``Annotated`` of the model's field."""

    text: str


def unit_in(model: Any, path: str) -> str:
    """Find the unit that a model declares for a value at a dotted path; empty without one.

    Args:
        model: A pydantic model; ``None`` declares nothing.
        path: Of fields, and of places or ids in lists, such as ``vehicles.0.speed``.
    """
    models, unit = [model], ""
    for key in path.split("."):
        fields = [each.model_fields[key] for each in models if key in _fields_of(each)]
        if fields:  # else it is an entry of a list
            marks = [mark for each in fields for mark in each.metadata if isinstance(mark, Unit)]
            unit = marks[0].text if marks else ""
            models = [part for each in fields for part in _parts_of(each.annotation)]
    return unit


def _fields_of(model: Any) -> Mapping[str, Any]:
    fields: Mapping[str, Any] = getattr(model, "model_fields", {})
    return fields


def _parts_of(annotation: Any) -> list[Any]:
    """A type, or those that it is made of: the alternatives of a union, the entries of a list."""
    inner = get_args(annotation)
    return [part for each in inner for part in _parts_of(each)] if inner else [annotation]


def _check_quantity(kind: str, name: object, unit: object) -> None:
    if not isinstance(name, str) or not name.isidentifier():
        raise ConfigurationError(
            f"a {kind} has a name that nothing can read",
            found=name,
            expected="letters, digits and underscores",
            remedy="give it another name",
        )
    if not isinstance(unit, str) or not unit.strip():
        raise ConfigurationError(
            f"the {kind} {name!r} has no unit",
            key="unit",
            found=unit,
            expected=f"a unit such as m/s, 1 for a plain number, or {TRUTH!r}",
            remedy=f"declare {kind.capitalize()}({name!r}, unit=..., meaning=...)",
        )


def _check_declared(domain: str, key: str, kind: type[Any], declared: object) -> None:
    """Refuse what is not a sequence of a kind, each with a name of its own.

    Raises:
        ConfigurationError: With the domain and the key.
    """
    if declared is None:
        return
    entries: list[Any] = list(declared) if isinstance(declared, Sequence) else [declared]
    for entry in entries:
        if not isinstance(entry, kind):
            unit = f"the {kind.__name__.lower()} {entry!r} of the domain {domain!r} has no unit"
            raise ConfigurationError(
                unit if isinstance(entry, str) else f"{domain!r} declares no {kind.__name__}",
                key=key,
                found=entry,
                expected=f"a sequence of pytest_dura.{kind.__name__}",
                remedy=f"declare {kind.__name__}(name, unit, meaning) for each",
            )
    names = [entry.name for entry in entries]
    for name in names:
        if names.count(name) > 1:
            raise ConfigurationError(
                f"the domain {domain!r} declares {name!r} twice",
                key=key,
                found=name,
                expected=f"a name of its own for each {kind.__name__.lower()}",
                remedy="rename one of them, or leave it out",
            )


@dataclass(frozen=True)
class Domain:
    """A kind of system.

    Args:
        name: Its name, with which those of its roles and simulators begin.
        roles: Short names of the default roles, by role name.
        parameters: Parameters that a class with a short name needs to know of the domain, by that
            name. A scenario's own parameters come before them.
        world: The pydantic model of ``world``, for editors and for messages.
        signals: The ground-truth signals; ``None`` if only the simulator knows them.
        percept_signals: The percept signals, without the prefix ``percept.``.
        proposal_signals: The signals that proposals and their explanations give, without the
            prefix ``proposal.``.
        actions: The numbers of the command. Those of a domain that declares no channel ``command``
            are its fields.
        channels: What each sensor channel holds, by name; ``None`` if only a running episode shows
            that.
        fault_targets: Default target of faults, by what their type acts on.
        provokers: Short names of its components that need their monitor and their recovery, with
            which these are put to the test.
        concrete: Function of world, duration in seconds and seed that returns an equal world in
            which nothing is left to the seed, and returns such a world as it is.

    Raises:
        ConfigurationError: For a signal or an action without a unit, and for two of one name.
    """

    name: str
    roles: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    world: type[BaseModel] | None = None
    signals: Sequence[Signal] | None = None
    percept_signals: Sequence[Signal] | None = None
    proposal_signals: Sequence[Signal] | None = None
    actions: Sequence[Action] = ()
    channels: Mapping[str, Channel] | None = None
    fault_targets: Mapping[str, str] = field(default_factory=dict)
    provokers: Sequence[str] = ()
    concrete: Callable[[Mapping[str, Any], float, int], dict[str, Any]] | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for key in ("signals", "percept_signals", "proposal_signals"):
            _check_declared(self.name, key, Signal, getattr(self, key))
        _check_declared(self.name, "actions", Action, self.actions)
        if self.actions and self.channels is not None and COMMAND not in self.channels:
            command = Channel(
                "numbers",
                tuple(action.name for action in self.actions),
                units=tuple(action.unit for action in self.actions),
                meaning="the command, as the actuators get it",
                ranges=tuple(action.range for action in self.actions),
            )
            object.__setattr__(self, "channels", {**self.channels, COMMAND: command})

    @property
    def simulator(self) -> str:
        """Import path of the simulator of the domain's own name."""
        return SIMULATORS.path(self.name)

    @property
    def units(self) -> dict[str, str]:
        """Units of all signals that it declares, by their names in formulas."""
        return {name: signal.unit for name, signal in self.declared_signals.items()}

    @property
    def declared_signals(self) -> dict[str, Signal]:
        """All signals that it declares, by their names in formulas."""
        declared = {"": self.signals, "percept.": self.percept_signals,
                    "proposal.": self.proposal_signals}  # fmt: skip
        return {
            prefix + signal.name: signal
            for prefix, signals in declared.items()
            for signal in signals or ()
        }

    @property
    def measures(self) -> Sequence[Measure]:
        """Figures of its episodes, which the simulator of its name declares; empty without one."""
        return SIMULATORS[self.name].measures if self.name in SIMULATORS else ()

    @property
    def channel_aliases(self) -> Mapping[str, str]:
        """Second names of channels, which the simulator of its name declares; empty without one.

        Raises:
            ConfigurationError: For one that is a channel itself, and for one of no channel.
        """
        return self.aliases_of(SIMULATORS[self.name]) if self.name in SIMULATORS else {}

    def aliases_of(self, simulator: Any) -> Mapping[str, str]:
        """Return the second names of channels that a simulator's class declares, checked.

        Raises:
            ConfigurationError: As for :attr:`channel_aliases`.
        """
        if self.channels is None:
            return getattr(simulator, "channel_aliases", {})
        return checked_aliases(simulator, self.channels.keys() - {COMMAND})

    @property
    def short_names(self) -> Mapping[str, Mapping[str, str]]:
        """Import paths of the roles that the domain knows: role name to short name to path."""
        return {
            role: {short: ROLES.path(name) for short, name in names.items()}
            for role, names in _names_of_roles(self.name).items()
        }

    @property
    def default_roles(self) -> Mapping[str, str]:
        """Import paths of the default roles, by role name."""
        return {
            role: role_spec(role, RoleSpec(name), self).path
            for role, name in (
                {**self.roles}
                if "fault_injector" in self.roles
                else {**self.roles, "fault_injector": DEFAULT_INJECTOR}
            ).items()
        }

    def concrete_world(
        self, world: Mapping[str, Any], duration: float, seed: int
    ) -> dict[str, Any]:
        """Write out what the seed draws in a world, where the domain can; else copy the world."""
        return dict(world if self.concrete is None else self.concrete(world, duration, seed))


DOMAINS: Registry[Domain] = Registry(
    "pytest_dura.domains",
    "domain",
    lambda value: isinstance(value, Domain),
    "a pytest_dura.Domain",
)
ROLES: Registry[type[Role]] = Registry(
    "pytest_dura.roles",
    "role",
    callable,  # whether it may be built is checked where it is: see `core.trust`
    "a subclass of pytest_dura.Role",
    names=r"([A-Za-z][\w-]*\.)?[A-Za-z]\w*\.[A-Za-z][\w-]*",
)
"""Roles by domain, role and short name, such as ``lift.generator.patient``; those of any domain
have no first part."""


def _names_of_roles(domain: str) -> Mapping[str, Mapping[str, str]]:
    """Map roles to short names to registered names; of equal ones the domain's own counts."""
    return _sorted_by_role(domain, ROLES.known())


@lru_cache(maxsize=32)
def _sorted_by_role(domain: str, registered: tuple[str, ...]) -> dict[str, dict[str, str]]:
    names: dict[str, dict[str, str]] = {}
    for name in sorted(registered, key=lambda name: name.count(".")):
        *owner, role, short = name.split(".")
        if owner in ([], [domain]):
            names.setdefault(role, {})[short] = name
    return {role: dict(sorted(names[role].items())) for role in sorted(names)}


def names_of_role(role: str) -> dict[str, str]:
    """Map short names of a role in any domain to registered names.

    A short name of two domains is there as it is registered, such as ``lift.generator.random``.
    """
    names: dict[str, list[str]] = {}
    for name in ROLES:
        *_, known, short = name.split(".")
        if known == role:
            names.setdefault(short, []).append(name)
    return {
        short if len(registered) == 1 else name: name
        for short, registered in names.items()
        for name in registered
    }


def domain_of(simulator: str, named: str | None = None) -> Domain | None:
    """Find the domain of a scenario.

    Args:
        simulator: Name or path of its simulator, which gives the domain where none is named.
        named: The domain that the scenario names: a registered name, or ``package.module:NAME``.

    Returns:
        The domain; ``None`` for a simulator that is in no domain.

    Raises:
        ConfigurationError: For a name that is neither registered nor the path of a domain.
    """
    if named is not None:
        return _named_domain(named)
    name = SIMULATORS.name_of(simulator) if ":" in simulator else simulator
    domain = str(name).partition(".")[0]
    return DOMAINS[domain] if name in SIMULATORS and domain in DOMAINS else None


def _named_domain(named: str) -> Domain:
    if ":" not in named:
        if named not in DOMAINS:
            raise DOMAINS.unknown(named, key="domain", also="an import path package.module:NAME")
        return DOMAINS[named]
    check_registered(named)
    domain = RoleSpec(named).resolve()
    if not isinstance(domain, Domain):
        raise ConfigurationError(
            f"{named!r} is no domain",
            key="domain",
            found=f"a {type(domain).__name__}",
            expected="a pytest_dura.Domain",
            remedy="name a domain, or leave the key out",
        )
    return domain


def simulator_spec(path: str, params: Mapping[str, object]) -> RoleSpec:
    """Make the RoleSpec of the simulator that a scenario names.

    Raises:
        ConfigurationError: For a name that is neither registered nor an import path.
    """
    if path in SIMULATORS:
        return RoleSpec(SIMULATORS.path(path), dict(params))
    if ":" in path:
        return RoleSpec(path, dict(params))
    raise SIMULATORS.unknown(path, key="simulator", also="an import path package.module:Class")


def role_spec(role: str, spec: RoleSpec, domain: Domain | None) -> RoleSpec:
    """Replace a short name, such as ``rule_based``, by its import path and parameters.

    Raises:
        ConfigurationError: For a name that is neither known nor an import path.
    """
    if ":" in spec.path:
        return spec
    known = _names_of_roles("" if domain is None else domain.name).get(role, {})
    if spec.path in known:
        given = {} if domain is None else domain.parameters.get(spec.path, {})
        return RoleSpec(ROLES.path(known[spec.path]), {**given, **spec.params})
    names = ", ".join(sorted(known))
    raise ConfigurationError(
        f"unknown {role} {spec.path!r}",
        key=f"roles.{role}",
        found=spec.path,
        expected=f"{names}, or an import path package.module:Name"
        if names
        else "an import path package.module:Name",
        remedy=did_you_mean(spec.path, known) if known else "write package.module:Name",
    )


def check_role_name(role: str, *, switched_off: bool) -> None:
    """Refuse a role name that is a misspelt standard name.

    Any other name is the user's own role. Only standard roles can be switched off.

    Raises:
        ConfigurationError: With the name that was probably meant.
    """
    if role in STANDARD_ROLES or (not switched_off and not _misspelt(role)):
        return
    raise ConfigurationError(
        f"there is no role {role!r}" + (" to switch off" if switched_off else ""),
        key=f"roles.{role}",
        found=role,
        expected="one of " + ", ".join(STANDARD_ROLES) + ", or a name of your own",
        remedy=did_you_mean(role, STANDARD_ROLES),
    )


def _misspelt(role: str) -> bool:
    # `safety_monitor_2` is a second monitor; `safty_monitor` is a slip.
    if any(role.startswith(name) for name in STANDARD_ROLES):
        return False
    return bool(difflib.get_close_matches(role, STANDARD_ROLES, n=1, cutoff=0.85))
