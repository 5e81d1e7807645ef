"""SearchSpace: the parameters of a case as coordinates in [0, 1], and which of it was covered."""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.fault import Fault
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.domains import unit_in
from pytest_dura.faults.catalogue import FAULT_TYPES, fault_class
from pytest_dura.faults.parts import Choices, spans_of
from pytest_dura.library.cases import Case, SearchedCase, make_searched_case
from pytest_dura.library.fault_campaigns import FaultCampaign, Faults, expand_campaign
from pytest_dura.library.planned_faults import example_fault, parse_scenario_fault, spans_in
from pytest_dura.library.scenario import (
    Choice,
    Range,
    Scenario,
    check_world,
    replace_value,
    split_path,
)
from pytest_dura.requirements.searches import SpaceCoverage

STEPS = 1000
"""Least number of grid steps in an interval."""


def digits_of(low: float, high: float) -> int:
    """Return the decimal places (negative: before the point) of the grid over an interval."""
    span = high - low
    if span <= 0.0 or not math.isfinite(span):
        return 0
    return -math.floor(math.log10(span / STEPS) + 1e-9)


def on_grid(value: float, low: float, high: float) -> float:
    """Round a number to the grid over an interval, within the interval."""
    rounded = round(value, digits_of(low, high))
    # The ends belong to the grid, whatever their digits.
    return float(min(max(rounded, low), high))


@dataclass(frozen=True, slots=True)
class Group:
    """Coordinates that belong together, each in [0, 1].

    Args:
        name: Name of the parameter, for reports.
        size: 1 for a single value; more for an input over time, one coordinate per piece, in the
            order of time.
        options: Number of unordered values to choose from; 0 for an interval.
    """

    name: str
    size: int = 1
    options: int = 0


@dataclass(frozen=True)
class Layout:
    """The groups of a search point, one after the other."""

    groups: tuple[Group, ...]

    @cached_property
    def size(self) -> int:
        """Coordinates of a point."""
        return sum(group.size for group in self.groups)

    def slices(self) -> Iterator[tuple[Group, slice]]:
        """Yield each group with the slice of its coordinates."""
        ends = itertools.accumulate(group.size for group in self.groups)
        for group, end in zip(self.groups, ends, strict=True):
            yield group, slice(end - group.size, end)


_PARTS = 10
"""Parts of a coordinate's range."""
_PAIR_PARTS = 5
"""Parts of each coordinate's range where pairs of coordinates are counted."""


class CoverageCount:
    """Counts which parts of a search space have points; memory does not grow with them.

    Args:
        layout: What the coordinates mean.
    """

    def __init__(self, layout: Layout) -> None:
        owners = [group for group in layout.groups for _ in range(group.size)]
        self._layout = layout
        self._parts = np.array([group.options or _PARTS for group in owners])
        self._coarse = np.array([group.options or _PAIR_PARTS for group in owners])
        self._hit = [np.zeros(parts, bool) for parts in self._parts]
        # The parts of all coordinates one after the other: a table of each with each.
        self._first = np.cumsum(self._coarse) - self._coarse
        self._pairs = np.zeros((self._coarse.sum(),) * 2, bool)

    def add(self, point: NDArray[np.float64]) -> None:
        """Count a simulated point, coordinates in [0, 1]."""
        fine, coarse = _parts_of(point, self._parts), _parts_of(point, self._coarse)
        for hit, part in zip(self._hit, fine, strict=True):
            hit[part] = True
        places = self._first + coarse
        self._pairs[np.ix_(places, places)] = True

    def coverage(self) -> SpaceCoverage:
        """Return the shares that are covered by now."""
        shares = {
            group.name: float(np.mean([self._hit[i].mean() for i in range(*where.indices(10**9))]))
            for group, where in self._layout.slices()
        }
        blocks = np.add.reduceat(self._pairs, self._first, axis=0, dtype=float)
        blocks = np.add.reduceat(blocks, self._first, axis=1)
        blocks /= np.outer(self._coarse, self._coarse)
        pairs = blocks[np.triu_indices(len(blocks), 1)]
        return SpaceCoverage(shares, float(pairs.mean()) if len(pairs) else None)


def _parts_of(point: NDArray[np.float64], parts: NDArray[np.int_]) -> NDArray[np.int_]:
    indices: NDArray[np.int_] = (np.asarray(point) * parts).astype(int)
    return np.clip(indices, 0, parts - 1)


