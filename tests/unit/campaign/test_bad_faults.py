"""Faults of scenario files that cannot be: each message with file, line, key and remedy."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import pytest
from rooms import Room

from pytest_dura import ConfigurationError, RoleSpec
from pytest_dura.library import expand_cases, load_scenarios

HEAD = """\
name: yard/some
simulator: rooms:Room
domain: carts:CART
duration: 20.0
faults:
"""
FIRST = "  - {type: bias, id: first, activation: {at: 2.0}, duration: 4.0}\n"


class Bad(NamedTuple):
    faults: str
    line: int
    key: str
    problem: str
    expected: str
    remedy: str


def one(activation: str, kind: str = "bias", rest: str = "") -> str:
    """A fault on three lines or more: type, activation, the rest."""
    lines = [f"type: {kind}", f"activation: {activation}", *rest.splitlines()]
    return "  - " + "\n    ".join(lines) + "\n"


AT = "{at: 2.0}"
CASES = {
    "a channel that is not there": Bad(
        one(AT, rest="target: odometer.speed"),
        8,
        "faults.0.target",
        "the fault 'bias' cannot act on 'odometer.speed': there is no channel 'odometer'",
        "one of imu.acceleration, ",
        "did you mean 'odometry.speed'?",
    ),
    "a misspelt field": Bad(
        one(AT, rest="target: odometry.sped"),
        8,
        "faults.0.target",
        "'odometry' has no part 'sped' that holds a number",
        "odometry.speed",
        "did you mean 'odometry.speed'?",
    ),
    "a channel that the type cannot act on": Bad(
        one(AT, "ghost-obstacle", "target: radar"),
        8,
        "faults.0.target",
        "'ghost-obstacle' cannot act on 'radar': it acts on a list of objects",
        "one of lidar",
        "did you mean 'lidar'?",
    ),
    "a list of objects for a number": Bad(
        one(AT, rest="target: lidar"),
        8,
        "faults.0.target",
        "cannot act on 'lidar': it acts on a number",
        "radar.<row>.<0 to 2>",
        "choose a target",
    ),
    "a command fault on a sensor": Bad(
        one(AT, "inversion", "target: odometry.speed"),
        8,
        "faults.0.target",
        "it acts on a number of the command",
        "one of command.acceleration",
        "choose a target",
    ),
    "an empty window": Bad(
        one("{rate: 0.1, not_before: 4.0, not_after: 3.0}"),
        7,
        "faults.0.activation",
        "the window is empty: not_after (3 s) is before not_before (4 s)",
        "not_before <= not_after",
        "exchange them",
    ),
    "a window for a time": Bad(
        one("{at: 2.0, not_after: 3.0}"),
        7,
        "faults.0.activation",
        "a window does not bound 'at'",
        "beside `when`, `probability` or `rate`",
        "remove the window",
    ),
    "a time beyond the duration": Bad(
        one("{at: 25.0}"),
        7,
        "faults.0.activation.at",
        "the fault 'bias' can only begin at 25 s, when the episode is over",
        "at most 19.9 s, the last decision of the scenario's 20 s",
        "let it begin earlier",
    ),
    "a time after the last decision": Bad(
        one("{at: 19.95}"),
        7,
        "faults.0.activation.at",
        "can only begin at 19.95 s",
        "at most 19.9 s",
        "let it begin earlier",
    ),
    "a window beyond the duration": Bad(
        one("{rate: 0.1, not_before: 20.0}"),
        7,
        "faults.0.activation.not_before",
        "can only begin at 20 s",
        "at most 19.9 s",
        "make the scenario longer",
    ),
    "a delay beyond the duration": Bad(
        FIRST + one("{after: {fault: first, delay: 30.0}}"),
        8,
        "faults.1.activation.after.delay",
        "the fault 'bias' waits 30 s, longer than the episode",
        "at most 19.9 s",
        "make the scenario longer",
    ),
    "two that wait for each other": Bad(
        one("{after: {fault: b}}", rest="id: a") + one("{after: {fault: a}}", rest="id: b"),
        7,
        "faults.0.activation.after.fault",
        "these faults wait for each other for ever: a -> b -> a",
        "a fault that something else activates",
        "give one of them a time, `at`",
    ),
    "three that wait for each other, and one for them": Bad(
        one("{after: {fault: b}}", rest="id: a")
        + one("{after: {fault: c}}", rest="id: b")
        + one("{after: {fault: d}}", rest="id: c")
        + one("{after: {fault: b}}", rest="id: d"),
        10,
        "faults.1.activation.after.fault",
        "for ever: b -> c -> d -> b",
        "something else",
        "`at`",
    ),
    "one that waits for itself": Bad(
        one("{after: {fault: bias}}"),
        7,
        "faults.0.activation.after.fault",
        "the fault 'bias' waits for itself",
        "a fault that something else activates",
        "give it a time, `at`",
    ),
    "a chain on what is not planned": Bad(
        FIRST + one("{after: {fault: second}}"),
        8,
        "faults.1.activation.after.fault",
        "the fault 'bias' waits for 'second', which is not planned with it",
        "one of first",
        "plan 'second' as well",
    ),
    "a chain on a misspelt id": Bad(
        FIRST + one("{after: {fault: frist}}"),
        8,
        "faults.1.activation.after.fault",
        "waits for 'frist'",
        "one of first",
        "did you mean 'first'?",
    ),
    "a chain on nothing at all": Bad(
        one("{after: {fault: first}}"),
        7,
        "faults.0.activation.after.fault",
        "waits for 'first', which is not planned with it",
        "another fault beside it",
        "plan 'first' as well",
    ),
    "a chain on the end of a permanent fault": Bad(
        FIRST.replace("4.0}", "null}") + one("{after: {fault: first, event: deactivated}}"),
        8,
        "faults.1.activation.after.event",
        "waits for the end of 'first', which has none",
        "`activated` or `manifested`",
        "give 'first' a duration",
    ),
    "a chain on turns without an end": Bad(
        FIRST.replace("4.0}", "{on: 1, off: 1}}")
        + one("{after: {fault: first, event: deactivated}}"),
        8,
        "faults.1.activation.after.event",
        "which has none",
        "`activated`",
        "a duration",
    ),
    "a negative probability": Bad(
        one("{probability: -0.1}"),
        7,
        "faults.0.activation.probability",
        "'probability' must be greater than or equal to 0",
        "equal to 0 (Of an activation at each tick",
        "correct the value",
    ),
    "a probability of two": Bad(
        one("{probability: 2}"),
        7,
        "faults.0.activation.probability",
        "less than or equal to 1",
        "equal to 1",
        "correct the value",
    ),
    "two triggers": Bad(
        one("{at: 2.0, when: odometry.speed > 5}"),
        7,
        "faults.0.activation",
        "at and when contradict each other",
        "only one of at, when, probability, rate, after",
        "keep one of them",
    ),
    "no trigger": Bad(
        one("{not_after: 3.0}"),
        7,
        "faults.0.activation",
        "nothing activates it",
        "one of at, when, probability, rate, after",
        "such as `at: 2.0`",
    ),
    "no activation": Bad(
        "  - type: bias\n    duration: 2.0\n",
        6,
        "faults.0.activation",
        "nothing activates it",
        "one of at, when, probability, rate, after",
        "add `activation: {at: 2.0}`",
    ),
    "an unknown key": Bad(
        one(AT, rest="parametres: {offset: 1}"),
        8,
        "faults.0.parametres",
        "unknown key 'parametres'",
        "parameters",
        "did you mean 'parameters'?",
    ),
    "an unknown key of the activation": Bad(
        one("{at: 2.0, untill: 3}"),
        7,
        "faults.0.activation.untill",
        "unknown key 'untill'",
        "one of after, at, by, every",
        "remove the key",
    ),
    "an unknown parameter": Bad(
        one(AT, rest="parameters: {ofset: 1}"),
        8,
        "faults.0.parameters.ofset",
        "unknown key 'ofset'",
        "one of offset",
        "did you mean 'offset'?",
    ),
    "min above max": Bad(
        one(AT, rest="duration: {min: 3, max: 2}"),
        8,
        "faults.0.duration",
        "min is above max (3 > 2)",
        "no longer than the longest",
        "exchange them",
    ),
    "a duration with a misspelt key": Bad(
        one(AT, rest="duration:\n  min: 3\n  mx: 4"),
        10,
        "faults.0.duration.mx",
        "unknown key 'mx'",
        "one of max, min",
        "did you mean 'max'?",
    ),
    "a duration as a word": Bad(
        one(AT, rest="duration: forever"),
        8,
        "faults.0.duration",
        "'duration' is no duration",
        "seconds above 0, once, {min, max}, {until, at_most}, {on, off, lasting}, or null",
        "correct the value",
    ),
    "an unreadable condition": Bad(
        one("{when: odometry.speed is 5}"),
        7,
        "faults.0.activation.when",
        "'odometry.speed is 5' is not a comparison such as 'odometry.speed > 5'",
        "one of >= <= > <, and a number",
        "correct the condition",
    ),
    "a condition on what is not there": Bad(
        one("{when: odometry.speed > 5 and lidr.count > 1}"),
        7,
        "faults.0.activation.when",
        "a condition cannot read 'lidr.count'",
        "one of imu.acceleration",
        "did you mean 'lidar.count'?",
    ),
    "a condition on the proposal, of a fault that nobody directs": Bad(
        one("{when: proposal.acceleration > 1}"),
        7,
        "faults.0.activation.when",
        "a condition cannot read 'proposal.acceleration'",
        "one of imu.acceleration",
        "",
    ),
    "a directed attack on a part that no proposal has": Bad(
        one("{when: proposal.speed > 1, by: security_assessor}"),
        7,
        "faults.0.activation.when",
        "a condition cannot read 'proposal.speed'",
        "proposal.acceleration",
        "",
    ),
    "the end of a duration on what is not there": Bad(
        one(AT, rest="duration: {until: odometry.sped < 1}"),
        8,
        "faults.0.duration.until",
        "a condition cannot read 'odometry.sped'",
        "odometry.speed",
        "did you mean 'odometry.speed'?",
    ),
    "a name that means something else": Bad(
        one(AT, rest="id: none"), 8, "faults.0.id", "cannot have the id 'none'", "none", "another"
    ),
}


def refused(folder: Path, text: str) -> ConfigurationError:
    file = folder / "bad.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError) as caught:
        load_scenarios([file])
    return caught.value


OF_A_GUEST = "a channel that the type cannot act on"
"""The house itself has no fault of a list of objects."""


@pytest.mark.parametrize(
    "bad",
    [
        pytest.param(bad, id=name, marks=[pytest.mark.of_guest] if name == OF_A_GUEST else [])
        for name, bad in CASES.items()
    ],
)
def test_the_message_says_where_what_and_what_to_do(tmp_path: Path, bad: Bad) -> None:
    error = refused(tmp_path, HEAD + bad.faults)
    text = str(error)
    assert text.startswith(f"{tmp_path / 'bad.yaml'}:{bad.line}: ")
    assert error.key == bad.key
    assert bad.problem in error.problem
    assert bad.expected in str(error.expected)
    assert bad.remedy in str(error.remedy)
    for leaked in ("pydantic", "Value error", "Input should", "<seconds>", "<sampled>", "Field "):
        assert leaked not in text


def test_each_bad_fault_of_a_file_is_told(tmp_path: Path) -> None:
    faults = one("{probability: -0.1}", rest="id: a") + one("{at: 99.0}", rest="id: b")
    error = refused(tmp_path, HEAD + faults)
    assert "the first of 2 problems" in error.problem
    (also,) = [line for line in str(error).splitlines() if line.startswith("  also:")]
    assert f"{tmp_path / 'bad.yaml'}:10: the fault 'b' can only begin at 99 s" in also


def test_in_an_unknown_domain_a_fault_needs_a_target_and_no_more_is_known(tmp_path: Path) -> None:
    room = HEAD.replace("domain: carts:CART", 'roles: {generator: "thermostat:Controller"}')
    error = refused(tmp_path, room + one(AT))
    assert error.key == "faults.0.target"
    assert error.problem.startswith("the fault 'bias' cannot be used: it has no target")
    assert "add `target: <channel>" in str(error.remedy)
    assert error.line == 6
    file = tmp_path / "good.yaml"
    file.write_text(room + one(AT, rest="target: thermomter"))
    (case,) = expand_cases(load_scenarios([file]))
    spec = case.spec(0, 1, simulator=RoleSpec.of(Room))
    assert spec.faults[0].target == "thermomter"


def scenario(tmp_path: Path) -> Any:
    file = tmp_path / "good.yaml"
    second = one("{after: {fault: first, event: manifested}}", rest="id: second")
    file.write_text(HEAD + FIRST + second)
    return load_scenarios([file])


@pytest.mark.parametrize("faults", ["second", ["second"], "second+drift"])
def test_a_campaign_that_leaves_out_what_a_fault_waits_for_is_refused(
    tmp_path: Path, faults: Any
) -> None:
    with pytest.raises(
        ConfigurationError, match="waits for 'first', which is not planned"
    ) as caught:
        expand_cases(scenario(tmp_path), [faults])
    assert caught.value.key == "faults.0.activation.after.fault"
    assert "first+second" in str(caught.value.remedy)


def test_a_campaign_that_has_both_is_fine(tmp_path: Path) -> None:
    (case,) = expand_cases(scenario(tmp_path), ["second+first"])
    assert [fault.id for fault in case.faults] == ["first", "second"]


VARIED = """\
variation:
  faults.bias.duration.min: {min: 1.0, max: 3.0}
  faults.bias.duration.max: {min: 2.0, max: 4.0}
