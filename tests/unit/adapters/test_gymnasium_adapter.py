"""GymnasiumSimulator: actions, time, ends, faults and configuration, on small environments."""

from __future__ import annotations

import builtins
import importlib
import subprocess
import sys
from collections.abc import Iterator, Mapping
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete

from pytest_dura import (
    ActionError,
    ConfigurationError,
    EpisodeSpec,
    Generator,
    Orchestrator,
    Percept,
    Proposal,
    RoleSpec,
    Termination,
    check_simulator,
)
from pytest_dura.adapters.gymnasium import GymnasiumSimulator, read_only
from pytest_dura.core.seeding import recording_draws

HERE = __name__


class Tank(gymnasium.Env[Any, Any]):
    """Water flows in as the action says; it reuses its observation array."""

    def __init__(
        self, size: float = 10.0, space: str = "box", render_mode: str | None = None
    ) -> None:
        self.observation_space = Box(0.0, 100.0, (1,), np.float64)
        low, high = np.array([[-1.0, 0.0], [1.0, 2.0]], dtype=np.float32)
        self.action_space = {
            "box": Box(low, high, (2,), np.float32),
            "same": Box(0.5, 2.0, (1,), np.float32),
            "choice": Discrete(3, start=1),
            "dict": Dict({"flow": Discrete(2)}),
        }[space]
        self.size, self.render_mode, self.dt = size, render_mode, 0.5
        self.level = np.zeros(1)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.level[0] = (options or {}).get("start", 1.0) + self.np_random.uniform(0.0, 0.1)
        return self.level, {"size": self.size}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.level += self.dt * float(np.sum(action)) if not isinstance(action, dict) else 0.0
        over = bool(self.level[0] >= self.size)
        return self.level, 1.5, over, bool(self.level[0] > 5.0), {"size": self.size}


def signals(observation: Any, info: Mapping[str, Any], reward: float) -> dict[str, float]:
    return {"level": observation[0], "reward": reward}


def sensors(observation: Any, info: Mapping[str, Any]) -> dict[str, Any]:
    return {"gauge": observation, "level": float(observation[0]), "parts": {"list": [1, {"a": 2}]}}


def full(observation: Any, info: Mapping[str, Any], reward: float) -> bool:
    return bool(observation[0] >= 4.0)


def too_full(observation: Any, info: Mapping[str, Any], reward: float) -> str | None:
    return "wet feet" if observation[0] >= 3.0 else None


def tank(**changes: Any) -> GymnasiumSimulator:
    fields = {
        "env": f"{HERE}:Tank",
        "time_step": 0.5,
        "signals": f"{HERE}:signals",
        "sensors": f"{HERE}:sensors",
    }
    return GymnasiumSimulator(**(fields | changes))


def message_of(call: Any, kind: Any = ConfigurationError) -> str:
    with pytest.raises(kind) as caught:
        call()
    return str(caught.value)


@pytest.mark.parametrize("space", ["box", "same", "choice"])
def test_it_keeps_the_contract_of_a_simulator(space: str) -> None:
    action = {"box": [0.5, 0.5], "same": [1.0], "choice": 2}[space]
    report = check_simulator(lambda: tank(params={"space": space}), {}, [action] * 12)
    assert report.not_supported == ("lazy channels", "a time step of 0.25 s", "render", "scene")


def test_registered_environments_with_renderer_conform_too() -> None:
    report = check_simulator(
        lambda: GymnasiumSimulator(
            "Pendulum-v1",
            {"render_mode": "rgb_array"},
            time_step=0.05,
            time_step_attribute="dt",
            signals=lambda o, i, r: {"cos": o[0]},
            sensors=lambda o, i: {"observation": o},
        ),
        {},
        [[0.5], [2.0]] * 4,
    )
    assert report.not_supported == ("lazy channels", "scene")


