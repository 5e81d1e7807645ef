"""The causal chain of a fault: planned, activated, manifested, detected, gone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from loops import Says, doing, run_loop
from thermostat import Bias, Controller, HeatMonitor, JumpWatch, Meter, SwitchOff, Thermostat

from pytest_dura import (
    Alert,
    Assessed,
    Assessment,
    Episode,
    Fault,
    FaultInjector,
    Injection,
    Proposal,
    RoleView,
    SafetyMonitor,
    SecurityAssessment,
    SecurityAssessor,
)

BIAS = Fault("bias", "bias", "thermometer", {"at": 0.5}, 0.3)


def with_faults(generator: Any, *faults: Any, seconds: float = 1.5, **roles: Any) -> Episode:
    roles.setdefault("fault_injector", Bias())
    return run_loop(generator, seconds=seconds, spec={"faults": faults or (BIAS,)}, **roles)


def kinds(episode: Episode) -> list[tuple[int, str]]:
    return [(e.tick, e.kind) for e in episode.events if e.kind.startswith("fault")]


def test_a_fault_is_recorded_from_plan_to_end() -> None:
    episode = with_faults(Controller(), security_assessor=JumpWatch())
    (fault,) = episode.faults
    assert fault.planned_at == 0.5
    assert fault.activated_at == pytest.approx(0.5)
    assert fault.manifested_at == pytest.approx(0.5)
    assert fault.deactivated_at == pytest.approx(0.8)  # the first tick without it
    assert fault.manifest_ticks == 3
    assert fault.success
    assert fault.activations == 1
    assert fault.detected_at == pytest.approx(0.5)
    assert (fault.detected_by, fault.pattern) == ("security_assessor", "jump")
    assert fault.latencies() == {
        "manifestation_latency": pytest.approx(0.0),
        "detection_latency": pytest.approx(0.0),
        "recovery_latency": None,
        "time_to_recover": None,
    }
    assert episode.validity == "valid"
    assert kinds(episode) == [
        (5, "fault_activated"),
        (5, "fault_manifested"),
        (8, "fault_deactivated"),
    ]


def test_ground_truth_does_not_see_the_fault() -> None:
    def blind(view: Any) -> Proposal:
        return Proposal(0.5)

    plain = run_loop(blind, seconds=1.5)
    faulty = with_faults(blind)
    assert faulty.signals["temperature"].tobytes() == plain.signals["temperature"].tobytes()
    difference = plain.signals["percept.temperature"] - faulty.signals["percept.temperature"]
    assert difference[5:8].tolist() == pytest.approx([10.0, 10.0, 10.0])
    assert not difference[:5].any()


def test_a_fault_that_the_component_did_not_read_has_not_manifested() -> None:
    episode = with_faults(Says(lambda view: Proposal(float(view.percept["clock"] < 0.3))))
    (fault,) = episode.faults
    assert fault.activated_at is not None
    assert fault.manifested_at is None
    assert not fault.success
    assert episode.validity == "invalid"
    assert episode.invalid_reason == "never manifested: bias"


@pytest.mark.parametrize(
    "read",
    [
        lambda percept: percept["thermometer"],
        lambda percept: percept.get("thermometer"),
        lambda percept: list(percept.values()),
        lambda percept: dict(percept.items()),
        lambda percept: "thermometer" in percept,
    ],
)
def test_every_way_of_reading_counts(read: Any) -> None:
    def answer(view: Any) -> Proposal:
        read(view.percept)
        return Proposal(0.5)

    assert with_faults(answer).validity == "valid"


def test_what_any_role_reads_counts_and_the_record_names_the_readers() -> None:
    episode = with_faults(
        lambda view: Proposal(0.5), safety_monitor=HeatMonitor(), security_assessor=JumpWatch()
    )
    (fault,) = episode.faults
    assert episode.validity == "valid"
    assert fault.manifested_at == pytest.approx(0.5)
    assert fault.detected_by == "security_assessor"
    assert fault.read_by == ("safety_monitor", "security_assessor")
    assert episode.read_by == {"bias": fault.read_by}
    assert with_faults(Controller()).read_by == {"bias": ("generator",)}


def test_the_digest_leaves_out_who_read_a_fault() -> None:
    monitored = with_faults(Controller(), safety_monitor=HeatMonitor())
    renamed = replace(
        monitored, faults=tuple(replace(fault, read_by=()) for fault in monitored.faults)
    )
    assert monitored.read_by["bias"] == ("generator", "safety_monitor")
    assert monitored.digest == renamed.digest


def test_the_injector_is_no_reader_of_what_it_changes_itself() -> None:
    class Looks(Bias):
        def run(self, view: RoleView) -> Injection:
            view.percept["thermometer"]
            return super().run(view)

    episode = with_faults(lambda view: Proposal(0.5), fault_injector=Looks())
    assert episode.invalid_reason == "never manifested: bias"


class Late(SafetyMonitor):
    """Looks half a second back, every half second."""

    def trigger(self, view: RoleView) -> bool:
        return view.index % 5 == 0 and view.index > 5

    def run(self, view: RoleView) -> Assessment:
        for percept in view.percepts[-5:-2]:
            percept["thermometer"]
        return Assessment()


def test_a_changed_value_counts_when_a_role_reads_it_later() -> None:
    (fault,) = with_faults(lambda view: Proposal(0.5), watch=Late()).faults
    assert fault.deactivated_at == pytest.approx(0.8)
    assert fault.manifested_at == pytest.approx(1.0)
    assert fault.manifest_ticks == 1
    assert fault.read_by == ("watch",)


def test_looking_back_at_what_has_manifested_already_is_no_further_tick_of_it() -> None:
    (fault,) = with_faults(Controller(), watch=Late()).faults
    assert fault.manifested_at == pytest.approx(0.5)
    assert fault.manifest_ticks == 3
    assert fault.read_by == ("generator", "watch")


class Shares(SafetyMonitor):
    """Takes what another role has made of the percept."""

    def run(self, view: RoleView) -> Assessment:
        view.percept.once(_through_another)
        return Assessment()


def _through_another(percept: Any) -> Any:
    return percept.once(_temperature) + 1.0


def _temperature(percept: Any) -> Any:
    return percept["thermometer"]


class SharesDirectly(Shares):
    after = ("first",)

    def run(self, view: RoleView) -> Assessment:
        view.percept.once(_temperature)
        return Assessment()


def test_who_takes_what_was_made_of_a_changed_value_has_read_it() -> None:
    roles = {"first": Shares(), "second": SharesDirectly(), "third": Shares()}
    (fault,) = with_faults(lambda view: Proposal(0.5), **roles).faults
    assert fault.read_by == ("first", "second", "third")


def test_reading_in_a_refined_proposal_counts() -> None:
    def answer(view: Any) -> Proposal:
        if view.feedback:
            view.percept["thermometer"]
            return Proposal(0.0)
        return Proposal(None)

    assert with_faults(answer, policy="refine(1)").validity == "valid"


def test_a_component_that_failed_before_reading_was_not_reached() -> None:
    assert with_faults(lambda view: 1 / 0, recovery_planner=SwitchOff()).validity == "invalid"


def test_a_fault_that_ends_before_the_plan_begins_it_is_invalid_and_one_by_chance_is_not() -> None:
    late = replace(BIAS, activation={"at": 99.0})
    assert with_faults(Controller(), late).validity == "invalid"
    assert with_faults(Controller(), replace(late, by_chance=True)).validity == "valid"
    assert with_faults(Controller(), BIAS, replace(late, id="other")).invalid_reason == (
        "never manifested: other"
    )


def test_a_halt_does_not_hide_that_the_fault_manifested() -> None:
    cold = replace(BIAS, activation={"at": 0.3})
    episode = with_faults(
        Controller(),
        cold,
        policy="halt",
        fault_injector=Bias(+40.0),
        safety_monitor=HeatMonitor(limit=-99.0),
    )
    assert episode.termination == "halt"
    assert episode.ticks == 1
    reached = with_faults(
        lambda view: Proposal(float(view.percept["thermometer"] > 30.0)),
        cold,
        policy="halt",
        fault_injector=Bias(+40.0),
        safety_monitor=HeatMonitor(),
    )
    assert (reached.termination, reached.ticks) == ("halt", 4)
    assert reached.validity == "valid"
    assert reached.faults[0].flagged_ticks == 1


class Scripted(FaultInjector):
    """Changes channels and commands at the ticks it is told."""

    def __init__(self, channels: dict[int, tuple[str, ...]], commands: dict[int, str]) -> None:
        self.channels, self.commands = channels, commands

    def run(self, view: Any) -> Injection:
        return Injection()

    def corrupt(self, channels: Any, time: float) -> Any:
        ids = self.channels.get(round(time / 0.1), ())
        return {**channels, "thermometer": 0.0} if ids else channels, {"thermometer": ids}

    def corrupt_command(self, action: Any, time: float) -> Any:
        fault = self.commands.get(round(time / 0.1))
        return (0.25, (fault,)) if fault else (action, ())


def test_a_command_fault_manifests_at_once_and_reaches_the_plant() -> None:
    command = Fault("bias", "weak", "command")
    episode = with_faults(
        lambda view: Proposal(1.0), command, fault_injector=Scripted({}, {3: "weak"})
    )
    (fault,) = episode.faults
    assert fault.manifested_at == pytest.approx(0.3)
    assert fault.manifest_ticks == 1
    assert episode.decisions["executed"][3] == "100%"  # what was decided
    assert episode.signals["power"][4] == 0.25  # what was carried out


def test_two_faults_on_one_channel_both_manifest() -> None:
    faults = (Fault("bias", "a", "thermometer"), Fault("bias", "b", "thermometer"))
    episode = with_faults(Controller(), *faults, fault_injector=Scripted({2: ("b", "a")}, {}))
    assert [fault.manifest_ticks for fault in episode.faults] == [1, 1]
    manifested = [e.subject for e in episode.events if e.kind == "fault_manifested"]
    assert manifested == ["a", "b"]


def test_a_fault_that_nobody_planned_is_recorded_as_such() -> None:
    injector = doing(FaultInjector, lambda view: Injection(("stray",), ("other",)))
    episode = run_loop(Controller(), fault_injector=injector)
    assert [(f.id, f.target) for f in episode.faults] == [
        ("stray", "unplanned"),
        ("other", "unplanned"),
    ]


def alerts_at(*ticks: int) -> Any:
    def output(view: Any) -> SecurityAssessment:
        found = (Alert(f"pattern-{view.index}", "thermometer"),) if view.index in ticks else ()
        return SecurityAssessment(alerts=found)

    return doing(SecurityAssessor, output)


@pytest.mark.parametrize(
    "ticks, detected",
    [
        ((), None),
        ((2, 4), None),  # before it begins: a false alarm
        ((2, 6, 7), 6),
        ((5,), 5),
        ((18,), 18),  # one second after its end is still in time
        ((19,), None),
    ],
)
def test_detection_is_the_first_alert_from_activation_to_shortly_after(
    ticks: tuple[int, ...], detected: int | None
) -> None:
    episode = with_faults(Controller(), seconds=2.5, security_assessor=alerts_at(*ticks))
    (fault,) = episode.faults
    if detected is None:
        assert (fault.detected_at, fault.detected_by, fault.pattern) == (None,) * 3
        assert fault.detection_latency is None
    else:
        assert (fault.detected_by, fault.pattern) == ("security_assessor", f"pattern-{detected}")
        assert fault.detection_latency == pytest.approx((detected - 5) * 0.1)
    assert episode.metrics.alerts == len(ticks)


def reading_each_second(view: Any) -> Proposal:
    """A component at 1 Hz beside monitors at 10 Hz."""
    if view.index % 10 == 0:
        view.percept["thermometer"]
    return Proposal(0.5)


LONG = replace(BIAS, duration=1.0)


@pytest.mark.parametrize(
    "ticks, detected",
    [
        ((5,), 5),  # five ticks before the component reads it
        ((4, 7, 12), 7),
        ((4,), None),
        ((25,), 25),
        ((26,), None),
    ],
)
def test_an_alert_before_the_component_reads_the_fake_has_detected_it(
    ticks: tuple[int, ...], detected: int | None
) -> None:
    episode = with_faults(
        reading_each_second, LONG, seconds=3.0, security_assessor=alerts_at(*ticks)
    )
    (fault,) = episode.faults
    assert (fault.activated_at, fault.manifested_at) == (pytest.approx(0.5), pytest.approx(1.0))
    if detected is None:
        assert (fault.detected_at, fault.detection_latency) == (None, None)
    else:
        assert fault.detected_at == pytest.approx(detected * 0.1)
        assert fault.detection_latency == pytest.approx(detected * 0.1 - 0.5)
        assert fault.pattern == f"pattern-{detected}"


def test_a_command_fault_is_not_detected_at_the_tick_at_whose_end_it_first_acts() -> None:
    command = Fault("bias", "weak", "command")

    class Reported(Scripted):
        def run(self, view: Any) -> Injection:
            return Injection(("weak",)) if view.index == 3 else Injection()

    def detected(*ticks: int) -> float | None:
        (fault,) = with_faults(
            lambda view: Proposal(1.0),
            command,
            fault_injector=Reported({}, dict.fromkeys((6, 7), "weak")),
            security_assessor=alerts_at(*ticks),
        ).faults
        assert (fault.activated_at, fault.manifested_at) == (pytest.approx(0.3), pytest.approx(0.6))
        return fault.detected_at

    assert detected(3) is None
    assert detected(3, 4) == pytest.approx(0.4)
    assert detected(6) == pytest.approx(0.6)


def test_the_role_that_alerts_first_has_detected_it() -> None:
    later = doing(
        SecurityAssessor,
        lambda view: SecurityAssessment(alerts=(Alert("other", "thermometer"),)),
        name="residuals",
        after=("security_assessor",),
    )
    episode = with_faults(Controller(), security_assessor=alerts_at(5), residuals=later)
    assert (episode.faults[0].detected_by, episode.faults[0].pattern) == (
        "security_assessor",
        "pattern-5",
    )
    alone = with_faults(Controller(), security_assessor=alerts_at(), residuals=later)
    assert (alone.faults[0].detected_by, alone.faults[0].pattern) == ("residuals", "other")


def refusing(*ticks: int) -> Any:
    def output(view: Any) -> Assessment:
        refused = view.index in ticks
        return Assessment(Assessed.UNSAFE if refused else Assessed.SAFE, 0.0, ("no",) * refused)

    return doing(SafetyMonitor, output)


@pytest.mark.parametrize(
    "refused, recovery_at, recovered_at",
    [
        ((), None, None),
        ((4,), None, None),  # before it manifests: an answer to something else
        ((5, 6, 9), 0.5, 0.7),
        ((4, 5), 0.5, 0.6),  # it went on into the fault
        ((9,), 0.9, 1.0),
        ((18,), 1.8, 1.9),  # one second after its end is still in time
        ((19,), None, None),
        ((18, 19, 20, 21, 22, 23, 24), 1.8, None),  # it never was acceptable again
    ],
)
def test_recovery_is_looked_for_from_manifestation_to_shortly_after(
    refused: tuple[int, ...], recovery_at: float | None, recovered_at: float | None
) -> None:
    episode = with_faults(
        Controller(),
        seconds=2.5,
        safety_monitor=refusing(*refused),
        recovery_planner=SwitchOff(),
        fault_injector=Bias(),
    )
    (fault,) = episode.faults
    assert fault.deactivated_at == pytest.approx(0.8)
    assert fault.recovery_at == (None if recovery_at is None else pytest.approx(recovery_at))
    assert fault.recovered_at == (None if recovered_at is None else pytest.approx(recovered_at))
    assert fault.recovery == (None if recovery_at is None else "switch_off")
    if recovered_at is not None and recovery_at is not None:
        assert fault.recovery_latency == pytest.approx(recovery_at - 0.5)
        assert fault.time_to_recover == pytest.approx(recovered_at - recovery_at)


def test_without_recovery_a_refused_proposal_is_no_recovery() -> None:
    episode = with_faults(Controller(), policy="log_only", safety_monitor=refusing(5, 6))
    (fault,) = episode.faults
    assert fault.flagged_ticks == 2
    assert (fault.recovery, fault.recovery_at, fault.recovered_at) == (None,) * 3


def test_what_was_decided_before_the_command_was_changed_is_no_answer_to_it() -> None:
    command = Fault("bias", "weak", "command")

    def chained(*ticks: int) -> Any:
        (fault,) = with_faults(
            lambda view: Proposal(1.0),
            command,
            fault_injector=Scripted({}, dict.fromkeys((3, 4, 5), "weak")),
            safety_monitor=refusing(*ticks),
            security_assessor=alerts_at(*ticks),
            recovery_planner=SwitchOff(),
        ).faults
        assert fault.manifested_at == pytest.approx(0.3)
        return fault

    same_tick, next_tick = chained(3), chained(3, 4)
    assert (same_tick.detected_at, same_tick.recovery_at) == (None, None)
    assert (next_tick.detected_at, next_tick.recovery_at) == (pytest.approx(0.4),) * 2


def test_each_activation_is_counted_and_manifests_anew() -> None:
    on, off = {4: ("a",), 8: ("a",)}, {6: ("a",), 10: ("a",)}

    class Twice(Scripted):
        def run(self, view: Any) -> Injection:
            return Injection(on.get(view.index, ()), off.get(view.index, ()))

    told: list[tuple[tuple[str, ...], float]] = []

    class Hears(Twice):
        def manifested(self, faults: tuple[str, ...], time: float) -> None:
            told.append((faults, round(time, 9)))

    ticks = dict.fromkeys((4, 5, 8, 9), ("a",))
    episode = with_faults(
        Controller(), Fault("bias", "a", "thermometer"), fault_injector=Hears(ticks, {})
    )
    (fault,) = episode.faults
    assert fault.activations == 2
    assert (fault.activated_at, fault.manifested_at) == (pytest.approx(0.4),) * 2
    assert fault.deactivated_at == pytest.approx(1.0)
    manifested = [event.tick for event in episode.events if event.kind == "fault_manifested"]
    assert manifested == [4, 8]
    assert told == [(("a",), 0.4), (("a",), 0.8)]


def test_a_command_that_no_fault_changed_is_carried_out_as_it_was_decided() -> None:
    class Loose(Thermostat):
        def actuation(self, action: Any) -> Any:
            return action + 0.5  # an adapter that breaks the contract

    episode = with_faults(
        lambda view: Proposal(0.25), simulator=Loose(), fault_injector=Scripted({}, {})
    )
    assert set(episode.signals["power"][1:].tolist()) == {0.25}


def test_a_reaction_is_an_event_whenever_it_changes() -> None:
    episode = with_faults(Controller(), security_assessor=JumpWatch())
    reactions = [(e.tick, e.detail) for e in episode.events if e.kind == "reaction"]
    assert reactions == [
        (0, "unaffected"),
        (5, "follows the fake"),
        (6, "unaffected"),
        (8, "follows the fake"),
        (9, "unaffected"),
    ]


def test_what_the_injector_takes_to_corrupt_counts_as_its_time() -> None:
    import time

    class Slow(Scripted):
        def corrupt(self, channels: Any, now: float) -> Any:
            time.sleep(0.002)
            return channels, {}

    episode = run_loop(Controller(), seconds=0.3, fault_injector=Slow({}, {}), m=Meter())
    assert min(episode.metrics.processing_ns["fault_injector"][1]) > 1_500_000
