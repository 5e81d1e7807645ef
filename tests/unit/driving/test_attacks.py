"""Faults through the whole loop: they change the percept, and nothing else."""

from __future__ import annotations

import functools
from typing import Any, ClassVar

import numpy as np
import pytest
from roads import SCENARIOS, SIX, run, spec_of_drive, truth_of

from pytest_dura import Episode
from pytest_dura.core import RoleSpec
from pytest_dura.driving import Aggressive
from pytest_dura.library import expand_cases, load_scenarios

WORLD: dict[str, Any] = {
    "ego": {"distance": 50.0, "speed": 8.0},
    "traffic": {"headway": 8.0},
    "vehicles": [{"id": "E", "arm": "east", "distance": 70.0}],
    "pedestrians": [{"id": "P1", "arm": "north", "start": 1.0}],
}
GHOST = {"type": "ghost-obstacle", "activation": {"at": 1.0}, "duration": 2.0}
SPOOF = {"type": "trajectory-spoof", "activation": {"at": 0.8}, "duration": 3.0}


class Oblivious(Aggressive):
    """Drives the same whatever it is shown, but looks at it: a fault must reach it to manifest."""

    def propose(self, view: Any) -> Any:
        """Read all that is cheap, and ignore it."""
        for name in view.percept:
            if not name.startswith("camera"):
                _ = view.percept[name]
        return super().propose(view)


def episode(*faults: Any, **options: Any) -> Episode:
    options.setdefault("generator", RoleSpec("test_attacks:Oblivious"))
    found = run(spec_of_drive(WORLD, faults=faults, **options))
    assert found.failure is None
    return found


@functools.cache
def clean_episode(duration: float | None = None) -> Episode:
    """That without a fault, which is the same for every test."""
    return episode() if duration is None else episode(duration=duration)


@pytest.mark.parametrize(
    "faults", [[GHOST], [SPOOF], [GHOST, SPOOF]], ids=["ghost", "spoof", "both"]
)
def test_ground_truth_is_bit_identical_with_and_without_the_fault(faults: list[Any]) -> None:
    clean, attacked = clean_episode(), episode(*faults)
    assert truth_of(attacked) == truth_of(clean)
    assert attacked.decisions["executed"].tolist() == clean.decisions["executed"].tolist()
    assert attacked.termination == clean.termination
    assert all(fault.success for fault in attacked.faults)
    assert attacked.validity == "valid"
    different = attacked.signals["percept.gap"] != clean.signals["percept.gap"]
    assert different.any(), "the percept is another one"
    assert not different[:8].any(), "but not before the attack"


@pytest.mark.parametrize("name", SIX)
def test_ground_truth_is_bit_identical_in_the_built_in_scenarios(name: str) -> None:
    scenarios = load_scenarios([SCENARIOS / "intersection"])
    (clean,) = expand_cases([scenarios[name]], ["none"])
    (attacked,) = expand_cases([scenarios[name]], ["ghost-obstacle+trajectory-spoof"])
    roles = {"generator": RoleSpec("test_attacks:Oblivious")}
    one, other = (run(case.spec(0, 11, roles, policy="log_only")) for case in (clean, attacked))
    assert one.failure is None
    assert other.failure is None
    assert truth_of(one) == truth_of(other)


def test_a_component_that_believes_it_drives_otherwise() -> None:
    clean, attacked = (episode(*f, generator="reactive") for f in ([], [GHOST]))
    assert truth_of(attacked) != truth_of(clean)


def test_a_spoof_of_magnitude_zero_is_no_fault_and_counts_as_not_manifested() -> None:
    idle = {**SPOOF, "parameters": {"magnitude": 0.0}}
    clean, attacked = clean_episode(), episode(idle)
    for name, column in clean.signals.items():
        assert column.tobytes() == attacked.signals[name].tobytes()
    (record,) = attacked.faults
    assert record.activated_at is not None
    assert record.manifested_at is None
    assert attacked.validity == "invalid"
    assert attacked.invalid_reason == "never manifested: trajectory-spoof"


def test_an_attack_that_the_component_does_not_read_reaches_the_roles_that_do() -> None:
    attacked = episode(GHOST, generator="aggressive")
    (record,) = attacked.faults
    assert record.activated_at is not None
    assert "generator" not in record.read_by
    assert "safety_monitor" in record.read_by
    assert attacked.validity == "valid"


