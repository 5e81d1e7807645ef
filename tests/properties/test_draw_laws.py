"""Laws of draws: adding a fault, a role, an arm or a run shifts the numbers of nobody else.

And an episode knows whether any number was drawn in it.

Faults among themselves stand in ``test_fault_plan_laws`` and ``test_fault_independence``, and the
samples of a language model in ``test_llm_planner_laws``.
"""

from __future__ import annotations

import contextvars
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from threading import Barrier
from typing import Any

import pytest
from clockwork import Clockwork
from hypothesis import given, settings
from hypothesis import strategies as st
from injecting import Drawing, fault
from loops import run_loop
from shaft import lift_scenario

from pytest_dura import Assessment, Proposal, RoleContext, SafetyMonitor, Tick, stream
from pytest_dura.core import GeneratorView
from pytest_dura.faults import CampaignInjector
from pytest_dura.library import Case, Scenario, case_with_faults, expand_cases

law = settings(derandomize=True, deadline=None, max_examples=25)


# Within an episode


class Gambler(SafetyMonitor):
    """Scores each proposal by a number that it draws."""

    def __init__(self, name: str) -> None:
        self._name = name

    def reset(self, context: RoleContext) -> None:
        self._stream = stream(context.seed, self._name)

    def run(self, view: Any) -> Assessment:
        return Assessment(score=float(self._stream.random()))


PLANS = {
    name: fault(name, type="injecting:Drawing", target="level", probability=0.3, duration="once")
    for name in ("first", "second")
}
ROLES = ("gambler", "player")


def draws(seed: int, parts: frozenset[str]) -> dict[str, Any]:
    """All that was drawn in an episode with these faults and roles, by who drew it."""
    Drawing.noted.clear()

    def propose(view: GeneratorView) -> Proposal:
        view.percept["level"]
        return Proposal(0.0)

    episode = run_loop(
        propose,
        simulator=Clockwork(),
        seconds=2.0,
        spec={"seed": seed, "faults": tuple(PLANS[name] for name in PLANS if name in parts)},
        fault_injector=CampaignInjector(),
        **{name: Gambler(name) for name in ROLES if name in parts},
    )
    numbers: dict[str, Any] = {"world": episode.signals["noise"].tolist()}
    for name in PLANS:
        if name in parts:
            numbers[name] = [row for row in Drawing.noted if row[0] == name]
    return numbers | {name: scores[1] for name, scores in episode.metrics.robustness.items()}


@law
@given(st.integers(0, 2**53 - 1), st.sets(st.sampled_from([*PLANS, *ROLES])))
def test_world_faults_and_roles_draw_the_same_whoever_else_draws(
    seed: int, parts: set[str]
) -> None:
    everybody = draws(seed, frozenset([*PLANS, *ROLES]))
    some = draws(seed, frozenset(parts))
    assert set(some) == {"world", *parts}
    assert some == {name: everybody[name] for name in some}
    other = draws(seed + 1, frozenset(parts))
    for name in {"world", *parts} & {"world", *ROLES}:
        assert not set(some[name]) & set(other[name])
    assert not set(everybody["world"]) & {*everybody["gambler"], *everybody["player"]}
    assert not set(everybody["gambler"]) & set(everybody["player"])


class Still(Clockwork):
    """A clockwork of which nothing is drawn."""

    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick:
        self._index = 0
        return self._tick()

    def step(self, action: Any) -> Tick:
        self._index += 1
        return self._tick()

    def _tick(self) -> Tick:
        return Tick(self._index, self._index * self.time_step, {"level": 0.0}, {"level": 0.0})


def directly(call: Callable[[], Any]) -> Any:
    """Call it in this thread."""
    return call()


def in_a_thread(call: Callable[[], Any]) -> Any:
    """Call it in a thread that is begun for it, whose context is empty."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(call).result(10.0)


def with_the_context(call: Callable[[], Any]) -> Any:
    """As a time limit does: in a thread that has a copy of this one's context."""
    return in_a_thread(partial(contextvars.copy_context().run, call))


