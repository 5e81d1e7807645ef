"""Domains: what each kind of system declares, and the registries of domains, simulators and roles.

A scenario names a simulator, such as ``driving``; the first part of the name is its domain.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.core.registry import Registry
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import STANDARD_ROLES, Role
from pytest_dura.core.simulator import SIMULATORS

if TYPE_CHECKING:
    from pydantic import BaseModel

    from pytest_dura.core.measures import Measure
    from pytest_dura.faults.model import Channel


@dataclass(frozen=True)
class Domain:
    """A kind of system.

    Args:
        name: Its name, with which those of its roles and simulators begin.
        roles: Short names of the default roles, by role name.
        parameters: Parameters that a class with a short name needs to know of the domain, by that
            name. A scenario's own parameters come before them.
        world: The pydantic model of ``world``, for editors and for messages.
        signals: Names of the ground-truth signals; ``None`` if only the simulator has them.
        percept_signals: Names of the percept signals, without the prefix ``percept.``.
        proposal_signals: Names of the signals that proposals and their explanations give, without
            the prefix ``proposal.``.
        channels: What each sensor channel holds, by name; ``None`` if only a running episode shows
            that.
        fault_targets: Default target of faults, by what their type acts on.
        concrete: Function of world, duration in seconds and seed that returns an equal world in
            which nothing is left to the seed, and returns such a world as it is.
    """

    name: str
    roles: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    world: type[BaseModel] | None = None
    signals: Sequence[str] | None = None
    percept_signals: Sequence[str] | None = None
    proposal_signals: Sequence[str] | None = None
    channels: Mapping[str, Channel] | None = None
    fault_targets: Mapping[str, str] = field(default_factory=dict)
    concrete: Callable[[Mapping[str, Any], float, int], dict[str, Any]] | None = None

    @property
    def simulator(self) -> str:
        """Import path of the simulator of the domain's own name."""
        return SIMULATORS.path(self.name)

    @property
    def measures(self) -> Sequence[Measure]:
        """Figures of its episodes, which the simulator of its name declares."""
        return SIMULATORS[self.name].measures

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
            role: role_spec(role, RoleSpec(name), self).path for role, name in self.roles.items()
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
"""Roles by domain, role and short name, such as ``driving.generator.reactive``; those of any domain
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

    A short name of two domains is there as it is registered, such as ``driving.generator.random``.
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


def domain_of(simulator: str) -> Domain | None:
    """Find the domain of a simulator by its name or path; ``None`` for one that is in no domain."""
    name = SIMULATORS.name_of(simulator) if ":" in simulator else simulator
    domain = str(name).partition(".")[0]
    return DOMAINS[domain] if name in SIMULATORS and domain in DOMAINS else None


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
