"""Faults that a search may add to a case: when they begin, how long they last, how strong they are.

A fault of the catalogue by its name may begin at any time and last up to half of it; its
parameters lie in the spans that its type declares. One that is given as data stays as it is, but
for what the data leaves open.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from pytest_dura.campaign.fault_campaigns import FaultCampaign, Faults, alternatives
from pytest_dura.campaign.planned_faults import own_fault
from pytest_dura.campaign.scenario import Scenario
from pytest_dura.campaign.search.space.parameters import FaultChoice, Interval, OneOf, Parameter
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.faults.catalogue import fault_class
from pytest_dura.faults.spans import Words, spans_of

LONGEST = 0.5
"""Share of the time in which faults begin for which an added fault acts at most."""


def fault_choices(
    scenario: Scenario, faults: Iterable[FaultCampaign], lasting: float | None = None
) -> tuple[FaultChoice, ...]:
    """Each of these faults, with what a search may change of it.

    Args:
        scenario: To whose domain and duration the faults belong.
        faults: Names of the catalogue or of the scenario's own faults, globs, ``catalogue``, and
            faults as data; see :mod:`pytest_dura.campaign.fault_campaigns`.
        lasting: Simulated seconds within which they begin; by default all of the scenario's.

    Raises:
        ConfigurationError: For an unknown fault, one that cannot be used, and several together.
    """
    own: Faults = tuple(own_fault(scenario, index) for index in range(len(scenario.faults)))
    lasting = scenario.lasts if lasting is None else lasting
    found: dict[str, FaultChoice] = {}
    for entry in faults:
        for planned in alternatives(scenario, own, entry):
            if len(planned) > 1:
                raise ConfigurationError(
                    "a search adds faults one by one",
                    key="faults",
                    found="+".join(one["id"] for one in planned),
                    expected="single faults, and `at_most` for how many may act together",
                    remedy="name each of them as an entry of its own",
                )
            for one in planned:
                given = entry if isinstance(entry, Mapping) else {}
                choice = FaultChoice(one, tuple(_inner(scenario.time_step, lasting, one, given)))
                _add(found, choice)
    return tuple(found.values())


def _add(found: dict[str, FaultChoice], choice: FaultChoice) -> None:
    """Take in what may be added, once; another fault of the same id has a number behind it."""
    own, number = choice.fault["id"].replace(":", "-").replace(".", "-"), 2
    while (known := found.get(choice.fault["id"])) is not None:
        if known == choice:
            return
        choice = replace(choice, fault={**choice.fault, "id": f"{own}-{number}"})
        number += 1
    found[choice.fault["id"]] = choice


def _inner(
    step: float, lasting: float, fault: Mapping[str, Any], given: Mapping[str, Any]
) -> Iterable[Parameter]:
    """What may differ, in the order in which it is made simpler."""
    latest = max(lasting - step, step)
    activation = fault["activation"]
    if activation.get("at") is not None and "activation" not in given:
        yield Interval("activation.at", 0.0, latest, latest)
    if isinstance(fault["duration"], (int, float)) and "duration" not in given:
        longest = max(LONGEST * lasting, 2 * step)
        yield Interval("duration", step, longest, step)
    fixed = given.get("parameters", {})
    for path, span in spans_of(fault_class(fault["type"])).items():
        if path.rpartition(".")[2] in fixed:
            continue
        if isinstance(span, Words):
            yield OneOf(path, span.values, span.values[0])
        else:
            yield Interval(path, span.low, span.high, span.mildest)