def test_a_tick_holds_truth_and_sensors_of_its_own_instant() -> None:
    simulator = tank()
    first = simulator.reset({"world": {"start": 2.0}}, 0)
    second = simulator.step(simulator.check_action([1.0, 1.0]))
    assert (second.index, second.time) == (1, 0.5)
    assert second.truth["level"] == pytest.approx(first.truth["level"] + 1.0)
    assert (first.truth["reward"], second.truth["reward"]) == (0.0, 1.5)
    # The environment reuses its array; the channel of the first tick must not follow it.
    assert first.channels["gauge"][0] == first.truth["level"] >= 2.0
    with pytest.raises(ValueError, match="read-only"):
        second.channels["gauge"][0] = 9.0
    assert second.channels["parts"] == {"list": (1, {"a": 2})}
    columns = simulator.signals([first, second])
    assert columns["level"].tolist() == [first.truth["level"], second.truth["level"]]
    assert columns["reward"].dtype == np.float64


def test_the_seed_of_the_episode_seeds_the_environment() -> None:
    simulator = tank()
    levels = [simulator.reset({}, seed).truth["level"] for seed in (0, 1, 0)]
    assert levels[0] == levels[2] != levels[1]


def test_what_an_environment_draws_is_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    with recording_draws() as draws:
        tank().reset({}, 7)
    assert draws.any
    monkeypatch.setattr(Tank, "reset", dry)
    with recording_draws() as draws:
        tank().reset({}, 7)
    assert not draws.any


