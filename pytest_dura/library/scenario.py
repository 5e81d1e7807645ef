"""Scenario: the model of a scenario file, and its world as the simulator checks it.

The descriptions of the fields are what editors show.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    JsonValue,
    PrivateAttr,
    Tag,
    ValidationError,
    model_validator,
)

from pytest_dura.core.episode import Policy
from pytest_dura.core.errors import ConfigurationError, error_at
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.domains import Domain, domain_of
from pytest_dura.faults.model import Channel
from pytest_dura.library.documents import Document, translate, validate

NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]*(/[A-Za-z0-9][A-Za-z0-9_.-]*)*$"
_IDENTIFIER = r"^[A-Za-z0-9][A-Za-z0-9_-]*$"


def not_empty(values: tuple[Any, ...]) -> tuple[Any, ...]:
    """Refuse an empty list. Pydantic's own check would also tell of entries that are in error."""
    if not values:
        raise ValueError("the list is empty; it must have at least one entry")
    return values


class Entry(BaseModel):
    """Base of everything in a scenario file: no unknown keys, no silent conversion, read-only."""

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


class RoleEntry(Entry):
    """How to build a role or a simulator."""

    path: str = Field(min_length=1)
    """Import path `package.module:Name`, or a short name of the domain."""
    params: dict[str, JsonValue] = Field(default_factory=dict)
    """Keyword parameters of the class or factory."""


def _path_alone(value: object) -> object:
    return {"path": value} if isinstance(value, str) else value


RoleField = Annotated[
    RoleEntry, BeforeValidator(_path_alone, json_schema_input_type=str | RoleEntry)
]
OptionalRoleField = Annotated[
    RoleEntry | None,
    BeforeValidator(_path_alone, json_schema_input_type=str | RoleEntry | None),
]


class Range(Entry):
    """A number drawn uniformly from an interval, anew for each run; or a list of such numbers."""

    min: float
    """Least value, in the unit of the key that is varied."""
    max: float
    """Greatest value, in the unit of the key that is varied."""
    pieces: int | None = Field(default=None, ge=1, le=1000)
    """The value is a list of so many numbers: an input that is constant in pieces of time."""

    @model_validator(mode="after")
    def _ordered(self) -> Range:
        if self.min > self.max:
            raise ValueError(f"min is above max ({self.min:g} > {self.max:g})")
        return self


class Choice(Entry):
    """One of several values, each as likely as the others, drawn anew for each run."""

    choice: Annotated[tuple[JsonValue, ...], Field(strict=False), AfterValidator(not_empty)]
    """The values."""


class Budget(Entry):
    """Runs that end once the requirement at hand is decided."""

    until: Literal["decided"]
    """The only condition there is."""
    at_most: int = Field(ge=1, le=1_000_000)
    """Greatest number of runs; what is open then is undecided."""


def _kind_of_runs(value: object) -> str:
    return "<budget>" if isinstance(value, (Mapping, Budget)) else "<number>"


Runs = Annotated[
    Annotated[Annotated[int, Field(ge=1, le=1_000_000)], Tag("<number>")]
    | Annotated[Budget, Tag("<budget>")],
    Discriminator(_kind_of_runs),
]


def _kind_of_variation(value: object) -> str:
    if isinstance(value, Choice) or (isinstance(value, Mapping) and "choice" in value):
        return "<choice>"
    return "<range>"


Variation = Annotated[
    Annotated[Range, Tag("<range>")] | Annotated[Choice, Tag("<choice>")],
    Discriminator(_kind_of_variation),
]


class FaultEntry(Entry):
    """One planned fault. The catalogue checks activation and parameters, which differ by type."""

    type: str = Field(min_length=1)
    """A type of the fault catalogue."""
    id: str | None = Field(default=None, pattern=_IDENTIFIER)
    """Name within the scenario, unique; default: the type."""
    target: str | None = None
    """Sensor channel, field of a channel, or `command`. Default: per fault type."""
    activation: dict[str, JsonValue] = Field(default_factory=dict)
    """When it begins, in simulated seconds, and which role begins it."""
    duration: JsonValue = None
    """Simulated seconds that it stays active; `once`, `{min, max}`, `{until, at_most}`,
    `{on, off, lasting}`; null for the rest of the episode."""
    parameters: dict[str, JsonValue] = Field(default_factory=dict)
    """Parameters of the fault type, in the units that the catalogue states."""

    @property
    def name(self) -> str:
        """The id, given or by default."""
        return self.id or self.type


