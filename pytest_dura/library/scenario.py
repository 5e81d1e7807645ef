"""Scenario: the model of a scenario file, its world, its variation, and its JSON Schema.

The descriptions of the fields are what editors show: after a change of them, run
``python -m pytest_dura.library.scenario``, which writes the schema.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
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

from pytest_dura.core.clock import Clock
from pytest_dura.core.episode import EpisodeSpec, Policy
from pytest_dura.core.errors import ConfigurationError, did_you_mean, error_at
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.seeding import stream
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.text import one_line
from pytest_dura.core.trust import check_registered
from pytest_dura.domains import DOMAINS, Domain, domain_of, simulator_spec
from pytest_dura.faults.catalogue import FAULT_TYPES, form_of
from pytest_dura.library.documents import Document, translate, validate

SCHEMA_FILE = "scenario.schema.json"
NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]*(/[A-Za-z0-9][A-Za-z0-9_.-]*)*$"
_IDENTIFIER = r"^[A-Za-z0-9][A-Za-z0-9_-]*$"


def not_empty(values: tuple[Any, ...]) -> tuple[Any, ...]:
    """Refuse an empty list; pydantic's own check would count entries that are invalid."""
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
    unit: str | None = Field(default=None, min_length=1)
    """Unit of the key, such as `m/s`, for reports; default: what the domain's world states."""

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
    """A registered name such as `lift`, an import path `package.module:Class`, or path and
    params."""
    domain: str | None = Field(default=None, min_length=1)
    """The domain: a registered name, or `package.module:NAME`; default: the simulator's."""
    on_request: bool = False
    """Whether it is run only where `--dura-select` or an argument names it, whose `*` stands for
    no `/` of its name."""
    seed: int | None = Field(default=None, ge=0, lt=2**53)
    """Seed of the first run, from which those of further runs follow; by default all follow from
    the session's seed. A counterexample that was found keeps its seed here."""
    duration: float = Field(gt=0, le=86400)
    """Simulated seconds after which an episode ends."""
    time_step: float = Field(default=0.1, gt=0, le=86400)
    """Simulated seconds per tick."""
    iterations: int | None = Field(default=None, ge=1, le=1_000_000)
    """Decisions after which an episode ends, if it has not before; null for the duration alone."""
    runs: Runs = 1
    """Planned episodes per case, each with a seed of its own; or `{until: decided, at_most: N}`."""
    policy: Annotated[str, AfterValidator(_known_policy)] = "recover"
    """What follows a refused proposal: recover, halt, log_only, or refine(k), k at least 1."""
    time_budget: float | None = Field(default=5.0, gt=0)
    """Seconds that the component has for one proposal; null waits for ever."""
    clock: Literal["simulated", "wall"] = "simulated"
    """`wall`: ticks come when they are due by the machine's clock, and the world does not wait for
    the component."""
    latency: Literal["none", "declared", "measured"] = "none"
    """With the simulated clock: the world waits for the component (`none`), goes on for the latency
    that it declares, or for the wall-clock time that it took."""
    hold: float = Field(default=1.0, gt=0)
    """Seconds for which a command stays in force at most while the next one is late; then it is as
    if the component had proposed nothing."""
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
        try:
            is_timed = self.pace.is_timed
        except ConfigurationError as error:
            raise ValueError(f"{error.problem}; {error.remedy}") from None
        if is_timed and self.policy.startswith("refine"):
            raise ValueError(
                "`refine` asks anew within a tick, which `clock` and `latency` rule out"
            )
        return self

    @classmethod
    def from_document(cls, document: Document) -> Scenario:
        """Make the scenario of a YAML file.

        Raises:
            ConfigurationError: One for all errors of keys and values.
        """
        scenario = validate(cls, document)
        scenario._source = document  # noqa: SLF001 - our own
        return scenario

    @property
    def system(self) -> Domain | None:
        """Its domain, if it has one.

        Raises:
            ConfigurationError: For a domain that is named and is none.
        """
        return domain_of(self.simulator.path, self.domain)

    @property
    def units(self) -> dict[str, str]:
        """Units of its signals by name: those of its domain, and those that its world declares.

        Raises:
            ConfigurationError: For a domain that is named and is none.
        """
        factory = simulator_class(self.simulator_spec())
        domain, of_world = self.system, getattr(factory, "units_of", None)
        units = {} if domain is None else domain.units
        return units if of_world is None else {**units, **of_world(self.world)}

    @property
    def pace(self) -> Clock:
        """What thinking costs in its world."""
        return Clock(self.clock, self.latency, self.hold)

    def paced(self, kind: Literal["simulated", "wall"] | None = None) -> Clock:
        """Return its clock, or what it is by the kind of another one.

        Raises:
            ConfigurationError: Where its policy does not go with that clock.
        """
        if kind in (None, self.clock):
            return self.pace
        pace = Clock(kind or self.clock, hold=self.hold)
        if pace.is_timed and self.policy.startswith("refine"):
            raise ConfigurationError(
                f"the scenario {self.name!r} asks anew within a tick, "
                f"which the {kind} clock rules out",
                file=self.file or None,
                line=self.line_of("policy"),
                key="policy",
                found=self.policy,
                expected=f"recover, halt or log_only by the {kind} clock",
                remedy="change the policy, or leave the scenario out with --dura-select",
            )
        return pace

    def simulator_spec(self) -> RoleSpec:
        """Make the RoleSpec of the scenario's own simulator.

        Raises:
            ConfigurationError: For a name that is neither an alias nor an import path.
        """
        return simulator_spec(self.simulator.path, self.simulator.params)

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
        """The document it was read from; an empty one if it was made otherwise."""
        return self._source

    def __repr__(self) -> str:
        return f"Scenario({one_line(repr(self.name), 100)})"

    @property
    def file(self) -> str:
        """The file it was read from; empty if it was made otherwise."""
        return self._source.file

    def line_of(self, key: str) -> int | None:
        """Return the line of a dotted key in that file."""
        return self._source.line_of(key)

    def plain(self) -> dict[str, Any]:
        """Return plain data, from which an equal scenario can be read."""
        return self.model_dump(mode="json", exclude_unset=True)


