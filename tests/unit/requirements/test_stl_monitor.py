"""StlSafetyMonitor: its verdicts, its place in the loop, and what it refuses."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from loops import doing, run_loop
from roads import run, spec_of_drive
from thermostat import HeatMonitor, Overheater, SwitchOff, Thermostat

import pytest_dura
from pytest_dura import (
    Assessed,
    Assessment,
    ConfigurationError,
    Episode,
    Percept,
    Proposal,
    RoleContext,
    RoleSpec,
    StateManager,
    Tick,
    check_role,
)
from pytest_dura.driving import Aggressive, HighwaySimulator
from pytest_dura.library import Scenario, expand_cases
from pytest_dura.requirements import evaluate, parse, robustness
from pytest_dura.requirements.monitoring.stl_monitor import StlSafetyMonitor

PERCEPT = "pytest_dura.driving.signals:percept_at"
COOL = "historically[0:0.2] (thermometer < 16)"


def fahrenheit(percept: Percept) -> dict[str, float]:
    return {"heat": percept["thermometer"] * 1.8 + 32.0, "spare": math.nan}


def a_list(percept: Percept) -> list[float]:
    return [percept["thermometer"]]


class Wheel(NamedTuple):
    speed: float
    slip: float


class Seen:
    """A monitor shown percepts one after the other."""

    def __init__(self, monitor: StlSafetyMonitor, dt: float = 0.1) -> None:
        self.monitor, self.state = monitor, StateManager(dt)
        monitor.reset(RoleContext(0, dt))

    def skip(self, **channels: Any) -> None:
        index = len(self.state.ticks)
        tick = Tick(index, index * self.state.dt, {}, channels)
        self.state.update(tick, Percept(channels))

    def __call__(self, **channels: Any) -> Assessment:
        self.skip(**channels)
        return self.again()

    def again(self) -> Assessment:
        return self.monitor.run(self.state.role_view())


def verdicts(episode: Episode, role: str) -> list[tuple[float, float]]:
    assert episode.failure is None, episode.failure
    times, scores = episode.metrics.robustness[role]
    return list(zip(times, scores, strict=True))


def test_it_is_public() -> None:
    assert pytest_dura.StlSafetyMonitor is StlSafetyMonitor
    assert "StlSafetyMonitor" in pytest_dura.__all__


def test_it_keeps_the_contract_of_a_role() -> None:
    report = check_role(
        RoleSpec("pytest_dura:StlSafetyMonitor", {"formula": COOL, "warning": "thermometer < 15"}),
        simulator=Thermostat,
        scenario={"world": {"outside": 40.0}},
    )
    assert len(report.checked) == 2
    spec = {"formula": "historically[0:0.5] (gap > 0.5)", "signals": PERCEPT}
    world = {"traffic": {"headway": 6.0}, "pedestrians": [{"id": "P1"}]}
    check_role(
        RoleSpec("pytest_dura:StlSafetyMonitor", spec),
        simulator=HighwaySimulator,
        scenario={"world": world},
    )


def test_verdict_score_and_reason() -> None:
    seen = Seen(StlSafetyMonitor("historically[0:0.1] (x > 1)", warning="x > 2"))
    assert seen(x=4.0) == Assessment(Assessed.SAFE, 3.0)
    reason = "`x > 2` does not hold at tick 1: robustness -0.5"
    assert seen(x=1.5) == Assessment(Assessed.WARNING, 0.5, (reason,))
    reason = "`historically[0:0.1] (x > 1)` does not hold at tick 2: robustness 0"
    assert seen(x=1.0) == Assessment(Assessed.UNSAFE, 0.0, (reason,))
    assert seen(x=9.0).verdict is Assessed.UNSAFE
    assert seen(x=9.0) == Assessment(Assessed.SAFE, 8.0)


def test_on_the_bound_the_comparison_decides() -> None:
    assert Seen(StlSafetyMonitor("x >= 1"))(x=1.0) == Assessment(Assessed.SAFE, 0.0)
    assert Seen(StlSafetyMonitor("x > 1"))(x=1.0).verdict is Assessed.UNSAFE


def test_signals_are_channels_their_fields_or_what_a_function_makes_of_them() -> None:
    wheel = Wheel(3.0, 0.1)
    channels = {"wheel": wheel, "imu": {"yaw": np.float64(2.0)}, "pose": wheel, "x": 5}
    for name, value in {
        "x": 5.0,
        "percept.x": 5.0,
        "wheel.speed": 3.0,
        "percept.wheel.slip": 0.1,
        "imu.yaw": 2.0,
    }.items():
        assert Seen(StlSafetyMonitor(f"{name} > 0"))(**channels).score == value
    for name in ("heat", "percept.heat"):
        monitor = StlSafetyMonitor(f"{name} > 0", signals="test_stl_monitor:fahrenheit")
        assert Seen(monitor)(thermometer=10.0).score == 50.0


def test_ticks_at_which_nobody_asked_count_and_none_counts_twice() -> None:
    formula = "(once[0.2:0.2] (x > 5)) or (x > 9)"
    seen = Seen(StlSafetyMonitor(formula))
    seen(x=1.0)
    seen.skip(x=6.0)
    first = seen(x=1.0)
    assert [seen.again(), seen.again()] == [first, first]
    assert seen(x=1.0).score == 1.0
    assert seen(x=1.0).score == -4.0


def test_it_refuses_to_judge_by_half_a_history() -> None:
    seen = Seen(StlSafetyMonitor("once (x > 0)"))
    seen(x=1.0)
    seen.skip(x=1.0)
    view = seen.state.role_view()
    with pytest.raises(ConfigurationError, match="needs the percepts of all ticks"):
        seen.monitor.run(replace(view, percepts=[view.percept]))


@pytest.mark.parametrize("role", ["safety_monitor", "stl_monitor"])
def test_in_a_loop_it_says_what_the_percepts_give(role: str) -> None:
    parts = {"safety_monitor": HeatMonitor(), role: StlSafetyMonitor(COOL)}
    episode = run_loop(Overheater(), policy="log_only", **parts)
    expected = robustness(
        parse(COOL), {"thermometer": episode.signals["percept.temperature"]}, 0.1
    )[:-1]
    assert [score for _, score in verdicts(episode, role)] == expected.tolist()
    flagged = list(episode.metrics.flags[role])
    assert flagged == np.flatnonzero(expected <= 0).tolist()
    assert flagged


def test_it_stops_the_proposal_as_any_monitor_does() -> None:
    episode = run_loop(
        Overheater(), seconds=3.0, stl_monitor=StlSafetyMonitor(COOL), recovery_planner=SwitchOff()
    )
    flagged = episode.metrics.flags["stl_monitor"]
    sources = episode.decisions["source"].tolist()
    assert [at for at, source in enumerate(sources) if source == "recovery"] == flagged
    assert 0 < len(flagged) < len(sources)
    first = next(event for event in episode.events if event.kind == "unsafe")
    assert (first.subject, first.tick) == ("stl_monitor", flagged[0])
    assert first.detail.startswith(f"`{COOL}` does not hold at tick {flagged[0]}: robustness -")


def test_it_runs_where_there_is_no_valid_proposal() -> None:
    def sometimes(view: Any) -> Proposal:
        return Proposal(1.0 if view.index % 2 else "nonsense")

    episode = run_loop(sometimes, policy="log_only", stl_monitor=StlSafetyMonitor(COOL))
    times = [time for time, _ in verdicts(episode, "stl_monitor")]
    assert times == pytest.approx([0.1 * index for index in range(10)])


def test_a_refined_proposal_is_no_further_sample() -> None:
    def refining(view: Any) -> Proposal:
        view.percept["thermometer"]
        return Proposal(0.5 if view.feedback else 1.0)

    def refuses(view: Any) -> Assessment:
        found = Assessed.UNSAFE if view.proposal.action > 0.5 else Assessed.SAFE
        return Assessment(found, 0.0, ("too much",))

    monitor = doing(pytest_dura.SafetyMonitor, refuses)
    steps = "rise (thermometer > 0)"
    parts = {"safety_monitor": monitor, "stl_monitor": StlSafetyMonitor(f"not ({steps})")}
    episode = run_loop(refining, policy="refine(2)", **parts)
    assert len(monitor.seen) > 10
    scores = [score for _, score in verdicts(episode, "stl_monitor")]
    assert len(scores) == 10
    assert [score < 0 for score in scores] == [True] + [False] * 9
    assert episode.metrics.flags["stl_monitor"] == [0]


class Oblivious(Aggressive):
    """Looks at lidar, so that a fault of it manifests, and drives on."""

    def propose(self, view: Any) -> Proposal:
        view.percept["lidar"]
        return super().propose(view)


CRASH: dict[str, Any] = {
    "ego": {"distance": 50.0, "speed": 8.0},
    "vehicles": [{"id": "W", "arm": "west", "distance": 42.0, "speed": 9.0}],
}
EMPTY_ROAD: dict[str, Any] = {"ego": {"distance": 50.0, "speed": 8.0}}
GHOST = {
    "type": "ghost-obstacle", "activation": {"at": 1.0}, "duration": 2.0,
    "parameters": {"ahead": 5.5},
}  # fmt: skip


def driven(world: Mapping[str, Any], roles: Mapping[str, RoleSpec], **options: Any) -> Episode:
    generator = RoleSpec("test_stl_monitor:Oblivious")
    episode = run(spec_of_drive(world, generator=generator, roles=roles, **options))
    assert episode.failure is None
    return episode


def monitor_of(formula: str) -> RoleSpec:
    return RoleSpec("pytest_dura:StlSafetyMonitor", {"formula": formula, "signals": PERCEPT})


@pytest.mark.parametrize("role", ["safety_monitor", "stl_monitor"])
def test_it_flags_a_contact_before_it_comes(role: str) -> None:
    episode = driven(CRASH, {role: monitor_of("historically[0:0.5] (gap > 1.5)")})
    (contact,) = np.flatnonzero(episode.signals["collided"])
    assert episode.signals["gap"][contact] == 0.0
    flagged = episode.metrics.flags[role]
    assert flagged == list(range(flagged[0], contact))
    assert episode.signals["gap"][flagged[0] - 1] > 1.5 >= episode.signals["gap"][flagged[0]] > 0.0


def test_it_flags_a_ghost_and_the_requirement_of_the_same_words_is_satisfied() -> None:
    formula = "historically[0:0.5] (gap > 1.5)"
    attacked = driven(EMPTY_ROAD, {"stl_monitor": monitor_of(formula)}, faults=[GHOST])
    assert attacked.validity == "valid"
    flagged = attacked.metrics.flags["stl_monitor"]
    near = np.flatnonzero(attacked.signals["percept.gap"] <= 1.5)
    assert flagged == list(range(near[0], near[-1] + 6))
    found = evaluate(parse(formula), attacked.time, attacked.signals)
    assert found.status == "satisfied"
    alike = driven(
        EMPTY_ROAD,
        {"stl_monitor": monitor_of(formula.replace("gap", "percept.gap"))},
        faults=[GHOST],
    )
    assert alike.metrics.flags["stl_monitor"] == flagged
    clean = driven(EMPTY_ROAD, {"stl_monitor": monitor_of(formula)})
    assert "stl_monitor" not in clean.metrics.flags


def test_the_documented_example_runs_in_the_driving_domain() -> None:
    page = (Path(__file__).parents[3] / "docs" / "formulas.md").read_text("utf-8")
    (example,) = re.findall(r"`(stl_monitor: {path: stl, .*}})`", page)
    given = yaml.safe_load(example)
    scenario = {
        "name": "s",
        "simulator": "driving",
        "duration": 30.0,
        "world": CRASH,
        "roles": given,
    }
    (case,) = expand_cases([Scenario.model_validate(scenario)])
    chosen = {"generator": RoleSpec("test_stl_monitor:Oblivious"), "safety_monitor": None}
    episode = run(case.spec(0, 1, chosen, policy="log_only"))
    assert episode.failure is None
    (contact,) = np.flatnonzero(episode.signals["collided"])
    near = np.flatnonzero(episode.signals["percept.gap"][:contact] <= 0.5).tolist()
    assert near
    assert episode.metrics.flags["stl_monitor"] == near


@pytest.mark.parametrize("key", ["formula", "warning"])
def test_a_formula_that_looks_ahead_is_refused_at_once(key: str) -> None:
    with pytest.raises(ConfigurationError, match="a monitor cannot know the future: `eventually`"):
        RoleSpec(
            "pytest_dura:StlSafetyMonitor",
            {"formula": "x > 0"} | {key: "(x > 0) or (eventually[0:1] (x > 1))"},
        ).create()


@pytest.mark.parametrize("key", ["formula", "warning"])
@pytest.mark.parametrize("bad", [3, ["x > 0"]])
def test_a_formula_is_a_text(key: str, bad: Any) -> None:
    with pytest.raises(ConfigurationError, match=f"the {key} of a monitor is no text"):
        StlSafetyMonitor(**{"formula": "x > 0", key: bad})


@pytest.mark.parametrize(
    "signals, problem",
    [
        ("pytest_dura.driving.signals", "an import path has the form"),
        ("pytest_dura.driving.signals:percept_of", "cannot import"),
        ("pytest_dura.driving.signals:NAMES", "is not a function"),
        ({"gap": "lidar"}, "no import path"),
    ],
)
def test_signals_that_are_no_function_are_refused(signals: Any, problem: str) -> None:
    with pytest.raises(ConfigurationError, match=problem) as caught:
        StlSafetyMonitor("gap > 0", signals)
    assert caught.value.key == "signals"
    assert "of a function that takes a percept" in str(caught.value)


def first_tick(formula: str, signals: str | None = None) -> str:
    """What is told to the user; an error of later ticks would be the episode's failure."""
    with pytest.raises(ConfigurationError) as caught:
        run_loop(Overheater(), stl_monitor=StlSafetyMonitor(formula, signals))
    return str(caught.value)