def _known_policy(text: str) -> str:
    try:
        Policy.parse(text)
    except ConfigurationError as error:
        raise ValueError(f"{error.problem}; expected {error.expected}") from None
    return text


def _unique(values: tuple[str, ...]) -> tuple[str, ...]:
    twice = sorted({value for value in values if values.count(value) > 1})
    if twice:
        raise ValueError(f"listed twice: {', '.join(twice)}")
    return values


class Scenario(Entry):
    """A situation to test in: world, duration, variation, faults, requirements that apply."""

    name: str = Field(pattern=NAME)
    """Unique name, such as `intersection/nominal`; cases and episodes are named after it."""
    description: str = ""
    """What happens here, in one sentence."""
    order: int | None = Field(default=None, ge=1)
    """Place in tables, from 1; scenarios without one come last, by name."""
    simulator: RoleField
    """The alias `driving`, an import path `package.module:Class`, or path and params."""
    seed: int | None = Field(default=None, ge=0, lt=2**53)
    """Seed of the first run, from which those of further runs follow; by default all follow from
    the session's seed. A counterexample that was found keeps its seed here."""
    duration: float = Field(gt=0, le=86400)
    """Simulated seconds after which an episode ends."""
    time_step: float = Field(default=0.1, gt=0, le=60)
    """Simulated seconds per tick."""
    iterations: int | None = Field(default=None, ge=1, le=1_000_000)
    """Decisions after which an episode ends, if it has not before; null for the duration alone."""
    runs: Runs = 1
    """Planned episodes per case, each with a seed of its own; or `{until: decided, at_most: N}`."""
    policy: Annotated[str, AfterValidator(_known_policy)] = "recover"
    """What follows a refused proposal: recover, halt, log_only, or refine(k), k at least 1."""
    time_budget: float | None = Field(default=5.0, gt=0)
    """Seconds that the component has for one proposal; null waits for ever."""
    end_at_violation: bool = False
    """Whether an episode ends at a violation, once every requirement is decided."""
    end_when_decided: bool = False
    """Whether an episode ends once every requirement is decided, violated or not."""
    world: dict[str, JsonValue] = Field(default_factory=dict)
    """The world, as the simulator reads it."""
    variation: dict[str, Variation] = Field(default_factory=dict)
    """What differs between runs: `world.x` or `faults.id.x` to a range or a choice."""
    roles: dict[str, OptionalRoleField] = Field(default_factory=dict)
    """Roles that differ from the domain's defaults; null switches a role off."""
    faults: Annotated[tuple[FaultEntry, ...], Field(strict=False)] = ()
    """The planned faults, all together; with `campaigns`, what those may name."""
    campaigns: Annotated[tuple[JsonValue, ...], Field(strict=False)] = ()
    """Fault campaigns, each with cases of its own: `none`, a fault's name or data, `a+b`, a list,
    `catalogue`, a glob of types, `{fault, grid}`, or `{fault, sample, count, seed}`."""
    requirements: Annotated[
        tuple[Annotated[str, Field(min_length=1)], ...],
        Field(strict=False),
        AfterValidator(_unique),
    ] = ()
    """Ids of the requirements that apply, defined in requirement files."""

    _source: Document = PrivateAttr(default_factory=Document)

    @model_validator(mode="after")
    def _consistent(self) -> Scenario:
        if self.time_step > self.duration:
            raise ValueError(
                f"the time step is longer than the duration: {self.time_step:g} > {self.duration:g}"
            )
        _unique(tuple(fault.name for fault in self.faults))
        return self

    @classmethod
    def from_document(cls, document: Document) -> Scenario:
        """The scenario that a YAML file holds.

        Raises:
            ConfigurationError: One for all that is wrong with the file's keys and values.
        """
        scenario = validate(cls, document)
        scenario._source = document  # noqa: SLF001 - our own
        return scenario

    @property
    def lasts(self) -> float:
        """Simulated seconds that an episode lasts at most: the duration, or fewer `iterations`."""
        if self.iterations is None:
            return self.duration
        return min(self.duration, self.iterations * self.time_step)

    @property
    def planned(self) -> int:
        """Episodes that are planned per case, or may be run at most."""
        return self.runs.at_most if isinstance(self.runs, Budget) else self.runs

    @property
    def until_decided(self) -> bool:
        """Whether runs end once the requirement at hand is decided."""
        return isinstance(self.runs, Budget)

    @property
    def source(self) -> Document:
        """Where it was read from; an empty document if it was made otherwise."""
        return self._source

    @property
    def file(self) -> str:
        """The file it was read from; empty if it was made otherwise."""
        return self._source.file

    def line_of(self, key: str) -> int | None:
        """The line of a dotted key in that file."""
        return self._source.line_of(key)

    def plain(self) -> dict[str, Any]:
        """Plain data, from which an equal scenario can be read again."""
        return self.model_dump(mode="json", exclude_unset=True)