Data = Mapping[str, Any]


class Parameter(ABC):
    """A value of a case, or a fault, that a search chooses.

    ``path`` names it, such as ``world.ego.speed`` or ``faults.search-1``.
    """

    path: str

    @property
    @abstractmethod
    def groups(self) -> tuple[Group, ...]:
        """The groups of coordinates that its value is decoded from."""

    @abstractmethod
    def value(self, coordinates: Sequence[float]) -> Any:
        """Decode the coordinates of all groups, one after the other, to plain data."""


@dataclass(frozen=True)
class Interval(Parameter):
    """A number between two others, on a grid that people can read; or a list of such numbers.

    Args:
        path: Its name.
        low: Least value.
        high: Greatest value.
        nominal: The simplest value.
        pieces: Numbers of the list; ``None`` for a single number.
        unit: Of the numbers; empty where none is declared.
    """

    path: str
    low: float
    high: float
    nominal: Any = None
    pieces: int | None = None
    unit: str = ""

    @property
    def groups(self) -> tuple[Group, ...]:
        """One group, with a coordinate for each piece."""
        return (Group(self.path, self.pieces or 1),)

    def value(self, coordinates: Sequence[float]) -> Any:
        """Map 0 to ``low`` and 1 to ``high``."""
        values = [
            on_grid(self.low + float(coordinate) * (self.high - self.low), self.low, self.high)
            for coordinate in coordinates
        ]
        return values[0] if self.pieces is None else values


@dataclass(frozen=True)
class OneOf(Parameter):
    """One of several values.

    Args:
        path: Its name.
        values: The values.
        nominal: The simplest value.
        unit: Of numbers among them; empty where none is declared.
    """

    path: str
    values: tuple[Any, ...]
    nominal: Any = None
    unit: str = ""

    @property
    def groups(self) -> tuple[Group, ...]:
        """One group of one coordinate."""
        return (Group(self.path, options=len(self.values)),)

    def value(self, coordinates: Sequence[float]) -> Any:
        """Map equal parts of [0, 1] to the values."""
        return self.values[_part(coordinates[0], len(self.values))]


@dataclass(frozen=True)
class FaultChoice:
    """A fault that may be added to a case, and its parameters.

    Args:
        fault: The fault, defaults filled in.
        inner: Its parameters; their paths are within the fault, such as ``activation.at``.
    """

    fault: Fault
    inner: tuple[Parameter, ...]

    def fault_with(self, values: Data) -> dict[str, Any]:
        """Return the fault as plain data, with values of its parameters by path."""
        fault: Any = self.fault.plain()
        for path in (parameter.path for parameter in self.inner if parameter.path in values):
            fault = replace_value(fault, path, values[path], create=True)
        return dict(fault)


@dataclass(frozen=True)
class FaultSlot(Parameter):
    """A fault that may be added: none, or one of several, each with parameters of its own.

    The parameters of all choices share coordinates, the first of each with the first of another.

    Args:
        path: Its name.
        choices: The faults.
    """

    path: str
    choices: tuple[FaultChoice, ...]

    @property
    def groups(self) -> tuple[Group, ...]:
        """One group for the choice, then as many as the fault with the most parameters has."""
        most = max((_size(choice) for choice in self.choices), default=0)
        inner = tuple(Group(f"{self.path}.{number}") for number in range(1, most + 1))
        return (Group(self.path, options=len(self.choices) + 1), *inner)

    def value(self, coordinates: Sequence[float]) -> Any:
        """Decode a fault as plain data; ``None`` in the first part of the first coordinate."""
        which = _part(coordinates[0], len(self.choices) + 1)
        if which == 0:
            return None
        choice, rest, values = self.choices[which - 1], list(coordinates[1:]), {}
        for parameter in choice.inner:
            size = sum(group.size for group in parameter.groups)
            values[parameter.path] = parameter.value(rest[:size])
            rest = rest[size:]
        return choice.fault_with(values)


def _parameter_of(path: str, spread: Range | Choice, nominal: Any, unit: str) -> Parameter:
    if isinstance(spread, Range):
        return Interval(path, spread.min, spread.max, nominal, spread.pieces, unit)
    return OneOf(path, spread.choice, nominal, unit)


