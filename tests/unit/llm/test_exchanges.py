"""Request and answer of a decision in its account: whole, bounded, and in nothing measured."""

from __future__ import annotations

import json

from hypothesis import given, settings
from hypothesis import strategies as st
from models import Model, llm_episode, said

from pytest_dura.core.loop_signals import LONGEST, account_problem
from pytest_dura.evidence import Trace, first_difference
from pytest_dura.llm import Answer, Message, Request
from pytest_dura.llm.planner import exchange_data
from pytest_dura.llm.session import ModelSession

EVERY_SECOND = {"decide_every": 10}


def exchanges(episode):
    return [each["exchange"] for each in episode.recording.accounts if each["decided"]]


def test_each_new_decision_keeps_what_was_asked_and_answered():
    answer = said("wait", observations="a car")
    usage = {"prompt_tokens": 7, "completion_tokens": 3}
    episode, model = llm_episode(
        lambda *_: Answer(answer, seconds=0.25, finish="stop", usage=usage), EVERY_SECOND
    )
    kept = exchanges(episode)
    assert len(kept) == len(model.requests) == 3
    for exchange, request in zip(kept, model.requests, strict=True):
        texts = [(message.role, message.text) for message in request.messages]
        assert [(each["role"], each["text"]) for each in exchange["messages"]] == texts
        assert (exchange["answer"], exchange["usage"], exchange["seconds"]) == (answer, usage, 0.25)
    others = [each for each in episode.recording.accounts if not each["decided"]]
    assert not any("exchange" in each for each in others)


def test_a_failure_is_kept_with_its_detail():
    episode, _ = llm_episode(lambda *_: Answer(failure="refused", detail="I may not"), EVERY_SECOND)
    assert {(each["answer"], each["detail"]) for each in exchanges(episode)} == {("", "I may not")}


def test_words_are_in_no_digest_and_in_no_comparison_of_traces():
    told = [
        llm_episode(lambda *_, text=text: said("wait", observations=text), EVERY_SECOND)[0]
        for text in ("all is calm", "all is quiet")
    ]
    assert exchanges(told[0]) != exchanges(told[1])
    assert told[0].digest == told[1].digest
    assert first_difference(*map(Trace.of, told)) is None


TEXT = st.sampled_from(["x", "\x00", "\u20ac", "\U0001f600", "\ud800", '"', "ab "])


@settings(derandomize=True, max_examples=30)
@given(
    st.lists(st.tuples(TEXT, st.integers(0, 40_000)), min_size=1, max_size=8),
    st.tuples(TEXT, st.integers(0, 40_000)),
)
def test_however_long_a_prompt_is_the_account_is_one(messages, answer):
    request = Request("m", tuple(Message("user", text * count) for text, count in messages))
    data = exchange_data(request, Answer(answer[0] * answer[1], thoughts=answer[0] * answer[1]))
    assert account_problem({"exchange": data}) is None
    assert len(json.dumps(data)) < 0.7 * LONGEST
    last, whole = data["messages"][-1]["text"], request.messages[-1].text
    assert last == whole or last.endswith(f"... ({len(whole)} characters)")


def test_a_component_with_a_very_long_prompt_still_decides(tmp_path):
    (tmp_path / "system.j2").write_text("Drive. " + "\u20ac" * 20_000, "utf-8")
    episode, _ = llm_episode(lambda *_: said("wait"), EVERY_SECOND | {"templates": str(tmp_path)})
    assert {each["outcome"] for each in episode.recording.accounts} == {"answered"}
    system, *_, user = exchanges(episode)[0]["messages"]
    assert "characters)" in system["text"]
    assert user["text"].startswith("EGO")


def test_keys_of_servers_and_other_secrets_are_taken_out():
    class Keyed(Model):
        def scrub(self, text):
            return text.replace("sk-1", "***")

    def without_password(value):
        return value.replace("pass", "+++") if isinstance(value, str) else value

    model = Keyed(lambda *_: said())
    session = ModelSession(environ={}, connect=lambda *_: model, scrub=without_password)
    session.describe()
    request = Request("m", (Message("user", "sk-1 and pass"),))
    (message,) = exchange_data(request, Answer(), session.scrub_text)["messages"]
    assert message["text"] == "*** and +++"
