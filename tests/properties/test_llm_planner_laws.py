"""Laws of a language model as the component: what it is asked, when its answers land, what fails.

Each law runs the planner in the real loop with a scripted model in this process, and compares what
reached the model, or was proposed, with a reference that counts in ticks and decisions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import models
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura import Episode
from pytest_dura.llm import Answer, Request

law = settings(derandomize=True, deadline=None, max_examples=12)
MANEUVERS = ("proceed", "yield", "accelerate", "proceed_cautiously")
TICKS = 20
LOOP_BUDGET = 5.0
"""Seconds for one proposal, unless a test says otherwise."""


def numbered(_: Request, number: int) -> str:
    return models.said(MANEUVERS[number % 4], reasoning=f"reason {number};")


def asked(answers: Any = numbered, **params: Any) -> tuple[Episode, models.Model]:
    """An episode of two seconds in which nothing is asked beside the deciding requests."""
    params = {**models.ALONE, **params}
    return models.llm_episode(answers, params, seconds=TICKS / 10)


# Requests


@law
@given(st.integers(2, 6), st.integers(1, 4), st.integers(1, 4))
def test_adding_samples_shifts_no_deciding_request_and_no_other_sample(
    every: int, samples: int, beside_every: int
) -> None:
    """Samples stand beside every n-th decision from the first one on, each with its own seed."""

    def constant(request: Request, number: int) -> str:
        return models.said("wait" if request.sample else "proceed")

    options = {"decide_every": every, "beside_every": beside_every}
    alone, model = asked(constant, samples=1, **options)
    sampled, more = asked(constant, samples=samples, **options)
    decisions = math.ceil(TICKS / every)
    expected = [
        (number, sample)
        for number in range(decisions)
        for sample in range(1 if number % beside_every else samples)
    ]
    assert [request.sample for request in more.requests] == [sample for _, sample in expected]
    for (number, sample), request in zip(expected, more.requests, strict=True):
        deciding = model.requests[number]
        assert request == replace(deciding, sample=sample, seed=request.seed)
        assert (request.seed == deciding.seed) == (sample == 0)
    seeds = {(request.sample, request.seed) for request in more.requests}
    assert len(seeds) == len({seed for _, seed in seeds}) == samples, "one seed for each sample"
    assert len(model.requests) == decisions
    assert sampled.decisions["proposed"].tolist() == alone.decisions["proposed"].tolist()
    assert sampled.signals["speed"].tolist() == alone.signals["speed"].tolist()


@law
@given(st.integers(2, 6), st.integers(0, 5))
def test_a_prompt_tells_of_as_many_earlier_decisions_as_its_history_has(
    every: int, history: int
) -> None:
    _, model = asked(decide_every=every, history=history)
    assert len(model.requests) == math.ceil(TICKS / every)
    for number, request in enumerate(model.requests):
        text = request.messages[-1].text
        remembered = [n for n in range(number) if f"reason {n};" in text]
        assert remembered == list(range(max(number - history, 0), number))


# Time


@settings(law, max_examples=25)
@given(
    st.integers(1, 6),
    st.lists(st.integers(0, 9) | st.sampled_from([0.5, 1.25, 3.75]), min_size=1, max_size=4),
)
def test_in_real_time_a_decision_lands_at_the_first_tick_that_its_latency_reaches(
    every: int, latencies: list[float]
) -> None:
    """Latencies are in ticks; one is asked for only after the last one has landed."""

    def late(request: Request, number: int) -> Answer:
        return Answer(numbered(request, number), seconds=latencies[number % len(latencies)] / 10)

    episode, model = asked(late, decide_every=every, clock="realtime", fallback="wait")
    proposed, holds, due, lands, number = [], "wait", 0, math.inf, -1
    for tick in range(TICKS):
        if tick >= lands:
            holds, lands = MANEUVERS[number % 4], math.inf
        if tick >= due and lands == math.inf:
            number, due = number + 1, tick + every
            lands = tick + math.ceil(latencies[number % len(latencies)])
            if lands == tick:
                holds, lands = MANEUVERS[number % 4], math.inf
        proposed.append(holds)
    assert episode.decisions["proposed"].tolist() == proposed
    assert len(model.requests) == number + 1


@pytest.mark.parametrize("seconds", [0.0, 0.5, 1.5, 2.0, 2.001])
@pytest.mark.parametrize("delay", [0.0, 0.5, 1.999, 2.0, 3.0])
def test_an_answer_counts_to_the_last_instant_of_its_budget(seconds: float, delay: float) -> None:
    """A delay that leaves it no time at all is a timeout that no model is asked for."""
    fault = {
        "type": "model-delay",
        "activation": {"at": 0.0},
        "duration": None,
        "parameters": {"seconds": delay},
    }
    params = {**models.ALONE, "budget": 2.0}
    episode, model = models.llm_episode(
        lambda *_: Answer(models.said(), seconds=seconds), params, faults=[fault], seconds=0.1
    )
    in_time = delay < 2.0 and seconds + delay <= 2.0
    assert len(model.requests) == (delay < 2.0)
    assert episode.metrics.valid_proposals == in_time
    outcomes = {name for name, tally in episode.metrics.tallies.items() if tally.hits}
    assert ("timeout" in outcomes) is not in_time
    (took,) = episode.metrics.answer_seconds
    assert took == pytest.approx(min(seconds + delay, 2.0))


@pytest.mark.parametrize("own", [None, 1.0, 5.0, 9.0])
@pytest.mark.parametrize("loops", [2.0, 5.0, 30.0])
def test_the_tighter_of_two_budgets_is_the_models(own: float | None, loops: float) -> None:
    params = {**models.ALONE, "budget": own}
    _, model = models.llm_episode(lambda *_: models.said(), params, seconds=0.1, time_budget=loops)
    assert model.budgets == [min(loops, loops if own is None else own)]


@law
@given(st.integers(1, 4), st.permutations(MANEUVERS), st.integers(6, 12))
def test_an_acceleration_is_extrapolated_no_longer_than_two_decisions_lie_apart(
    apart: int, maneuvers: Sequence[str], latency: int
) -> None:
    """Along the line through both, and within the envelope; the third decision comes late."""

    def answers(_: Request, number: int) -> Answer:
        seconds = latency / 10 if number == 2 else 0.0
        return Answer(models.said(maneuvers[number % 4]), seconds=seconds)

    options = {"decide_every": apart, "clock": "realtime", "between": "extrapolate"}
    episode, _ = asked(answers, **options)
    shown = [account["acceleration"] for account in episode.recording.accounts]
    first, second = shown[0], shown[apart]
    for tick in range(apart, 2 * apart + latency):
        passed = min(tick - apart, apart)
        line = second + (second - first) / apart * passed
        assert shown[tick] == pytest.approx(min(max(line, -8.0), 4.0), abs=1e-6)


# Servers


@pytest.mark.parametrize("fingerprint", ["f00d", "beef"])
def test_answers_of_another_server_than_the_component_was_settled_with_are_none(
    fingerprint: str,
) -> None:
    """Nobody is asked, and the episode is missing: it says nothing about the component."""
    server = {"fingerprint": fingerprint, "structured": "json_schema", "seed": True}
    episode, model = asked(model="scripted", server=server)
    same = fingerprint == "f00d"  # which the model of the test says that it has
    assert (episode.validity == "missing") is not same
    assert bool(model.requests) is same
    if not same:
        assert "the server is another" in episode.failure
