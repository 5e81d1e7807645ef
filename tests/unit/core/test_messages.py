"""What a component sends through the loop, what it hears of its past, and decisions it failed."""

from __future__ import annotations

import time

import numpy as np
import pytest
from loops import Says, doing, run_loop

from pytest_dura import (
    Fault,
    FaultInjector,
    Injection,
    Proposal,
    Recovery,
    RecoveryPlanner,
    SafetyMonitor,
)
from pytest_dura.core import NOTHING, Assessed, Assessment, ComponentEnvironmentError

LOUDER = [Fault("bias", "louder", "prompt", {"at": 0.3})]


class Louder(FaultInjector):
    """Changes each message of the channel `prompt` from 0.3 s on."""

    def __init__(self, *, fails=False):
        self.fails = fails

    def run(self, view):
        return Injection(("louder",)) if view.index == 3 else Injection()

    def corrupt_message(self, channel, message, now):
        if self.fails:
            raise RuntimeError("no line")
        if channel == "prompt" and now > 0.25:
            return message.upper(), ("louder",)
        return message, ()


def test_a_message_arrives_as_it_was_sent_without_an_injector():
    heard = []

    def talk(view):
        heard.append(view.transmit("prompt", "cold"))
        return Proposal(1.0)

    run_loop(talk, seconds=0.5)
    assert heard == ["cold"] * 5


def test_a_fault_of_a_message_manifests_when_the_message_is_sent():
    heard = []

    def talk(view):
        if view.index != 3:
            heard.append((view.index, view.transmit("prompt", "cold")))
        return Proposal(1.0)

    episode = run_loop(talk, fault_injector=Louder(), seconds=0.6, spec={"faults": LOUDER})
    assert heard == [(0, "cold"), (1, "cold"), (2, "cold"), (4, "COLD"), (5, "COLD")]
    (fault,) = episode.faults
    assert fault.activated_at == pytest.approx(0.3)
    assert fault.manifested_at == pytest.approx(0.4)
    assert fault.manifest_ticks == 2
    assert episode.validity == "valid"


def test_a_fault_of_a_message_that_is_never_sent_makes_the_episode_invalid():
    episode = run_loop(
        lambda _: Proposal(1.0), fault_injector=Louder(), seconds=0.6, spec={"faults": LOUDER}
    )
    assert episode.invalid_reason == "never manifested: louder"


@pytest.mark.parametrize("catches", [False, True])
def test_an_injector_that_fails_within_a_proposal_is_no_failure_of_the_component(catches):
    def talk(view):
        try:
            view.transmit("prompt", "cold")
        except ComponentEnvironmentError:
            if not catches:
                raise
        return Proposal(1.0)

    episode = run_loop(talk, fault_injector=Louder(fails=True), seconds=0.5)
    assert episode.validity == "missing"
    assert "fault_injector" in episode.failure
    assert "no line" in episode.failure
    assert not [event for event in episode.events if event.kind == "component_failure"]


def test_a_component_hears_what_became_of_its_proposals():
    seen = []

    def answer(view):
        seen.append(
            [(one.proposed, one.explanation, one.executed, one.source) for one in view.past]
        )
        return Proposal(view.index / 10, f"said {view.index}")

    def refuses(view):
        return Assessment(Assessed.UNSAFE if view.index == 1 else Assessed.SAFE)

    run_loop(
        answer,
        seconds=0.3,
        safety_monitor=doing(SafetyMonitor, refuses),
        recovery_planner=doing(RecoveryPlanner, lambda _: Recovery(1.0, "heat")),
    )
    first = (0.0, "said 0", 0.0, "proposal")
    assert seen == [[], [first], [first, (0.1, "said 1", 1.0, "recovery")]]


def test_the_past_is_the_component_s_to_read_and_not_to_change():
    def answer(view):
        with pytest.raises(TypeError):
            view.past[0] = None
        return Proposal(0.0)

    episode = run_loop(answer, seconds=0.3)
    assert not [event for event in episode.events if event.kind == "component_failure"]