@pytest.mark.parametrize("drawing", [True, False])
@pytest.mark.parametrize("way", ["directly", "thread", "context", "context of another episode"])
def test_an_episode_in_which_a_component_draws_says_so_whichever_thread_draws(
    way: str, drawing: bool
) -> None:
    """Runs in which nothing is drawn, nor declared to vary, are one situation, repeated."""
    kept: list[contextvars.Context] = []

    def propose(_: GeneratorView) -> Proposal:
        kept.append(contextvars.copy_context())
        return Proposal(0.0)

    run_loop(propose, simulator=Still(), seconds=0.2)
    earlier = kept[0]
    ways: dict[str, Callable[[Callable[[], Any]], Any]] = {
        "directly": directly,
        "thread": in_a_thread,
        "context": with_the_context,
        "context of another episode": lambda call: in_a_thread(partial(earlier.run, call)),
    }

    def draws_some_or_none(_: GeneratorView) -> Proposal:
        ways[way](lambda: stream(7, "component").random(3 if drawing else 0))
        return Proposal(0.0)

    assert run_loop(draws_some_or_none, simulator=Still(), seconds=0.2).drawn == drawing


@pytest.mark.parametrize("own_context", [True, False], ids=["as in the loop", "empty context"])
def test_of_episodes_at_once_the_one_that_draws_says_so(own_context: bool) -> None:
    """A thread with an empty context may be of either, and counts for both."""
    together = Barrier(2)

    def episode(draws: bool) -> bool:
        def propose(view: GeneratorView) -> Proposal:
            together.wait(10.0)
            if draws and view.index == 1:
                (directly if own_context else in_a_thread)(lambda: stream(7, "own").random())
            together.wait(10.0)
            return Proposal(0.0)

        return run_loop(propose, simulator=Still(), seconds=0.3).drawn

    with ThreadPoolExecutor(2) as pool:
        drew, did_not = pool.map(episode, (True, False))
    assert (drew, did_not) == (True, not own_context)


# Within a campaign

ARMS: dict[str, list[str] | str] = {"none": "none", "drift": ["drift"], "both": ["noise", "bias"]}
ROLES_TO_MISS = {
    "recovery_planner": "thermostat:SwitchOff",
    "safety_monitor": "thermostat:HeatMonitor",
}


@cache
def scenario() -> Scenario:
    return lift_scenario(roles=ROLES_TO_MISS, runs=15)


def situation(case: Case, run: int, base_seed: int) -> tuple[int, Any]:
    """The seed and the world of a run."""
    spec = case.spec(run, base_seed)
    return spec.seed, spec.scenario["world"]


@law
@given(
    st.integers(0, 2**40),
    st.integers(0, 300),
    st.sampled_from(sorted(ROLES_TO_MISS)),
)
def test_the_arms_of_a_scenario_meet_the_same_worlds_run_by_run(
    base_seed: int, run: int, role: str
) -> None:
    """So that each run is a pair with its run of every other arm, also of one without a role."""
    plain = case_with_faults(scenario(), "none")
    arms = [case_with_faults(scenario(), faults) for faults in ARMS.values()]
    arms += [arm.switched_off(role) for arm in arms]
    assert len({arm.id for arm in arms}) == len(arms)
    for arm in arms:
        assert situation(arm, run, base_seed) == situation(plain, run, base_seed)
    for other in (situation(plain, run + 1, base_seed), situation(plain, run, base_seed + 1)):
        seed, world = situation(plain, run, base_seed)
        assert other[0] != seed
        assert other[1] != world, "what varies is drawn anew"


@pytest.mark.parametrize("runs", [1, 7, 400])
def test_planning_more_runs_or_more_arms_shifts_no_run(runs: int) -> None:
    planned = scenario().model_copy(update={"runs": runs})
    (alone,) = expand_cases([planned], ["none"])
    among = {case.id: case for case in expand_cases([planned], list(ARMS.values()))}[alone.id]
    known = case_with_faults(scenario(), "none")
    for run in range(5):
        expected = situation(known, run, 3)
        assert situation(alone, run, 3) == situation(among, run, 3) == expected
