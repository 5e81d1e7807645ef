"""Laws of the loop: who decides at each tick, what ends an episode, and what follows for metrics.

Each law draws a script of what the parts do tick by tick, runs it in the real loop, and compares
with a reference that reads the script alone.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import pytest
from clockwork import Clockwork
from hypothesis import given, settings
from hypothesis import strategies as st
from loops import Says, doing, run_loop

from pytest_dura import (
    Assessed,
    Assessment,
    Episode,
    Generator,
    Proposal,
    Recovery,
    RecoveryPlanner,
    Requirement,
    RoleContext,
    SafetyMonitor,
    Termination,
    derive_seed,
    stream,
)
from pytest_dura.core import GeneratorView, switching
from pytest_dura.requirements import RequirementJudge

DT = 0.1
CRITICAL = 3
"""Level of an assessment that says safe, and critical."""


# Decisions


class Script(NamedTuple):
    """What the parts do; rows are ticks, and columns the attempts at a proposal."""

    policy: str
    valid: list[list[bool]]
    levels: dict[str, list[list[int]]]
    end: Termination
    world: dict[str, int | None]

    @property
    def attempts(self) -> int:
        return int(self.policy[7:-1]) if self.policy.startswith("refine") else 0


@st.composite
def scripts(draw: st.DrawFn) -> Script:
    ticks = draw(st.integers(1, 9))

    def table(cell: st.SearchStrategy[Any]) -> Any:
        return draw(
            st.lists(st.lists(cell, min_size=3, max_size=3), min_size=ticks, max_size=ticks)
        )

    level = st.sampled_from([0, 0, 0, 1, 2, 2, CRITICAL])
    moment = st.none() | st.integers(0, 10)
    return Script(
        draw(st.sampled_from(["recover", "log_only", "halt", "refine(1)", "refine(2)"])),
        table(st.sampled_from([True, True, True, False])),
        {"first_watch": table(level), "second_watch": table(level)},
        Termination(
            ticks * DT,
            goal=draw(st.booleans()),
            iterations=draw(st.none() | st.integers(1, 10)),
        ),
        {name: draw(moment) for name in ("goal", "critical", "truncated")},
    )


def played(script: Script) -> Episode:
    """The episode of a script; two monitors look at each proposal."""
    asked: Counter[int] = Counter()

    def propose(view: GeneratorView) -> Proposal:
        attempt = asked[view.index]
        asked[view.index] += 1
        return Proposal(float(attempt) if script.valid[view.index][attempt] else None)

    def watch(name: str) -> Any:
        def look(view: Any) -> Assessment:
            level = script.levels[name][view.index][asked[view.index] - 1]
            if level == CRITICAL:
                return Assessment(Assessed.SAFE, 0.0, critical=True)
            return Assessment(Assessed(level), 0.0)

        return doing(SafetyMonitor, look)

    return run_loop(
        propose,
        simulator=Clockwork(),
        policy=script.policy,
        spec={"termination": script.end, "scenario": {"world": script.world}},
        recovery_planner=doing(RecoveryPlanner, lambda _: Recovery(0.5, "rescue")),
        **{name: watch(name) for name in script.levels},
    )


class Row(NamedTuple):
    """A decision, with what the component was asked for it."""

    verdict: int
    source: str
    attempts: int
    valid: int


def decided(script: Script, tick: int) -> Row | None:
    """The decision of a tick; ``None`` to halt."""
    refines, attempt = script.attempts, 0
    while True:
        levels = [min(rows[tick][attempt], 2) for rows in script.levels.values()]
        verdict = max(*levels, 0 if script.valid[tick][attempt] else 2)
        if verdict < 2 or attempt == refines:
            break
        attempt += 1
    source = "proposal" if script.valid[tick][attempt] else "fallback"
    if verdict == 2 and script.policy == "halt":
        return None
    if verdict == 2 and script.policy != "log_only":
        source = "recovery"
    return Row(verdict, source, attempt, sum(script.valid[tick][: attempt + 1]))


def expected(script: Script) -> tuple[list[Row], str]:
    """All decisions of the script, and what ends it."""
    rows: list[Row] = []
    limit, most = round(script.end.time_limit / DT), script.end.iterations
    for tick in range(limit + 1):
        ends = {
            "critical": tick == script.world["critical"],
            "goal": script.end.goal and tick == script.world["goal"],
            "time": tick == limit,
            "iterations": most is not None and tick >= most,
            "truncated": tick == script.world["truncated"],
        }
        if any(ends.values()):
            return rows, next(name for name, holds in ends.items() if holds)
        row = decided(script, tick)
        if row is None:
            return rows, "halt"
        rows.append(row)
    raise AssertionError("the time limit ends every script")


def stretches(rows: Sequence[Row]) -> list[tuple[int, int]]:
    """First and last tick of each stretch in which recovery decided."""
    acting = [False, *(row.source == "recovery" for row in rows), False]
    firsts = [tick for tick in range(len(rows)) if acting[tick + 1] and not acting[tick]]
    lasts = [tick for tick in range(len(rows)) if acting[tick + 1] and not acting[tick + 2]]
    return list(zip(firsts, lasts, strict=True))


def test_each_decision_and_the_end_are_those_of_the_script() -> None:
    ways: Counter[str] = Counter()

    @settings(max_examples=150, derandomize=True, deadline=None)
    @given(scripts())
    def law(script: Script) -> None:
        rows, end = expected(script)
        episode = played(script)
        columns = [episode.decisions[name].tolist() for name in ("verdict", "source", "attempts")]
        assert list(zip(*columns, strict=True)) == [row[:3] for row in rows]
        assert (episode.termination, episode.ticks) == (end, len(rows) + 1)
        assert not episode.ended_early
        if end != "halt":  # the tick of a halt is asked for as well, and has no decision
            assert episode.metrics.proposals == sum(row.attempts + 1 for row in rows)
            assert episode.metrics.valid_proposals == sum(row.valid for row in rows)
        ways[end] += 1
        ways.update(row.source for row in rows)
        ways.update(f"{script.policy} {row.attempts}" for row in rows)

    law()
    ends = ("critical", "goal", "time", "iterations", "truncated", "halt")
    assert min(ways[name] for name in (*ends, "recovery", "fallback", "refine(2) 1")) > 4, ways


def test_takeovers_and_successes_of_recovery_follow_from_the_decisions() -> None:
    ways: Counter[str] = Counter()

    @settings(max_examples=150, derandomize=True, deadline=None)
    @given(scripts())
    def law(script: Script) -> None:
        rows, end = expected(script)
        episode, spans = played(script), stretches(rows)
        control = switching(episode)
        acceptable = [tick for tick, row in enumerate(rows) if row.verdict < 2]
        waits = [next((t - first for t in acceptable if t > first), None) for first, _ in spans]
        assert control.takeovers == len(spans)
        assert [None if wait is None else round(wait / DT) for wait in control.time_to_safe] == (
            waits
        )
        assert control.returns == sum(last < len(rows) - 1 for _, last in spans)
        # It failed where it was still acting at the end, and where a breakdown followed.
        succeeded = [
            last < len(rows) - 1 and not (end == "critical" and (first, last) == spans[-1])
            for first, last in spans
        ]
        assert episode.metrics.recoveries == [
            (first, last, success) for (first, last), success in zip(spans, succeeded, strict=True)
        ]
        ways.update(f"{success} {end}" for success in succeeded)
        ways["at the first tick"] += bool(spans) and spans[0][0] == 0
        ways["unsafe before safe"] += any(wait is not None and wait > 1 for wait in waits)

    law()
    names = ("True time", "False time", "False critical", "at the first tick", "unsafe before safe")
    assert min(ways[name] for name in names) > 4, ways


# Ends


@pytest.mark.parametrize(
    "check, end, ended, early",
    [
        ("always (level < 3)", Termination(9.0, violation=True), "violation", True),
        ("always (level < 3)", Termination(9.0, decided=True), "decided", True),
        ("eventually (level > 3)", Termination(9.0, decided=True), "decided", True),
        ("always (level < 300)", Termination(9.0, violation=True), "time", False),
        ("always (level < 3)", Termination(9.0), "time", False),
    ],
)
def test_an_episode_ended_early_exactly_where_its_requirements_ended_it(
    check: str, end: Termination, ended: str, early: bool
) -> None:
    episode = run_loop(
        lambda view: Proposal(0.0),
        simulator=Clockwork(),
        judge=RequirementJudge([Requirement("R", check=check)]),
        spec={"termination": end},
    )
    assert (episode.termination, episode.ended_early) == (ended, early)
    assert (episode.ticks <= end.last_index(DT)) == early


# Time budgets


@settings(max_examples=60, derandomize=True, deadline=None)
@given(st.lists(st.integers(0, 9), max_size=5), st.integers(1, 10))
def test_a_component_that_overran_three_times_is_not_called_again(
    overrun: list[int], ticks: int
) -> None:
    overran = sorted(set(overrun))
    component = Says(lambda view: Proposal(1.0))
    episode = run_loop(
        component,
        simulator=Clockwork(),
        seconds=ticks * DT,
        spec={"timeouts": tuple(overran)},
    )
    given_up = overran[2] if len(overran) > 2 else math.inf
    answered = [tick for tick in range(ticks) if tick not in overran and tick < given_up]
    assert [view.index for view in component.views] == answered
    assert episode.metrics.valid_proposals == len(answered)
    assert episode.timeouts == tuple(tick for tick in overran[:3] if tick < ticks)


@pytest.mark.parametrize("budget", [0.25, 5.0])
@pytest.mark.parametrize("share, valid", [(0.0, True), (0.5, True), (1.0, True), (1.001, False)])
def test_an_answer_within_its_budget_counts_to_the_last_instant(
    budget: float, share: float, valid: bool
) -> None:
    episode = run_loop(
        lambda view: Proposal(1.0, latency=budget * share),
        simulator=Clockwork(),
        seconds=DT,
        spec={"time_budget": budget},
    )
    assert episode.metrics.valid_proposals == int(valid)


# Seeds


class Drawing(Generator):
    """Draws from a stream of the world's name, and proposes what it drew."""

    def reset(self, context: RoleContext) -> None:
        self.seed, self._stream = context.seed, stream(context.seed, "world")

    def propose(self, view: GeneratorView) -> Proposal:
        return Proposal(float(self._stream.random()))


@pytest.mark.parametrize("seed", [0, 1, 99])
def test_a_component_cannot_draw_the_numbers_of_its_world(seed: int) -> None:
    component = Drawing()
    episode = run_loop(component, simulator=Clockwork(), spec={"seed": seed})
    assert component.seed == derive_seed(seed, "generator")
    assert not set(episode.signals["noise"]) & set(episode.signals["power"])
    silent = run_loop(lambda view: Proposal(0.0), simulator=Clockwork(), spec={"seed": seed})
    assert silent.signals["noise"].tolist() == episode.signals["noise"].tolist()


@settings(max_examples=100, derandomize=True, deadline=None)
@given(
    st.integers(0, 200),
    st.lists(st.text("ab1", max_size=2) | st.integers(0, 20), max_size=3),
    st.integers(0, 200),
    st.lists(st.text("ab1", max_size=2) | st.integers(0, 20), max_size=3),
)
def test_other_names_are_another_seed(
    base: int, names: list[object], other: int, others: list[object]
) -> None:
    same = [str(base), *map(str, names)] == [str(other), *map(str, others)]
    assert (derive_seed(base, *names) == derive_seed(other, *others)) is same
