"""Black boxes: inputs over time, what `simulate` may return, and the contract of a simulator."""

from __future__ import annotations

import numpy as np
import pytest

from pytest_dura import BlackBox, ConfigurationError, Input, InputCurve, RoleSpec, check_simulator

TIME = np.arange(21) * 0.5


def double(time, inputs):
    return {"y": 2.0 * inputs["u"](time)}


BOX = BlackBox(double, [Input("u", 0.0, 1.0, pieces=4)], ["y"])


def returning(**signals):
    return BlackBox(lambda time, inputs: signals, [Input("u", 0.0, 1.0)], ["y"])


def test_a_constant_piece_counts_from_its_beginning_on() -> None:
    curve = InputCurve((1.0, 2.0, 3.0), 0.3, "constant")
    assert curve.times.tolist() == pytest.approx([0.0, 0.1, 0.2])
    assert curve(np.arange(4) * 0.1).tolist() == [1.0, 2.0, 3.0, 3.0]
    assert curve(0.0999) == 1.0


def test_a_linear_input_goes_through_its_values() -> None:
    curve = InputCurve((0.0, 4.0, 0.0), 10.0, "linear")
    assert curve([0.0, 2.5, 5.0, 7.5, 10.0]).tolist() == [0.0, 2.0, 4.0, 2.0, 0.0]


def test_signals_follow_the_inputs_of_the_world() -> None:
    columns = BOX.columns({"u": [0.0, 0.5, 1.0, 0.25]}, TIME)
    assert columns["u"][[0, 5, 10, 15, 20]].tolist() == [0.0, 0.5, 1.0, 0.25, 0.25]
    assert np.array_equal(columns["y"], 2.0 * columns["u"])


def test_a_time_of_its_own_is_interpolated() -> None:
    box = returning(time=[0.0, 2.0, 10.0], y=[0.0, 4.0, 4.0])
    assert box.columns({}, TIME)["y"][[0, 2, 4, 5, 20]].tolist() == [0.0, 2.0, 4.0, 4.0, 4.0]


@pytest.mark.parametrize(
    "signals, problem",
    [
        ({"x": TIME}, "no signal 'y'"),
        ({"y": TIME[:-1]}, r"'y' of shape \(20,\), expected \(21,\)"),
        ({"y": 1.0}, r"'y' of shape \(\)"),
        ({"y": np.where(TIME > 3.0, np.inf, 0.0)}, "returned inf for 'y' at 3.5 s"),
        ({"time": [0.0, 5.0], "y": [0.0, 0.0]}, "0 to 5 s of a run from 0 to 10 s"),
        ({"time": [0.0, 6.0, 5.0, 10.0], "y": [0.0] * 4}, "times that go back"),
        ({"time": [], "y": []}, "no time of a run"),
    ],
)
def test_unusable_signals_are_refused_with_their_reason(signals, problem) -> None:
    with pytest.raises(ValueError, match=problem):
        returning(**signals).columns({}, TIME)


def test_a_tool_may_take_a_last_step_beyond_the_run_and_no_further() -> None:
    box = returning(time=[0.0, 4.0, 8.0, 12.0], y=[0.0, 4.0, 8.0, 12.0])
    assert box.columns({}, TIME)["y"][-1] == 10.0
    with pytest.raises(ValueError, match="0 to 16 s of a run from 0 to 10 s: 3 of 5 lines"):
        returning(time=[0.0, 4.0, 8.0, 12.0, 16.0], y=[0.0] * 5).columns({}, TIME)


LOGGED = np.arange(11) * 1.0


@pytest.mark.parametrize(
    "time, problem",
    [
        (LOGGED * 1e9, "1 of 11 lines lie within it; if its times are in nanoseconds, multiply"),
        (LOGGED * 1e6, "1 of 11 lines lie within it; if its times are in microseconds"),
        (LOGGED * 1e3, "1 of 11 lines lie within it; if its times are in milliseconds"),
        (LOGGED + 1.7e9, "1700000000 to 1700000010 s of .*; subtract the first stamp: time - time"),
        ((LOGGED + 1.7e9) * 1e9, "subtract the first stamp: .*; if its times are in nanoseconds"),
        (LOGGED + 0.01, "0.01 to 10.01 s of .*: 10 of 11 lines .*; subtract the first stamp"),
        (LOGGED * 1.3, r"0 to 13 s of .*: 8 of 11 lines .*; let the scenario run for 13 s"),
        (LOGGED * 0.9, r"0 to 9 s of .*; let the scenario run for 9 s: `duration`"),
        (LOGGED - 3.0, "-3 to 7 s of .*: 8 of 11 lines .*; subtract the first stamp"),
        (np.delete(LOGGED, [3, 4]), "no line from 2 to 5 s; only 7 of 10 s have lines, one every"),
        (np.r_[LOGGED[:5], LOGGED[5:] / 1e3], "times that go back"),
        (np.r_[LOGGED[:2], LOGGED[2:] * 1e3], "0 to 10000 s of .*: 2 of 11 lines"),
    ],
)
def test_a_log_that_would_be_judged_in_part_is_refused_with_a_remedy(time, problem) -> None:
    log = BlackBox(lambda _, __: {"time": time, "y": np.zeros(len(time))}, [], ["y"])
    with pytest.raises(ValueError, match=problem):
        log.columns({}, TIME)


