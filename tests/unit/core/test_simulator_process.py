"""What a class of simulators holds of its process, and what it says of itself."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter
from typing import Any

import numpy as np
import pytest
from thermostat import Controller, Thermostat

from pytest_dura import ConfigurationError, EpisodeSpec, RoleSpec, Tick
from pytest_dura.core.simulator import Simulator, beyond_tolerance
from pytest_dura.core.simulator_process import close_classes, open_class, simulating
from pytest_dura.execution import child, run_episode


class Server(Thermostat):
    """Counts what outlives episodes, which a server would."""

    calls: Counter[str] = Counter()  # noqa: RUF012 - shared on purpose
    alive = 0

    @classmethod
    def open_process(cls) -> None:
        cls.calls["open"] += 1

    @classmethod
    def close_process(cls) -> None:
        cls.calls["close"] += 1

    def reset(self, scenario: Any, seed: int) -> Tick:
        assert self.calls["open"] == self.calls["close"] + 1
        return super().reset(scenario, seed)


class Unreachable(Thermostat):
    @classmethod
    def open_process(cls) -> None:
        raise OSError("no answer on port 2000")


class Stubborn(Server):
    calls: Counter[str] = Counter()  # noqa: RUF012 - as above

    @classmethod
    def close_process(cls) -> None:
        super().close_process()
        raise OSError("the server does not end")


class Single(Thermostat):
    """Fails where two of its kind are alive."""

    instances = "one per process"
    alive = 0
    most = 0

    def reset(self, scenario: Any, seed: int) -> Tick:
        type(self).alive += 1
        type(self).most = max(self.most, self.alive)
        time.sleep(0.02)
        return super().reset(scenario, seed)

    def close(self) -> None:
        type(self).alive -= 1


class Nesting(Controller):
    """Simulates by itself, in the simulator that it is in."""

    def propose(self, view: Any) -> Any:
        run_episode(spec_of(Single))
        return super().propose(view)


def spec_of(simulator: type[Simulator], generator: type = Controller, run: int = 0) -> EpisodeSpec:
    return EpisodeSpec(
        "room",
        run,
        run,
        RoleSpec.of(simulator),
        {"generator": RoleSpec.of(generator)},
        {"name": "room", "duration": 1.0, "world": {}},
    )


@pytest.fixture(autouse=True)
def _closed():
    yield
    close_classes()
    for kind in (Server, Stubborn):
        kind.calls.clear()
    Single.alive = Single.most = 0


def test_a_class_is_opened_once_for_all_episodes_of_a_process_and_closed_at_its_end():
    for run in range(3):
        assert run_episode(spec_of(Server, run=run)).failure is None
    assert Server.calls == {"open": 1}
    assert close_classes() == []
    assert Server.calls == {"open": 1, "close": 1}
    assert close_classes() == []
    run_episode(spec_of(Server))
    assert Server.calls["open"] == 2


def test_what_cannot_be_opened_refuses_the_episode_by_name():
    with pytest.raises(
        ConfigurationError, match=r"Unreachable cannot be opened.*no answer on port"
    ):
        run_episode(spec_of(Unreachable))


def test_a_class_that_cannot_be_closed_is_named_and_the_others_are_closed():
    open_class(Server)
    open_class(Stubborn)
    (problem,) = close_classes()
    assert problem.startswith("Stubborn cannot be closed: OSError: the server does not end")
    assert Server.calls == {"open": 1, "close": 1}


def test_a_process_that_simulates_for_others_closes_before_it_gives_way():
    open_class(Server)
    child._close_simulators()
    assert Server.calls == {"open": 1, "close": 1}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_copy_of_the_process_leaves_it_to_its_parent():
    open_class(Server)
    child = os.fork()
    if child == 0:
        close_classes()
        os._exit(Server.calls["close"])
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    close_classes()
    assert Server.calls["close"] == 1


def test_of_a_class_with_one_per_process_threads_run_one_episode_after_the_other():
    failures: list[str | None] = []
    threads = [
        threading.Thread(target=lambda: failures.append(run_episode(spec_of(Single)).failure))
        for _ in range(3)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20.0)
    assert failures == [None] * 3
    assert Single.most == 1


def test_an_episode_inside_another_one_of_the_same_class_is_refused_and_does_not_hang():
    with (
        simulating(Single),
        pytest.raises(ConfigurationError, match="begins while another one runs"),
        simulating(Single),
    ):
        pass
    episode = run_episode(spec_of(Single, Nesting))
    (event, *_) = [event for event in episode.events if event.kind == "component_failure"]
    assert "one per process" in event.detail
    assert run_episode(spec_of(Single)).failure is None


def test_tolerances_compare_the_signals_that_they_name_over_common_ticks():
    signals = {"x": np.array([0.0, 1.0, 2.0]), "other": np.zeros(3)}
    near = {"x": np.array([0.05, 1.0]), "other": np.ones(2)}
    assert beyond_tolerance({"x": 0.1}, signals, near) is None
    text = "x differs by 0.05 at tick 0, tolerance 0.01"
    assert beyond_tolerance({"x": 0.01}, signals, near) == text
    assert "not" not in str(beyond_tolerance({}, signals, near))
    assert "no signal of both" in str(beyond_tolerance({"y": 1.0}, signals, near))
    assert "differs" in str(beyond_tolerance({"x": 1.0}, signals, {"x": np.array([np.nan])}))


def test_what_is_lacking_is_found_where_the_world_gives_it_a_value():
    class Poor(Thermostat):
        lacks = {  # noqa: RUF012 - a declaration
            "people": "nobody lives here",
            "weather.rain": "there is a roof",
            "channels.radio": "none is built in",
        }

    def lacking(world: dict[str, Any]) -> list[str]:
        return [key for key, _, _ in Poor.lacking(world)]

    assert lacking({}) == lacking({"people": [], "weather": {"rain": None}}) == []
    assert lacking({"people": ["A"], "weather": {"rain": 0.5}}) == ["people", "weather.rain"]
    assert lacking({"weather": "rain", "radio": 1}) == []


def test_the_base_takes_any_world_as_it_is():
    world = {"start": 18.0}
    assert Thermostat.check_scenario(world) == world
    assert Thermostat.check_scenario(world) is not world