def test_what_the_percept_does_not_have_is_told_at_the_first_tick() -> None:
    text = first_tick("(heat > 0) and (once (heap > 0))", "test_stl_monitor:fahrenheit")
    assert "no signal 'heap' at t = 0.00 s" in text
    assert "one of heat, spare" in text
    assert "did you mean 'heat'?" in text
    text = first_tick("temperature > 0")
    assert "'temperature' cannot be read from the percept: there is no channel" in text
    assert "one of clock, thermal_camera, thermometer" in text
    text = first_tick("percept.thermometer.celsius > 0")
    assert "there is no 'celsius' in it" in text
    with pytest.raises(ConfigurationError, match="one of slip, speed"):
        Seen(StlSafetyMonitor("wheel.sped > 0"))(wheel=Wheel(1.0, 0.0))


def test_what_has_no_value_is_told_at_the_first_tick() -> None:
    assert "returned no signals" in first_tick("x > 0", "test_stl_monitor:a_list")
    assert "'spare' is not finite" in first_tick("spare > 0", "test_stl_monitor:fahrenheit")
    with pytest.raises(ConfigurationError, match="'wheel' is no number"):
        Seen(StlSafetyMonitor("wheel > 0"))(wheel=Wheel(1.0, 0.0))


def test_a_window_between_two_ticks_is_told_before_the_first_one() -> None:
    assert "falls between two samples" in first_tick("once[0:0.25] (thermometer > 0)")


def test_a_percept_that_loses_its_value_is_a_failure_and_no_verdict() -> None:
    class Breaks(Thermostat):
        def step(self, action: Any) -> Tick:
            tick = super().step(action)
            channels = {**tick.channels, "thermometer": math.nan} if tick.index == 4 else None
            return replace(tick, channels=channels) if channels else tick

    monitor = StlSafetyMonitor("thermometer > 0")
    episode = run_loop(Overheater(), simulator=Breaks(), stl_monitor=monitor)
    assert episode.failure is not None
    assert episode.failure.startswith("infrastructure: stl_monitor at tick 4")
    assert "the signal 'thermometer' is not finite at t = 0.40 s" in episode.failure