def dry(self: Tank, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
    gymnasium.Env.reset(self, seed=seed)
    return self.level, {"size": self.size}


def test_numeric_channels_are_percept_signals_and_nan_where_they_are_gone() -> None:
    simulator = tank()
    tick = simulator.reset({}, 0)
    gone = {name: value for name, value in tick.channels.items() if name != "level"}
    columns = simulator.percept_signals([Percept(tick.channels), Percept(gone)])
    assert set(columns) == {"level"}
    assert columns["level"][0] == tick.truth["level"]
    assert np.isnan(columns["level"][1])


@pytest.mark.parametrize(
    "space, action, problem",
    [
        ("choice", 0, "0 is not an action; expected a whole number from 1 to 3"),
        ("choice", 4, "4 is not an action"),
        ("choice", 1.0, "1.0 is not an action"),
        ("choice", True, "True is not an action"),
        ("choice", None, "no action (None); expected Discrete(3, start=1)"),
        ("choice", float("nan"), "nan is not an action"),
        ("choice", "left", "'left' is not an action"),
        ("box", [0.0, float("nan")], "NaN; expected (2,) numbers from [-1, 0] to [1, 2]"),
        ("box", [0.0, 2.5], "[0, 2.5] is out of bounds; expected (2,) numbers"),
        ("box", [-1.5, 1.0], "out of bounds"),
        ("box", [float("inf"), 1.0], "out of bounds"),
        ("box", [0.0], "the action has the shape (1,); expected (2,) numbers"),
        ("box", 0.5, "the action has the shape ()"),
        ("box", "fast", "'fast' is not an action; expected (2,) numbers"),
        ("box", None, "no action (None)"),
        ("same", [3.0], "[3] is out of bounds; expected (1,) numbers from 0.5 to 2"),
        ("dict", {"flow": 5}, "{'flow': 5} is not an element of Dict('flow': Discrete(2))"),
    ],
)
def test_a_wrong_action_is_refused_with_what_is_expected(
    space: str, action: Any, problem: str
) -> None:
    simulator = tank(params={"space": space})
    assert problem in message_of(lambda: simulator.check_action(action), ActionError)


def test_good_actions_come_back_in_the_environments_form() -> None:
    choice = tank(params={"space": "choice"})
    assert choice.check_action(np.int64(2)) == 2
    assert type(choice.check_action(np.int64(2))) is int
    box = tank()
    given = np.array([0.5, 2.0])
    action = box.check_action(given)
    assert action.dtype == np.float32
    assert not action.flags.writeable
    given[0] = 9.0
    assert action.tolist() == [0.5, 2.0]
    assert box.describe_action(action) == "[0.5, 2]"
    assert tank(params={"space": "dict"}).check_action({"flow": 1}) == {"flow": 1}


def test_the_fallback_is_configurable_and_has_a_default() -> None:
    assert tank(params={"space": "choice"}).fallback_action() == 1
    assert tank(params={"space": "choice"}, fallback=3).fallback_action() == 3
    assert tank().fallback_action().tolist() == [0.0, 0.0]
    assert tank(params={"space": "same"}).fallback_action().tolist() == [0.5]
    text = message_of(lambda: tank(fallback=[9.0, 9.0]).reset({}, 0))
    assert "cannot fall back to that: [9, 9] is out of bounds" in text
    assert "fallback" in message_of(lambda: tank(params={"space": "dict"}).reset({}, 0))


def test_goal_critical_and_truncation() -> None:
    def run(**changes: Any) -> Any:
        simulator = tank(**changes)
        tick = simulator.reset({}, 0)
        ticks = [tick]
        while tick.critical is None and not tick.goal and not tick.truncated:
            tick = simulator.step(simulator.check_action([0.0, 2.0]))
            ticks.append(tick)
        return ticks

    cut = run()[-1]
    assert (cut.truncated, cut.critical, cut.goal) == (True, None, False)
    assert 10.0 > cut.truth["level"] > 5.0
    ended = run(params={"size": 4.0})
    assert ended[-1].critical == "the environment has terminated"
    assert 5.0 > ended[-1].truth["level"] >= 4.0
    reached = run(goal=f"{HERE}:full")
    assert (reached[-1].goal, reached[-1].critical) == (True, None)
    assert run(critical=f"{HERE}:too_full")[-1].critical == "wet feet"
    both = run(goal=f"{HERE}:full", params={"size": 4.0})
    assert (both[-1].goal, both[-1].critical) == (True, None)


class Once(Tank):
    """A tank that refuses to be stepped after its end, as Gymnasium's interface allows."""

    over = False

    def reset(self, **arguments: Any) -> Any:
        self.over = False
        return super().reset(**arguments)

    def step(self, action: Any) -> Any:
        if self.over:
            raise RuntimeError("stepped after its end")
        result = super().step(action)
        self.over = result[2] or result[3]
        return result


class Pours(Generator):
    def propose(self, view: Any) -> Proposal:
        return Proposal([0.0, 2.0])


@pytest.mark.parametrize(
    "changes, goal, end",
    [
        ({}, True, "truncated"),
        ({"params": {"size": 4.0}}, True, "critical"),
        ({"goal": f"{HERE}:full"}, True, "goal"),
        ({"goal": f"{HERE}:full", "params": {"size": 4.0}}, True, "goal"),
        ({"goal": f"{HERE}:full", "params": {"size": 4.0}}, False, "truncated"),
        ({"critical": f"{HERE}:too_full"}, True, "critical"),
    ],
)
def test_nothing_is_stepped_after_its_end(changes: Any, goal: bool, end: str) -> None:
    parts = {"time_step": 0.5, "signals": f"{HERE}:signals", "sensors": f"{HERE}:sensors"}
    spec = EpisodeSpec(
        case="tank/filling",
        run=0,
        seed=1,
        simulator=RoleSpec(
            "pytest_dura.adapters.gymnasium:GymnasiumSimulator",
            {"env": f"{HERE}:Once", **parts, **changes},
        ),
        roles={"generator": RoleSpec(f"{HERE}:Pours")},
        termination=Termination(20.0, goal=goal),
        time_step=0.5,
    )
    episode = Orchestrator.build(spec).run(spec)
    assert (episode.failure, episode.termination) == (None, end)
    check_simulator(lambda: tank(env=f"{HERE}:Once", **changes), {}, [[0.0, 2.0]] * 20)


def test_a_time_step_is_fixed_unless_an_attribute_holds_it() -> None:
    simulator = tank()
    simulator.set_time_step(0.5)
    text = message_of(lambda: simulator.set_time_step(0.1))
    assert "one step of" in text
    assert "takes 0.5 s" in text
    assert "positive number" in message_of(lambda: simulator.set_time_step(float("nan")))
    assert "positive number" in message_of(lambda: tank(time_step=0.0))
    free = tank(time_step_attribute="dt")
    free.set_time_step(0.25)
    before = free.reset({}, 0)
    after = free.step(free.check_action([1.0, 1.0]))
    assert after.time == 0.25
    assert after.truth["level"] == pytest.approx(before.truth["level"] + 0.5)
    wrong = tank(time_step_attribute="tau")
    assert "no attribute 'tau'" in message_of(lambda: wrong.reset({}, 0))


@pytest.mark.parametrize(
    "env, problem",
    [
        ("NoSuchThing-v0", "Gymnasium cannot make 'NoSuchThing-v0'"),
        ("no_such_module:Thing-v0", "Gymnasium cannot make 'no_such_module:Thing-v0'"),
        ("no_such_module:Thing", "cannot import 'no_such_module:Thing'"),
        ("thermometer", "Gymnasium cannot make 'thermometer'"),
        (f"{HERE}:signals", "is neither a class nor a factory of Env"),
        ("builtins:dict", "Python's standard library"),
        ("csv:Thing-v0", "Python's standard library"),
    ],
)
def test_an_environment_that_cannot_be_made_is_told(env: str, problem: str) -> None:
    assert problem in message_of(lambda: tank(env=env).reset({}, 0))


def test_wrong_parameters_and_callables_are_told() -> None:
    assert "tarqet" in message_of(lambda: tank(params={"tarqet": 1}).reset({}, 0))
    assert "nowhere" in message_of(lambda: tank(signals=f"{HERE}:nowhere"))


@pytest.fixture
def installed(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Names of imported modules: of a package that registers nothing, and of the project's."""
    mark = "import builtins\nbuiltins.imported.append(__name__)\n"
    (tmp_path / "site-packages").mkdir()
    (tmp_path / "site-packages/stranger.py").write_text(f"{mark}class Car: pass\n")
    (tmp_path / "mine.py").write_text(
        f"{mark}from os import system\nfrom highway_env.vehicle.behavior import IDMVehicle\n"
        "class Car(IDMVehicle): pass\n"
    )
    imported: list[str] = []
    monkeypatch.setattr(builtins, "imported", imported, raising=False)
    monkeypatch.syspath_prepend(tmp_path / "site-packages")
    monkeypatch.syspath_prepend(tmp_path)
    yield imported
    for name in ("stranger", "mine"):
        sys.modules.pop(name, None)


def motorway(**config: Any) -> GymnasiumSimulator:
    """highway-env's motorway, whose vehicles have the class that its configuration names."""
    return GymnasiumSimulator(
        "highway_env:highway-v0",
        {"config": {"vehicles_count": 2} | config},
        time_step=1.0,
        signals=lambda o, i, r: {"reward": r},
        sensors=lambda o, i: {"speed": float(i["speed"])},
    )


@pytest.mark.parametrize(
    "name, why",
    [
        ("stranger.Car", "is of the package stranger, which registers nothing"),
        ("stranger.inner.Car", "is of the package stranger, which registers nothing"),
        ("antigravity.Car", "leads into Python's standard library"),
        ("mine.system", "leads into Python's standard library"),
        ("mine.IDMVehicle", None),
        ("mine.Car", None),
        ("highway_env.vehicle.behavior.LinearVehicle", None),
    ],
)
@pytest.mark.parametrize("place", ["params", "world"])
def test_names_in_a_configuration_are_checked_as_our_own(
    installed: list[str], place: str, name: str, why: str | None
) -> None:
    """highway-env imports the class of its vehicles by name."""
    pytest.importorskip("highway_env")
    config = {"other_vehicles_type": name}
    simulator = motorway(**config if place == "params" else {})
    scenario = {"world": {"config": config}} if place == "world" else {}
    if why is None:
        simulator.reset(scenario, 0)
    else:
        text = message_of(lambda: simulator.reset(scenario, 0))
        assert f"{name!r} in a configuration {why}" in text
    assert "stranger" not in installed
    assert "antigravity" not in sys.modules
    simulator.close()


def test_what_only_looks_like_a_name_is_handed_over(installed: list[str]) -> None:
    texts = ["v1.0", "no.such.Thing", "maps/a.xml", "./stranger.xml", "stranger", "a: b", ".", ":"]
    simulator = tank()
    simulator.reset({"world": {"texts": texts, "one.of": {"stranger": texts}}}, 0)
    assert not installed


@pytest.mark.parametrize("env", ["stranger:Thing-v0", "stranger:Car", "stranger.inner:Thing-v0"])
def test_an_environment_imports_no_package_that_registers_nothing(
    installed: list[str], env: str
) -> None:
    text = message_of(lambda: tank(env=env).reset({}, 0))
    assert "is of the package stranger, which registers nothing" in text
    assert "--dura-trust-code" in text
    assert not installed
    if env.endswith("-v0"):  # what a conftest.py has imported is not imported by that
        importlib.import_module("stranger")
        assert "Gymnasium cannot make" in message_of(lambda: tank(env="stranger:Thing-v0").env)


def test_without_a_render_mode_it_does_not_render() -> None:
    with pytest.raises(NotImplementedError, match="rgb_array"):
        tank().render()


def test_the_time_limit_of_the_environment_is_left_out() -> None:
    simulator = GymnasiumSimulator(
        "MountainCar-v0", time_step=1.0, signals=signals_of_car, sensors=sensors_of_car
    )
    tick = simulator.reset({}, 0)
    for _ in range(250):
        tick = simulator.step(1)
    assert tick.events == ()
    simulator.close()
    simulator.close()


def signals_of_car(observation: Any, info: Any, reward: float) -> dict[str, float]:
    return {"position": observation[0]}


def sensors_of_car(observation: Any, info: Any) -> dict[str, float]:
    return {"position": float(observation[0])}


class Push(Generator):
    def propose(self, view: Any) -> Proposal:
        return Proposal([0.25, 0.25], str(view.percept["level"]))


def test_a_spec_of_plain_data_rebuilds_it() -> None:
    params = {
        "env": f"{HERE}:Tank",
        "time_step": 0.5,
        "signals": f"{HERE}:signals",
        "sensors": f"{HERE}:sensors",
        "goal": f"{HERE}:full",
    }
    spec = EpisodeSpec(
        "tank/fill",
        0,
        5,
        RoleSpec("pytest_dura.adapters.gymnasium:GymnasiumSimulator", params),
        {"generator": RoleSpec(f"{HERE}:Push")},
        termination=Termination(60.0),
        time_step=0.5,
    )
    again = EpisodeSpec.from_json(spec.to_json())
    episode = Orchestrator.build(again).run(again)
    assert episode.termination == "goal"
    assert episode.digest == Orchestrator.build(spec).run(spec).digest
    wrong = EpisodeSpec.from_json({**spec.to_json(), "time_step": 0.1})
    assert "takes 0.5 s" in message_of(lambda: Orchestrator.build(wrong).run(wrong))


def test_read_only_copies_what_can_be_written_to() -> None:
    array = np.zeros(2)
    frozen = read_only({"a": array, "b": [1, [2]], "c": (array,), "d": "text"})
    array[0] = 1.0
    assert frozen["a"].tolist() == [0.0, 0.0]
    assert frozen["b"] == (1, (2,))
    assert not frozen["c"][0].flags.writeable
    assert frozen["d"] == "text"


def test_gymnasium_is_imported_late() -> None:
    program = (
        "import sys; import pytest_dura.adapters.gymnasium; assert 'gymnasium' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
