"""check_simulator: passes a good adapter and names every breach of a bad one."""

from __future__ import annotations

import random
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from thermostat import Thermostat

import pytest_dura
from pytest_dura import DuraError, Line, RoleSpec, Scene, Simulator, Tick, Tracks, check_simulator
from pytest_dura.core import ConformanceError, Lazy

ACTIONS = [1.0, 0.5, 0.0, 1.0, 1.0, 0.25, 0.0, 1.0]
SCENARIO = {"world": {"start": 18.0}}


def breaches(kind: Any, scenario: Any = SCENARIO, actions: Any = ACTIONS) -> str:
    with pytest.raises(ConformanceError) as caught:
        check_simulator(kind, scenario, actions)
    assert isinstance(caught.value, DuraError)
    assert not isinstance(caught.value, AssertionError)
    assert caught.value.breaches
    return str(caught.value)


@pytest.mark.parametrize("factory", [Thermostat, RoleSpec("thermostat:Thermostat")])
def test_a_good_adapter_passes_and_the_report_says_what_was_checked(factory: Any) -> None:
    report = check_simulator(factory, SCENARIO, ACTIONS)
    assert "Thermostat" in report.subject
    assert report.not_supported == ("scene",)  # the base class shows nothing
    text = "; ".join(report.checked)
    for word in ("ticks", "signals", "determinism", "None", "fallback", "snapshot", "render",
                 "time step", "close", "lazy"):  # fmt: skip
        assert word in text


def test_the_kits_are_public() -> None:
    assert pytest_dura.check_simulator is check_simulator
    assert "check_role" in pytest_dura.__all__


def test_a_frozen_scenario_and_another_time_step_are_fine() -> None:
    check_simulator(Thermostat, MappingProxyType(SCENARIO), ACTIONS, (5, 9), time_step=0.02)


def test_an_episode_that_turns_critical_is_checked_up_to_there() -> None:
    check_simulator(Thermostat, {"world": {"start": 29.0, "fuse": 30.0}}, [1.0] * 20)


@pytest.mark.parametrize("at", [0, 1, 3])
@pytest.mark.parametrize("end", ["critical", "goal", "truncated"])
def test_nothing_is_stepped_after_its_end(end: str, at: int) -> None:
    class Ends(Thermostat):
        over = False

        def reset(self, scenario: Any, seed: int) -> Tick:
            self.over = False
            return self._ended(super().reset(scenario, seed))

        def step(self, action: Any) -> Tick:
            assert not self.over, "stepped after its end"
            return self._ended(super().step(action))

        def restore(self, snapshot: Any) -> None:
            self.over = False
            super().restore(snapshot)

        def _ended(self, tick: Tick) -> Tick:
            self.over = tick.index >= at
            ended = {"critical": "broke" if self.over else None, "goal": self.over}
            return replace(tick, **{end: ended.get(end, self.over)})

    check_simulator(Ends, SCENARIO, ACTIONS)


class Bare(Thermostat):
    """Without the optional parts."""

    render = Simulator.render
    snapshot = Simulator.snapshot
    restore = Simulator.restore

    def set_time_step(self, seconds: float) -> None:
        super().set_time_step(seconds)
        if seconds != 0.1:
            raise pytest_dura.ConfigurationError("only 0.1 s")


def test_a_channel_alias_of_no_channel_is_a_breach() -> None:
    class Misnamed(Thermostat):
        channel_aliases = {"warmth": "thermometre"}  # noqa: RUF012 - as the base declares it

    text = breaches(Misnamed)
    assert "the channel alias 'warmth' cannot be used: there is no channel 'thermometre'" in text


def test_optional_parts_may_be_missing_and_are_reported() -> None:
    report = check_simulator(Bare, SCENARIO, ACTIONS)
    assert report.not_supported == (
        "a time step of 0.05 s", "snapshot and restore", "render", "scene",
    )  # fmt: skip


class Shown(Thermostat):
    """A room and the heater that is perceived in it."""

    def scene(self, ticks: Any, percepts: Any) -> Any:
        poses = np.zeros((len(ticks), 1, 6), np.float32)
        poses[:, 0, 0] = [tick.truth["temperature"] for tick in ticks]
        seen = poses.copy()
        seen[::2] = np.nan
        lines = (Line("edge", np.zeros((3, 2), np.float32)),)
        return Scene(lines, Tracks(("room",), poses), Tracks(("heater",), seen), "room")