@pytest.mark.parametrize("by", ["fault_injector", "security_assessor"])
@pytest.mark.parametrize("at", [0.5, 1.0, 1.7])
def test_at_is_the_first_tampered_tick_whoever_activates_it(by: str, at: float) -> None:
    ghost = {**GHOST, "activation": {"at": at, "by": by}, "duration": 1.0}
    attacked = episode(ghost)
    (record,) = attacked.faults
    assert record.manifested_at == pytest.approx(at)
    assert record.manifest_ticks == 10
    assert record.activated_at == pytest.approx(at)
    assert record.deactivated_at == pytest.approx(at + 1.0), "the first tick without it"
    clean = clean_episode()
    tampered = attacked.signals["percept.gap"] != clean.signals["percept.gap"]
    first = round(at / 0.1)
    assert np.flatnonzero(tampered)[0] == first
    assert np.flatnonzero(tampered)[-1] <= first + 9


@pytest.mark.parametrize("by", ["fault_injector", "security_assessor"])
def test_a_command_is_attacked_at_its_time_whoever_begins_it(by: str) -> None:
    attack = {
        "type": "bias",
        "target": "command.acceleration",
        "activation": {"at": 1.0, "every": 2.0, "by": by},
        "duration": 0.5,
        "parameters": {"offset": -2.0},
    }
    attacked = episode(attack, duration=6.0)
    activated = [event.tick for event in attacked.events if event.kind == "fault_activated"]
    assert activated == [10, 30, 50]
    clean = clean_episode(6.0)
    speeds = [found.signals["speed"] for found in (clean, attacked)]
    assert np.flatnonzero(speeds[0] != speeds[1])[0] == 11, "it shows in the state that follows"


def test_a_planned_fault_at_the_very_beginning() -> None:
    attacked = episode({**GHOST, "activation": {"at": 0.0}, "duration": 0.5})
    (record,) = attacked.faults
    assert record.manifested_at == 0.0
    assert record.manifest_ticks == 5


def test_a_directed_attack_without_an_assessor_never_happens() -> None:
    ghost = {**GHOST, "activation": {"at": 1.0, "by": "security_assessor"}}
    attacked = episode(ghost, roles={"security_assessor": None})
    assert attacked.faults[0].activated_at is None
    assert attacked.validity == "invalid"


def test_periodic_attacks_come_again() -> None:
    for by in ("fault_injector", "security_assessor"):
        activation = {"at": 1.0, "every": 2.0, "by": by}
        attacked = episode({**GHOST, "activation": activation, "duration": 0.5}, duration=6.0)
        activated = [event.tick for event in attacked.events if event.kind == "fault_activated"]
        assert activated == [10, 30, 50]
        assert attacked.faults[0].manifest_ticks == 15


def test_a_second_fault_leaves_the_first_one_as_it_was() -> None:
    alone, both = episode(GHOST), episode(GHOST, SPOOF)
    one, same = alone.faults[0], both.faults[0]
    assert (one.activated_at, one.manifest_ticks) == (same.activated_at, same.manifest_ticks)

    def ghosts(found: Episode) -> list[str]:
        return [e.subject for e in found.events if e.kind == "alert" and e.subject[:2] == "V9"]

    assert ghosts(alone)
    assert set(ghosts(alone)) == set(ghosts(both))


def directed(**activation: Any) -> dict[str, Any]:
    """A short ghost that the SecurityAssessor directs."""
    return {**GHOST, "activation": {**activation, "by": "security_assessor"}, "duration": 0.5}


def activations(attacked: Episode, fault: str = "ghost-obstacle") -> list[int]:
    events = [event for event in attacked.events if event.kind == "fault_activated"]
    return [event.tick for event in events if event.subject == fault]


def test_the_assessor_attacks_where_what_it_perceives_begins_to_meet_a_condition() -> None:
    attacked = episode(directed(when="odometry.speed > 9"))
    fast = int(np.flatnonzero(attacked.signals["speed"] > 9.0)[0])
    assert activations(attacked) == [fast + 1], "it directs, and the next percept is tampered"


def test_the_assessor_attacks_by_what_the_component_proposes() -> None:
    # At 8 m/s `aggressive` accelerates towards 10 m/s at once, `reactive` towards 9 m/s.
    attack = directed(when="proposal.acceleration > 1.5")
    assert activations(episode(attack, generator="aggressive")) == [1]
    (later,) = activations(episode(attack, generator="reactive"))
    assert later > 10, "once it has braked"


