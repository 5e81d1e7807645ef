"""One episode: triggers, views, outputs, decisions and their columns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loops import Says, doing, run_loop
from thermostat import Controller, HeatMonitor, NightWatch, SwitchOff

from pytest_dura import (
    Assessed,
    Assessment,
    Fault,
    FaultInjector,
    Injection,
    Proposal,
    Recovery,
    RecoveryPlanner,
    Role,
    SafetyMonitor,
    SecurityAssessment,
    SecurityAssessor,
    Termination,
)
from pytest_dura.core import PastDecision


def test_an_episode_has_one_row_per_tick_and_one_decision_per_step() -> None:
    episode = run_loop(Controller(target=99.0), seconds=1.0, safety_monitor=HeatMonitor())
    assert episode.termination == "time"
    assert episode.validity == "valid"
    assert episode.ticks == 11
    np.testing.assert_allclose(episode.time, np.arange(11) * 0.1)
    assert {len(column) for column in episode.signals.values()} == {11}
    assert {len(column) for column in episode.decisions.values()} == {10}
    assert set(episode.signals) == {"temperature", "power", "headroom", "percept.temperature"}
    assert episode.decisions["proposed"].tolist() == ["100%"] * 10
    assert episode.decisions["source"].tolist() == ["proposal"] * 10


def test_a_role_runs_only_when_its_trigger_holds_and_after_whom_it_named() -> None:
    seen: list[Any] = []
    watch = doing(
        Role, lambda view: seen.append(view.outputs["night_watch"][0]), after=("night_watch",)
    )
    night = NightWatch()
    run_loop(Controller(), seconds=1.0, safety_monitor=HeatMonitor(), night_watch=night, z=watch)
    # Between its ticks, the latest output of the triggered role still stands.
    assert seen == [0, 0, 0, 0, 0, 5, 5, 5, 5, 5]


def test_later_roles_read_the_history_of_the_outputs_of_others() -> None:
    seen: list[list[tuple[float, Any]]] = []

    def read(view: Any) -> None:
        history = view.history.get("night_watch", ())
        assert [one[0] for one in history] == sorted(one[0] for one in history)
        assert not history or history[-1][1] is view.outputs["night_watch"]
        seen.append([(round(time, 6), output[0]) for time, output in history])

    reader = doing(Role, read, after=("night_watch",))
    run_loop(Controller(), seconds=1.0, night_watch=NightWatch(), z=reader)
    assert seen[0] == [(0.0, 0)]
    assert seen[4] == [(0.0, 0)], "it is triggered every fifth tick, and did not run in between"
    assert seen[-1] == [(0.0, 0), (0.5, 5)]
    own: list[int] = []
    mine = doing(Role, lambda view: own.append(len(view.history.get("mine", ()))) or view.index)
    run_loop(Controller(), seconds=0.3, mine=mine)
    assert own == [0, 1, 2], "a role sees what it returned at the ticks before"


@pytest.mark.parametrize("may_act", [False, True])
def test_an_injector_that_may_not_act_is_not_run_and_has_an_output_all_the_same(
    may_act: bool,
) -> None:
    seen: list[Any] = []

    def read(view: Any) -> None:
        history = view.history["fault_injector"]
        seen.append((view.outputs["fault_injector"], len(history), history[-1]))

    injector = doing(FaultInjector, lambda _: Injection(), may_act=lambda _: may_act)
    reader = doing(Role, read, after=("fault_injector",))
    run_loop(Controller(), seconds=0.3, fault_injector=injector, z=reader)
    assert injector.seen == ([0, 1, 2] if may_act else [])
    nothing = Injection()
    expected = [(nothing, tick + 1, (pytest.approx(tick * 0.1), nothing)) for tick in range(3)]
    assert seen == expected


def test_the_component_reads_its_past_decisions_one_or_several_at_a_time() -> None:
    def answer(view: Any) -> Proposal:
        past = view.past
        assert len(past) == view.index
        if past:
            assert past[-1] == PastDecision(past[-1].time, 0.5, "as ever", 0.5, "proposal")
            assert [each.time for each in past[-2:]] == [each.time for each in past][-2:]
        return Proposal(0.5, "as ever")

    episode = run_loop(Says(answer), seconds=0.5)
    assert episode.metrics.valid_proposals == 5


def test_a_directive_holds_for_its_tick_only() -> None:
    obeyed: list[tuple[int, tuple[str, ...]]] = []
    assessor = doing(
        SecurityAssessor,
        lambda view: SecurityAssessment(score=-1.0, directives=("attack",)),
        trigger=lambda self, view: view.index == 1,
    )
    reader = doing(
        Role,
        lambda view: obeyed.append((view.index, view.outputs["security_assessor"].directives)),
        after=("security_assessor",),
        trigger=lambda self, view: "security_assessor" in view.outputs,
    )
    run_loop(Controller(), seconds=0.4, security_assessor=assessor, reader=reader)
    assert obeyed == [(1, ("attack",)), (2, ()), (3, ())]


def test_roles_see_the_command_of_the_tick_before_whoever_gave_it() -> None:
    seen: list[Any] = []
    watch = doing(Role, lambda view: seen.append(view.command))
    run_loop(
        Controller(target=99.0),
        seconds=0.3,
        watch=watch,
        safety_monitor=doing(
            SafetyMonitor, lambda view: Assessment(Assessed(2 * (view.index == 1)))
        ),
        recovery_planner=doing(RecoveryPlanner, lambda view: Recovery(0.0, "off")),
    )
    assert seen == [None, 1.0, 0.0]


def test_a_role_sees_what_an_earlier_one_said_in_the_same_tick() -> None:
    scores: list[tuple[int, float]] = []
    monitor = doing(SafetyMonitor, lambda view: Assessment(score=float(view.index)))
    reader = doing(
        Role,
        lambda view: scores.append((view.index, view.outputs["safety_monitor"].score)),
        after=("safety_monitor",),
    )
    run_loop(Controller(), seconds=0.5, safety_monitor=monitor, reader=reader)
    assert scores == [(i, float(i)) for i in range(5)]


def test_roles_see_the_proposal_and_the_history_of_percepts() -> None:
    rows: list[tuple[Any, ...]] = []

    def look(view: Any) -> None:
        temperatures = [percept["thermometer"] for percept in view.percepts]
        rows.append((view.proposal.action, len(temperatures), temperatures[-1]))

    episode = run_loop(lambda view: Proposal(0.5), seconds=0.5, watch=doing(Role, look))
    assert [row[:2] for row in rows] == [(0.5, n + 1) for n in range(5)]
    assert [row[2] for row in rows] == episode.signals["temperature"][:5].tolist()


def test_the_worst_verdict_wins_and_reasons_name_their_role() -> None:
    reasons: list[tuple[str, ...]] = []

    def recover(view: Any) -> Recovery:
        reasons.append(view.reasons)
        return Recovery(0.0, "off")

    episode = run_loop(
        lambda view: Proposal(1.0),
        seconds=0.1,
        safety_monitor=doing(SafetyMonitor, lambda v: Assessment(Assessed.UNSAFE, -1.0, ("hot",))),
        second=doing(SafetyMonitor, lambda v: Assessment(Assessed.WARNING, 1.0)),
        third=doing(SafetyMonitor, lambda v: Assessment(Assessed.SAFE, 2.0, ("fine",))),
        recovery_planner=doing(RecoveryPlanner, recover),
    )
    assert reasons == [("safety_monitor: hot", "second: WARNING")]
    assert episode.decisions["verdict"].tolist() == [2]
    assert episode.decisions["executed"].tolist() == ["0%"]
    assert episode.decisions["proposed"].tolist() == ["100%"]


def test_a_critical_assessment_refuses_the_proposal_whatever_its_verdict() -> None:
    monitor = doing(SafetyMonitor, lambda view: Assessment(Assessed.SAFE, 1.0, critical=True))
    episode = run_loop(
        Controller(), seconds=0.1, safety_monitor=monitor, recovery_planner=SwitchOff()
    )
    assert episode.decisions["source"].tolist() == ["recovery"]
    assert episode.metrics.violations["safety_monitor"] == 1


def test_lasting_conditions_are_events_where_they_begin_and_end() -> None:
    monitor = doing(
        SafetyMonitor,
        lambda view: Assessment(
            Assessed.UNSAFE if view.index in (2, 3, 6) else Assessed.SAFE,
            0.0,
            (f"at {view.index}",),
        ),
    )
    episode = run_loop(Controller(), seconds=1.0, policy="log_only", safety_monitor=monitor)
    unsafe = [(e.tick, e.kind) for e in episode.events if "unsafe" in e.kind]
    assert unsafe == [(2, "unsafe"), (4, "unsafe_ended"), (6, "unsafe"), (7, "unsafe_ended")]
    assert episode.metrics.violations["safety_monitor"] == 3


def test_the_simulators_own_events_are_kept() -> None:
    episode = run_loop(lambda view: Proposal(float(view.index >= 2)), seconds=0.5)
    switched = [(e.tick, e.subject, e.detail) for e in episode.events if e.kind == "switched"]
    assert switched == [(3, "heater", "on")]


def test_a_context_is_a_copy_and_the_component_does_not_learn_the_faults() -> None:
    contexts: dict[str, Any] = {}

    class Spoiler(Says):
        def reset(self, context: Any) -> None:
            contexts["generator"] = context
            context.scenario["world"]["start"] = -40.0

    class Watch(NightWatch):
        def reset(self, context: Any) -> None:
            contexts["watch"] = context

    fault = Fault("bias", "bias", "thermometer", {"at": 5.0}, 1.0)
    scenario = {"world": {"start": 17.0, "names": ["a"], "pair": (1, 2)}}
    episode = run_loop(
        Spoiler(lambda view: Proposal(0.0)),
        seconds=0.1,
        night_watch=Watch(),
        spec={"scenario": scenario, "faults": (fault,)},
    )
    assert episode.signals["temperature"][0] == 17.0
    assert scenario == {"world": {"start": 17.0, "names": ["a"], "pair": (1, 2)}}
    assert contexts["generator"].faults == ()
    assert contexts["generator"].seed != contexts["watch"].seed
    assert contexts["watch"].scenario == scenario
    assert contexts["watch"].faults == (fault,)
    contexts["watch"].faults[0].activation["at"] = 0.0
    assert episode.spec.faults[0].activation == fault.activation == {"at": 5.0}


def test_a_loop_can_be_run_again_with_its_parts() -> None:
    from loops import spec_of
    from thermostat import Thermostat

    from pytest_dura import Orchestrator

    roles = {"generator": Controller(), "safety_monitor": HeatMonitor()}
    loop = Orchestrator(Thermostat(), roles)
    spec = spec_of(roles, termination=Termination(1.0))
    assert loop.run(spec).digest == loop.run(spec).digest


def test_recovery_without_a_planner_lets_the_proposal_pass() -> None:
    episode = run_loop(
        lambda view: Proposal(1.0), seconds=1.0, safety_monitor=HeatMonitor(limit=0.0)
    )
    assert set(episode.decisions["source"]) == {"proposal"}
    assert episode.flagged


@pytest.mark.parametrize("start, flagged", [(15.0, False), (35.0, True)])
def test_flagged_says_whether_any_proposal_was_unsafe(start: float, flagged: bool) -> None:
    episode = run_loop(
        lambda view: Proposal(1.0),
        seconds=0.3,
        safety_monitor=HeatMonitor(),
        spec={"scenario": {"world": {"start": start}}},
    )
    assert episode.flagged is flagged
