"""Laws of a fault's causal chain: planned, manifested, detected, recovered from, and propagated.

Each law draws when faults act and what the roles do, and compares the loop's records with a
reference that reads the plan alone. All times of a plan are counted in ticks.
"""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

import pytest
from clockwork import Clockwork
from hypothesis import given, settings
from hypothesis import strategies as st
from injecting import fault
from loops import doing, run_loop

from pytest_dura import (
    Alert,
    Assessed,
    Assessment,
    Episode,
    Proposal,
    Recovery,
    RecoveryPlanner,
    Requirement,
    SafetyMonitor,
    SecurityAssessment,
    SecurityAssessor,
    Termination,
)
from pytest_dura.core import Divergence, Fault, GeneratorView
from pytest_dura.faults import CampaignInjector
from pytest_dura.requirements import RequirementJudge

DT = 0.1
GRACE = 10
"""Ticks after a fault's end in which an alert or a recovery still answers it."""


def bias(name: str, offset: float, **plan: Any) -> Fault:
    """A planned bias of the channel ``level``, or of another target."""
    plan = {"target": "level", **plan}
    return fault(name, type="bias", parameters={"offset": offset}, **plan)


def weak(name: str, **plan: Any) -> Fault:
    """A planned fault by which no command reaches the plant."""
    parameters = {"percent": 100.0}
    return fault(
        name, type="loss-of-effectiveness", target="command", parameters=parameters, **plan
    )


def tick_of(time: float | None) -> int | None:
    return None if time is None else round(time / DT)


# From plan to recovery


class Plan(NamedTuple):
    """When the faults act, and when the roles do something; all in ticks."""

    ticks: int
    begins: dict[str, int]
    lasts: dict[str, int]
    reads: set[int]
    alerts: set[int]
    unsafe: set[int]
    policy: str


@st.composite
def plans(draw: st.DrawFn) -> Plan:
    ticks = draw(st.integers(1, 34))
    names = ("sensor", "command")
    moments = st.sets(st.integers(0, ticks - 1), max_size=8)
    return Plan(
        ticks,
        {name: draw(st.integers(0, 20)) for name in names},
        {name: draw(st.integers(1, 6)) for name in names},
        set(range(ticks)) - draw(st.sets(st.integers(0, ticks - 1), max_size=20)),
        draw(moments),
        draw(moments),
        draw(st.sampled_from(["recover", "recover", "log_only"])),
    )


def carried_out(plan: Plan) -> Episode:
    """The episode of a plan; beside its two faults, one by chance is on a channel nobody reads."""

    def propose(view: GeneratorView) -> Proposal:
        if view.index in plan.reads:
            view.percept["level"]
        return Proposal(1.0)

    def look(view: Any) -> SecurityAssessment:
        return SecurityAssessment(
            Assessed.UNSAFE if view.index in plan.unsafe else Assessed.SAFE,
            alerts=(Alert(f"pattern {view.index}", "level"),) if view.index in plan.alerts else (),
        )

    timing = {
        name: {"at": plan.begins[name] * DT, "duration": plan.lasts[name] * DT}
        for name in plan.begins
    }
    rare = bias("rare", 1.0, target="power", probability=0.2, duration="once")
    return run_loop(
        propose,
        simulator=Clockwork(),
        seconds=plan.ticks * DT,
        policy=plan.policy,
        spec={
            "faults": (
                bias("sensor", 100.0, **timing["sensor"]),
                weak("command", **timing["command"]),
                rare,
            )
        },
        fault_injector=CampaignInjector(),
        security_assessor=doing(SecurityAssessor, look),
        recovery_planner=doing(RecoveryPlanner, lambda _: Recovery(0.5, "rescue")),
    )