def check_world(
    scenario: Scenario, simulator: RoleSpec, world: Mapping[str, Any]
) -> dict[str, Any]:
    """Check a world by the simulator's class, which fills in defaults.

    Raises:
        ConfigurationError: If the simulator cannot be imported, refuses the world, or lacks
            something that the world needs.
    """
    check = world_checker(scenario, simulator)
    try:
        checked = dict(world if check is None else check(world))
        factory = simulator_class(simulator)
        lacking = getattr(factory, "lacking", None)
        for key, value, reason in () if lacking is None else lacking(checked):
            raise lacks_error(factory, key, value, reason, key=f"world.{key}")
        return checked  # noqa: TRY300 - what may be raised is above
    except ValidationError as error:
        domain = domain_of(simulator.path, scenario.domain)
        model = None if domain is None else domain.world
        raise translate(error, model or BaseModel, scenario.source, "world") from None
    except ConfigurationError as error:
        key = error.key or "world"
        key = key if key.startswith(("world", "simulator")) else f"world.{key}"
        raise error_at(error, file=scenario.file, line=scenario.line_of(key), key=key) from None


def world_checker(scenario: Scenario, simulator: RoleSpec) -> Any:
    """Return what checks a world and fills in its defaults; ``None`` if nothing does.

    That is ``check_scenario`` of the simulator's class, or else the domain's model of worlds.

    Raises:
        ConfigurationError: If the class cannot be imported, or the domain is none.
    """
    check = getattr(simulator_class(simulator), "check_scenario", None)
    inherited = Simulator.check_scenario.__func__  # type: ignore[attr-defined]
    if check is not None and getattr(check, "__func__", None) is not inherited:
        return check
    domain = domain_of(simulator.path, scenario.domain)
    return None if domain is None or domain.world is None else partial(_by_model, domain.world)