def test_a_fallback_is_carried_out_and_counts_as_a_failed_proposal():
    def answer(view):
        if view.index < 2:
            return Proposal(1.0, failure="timeout: no answer", account={"outcome": "timeout"})
        return Proposal(0.5)

    episode = run_loop(answer, seconds=0.4)
    assert episode.decisions["source"].tolist() == ["proposal"] * 4
    assert episode.decisions["executed"].tolist() == ["100%", "100%", "50%", "50%"]
    assert (episode.metrics.proposals, episode.metrics.valid_proposals) == (4, 2)
    assert episode.metrics.violations["component"] == 2
    (failure,) = [event for event in episode.events if event.kind == "component_failure"]
    assert failure.detail == "timeout: no answer"


def test_a_failure_without_a_fallback_leaves_the_plant_to_the_loop():
    episode = run_loop(lambda _: Proposal(None, failure="unavailable: no server"), seconds=0.2)
    assert episode.decisions["source"].tolist() == ["fallback"] * 2
    (failure,) = [event for event in episode.events if event.kind == "component_failure"]
    assert failure.detail == "unavailable: no server"


@pytest.mark.parametrize(
    "proposal, told",
    [
        (Proposal(1.0, failure=None), "gave a failure that is NoneType, not str"),
        (Proposal(1.0, account=[1]), "gave an account that is list, not a mapping"),
        (Proposal(1.0, account={"a": np.zeros(2)}), "gave an account that is no plain data"),
        (Proposal(1.0, account={"a": float("nan")}), "gave an account that is no plain data"),
        (Proposal(1.0, account={"a": "x" * 200_000}), "gave an account of 200"),
    ],
)
def test_what_is_no_account_is_a_failure_of_the_component(proposal, told):
    episode = run_loop(lambda _: proposal, seconds=0.2)
    (failure,) = [event for event in episode.events if event.kind == "component_failure"]
    assert failure.detail.startswith(told)
    assert episode.validity == "valid"


class Patient(Says):
    """Asks for more wall-clock time than its budget."""

    def time_limit(self, budget):
        return budget + 10.0


def test_a_component_with_a_deadline_of_its_own_is_held_to_what_it_declares():
    def slow(view):
        time.sleep(0.1)
        return Proposal(1.0, latency=0.2 if view.index else 0.01)

    episode = run_loop(Patient(slow), seconds=0.2, spec={"time_budget": 0.05})
    assert episode.timeouts == ()
    (failure,) = [event for event in episode.events if event.kind == "component_failure"]
    assert (failure.tick, failure.detail) == (1, "answered after 0.2 s; its budget is 0.05 s")
    assert run_loop(slow, seconds=0.2, spec={"time_budget": 0.05}).timeouts == (0, 1)


def test_a_component_learns_its_time_budget():
    class Asks(Says):
        def reset(self, context):
            self.budget = context.time_budget

    asks = Asks(lambda _: Proposal(1.0))
    run_loop(asks, seconds=0.1, spec={"time_budget": 2.5})
    assert asks.budget == 2.5
    assert Proposal(1.0).account is NOTHING


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan"), float("inf"), "5", True])
def test_a_time_limit_that_is_none_fails_the_component_and_not_the_loop(limit):
    class Odd(Says):
        def time_limit(self, budget):
            return limit

    episode = run_loop(Odd(lambda _: Proposal(1.0)), seconds=0.2)
    assert episode.validity == "valid"
    assert f"its time_limit is {limit!r}" in episode.events[0].detail
    assert episode.metrics.valid_proposals == 0


def test_a_time_limit_that_raises_fails_the_component_and_not_the_loop():
    class Odd(Says):
        def time_limit(self, budget):
            raise RuntimeError("no idea")

    episode = run_loop(Odd(lambda _: Proposal(1.0)), seconds=0.2)
    assert "no idea" in episode.events[0].detail
    assert episode.metrics.valid_proposals == 0


def test_a_component_may_ask_for_no_limit():
    class Endless(Says):
        def time_limit(self, budget):
            return None

    assert run_loop(Endless(lambda _: Proposal(1.0)), seconds=0.2).metrics.valid_proposals == 2
