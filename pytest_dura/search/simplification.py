"""Simplification: how a case differs from its nominal one, and the choices to make it simpler.

Each choice goes from the simplest value of a parameter to the value that the case has.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from itertools import takewhile
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.fault import Fault
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.domains import domain_of
from pytest_dura.faults.catalogue import BY_CHANCE
from pytest_dura.faults.parts import Choices, Span
from pytest_dura.library.cases import Case, SearchedCase, make_searched_case
from pytest_dura.library.planned_faults import example_fault, spans_in
from pytest_dura.library.scenario import Choice, Range, check_world, world_checker
from pytest_dura.requirements.searches import ParameterChange
from pytest_dura.search.space import input_unit

Keys = tuple[str | int, ...]
"""Where something is in plain data: keys of mappings, places of lists."""


class _Absence(Enum):
    """Stands in the place of a value where there is none; ``None`` is a value."""

    ABSENT = "absent"
    REQUIRED = "required"


ABSENT, _REQUIRED = _Absence.ABSENT, _Absence.REQUIRED


def _is_list(data: Any) -> bool:
    return isinstance(data, (list, tuple))


def _has_entries(*lists: Any) -> bool:
    """Whether these are lists of mappings, and not all of them empty."""
    entries = [entry for data in lists if _is_list(data) for entry in data]
    return bool(entries) and all(isinstance(entry, Mapping) for entry in entries)


def _match_entries(values: Sequence[Any], nominal: Any) -> Iterator[tuple[str, int | None, Any]]:
    """Pair the entries of two lists: name, place in the first or ``None``, value of the second.

    They are matched by their ``id`` where each has one of its own, else by their place. Entries of
    the second list alone come last.
    """
    others = list(nominal) if _is_list(nominal) else []
    named = all(_have_unique_ids(entries) for entries in (values, others))
    places = {_name(entry, i, named): i for i, entry in enumerate(values)}
    nominal_entries = {_name(entry, i, named): entry for i, entry in enumerate(others)}
    for name, place in places.items():
        yield name, place, nominal_entries.get(name, ABSENT)
    for name, entry in nominal_entries.items():
        if name not in places:
            yield name, None, entry


def value_at(data: Any, keys: Keys) -> Any:
    """Return the value at a place; ``ABSENT`` where the place does not exist."""
    for key in keys:
        inside = isinstance(data, Mapping) and key in data
        if not inside and not (_is_list(data) and isinstance(key, int) and key < len(data)):
            return ABSENT
        data = data[key]
    return data


def with_value(data: Any, keys: Keys, value: Any) -> Any:
    """Copy data with the value at a place replaced; ``ABSENT`` removes it."""
    key, *rest = keys
    copied: Any = dict(data) if isinstance(data, Mapping) else list(data)
    if rest:
        copied[key] = with_value(data[key], tuple(rest), value)
    elif value is ABSENT:
        del copied[key]
    else:
        copied[key] = value
    return copied


def with_values(data: Any, edits: Iterable[tuple[Keys, Any]]) -> Any:
    """Copy data with the values at several places replaced; ``ABSENT`` removes one."""

    def order(edit: tuple[Keys, Any]) -> tuple[bool, tuple[tuple[bool, Any], ...]]:
        # Remove last, and from the last to the first, so that places in lists stay the same.
        keys, value = edit
        return value is not ABSENT and value is not None, tuple(
            (isinstance(key, str), key) for key in keys
        )

    for keys, value in sorted(edits, key=order, reverse=True):
        data = with_value(data, keys, value)
    return data


def _dotted_path(keys: Keys) -> str:
    """Return a path such as ``vehicles.0.speed``."""
    return ".".join(map(str, keys))


def _name(entry: Mapping[str, Any], place: int, named: bool) -> str:
    return str(entry["id"]) if named else str(place)


def _have_unique_ids(entries: Sequence[Any]) -> bool:
    names = [entry.get("id") for entry in entries if isinstance(entry, Mapping)]
    return all(isinstance(name, str) for name in names) and len(set(names)) == len(names)


@dataclass(frozen=True)
class Nominal:
    """A case as its scenario has it, which searched cases are compared with.

    Args:
        case: The case.
        simulator: Checks its worlds.
    """

    case: Case
    simulator: RoleSpec

    @classmethod
    def of(cls, case: Case, simulator: RoleSpec | None = None) -> Nominal:
        """Take a case with its own simulator, or with another one."""
        return cls(case, simulator or case.scenario.simulator_spec())

    @property
    def seed(self) -> int:
        """The scenario's seed, or 0."""
        return self.case.scenario.seed or 0

    @cached_property
    def world(self) -> dict[str, Any]:
        """The scenario's world, defaults filled in."""
        return self.checked(self.case.scenario.world)

    def checked(self, world: Mapping[str, Any]) -> dict[str, Any]:
        """Check a world, and fill in its defaults.

        Raises:
            ConfigurationError: If the simulator refuses it.
        """
        return check_world(self.case.scenario, self.simulator, world)

    def concrete(self, world: Mapping[str, Any], seed: int) -> dict[str, Any]:
        """Write out what the seed draws in a world, where the domain can."""
        domain = domain_of(self.simulator.path, self.case.scenario.domain)
        if domain is None:
            return dict(world)
        return domain.concrete_world(world, self.case.scenario.duration, seed)

    def default(self, world: Mapping[str, Any], keys: Keys) -> Any:
        """Return the default of a place in a world.

        Returns:
            ``ABSENT`` if the place may be left out and has no default, ``_REQUIRED`` if it may
            not.
        """
        return self._checked_value(world, keys, ABSENT)

    def may_be_none(self, world: Mapping[str, Any], keys: Keys) -> bool:
        """Whether a part of a world can be left out."""
        return self._checked_value(world, keys, None) is None

    def _checked_value(self, world: Mapping[str, Any], keys: Keys, value: Any) -> Any:
        """Return what the simulator makes of a value in a world; ``_REQUIRED`` if it refuses it."""
        if world_checker(self.case.scenario, self.simulator) is None:
            return _REQUIRED
        try:
            return value_at(self.checked(with_value(world, keys, value)), keys)
        except ConfigurationError:
            return _REQUIRED

    def fault(self, fault: Mapping[str, Any]) -> tuple[Fault, bool]:
        """Return the fault that a fault is compared with, and whether it is the case's own.

        That is the case's own fault of the same id and type, else the example of its type.
        """
        for own in self.case.faults:
            if (own.id, own.type) == (fault["id"], fault["type"]):
                return own, True
        kind = fault["type"]
        own_id = {"id": fault["id"]}
        try:
            return example_fault(self.case.scenario, kind, own_id), False
        except ConfigurationError:
            # Such a fault has no default target, or the example begins after the end: compare with
            # one of the same target that acts from the beginning.
            own_place = {"target": fault["target"], "activation": {"at": 0.0}}
            return example_fault(self.case.scenario, kind, own_id | own_place), False


