"""Differences between a counterexample and the nominal case, parameter by parameter."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any

from pytest_dura.campaign.falsification import ParameterChange
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.domains import domain_of, simulator_spec
from pytest_dura.faults.catalogue import BY_CHANCE, fault_class
from pytest_dura.library.cases import Case, SearchedCase
from pytest_dura.library.planned_faults import parse_fault
from pytest_dura.library.scenario import check_world, world_checker

Keys = tuple[str | int, ...]
"""Where something is in plain data: keys of mappings, places of lists."""


class Absence(Enum):
    """In the place of a value where there is none; ``None`` is a value."""

    NOTHING_THERE = "nothing there"
    REQUIRED = "required"


ABSENT, REQUIRED = Absence.NOTHING_THERE, Absence.REQUIRED


def is_list(data: Any) -> bool:
    """Whether it is a list of plain data."""
    return isinstance(data, (list, tuple))


def has_entries(*lists: Any) -> bool:
    """Whether these are lists of mappings, and not all of them empty."""
    every = [item for data in lists if is_list(data) for item in data]
    return bool(every) and all(isinstance(item, Mapping) for item in every)


def match_entries(found: Sequence[Any], nominal: Any) -> Iterator[tuple[str, int | None, Any]]:
    """The entries of two lists: name, place in the first or ``None``, what the second has.

    They are matched by their ``id`` where each has one of its own, else by their place. What only
    the second list has comes last.
    """
    others = list(nominal) if is_list(nominal) else []
    named = all(_names_apart(item) for item in (found, others))
    ours = {_name(item, i, named): i for i, item in enumerate(found)}
    theirs = {_name(item, i, named): item for i, item in enumerate(others)}
    for name, place in ours.items():
        yield name, place, theirs.get(name, ABSENT)
    for name, their in theirs.items():
        if name not in ours:
            yield name, None, their


def value_at(data: Any, keys: Keys) -> Any:
    """What is at a place; ``ABSENT`` where the place does not exist."""
    for key in keys:
        inside = isinstance(data, Mapping) and key in data
        if not inside and not (is_list(data) and isinstance(key, int) and key < len(data)):
            return ABSENT
        data = data[key]
    return data


def with_value(data: Any, keys: Keys, value: Any) -> Any:
    """A copy with the value at a place replaced; ``ABSENT`` takes it out."""
    key, *rest = keys
    copied: Any = dict(data) if isinstance(data, Mapping) else list(data)
    if rest:
        copied[key] = with_value(data[key], tuple(rest), value)
    elif value is ABSENT:
        del copied[key]
    else:
        copied[key] = value
    return copied


def dotted_path(keys: Keys) -> str:
    """Such as ``vehicles.0.speed``."""
    return ".".join(map(str, keys))


def _name(entry: Mapping[str, Any], place: int, named: bool) -> str:
    return str(entry["id"]) if named else str(place)


def _names_apart(entries: Sequence[Any]) -> bool:
    names = [entry.get("id") for entry in entries if isinstance(entry, Mapping)]
    return all(isinstance(name, str) for name in names) and len(set(names)) == len(names)


@dataclass(frozen=True)
class Nominal:
    """The case as its scenario has it.

    Args:
        case: The case.
        simulator: In place of the scenario's.
    """

    case: Case
    simulator: RoleSpec

    @classmethod
    def of(cls, case: Case, simulator: RoleSpec | None = None) -> Nominal:
        """What a case is, run on its own simulator or on another one."""
        entry = case.scenario.simulator
        return cls(case, simulator or simulator_spec(entry.path, entry.params))

    @property
    def seed(self) -> int:
        """The scenario's seed, or 0."""
        return self.case.scenario.seed or 0

    @cached_property
    def world(self) -> dict[str, Any]:
        """The scenario's world, defaults filled in."""
        return self.checked(self.case.scenario.world)

    def checked(self, world: Mapping[str, Any]) -> dict[str, Any]:
        """A world with defaults filled in.

        Raises:
            ConfigurationError: If the simulator refuses it.
        """
        return check_world(self.case.scenario, self.simulator, world)

    def concrete(self, world: Mapping[str, Any], seed: int) -> dict[str, Any]:
        """An equal world in which nothing is left to the seed, where the domain can tell one."""
        domain = domain_of(self.simulator.path)
        if domain is None:
            return dict(world)
        return domain.concrete_world(world, self.case.scenario.duration, seed)

    def default(self, world: Mapping[str, Any], keys: Keys) -> Any:
        """What is filled in where a world has nothing at a place.

        Returns:
            ``ABSENT`` if it may be left out and nothing is filled in, ``REQUIRED`` if it
            may not.
        """
        if world_checker(self.simulator) is None:
            return REQUIRED
        try:
            return value_at(self.checked(with_value(world, keys, ABSENT)), keys)
        except ConfigurationError:
            return REQUIRED

    def may_be_none(self, world: Mapping[str, Any], keys: Keys) -> bool:
        """Whether a part of a world can be left out."""
        if world_checker(self.simulator) is None:
            return False
        try:
            return value_at(self.checked(with_value(world, keys, None)), keys) is None
        except ConfigurationError:
            return False

    def fault(self, fault: Mapping[str, Any]) -> tuple[dict[str, Any], bool]:
        """What a fault is compared with, and whether the case itself has it.

        That is the case's own fault of the same id and type, else the example of its type.
        """
        for own in self.case.faults:
            if (own["id"], own["type"]) == (fault["id"], fault["type"]):
                return own, True
        kind = fault["type"]
        example = {"type": kind, "id": fault["id"], **fault_class(kind).example()}
        try:
            return parse_fault(self.case.scenario, example), False
        except ConfigurationError:
            # Nothing says where such a fault acts by default, or the example begins after the end:
            # it acts where this one does, and from the beginning.
            own_place = {"target": fault["target"], "activation": {"at": 0.0}}
            return parse_fault(self.case.scenario, example | own_place), False