def test_the_assessor_attacks_after_another_fault() -> None:
    spoof = {**SPOOF, "activation": {"at": 1.0}, "duration": 0.5}
    begun = directed(after={"fault": "trajectory-spoof"})
    ended = directed(after={"fault": "trajectory-spoof", "event": "deactivated", "delay": 1.0})
    assert activations(episode(spoof, begun)) == [12], "seen at tick 11, after the injector told"
    assert activations(episode(spoof, ended)) == [25], "a second after the end at tick 15"


def test_a_directed_attack_on_a_condition_happens_once_unless_told_otherwise() -> None:
    often = "proposal.acceleration > -9"
    window = {"not_before": 1.0, "not_after": 1.0}
    assert activations(episode(directed(when=often, **window))) == [11]
    assert activations(episode(directed(when=often))) == [1]


def test_a_ghost_at_the_junction_stands_beyond_the_stop_line_wherever_the_ego_is() -> None:
    parameters = {"place": "junction", "ahead": 1.0, "lateral": -4.0, "heading": 1.57, "speed": 1.5}
    world = {"ego": {"distance": 50.0, "speed": 8.0}}
    places = []
    for at in (0.5, 2.5):
        spec = spec_of_drive(
            world,
            generator=RoleSpec("test_attacks:Noting"),
            faults=[{**GHOST, "activation": {"at": at}, "parameters": parameters}],
            duration=4.0,
        )
        Noting.seen.clear()
        assert run(spec).failure is None
        places.append(Noting.seen[:11:10])
    early, late = places
    # The ego comes from the south on x = 2; its stop line lies at y = 11, and y points south.
    x, y, heading, vx, vy = early[0][1:6]
    assert (x, y) == pytest.approx((-2.0, 11.0 - 1.0 - 2.5))
    assert heading == pytest.approx(0.0, abs=0.01), "across the lane"
    assert (vx, vy) == pytest.approx((1.5, 0.0), abs=0.01)
    assert early[1][1] == pytest.approx(-2.0 + 1.5, abs=0.01), "a second later it has crept on"
    assert late[0][1:6] == pytest.approx(early[0][1:6])


class Noting(Oblivious):
    """Notes the ghosts that lidar reports."""

    seen: ClassVar[list[Any]] = []

    def propose(self, view: Any) -> Any:
        """Note, and drive on."""
        self.seen += [body for body in view.percept["lidar"] if body.id.startswith("V9")]
        return super().propose(view)


def test_the_spoofed_car_is_the_nearest_or_the_nearest_oncoming_one() -> None:
    world = {
        "ego": {"distance": 50.0, "speed": 8.0},
        "vehicles": [
            {"id": "NEAR", "arm": "east", "distance": 20.0},
            {"id": "ONCOMING", "arm": "north", "distance": 60.0},
        ],
    }
    for victim, expected in (("nearest", "NEAR"), ("oncoming", "ONCOMING")):
        fault = {**SPOOF, "parameters": {"victim": victim}}
        shifted = {
            body.id
            for clean, false in zip(percepts(world, []), percepts(world, [fault]), strict=True)
            for body in clean
            if body != false.get(body.id)
        }
        assert shifted == {expected}


def percepts(world: Any, faults: list[Any]) -> list[Any]:
    """What lidar reports in the first three seconds."""
    Recording.seen.clear()
    found = run(
        spec_of_drive(
            world, generator=RoleSpec("test_attacks:Recording"), faults=faults, duration=3.0
        )
    )
    assert found.failure is None
    return list(Recording.seen)


class Recording(Oblivious):
    """Notes all that lidar reports."""

    seen: ClassVar[list[Any]] = []

    def propose(self, view: Any) -> Any:
        """Note, and drive on."""
        self.seen.append(view.percept["lidar"])
        return super().propose(view)


def test_without_an_oncoming_car_a_spoof_of_one_waits() -> None:
    world = {
        "ego": {"distance": 50.0, "speed": 8.0},
        "vehicles": [{"id": "E", "arm": "east", "distance": 50.0}],
    }
    fault = {**SPOOF, "parameters": {"victim": "oncoming"}}
    generator = RoleSpec("test_attacks:Oblivious")
    attacked = run(spec_of_drive(world, generator=generator, faults=[fault]))
    assert attacked.failure is None
    assert attacked.faults[0].manifested_at is None
    assert attacked.validity == "invalid"