def input_unit(scenario: Scenario, path: str, fault_type: str = "") -> str:
    """Find the unit of an input; empty where none is declared.

    The scenario's ``variation`` states it, or else the domain's world, or the type of the fault.

    Args:
        scenario: The scenario.
        path: Such as ``world.ego.speed``, or ``faults.delay.activation.at``.
        fault_type: Of a path in a fault.
    """
    spread = scenario.variation.get(path)
    if isinstance(spread, Range) and spread.unit:
        return spread.unit
    if path.startswith("world."):
        system = scenario.system
        return "" if system is None else unit_in(system.world, path.removeprefix("world."))
    inner = path.split(".", 2)[-1]
    if inner in _IN_SECONDS:
        return "s"
    spans = spans_of(fault_class(fault_type)) if fault_type else {}
    return spans[inner].unit if inner in spans else ""


_IN_SECONDS = ("activation.at", "duration")
"""Keys of every fault."""


def _size(choice: FaultChoice) -> int:
    return sum(group.size for parameter in choice.inner for group in parameter.groups)


def _part(coordinate: float, parts: int) -> int:
    return min(max(int(float(coordinate) * parts), 0), parts - 1)


_MAX_DURATION_SHARE = 0.5
"""Longest duration of an added fault, as a share of the time in which faults begin."""


def _fault_choices(
    scenario: Scenario, faults: Iterable[FaultCampaign], begin_within: float | None = None
) -> tuple[FaultChoice, ...]:
    """Make a choice of each of these faults.

    Args:
        scenario: To whose domain and duration the faults belong.
        faults: Names of the catalogue or of the scenario's own faults, globs, ``catalogue``, and
            faults as data; see :mod:`pytest_dura.library.fault_campaigns`.
        begin_within: Simulated seconds within which they begin; by default all of the scenario's.

    Raises:
        ConfigurationError: For an unknown fault, one that cannot be used, and a campaign that
            combines several.
    """
    own: Faults = tuple(
        parse_scenario_fault(scenario, index) for index in range(len(scenario.faults))
    )
    begin_within = scenario.lasts if begin_within is None else begin_within
    choices: dict[str, FaultChoice] = {}
    for entry in faults:
        for planned in _planned(scenario, own, entry):
            if len(planned) > 1:
                raise ConfigurationError(
                    "a search adds faults one by one",
                    key="faults",
                    found="+".join(fault.id for fault in planned),
                    expected="single faults, and `at_most` for how many may act together",
                    remedy="name each of them as an entry of its own",
                )
            for fault in planned:
                given = entry if isinstance(entry, Mapping) else {}
                choice = FaultChoice(fault, tuple(_inner(scenario, begin_within, fault, given)))
                _add(choices, choice)
    return tuple(choices.values())


def _planned(scenario: Scenario, own: Faults, entry: FaultCampaign) -> Sequence[Faults]:
    """List the faults of an entry; a fault as data need not say when it acts, which is searched."""
    if isinstance(entry, Mapping) and "activation" not in entry:
        kind, given = entry.get("type"), entry.get("parameters", {})
        if isinstance(kind, str) and kind in FAULT_TYPES and isinstance(given, Mapping):
            return [(example_fault(scenario, kind, entry),)]
    return expand_campaign(scenario, own, entry)


def _add(choices: dict[str, FaultChoice], choice: FaultChoice) -> None:
    """Add a choice once; a number behind the id tells other faults of the same id apart."""
    for name in _ids(choice.fault.id):
        named = replace(choice, fault=replace(choice.fault, id=name))
        if choices.setdefault(name, named) == named:
            return


def _ids(name: str) -> Iterator[str]:
    """Yield the id of a fault, then names that are made of it."""
    yield name
    for number in itertools.count(2):
        yield f"{name.replace(':', '-').replace('.', '-')}-{number}"


def _inner(
    scenario: Scenario, begin_within: float, fault: Fault, given: Mapping[str, Any]
) -> Iterable[Parameter]:
    """Yield a fault's parameters that the user did not fix, in the order of simplification."""
    step, longest = scenario.time_step, None
    latest = max(begin_within - step, step)
    if fault.planned_at is not None and "activation" not in given:
        yield Interval("activation.at", 0.0, latest, latest, unit="s")
    if isinstance(fault.duration, (int, float)) and "duration" not in given:
        longest = max(_MAX_DURATION_SHARE * begin_within, 2 * step)
        yield Interval("duration", step, longest, step, unit="s")
    fixed = given.get("parameters", {})
    for path, span in spans_in(scenario, fault.plain(), longest).items():
        if path.rpartition(".")[2] in fixed:
            continue
        if isinstance(span, Choices):
            yield OneOf(path, span.values, span.values[0], span.unit)
        else:
            yield Interval(path, span.low, span.high, span.neutral, unit=span.unit)