def test_a_scene_that_is_sound_passes() -> None:
    report = check_simulator(Shown, SCENARIO, ACTIONS)
    assert report.not_supported == ()
    assert "scene" in report.checked


def shows(**changes: Any) -> type[Thermostat]:
    """A room whose scene has other parts."""

    class Changed(Shown):
        def scene(self, ticks: Any, percepts: Any) -> Any:
            return replace(super().scene(ticks, percepts), **changes)

    return Changed


def poses(*shape: int, dtype: Any = np.float32, value: float = 0.0) -> Any:
    return np.full(shape, value, dtype)


@pytest.mark.parametrize(
    "changes, breach",
    [
        ({"lines": [Line("edge", poses(3, 2))]}, "lines is no tuple of Line"),
        ({"lines": (Line("edge", poses(2, 3)),)}, "lines[0].points is float32 of shape (2, 3)"),
        ({"lines": (Line("edge", poses(3, 2, value=np.nan)),)}, "lines[0].points is not finite"),
        ({"lines": (Line(3, poses(3, 2)),)}, "lines[0].kind is a int"),  # type: ignore[arg-type]
        ({"truth": Tracks(("room",), poses(9, 1, 6, dtype=float))}, "truth.poses is float64"),
        ({"truth": Tracks(("room",), poses(8, 1, 6))}, "(8, 1, 6), expected float32 of shape (9,"),
        ({"percept": Tracks((), poses(9, 1, 6))}, "percept.poses is float32 of shape (9, 1, 6)"),
        ({"percept": Tracks(("a", "a"), poses(9, 2, 6))}, "percept.ids has 'a' more than once"),
        ({"percept": Tracks(["a"], poses(9, 1, 6))}, "percept.ids is no tuple of texts"),  # type: ignore[arg-type]
        ({"percept": Tracks(("a",), poses(9, 1, 6, value=np.inf))}, "percept.poses is not finite"),
        ({"percept": None}, "percept is a NoneType"),
        ({"ego": None}, "ego is a NoneType"),
        ({"ego": "car"}, "ego is 'car', which is not in truth.ids"),
    ],
)
def test_a_scene_that_nobody_could_show_is_a_breach(changes: Any, breach: str) -> None:
    assert breach in breaches(shows(**changes))


class HalfAbsent(Shown):
    def scene(self, ticks: Any, percepts: Any) -> Any:
        shown = super().scene(ticks, percepts)
        shown.truth.poses[1, 0, 2] = np.nan
        return shown


class OtherScenes(Shown):
    """Shows another scene each time."""

    calls = 0

    def scene(self, ticks: Any, percepts: Any) -> Any:
        OtherScenes.calls += 1
        shown = super().scene(ticks, percepts)
        shown.truth.poses[:, 0, 1] = OtherScenes.calls
        return shown


class SceneHeats(Shown):
    """Warms up all rooms to come."""

    heat = 0.0

    def reset(self, scenario: Any, seed: int) -> Tick:
        super().reset(scenario, seed)
        self._temperature += self.heat
        return self._tick(())

    def scene(self, ticks: Any, percepts: Any) -> Any:
        self.heat = 1.0
        return super().scene(ticks, percepts)


class SceneEdits(Shown):
    def scene(self, ticks: Any, percepts: Any) -> Any:
        ticks[3].truth["temperature"] = 0.0
        return super().scene(ticks, percepts)


class NeedsTwoTicks(Shown):
    def scene(self, ticks: Any, percepts: Any) -> Any:
        return super().scene(ticks, percepts) if ticks[1] else None


class NotAScene(Shown):
    def scene(self, ticks: Any, percepts: Any) -> Any:
        return {}


@pytest.mark.parametrize(
    "kind, breach",
    [
        (HalfAbsent, "truth.poses is not finite where something is present"),
        (OtherScenes, "another instance has another scene, in .truth.poses"),
        (SceneHeats, "an instance, after scene differs at tick 0"),
        (SceneEdits, "scene changed ticks[3].truth['temperature']"),
        (NeedsTwoTicks, "scene: raised IndexError"),
        (NotAScene, "scene is a dict"),
    ],
)
def test_a_scene_is_shown_and_nothing_else_comes_of_it(kind: Any, breach: str) -> None:
    assert breach in breaches(kind)


class CountsFromOne(Thermostat):
    def _tick(self, events: Any) -> Tick:
        tick = super()._tick(events)
        return replace(tick, index=tick.index + 1)


