"""Laws of black boxes: an episode made at once is the one of the loop, batches change nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pytest_dura import BlackBox, Input, RoleSpec, Runner, Simulator
from pytest_dura.adapters.black_box_run import BlackBoxRun
from pytest_dura.campaign import Limits
from pytest_dura.core import EpisodeSpec, Orchestrator, Termination
from pytest_dura.faults import CampaignInjector
from pytest_dura.library import case_with_faults
from pytest_dura.library.loading import load_library
from pytest_dura.library.scenario import Scenario
from pytest_dura.requirements.model import Requirement
from pytest_dura.search import Objective
from pytest_dura.search.falsify import falsify


def integrated(time, inputs):
    return {"x": np.cumsum(inputs["u"](time) - 0.5) * 0.1, "y": np.sin(time) * inputs["v"](time)}


INPUTS = [Input("u", 0.0, 1.0, pieces=4), Input("v", -1.0, 1.0, pieces=3, interpolation="linear")]
BOX = BlackBox(integrated, INPUTS, ["x", "y"])
worlds = st.fixed_dictionaries(
    {
        "u": st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4),
        "v": st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    }
)


class Looped(BlackBoxRun):
    """A run that the loop goes over sample by sample."""

    recorded_episode = Simulator.recorded_episode


@given(
    worlds,
    st.floats(0.3, 12.0),
    st.sampled_from([0.1, 0.25, 0.03]),
    st.none() | st.integers(1, 60),
    st.tuples(st.booleans(), st.booleans()),
)
def test_an_episode_made_at_once_is_that_of_the_loop(
    world, duration, step, iterations, flags
) -> None:
    has_injector, recorded = flags
    roles = {"generator": RoleSpec(f"{__name__}:BOX", {"component": True})}
    if has_injector:
        roles["fault_injector"] = RoleSpec.of(CampaignInjector)
    scenario = {"duration": duration, "iterations": iterations, "world": world}
    end = Termination(duration, iterations=iterations)
    spec = EpisodeSpec(
        "box", 0, 7, RoleSpec(f"{__name__}:BOX"), roles, scenario, time_step=step, termination=end
    )

    def run(simulator):
        parts = {"generator": BOX(component=True)}
        if has_injector:
            parts["fault_injector"] = CampaignInjector()
        return Orchestrator(simulator, parts, recorded=recorded).run(spec)

    at_once, looped = run(BlackBoxRun(BOX)), run(Looped(BOX))
    assert at_once.failure is None
    assert not at_once.metrics.processing_ns  # no component was asked
    assert looped.metrics.processing_ns
    assert at_once.digest == looped.digest
    assert at_once.termination == looped.termination
    assert at_once.metrics.deterministic() == looped.metrics.deterministic()
    assert at_once.drawn == looped.drawn
    assert at_once.recording == looped.recording
    for name, column in looped.decisions.items():
        assert np.array_equal(at_once.decisions[name], column)
        assert at_once.decisions[name].dtype == column.dtype


SIZES: list[int] = []
"""Sizes of the batches."""


def together(time, inputs):
    SIZES.append(len(inputs))
    u, v = (np.array([each[name](time) for each in inputs]) for name in ("u", "v"))
    x, y = np.cumsum(u - 0.5, axis=1) * 0.1, np.sin(time) * v
    return [{"x": x[i], "y": y[i]} for i in range(len(inputs))]


def off_by_a_little(time, inputs):
    return [{name: each + 1e-9 for name, each in run.items()} for run in together(time, inputs)]


def refusing(time, inputs):
    if any(each["u"](0.0) > 0.5 for each in inputs):
        raise ValueError("no such run")
    return together(time, inputs)


MANY = BlackBox(integrated, INPUTS, ["x", "y"], simulate_many=together)
OFF = BlackBox(integrated, INPUTS, ["x", "y"], simulate_many=off_by_a_little)
REFUSING = BlackBox(integrated, INPUTS, ["x", "y"], simulate_many=refusing)


@given(st.lists(worlds, min_size=1, max_size=7), st.integers(1, 7), st.integers(2, 40))
def test_no_run_depends_on_those_that_it_is_simulated_with(given_worlds, size, samples) -> None:
    time = np.arange(samples) * 0.1
    for box in (MANY, REFUSING):
        for first in range(0, len(given_worlds), size):
            batch = given_worlds[first : first + size]
            for world in batch:
                box.announce(batch)
                found, alone = box.columns(world, time), BOX.columns(world, time)
                assert found.keys() == alone.keys()
                assert all(np.array_equal(found[name], alone[name]) for name in alone)


def searched(name, budget, check="always (x <= 4)", seed=5):
    """Search a case of a box of this module; the result, and the sizes of its batches."""
    del SIZES[:]
    scenario = Scenario.model_validate(
        {
            "name": "box/one",
            "simulator": f"{__name__}:{name}",
            "duration": 10.0,
            "variation": {
                "world.u": {"min": 0.0, "max": 1.0, "pieces": 4},
                "world.v": {"min": -1.0, "max": 1.0, "pieces": 3},
            },
        }
    )
    runner = Runner(lambda: load_library([]))
    objective = Objective(Requirement("X-1", text="It stays near.", kind="safety", check=check))
    limits = Limits(budget, shrink=0, baselines=False)
    case = case_with_faults(scenario, "none")
    return falsify(runner, case, [objective], limits=limits, seed=seed), list(SIZES)


@pytest.mark.parametrize("budget, check", [(60, "always (x <= 40)"), (40, "always (x <= 4)")])
def test_a_search_in_batches_finds_what_it_finds_one_by_one(budget, check) -> None:
    batches, sizes = searched("MANY", budget, check)
    one_by_one, none = searched("BOX", budget, check)
    assert max(sizes) > 1
    assert sum(sizes) >= batches.simulations
    assert none == []
    (first,), (second,) = batches.outcomes, one_by_one.outcomes
    for name in ("status", "simulations", "searcher", "best"):
        assert getattr(first, name) == getattr(second, name)
    margins = [each.counterexample and each.counterexample.margin for each in (first, second)]
    assert margins[0] == margins[1]
    assert batches.searchers == one_by_one.searchers


def test_a_batch_that_differs_from_the_run_alone_ends_the_run() -> None:
    time, batch = np.arange(5) * 0.1, [{"u": [0.1] * 4, "v": [0.2] * 3}, {"u": [0.9] * 4}]
    for world in batch:
        OFF.announce(batch)
        with pytest.raises(ValueError, match=r"simulate_many returns x = .*where simulate returns"):
            OFF.columns(world, time)


def beyond_the_first(time, inputs):
    first, *rest = together(time, inputs)
    return [first, *({name: each + 9.0 for name, each in run.items()} for run in rest)]


SLY = BlackBox(integrated, INPUTS, ["x", "y"], simulate_many=beyond_the_first)


def test_a_run_by_itself_has_nothing_of_a_batch_that_was_left() -> None:
    time, batch = np.arange(5) * 0.1, [{"u": [0.1] * 4}, {"u": [0.9] * 4}]
    SLY.announce(batch)
    SLY.columns(batch[0], time)
    alone = BOX.columns(batch[1], time)
    assert all(np.array_equal(SLY.columns(batch[1], time)[name], alone[name]) for name in alone)


def test_a_violation_of_a_batch_alone_is_not_repeatable() -> None:
    result, sizes = searched("SLY", 40)
    assert max(sizes) > 1
    assert result.outcomes[0].status == "not repeatable"
