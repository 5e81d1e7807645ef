"""Fault campaigns: lists, grids and random samples of faults, and the catalogue."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from pydantic import AfterValidator, Field, JsonValue, ValidationError

from pytest_dura.core.errors import ConfigurationError, did_you_mean, error_at
from pytest_dura.core.fault import Fault
from pytest_dura.domains import Domain
from pytest_dura.faults.catalogue import FAULT_TYPES, fault_class
from pytest_dura.faults.model import possible_targets
from pytest_dura.faults.parts import PARAMETERS
from pytest_dura.library.documents import MAX_DEPTH, Document, read_yaml, translate
from pytest_dura.library.planned_faults import (
    FaultReader,
    ReadFault,
    ReadPart,
    check_chains,
    example_fault,
    parse_fault,
)
from pytest_dura.library.scenario import Entry, Scenario, Variation, draw_value, not_empty

MAX_CASES = 10_000
"""Cases that the fault campaigns of one scenario may make, all together."""

Values = Annotated[tuple[JsonValue, ...], Field(strict=False), AfterValidator(not_empty)]


class FaultGrid(Entry):
    """Every combination of values."""

    fault: dict[str, JsonValue]
    """The fault, without what the grid varies."""
    grid: dict[str, Values]
    """Keys of the fault, such as `parameters.offset`, to their values."""


class FaultSample(Entry):
    """Faults with random values."""

    fault: dict[str, JsonValue]
    """The fault, without what is drawn."""
    sample: dict[str, Variation]
    """Keys of the fault, such as `parameters.offset`, to a range or a choice."""
    count: int = Field(ge=1, le=MAX_CASES)
    """How many faults."""
    seed: int = Field(default=0, ge=0)
    """From which all draws follow."""


def expand_grid(scenario: Scenario, data: Mapping[str, Any]) -> Iterator[Fault]:
    """Yield the faults of a :class:`FaultGrid`, the last key varying fastest.

    Raises:
        ConfigurationError: For too many of them, and for one that cannot be used.
    """
    given: FaultGrid = _model(FaultGrid, data)
    _check_keys("grid", given.grid)
    check_case_count(math.prod(map(len, given.grid.values())), "grid")
    yield from _combinations(given, FaultReader(scenario))


def _expand_sample(scenario: Scenario, data: Mapping[str, Any]) -> Iterator[Fault]:
    """Yield the faults of a :class:`FaultSample`; each value has its own stream.

    Raises:
        ConfigurationError: For one that cannot be used.
    """
    given: FaultSample = _model(FaultSample, data)
    _check_keys("sample", given.sample)
    reader = FaultReader(scenario)
    for number in range(given.count):
        values = {
            path: draw_value(f"{number}:{path}", spread, given.seed)
            for path, spread in given.sample.items()
        }
        fault: Any = _with_id(given.fault)
        for path, value in values.items():
            fault = _with_value(fault, path.split("."), value)
        name = f"{fault['id']}-sample{given.seed}.{number}"
        yield reader.read({**fault, "id": name})


def check_case_count(cases: int, key: str) -> None:
    """Refuse more than ``MAX_CASES`` cases.

    Raises:
        ConfigurationError: With the key.
    """
    if cases > MAX_CASES:
        raise ConfigurationError(
            "these fault campaigns make too many cases",
            key=key,
            found=f"{cases:,} cases" if cases < 10**15 else "more than 10^15 cases",
            expected=f"at most {MAX_CASES:,} cases of one scenario",
            remedy="give fewer values, or draw some of the combinations with a `sample`",
        )


def _check_keys(kind: str, keys: Iterable[str]) -> None:
    """Refuse an empty mapping, and keys of which one overwrites another."""
    paths = {key: key.split(".") for key in keys}
    if not paths:
        raise ConfigurationError(
            f"the {kind} varies nothing",
            key=kind,
            expected="keys of the fault with their values",
            remedy=f"for example {kind}: {{parameters.offset: "
            + ("[1, 2]}" if kind == "grid" else "{min: 1, max: 2}}"),
        )
    for key, path in paths.items():
        if len(path) > MAX_DEPTH:
            raise ConfigurationError(
                f"a key of the {kind} is nested too deeply",
                key=kind,
                found=f"{len(path)} parts",
                expected=f"at most {MAX_DEPTH} parts",
                remedy="name a key of the fault, such as parameters.offset",
            )
        within = [
            inner for inner, longer in paths.items() if inner != key and longer[: len(path)] == path
        ]
        if within:
            raise ConfigurationError(
                f"the {kind} sets {key!r}, and {within[0]!r} within it",
                key=f"{kind}.{key}",
                found=key,
                expected="keys of which none is part of another",
                remedy="leave out one of them",
            )


def _combinations(given: FaultGrid, reader: FaultReader) -> Iterator[Fault]:
    base = _with_id(given.fault)
    parts = _GridPart.of(given.grid, base)
    names = [f"-{name}=" for name in _short_names(list(given.grid))]
    first: ReadFault | None = None
    for chosen in itertools.product(*(range(len(values)) for values in given.grid.values())):
        values = {part.key: part.value(chosen, reader) for part in parts}
        texts = {place: text for value in values.values() for place, text in value.texts.items()}
        suffix = "".join([name + texts[place] for place, name in enumerate(names)])
        known = {key: value.read for key, value in values.items() if value.read is not None}
        # How strong a drift is by default may follow from how long it lasts.
        follows = "duration" in values and PARAMETERS not in values
        if (
            first is not None
            and len(known) == len(values)
            and not (follows and reader.suited(first.fault.plain()))
        ):
            yield first.combined(f"{base['id']}{suffix}", known)
            continue
        data = {key: value.data for key, value in values.items()}
        read = reader.read_parts({**base, **data, "id": f"{base['id']}{suffix}"})
        first = first or read
        for key, value in values.items():
            value.read = read.parts.get(key)
        yield read.fault


@dataclass
class _GridValue:
    """Value of a key of a fault in a grid, such as its ``activation``."""

    data: Any
    texts: dict[int, str]
    """Texts for the id of the fault, by the position of the varied path in the grid."""
    read: ReadPart | None = None
    """What it was read as in the first fault that has it, if it is a part of a fault."""


@dataclass
class _GridPart:
    """Key of a fault that a grid varies, of which each value is made and read once."""

    key: str
    base: Any
    """The value that the fault gives without the grid."""
    paths: dict[int, tuple[list[str], Sequence[Any]]] = field(default_factory=dict)
    """By position in the grid: keys within the part, and their values."""
    made: dict[tuple[int, ...], _GridValue] = field(default_factory=dict)

    @classmethod
    def of(cls, grid: Mapping[str, Sequence[Any]], base: Mapping[str, Any]) -> list[_GridPart]:
        """Sort the paths of a grid by the key of the fault that each is in."""
        parts: dict[str, _GridPart] = {}
        for place, (key, values) in enumerate(grid.items()):
            first, *inner = key.split(".")
            part = parts.setdefault(first, cls(first, base.get(first)))
            part.paths[place] = inner, values
        return [*parts.values()]

    def value(self, chosen: Sequence[int], reader: FaultReader) -> _GridValue:
        """Return its value in a combination, which says the index of each path's value."""
        own = tuple([chosen[place] for place in self.paths])
        if own not in self.made:
            data = self.base
            for place, (path, values) in self.paths.items():
                data = _with_value(data, path, values[chosen[place]])
            # Either name of a channel makes the same fault, and so the same id.
            data = reader.by_channels({self.key: data})[self.key]
            texts = {
                place: _id_part(reduce(getitem, path, data))
                for place, (path, _) in self.paths.items()
            }
            self.made[own] = _GridValue(data, texts)
        return self.made[own]


