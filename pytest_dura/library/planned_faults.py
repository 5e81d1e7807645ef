"""Parse the faults of a case for the scenario's domain, and check them together."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pytest_dura.core.episode import Termination
from pytest_dura.core.errors import ConfigurationError, did_you_mean, error_at
from pytest_dura.core.fault import Fault
from pytest_dura.core.percepts import NOTHING
from pytest_dura.core.trust import check_registered
from pytest_dura.faults.activation import TOLERANCE, Until
from pytest_dura.faults.catalogue import FaultForm, fault_class, fault_form
from pytest_dura.faults.conditions import by_channels, parse_condition
from pytest_dura.faults.model import (
    Channel,
    FaultEffect,
    check_condition_targets,
    check_target,
    with_proposal,
)
from pytest_dura.faults.parts import (
    PARAMETERS,
    PROPOSAL,
    Choices,
    Span,
    Suited,
    Target,
    spans_of,
)
from pytest_dura.library.scenario import Scenario, channel_aliases

_RESERVED = ("none", "catalogue")
"""Names of fault campaigns, which no fault may have."""
_MAX_ID = 200
"""Characters of an id, which is part of the names of tests and of commands."""
_MISREAD = re.compile(r"[+~#*?\[]|::")


_PARTS = ("activation", "duration", PARAMETERS)
"""Keys of a fault whose values many faults of a grid share."""
_MAX_PARTS = 10_000


@dataclass(frozen=True, slots=True)
class ReadPart:
    """One of the parts of a fault that was read without an error."""

    plain: Any
    """The same object in all faults that have this part: nothing writes into plain faults."""
    effect: FaultEffect
    by_chance: bool
    """Whether the activation of that fault is by chance."""


@dataclass(frozen=True, slots=True)
class ReadFault:
    """A fault that was read, of which others are made that share some of its parts."""

    fault: Fault
    channel: Channel | None
    parts: Mapping[str, ReadPart]

    def combined(self, name: str, parts: Mapping[str, ReadPart]) -> Fault:
        """Make a fault of the same type and target with parts of other faults of that type.

        A part that is valid in one fault is so in each: of a grid on activations and parameters
        each of either is validated once, and not each pair of them.

        Args:
            name: Its id.
            parts: Those that differ from this fault's.
        """
        own = {**self.parts, **parts}
        activation, effect = own["activation"], own[PARAMETERS].effect
        fault = Fault(
            self.fault.type,
            name,
            self.fault.target,
            activation.plain,
            own["duration"].plain,
            own[PARAMETERS].plain,
            activation.by_chance or effect.hits_by_chance,
        )
        if self.channel is not None:
            effect.check_parameters(fault, self.channel)
        _check_id(name)
        return fault


class FaultReader:
    """Reads faults of a scenario; what its domain allows is looked up once for all of them.

    Args:
        scenario: Gives the domain and the duration.
    """

    def __init__(self, scenario: Scenario) -> None:
        domain = scenario.system
        try:
            self._aliases = channel_aliases(scenario)
        except ConfigurationError:  # an error of the scenario's simulator, reported as that
            self._aliases = {}
        self._targets = {} if domain is None else domain.fault_targets
        self._channels = None if domain is None else domain.channels
        last = Termination(scenario.lasts).last_index(scenario.time_step) - 1
        self._duration, self._end = scenario.lasts, last * scenario.time_step
        self._step = scenario.time_step
        self._classes: dict[str, type[FaultEffect]] = {}
        self._parts: dict[tuple[Any, str, str], Any] = {}
        """Validated parts, by the type of the fault, the key, and what was given."""
        self._places: dict[tuple[str, str], Channel] = {}
        """The channels of types and targets that fit each other."""
        self._conditions: set[tuple[str, str, bool]] = set()
        """Keys and texts of valid conditions, and whether they may read a proposal."""

    def read(self, data: Mapping[str, Any]) -> Fault:
        """Read a fault, with the defaults of its type and of the domain.

        Channels have their own names in it, also where the fault uses an alias.

        Args:
            data: The fault.

        Raises:
            ConfigurationError: If the catalogue refuses it, or the domain has no such target.
        """
        return self.read_parts(data).fault

    def read_parts(self, data: Mapping[str, Any]) -> ReadFault:
        """Read a fault as :meth:`read` does, and keep its parts for others."""
        if ":" in str(data.get("type")):
            check_registered(str(data["type"]))
        data = self.by_channels(data)
        suited = {name: each.default for name, each in self.suited(data).items()}
        given = data.get(PARAMETERS, {})
        if suited and isinstance(given, Mapping):
            data = {**data, PARAMETERS: {**suited, **given}}
        form = self._form(data)
        fault, channel = form.fault, None
        if self._channels is not None:
            channel = self._check_place(fault, form.effect, self._channels)
            if form.activation.when is not None:
                known = self._channels
                if form.activation.directed:
                    known = with_proposal(known)
                self._check_condition(form.activation.when, known, "activation.when")
            if isinstance(form.duration, Until):
                self._check_condition(form.duration.until, self._channels, "duration.until")
        _check_id(fault.id)
        self._check_times(form)
        by_chance = form.activation.by_chance
        parts = {key: ReadPart(getattr(fault, key), form.effect, by_chance) for key in _PARTS}
        return ReadFault(fault, channel, parts)

    def example(self, name: str, given: Mapping[str, Any] = NOTHING) -> Fault:
        """Make the fault that a type's name alone stands for.

        Where a tick is longer than 0.1 s, it begins after twenty and lasts for forty, at most a
        third of the episode.

        Args:
            name: The type.
            given: Keys that differ.

        Raises:
            ConfigurationError: As :meth:`read`.
        """
        data = {"type": name, **fault_class(name).example()}
        third = self._end / 3.0
        begin = max(data["activation"]["at"], min(20 * self._step, third))
        data["activation"] = {**data["activation"], "at": begin}
        if isinstance(data["duration"], (int, float)):
            data["duration"] = max(data["duration"], min(40 * self._step, third))
        data |= given
        suited = self.suited(data)
        typical = data.get(PARAMETERS, {}).items()
        parameters = {key: value for key, value in typical if key not in suited}
        return self.read({**data, PARAMETERS: parameters} if PARAMETERS in data else data)

    def suited(self, data: Mapping[str, Any], seconds: float | None = None) -> Mapping[str, Suited]:
        """Return the parameters that follow from what the target's channel declares.

        Args:
            data: A fault, with each channel under its own name.
            seconds: How long it acts at most, if not its duration.
        """
        kind = self._class_of(data.get("type", ""))
        target = data.get("target", self._targets.get(kind.acts_on, kind.default_target))
        place = Target.parse(target) if isinstance(target, str) else None
        channel = None if place is None else (self._channels or {}).get(place.channel)
        if place is None or channel is None:
            return NOTHING
        lasting = data.get("duration")
        if isinstance(lasting, Mapping):  # drawn: the longest; until a condition: unknown
            lasting = lasting.get("max")
        if seconds is None and isinstance(lasting, (int, float)) and lasting > 0.0:
            seconds = min(lasting, self._duration)
        within = self._duration if seconds is None else seconds
        return kind.suited(channel.quantity(place.field), within)

    def _form(self, data: dict[str, Any]) -> FaultForm:
        """Validate a fault; a part that an earlier fault of its type has is not read again."""
        keys = {part: (data.get("type"), part, repr(data[part])) for part in _PARTS if part in data}
        known = {part: self._parts[key] for part, key in keys.items() if key in self._parts}
        form = fault_form({**data, **known}, self._targets, self._class_of)
        if len(self._parts) < _MAX_PARTS:
            self._parts.update({key: getattr(form, part) for part, key in keys.items()})
        return form

    def by_channels(self, data: Mapping[str, Any]) -> dict[str, Any]:
        """Copy a fault's plain data, with each channel under its own name."""
        return by_channels(data, self._aliases)

    def _class_of(self, name: str) -> type[FaultEffect]:
        """Import the class of a type; a grid has many faults of one."""
        if not isinstance(name, str):
            return fault_class(name)
        if name not in self._classes:
            self._classes[name] = fault_class(name)
        return self._classes[name]

    def _check_place(
        self, fault: Fault, effect: FaultEffect, channels: Mapping[str, Channel]
    ) -> Channel:
        place = fault.type, fault.target
        if place in self._places:
            effect.check_parameters(fault, self._places[place])
        else:
            self._places[place] = check_target(fault, effect, channels)
        return self._places[place]

    def _check_condition(self, text: str, channels: Mapping[str, Channel], key: str) -> None:
        checked = key, text, PROPOSAL in channels
        if checked not in self._conditions:
            check_condition_targets(parse_condition(text).targets, channels, key)
            self._conditions.add(checked)

    def _check_times(self, fault: FaultForm) -> None:
        """Refuse faults that can only begin after the last decision of the episode."""
        activation, end = fault.activation, self._end
        times = {"at": activation.at, "not_before": activation.not_before or None}
        if activation.after is not None:
            times["after.delay"] = activation.after.delay
        for name, time in times.items():
            if time is not None and time > end + TOLERANCE:
                raise ConfigurationError(
                    f"the fault {fault.id!r} can only begin at {time:g} s, when the episode is over"
                    if name != "after.delay"
                    else f"the fault {fault.id!r} waits {time:g} s, longer than the episode",
                    key=f"activation.{name}",
                    found=time,
                    expected=f"at most {end:g} s, the last decision of the scenario's"
                    f" {self._duration:g} s",
                    remedy="let it begin earlier, or make the scenario longer",
                )