def _by_model(model: type[BaseModel], world: Mapping[str, Any]) -> dict[str, Any]:
    known = model.model_fields
    for key in () if model.model_config.get("extra") == "allow" else world:
        if key not in known:
            raise ConfigurationError(
                f"unknown key {key!r} of the world",
                key=key,
                found=key,
                expected="one of " + ", ".join(known) if known else "an empty world",
                remedy=did_you_mean(key, known),
            )
    return model.model_validate(dict(world)).model_dump(mode="json")


def world_of_run(simulator: RoleSpec, world: dict[str, Any], run: int) -> dict[str, Any]:
    """Return the world of a run, by the simulator's class if it tells runs apart.

    Raises:
        ConfigurationError: If the class cannot be imported, or has no world for this run.
    """
    of_run = getattr(simulator_class(simulator), "world_of_run", None)
    return world if of_run is None else of_run(world, run)


def simulator_class(simulator: RoleSpec) -> Any:
    """Return the simulator's class, or the function that makes it.

    Raises:
        ConfigurationError: If it cannot be imported.
    """
    return type(simulator.instance) if simulator.opaque else simulator.factory()


def channel_aliases(scenario: Scenario) -> Mapping[str, str]:
    """Return the second names of channels, such as ``objects``, that the simulator declares.

    Raises:
        ConfigurationError: If its class cannot be imported, or declares one that cannot be used.
    """
    simulator, domain = scenario.simulator_spec(), scenario.system
    if ":" in scenario.simulator.path:
        check_registered(simulator.path)
    factory = simulator_class(simulator)
    if domain is None:
        return getattr(factory, "channel_aliases", {})
    return domain.aliases_of(factory)


def tolerances_of(spec: EpisodeSpec) -> Mapping[str, float] | None:
    """Return within what the signals of two runs are compared; ``None`` if digests are.

    Raises:
        ConfigurationError: If the simulator's class cannot be imported.
    """
    factory = simulator_class(spec.simulator)
    if spec.clock.not_repeatable:
        return getattr(factory, "tolerances", None) or None
    tolerances: Mapping[str, float] = getattr(factory, "tolerances", {})
    return None if getattr(factory, "deterministic", True) else tolerances


def lacks_error(
    factory: Any, feature: str, value: object, reason: str, *, key: str
) -> ConfigurationError:
    """Make the error for what a scenario needs and its simulator lacks.

    Args:
        factory: The simulator's class.
        feature: As its ``lacks`` names it.
        value: What the scenario gives.
        reason: Why it lacks it.
        key: Where the scenario gives it.
    """
    return ConfigurationError(
        f"{factory.__name__} lacks {feature}: {reason}",
        key=key,
        found=value,
        expected=f"a scenario that needs none of {', '.join(sorted(factory.lacks))}",
        remedy="run the scenario in another simulator of its domain, or leave this out",
    )


def draw_value(path: str, variation: Range | Choice, seed: int) -> Any:
    """Draw the value of a path in the run with this seed, independent of other paths."""
    numbers = stream(seed, f"variation:{path}")
    if isinstance(variation, Range):
        drawn = numbers.uniform(variation.min, variation.max, variation.pieces)
        return float(drawn) if variation.pieces is None else drawn.tolist()
    return variation.choice[int(numbers.integers(len(variation.choice)))]


def extreme_values(variation: Range | Choice) -> list[Any]:
    """List the values of a variation that are checked before any run."""
    if isinstance(variation, Range):
        ends = [variation.min, variation.max]
        return ends if variation.pieces is None else [[end] * variation.pieces for end in ends]
    return list(variation.choice)


def split_path(path: str) -> tuple[str, str]:
    """Split ``world.x.y`` to ``("", "x.y")``, and ``faults.id.x.y`` to ``("id", "x.y")``.

    Raises:
        ConfigurationError: For any other path.
    """
    head, _, rest = path.partition(".")
    if head == "world" and rest:
        return "", rest
    fault, _, inner = rest.partition(".")
    if head == "faults" and fault and inner:
        return fault, inner
    raise ConfigurationError(
        f"{path!r} cannot be varied",
        key=f"variation.{path}",
        found=path,
        expected="a path such as world.traffic.headway or faults.<id>.activation.at",
        remedy=did_you_mean(head, ("world", "faults")),
    )