_NOT_PARAMETERS = (BY_CHANCE, "id", "type")
"""Keys of a fault that are no parameters of it."""


def changes_of(
    case: Case, searched: SearchedCase, *, simulator: RoleSpec | None = None
) -> tuple[ParameterChange, ...]:
    """List every parameter of a searched case that differs from its nominal case.

    Worlds are compared with their defaults filled in. An entry of a list that only one of them has
    is one change, such as ``world.vehicles.CAR1``; its value leaves out what is at its default. A
    fault that was added is one change, ``faults.delay`` with its type as the value, and each key in
    which it is not the example of its type is another, such as ``faults.delay.activation.at``. The
    seed is compared with the scenario's, or with 0.

    Args:
        case: The nominal case.
        searched: The searched case.
        simulator: In place of the scenario's.

    Raises:
        ConfigurationError: If the simulator refuses one of the worlds.
    """
    nominal = Nominal.of(case, simulator)
    world = nominal.checked(searched.scenario.world)
    changes = [
        _reduced(nominal, world, difference)
        for difference in _differences(world, nominal.world, ())
    ]
    changes += _fault_changes(nominal, [fault.plain() for fault in searched.faults])
    seed = searched.scenario.seed or 0
    if seed != nominal.seed:
        changes.append(ParameterChange("seed", seed, nominal.seed))
    return tuple(changes)


def count_parameters(changes: Iterable[ParameterChange]) -> int:
    """Count the parameters that differ.

    A change of a value counts one, as does the type of an added fault. An added entry counts the
    values that are not at their defaults, without its ``id``. A part that was left out counts none.
    """
    return sum(_size(change) for change in changes)


def _size(change: ParameterChange) -> int:
    if isinstance(change.nominal, Mapping) and change.value is None:
        return 0
    return max(_leaves(change.value), 1)


def _leaves(value: Any) -> int:
    if isinstance(value, Mapping):
        return sum(_leaves(inner) for key, inner in value.items() if key != "id")
    return sum(map(_leaves, value)) if _is_list(value) else 1


