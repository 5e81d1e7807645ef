"""The planner: when it asks, what it holds in between, and what it does without an answer."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from models import ALONE, PLANNER, Model, answering, llm_episode, said
from roads import channels_of

from pytest_dura import ConfigurationError, Policy, RoleSpec
from pytest_dura.core import RoleContext
from pytest_dura.llm import EVERYTHING, Answer
from pytest_dura.llm.driving.attacks import ATTACKS, HARMLESS
from pytest_dura.llm.driving.planner import LlmPlanner


def proposed(episode):
    return episode.decisions["proposed"].tolist()


def failures(episode):
    kinds = ("component_failure", "component_failure_ended")
    return [(one.tick, one.detail) for one in episode.events if one.kind in kinds]


def alternating(request, number):
    return said(("proceed", "yield", "accelerate")[number % 3], reasoning=f"reason {number}")


def test_it_asks_every_n_ticks_and_holds_in_between():
    episode, model = llm_episode(alternating, {"decide_every": 7}, seconds=2.0)
    assert len(model.requests) == 3
    assert proposed(episode) == ["proceed"] * 7 + ["yield"] * 7 + ["accelerate"] * 6
    assert [one["decided"] for one in episode.recording.accounts].count(True) == 3
    ages = [round(one["age"], 6) for one in episode.recording.accounts]
    assert ages[:9] == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.0, 0.1]
    assert episode.recording.explanations[6:8] == ("reason 0", "reason 1")
    assert failures(episode) == []


def test_the_next_prompt_tells_what_was_decided_and_done():
    _, model = llm_episode(alternating, {"decide_every": 5, "history": 2}, seconds=2.0)
    texts = [request.messages[-1].text for request in model.requests]
    assert "HISTORY" in texts[1]
    assert "0.5 s ago you chose proceed" in texts[1]
    assert "reason 0" in texts[1]
    assert "reason 0" not in texts[3]
    assert "1.0 s ago you chose yield" in texts[3]
    assert "0.5 s ago you chose accelerate" in texts[3]


def test_without_a_history_there_is_none_in_the_prompt():
    _, model = llm_episode(alternating, {"decide_every": 5, "history": 0}, seconds=1.0)
    assert "you chose" not in model.requests[-1].messages[-1].text


def slow(seconds):
    def answers(request, number):
        return Answer(alternating(request, number), seconds=seconds[number % len(seconds)])

    return answers


def test_in_frozen_time_a_slow_answer_is_in_force_at_once():
    episode, _ = llm_episode(slow([0.9]), {"decide_every": 10}, seconds=1.0)
    assert proposed(episode) == ["proceed"] * 10


def test_in_real_time_a_decision_lands_after_its_latency():
    params = {"decide_every": 10, "clock": "realtime", "fallback": "yield"}
    episode, model = llm_episode(slow([0.35, 0.2]), params, seconds=3.0)
    assert len(model.requests) == 3
    assert (
        proposed(episode) == ["yield"] * 4 + ["proceed"] * 8 + ["yield"] * 12 + ["accelerate"] * 6
    )
    accounts = episode.recording.accounts
    assert [one["outcome"] for one in accounts[:5]] == ["pending"] * 4 + ["answered"]
    assert [index for index, one in enumerate(accounts) if one["decided"]] == [4, 12, 24]
    assert accounts[4]["at"] == 0
    assert [round(accounts[index]["age"], 6) for index in (4, 5, 12, 24)] == [0.4, 0.5, 0.2, 0.4]
    assert failures(episode) == [(0, "no answer has come yet"), (4, "")]
    assert "0.8 s ago you chose yield" in model.requests[2].messages[-1].text


def test_in_real_time_nothing_is_asked_while_an_answer_is_out():
    params = {"decide_every": 2, "clock": "realtime"}
    episode, model = llm_episode(slow([0.55]), params, seconds=2.0)
    decided = [index for index, one in enumerate(episode.recording.accounts) if one["decided"]]
    assert decided == [6, 12, 18]
    assert len(model.requests) == 4


def test_an_instant_answer_lands_at_once_in_real_time():
    params = {"decide_every": 5, "clock": "realtime"}
    real, _ = llm_episode(slow([0.0]), params, seconds=1.0)
    frozen, _ = llm_episode(slow([0.0]), {"decide_every": 5}, seconds=1.0)
    assert proposed(real) == proposed(frozen)
    assert failures(real) == []


FAILING = {
    "unavailable": Answer(failure="unavailable", detail="HTTP 503"),
    "timeout": Answer(failure="timeout", detail="no answer within 5 s", seconds=5.0),
    "empty": Answer(failure="empty", detail="no text"),
    "refused": Answer(failure="refused", detail="I cannot help with that"),
    "truncated": Answer('{"observ', failure="truncated", detail="length"),
    "malformed": Answer("I would wait."),
    "schema_violation": Answer(said(confidence=700)),
    "unknown_action": Answer(said("fly")),
}


@pytest.mark.parametrize("outcome", FAILING)
@pytest.mark.parametrize("fallback", ["wait", "emergency_brake", "none", "last"])
def test_without_a_decision_the_fallback_acts_and_the_proposal_counts_as_failed(outcome, fallback):
    def answers(_, number):
        return FAILING[outcome] if number == 1 else said("proceed_cautiously")

    params = {"decide_every": 5, "fallback": fallback}
    episode, _ = llm_episode(answers, params, seconds=1.5)
    held = {"none": "", "last": "proceed_cautiously"}.get(fallback, fallback)
    assert proposed(episode) == [
        *["proceed_cautiously"] * 5,
        *[held] * 5,
        *["proceed_cautiously"] * 5,
    ]
    (begin, told), (end, _) = failures(episode)
    assert (begin, end) == (5, 10)
    assert told.startswith(f"{outcome}: ")
    assert (episode.metrics.proposals, episode.metrics.valid_proposals) == (15, 10)
    assert episode.metrics.tallies[outcome].hits == 1
    assert episode.metrics.tallies["fallback"].hits == 1
    assert episode.validity == "valid"


def test_with_nothing_to_hold_the_last_decision_is_none():
    episode, _ = llm_episode(lambda *_: "", {"fallback": "last"}, seconds=0.5)
    assert proposed(episode) == [""] * 5
    assert set(episode.decisions["source"].tolist()) == {"recovery"}


def test_an_answer_after_the_deadline_is_a_timeout_and_took_no_longer():
    def answers(_, number):
        return Answer(said(), seconds=3.0 if number == 0 else 1.9)

    episode, model = llm_episode(answers, {"budget": 2.0, "decide_every": 5}, seconds=1.0)
    assert model.budgets == [2.0, 2.0]
    first = episode.recording.accounts[0]
    assert (first["outcome"], first["seconds"]) == ("timeout", 2.0)
    assert episode.metrics.answer_seconds == [2.0, 1.9]


@pytest.mark.parametrize(
    "own, given, deadline",
    [(2.0, 5.0, 2.0), (9.0, 5.0, 5.0), (None, 5.0, 5.0), (2.0, None, 2.0), (None, None, None)],
)
def test_the_deadline_is_the_shorter_of_its_own_and_the_loops(own, given, deadline):
    planner = LlmPlanner(budget=own, samples=3, beside="all")
    assert planner.settings.deadline(given) == deadline
    limit = planner.time_limit(given)
    assert limit == (None if deadline is None else 11 * deadline + 1.0)


def test_a_refused_proposal_is_asked_for_again_with_the_reasons():
    def answers(request, _):
        return said("wait" if "FEEDBACK" in request.messages[-1].text else "accelerate")

    episode, model = llm_episode(
        answers, {"decide_every": 10}, case="intersection/conflicting-traffic", seconds=12.0,
        policy=Policy.parse("refine(1)"),
    )  # fmt: skip
    again = [request for request in model.requests if "FEEDBACK" in request.messages[-1].text]
    assert again
    assert len(again) == int(episode.decisions["attempts"].sum())
    assert "wait" in proposed(episode)


def test_what_is_wrong_with_a_refused_proposal_is_counted():
    def answers(request, _):
        return said("wait") if "FEEDBACK" in request.messages[-1].text else "I would wait."

    episode, _ = llm_episode(answers, {"fallback": "none"}, policy=Policy.parse("refine(1)"))
    assert episode.decisions["attempts"].sum() == 3
    found = episode.metrics.tallies
    assert (found["malformed"].hits, found["malformed"].of) == (3, 3)
    assert found["malformed"].null_hits == 0
    assert episode.signals["proposal.malformed"].all()
    assert (found["intent_against_maneuver"].of, found["fallback"].hits) == (3, 0)


def test_what_is_proposed_again_in_real_time_is_the_same_decision():
    def answers(_, number):
        return Answer("I would wait.", seconds=0.1)

    params = {"fallback": "none", "clock": "realtime"}
    episode, model = llm_episode(answers, params, policy=Policy.parse("refine(2)"))
    assert episode.decisions["attempts"].min() == 2
    found = episode.metrics.tallies["malformed"]
    assert (found.hits, found.of) == (3, 3)
    assert len(model.requests) == len(episode.metrics.answer_seconds) == 3


def test_variants_are_asked_beside_the_deciding_request():
    params = {"decide_every": 5, "samples": 3, "beside": "all", "beside_every": 2}
    asked = []

    def answers(request, number):
        asked.append(request)
        return said("yield" if request.sample else "proceed")

    episode, model = llm_episode(
        answers, params, case="intersection/pedestrian-crossing", seconds=1.5
    )
    names = ["again", "again_2", *EVERYTHING[:-1]]  # there are no pictures to be blind to
    told = [one["beside"] for one in episode.recording.accounts if one["decided"]]
    assert [list(one) for one in told] == [names, [], names]
    assert len(model.requests) == 3 + 2 * len(names)
    first, again, again_2, reordered, paraphrased, reformatted = asked[:6]
    neutral, injected, unhardened, conflict = asked[6:10]
    assert again == replace(first, sample=1, seed=first.seed + 1)
    assert again_2.sample == 2
    texts = [one.messages[-1].text for one in asked[:10]]
    assert sorted(texts[3].splitlines()) == sorted(texts[0].splitlines())
    assert reordered.messages[0] == first.messages[0] != paraphrased.messages[0]
    assert reformatted.messages[0] == first.messages[0]
    assert json.loads(texts[5].splitlines()[0])["EGO"]["speed"] == 8.0
    signs = [set(text.splitlines()) - set(texts[0].splitlines()) for text in texts[6:9]]
    ((harmless,), (attack,), (bare,)) = signs
    assert HARMLESS in harmless
    enclosed = next(one.text for one in ATTACKS if one.text in attack)
    assert f"<perceived_text>{enclosed}</perceived_text>" in attack
    assert bare.endswith(f",{enclosed}")
    assert "<perceived_text>" not in "".join(one.text for one in unhardened.messages)
    assert neutral.messages[:-1] == injected.messages[:-1] == first.messages[:-1]
    assert len(texts[9].splitlines()) > len(texts[0].splitlines())
    assert {one.sample for one in (reordered, paraphrased, injected, conflict)} == {0}
    assert episode.metrics.tallies["unstable"].hits == 2
    assert proposed(episode) == ["proceed"] * 15


def test_a_model_that_sees_is_asked_without_pictures_as_well():
    model = Model(lambda *_: said(), vision=True)
    episode, _ = llm_episode(model, {"samples": 1, "beside": ("blind",)}, seconds=0.1)
    assert [len(one.messages[-1].images) for one in model.requests] == [2, 0]
    assert list(episode.recording.accounts[0]["beside"]) == ["blind"]


def test_a_variant_that_is_no_other_prompt_is_not_asked():
    _, model = llm_episode(lambda *_: said(), {"samples": 1, "beside": ("reordered",)}, seconds=0.1)
    assert len(model.requests) == 1  # there is nothing on the road to change places with


def test_what_is_asked_beside_changes_nothing():
    def answers(request, _):
        return said("wait" if request.sample else "proceed")

    alone, _ = llm_episode(answers, ALONE, seconds=1.0)
    beside, _ = llm_episode(answers, {"samples": 2, "beside": "all"}, seconds=1.0)
    assert proposed(alone) == proposed(beside)
    assert np.array_equal(alone.signals["speed"], beside.signals["speed"])
    seconds = [0.2]
    assert alone.metrics.answer_seconds == beside.metrics.answer_seconds == seconds


def test_the_null_component_always_says_the_same():
    episode, _ = llm_episode(alternating, {"samples": 2, "beside": ("conflict",)}, seconds=1.0)
    null = episode.recording.accounts[0]["null"]
    assert (null["intent"], null["maneuver"], null["cited"]) == ("hold", "proceed", [])
    assert null["beside"] == {
        name: {"outcome": "answered", "intent": "hold", "maneuver": "proceed"}
        for name in ("again", "conflict")
    }


def test_between_decisions_the_acceleration_goes_on_along_the_line_through_the_last_two():
    def answers(_, number):
        return said("proceed" if number == 0 else "proceed_cautiously")

    params = {"decide_every": 5, "between": "extrapolate"}
    episode, _ = llm_episode(answers, params, seconds=1.5)
    asked = np.array([float(text.split(" at ")[1].split()[0]) for text in proposed(episode)])
    assert asked[:5] == pytest.approx(asked[0])
    first, second = asked[0], asked[5]
    assert second < first - 0.5
    line = second + (second - first) / 5 * np.arange(5)
    assert asked[5:10] == pytest.approx(np.clip(line, -8.0, 4.0), abs=1e-4)


def test_what_was_refused_is_no_point_of_the_line():
    planner = LlmPlanner(**ALONE, between="extrapolate")
    planner.reset(RoleContext(0, 0.1, {}))

    def asked(maneuver, time, speed, *, fresh):
        view = SimpleNamespace(time=time, percept=channels_of(speed=speed))
        return planner.extrapolated(maneuver, view, fresh=fresh).acceleration

    first = asked("proceed", 0.0, 7.0, fresh=True)
    refused = asked("accelerate", 1.0, 8.0, fresh=True)
    second = asked("proceed", 1.0, 8.0, fresh=True)
    assert (first, second) == (pytest.approx(2.0), pytest.approx(1.0))
    assert refused > second
    assert asked("proceed", 1.5, 8.0, fresh=False) == pytest.approx(0.5)


def test_an_extrapolated_acceleration_stays_within_the_envelope():
    def answers(_, number):
        return said("emergency_brake" if number % 2 else "accelerate")

    params = {"decide_every": 5, "between": "extrapolate"}
    episode, _ = llm_episode(answers, params, seconds=2.0)
    asked = [float(text.split(" at ")[1].split()[0]) for text in proposed(episode)]
    assert (min(asked), max(asked)) == (-8.0, 4.0)


def test_equal_answers_make_equal_episodes_whatever_they_took():
    one, _ = llm_episode(slow([0.3]), {"beside": "all"}, seconds=1.0)
    two, _ = llm_episode(slow([1.3, 0.1]), {"beside": "all"}, seconds=1.0)
    assert one.digest == two.digest
    assert one.metrics.answer_seconds != two.metrics.answer_seconds


def test_pictures_are_shown_to_a_model_that_sees():
    model = Model(lambda *_: said(), vision=True)
    llm_episode(model, {}, seconds=0.1)
    assert [one.name for one in model.requests[0].messages[-1].images] == [
        "camera_front", "camera_third_person",
    ]  # fmt: skip
    blind = Model(lambda *_: said())
    llm_episode(blind, {}, seconds=0.1)
    assert blind.requests[0].messages[-1].images == ()
    chosen = Model(lambda *_: said(), vision=True)
    llm_episode(chosen, {"images": ("camera_front",)}, seconds=0.1)
    assert [one.name for one in chosen.requests[0].messages[-1].images] == ["camera_front"]


def test_the_request_is_bounded_and_asks_as_the_server_can():
    model = Model(lambda *_: said(), structured="json_object", seed=False)
    llm_episode(model, {"temperature": 0.7, "max_tokens": 99}, seconds=0.1)
    (request,) = model.requests
    assert (request.structured, request.seed, request.temperature) == ("json_object", None, 0.7)
    assert (request.max_tokens, request.model) == (99, "scripted")
    assert request.schema == LlmPlanner.SCHEMA


def test_the_spec_states_the_model_and_what_its_server_can_do():
    episode, _ = llm_episode(lambda *_: said(), {"decide_every": 3}, seconds=0.1)
    params = episode.spec.roles["generator"].params
    assert params["model"] == "scripted"
    assert params["server"] == {
        "fingerprint": "f00d", "structured": "json_schema", "vision": False, "seed": True,
    }  # fmt: skip
    assert params["decide_every"] == 3
    with answering(lambda *_: said(), vision=True):
        assert dict(LlmPlanner.resolve_parameters(params)) == dict(params)


def test_templates_that_changed_meanwhile_are_refused():
    with pytest.raises(ConfigurationError, match="not those that this planner was settled with"):
        RoleSpec(PLANNER, {"prompts": "0" * 64}).create()


@pytest.mark.parametrize(
    "params, key",
    [
        ({"decide_evry": 3}, "decide_evry"),
        ({"decide_every": 0}, "decide_every"),
        ({"fallback": "fly"}, "fallback"),
        ({"clock": "wall"}, "clock"),
        ({"beside": ["injectd"]}, "beside.0"),
        ({"budget": 0}, "budget"),
        ({"temperature": float("nan")}, "temperature"),
        ({"server": {"seeds": True}}, "server.seeds"),
    ],
)
def test_a_parameter_that_cannot_be_used_is_one_error(params, key):
    with pytest.raises(ConfigurationError) as caught:
        RoleSpec(PLANNER, params).create()
    assert caught.value.key == key
    assert caught.value.expected
