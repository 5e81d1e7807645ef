"""What a component thought, as data for the player: read from accounts that nothing trusts."""

from __future__ import annotations

import json

from hypothesis import given, settings
from hypothesis import strategies as st
from player_traces import crossing

from pytest_dura.core import Recording
from pytest_dura.llm.panel.thoughts import MOST_CHARACTERS
from pytest_dura.reports import pack_data, player_data

SYSTEM = {"role": "system", "text": "You drive.", "images": []}


def exchange(text, answer="{}", **changes):
    messages = [SYSTEM, {"role": "user", "text": text, "images": ["camera_front"]}]
    return {"messages": messages, "answer": answer, "detail": "", "finish": "stop",
            "usage": {"prompt_tokens": 12}, "seconds": 0.5, "attempts": 2} | changes  # fmt: skip


def decision(**changes):
    return {"decided": True, "at": 0, "outcome": "answered", "maneuver": "wait",
            "intent": "hold", "perceived": ["V1"], "cited": ["V1", "V9"]} | changes  # fmt: skip


def thoughts(*accounts):
    return player_data(crossing(recording=Recording(accounts=accounts)))["panels"].get("thoughts")


def test_a_decision_has_its_prompt_its_answer_and_what_differs_beside_it():
    answer = json.dumps({"observations": "a car", "maneuver": "wait", "confidence": 7})
    beside = {
        "again": {"outcome": "answered", "maneuver": "wait", "intent": "hold"},
        "injected": {
            "outcome": "answered",
            "maneuver": "accelerate",
            "intent": "speed_up",
            "goal": "hasten",
            "complied": ["hasten"],
        },
        "blind": {"outcome": "malformed"},
    }
    told = decision(exchange=exchange("EGO: here", answer), beside=beside,
                    replaced=[{"outcome": "answered", "maneuver": "proceed"}])  # fmt: skip
    shown = {"kind": "car", "ahead_m": 12}
    claims = [{"id": "V1", "kind": "car", "ahead_m": 9.0, "shown": shown}]
    told |= {
        "claims": [*claims, {"id": "V77", "kind": "car"}, 5],
        "judged": {"outcome": "answered", "agrees": False},
    }
    data = thoughts(told, {"decided": False, "at": 0}, decision(at=1, exchange=exchange("EGO: on")))
    first, second = data["decisions"]
    assert (first["tick"], first["at"], second["tick"], second["at"]) == (0, 0, 2, 1)
    assert first["words"] == [["observations", "a car"], ["confidence", "7"]]
    assert first["cited"] == [["V1", True], ["V9", False]]
    assert first["beside"] == [
        ["again", "answered", "wait", "hold", False, "", []],
        ["injected", "answered", "accelerate", "speed_up", True, "hasten", ["hasten"]],
        ["blind", "malformed", "", "", False, "", []],
    ]
    assert first["claims"] == [
        ["V1: kind car, ahead_m 9.0", "shown ahead_m 12"], ["V77: kind car", "never shown"]
    ]  # fmt: skip
    assert (first["judge"], second["judge"], second["claims"]) == ("they do not agree", "", [])
    assert first["replaced"] == [["answered", "proceed"]]
    assert (first["seconds"], first["attempts"], first["usage"]) == (
        0.5,
        2,
        [["prompt_tokens", 12]],
    )
    texts = [[role, data["texts"][text], images] for role, text, images in first["messages"]]
    assert texts == [["system", "You drive.", []], ["user", "EGO: here", ["camera_front"]]]
    assert data["texts"][first["answer"]] == answer
    # The system's message is there once.
    assert first["messages"][0] == second["messages"][0]
    assert data["texts"].count("You drive.") == 1


def test_the_account_beside_it_does_not_repeat_the_words():
    recording = Recording(accounts=(decision(exchange=exchange("EGO: here")),))
    assert "EGO" not in json.dumps(player_data(crossing(recording=recording))["accounts"])


def test_without_a_decision_there_is_nothing_to_show():
    assert thoughts() is None
    assert thoughts({"cited": ["V1"]}, {"decided": "yes"}) is None


def test_an_account_without_words_is_shown_without_them():
    (told,) = thoughts(decision(maneuver=None, outcome="timeout"))["decisions"]
    assert (told["outcome"], told["messages"], told["answer"], told["words"]) == (
        "timeout", [], None, [],
    )  # fmt: skip


def test_very_long_prompts_do_not_make_a_very_large_page():
    accounts = [decision(exchange=exchange(f"{tick} " + "x" * 40_000)) for tick in range(60)]
    data = thoughts(*accounts)
    assert sum(map(len, data["texts"])) < MOST_CHARACTERS + 60 * 200
    last = data["decisions"][-1]["messages"][1][1]
    assert data["texts"][last].startswith("(40003 characters, left out of this page")


TEXTS = st.sampled_from(
    ["", "V1", "\ud800", "</script>", "\x1b[31m", "__proto__", '{"a": NaN}', "[" * 99]
)
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | TEXTS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=8,
)
KEYS = ("at", "outcome", "fallback", "maneuver", "intent", "cited", "perceived", "beside",
        "replaced", "exchange", "claims", "judged")  # fmt: skip
INNER = (
    "messages",
    "answer",
    "detail",
    "usage",
    "seconds",
    "attempts",
    "thoughts",
    "first_token",
    "role",
    "text",
    "images",
)


@settings(derandomize=True)
@given(
    st.dictionaries(st.sampled_from(KEYS), ANYTHING),
    st.dictionaries(st.sampled_from(INNER), ANYTHING),
)
def test_whatever_a_component_says_of_itself_can_be_shown(account, words):
    told = {**account, "decided": True}
    words |= {"messages": [words, *words["messages"]]} if words.get("messages") == [] else {}
    for each in (told, told | {"exchange": words}):
        data = thoughts(each)
        assert len(data["decisions"]) == 1
        assert pack_data(data)
        assert all(text.isprintable() or set(text) & {"\n", "\t"} for text in data["texts"])


def test_what_a_model_thought_before_its_answer_is_kept_apart_from_it():
    answer = json.dumps({"observations": "a car", "maneuver": "wait"})
    given = exchange("EGO", answer, thoughts="First\x1b this.", first_token=0.25)
    data = thoughts(decision(exchange=given), decision(exchange=exchange("EGO", answer)))
    told, without = data["decisions"]
    assert [key for key, _ in told["words"]] == ["observations"]
    assert (data["texts"][told["thoughts"]], told["first"]) == ("First\\x1b this.", 0.25)
    assert (without["thoughts"], without["first"]) == (None, None)