def example_fault(scenario: Scenario, name: str, given: Mapping[str, Any] = NOTHING) -> Fault:
    """Make the fault that a type's name stands for; see :meth:`FaultReader.example`."""
    return FaultReader(scenario).example(name, given)


def spans_in(
    scenario: Scenario, fault: Mapping[str, Any], seconds: float | None = None
) -> Mapping[str, Span | Choices]:
    """Map the parameters of a fault that a search may change to the values that suit its target.

    Args:
        scenario: Whose domain declares the target.
        fault: The fault, defaults filled in.
        seconds: How long it acts at most, if not its duration.
    """
    suited = FaultReader(scenario).suited(fault, seconds)
    declared = {f"{PARAMETERS}.{name}": each.span for name, each in suited.items()}
    spans = spans_of(fault_class(fault["type"]))
    return {path: declared.get(path) or span for path, span in spans.items()}


def parse_fault(scenario: Scenario, data: Mapping[str, Any]) -> Fault:
    """Read one fault; see :meth:`FaultReader.read`."""
    return FaultReader(scenario).read(data)


def _check_id(name: str) -> None:
    """Refuse an id that means something else in the id of a case, or on a command line."""
    plain = name.isprintable() and name == name.strip() and len(name) <= _MAX_ID
    misread = _MISREAD.search(name) or name.endswith(".py")
    if name in _RESERVED or misread or not plain:
        raise ConfigurationError(
            f"a fault cannot have the id {name[:_MAX_ID]!r}",
            key="id",
            found=repr(name),
            expected=f"a name other than {' and '.join(_RESERVED)}, without any of + ~ # * ? [ ::,"
            f" of at most {_MAX_ID} printable characters, not ending in .py",
            remedy="give it another `id`",
        )