class LateClock(Thermostat):
    def _tick(self, events: Any) -> Tick:
        tick = super()._tick(events)
        return replace(tick, time=tick.time + 0.05)


class FixedStep(Thermostat):
    """Takes any time step and goes on at 0.1 s."""

    def _tick(self, events: Any) -> Tick:
        return replace(super()._tick(events), time=self._index * 0.1)


class TakesAnyStep(Thermostat):
    def set_time_step(self, seconds: float) -> None:
        self.time_step = seconds


class GlobalRandom(Thermostat):
    def step(self, action: Any) -> Tick:
        self._temperature += random.random()
        return super().step(action)


class GlobalNumpy(Thermostat):
    def step(self, action: Any) -> Tick:
        self._temperature += float(np.random.normal())  # noqa: NPY002
        return super().step(action)


class ClassLevel(Thermostat):
    """Keeps a count on the class, as highway-env does with its settings."""

    resets = 0

    def reset(self, scenario: Any, seed: int) -> Tick:
        ClassLevel.resets += 1
        return super().reset(scenario, seed)

    def step(self, action: Any) -> Tick:
        self._temperature += 1e-9 * ClassLevel.resets
        return super().step(action)


class Forgetful(Thermostat):
    """Keeps its temperature over a reset."""

    def reset(self, scenario: Any, seed: int) -> Tick:
        kept = getattr(self, "_temperature", None)
        tick = super().reset(scenario, seed)
        if kept is not None:
            self._temperature = kept
            tick = self._tick(())
        return tick


class SharedWeather(Thermostat):
    """All instances draw from the generator of the one that was reset last."""

    weather: Any = None

    def reset(self, scenario: Any, seed: int) -> Tick:
        tick = super().reset(scenario, seed)
        SharedWeather.weather = self._weather
        return tick

    def step(self, action: Any) -> Tick:
        self._weather = SharedWeather.weather
        return super().step(action)


class NaNSignal(Thermostat):
    def signals(self, ticks: Any) -> Any:
        column = np.zeros(len(ticks))
        column[2] = np.nan
        return {"gap": column}


class ShortSignal(Thermostat):
    def signals(self, ticks: Any) -> Any:
        return {"gap": np.zeros(len(ticks) - 1)}


class IntSignal(Thermostat):
    def signals(self, ticks: Any) -> Any:
        return {"gap": np.zeros(len(ticks), dtype=int)}


class Foresees(Thermostat):
    """Its signal is the greatest temperature of the episode, from the first tick on."""

    def signals(self, ticks: Any) -> Any:
        temperature = super().signals(ticks)["temperature"]
        return {"peak": np.full(len(ticks), temperature.max())}


class SaysThatItForesees(Foresees):
    hindsight = frozenset({"peak"})


class NoSignal(Thermostat):
    def signals(self, ticks: Any) -> Any:
        return {}


class WrongPerceptSignal(Thermostat):
    def percept_signals(self, percepts: Any) -> Any:
        return {"gap": [1.0]}


class Reuses(Thermostat):
    """Hands out its one state array, writeable, at every tick."""

    def reset(self, scenario: Any, seed: int) -> Tick:
        self._array = np.zeros(1)
        return super().reset(scenario, seed)

    def _tick(self, events: Any) -> Tick:
        self._array[0] = self._temperature
        tick = super()._tick(events)
        return replace(tick, truth={**tick.truth, "state": self._array})


class ListChannel(Thermostat):
    def _tick(self, events: Any) -> Tick:
        tick = super()._tick(events)
        return replace(tick, channels={**tick.channels, "lidar": ({"id": "V1"},)})


class TakesAnything(Thermostat):
    def check_action(self, action: Any) -> Any:
        return 0.0


class RaisesTypeError(Thermostat):
    def check_action(self, action: Any) -> Any:
        return super().check_action(action + 0.0)


class AddressInText(Thermostat):
    def describe_action(self, action: Any) -> str:
        return repr(object())


class BadFallback(Thermostat):
    def fallback_action(self) -> Any:
        return None


class Forgets(Thermostat):
    """A snapshot without the random generator."""

    def snapshot(self) -> object:
        return {name: value for name, value in vars(self).items() if name != "_weather"}


class OneUse(Thermostat):
    """Hands out a snapshot that the simulator goes on to change."""

    def snapshot(self) -> object:
        return dict(vars(self))

    def restore(self, snapshot: Any) -> None:
        vars(self).update(snapshot)