def chain(plan: Plan, name: str) -> dict[str, int | None]:
    """The record of a fault, as it follows from the plan."""
    begin, end = plan.begins[name], plan.begins[name] + plan.lasts[name]
    on_command = name == "command"
    acting = [t for t in range(begin, min(end, plan.ticks)) if on_command or t in plan.reads]
    manifested = min(acting, default=None)
    recovering = plan.unsafe if plan.policy == "recover" else set[int]()
    # A command is changed at the end of a tick: what the roles did at that tick answers nothing.
    answers = range(begin + on_command, end + GRACE + 1)
    detected = recovery = recovered = None
    if manifested is not None:
        detected = min((t for t in plan.alerts if t in answers), default=None)
        later = [t for t in recovering if t in answers and t >= manifested + on_command]
        recovery = min(later, default=None)
    if recovery is not None:
        sound = (t for t in range(recovery + 1, plan.ticks) if t not in plan.unsafe)
        recovered = next(sound, None)
    return {
        "activated_at": begin if begin < plan.ticks else None,
        "manifested_at": manifested,
        "deactivated_at": end if end < plan.ticks else None,
        "detected_at": detected,
        "recovery_at": recovery,
        "recovered_at": recovered,
        "manifest_ticks": len(acting),
        "flagged_ticks": len(set(acting) & plan.unsafe),
    }


def test_the_record_of_a_fault_follows_from_its_plan() -> None:
    ways: Counter[str] = Counter()

    @settings(max_examples=250, derandomize=True, deadline=None)
    @given(plans())
    def law(plan: Plan) -> None:
        episode = carried_out(plan)
        records = {record.id: record for record in episode.faults}
        silent = []
        for name in plan.begins:
            expected, record = chain(plan, name), records[name]
            times = {key: tick_of(getattr(record, key)) for key in expected if key.endswith("_at")}
            counts = {key: getattr(record, key) for key in expected if key.endswith("_ticks")}
            assert times | counts == expected
            if record.detected_at is not None:
                assert record.pattern == f"pattern {expected['detected_at']}"
            silent += [name] if expected["manifested_at"] is None else []
            ways.update(f"{name} {key}" for key, value in expected.items() if value is not None)
            end = plan.begins[name] + plan.lasts[name]
            ways[f"{name} answered late"] += (expected["detected_at"] or 0) >= end
        # The fault by chance manifested nowhere either, and makes no episode invalid.
        assert records["rare"].manifested_at is None
        assert episode.validity == ("invalid" if silent else "valid")
        reason = f"never manifested: {', '.join(silent)}" if silent else None
        assert episode.invalid_reason == reason
        ways[episode.validity] += 1

    law()
    names = [f"{name} {way}" for name in ("sensor", "command") for way in ("recovered_at",)]
    names += ["sensor answered late", "command answered late", "valid", "invalid"]
    assert min(ways[name] for name in names) > 9, ways


offsets = st.sampled_from([-4.0, -2.0, -1.0, 1.0, 2.0, 4.0])


@settings(max_examples=60, derandomize=True, deadline=None)
@given(st.lists(offsets, min_size=1, max_size=3), st.integers(0, 3))
def test_faults_that_cancel_each_other_manifest_nowhere(changes: list[float], turned: int) -> None:
    """Biases whose sum is zero, and an even number of inversions, reach nobody."""
    biases = [bias(f"bias {i}", change, at=0.3, duration=0.2) for i, change in enumerate(changes)]
    turns = [
        fault(f"turn {i}", type="inversion", target="command", at=0.3, duration=0.2)
        for i in range(turned)
    ]

    def propose(view: GeneratorView) -> Proposal:
        return Proposal(1.0 + view.percept["level"])

    episode = run_loop(
        propose,
        simulator=Clockwork(),
        spec={"faults": (*biases, *turns)},
        fault_injector=CampaignInjector(),
    )
    reached = {record.id for record in episode.faults if record.manifested_at is not None}
    shown = {each.id for each in biases if sum(changes)} | {each.id for each in turns if turned % 2}
    assert reached == shown
    assert (episode.validity == "valid") == (len(shown) == len(biases) + len(turns))


# Twins


