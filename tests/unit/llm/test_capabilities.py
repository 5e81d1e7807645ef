"""The probe: what it finds of servers that keep to a schema, see and take seeds, or do not."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import scripted_server as script

from pytest_dura.core import ConfigurationError
from pytest_dura.llm import Answer, Endpoint, OpenAiClient
from pytest_dura.llm.capabilities import CODE, Capabilities, canary, holds_code, probe

ENDPOINT = Endpoint("http://127.0.0.1:8000/v1", "m1", "sk-0123456789")
KEPT = json.dumps({"words": ["a"], "sentence": "The sea.", "mood": "calm"})
ENTRY = {
    "id": "m1",
    "created": 1,
    "owned_by": "me",
    "permission": [{"id": "modelperm-1", "created": 1}],
    "meta": {"n_params": 7, "n_ctx": 4096},
}


class Model:
    """A server that can what is said; ``refusals`` are for the first requests, in order."""

    def __init__(self, *refusals, enforces=(), takes=(), sees=False, seeded=True, entry=ENTRY):
        self.refusals, self.enforces, self.takes = list(refusals), enforces, takes
        self.sees, self.seeded, self.entry = sees, seeded, entry
        self.asked = []
        self.guesses = False
        self.failure_of_listing = None
        self.fingerprints = ["fp_1"]

    def ask(self, request, budget, fault="", repeats=None):
        self.asked.append(request)
        if self.refusals:
            return self.refusals.pop(0)
        said = self.fingerprints[len(self.asked) % len(self.fingerprints)]
        return replace(self.answer(request), fingerprint=said)

    def answer(self, request):
        if request.structured in self.enforces:
            return Answer("{}" if request.structured == "json_object" else KEPT)
        if request.structured not in ("none", *self.takes):
            return refused(400, "unknown response_format")
        if request.messages[0].images:
            return Answer(f"{CODE[:3]} {CODE[3:].lower()}.") if self.sees else Answer("NONE")
        if self.guesses:
            return Answer(CODE)
        return Answer("The sea is wide." if self.seeded else f"words {len(self.asked)}")

    def listing(self, budget):
        if self.failure_of_listing:
            return self.failure_of_listing
        return Answer(json.dumps({"data": [{"id": "other"}, self.entry]}))


def refused(status, message):
    return Answer(failure="unavailable", detail=f"HTTP {status}: {message}")


def probed(model, **options):
    return probe(model, ENDPOINT, 5.0, pause=0.0, **options)


@pytest.mark.parametrize(
    "enforces, takes, level, enforced",
    [
        (("json_schema", "json_object_schema", "json_object"), (), "json_schema", True),
        (("json_object_schema", "json_object"), ("json_schema",), "json_object_schema", True),
        (("json_object",), ("json_schema",), "json_object", True),
        (("json_object",), (), "json_object", True),
        ((), ("json_schema", "json_object"), "json_schema", False),
        ((), ("json_object",), "json_object", False),
        (("tool", "json_object"), ("json_schema",), "tool", True),
        (("tool", "json_object"), (), "tool", True),
        ((), ("tool", "json_object"), "json_object", False),
        ((), (), "none", False),
    ],
)
def test_the_strongest_level_that_is_enforced_is_found(enforces, takes, level, enforced) -> None:
    model = Model(enforces=enforces, takes=takes)
    found = probed(model)
    assert (found.structured, found.enforced) == (level, enforced)
    assert 5 <= found.requests <= 9
    asked = [one for one in model.asked if one.structured != "none"]
    assert all("plain prose" in one.messages[0].text for one in asked), "it is tempted"
    for one in asked:
        assert f"{one.structured}: " in found.words["structured"]
    if not enforces and not takes:
        assert "HTTP 400: unknown response_format" in found.words["structured"]


def test_a_schema_of_one_s_own_is_the_one_that_counts() -> None:
    schema = {"type": "object", "properties": {"speed": {"type": "string", "maxLength": 9}}}
    model = Model(enforces=("json_schema",))
    found = probed(model, schema=schema)
    assert (found.structured, found.enforced) == ("json_schema", False)
    assert "json_schema: schema_violation, " in found.words["structured"]
    asked = [one.schema for one in model.asked if one.structured == "json_schema"]
    assert asked == [schema]


def test_a_model_sees_if_the_code_comes_back_and_does_not_without_the_picture() -> None:
    model = Model(sees=True)
    assert probed(model).vision is True
    shown, blind = model.asked[-2:]
    assert (len(shown.messages[0].images), blind.messages[0].images) == (1, ())
    assert shown.messages[0].text == blind.messages[0].text
    assert CODE not in shown.messages[0].text, "the question does not tell the code"
    assert probed(Model(sees=False)).vision is False


def test_a_model_that_tells_the_code_without_the_picture_is_not_seen_to_see() -> None:
    model = Model(sees=True)
    model.guesses = True
    found = probed(model)
    assert found.vision is False
    assert "without the picture, too" in found.words["vision"]


def test_a_server_that_refuses_pictures_is_blind_and_its_words_are_kept() -> None:
    model = Model()
    usual = model.answer
    model.answer = lambda request: (
        refused(500, "image input is not supported")
        if request.messages[0].images
        else usual(request)
    )
    found = probed(model)
    assert found.vision is False
    assert "image input is not supported" in found.words["vision"]


def test_a_seed_counts_if_two_answers_are_equal_where_sampling_is_free() -> None:
    model = Model()
    assert probed(model).seed is True
    first, second = model.asked[:2]
    assert first == second
    assert (first.temperature, first.seed) == (1.0, 7)
    assert all(one.seed == 7 for one in model.asked), "what is taken is used from then on"
    other = probed(Model(seeded=False))
    assert (other.seed, "different" in other.words["seed"]) == (False, True)


def test_without_a_seed_none_is_sent_any_more() -> None:
    model = Model(refused(422, "seed: extra fields not permitted"))
    found = probed(model)
    assert (found.seed, found.attempts) == (False, 2)
    assert [one.seed for one in model.asked] == [7, *[None] * (len(model.asked) - 1)]
    assert "refused" in found.words["seed"]


def test_nothing_to_compare_is_no_seed() -> None:
    empty = Answer(failure="truncated", detail="finish_reason: length")
    found = probed(Model(empty, empty))
    assert (found.seed, "nothing to compare" in found.words["seed"]) == (False, True)


def test_the_fingerprint_stays_where_server_and_model_do() -> None:
    before = probed(Model()).fingerprint
    later = {**ENTRY, "created": 2, "permission": [{"id": "modelperm-2"}], "status": "loaded"}
    assert probed(Model(entry=later)).fingerprint == before
    for change in ({"owned_by": "you"}, {"meta": {"n_params": 8}}, {"id": "m2"}):
        assert probed(Model(entry={**ENTRY, **change})).fingerprint != before
    other = Model()
    other.fingerprints = ["fp_2"]
    assert probed(other).fingerprint != before


def test_a_server_s_fingerprint_that_varies_is_left_out_and_told() -> None:
    one, other = Model(), Model()
    one.fingerprints, other.fingerprints = ["a", "b"], ["c", "d"]
    assert probed(one).fingerprint == probed(other).fingerprint
    assert "varies" in probed(one).words["server"]


@pytest.mark.parametrize(
    "entry, tokens",
    [
        ({"max_model_len": 8192}, 8192),
        ({"context_length": 131072}, 131072),
        ({"meta": {"n_ctx": 4096, "n_ctx_train": 9}}, 4096),
        ({"max_model_len": "long", "meta": []}, None),
        ({"max_model_len": True}, None),
        ({}, None),
    ],
)
def test_the_context_is_what_the_server_tells(entry, tokens) -> None:
    assert probed(Model(entry={"id": "m1", **entry})).context == tokens


@pytest.mark.parametrize(
    "listing",
    [refused(404, "Not Found"), Answer("<html>"), Answer("[1]"), Answer('{"data": [{"id": 3}]}')],
)
def test_a_server_without_a_list_of_models_can_be_used(listing) -> None:
    model = Model()
    model.failure_of_listing = listing
    found = probed(model)
    assert found.context is None
    assert len(found.fingerprint) == 64


def test_a_server_that_comes_late_is_waited_for_and_the_tries_are_told() -> None:
    down = Answer(failure="unavailable", detail="ConnectError: refused")
    found = probed(Model(down, refused(503, "Loading model")))
    assert found.attempts == 3
    assert found.requests == probed(Model()).requests + 2


@pytest.mark.parametrize(
    "answer, tries, key, told",
    [
        (Answer(failure="unavailable", detail="ConnectError: [Errno 111] Connection refused"), 3,
         "DURA_LLM_BASE_URL", ["3 tries", "Connection refused", "start the server"]),
        (refused(503, "Loading model"), 3, "DURA_LLM_BASE_URL", ["HTTP 503: Loading model"]),
        (Answer(failure="timeout", detail="late"), 3, "DURA_LLM_BASE_URL", ["more time", "5 s"]),
        (Answer(failure="malformed", detail="the body is no JSON: <html>"), 3,
         "DURA_LLM_BASE_URL", ["<html>", "check DURA_LLM_BASE_URL"]),
        (refused(401, "Incorrect key"), 1, "DURA_LLM_API_KEY", ["1 try", "check DURA_LLM_API_KEY"]),
        (refused(404, "no such model"), 1, "DURA_LLM_BASE_URL", ["/v1", "DURA_LLM_MODEL",
                                                                "lists other, m1"]),
        (refused(400, "bad model"), 5, "DURA_LLM_BASE_URL", ["check DURA_LLM_MODEL"]),
    ],
)  # fmt: skip
def test_a_server_that_gives_no_answer_is_one_clear_error(answer, tries, key, told) -> None:
    model = Model(*[answer] * 9)
    with pytest.raises(ConfigurationError) as caught:
        probed(model)
    assert len(model.asked) == tries
    assert caught.value.key == key
    for part in ["'m1'", "http://127.0.0.1:8000/v1", *told]:
        assert part in str(caught.value)
    assert ENDPOINT.key not in str(caught.value)


def test_capabilities_are_plain_data() -> None:
    capabilities = probed(Model(sees=True, enforces=("json_object",)))
    data = json.loads(json.dumps(capabilities.to_json()))
    assert Capabilities(**data) == capabilities
    assert set(capabilities.words) == {
        "structured", "vision", "seed", "server", "context", "fields"
    }  # fmt: skip


def test_the_canary_is_the_same_picture_everywhere() -> None:
    one = canary()
    assert one.digest == "a631ba2345658efb12e35ed4f3dd883b2fb2cca54ba4fb5d00e6959d909696bf"
    assert (one.pixels.shape, one.pixels.dtype) == ((168, 512, 3), np.uint8)
    assert set(np.unique(one.pixels)) == {0, 255}
    ink = (one.pixels[..., 0] == 0).any(axis=0)
    starts = np.flatnonzero(ink & ~np.roll(ink, 1))
    assert len(starts) == len(CODE), "the characters stand apart"


@pytest.mark.parametrize(
    "text, told",
    [("K7XM4R", True), ("It is **k7-xm 4r**.", True), ("K7XM4", False), ("NONE", False),
     ("", False)],
)  # fmt: skip
def test_the_code_is_told_however_it_is_set(text, told) -> None:
    assert holds_code(text) is told


def test_the_null_model_keeps_to_schemas_sees_nothing_and_takes_seeds(null_server) -> None:
    endpoint = Endpoint(null_server.base_url, null_server.model)
    found = probe(OpenAiClient(endpoint), endpoint, 20.0)
    assert (found.structured, found.enforced) == ("json_schema", True)
    assert (found.vision, found.seed, found.attempts) == (False, True, 1)
    assert "image input is not supported" in found.words["vision"]
    assert found.context is not None
    again = probe(OpenAiClient(endpoint), endpoint, 20.0)
    assert again == found


def test_a_server_that_ignores_format_picture_and_seed_can_none_of_it(scripted_server) -> None:
    server = scripted_server(otherwise=script.answers("Certainly! Here is an answer."))
    endpoint = Endpoint(server.base_url, "m1")
    found = probe(OpenAiClient(endpoint), endpoint, 5.0)
    assert (found.structured, found.enforced, found.vision) == ("json_schema", False, False)
    assert found.words["structured"].count("malformed") == 4
    formats = [request.json.get("response_format", {}).get("type") for request in server.requests]
    assert formats == [None, None, "json_schema", "json_object", None, "json_object", None]
    assert ["tools" in request.json for request in server.requests].index(True) == 4


def test_characters_per_token_are_those_of_the_prompts_without_the_frame_of_a_chat() -> None:
    class Counting(Model):
        def answer(self, request):
            characters = sum(len(message.text) for message in request.messages)
            usage = {"prompt_tokens": 20 + round(characters / 2.6)}
            return replace(super().answer(request), usage=usage)

    assert probed(Counting()).characters_per_token == pytest.approx(2.6, abs=0.05)
    assert probed(Model()).characters_per_token is None