class TwoUses(Thermostat):
    """Copies when it takes a snapshot, and hands over that very copy."""

    def restore(self, snapshot: Any) -> None:
        vars(self).update(snapshot)


class NumpyIndex(Thermostat):
    def _tick(self, events: Any) -> Tick:
        tick = super()._tick(events)
        return replace(tick, index=np.int64(tick.index))


class CriticalFlag(Thermostat):
    def _tick(self, events: Any) -> Tick:
        return replace(super()._tick(events), critical=False)


class CopiesGlobal(Thermostat):
    """Reads the global generator without moving it on."""

    def step(self, action: Any) -> Tick:
        copy = random.Random()
        copy.setstate(random.getstate())
        self._temperature += copy.random()
        return super().step(action)


class DriftingSignal(Thermostat):
    calls = 0

    def signals(self, ticks: Any) -> Any:
        DriftingSignal.calls += 1
        return {"gap": np.full(len(ticks), float(DriftingSignal.calls))}


class Black(Thermostat):
    def render(self) -> Any:
        return np.zeros((4, 6, 3), dtype=np.uint8)


class Grey(Thermostat):
    def render(self) -> Any:
        return np.ones((4, 6))


class RenderMoves(Thermostat):
    def render(self) -> Any:
        self._weather.random()
        return super().render()


class StaleCamera(Thermostat):
    """Its lazy channel shows the present, not the tick it belongs to."""

    def _tick(self, events: Any) -> Tick:
        tick = super()._tick(events)
        return replace(tick, channels={**tick.channels, "camera": Lazy(lambda: self._temperature)})


class CloseFails(Thermostat):
    def close(self) -> None:
        raise OSError("window is gone")


class CloseSpreads(Thermostat):
    closed = 0

    def close(self) -> None:
        CloseSpreads.closed += 1

    def step(self, action: Any) -> Tick:
        self._temperature += CloseSpreads.closed
        return super().step(action)


class EditsScenario(Thermostat):
    def reset(self, scenario: Any, seed: int) -> Tick:
        tick = super().reset(scenario, seed)
        scenario["world"]["seen"] = True
        return tick


class OddEvent(Thermostat):
    def _tick(self, events: Any) -> Tick:
        return replace(super()._tick(events), events=(("collision", "V1"),))


@pytest.mark.parametrize(
    "kind, breach",
    [
        (CountsFromOne, "tick number 0 has the index 1"),
        (LateClock, "tick 0 has the time 0.05 s, expected 0 s"),
        (FixedStep, "after set_time_step(0.05) the first tick is at 0.1 s"),
        (TakesAnyStep, "set_time_step(nan) is accepted"),
        (GlobalRandom, "another instance differs at tick 1 in .truth['temperature']"),
        (GlobalNumpy, "another instance differs at tick 1"),
        (ClassLevel, "differs at tick 1"),
        (Forgetful, "an instance after another episode differs at tick 0"),
        (SharedWeather, "an instance stepped in turn with another differs at tick 1"),
        (NaNSignal, "signals['gap'] is not finite at tick 2"),
        (ShortSignal, "signals['gap'] is float64 of shape (8,), expected float64 of shape (9,)"),
        (IntSignal, "signals['gap'] is int64 of shape (9,)"),
        (Foresees, "signals['peak'] of the first 1 ticks changes once more have followed"),
        (NoSignal, "there are no signals"),
        (WrongPerceptSignal, "percept_signals['gap'] is list of shape (1,)"),
        (Reuses, ".truth['state'] of tick 0 was changed by a later step"),
        (Reuses, "truth['state'] is not read-only: the value (a writeable array)"),
        (ListChannel, "channels['lidar'] is not read-only: [0] (a dict)"),
        (TakesAnything, "check_action(None) accepts it"),
        (TakesAnything, "check_action(nan) accepts it"),
        (RaisesTypeError, "check_action(None) raises TypeError"),
        (AddressInText, "describe_action gives '<object object at 0x"),
        (BadFallback, "fallback action: raised TypeError"),
        (Forgets, "the first return to a snapshot differs at tick 5"),
        (OneUse, "the first return to a snapshot differs at tick 5"),
        (TwoUses, "the second return to a snapshot differs at tick 5"),
        (NumpyIndex, "tick number 0 has the index np.int64(0)"),
        (CriticalFlag, "critical is False at tick 0"),
        (CopiesGlobal, "another instance differs at tick 1 in .truth['temperature']"),
        (DriftingSignal, "another instance has another signal ['gap']"),
        (Black, "the rendered picture is all black"),
        (Grey, "render gives float64 (4, 6)"),
        (RenderMoves, "with rendering differs at tick 1"),
        (StaleCamera, "lazy channel 'camera' shows another instant"),
        (CloseFails, "close: raised OSError: window is gone"),
        (CloseSpreads, "an instance, after another was closed differs at tick 1"),
        (EditsScenario, "the scenario was changed at ['world']['seen']"),
        (OddEvent, "tick 0 has the event ('collision', 'V1')"),
    ],
)
def test_a_breach_is_named_with_its_remedy(kind: Any, breach: str) -> None:
    text = breaches(kind, {"world": {"start": 18.0}})
    assert breach in text
    assert text.count("remedy:") == text.count("\n") / 2