def _fault_changes(
    nominal: Nominal, faults: Iterable[Mapping[str, Any]]
) -> Iterator[ParameterChange]:
    removed = {fault.id: fault.plain() for fault in nominal.case.faults}
    for fault in faults:
        compared, own = nominal.fault(fault)
        nominal_fault = compared.plain()
        path = f"faults.{fault['id']}"
        if own:
            del removed[fault["id"]]
        else:
            yield ParameterChange(path, fault["type"], None)
        for key in [key for key in fault if key not in _NOT_PARAMETERS]:
            for keys, value, plain, _ in _differences(fault[key], nominal_fault.get(key), (key,)):
                name = f"{path}.{_dotted_path(keys)}"
                unit = input_unit(nominal.case.scenario, name, fault["type"])
                yield ParameterChange(name, _or_none(value), _or_none(plain), unit)
    for name, fault in removed.items():
        yield ParameterChange(f"faults.{name}", None, fault)


Difference = tuple[Keys, Any, Any, Keys]
"""Name, value, nominal value, and the keys of the value in the data."""


def _differences(value: Any, nominal: Any, name: Keys, place: Keys = ()) -> Iterator[Difference]:
    if isinstance(value, Mapping) and isinstance(nominal, Mapping):
        for key in dict.fromkeys([*nominal, *value]):
            yield from _differences(
                value.get(key, ABSENT),
                nominal.get(key, ABSENT),
                (*name, key),
                (*place, key),
            )
    elif _has_entries(value, nominal) and _is_list(value) and _is_list(nominal):
        for entry_name, index, other in _match_entries(value, nominal):
            entry = ABSENT if index is None else value[index]
            entry_place = (*place, index if index is not None else -1)
            yield from _differences(entry, other, (*name, entry_name), entry_place)
    elif _is_list(value) and _is_list(nominal) and len(value) == len(nominal):
        for i, (entry, other) in enumerate(zip(value, nominal, strict=True)):
            yield from _differences(entry, other, (*name, i), (*place, i))
    elif value != nominal:
        yield name, value, nominal, place


def _reduced(nominal: Nominal, world: Mapping[str, Any], difference: Difference) -> ParameterChange:
    """Drop what an added entry leaves at its default."""
    name, value, plain, place = difference
    if isinstance(value, Mapping) and _or_none(plain) is None:
        value = {
            key: inner
            for key, inner in value.items()
            if key == "id" or nominal.default(world, (*place, key)) != inner
        }
    path = f"world.{_dotted_path(name)}"
    unit = input_unit(nominal.case.scenario, path)
    return ParameterChange(path, _or_none(value), _or_none(plain), unit)


def _or_none(value: Any) -> Any:
    return None if value is ABSENT else value


Values = tuple[Any, ...]

_TINY = 1e-6
"""Numbers below it are not made simpler: they would become smaller without end."""


def simpler_values(value: Any, nominal: Any, limits: tuple[float, float] | None = None) -> Values:
    """List values from the simplest to a given one.

    Args:
        value: The given value; plain data.
        nominal: The simplest value.
        limits: What the case allows where rounding leads past the given value; ``None`` where
            nothing is declared.
    """
    if not (_is_number(value) and _is_number(nominal)):
        return _unique([nominal, value])
    if value == nominal:
        return (value,)
    if max(abs(value), abs(nominal)) < _TINY:
        return (nominal, value)
    low, high = (-math.inf, math.inf) if limits is None else limits
    nearer = [
        number for number, past in _nearer(value, nominal) if not past or low <= number <= high
    ]
    if isinstance(value, int) and isinstance(nominal, int):
        nearer = [int(number) for number in nearer if number == int(number)]
    return _unique([nominal, *nearer, value])


def rounded_values(value: Any) -> Values:
    """List a number with one to three digits, and as it is; anything else alone."""
    if not _is_number(value) or value == 0:
        return (value,)
    exponent = math.floor(math.log10(abs(value)))
    rounded = [type(value)(round(float(value), places - exponent)) for places in range(3)]
    return _unique([*rounded, value])


def _nearer(value: float, nominal: float) -> Iterator[tuple[float, bool]]:
    """Numbers between the two, ever finer ones next to the value, and whether each is past it."""
    exponent = math.floor(math.log10(max(abs(value), abs(nominal))))
    last, sign = nominal, 1 if value > nominal else -1
    for parts in (2, 10, 100):
        step = 10.0**exponent / parts
        count = math.floor(sign * last / step + 1e-9)
        while sign * (number := round(sign * (count + 1) * step, 2 - exponent)) < sign * value:
            if number != last:
                yield number, False
            last, count = number, count + 1
        if number == value:
            return
        if parts > 2:
            yield number, True


