"""Faults as data: what is accepted, and what the messages say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from pytest_dura.core import ConfigurationError, EpisodeSpec, Fault, FaultRecord, RoleSpec
from pytest_dura.driving import FAULT_TARGETS
from pytest_dura.faults import (
    Activation,
    NumberFault,
    default_fault,
    fault_effect,
    parse_fault,
)

GHOST: dict[str, Any] = {"type": "ghost-obstacle", "activation": {"at": 2.0}, "duration": 4.0}


def test_defaults_are_filled_in() -> None:
    fault = parse_fault(GHOST)
    assert fault.parameters.items() >= {"ahead": 14.0, "length": 5.0, "width": 2.0}.items()
    assert parse_fault({**GHOST, "id": "g2"}).id == "g2"
    assert parse_fault({**GHOST, "duration": None}).duration is None


@pytest.mark.parametrize(
    "change, key, told",
    [
        ({"type": "ghost-obstcle"}, "type", ["unknown fault", "did you mean 'ghost-obstacle'?"]),
        ({"type": "meteor"}, "type", ["package.module:Class, or one of bias", "use one of: bias"]),
        ({"type": None}, "type", ["unknown fault None"]),
        ({"duraton": 3.0}, "duraton", ["did you mean 'duration'?"]),
        ({"duration": -1.0}, "duration", ["greater than 0", "found:    -1.0"]),
        ({"duration": 0.0}, "duration", ["greater than 0"]),
        ({"duration": "4"}, "duration", ["no duration", "{min, max}", "found:    '4'"]),
        ({"duration": float("inf")}, "duration", ["finite"]),
        ({"activation": {"at": -1.0}}, "activation.at", ["greater than or equal to 0"]),
        ({"activation": {"at": float("nan")}}, "activation.at", ["found:    nan"]),
        ({"duration": "onec"}, "duration", ["no duration", "seconds above 0, once, {min, max}"]),
        ({"duration": {"min": 1.0}}, "duration.max", ["the key 'max' is missing", "Longest"]),
        ({"duration": {"min": 1.0, "mx": 2.0}}, "duration.mx", ["did you mean 'max'?"]),
        ({"duration": {"min": 3.0, "max": 2.0}}, "duration", ["min is above max (3 > 2)"]),
        ({"duration": {"min": -1.0, "max": 2.0}}, "duration.min", ["greater than 0", "Shortest"]),
        ({"duration": {"on": 1.0}}, "duration.off", ["'off' is missing"]),
        ({"duration": {"lasting": 1.0}}, "duration.on", ["'on' is missing"]),
        ({"duration": {"at_most": 1.0}}, "duration.until", ["'until' is missing"]),
        ({"duration": {"until": "x"}}, "duration.until", ["'x' is not a comparison", "joined"]),
        ({"duration": [1.0]}, "duration", ["no duration", "found:    [1.0]"]),
        ({"activation": {}}, "activation", ["nothing activates it", "at, when, probability"]),
        ({"activation": {"at": None}}, "activation", ["nothing activates it"]),
        ({"activation": {"at": 1.0, "rate": 2.0}}, "activation", ["at and rate contradict"]),
        (
            {"activation": {"at": 1.0, "when": "a.b > 1", "probability": 0.1}},
            "activation",
            ["at and when and probability contradict", "only one of at, when, probability"],
        ),
        ({"activation": {"probability": -0.1}}, "activation.probability", ["than or equal to 0"]),
        ({"activation": {"probability": 1.1}}, "activation.probability", ["than or equal to 1"]),
        ({"activation": {"rate": 0.0}}, "activation.rate", ["greater than 0", "1/s"]),
        ({"activation": {"every": 1.0}}, "activation", ["nothing activates it"]),
        (
            {"activation": {"every": 1.0, "by": "security_assessor"}},
            "activation",
            ["`every` repeats `at`"],
        ),
        (
            {"activation": {"rate": 1.0, "by": "security_assessor"}},
            "activation",
            ["does not direct by 'rate'", "leave the fault to the fault_injector"],
        ),
        (
            {
                "activation": {
                    "after": {"fault": "a", "event": "manifested"},
                    "by": "security_assessor",
                }
            },
            "activation",
            ["does not see whether a fault manifested", "`activated` or `deactivated`"],
        ),
        ({"activation": {"at": 1.0, "times": 2}}, "activation", ["once, not 2 times", "`every`"]),
        ({"activation": {"rate": 1.0, "times": 0}}, "activation.times", ["equal to 1"]),
        (
            {"activation": {"rate": 1.0, "not_before": 4.0, "not_after": 3.0}},
            "activation",
            ["the window is empty: not_after (3 s) is before not_before (4 s)", "exchange"],
        ),
        (
            {"activation": {"at": 1.0, "not_after": 3.0}},
            "activation",
            ["a window does not bound 'at'", "remove the window"],
        ),
        (
            {"activation": {"after": {"fault": "x", "event": "begun"}}},
            "activation.after.event",
            ["'activated', 'manifested' or 'deactivated'", "found:    'begun'"],
        ),
        ({"activation": {"after": {"falt": "x"}}}, "activation.after.falt", ["mean 'fault'?"]),
        ({"activation": {"after": {}}}, "activation.after.fault", ["is missing", "Id of the"]),
        ({"activation": {"after": "x"}}, "activation.after", ["a mapping with keys of fault"]),
        (
            {"activation": {"after": {"fault": "x", "delay": -1.0}}},
            "activation.after.delay",
            ["greater than or equal to 0"],
        ),
        ({"activation": {"att": 1.0}}, "activation.att", ["did you mean 'at'?"]),
        ({"activation": {"at": 1.0, "every": 0.0}}, "activation.every", ["greater than 0"]),
        ({"activation": {"at": 1.0, "by": "nobody"}}, "activation.by", ["security_assessor"]),
        ({"activation": 2.0}, "activation", ["found:    2.0", "a mapping with keys of at,"]),
        ({"target": 3}, "target", ["valid string", "found:    3"]),
        ({"id": ""}, "id", ["at least 1 character"]),
        ({"parameters": {"ahed": 3.0}}, "parameters.ahed", ["did you mean 'ahead'?"]),
        ({"parameters": {"ahead": -3.0}}, "parameters.ahead", ["greater than 0"]),
        (
            {"parameters": {"colour": "red"}},
            "parameters.colour",
            ["one of ahead, ", "length", "remove the key"],
        ),
    ],
    ids=lambda value: str(value)[:40] if isinstance(value, dict) else "",
)
def test_what_is_no_fault_is_refused_at_its_key(
    change: dict[str, Any], key: str, told: list[str]
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_fault({**GHOST, **change})
    assert caught.value.key == key
    for part in told:
        assert part in str(caught.value)
    assert caught.value.expected
    assert caught.value.remedy
    for leaked in ("pydantic", "Value error", "Input should", "<seconds>", "<until>", "<sampled>"):
        assert leaked not in str(caught.value)


@pytest.mark.parametrize(
    "kind, parameters, key, told",
    [
        ("out-of-range", {}, "parameters.low", "Lower end"),
        ("out-of-range", {"low": 2.0, "high": 1.0}, "parameters", "low is above high"),
        ("out-of-range", {"low": 0.0, "high": 1e300}, "parameters", "change the excess"),
        ("masquerade", {"forged": {"a": 1.0}, "value": 1.0}, "parameters", "give one"),
        ("masquerade", {"forged": {"a": float("nan")}}, "parameters.forged.a", "finite"),
        ("masquerade", {"forged": {"a": [1.0]}}, "parameters.forged.a", "a number, a text"),
        ("patch", {"colour": [0, 0, 256]}, "parameters.colour.2", "less than or equal to 255"),
        ("patch", {"colour": [0, 0]}, "parameters.colour.2", "missing"),
        ("id-switch", {"ids": ["V1"]}, "parameters", "two"),
        ("id-switch", {"ids": ["V1", "V1"]}, "parameters", "two"),
        ("trajectory-spoof", {"velocity": [1.0]}, "parameters.velocity", "missing"),
    ],
)
def test_parameters_that_do_not_go_together_or_lack_a_part_are_refused(
    kind: str, parameters: dict[str, Any], key: str, told: str
) -> None:
    """Those that are wrong on their own are asked of each type in ``test_fault_conformance.py``."""
    data = {"type": kind, "target": "link", "activation": {"at": 1.0}, "parameters": parameters}
    with pytest.raises(ConfigurationError) as caught:
        parse_fault(data)
    assert str(caught.value.key).startswith(key)
    assert told in str(caught.value)


def test_without_target_and_domain_there_is_one_clear_error() -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_fault({"type": "bias", "activation": {"at": 1.0}})
    error = caught.value
    assert error.key == "target"
    assert error.found is None
    assert "'bias' cannot be used: it has no target" in error.problem
    assert "add `target: <channel>" in str(error.remedy)


def test_without_activation_there_is_one_clear_error() -> None:
    with pytest.raises(ConfigurationError, match="nothing activates it") as caught:
        parse_fault({"type": "ghost-obstacle"})
    assert caught.value.key == "activation"
    assert "at: 2.0" in str(caught.value.remedy)


@pytest.mark.parametrize(
    "activation, by_chance",
    [
        ({"at": 1.0}, False),
        ({"when": "odometry.speed > 1"}, False),
        ({"rate": 0.1}, True),
        ({"probability": 0.5}, True),
        ({"probability": 1.0}, False),
        ({"probability": 0.0}, False),  # that it never begins is no chance
        ({"after": {"fault": "x"}}, False),
    ],
)
def test_what_is_by_chance_need_not_happen(activation: dict[str, Any], by_chance: bool) -> None:
    assert parse_fault({**GHOST, "activation": activation}).by_chance is by_chance


def test_a_fault_without_a_type_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="unknown fault"):
        parse_fault({"duration": 3.0})


def due_ticks(activation: Activation, dt: float, count: int) -> list[int]:
    times = [index * dt for index in range(count)]
    before = [-1.0, *times]
    return [
        index
        for index, (since, time) in enumerate(zip(before, times, strict=False))
        if activation.due(time, since)
    ]


@pytest.mark.parametrize("dt", [0.1, 0.05, 0.2])
def test_an_activation_falls_due_at_the_first_tick_at_or_past_its_time(dt: float) -> None:
    for at in (0.0, 0.4, 2.0, 3.6):
        assert due_ticks(Activation(at=at), dt, 100) == [round(at / dt)]
    assert due_ticks(Activation(at=0.41), 0.1, 100) == [5]


def test_a_periodic_activation_falls_due_at_each_multiple() -> None:
    found = due_ticks(Activation(at=1.0, every=2.5), 0.1, 120)
    assert found == [10, 35, 60, 85, 110]
    assert due_ticks(Activation(at=0.3, every=0.1), 0.1, 20) == list(range(3, 20))
    assert due_ticks(Activation(at=0.0, every=0.3), 0.1, 13) == [0, 3, 6, 9, 12]


def test_a_fault_can_be_read_where_its_type_is_not_installed() -> None:
    fault = Fault("elsewhere:Meteor", "m", "lidar", {"at": 1.5}, 2.0, {"mass": 3.0}, by_chance=True)
    spec = EpisodeSpec("a/b", 0, 1, RoleSpec("a:b"), {}, faults=(fault,))
    assert EpisodeSpec.from_json(spec.to_json()).faults == (fault,)
    assert FaultRecord.of(fault) == FaultRecord("m", "lidar", 1.5, by_chance=True)
    with pytest.raises(ConfigurationError, match="elsewhere"):
        fault_effect(fault)


@pytest.mark.parametrize(
    "plain, key",
    [
        ({"type": "bias", "id": "f", "target": "t", "sigma": 1.0}, "sigma"),
        ({"id": "f", "target": "t"}, "type"),
    ],
)
def test_what_is_read_as_a_planned_fault_has_its_keys(plain: dict[str, Any], key: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        Fault.of(plain)
    assert caught.value.key == key
    assert "planned faults have the keys type, id, target" in caught.value.problem


def test_a_type_has_parameters_and_no_other_field() -> None:
    with pytest.raises(TypeError, match="Loud has the field 'amount'; a type of fault has `param"):

        class Loud(NumberFault):
            amount: float = 1.0


def test_an_effect_is_made_of_data_that_was_changed_since_only_if_it_is_valid() -> None:
    """Also where a bundle of a stranger has it, which no reader of files has checked."""
    fault = replace(default_fault("noise", FAULT_TARGETS), parameters={"sigma": -1.0})
    with pytest.raises(ConfigurationError, match="the fault 'noise' cannot be used: 'sigma'"):
        fault_effect(fault)