def replace_value(data: Any, path: str, value: Any, *, create: bool = False) -> Any:
    """Copy plain data with the value at a dotted path replaced; lists are indexed from 0.

    Raises:
        ConfigurationError: If the path does not exist. ``create`` allows the last key to be new.
    """
    head, _, rest = path.partition(".")
    if isinstance(data, Mapping):
        if head not in data and not (create and not rest):
            raise _no_such(head, data)
        inner = replace_value(data[head], rest, value, create=create) if rest else value
        return {**data, head: inner}
    if isinstance(data, (list, tuple)):
        if not (head.isdecimal() and int(head) < len(data)):
            raise _no_such(head, map(str, range(len(data))))
        copied = list(data)
        i = int(head)
        copied[i] = replace_value(copied[i], rest, value, create=create) if rest else value
        return copied
    raise _no_such(head, ())


def _no_such(key: str, known: Any) -> ConfigurationError:
    names = sorted(map(str, known))
    if isinstance(known, Mapping) and not names:
        return ConfigurationError(
            f"there is no {key!r} to vary",
            found=key,
            expected="a key that has a value, and nothing has one here",
            remedy="give it one, or a default by the `world` of the domain",
        )
    return ConfigurationError(
        f"there is no {key!r} to vary",
        found=key,
        expected="one of " + ", ".join(names) if names else "nothing below a single value",
        remedy=did_you_mean(key, names),
    )


DIALECT = "https://json-schema.org/draft/2020-12/schema"


def scenario_schema() -> dict[str, Any]:
    """Make the schema: a scenario's keys, each domain's world, each fault type's parameters."""
    from pydantic.json_schema import models_json_schema

    worlds: dict[str, type[BaseModel]] = {
        name: domain.world for name, domain in DOMAINS.items() if domain.world is not None
    }
    faults = {name: form_of(kind) for name, kind in FAULT_TYPES.items()}
    models: list[type[BaseModel]] = [Scenario, FaultEntry, *worlds.values(), *faults.values()]
    references, combined = models_json_schema([(model, "validation") for model in models])
    definitions = combined["$defs"]

    def definition(model: Any) -> Any:
        return definitions[_name(references[model, "validation"])]

    scenario = definitions.pop(_name(references[Scenario, "validation"]))
    scenario["allOf"] = [
        _when_clause("simulator", alias, {"world": references[model, "validation"]})
        for alias, model in worlds.items()
    ]
    entry = definition(FaultEntry)
    entry["properties"]["type"]["enum"] = list(faults)
    entry["allOf"] = []
    for name, model in faults.items():
        parts = definition(model)["properties"]
        own = {part: parts[part] for part in ("activation", "parameters")}
        entry["allOf"].append(_when_clause("type", name, own))
    for model in faults.values():
        definitions.pop(_name(references[model, "validation"]))
    return {"$schema": DIALECT, **scenario, "$defs": definitions}


def write_schema(path: Path) -> None:
    """Write the schema to a file; equal schemas give equal bytes."""
    path.write_text(json.dumps(scenario_schema(), indent=2, sort_keys=True) + "\n", "utf-8")


def _name(reference: dict[str, Any]) -> str:
    return str(reference["$ref"]).rpartition("/")[2]


def _when_clause(key: str, value: str, properties: dict[str, Any]) -> dict[str, Any]:
    condition = {"properties": {key: {"const": value}}, "required": [key]}
    return {"if": condition, "then": {"properties": properties}}


if __name__ == "__main__":
    _own = Path(__file__).resolve().parents[2] / "scenarios" / SCHEMA_FILE
    write_schema(Path(sys.argv[1]) if sys.argv[1:] else _own)