SLOT = "faults.search-"
"""Path of a fault that a search adds, before its number."""


@dataclass(frozen=True)
class SearchSpace:
    """The parameters of a case that a search chooses.

    Args:
        case: The case.
        parameters: The parameters.
        world: The scenario's world, defaults filled in.
    """

    case: Case
    parameters: tuple[Parameter, ...]
    world: Mapping[str, Any]

    @classmethod
    def of(
        cls,
        case: Case,
        faults: Sequence[FaultCampaign] = (),
        *,
        at_most: int = 1,
        simulator: RoleSpec | None = None,
        begin_within: float | None = None,
    ) -> SearchSpace:
        """Take what the case's scenario varies, and faults that may be added.

        Args:
            case: The case.
            faults: Faults that may be added to those of the case; see :func:`_fault_choices`.
            at_most: How many of them may act together.
            simulator: In place of the scenario's.
            begin_within: Simulated seconds within which added faults begin; by default all of the
                scenario's duration.

        Raises:
            ConfigurationError: For faults that cannot be used, and if nothing may differ.
        """
        scenario = case.scenario
        simulator = simulator or scenario.simulator_spec()
        world = check_world(scenario, simulator, scenario.world)
        planned = {fault.id: fault.plain() for fault in case.faults}
        parameters: list[Parameter] = []
        for path, spread in scenario.variation.items():
            fault, inner = split_path(path)
            if not fault or fault in planned:
                nominal = _nominal(planned[fault] if fault else world, inner)
                unit = input_unit(scenario, path, planned[fault]["type"] if fault else "")
                parameters.append(_parameter_of(path, spread, nominal, unit))
        choices = _fault_choices(scenario, faults, begin_within)
        if choices:
            parameters += [
                FaultSlot(f"{SLOT}{number}", choices) for number in range(1, at_most + 1)
            ]
        if not parameters:
            raise ConfigurationError(
                f"there is nothing to search in the case {case.id!r}",
                file=scenario.file or None,
                key="variation",
                expected="a scenario with `variation`, or faults that may be added",
                remedy="declare what may differ under `variation`, or name `faults`",
            )
        return cls(case, tuple(parameters), world)

    @cached_property
    def layout(self) -> Layout:
        """What the coordinates of a point mean."""
        return Layout(tuple(group for parameter in self.parameters for group in parameter.groups))

    def values(self, point: Sequence[float] | NDArray[np.float64]) -> dict[str, Any]:
        """Decode a point to values by the names of the parameters; plain data.

        Args:
            point: Coordinates in [0, 1], shape ``(layout.size,)``.
        """
        values, start = {}, 0
        for parameter in self.parameters:
            end = start + sum(group.size for group in parameter.groups)
            values[parameter.path] = parameter.value([float(value) for value in point[start:end]])
            start = end
        return values

    def case_with(self, values: Mapping[str, Any], seed: int) -> SearchedCase:
        """Make the case with these values.

        Args:
            values: By the names of the parameters; one that is left out stays as the case has it.
            seed: Of the episode.

        Raises:
            ConfigurationError: If the values contradict each other.
        """
        world: Any = self.world
        planned: dict[str, Any] = {fault.id: fault.plain() for fault in self.case.faults}
        added: list[dict[str, Any]] = []
        for path, value in values.items():
            if _is_slot(path):
                added += [] if value is None else [dict(value)]
                continue
            name, inner = split_path(path)
            if not name:
                world = replace_value(world, inner, value, create=True)
            else:
                planned[name] = replace_value(planned[name], inner, value)
        for fault in added:
            name = next(name for name in _ids(fault["id"]) if name not in planned)
            planned[name] = {**fault, "id": name}
        return make_searched_case(self.case, world, planned.values(), seed)


def _is_slot(path: str) -> bool:
    """Whether a path names a fault slot, and nothing within a fault of such an id."""
    return path.startswith(SLOT) and "." not in path.removeprefix(SLOT)


def _nominal(data: Any, path: str) -> Any:
    for key in path.split("."):
        if isinstance(data, Mapping) and key in data:
            data = data[key]
        elif isinstance(data, (list, tuple)) and key.isdecimal() and int(key) < len(data):
            data = data[int(key)]
        else:
            return None
    return data