class Duel(NamedTuple):
    """A run with a lone fault, to be held against its twin; times in ticks."""

    ticks: int
    begin: int
    lasts: int
    offset: float
    threshold: int
    limit: int
    every: int


duels = st.builds(
    Duel,
    ticks=st.integers(1, 12),
    begin=st.integers(0, 9),
    lasts=st.integers(1, 6),
    offset=st.sampled_from([-9.0, -3.0, 3.0, 9.0]),
    threshold=st.integers(0, 14),
    limit=st.integers(2, 30),
    every=st.integers(1, 3),
)


def fought(duel: Duel, *, alone: bool) -> Episode:
    """A component that goes by the level at every few ticks, halted where the level is too high."""

    def propose(view: GeneratorView) -> Proposal:
        if view.index % duel.every:
            return Proposal(0.0)
        return Proposal(float(view.percept["level"] >= duel.threshold))

    def watch(view: Any) -> Assessment:
        high = view.percept["level"] >= duel.limit
        return Assessment(Assessed.UNSAFE if high else Assessed.SAFE)

    planned = bias("f", duel.offset, at=duel.begin * DT, duration=duel.lasts * DT)
    return run_loop(
        propose,
        simulator=Clockwork(),
        seconds=duel.ticks * DT,
        policy="halt",
        spec={"faults": () if alone else (planned,)},
        fault_injector=CampaignInjector(),
        safety_monitor=doing(SafetyMonitor, watch),
    )


def test_what_a_lone_fault_did_is_told_by_its_twin() -> None:
    """A fault propagated from the first proposal that differs; it is contained if none does.

    Where one run halts, there is nothing to compare behind its end, and nothing is said.
    """
    ways: Counter[str] = Counter()

    @settings(max_examples=200, derandomize=True, deadline=None)
    @given(duels)
    def law(duel: Duel) -> None:
        episode, twin = fought(duel, alone=False), fought(duel, alone=True)
        (record,) = episode.faults
        answer = Divergence.of(episode, twin).of_fault(record)
        own, other = (list(each.decisions["proposed"]) for each in (episode, twin))
        common = min(len(own), len(other))
        apart = next((t for t in range(common) if own[t] != other[t]), None)
        manifested = tick_of(record.manifested_at)
        if manifested is None:
            assert answer is None
            return
        assert answer is not None
        if apart is not None:
            expected = ("propagated", apart)
        elif len(own) != len(other) and manifested >= common:
            expected = ("unknown", None)
        else:
            expected = ("contained", None)
        assert (answer.status, tick_of(answer.at)) == expected
        ways[answer.status] += 1
        ways["propagated at once"] += apart == manifested

    law()
    assert min(ways[name] for name in ("unknown", "contained", "propagated at once")) > 9, ways


# Early ends


@pytest.mark.parametrize("check", ["always (level < 3)", "eventually (level > 3)"])
@pytest.mark.parametrize("kind", ["none", "planned", "by chance"])
def test_an_end_before_its_time_waits_for_faults_that_could_matter(check: str, kind: str) -> None:
    """For one whose hits are drawn, and for any other one unless all is violated already."""
    late = {"target": "level", "at": 5.0, "duration": None}
    faults = {
        "none": (),
        "planned": (bias("f", 1.0, at=5.0, duration=None),),
        "by chance": (fault("f", type="omission", parameters={"p": 0.5}, **late),),
    }[kind]
    episode = run_loop(
        lambda view: Proposal(float(view.percept["level"])),
        simulator=Clockwork(),
        judge=RequirementJudge([Requirement("R", check=check)]),
        spec={"faults": faults, "termination": Termination(20.0, decided=True)},
        fault_injector=CampaignInjector(),
    )
    waits = kind == "by chance" or (kind == "planned" and check.startswith("eventually"))
    assert episode.termination == "decided"
    assert (episode.time[-1] > 5.0) == waits
    assert all(record.manifested_at is not None for record in episode.faults) == (
        waits or kind == "none"
    )
