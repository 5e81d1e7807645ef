"""The faults of a case: parsed for the scenario's domain, and checked against each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pytest_dura.campaign.domains import domain_of
from pytest_dura.campaign.problems import did_you_mean, placed
from pytest_dura.campaign.scenario import Scenario
from pytest_dura.campaign.worlds import channel_kinds, fault_targets
from pytest_dura.core.errors import ConfigurationError


def parsed(scenario: Scenario, data: Mapping[str, Any]) -> dict[str, Any]:
    """A fault as plain data, with the defaults of its type and of the scenario's domain.

    Raises:
        ConfigurationError: If the catalogue refuses it, or the domain has no such target.
    """
    from pytest_dura.faults.catalogue import load_fault, parse_fault
    from pytest_dura.faults.channels import check_condition_targets, check_target
    from pytest_dura.faults.conditions import parse_condition
    from pytest_dura.faults.duration import Until

    domain = domain_of(scenario.simulator.path)
    filled = parse_fault(data, fault_targets(domain))
    fault, channels = load_fault(filled), channel_kinds(domain)
    if channels is not None:
        check_target(fault, channels)
        if fault.activation.when is not None:
            targets = parse_condition(fault.activation.when).targets
            check_condition_targets(targets, channels, "activation.when")
        if isinstance(fault.duration, Until):
            targets = parse_condition(fault.duration.until).targets
            check_condition_targets(targets, channels, "duration.until")
    earliest = fault.activation.at
    earliest = fault.activation.not_before if earliest is None else earliest
    if earliest >= scenario.duration:
        raise ConfigurationError(
            f"the fault {fault.id!r} can only begin at {earliest:g} s, when the episode is over",
            key="activation.at" if fault.activation.at is not None else "activation.not_before",
            found=earliest,
            expected=f"less than the scenario's duration of {scenario.duration:g} s",
            remedy="let it begin earlier, or make the scenario longer",
        )
    return filled


def own_fault(scenario: Scenario, index: int) -> dict[str, Any]:
    """One of the scenario's own faults; see :func:`parsed`.

    Raises:
        ConfigurationError: At its place in the file.
    """
    data = scenario.faults[index].model_dump(mode="json", exclude_unset=True)
    data = {key: value for key, value in data.items() if value is not None or key == "duration"}
    try:
        return parsed(scenario, data)
    except ConfigurationError as error:
        key = f"faults.{index}.{error.key}" if error.key else f"faults.{index}"
        raise placed(error, file=scenario.file, line=scenario.line_of(key), key=key) from None


def check_chains(faults: Sequence[Mapping[str, Any]]) -> None:
    """Refuse faults that wait for one that is not there, or for each other.

    Raises:
        ConfigurationError: With the key ``<index>.activation.after.fault``.
    """
    waits = {
        fault["id"]: after["fault"]
        for fault in faults
        if (after := fault["activation"].get("after")) is not None
    }
    ids = [fault["id"] for fault in faults]
    for index, fault in enumerate(faults):
        first = waits.get(fault["id"])
        key = f"{index}.activation.after.fault"
        if first is not None and first not in ids:
            raise ConfigurationError(
                f"the fault {fault['id']!r} waits for {first!r}, which is not planned with it",
                key=key,
                found=first,
                expected="one of " + ", ".join(one for one in ids if one != fault["id"]),
                remedy=did_you_mean(first, ids),
            )
        path = [fault["id"]]
        while path[-1] in waits and waits[path[-1]] not in path:
            path.append(waits[path[-1]])
        if waits.get(path[-1]) == fault["id"]:
            circle = " -> ".join([*path, fault["id"]])
            raise ConfigurationError(
                f"these faults wait for each other for ever: {circle}",
                key=key,
                found=first,
                expected="a fault that something else activates",
                remedy="give one of them a time, `at`",
            )