@pytest.mark.parametrize(
    "time",
    [
        LOGGED,
        np.r_[LOGGED[:-1] + 0.01, 10.0] - np.r_[0.01, np.zeros(10)],  # jitter
        np.r_[LOGGED, 10.4],  # less than a tick that no sample could judge
        np.arange(1001) * 0.01,
        np.r_[LOGGED[:5], LOGGED[4:]],  # a doubled stamp
    ],
)
def test_a_log_that_is_judged_as_a_whole_may_have_any_rate(time) -> None:
    log = BlackBox(lambda _, __: {"time": time, "y": time * 2.0}, [], ["y"])
    assert log.columns({}, TIME)["y"] == pytest.approx(TIME * 2.0, abs=0.03)


@pytest.mark.parametrize("value", [[0.5] * 3, 0.5, [0.5, 0.5, 0.5, 1.1], ["a"] * 4, [True] * 4])
def test_a_value_that_an_input_does_not_take_is_refused(value) -> None:
    with pytest.raises(ConfigurationError, match="a list of 4 numbers from 0 to 1") as caught:
        BOX.check_scenario({"u": value})
    assert caught.value.key == "world.u"


def test_inputs_have_defaults_within_their_range() -> None:
    box = BlackBox(double, [Input("u", 2.0, 3.0), Input("v", -1, 1, 2, nominal=0.5)], ["y"])
    assert box.check_scenario({}) == {"u": 2.0, "v": [0.5, 0.5]}


@pytest.mark.parametrize(
    "arguments",
    [
        {"low": 1.0, "high": 0.0},
        {"nominal": 2.0},
        {"high": float("inf")},
        {"high": float("nan")},
        {"pieces": 0},
        {"pieces": True},
        {"pieces": 1, "interpolation": "linear"},
        {"interpolation": "cubic"},
        {"name": "u-1"},
    ],
)
def test_an_input_that_cannot_be_is_refused(arguments) -> None:
    with pytest.raises(ConfigurationError):
        Input(**{"name": "u", "low": 0.0, "high": 1.0, **arguments})


@pytest.mark.parametrize("signals", [[], ["u"], ["y", "y"], ["time"], ["a b"]])
def test_names_that_formulas_could_not_tell_apart_are_refused(signals) -> None:
    with pytest.raises(ConfigurationError, match="names of a black box"):
        BlackBox(double, [Input("u", 0.0, 1.0)], signals)


def test_it_keeps_the_contract_of_a_simulator() -> None:
    scenario = {"duration": 2.0, "world": {"u": [0.0, 1.0, 0.5, 0.25]}}
    report = check_simulator(BOX, scenario, actions=["next sample"] * 20)
    assert "snapshot" not in " ".join(report.not_supported)


def test_it_takes_no_action_of_another_component() -> None:
    with pytest.raises(Exception, match="inputs are those of the scenario"):
        BOX().check_action(1.0)


@pytest.mark.parametrize("tolerances", [{"z": 0.1}, {"u": 0.1}, {"y": 0.0}, {"y": float("nan")}])
def test_tolerances_are_of_signals_and_above_zero(tolerances) -> None:
    with pytest.raises(ConfigurationError, match="tolerances"):
        BlackBox(double, [Input("u", 0.0, 1.0)], ["y"], tolerances=tolerances)


@pytest.mark.parametrize("name", ["fmi:Fmu", "black_box:BlackBox"])
def test_a_scenario_file_cannot_make_one_of_its_own(name) -> None:
    params = {"file": "strange.fmu", "inputs": [], "signals": ["y"]}
    with pytest.raises(ConfigurationError, match="neither a class nor a factory"):
        RoleSpec(f"pytest_dura.adapters.{name}", params).create()