"""


def test_values_that_are_possible_each_and_not_together_are_refused(tmp_path: Path) -> None:
    fault = one(AT, rest="duration: {min: 2.0, max: 3.0}")
    error = refused(tmp_path, HEAD + fault + VARIED)
    assert (error.key, error.line) == ("variation.faults.bias.duration.max", 11)
    assert "contradict each other: the fault 'bias' cannot be used: min is above" in error.problem
    assert "duration.min = 3.0, faults.bias.duration.max = 2.0" in str(error.found)
    assert "fit together" in str(error.remedy)
    file = tmp_path / "good.yaml"
    file.write_text(HEAD + fault + VARIED.replace("max: 3.0", "max: 2.0"))
    (case,) = expand_cases(load_scenarios([file]))
    for run in range(20):
        duration = case.spec(run, 0).faults[0].duration
        assert 1.0 <= duration["min"] <= 2.0 <= duration["max"] <= 4.0


def test_whether_a_fault_is_by_chance_follows_what_was_drawn(tmp_path: Path) -> None:
    file = tmp_path / "varied.yaml"
    vary = "variation:\n  faults.bias.activation.probability: {choice: [0.5, 1.0]}\n"
    file.write_text(HEAD + one("{probability: 0.5}") + vary)
    (case,) = expand_cases(load_scenarios([file]))
    found = {
        spec.faults[0].activation["probability"]: spec.faults[0].by_chance
        for spec in (case.spec(run, 0) for run in range(20))
    }
    assert found == {0.5: True, 1.0: False}