def parse_scenario_fault(scenario: Scenario, index: int) -> Fault:
    """Read one of the scenario's own faults; see :meth:`FaultReader.read`.

    Raises:
        ConfigurationError: At its place in the file.
    """
    data = scenario.faults[index].model_dump(mode="json", exclude_unset=True)
    data = {key: value for key, value in data.items() if value is not None or key == "duration"}
    try:
        return parse_fault(scenario, data)
    except ConfigurationError as error:
        key = f"faults.{index}.{error.key}" if error.key else f"faults.{index}"
        raise error_at(error, file=scenario.file, line=scenario.line_of(key), key=key) from None


def without_injector(scenario: Scenario, planned_in: str) -> ConfigurationError:
    """Make the error for planned faults that nothing would inject.

    Args:
        scenario: The scenario.
        planned_in: What plans them.
    """
    return ConfigurationError(
        f"{planned_in!r} plans faults, and the fault_injector is switched off",
        file=scenario.file or None,
        line=scenario.line_of("roles.fault_injector"),
        key="roles.fault_injector",
        found="null",
        expected="a fault injector wherever faults are planned",
        remedy="leave the key out for the default one, or plan no faults"
        if "fault_injector" in scenario.roles
        else "remove the fixture `fault_injector` that returns None, or plan no faults",
    )


def check_chains(faults: Sequence[Fault]) -> None:
    """Refuse faults that wait for an event that cannot happen.

    That is: an event of a fault that is not planned, the end of a permanent one, or each other's.

    Raises:
        ConfigurationError: With the key ``faults.<index>.activation.after.fault``, or ``.event``.
    """
    by_id = {fault.id: fault for fault in faults}
    after: Any = {name: fault.activation.get("after") for name, fault in by_id.items()}
    waits = {name: event["fault"] for name, event in after.items() if event is not None}
    for index, name in enumerate(by_id):
        if name not in waits:
            continue
        first, key = waits[name], f"faults.{index}.activation.after"
        if first not in by_id:
            others = [other for other in by_id if other != name]
            suggestion = did_you_mean(first, others) if others else ""
            raise ConfigurationError(
                f"the fault {name!r} waits for {first!r}, which is not planned with it",
                key=f"{key}.fault",
                found=first,
                expected="one of " + ", ".join(others) if others else "another fault beside it",
                remedy=suggestion
                if suggestion.startswith("did")
                else f"plan {first!r} as well, or name both"
                f" where the faults are chosen: {first}+{name}",
            )
        _check_circle(waits, name, f"{key}.fault")
        if after[name]["event"] == "deactivated" and not _can_end(by_id[first]):
            raise ConfigurationError(
                f"the fault {name!r} waits for the end of {first!r}, which has none",
                key=f"{key}.event",
                found="deactivated",
                expected=f"`activated` or `manifested`, since {first!r} is permanent",
                remedy=f"give {first!r} a duration, or wait for another event of it",
            )


def _check_circle(waits: Mapping[str, str], name: str, key: str) -> None:
    path = [name]
    while path[-1] in waits and waits[path[-1]] not in path:
        path.append(waits[path[-1]])
    if waits.get(path[-1]) == name:
        circle = " -> ".join([*path, name])
        raise ConfigurationError(
            f"these faults wait for each other for ever: {circle}"
            if len(path) > 1
            else f"the fault {name!r} waits for itself",
            key=key,
            found=waits[name],
            expected="a fault that something else activates",
            remedy="give one of them a time, `at`" if len(path) > 1 else "give it a time, `at`",
        )


def _can_end(fault: Fault) -> bool:
    """Whether a fault's duration has an end."""
    duration = fault.duration
    if isinstance(duration, Mapping) and "on" in duration:
        return duration.get("lasting") is not None
    return duration is not None