def _with_id(fault: Mapping[str, Any]) -> dict[str, Any]:
    return {"id": fault.get("id", fault.get("type", "")), **fault}


def _with_value(data: Any, path: Sequence[str], value: Any) -> Any:
    """Copy data with the value at a path, and create mappings on the way."""
    if not path:
        return value
    inner = data if isinstance(data, dict) else {}
    return {**inner, path[0]: _with_value(inner.get(path[0]), path[1:], value)}


def _short_names(paths: Sequence[str]) -> list[str]:
    """Return the last part of each path; all of it where two end alike."""
    last = [path.rpartition(".")[2] for path in paths]
    return [path if last.count(name) > 1 else name for path, name in zip(paths, last, strict=True)]


def _id_part(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return "".join(char if char.isalnum() or char in "_.-" else "_" for char in text)


def _model(model: type[Any], data: Mapping[str, Any]) -> Any:
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise translate(error, model, Document()) from None


SingleFault: TypeAlias = str | Mapping[str, Any]
FaultCampaign: TypeAlias = SingleFault | Sequence[SingleFault]
"""An entry of a list of fault campaigns: a name, a fault as data, a list of these, a grid or a
sample; see :func:`expand_campaign`."""
Faults: TypeAlias = tuple[Fault, ...]


@dataclass(frozen=True)
class ScenarioFaults:
    """The checked faults of a scenario, with defaults filled in.

    Args:
        own: Those of its key ``faults``.
        campaigns: For each entry of its ``campaigns``, the faults of each case.
    """

    own: Faults
    campaigns: tuple[list[Faults], ...]


NO_FAULTS = "none"
_CATALOGUE = "catalogue"
GLOB = "*?["
"""Characters that make a name a glob."""


@dataclass(frozen=True)
class FileEntry:
    """An entry of a file of fault campaigns, with its place for messages."""

    campaign: Any
    document: Document
    index: int

    def __str__(self) -> str:
        return str(self.campaign)

    def error(self, error: ConfigurationError) -> ConfigurationError:
        """Return the error with its place in the file."""
        key = f"campaigns.{self.index}"
        # In a marker entries are below `faults`; here that is the entry itself.
        place = f"{key}.{error.key}" if error.key not in (None, "faults") else key
        line = self.document.line_of(place)
        return error_at(error, file=self.document.file, line=line, key=place)


def read_campaigns(path: Path) -> list[FileEntry]:
    """Read the fault campaigns of a YAML file: a mapping with the key ``campaigns``.

    Raises:
        ConfigurationError: If the file cannot be read, or has another form.
    """
    document = read_yaml(path)
    campaigns = document.data.get("campaigns")
    if set(document.data) != {"campaigns"} or not isinstance(campaigns, list) or not campaigns:
        raise ConfigurationError(
            "this is no file of fault campaigns",
            file=document.file,
            line=1,
            key="campaigns",
            found=", ".join(map(str, document.data)),
            expected="the key `campaigns` alone, with a list",
            remedy="for example campaigns: [none, ghost-obstacle]",
        )
    return [FileEntry(campaign, document, i) for i, campaign in enumerate(campaigns)]


def expand_campaign(scenario: Scenario, own: Faults, campaign: object) -> list[Faults]:
    """List the faults of each case of an entry, with defaults filled in.

    Args:
        scenario: Gives the domain of the faults.
        own: The scenario's own faults, which come before the catalogue's of the same name.
        campaign: The entry.

    Raises:
        ConfigurationError: For an unknown fault, and for one that cannot be used.
    """
    if isinstance(campaign, FileEntry):
        try:
            return expand_campaign(scenario, own, campaign.campaign)
        except ConfigurationError as error:
            raise campaign.error(error) from None
    if isinstance(campaign, str):
        return _by_name(scenario, own, campaign)
    if isinstance(campaign, Mapping):
        for key, expand in (("grid", expand_grid), ("sample", _expand_sample)):
            if key in campaign:
                return [_single_fault(scenario, own, fault) for fault in expand(scenario, campaign)]
        campaign = [campaign]
    if not isinstance(campaign, Sequence) or not _are_faults(campaign):
        raise ConfigurationError(
            "this is no fault campaign",
            key="faults",
            found=campaign,
            expected="a fault's name or data, a list of them, a grid or a sample",
            remedy=f"for example {NO_FAULTS}, or ghost-obstacle",
        )
    return [_joint_faults(scenario, own, campaign)]


def _are_faults(campaign: Sequence[Any]) -> bool:
    # An empty list would be a run without any fault, which is `none`.
    return bool(campaign) and all(isinstance(fault, (str, Mapping)) for fault in campaign)


def _single_fault(scenario: Scenario, own: Faults, fault: Fault) -> Faults:
    check_chains([fault])
    _check_not_varied(scenario, own, fault)
    return (fault,)


def _check_not_varied(scenario: Scenario, own: Faults, fault: Fault) -> None:
    """Refuse a fault whose values the variation of the scenario's own fault would overwrite."""
    paths = [path for path in scenario.variation if path.startswith(f"faults.{fault.id}.")]
    if paths and fault not in own:
        raise ConfigurationError(
            f"the scenario varies a fault of its own with the id {fault.id!r}",
            key="id",
            found=fault.id,
            expected=f"an id that the scenario's variation does not name ({paths[0]})",
            remedy="give it another `id`, or name the scenario's own fault",
        )


def _by_name(scenario: Scenario, own: Faults, text: str) -> list[Faults]:
    if text == NO_FAULTS:
        return [()]
    matched = _matching(scenario, text)
    if matched is not None:
        return [
            _single_fault(scenario, own, _fault_of_name(scenario, own, name)) for name in matched
        ]
    return [_joint_faults(scenario, own, text.split("+"))]


def catalogue_for(scenario: Scenario) -> list[str]:
    """List the types of the catalogue whose defaults can act in the scenario's domain."""
    return catalogue_of(scenario.system)


def catalogue_of(domain: Domain | None) -> list[str]:
    """List the types of the catalogue whose defaults can act in a domain."""
    channels = None if domain is None else domain.channels
    if domain is None or channels is None:
        return []
    kinds = {name: fault_class(name).acts_on for name in FAULT_TYPES}
    return [
        name
        for name, kind in kinds.items()
        if kind in domain.fault_targets and possible_targets(kind, channels)
    ]


def _matching(scenario: Scenario, text: str) -> list[str] | None:
    """List the types that ``catalogue`` or a glob stands for; ``None`` for anything else."""
    if text != _CATALOGUE and not set(text) & set(GLOB):
        return None
    usable = catalogue_for(scenario)
    if not usable:
        raise ConfigurationError(
            f"the catalogue has no faults that fit {scenario.name!r} by themselves",
            key="faults",
            found=text,
            expected="faults with a `target`, since the domain of its simulator is not known",
            remedy="name each fault as data: {type: ..., target: ..., activation: {at: ...}}",
        )
    if text == _CATALOGUE:
        return usable
    matched = [name for name in usable if fnmatchcase(name, text)]
    if not matched:
        raise ConfigurationError(
            f"no fault of the catalogue matches {text!r}",
            key="faults",
            found=text,
            expected="a glob of: " + ", ".join(usable),
            remedy=did_you_mean(text, usable),
        )
    return matched


def _joint_faults(scenario: Scenario, own: Faults, names: Sequence[SingleFault]) -> Faults:
    chosen: dict[str, Fault] = {}
    for name in names:
        fault = (
            parse_fault(scenario, name)
            if isinstance(name, Mapping)
            else _fault_of_name(scenario, own, name)
        )
        if chosen.setdefault(fault.id, fault) != fault:
            raise ConfigurationError(
                f"two faults of one campaign have the id {fault.id!r}",
                key="faults",
                found=fault.id,
                expected="an id of its own for each fault",
                remedy="give one of them another `id`",
            )
        _check_not_varied(scenario, own, fault)
    check_chains(list(chosen.values()))
    return tuple(chosen.values())


def _fault_of_name(scenario: Scenario, own: Faults, name: str) -> Fault:
    for fault in own:
        if fault.id == name:
            return fault
    if name in FAULT_TYPES:
        return example_fault(scenario, name)
    known = {*FAULT_TYPES, *(fault.id for fault in own)}
    if name in (NO_FAULTS, _CATALOGUE) or set(name) & set(GLOB):
        raise ConfigurationError(
            f"{name!r} is a campaign by itself, and no fault among others",
            key="faults",
            found=name,
            expected="one of " + ", ".join(sorted(known)),
            remedy=f"make {name!r} an entry of its own",
        )
    raise ConfigurationError(
        f"unknown fault {name!r}",
        key="faults",
        found=name,
        expected=f"{NO_FAULTS}, {_CATALOGUE}, or one of " + ", ".join(sorted(known)),
        remedy=did_you_mean(name, {*known, NO_FAULTS, _CATALOGUE}),
    )