def _is_number(value: Any) -> bool:
    plain = isinstance(value, (int, float)) and not isinstance(value, bool)
    return plain and math.isfinite(value)


def _unique(values: Iterable[Any]) -> Values:
    unique: list[Any] = []
    for value in values:
        if not any(type(value) is type(known) and value == known for known in unique):
            unique.append(value)
    return tuple(unique)


_RANKS = ("fault", "entry", "part", "begin", "duration", "strength", "world", "seed")
_TIMES: dict[Keys, str] = {("activation", "at"): "begin", ("duration",): "duration"}


@dataclass(frozen=True)
class Knob:
    """A part of a case that can be made simpler.

    Args:
        rank: Its kind, one of ``_RANKS``, which stand in the order of preference.
        keys: Where it is: ``("world", ...)``, ``("faults", 0, ...)`` or ``("seed",)``.
        values: From the simplest to that of the case; ``ABSENT`` leaves the part out.
    """

    rank: str
    keys: Keys
    values: Values


@dataclass(frozen=True)
class Simplification:
    """The parts of a searched case that can be made simpler.

    Args:
        nominal: The case that it is compared with.
        case: The searched case.
    """

    nominal: Nominal
    case: SearchedCase

    @cached_property
    def data(self) -> dict[str, Any]:
        """World, faults and seed of the case."""
        scenario = self.case.scenario
        return {
            "world": self.nominal.checked(scenario.world),
            "faults": [fault.plain() for fault in self.case.faults],
            "seed": scenario.seed or 0,
        }

    @cached_property
    def knobs(self) -> tuple[Knob, ...]:
        """Everything that can be made simpler, in the order of preference."""
        knobs = [knob for i in range(len(self.case.faults)) for knob in self._fault(i)]
        knobs += self._inside(self.data["world"], self.nominal.world, ())
        knobs.append(Knob("seed", ("seed",), _unique((self.nominal.seed, self.data["seed"]))))
        knobs = [knob for knob in knobs if len(knob.values) > 1]
        return tuple(sorted(knobs, key=lambda knob: _RANKS.index(knob.rank)))

    def case_at(self, places: Sequence[int]) -> SearchedCase:
        """Make the case in which each knob has the value at a place of its values.

        Raises:
            ConfigurationError: If the values contradict each other.
        """
        edits = [
            (knob.keys, knob.values[place])
            for knob, place in zip(self.knobs, places, strict=True)
            if place < len(knob.values) - 1
        ]
        data = with_values(self.data, edits)
        world = self.nominal.checked(data["world"])
        return make_searched_case(self.nominal.case, world, data["faults"], data["seed"])

    def _fault(self, index: int) -> Iterator[Knob]:
        fault = self.data["faults"][index]
        place: Keys = ("faults", index)
        yield Knob("fault", place, (ABSENT, fault))
        compared, own = self.nominal.fault(fault)
        nominal_fault = compared.plain()
        spans = spans_in(self.nominal.case.scenario, fault)
        for key in fault:
            if key in _NOT_PARAMETERS:
                continue
            for keys, value, plain in _values(fault[key], nominal_fault.get(key), (key,)):
                rank = _TIMES.get(keys, "strength")
                if own or isinstance(plain, str) or plain is None:
                    path = f"faults.{fault['id']}.{_dotted_path(keys)}"
                    yield Knob(rank, (*place, *keys), self._declared(value, plain, path))
                else:
                    values = self._weaker(rank, keys, value, plain, spans)
                    yield Knob(rank, (*place, *keys), values)

    def _weaker(
        self, rank: str, keys: Keys, value: Any, plain: Any, spans: Mapping[str, Span | Choices]
    ) -> Values:
        """List values of an added fault: later, shorter, of less effect."""
        scenario = self.nominal.case.scenario
        last = scenario.lasts - scenario.time_step
        if rank == "begin":
            # A fault that begins with the last tick has no effect: it is left out instead.
            return simpler_values(value, last, (0.0, last))[1:]
        if rank == "duration":
            return simpler_values(value, scenario.time_step, (scenario.time_step, scenario.lasts))
        span = spans.get(_dotted_path(keys))
        if isinstance(span, Span) and isinstance(value, (int, float)):
            return simpler_values(value, type(value)(span.neutral), (span.low, span.high))
        return simpler_values(value, span.values[0] if isinstance(span, Choices) else plain)

    def _inside(
        self, value: Any, nominal: Any, keys: Keys, *, added: bool = False
    ) -> Iterator[Knob]:
        """Yield the knobs of a part of the world."""
        spread = self._spread(f"world.{_dotted_path(keys)}")
        if isinstance(spread, Choice) and not _has_entries(value):
            yield Knob("world", ("world", *keys), self._choices(value, nominal, keys, spread))
        elif isinstance(value, Mapping):
            yield from self._mapping(value, nominal, keys, added)
        elif _has_entries(value):
            for _, index, other in _match_entries(value, nominal):
                if index is not None:
                    place: Keys = (*keys, index)
                    yield Knob("entry", ("world", *place), (ABSENT, value[index]))
                    yield from self._inside(value[index], other, place, added=other is ABSENT)
        elif _is_list(value) and (
            not _is_list(nominal) or len(value) == len(nominal) or isinstance(spread, Range)
        ):
            plain = nominal if _is_list(nominal) else [nominal] * len(value)
            plain = plain if len(plain) == len(value) else [None] * len(value)
            for i, (number, other) in enumerate(zip(value, plain, strict=True)):
                yield from self._inside(number, other, (*keys, i), added=added)
        elif value != nominal and not _left_out(value, nominal):
            yield Knob("world", ("world", *keys), self._world_values(value, nominal, keys, added))

    def _mapping(
        self, value: Mapping[str, Any], nominal: Any, keys: Keys, added: bool
    ) -> Iterator[Knob]:
        world = self.data["world"]
        if keys and isinstance(keys[-1], str) and self.nominal.may_be_none(world, keys):
            yield Knob("part", ("world", *keys), (None, value))
        for key in value:
            if not (added and key == "id"):
                other = value_at(nominal, (key,))
                yield from self._inside(value[key], other, (*keys, key), added=added)

    def _world_values(self, value: Any, nominal: Any, keys: Keys, added: bool) -> Values:
        path = f"world.{_dotted_path(keys)}"
        if added:
            nominal = self.nominal.default(self.data["world"], keys)
            if nominal is _REQUIRED:
                return rounded_values(value)
            if nominal is ABSENT:
                return (ABSENT, *rounded_values(value))
        if nominal is ABSENT or nominal is None:
            # An input that the scenario does not have: the nearer to zero, the simpler.
            nominal = type(value)(0) if isinstance(value, (int, float)) else nominal
        return self._declared(value, nominal, path)

    def _declared(self, value: Any, nominal: Any, path: str) -> Values:
        """List simpler values; where the scenario varies the path, only those that it may draw."""
        spread = self._spread(path)
        if isinstance(spread, Choice):
            return _before(value, nominal, spread.choice)
        if spread is None:
            return simpler_values(value, nominal)
        if isinstance(nominal, (int, float)):
            nominal = min(max(nominal, spread.min), spread.max)
        return simpler_values(value, nominal, (spread.min, spread.max))

    def _choices(self, value: Any, nominal: Any, keys: Keys, spread: Choice) -> Values:
        """List the choices for a part of the world, defaults filled in as in the value."""
        world, choices = self.data["world"], []
        for choice in spread.choice:
            with suppress(ConfigurationError):
                choices.append(
                    value_at(self.nominal.checked(with_value(world, keys, choice)), keys)
                )
        return _before(value, nominal, choices)

    def _spread(self, path: str) -> Range | Choice | None:
        """Return the variation of a path, or of the list that it is a number of."""
        declared = self.nominal.case.scenario.variation
        outer = declared.get(path.rpartition(".")[0])
        return declared.get(path) or (outer if isinstance(outer, Range) else None)


def _values(value: Any, nominal: Any, keys: Keys) -> Iterator[tuple[Keys, Any, Any]]:
    """Yield what differs, value by value: keys, value, nominal value."""
    if (
        isinstance(value, Mapping)
        and isinstance(nominal, Mapping)
        and value.keys() == nominal.keys()
    ):
        for key in value:
            yield from _values(value[key], nominal[key], (*keys, key))
    elif value != nominal:
        yield keys, value, nominal


def _before(value: Any, nominal: Any, choices: Sequence[Any]) -> Values:
    """Put the nominal value first, if it is one of them, then the others up to the value."""
    ordered = [choice for choice in choices if choice == nominal]
    ordered += [choice for choice in choices if choice != nominal]
    return (*takewhile(lambda choice: choice != value, ordered), value)


def _left_out(value: Any, nominal: Any) -> bool:
    """Whether nothing is left of a part of the nominal case: then it stays left out."""
    part = isinstance(nominal, Mapping) or _has_entries(nominal)
    return part and (value is None or (_is_list(value) and not value))
