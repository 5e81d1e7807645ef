"""The digest: equal for equal specs wherever and whenever they run, and for nothing else."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from thermostat import Thermostat

from pytest_dura import (
    Episode,
    EpisodeSpec,
    Fault,
    Orchestrator,
    Policy,
    RoleSpec,
    Termination,
    Tick,
)

BIAS = Fault("bias", "bias", "thermometer", {"at": 0.5}, 0.3)


def full_spec(**changes: Any) -> EpisodeSpec:
    spec = EpisodeSpec(
        case="room/bias",
        run=4,
        seed=20,
        simulator=RoleSpec("thermostat:Thermostat"),
        roles={
            "generator": RoleSpec("thermostat:Controller", {"target": 16.0}),
            "safety_monitor": RoleSpec("thermostat:HeatMonitor", {"limit": 15.5}),
            "security_assessor": RoleSpec("thermostat:JumpWatch"),
            "fault_injector": RoleSpec("thermostat:Bias", {"bias": -4.0}),
            "performance_oracle": RoleSpec("thermostat:Meter"),
            "recovery_planner": RoleSpec("thermostat:SwitchOff"),
            "night_watch": RoleSpec("thermostat:NightWatch"),
        },
        scenario={"world": {"start": 15.0}},
        faults=(BIAS,),
        policy=Policy.parse("refine(2)"),
        termination=Termination(3.0),
    )
    return replace(spec, **changes)


def run(spec: EpisodeSpec) -> Episode:
    return Orchestrator.build(spec).run(spec)


def test_the_same_spec_gives_the_same_digest_in_one_process() -> None:
    assert run(full_spec()).digest == run(full_spec()).digest


def test_other_episodes_in_between_change_nothing() -> None:
    before = run(full_spec()).digest
    run(full_spec(seed=99, faults=()))
    np.random.seed(5)  # noqa: NPY002 - the global state that nobody may read
    assert run(full_spec()).digest == before


def test_the_order_of_declaration_changes_nothing() -> None:
    spec = full_spec()
    shuffled = replace(spec, roles=dict(reversed(spec.roles.items())))
    assert run(shuffled).digest == run(spec).digest


@pytest.mark.parametrize("hash_seed", ["0", "4242"])
def test_the_digest_is_the_same_in_a_fresh_process(hash_seed: str) -> None:
    program = (
        "import json, sys\n"
        "from pytest_dura import EpisodeSpec, Orchestrator\n"
        "spec = EpisodeSpec.from_json(json.loads(sys.stdin.read()))\n"
        "print(Orchestrator.build(spec).run(spec).digest)\n"
    )
    path = os.pathsep.join(entry for entry in sys.path if entry)
    done = subprocess.run(
        [sys.executable, "-c", program],
        input=json.dumps(full_spec().to_json()),
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": path},
    )
    assert done.stdout.strip() == run(full_spec()).digest


@pytest.mark.parametrize(
    "changes",
    [
        {"seed": 21},
        {"run": 5},
        {"case": "room/other"},
        {"policy": Policy("log_only")},
        {"termination": Termination(2.9)},
        {"time_step": 0.05},
        {"time_budget": 4.0},
        {"faults": ()},
        {"scenario": {"world": {"start": 15.001}}},
        {"roles": {"generator": RoleSpec("thermostat:Controller", {"target": 16.0})}},
    ],
)
def test_anything_that_determines_the_trace_changes_the_digest(changes: dict[str, Any]) -> None:
    assert run(full_spec(**changes)).digest != run(full_spec()).digest
    assert full_spec(**changes).key != full_spec().key


def test_another_seed_gives_another_trace() -> None:
    one, other = run(full_spec()), run(full_spec(seed=21))
    assert one.signals["temperature"].tobytes() != other.signals["temperature"].tobytes()


def test_a_role_more_shifts_nobodys_draws() -> None:
    spec = full_spec()
    fewer = replace(spec, roles={n: r for n, r in spec.roles.items() if n != "night_watch"})
    one, other = run(spec), run(fewer)
    assert one.signals["temperature"].tobytes() == other.signals["temperature"].tobytes()


@pytest.mark.parametrize(
    "spoil",
    [
        lambda e: e.signals["temperature"].__setitem__(3, 1.0),
        lambda e: e.decisions["attempts"].__setitem__(0, 7),
        lambda e: e.decisions["executed"].__setitem__(0, "1%"),
        lambda e: e.time.__setitem__(3, 9.0),
        lambda e: setattr(e, "events", e.events[1:]),
        lambda e: setattr(e, "termination", "goal"),
        lambda e: setattr(e, "failure", "infrastructure: x"),
        lambda e: setattr(e, "timeouts", (1,)),
        lambda e: setattr(e, "faults", (replace(e.faults[0], detected_at=0.1),)),
        lambda e: setattr(e, "faults", (replace(e.faults[0], activations=7),)),
        lambda e: setattr(e, "faults", (replace(e.faults[0], recovered_at=0.1),)),
        lambda e: e.metrics.robustness["safety_monitor"][1].__setitem__(0, 0.0),
        lambda e: e.signals.__setitem__("verdict", e.signals.pop("temperature")),
    ],
)
def test_everything_in_an_episode_counts(spoil: Any) -> None:
    episode = run(full_spec())
    spoil(episode)
    assert episode.digest != run(full_spec()).digest


@pytest.mark.parametrize(
    "spoil",
    [
        lambda e: e.metrics.processing_ns["generator"][1].__setitem__(0, 1),
        lambda e: e.metrics.wall_clock.clear(),
        lambda e: e.metrics.user.__setitem__("x", 1.0),
    ],
)
def test_timings_do_not_count(spoil: Any) -> None:
    episode = run(full_spec())
    spoil(episode)
    assert episode.digest == run(full_spec()).digest


def test_a_signal_named_like_a_decision_counts_too() -> None:
    episode, other = run(full_spec()), run(full_spec())
    for one, value in ((episode, 0.0), (other, 1.0)):
        one.signals["verdict"] = np.full(one.ticks, value)
    assert episode.digest != other.digest


def test_an_episode_can_be_pickled() -> None:
    episode = run(full_spec())
    copy = pickle.loads(pickle.dumps(episode))
    assert copy.digest == episode.digest
    assert copy.events == episode.events


def test_ids_and_names() -> None:
    episode = run(full_spec())
    assert (episode.id, episode.spec.id, episode.spec.component) == (
        "room/bias#4",
        "room/bias#4",
        "Controller",
    )


def test_runs_that_differ_by_their_seed_alone_have_one_trajectory_and_two_digests() -> None:
    one = full_spec(simulator=RoleSpec(f"{__name__}:Calm"))
    first, second = run(one), run(replace(one, run=5, seed=21))
    assert first.trajectory == second.trajectory
    assert first.digest != second.digest
    assert run(full_spec()).trajectory != run(full_spec(seed=21)).trajectory


def test_what_the_component_says_is_no_part_of_the_trajectory() -> None:
    episode = run(full_spec())
    told = replace(episode, signals={**episode.signals, "proposal.age": episode.time})
    assert told.trajectory == episode.trajectory
    perceived = replace(episode, signals={**episode.signals, "percept.noise": episode.time})
    assert perceived.trajectory != episode.trajectory


def test_it_is_known_whether_anything_was_drawn() -> None:
    assert run(full_spec()).drawn
    assert not run(full_spec(simulator=RoleSpec(f"{__name__}:Calm"))).drawn


class Calm(Thermostat):
    """A room without weather."""

    def step(self, action: Any) -> Tick:
        self._temperature += (8.0 * action - 0.1) * self.time_step
        self._index += 1
        return self._tick(())