_NAMES = (BY_CHANCE, "id", "type")
"""Keys of a fault that are no parameters of it."""


def changes_of(
    case: Case, searched: SearchedCase, *, simulator: RoleSpec | None = None
) -> tuple[ParameterChange, ...]:
    """Every parameter of a searched case that is not as its case has it.

    Worlds are compared with their defaults filled in. An entry of a list that only one of them has
    is one change, such as ``world.vehicles.CAR1``; its value leaves out what is at its default. A
    fault that was added is one change, ``faults.delay`` with its type as the value, and each key in
    which it is not the example of its type is another, such as ``faults.delay.activation.at``. The
    seed is compared with the scenario's, or with 0.

    Args:
        case: The case.
        searched: What a search made of it.
        simulator: In place of the scenario's.

    Raises:
        ConfigurationError: If the simulator refuses one of the worlds.
    """
    nominal = Nominal.of(case, simulator)
    world = nominal.checked(searched.scenario.world)
    found = [
        _reduced(nominal, world, difference)
        for difference in _differences(world, nominal.world, ())
    ]
    found += _fault_changes(nominal, searched.faults)
    seed = searched.scenario.seed or 0
    return (
        *found,
        *([ParameterChange("seed", seed, nominal.seed)] if seed != nominal.seed else []),
    )


def count_parameters(changes: Iterable[ParameterChange]) -> int:
    """How many parameters are not as the case has them.

    A change of a value counts one, as does the type of an added fault. An added entry counts the
    values that it does not leave at their defaults, without its ``id``. What was left out has no
    parameters, and counts none.
    """
    return sum(_size(change) for change in changes)


def _size(change: ParameterChange) -> int:
    if isinstance(change.nominal, Mapping) and change.value is None:
        return 0
    return max(_leaves(change.value), 1)


def _leaves(value: Any) -> int:
    if isinstance(value, Mapping):
        return sum(_leaves(item) for key, item in value.items() if key != "id")
    return sum(map(_leaves, value)) if is_list(value) else 1


def _fault_changes(
    nominal: Nominal, faults: Iterable[Mapping[str, Any]]
) -> Iterator[ParameterChange]:
    gone = {fault["id"]: fault for fault in nominal.case.faults}
    for fault in faults:
        before, own = nominal.fault(fault)
        path = f"faults.{fault['id']}"
        if own:
            del gone[fault["id"]]
        else:
            yield ParameterChange(path, fault["type"], None)
        for key in [key for key in fault if key not in _NAMES]:
            for keys, value, plain, _ in _differences(fault[key], before.get(key), (key,)):
                yield ParameterChange(
                    f"{path}.{dotted_path(keys)}", _or_none(value), _or_none(plain)
                )
    for name, fault in gone.items():
        yield ParameterChange(f"faults.{name}", None, fault)


Difference = tuple[Keys, Any, Any, Keys]
"""Its name, the found value, the case's, and where it is in the found data."""


def _differences(found: Any, nominal: Any, name: Keys, place: Keys = ()) -> Iterator[Difference]:
    if isinstance(found, Mapping) and isinstance(nominal, Mapping):
        for key in dict.fromkeys([*nominal, *found]):
            yield from _differences(
                found.get(key, ABSENT),
                nominal.get(key, ABSENT),
                (*name, key),
                (*place, key),
            )
    elif has_entries(found, nominal) and is_list(found) and is_list(nominal):
        for own, index, other in match_entries(found, nominal):
            value = ABSENT if index is None else found[index]
            where = (*place, index if index is not None else -1)
            yield from _differences(value, other, (*name, own), where)
    elif is_list(found) and is_list(nominal) and len(found) == len(nominal):
        for i, (item, other) in enumerate(zip(found, nominal, strict=True)):
            yield from _differences(item, other, (*name, i), (*place, i))
    elif found != nominal:
        yield name, found, nominal, place


def _reduced(nominal: Nominal, world: Mapping[str, Any], difference: Difference) -> ParameterChange:
    """A difference of worlds, without what an added entry leaves at its default."""
    name, value, plain, place = difference
    if isinstance(value, Mapping) and _or_none(plain) is None:
        value = {
            key: item
            for key, item in value.items()
            if key == "id" or nominal.default(world, (*place, key)) != item
        }
    return ParameterChange(f"world.{dotted_path(name)}", _or_none(value), _or_none(plain))


def _or_none(value: Any) -> Any:
    return None if value is ABSENT else value