def check_world(
    scenario: Scenario, simulator: RoleSpec, world: Mapping[str, Any]
) -> dict[str, Any]:
    """The world with defaults filled in, where the simulator's class has a ``check_scenario``.

    Raises:
        ConfigurationError: If the simulator cannot be imported or refuses the world.
    """
    check = world_checker(simulator)
    if check is None:
        return dict(world)
    try:
        return dict(check(world))
    except ValidationError as error:
        domain = domain_of(simulator.path)
        model = world_model(domain) if domain is not None else None
        raise translate(error, model or BaseModel, scenario.source, "world") from None
    except ConfigurationError as error:
        key = error.key or "world"
        key = key if key.startswith("world") else f"world.{key}"
        raise error_at(error, file=scenario.file, line=scenario.line_of(key), key=key) from None


def world_checker(simulator: RoleSpec) -> Any:
    """``check_scenario`` of the simulator's class, if it has one.

    Raises:
        ConfigurationError: If the class cannot be imported.
    """
    factory = type(simulator.instance) if simulator.opaque else simulator.factory()
    return getattr(factory, "check_scenario", None)


def world_model(domain: Domain) -> type[BaseModel] | None:
    """The pydantic model of a domain's world, imported now."""
    return None if domain.world is None else _import_attribute(domain.world)


def signal_names(domain: Domain) -> tuple[str, ...] | None:
    """The names of a domain's ground-truth signals, imported now."""
    return None if domain.signals is None else tuple(_import_attribute(domain.signals))


def percept_signal_names(domain: Domain) -> tuple[str, ...] | None:
    """The names of a domain's percept signals, without their prefix, imported now."""
    path = domain.percept_signals
    return None if path is None else tuple(_import_attribute(path))


def proposal_signal_names(domain: Domain) -> tuple[str, ...] | None:
    """The names of what accounts come to in a domain, without their prefix, imported now."""
    path = domain.proposal_signals
    return None if path is None else tuple(_import_attribute(path))


def channel_kinds(domain: Domain | None) -> Mapping[str, Channel] | None:
    """What a domain's channels hold; ``None`` where that is not known before an episode runs."""
    return _import_attribute(domain.channels) if domain is not None and domain.channels else None


def fault_targets(domain: Domain | None) -> Mapping[str, str]:
    """Where a domain's faults act that name no target, by what their type can act on."""
    return (
        _import_attribute(domain.fault_targets)
        if domain is not None and domain.fault_targets
        else {}
    )


def concrete_world(
    domain: Domain, world: Mapping[str, Any], duration: float, seed: int
) -> dict[str, Any]:
    """An equal world in which nothing is left to the seed, where the domain can tell one."""
    if domain.concrete is None:
        return dict(world)
    return dict(_import_attribute(domain.concrete)(world, duration, seed))


def _import_attribute(path: str) -> Any:
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)
