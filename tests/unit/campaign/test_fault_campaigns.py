"""Lists, grids, samples and the catalogue: which cases they make, and under which ids."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest

from pytest_dura import ConfigurationError
from pytest_dura.driving import FAULT_TARGETS
from pytest_dura.faults import FAULT_TYPES, Moment, NumberFault, fault_class
from pytest_dura.faults.types.base import Numeric
from pytest_dura.faults.types.scalar import GainParameters
from pytest_dura.library import (
    Case,
    Scenario,
    case_with_faults,
    expand_cases,
    fault_campaigns,
    parse_yaml,
    read_campaigns,
    scenario_problems,
)
from pytest_dura.library.fault_campaigns import catalogue_for

GHOST = {"type": "ghost-obstacle", "activation": {"at": 1.0}, "duration": 2.0}


def scenario(extra: str = "", name: str = "road/free") -> Scenario:
    text = f"name: {name}\nsimulator: driving\nduration: 10.0\n{extra}"
    return Scenario.from_document(parse_yaml(text, "road.yaml"))


def cases(*campaigns: Any, of: Scenario | None = None) -> dict[str, Case]:
    return {case.id: case for case in expand_cases([of or scenario()], campaigns or None)}


def grid(**values: Any) -> dict[str, Any]:
    return {"fault": GHOST, "grid": {key.replace("__", "."): one for key, one in values.items()}}


def test_a_grid_is_every_combination_in_declared_order() -> None:
    found = cases(grid(parameters__ahead=[10.0, 14.5], activation__at=[1, 2]))
    assert list(found) == [
        "road/free+ghost-obstacle-ahead=10-at=1",
        "road/free+ghost-obstacle-ahead=10-at=2",
        "road/free+ghost-obstacle-ahead=14.5-at=1",
        "road/free+ghost-obstacle-ahead=14.5-at=2",
    ]
    (fault,) = found["road/free+ghost-obstacle-ahead=14.5-at=2"].faults
    assert (fault.parameters["ahead"], fault.activation["at"]) == (14.5, 2)
    assert fault.duration == 2.0


def test_keys_that_end_alike_are_told_in_full() -> None:
    (name,) = cases(grid(parameters__width=[1.0], parameters__length=[2.0]))
    assert name.endswith("-width=1-length=2")
    data = {"fault": GHOST, "grid": {"duration.min": [1.0], "parameters.min": [2.0]}}
    with pytest.raises(ConfigurationError) as caught:
        cases(data)
    assert "ghost-obstacle-duration.min=1-parameters.min=2" in str(caught.value)


def test_a_sample_is_the_same_every_time_and_each_key_has_its_own_draws() -> None:
    spread = {"min": 10.0, "max": 20.0}
    one = {"fault": GHOST, "sample": {"parameters.ahead": spread}, "count": 3, "seed": 4}
    both = {**one, "sample": {"activation.at": {"min": 0, "max": 3}, "parameters.ahead": spread}}
    found, again, wider = cases(one), cases(one), cases(both)
    assert list(found) == [f"road/free+ghost-obstacle-sample4.{i}" for i in range(3)]
    assert found == again

    def drawn(some: dict[str, Case]) -> list[float]:
        return [case.faults[0].parameters["ahead"] for case in some.values()]

    assert drawn(found) == drawn(wider)
    assert len(set(drawn(found))) == 3
    assert all(10.0 <= value <= 20.0 for value in drawn(found))
    assert drawn(cases({**one, "count": 5}))[:3] == drawn(found)
    assert drawn(cases({**one, "seed": 5})) != drawn(found)


def test_the_whole_catalogue_is_one_word() -> None:
    found = cases("none", "catalogue")
    # What a component sends is its own affair: most send nothing on the way to a model.
    of_domain = [name for name in FAULT_TYPES if fault_class(name).acts_on in FAULT_TARGETS]
    assert set(FAULT_TYPES) - set(of_domain) >= {"prompt-drop", "prompt-reorder"}
    assert list(found) == ["road/free", *(f"road/free+{name}" for name in sorted(of_domain))]
    assert all(len(case.faults) == 1 for case in list(found.values())[1:])


def test_a_glob_chooses_among_the_catalogue() -> None:
    assert list(cases("*-obstacle")) == [
        f"road/free+{name}" for name in sorted(FAULT_TYPES) if name.endswith("-obstacle")
    ]


def test_a_scenario_of_another_domain_has_no_faults_by_themselves() -> None:
    other = scenario().model_copy(update={"simulator": scenario().simulator.model_copy(
        update={"path": "thermostat:Thermostat"})})  # fmt: skip
    assert catalogue_for(other) == []
    with pytest.raises(ConfigurationError) as caught:
        cases("catalogue", of=other)
    assert "target" in str(caught.value.remedy)


def test_campaigns_of_a_scenario_are_its_cases_and_may_name_its_faults() -> None:
    own = scenario(
        "faults:\n  - {type: ghost-obstacle, id: near, activation: {at: 1}, duration: 2}\n"
        "campaigns: [none, near, near+trajectory-spoof]\n"
    )
    assert list(cases(of=own)) == ["road/free+none", "road/free", "road/free+near+trajectory-spoof"]
    assert scenario_problems(own) == []


@pytest.mark.parametrize(
    "entry, told",
    [
        ("ghost-obstacl", "did you mean 'ghost-obstacle'?"),
        ("x-*", "matches 'x-*'"),
        (
            "{fault: {type: ghost-obstacle, activation: {}}, grid: {duration: [1]}}",
            "nothing activates it",
        ),
        ("{fault: {type: ghost-obstacle}, grid: {parameters.ahead: []}}", "the list is empty"),
        (
            ("{fault: {type: ghost-obstacle, activation: {at: 1}}, "
            "grid: {parameters.ahed: [1]}}"),
            "did you mean 'ahead'?",
        ),
        (
            ("{fault: {type: ghost-obstacle, activation: {at: 1}}, "
            "sample: {parameters.ahead: {min: 2, max: 1}}, count: 2}"),
            "min is above max",
        ),
        ("{fault: {type: ghost-obstacle}, sample: {}}", "the key 'count' is missing"),
        ("3", "this is no fault campaign"),
        ("[]", "this is no fault campaign"),
        ("none+ghost-obstacle", "'none' is a campaign by itself"),
        ("{fault: {type: ghost-obstacle, activation: {at: 1}}, grid: {}}", "varies nothing"),
        (
            "{fault: {type: ghost-obstacle, activation: {at: 1}}, sample: {}, count: 2}",
            "the sample varies nothing",
        ),
        (
            ("{fault: {type: ghost-obstacle, activation: {at: 1}}, "
            "grid: {parameters.ahead: [9], parameters: [{}]}}"),
            "the grid sets 'parameters', and 'parameters.ahead' within it",
        ),
        (
            ("{fault: {type: ghost-obstacle, activation: {after: {fault: bias}}}, "
            "grid: {duration: [1]}}"),
            "waits for 'bias', which is not planned with it",
        ),
        (
            ("{fault: {type: ghost-obstacle, activation: {at: 1}}, "
            f"grid: {{{'a.' * 400}b: [1]}}}}"),
            "nested too deeply",
        ),
    ],
)  # fmt: skip
def test_an_entry_that_cannot_be_used_is_told_with_its_line(entry: str, told: str) -> None:
    (problem,) = scenario_problems(scenario(f"campaigns:\n  - none\n  - {entry}\n"))
    assert told in str(problem)
    assert (problem.file, problem.line) == ("road.yaml", 6)
    assert (problem.key or "").startswith("campaigns.1")


def test_a_file_holds_campaigns_and_its_errors_name_the_line(tmp_path: Path) -> None:
    file = tmp_path / "campaigns.yaml"
    file.write_text("campaigns:\n  - none\n  - ghost-obstacle\n")
    assert list(cases(*read_campaigns(file))) == ["road/free", "road/free+ghost-obstacle"]
    file.write_text("campaigns:\n  - none\n  - type: ghost-obstacle\n    activation: {at: -1}\n")
    with pytest.raises(ConfigurationError) as caught:
        cases(*read_campaigns(file))
    assert (caught.value.file, caught.value.line) == (str(file), 4)
    file.write_text("campaigns:\n  - none\n  - 5\n")
    with pytest.raises(ConfigurationError) as caught:
        cases(*read_campaigns(file))
    assert (caught.value.line, caught.value.key) == (3, "campaigns.1")


@pytest.mark.parametrize("text", ["campaigns: []\n", "faults: [none]\n", "campaigns: none\n"])
def test_a_file_of_another_form_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "campaigns.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError, match="no file of fault campaigns"):
        read_campaigns(file)


def test_one_case_is_one_case() -> None:
    assert case_with_faults(scenario(), "ghost-obstacle").id == "road/free+ghost-obstacle"
    with pytest.raises(ConfigurationError, match="make 2 cases"):
        case_with_faults(scenario(), grid(parameters__ahead=[1.0, 2.0]))


def test_a_product_without_bounds_is_refused_before_any_of_it_is_built(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def never(*_: object) -> None:
        raise AssertionError("built")

    monkeypatch.setattr(fault_campaigns.FaultReader, "read", never)
    values = {f"parameters.p{i}": list(range(100)) for i in range(40)}
    with pytest.raises(ConfigurationError, match="too many cases") as caught:
        cases({"fault": GHOST, "grid": values})
    assert caught.value.found == "more than 10^15 cases"
    assert caught.value.expected == "at most 10,000 cases of one scenario"


def test_entries_are_bounded_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fault_campaigns, "MAX_CASES", 3)
    assert len(cases("none", grid(parameters__ahead=[1.0, 2.0]))) == 3
    with pytest.raises(ConfigurationError, match="too many cases"):
        cases("none", grid(parameters__ahead=[1.0, 2.0]), "bias")


def test_the_catalogue_takes_the_scenarios_fault_and_refuses_one_that_waits_for_another() -> None:
    own = scenario(
        "faults:\n  - {type: bias, activation: {at: 1}}\n"
        "  - {type: drift, activation: {after: {fault: bias}}}\n"
    )
    with pytest.raises(ConfigurationError, match="waits for 'bias'"):
        cases("drif*", of=own)


@pytest.mark.parametrize("name", ["a::b", "a\nb", "a\x00", " a", "a ", "x.py", "x" * 201])
def test_an_id_that_could_not_be_named_in_a_command_is_refused(name: str) -> None:
    with pytest.raises(ConfigurationError, match="a fault cannot have the id") as caught:
        cases({**GHOST, "id": name})
    assert caught.value.key == "id"
    assert "\n" not in caught.value.problem


def test_the_variation_of_an_own_fault_never_overwrites_another_one_of_its_id() -> None:
    own = scenario(
        "faults:\n  - {type: bias, activation: {at: 1}}\n"
        "variation: {faults.bias.parameters.offset: {min: 1, max: 2}}\n"
    )
    assert list(cases("none", "bias", "bias+noise", of=own)) == [
        "road/free+none", "road/free", "road/free+bias+noise",
    ]  # fmt: skip
    other = {"type": "bias", "activation": {"at": 1}, "parameters": {"offset": 9.0}}
    for campaign in (other, [other, "noise"]):
        with pytest.raises(ConfigurationError, match="varies a fault of its own"):
            cases(campaign, of=own)
    (case,) = cases({**other, "id": "far"}, of=own).values()
    (fault,) = case.spec(0, 0).faults
    assert fault.parameters["offset"] == 9.0


@pytest.mark.parametrize(
    "fault, values",
    [
        (
            GHOST,
            {"parameters.ahead": [9.0, 10.0], "activation.at": [1, 2.0], "duration": [1.0, 2.0]},
        ),
        (GHOST, {"parameters.ahead": [9.0, 10.0], "parameters.width": [1.0, 2.0]}),
        (GHOST, {"duration": [{"min": 1.0, "max": 2.0}, "once"], "activation.at": [1.0, 2.0]}),
        (
            {**GHOST, "activation": {"when": "odometry.speed > 5"}},
            {"duration": [{"until": "odometry.speed < 1"}, None], "parameters.ahead": [9.0, 10.0]},
        ),
        (
            {
                "type": "bias",
                "target": "odometry.speed",
                "activation": {"at": 1.0},
                "parameters": {},
            },
            {"type": ["bias", "drift"], "activation.at": [1.0, 2.0], "duration": [1.0, 2.0]},
        ),
        (
            {"type": f"{__name__}:Louder", "target": "odometry.speed"},
            {"activation.at": [1.0, 2.0], "parameters.factor": [2.0, 3.0]},
        ),
    ],
)
def test_each_fault_of_a_grid_is_what_it_is_by_itself(
    fault: dict[str, Any], values: dict[str, list[Any]]
) -> None:
    found = list(fault_campaigns.expand_grid(scenario(), {"fault": fault, "grid": values}))
    combinations = list(itertools.product(*values.values()))
    assert len(found) == len(combinations)
    for one, chosen in zip(found, combinations, strict=True):
        alone = {
            "fault": fault,
            "grid": {key: [value] for key, value in zip(values, chosen, strict=True)},
        }
        (expected,) = fault_campaigns.expand_grid(scenario(), alone)
        assert one == expected
        assert repr(one.plain()) == repr(expected.plain()), "keys stand in the same order"


class Louder(NumberFault):
    """A type that is no entry of the catalogue."""

    parameters: GainParameters = GainParameters()

    def changed(self, value: Numeric, moment: Moment) -> Numeric:
        return value * self.parameters.factor


def test_a_refusal_shows_what_was_given_though_a_part_of_it_was_read_before() -> None:
    ramp = {"type": "drift", "target": "odometry.speed", "activation": {"at": 1.0}}
    values = {"activation.at": [1.0, 2.0], "duration": [1.0, -1.0]}
    with pytest.raises(ConfigurationError) as first:
        cases({"fault": ramp, "grid": {"activation.at": [1.0], "duration": [-1.0]}})
    with pytest.raises(ConfigurationError) as later:
        cases({"fault": ramp, "grid": values})
    assert str(later.value) == str(first.value)
