"""Faults through a real loop: commands, chains on what manifested, directives, misuse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from injecting import fault
from loops import doing, run_loop
from thermostat import Controller, HeatMonitor, SwitchOff, Thermostat

from pytest_dura import (
    ConfigurationError,
    Episode,
    Proposal,
    SecurityAssessment,
    SecurityAssessor,
)
from pytest_dura.faults import CampaignInjector


class Room(Thermostat):
    """A thermostat whose heater fills in what ``auto`` leaves to it."""

    def check_action(self, action: Any) -> Any:
        return action if action == "auto" else super().check_action(action)

    def actuation(self, action: Any) -> float:
        return 0.5 if action == "auto" else action

    def describe_action(self, action: Any) -> str:
        return "auto" if action == "auto" else super().describe_action(action)

    def step(self, action: Any) -> Any:
        return super().step(self.actuation(action))


def episode(*faults: Any, generator: Any = None, **options: Any) -> Episode:
    return run_loop(
        generator or (lambda view: Proposal(float(view.percept["thermometer"] < 99.0))),
        simulator=Room(),
        fault_injector=CampaignInjector(),
        spec={"faults": faults},
        **{"seconds": 2.0, **options},
    )


def power(found: Episode) -> list[float]:
    """What the heater got at each tick that another one follows."""
    return found.signals["power"][1:].tolist()


WEAK = {"target": "command", "parameters": {"amount": 0.0, "factor": 0.25}}


def test_a_command_fault_reaches_the_plant_at_its_very_tick() -> None:
    found = episode(fault("weak", at=0.5, **WEAK))
    assert power(found) == [1.0] * 5 + [0.25] * 3 + [1.0] * 12
    assert set(found.decisions["executed"]) == {"100%"}, "what was decided"
    (record,) = found.faults
    assert (record.activated_at, record.manifested_at) == (pytest.approx(0.5),) * 2
    assert record.deactivated_at == pytest.approx(0.8)
    assert (record.manifest_ticks, record.activations) == (3, 1)
    assert found.validity == "valid"


def test_a_command_fault_gets_what_the_actuators_would_get() -> None:
    found = episode(fault("weak", at=0.5, **WEAK), generator=lambda view: Proposal("auto"))
    assert power(found) == [0.5] * 5 + [0.125] * 3 + [0.5] * 12
    assert set(found.decisions["executed"]) == {"auto"}


def test_a_command_fault_that_changes_nothing_has_not_manifested() -> None:
    found = episode(fault("weak", at=0.5, **WEAK), generator=lambda view: Proposal(0.0))
    (record,) = found.faults
    assert record.activated_at == pytest.approx(0.5)
    assert record.manifested_at is None
    assert found.validity == "invalid"


def test_a_recovery_s_command_is_weakened_too() -> None:
    found = episode(
        fault("hot", at=0.5, target="thermometer", parameters={"amount": 40.0}),
        fault("stuck", at=0.5, target="command", parameters={"amount": 0.25}),
        safety_monitor=HeatMonitor(),
        recovery_planner=SwitchOff(),
        generator=lambda view: Proposal(float(view.percept["thermometer"] > 0.0)),
    )
    assert found.decisions["source"][5:8].tolist() == ["recovery"] * 3
    assert power(found)[4:9] == [1.0, 0.25, 0.25, 0.25, 1.0]
    hot, stuck = found.faults
    assert (hot.recovery, hot.recovery_at) == ("switch_off", pytest.approx(0.5))
    assert hot.recovered_at == pytest.approx(0.8)
    assert stuck.recovery_at == pytest.approx(0.6), "what came before cannot answer it"


def test_a_chain_on_what_manifested_waits_until_the_component_looks() -> None:
    def looks_from_the_eighth(view: Any) -> Proposal:
        if view.index >= 8:
            view.percept["thermometer"]
        return Proposal(0.5)

    first = fault("first", at=0.5, target="thermometer", duration=None)
    after = {"fault": "first", "event": "manifested", "delay": 0.3}
    second = fault("second", after=after, **WEAK)
    found = episode(first, second, generator=looks_from_the_eighth)
    assert found.faults[0].activated_at == pytest.approx(0.5)
    assert found.faults[0].manifested_at == pytest.approx(0.8)
    assert found.faults[1].activated_at == pytest.approx(1.1)
    blind = episode(first, second, generator=lambda view: Proposal(0.5))
    assert blind.faults[1].activated_at is None
    assert blind.invalid_reason == "never manifested: first, second"


def test_a_chain_on_a_command_that_was_changed() -> None:
    after = {"fault": "weak", "event": "manifested"}
    second = fault("second", after=after, target="thermometer", duration="once")
    found = episode(fault("weak", at=0.5, **WEAK), second)
    assert found.faults[1].activated_at == pytest.approx(0.6)
    kinds = [(e.tick, e.kind, e.subject) for e in found.events if e.kind.startswith("fault")]
    assert kinds == [
        (5, "fault_activated", "weak"),
        (5, "fault_manifested", "weak"),
        (6, "fault_activated", "second"),
        (6, "fault_manifested", "second"),
        (7, "fault_deactivated", "second"),
        (8, "fault_deactivated", "weak"),
    ]


def directing(*names: str, tick: int = 4) -> Any:
    return doing(
        SecurityAssessor,
        lambda view: SecurityAssessment(directives=names if view.index == tick else ()),
    )


def test_the_assessor_directs_sensors_for_the_next_percept_and_commands_at_once() -> None:
    sensor = fault("sensor", by="security_assessor", target="thermometer")
    command = fault("command", by="security_assessor", **WEAK)
    found = episode(sensor, command, security_assessor=directing("sensor", "command"))
    one, other = found.faults
    assert (one.activated_at, one.manifested_at) == (pytest.approx(0.5),) * 2
    assert (other.activated_at, other.manifested_at) == (pytest.approx(0.4),) * 2
    assert power(found)[3:8] == [1.0, 0.25, 0.25, 0.25, 1.0]


def test_a_planned_fault_may_be_directed() -> None:
    found = episode(fault("weak", at=1.5, **WEAK), security_assessor=directing("weak"))
    assert power(found) == [1.0] * 4 + [0.25] * 3 + [1.0] * 13


@pytest.mark.parametrize("policy", ["recover", "refine(2)"])
def test_a_directive_counts_once_however_often_the_proposal_is_refined(policy: str) -> None:
    command = fault("weak", by="security_assessor", **WEAK, duration="once")
    found = episode(
        command,
        security_assessor=directing("weak"),
        safety_monitor=HeatMonitor(limit=-99.0),
        policy=policy,
    )
    assert found.faults[0].activations == 1
    assert np.flatnonzero(found.signals["power"][1:] == 0.25).tolist() == [4]


def test_an_unknown_directive_is_an_infrastructure_error() -> None:
    found = episode(fault("weak", at=1.5, **WEAK), security_assessor=directing("waek"))
    assert found.validity == "missing"
    assert found.failure is not None
    assert "fault_injector at tick 4" in found.failure
    assert "directs 'waek', which is no fault of this episode; there are: weak" in found.failure


def test_a_misspelt_target_is_told_before_anything_has_moved() -> None:
    with pytest.raises(ConfigurationError, match="no channel 'thermomter'"):
        episode(fault("f", at=1.5, target="thermomter"))


def test_faults_far_away_leave_the_episode_as_it_is() -> None:
    plain = run_loop(Controller(), simulator=Room(), seconds=2.0)
    armed = episode(
        fault("a", at=99.0, target="thermometer"),
        fault("b", when="time > 99", **WEAK),
        fault("c", probability=1e-12, target="thermometer"),
        fault("d", after={"fault": "a"}, **WEAK),
        generator=Controller(),
    )
    for name, column in plain.signals.items():
        assert column.tobytes() == armed.signals[name].tobytes()
    assert [record.activated_at for record in armed.faults] == [None] * 4


class Noting(CampaignInjector):
    """Notes which channels it was asked to change."""

    def __init__(self) -> None:
        self.asked = 0

    def corrupt(self, channels: Any, time: float) -> Any:
        self.asked += 1
        return super().corrupt(channels, time)


def test_an_injector_of_ones_own_is_asked_without_faults_too() -> None:
    injector = Noting()
    found = run_loop(
        lambda _: Proposal(0.0), simulator=Room(), fault_injector=injector, spec={"faults": ()}
    )
    assert injector.asked == found.ticks


def test_an_episode_without_faults_is_the_same_as_one_without_an_injector() -> None:
    with_injector = episode()
    without = run_loop(
        lambda view: Proposal(float(view.percept["thermometer"] < 99.0)),
        simulator=Room(),
        spec={"faults": ()},
        seconds=2.0,
    )
    assert with_injector.signals.keys() == without.signals.keys()
    assert all(
        np.array_equal(with_injector.signals[name], without.signals[name])
        for name in without.signals
    )