def test_a_signal_that_hindsight_gives_may_say_so() -> None:
    assert check_simulator(SaysThatItForesees, {"world": {"start": 5.0}}, ACTIONS).subject


def test_all_breaches_are_told_at_once() -> None:
    class Bad(TakesAnything, NaNSignal, Black):
        pass

    text = breaches(Bad)
    assert "3. " in text
    for words in ("check_action(None)", "not finite", "all black"):
        assert words in text


def test_what_cannot_run_at_all_is_a_breach() -> None:
    class Dead(Thermostat):
        def reset(self, scenario: Any, seed: int) -> Tick:
            raise RuntimeError("no licence")

    assert "an episode can be run: raised RuntimeError: no licence" in breaches(Dead)
    assert "the factory gave a dict, not a Simulator" in breaches(dict)


def test_the_kit_leaves_global_randomness_as_it_found_it() -> None:
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    before = random.getstate(), np.random.get_state()[1].tolist()  # noqa: NPY002
    check_simulator(Thermostat, SCENARIO, ACTIONS)
    assert (random.getstate(), np.random.get_state()[1].tolist()) == before  # noqa: NPY002


class Single(Thermostat):
    """As a server with one world: it can be reset by whoever is there alone."""

    instances = "one per process"
    newest: Any = None

    def reset(self, scenario: Any, seed: int) -> Tick:
        if type(self).newest not in (None, self):
            raise RuntimeError("another one is there")
        type(self).newest = self
        return super().reset(scenario, seed)

    def close(self) -> None:
        type(self).newest = None


class Several(Single):
    instances = "many"


def test_of_simulators_with_one_per_process_none_is_stepped_in_turn_with_another() -> None:
    report = check_simulator(Single, SCENARIO, ACTIONS)
    assert not any("close leaves" in text for text in report.checked)
    assert Single.newest is None
    assert "another one is there" in breaches(Several)


class Drafty(Thermostat):
    """Not deterministic: the temperature differs by up to 0.01 between repetitions."""

    deterministic = False
    tolerances = {"temperature": 0.05}  # noqa: RUF012 - a declaration
    drafts = random.Random(7)

    def _tick(self, events: Any) -> Tick:
        tick = super()._tick(events)
        blown = self._temperature + self.drafts.uniform(0.0, 0.01)
        return replace(tick, truth={**tick.truth, "temperature": blown})


def test_a_simulator_that_is_not_deterministic_is_compared_within_its_tolerances() -> None:
    check_simulator(Drafty, SCENARIO, ACTIONS)

    class Strict(Drafty):
        tolerances = {"temperature": 0.001}  # noqa: RUF012 - a declaration

    class Silent(Drafty):
        tolerances = {}  # noqa: RUF012 - a declaration

    class Claiming(Drafty):
        deterministic = True

    assert "temperature differs by 0.0" in breaches(Strict)
    assert "declares no tolerances" in breaches(Silent)
    assert "differs at tick 0" in breaches(Claiming)


def test_declarations_and_the_scenarios_world_are_checked() -> None:
    class Wrong(Thermostat):
        instances = "a few"  # type: ignore[assignment]
        tolerances = {"temperature": -1.0}  # noqa: RUF012 - a declaration
        lacks = {"start": "it is never warm", "fuse": ""}  # noqa: RUF012 - a declaration

        @classmethod
        def check_scenario(cls, world: Any) -> dict[str, Any]:
            return {**world, "start": world["start"] + 1.0}

    text = breaches(Wrong)
    for part in ("instances is 'a few'", "tolerance of temperature is -1.0", "lacks has 'fuse'",
                 "check_scenario changes its own result at ['start']",
                 "the scenario needs start, which it lacks: it is never warm"):  # fmt: skip
        assert part in text, text
