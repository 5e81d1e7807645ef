"""Laws of claims: who copies the prompt is never accused, who is off by its rounding always."""

from __future__ import annotations

from typing import Any

from hypothesis import assume, given, settings
from hypothesis import strategies as st
from roads import car, channels_of, walker

from pytest_dura.core import Percept, Tick
from pytest_dura.driving import BodyList, EgoState
from pytest_dura.driving.explanations import account_measures
from pytest_dura.driving.junction import route
from pytest_dura.llm import percept_prompt
from pytest_dura.llm.driving.planner import shown_facts

laws = settings(derandomize=True, deadline=None, max_examples=60)
X, Y, HEADING = (float(value) for value in route(0, "straight").pose(50.0))
EGO = EgoState(X, Y, HEADING, 8.0, 0.0, 0.0, 0.0, 50.0, 0.0)
PLACES, SPEEDS = st.floats(-40.0, 40.0), st.floats(-9.0, 9.0)
BODIES = st.lists(
    st.tuples(st.sampled_from([car, walker]), PLACES, PLACES, SPEEDS), min_size=1, max_size=6
)


def worlds(drawn: Any) -> tuple[Percept, list[Tick], dict[str, dict[str, Any]]]:
    """A percept, the world that it is true to, and what a prompt shows of each object."""
    bodies = [
        make(f"V{number}", x, y, 0.0, vx) if make is car else make(f"P{number}", x, y)
        for number, (make, x, y, vx) in enumerate(drawn, start=1)
    ]
    percept = Percept(channels_of(*bodies, speed=EGO.speed))
    truth = {"ego": EGO, "bodies": BodyList.of(bodies), "contact": 0}
    prompt = percept_prompt(percept)
    assert set(shown_facts(prompt)) == set(prompt.ids)
    return percept, [Tick(0, 0.0, truth, {}), Tick(1, 0.1, truth, {})], shown_facts(prompt)


def measured(percept: Percept, ticks: list[Tick], claims: list[dict[str, Any]]) -> dict[str, float]:
    account = {
        "decided": True, "at": 0, "outcome": "answered", "maneuver": "wait", "claims": claims,
        "perceived": [claim["id"] for claim in claims],
    }  # fmt: skip
    columns = account_measures(ticks, [percept], [account], 0.1)
    return {name: column[0] for name, column in columns.items() if "claims" in name}


@laws
@given(drawn=BODIES)
def test_who_copies_the_prompt_is_accused_of_nothing_nor_misled_by_true_sensors(drawn) -> None:
    percept, ticks, shown = worlds(drawn)
    bodies = {name: facts for name, facts in shown.items() if name[0] in "VP"}
    assume(bodies)
    claims = [{"id": name, **facts, "shown": facts} for name, facts in bodies.items()]
    assert measured(percept, ticks, claims) == {
        "claims_unperceived": 0, "claims_mistaken": 0, "claims_misled": 0, "without_claims": 0,
    }  # fmt: skip


@laws
@given(drawn=BODIES, key=st.sampled_from(["ahead_m", "arrives_s"]), off=st.floats(-3.0, 3.0))
def test_a_number_is_mistaken_as_soon_as_it_is_off_by_more_than_the_prompts_rounding(
    drawn, key, off
) -> None:
    assume(abs(abs(off) - 0.05) > 1e-3)
    percept, ticks, shown = worlds(drawn)
    name = next((each for each, facts in shown.items() if key in facts), None)
    assume(name is not None)
    facts = shown[name]
    claim = {"id": name, **facts, key: facts[key] + off, "shown": facts}
    assert measured(percept, ticks, [claim])["claims_mistaken"] == (abs(off) > 0.05)
