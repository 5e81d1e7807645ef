"""Laws of the client: whatever a server sends is an answer, and no key is in it."""

from __future__ import annotations

import base64
import io
import json
import os
from typing import Any
from urllib.parse import quote

import httpx2
import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from PIL import Image as Picture

from pytest_dura.core import ConfigurationError
from pytest_dura.llm import Answer, Endpoint, Image, Message, OpenAiClient, Request
from pytest_dura.llm.answers import FAILURES
from pytest_dura.llm.capabilities import ServerListing
from pytest_dura.llm.client import data_url
from pytest_dura.llm.completions import LONGEST_TEXT, read_completion, refusal_of
from pytest_dura.llm.port import Repeats

laws = settings(derandomize=True, deadline=None, max_examples=80)

texts = st.text(st.characters(exclude_categories=()), max_size=20)
"""Half characters, too."""
whole_texts = st.text(max_size=30).filter(str.strip)
numbers = st.none() | st.integers() | st.lists(st.integers(), max_size=2)
plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | texts,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=4,
)
_KEYS = ("choices", "error", "object", "usage", "system_fingerprint", "message", "content",
         "refusal", "finish_reason")  # fmt: skip
shaped = st.recursive(
    plain,
    lambda inner: st.dictionaries(st.sampled_from(_KEYS), inner, max_size=3) | st.lists(inner),
    max_leaves=9,
)
keys = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=8, max_size=40)


def is_answer(answer: Answer) -> None:
    data = answer.to_json()
    assert answer.failure in ("", *FAILURES)
    assert (answer.failure == "") == (answer.detail == "")
    assert answer.failure != "" or answer.text.strip()
    assert len(answer.text) <= LONGEST_TEXT
    assert len(answer.detail) <= 300
    for line in (answer.detail, answer.finish, answer.fingerprint):
        assert line.isprintable()
    assert Answer.from_json(json.loads(json.dumps(data, ensure_ascii=False).encode())) == answer


@laws
@given(st.binary(max_size=200))
def test_any_bytes_are_an_answer(body: bytes) -> None:
    is_answer(read_completion(body))
    is_answer(refusal_of(500, body))


@laws
@given(shaped, st.integers(100, 999))
def test_any_json_is_an_answer(data: Any, status: int) -> None:
    body = json.dumps(data).encode()
    is_answer(read_completion(body))
    told = refusal_of(status, body)
    is_answer(told)
    assert told.detail.startswith(f"HTTP {status}: ")


def completion(text: str, **more: Any) -> dict[str, Any]:
    message = {"role": "assistant", "content": text}
    return {"choices": [{"message": message, "finish_reason": "stop"}], **more}


@laws
@given(whole_texts, st.dictionaries(st.text(max_size=9), numbers, max_size=3), st.booleans())
def test_a_whole_completion_gives_its_text_whatever_stands_beside_it(
    text: str, beside: dict[str, Any], escaped: bool
) -> None:
    assume(not {"choices", "error", "object"} & set(beside))
    data = json.dumps({**beside, **completion(text)}, ensure_ascii=escaped)
    answer = read_completion(data.encode())
    assert (answer.text, answer.failure) == (text, "")


@laws
@given(whole_texts, st.data())
def test_the_beginning_of_a_completion_is_truncated(text: str, data: st.DataObject) -> None:
    body = json.dumps(completion(text, usage={"total_tokens": 3}), ensure_ascii=False).encode()
    size = data.draw(st.integers(1, len(body) - 1))
    assert read_completion(body[:size]).failure == "truncated"


@laws
@given(keys, texts, texts, st.integers(0, 2))
def test_no_form_of_a_key_is_left_in_a_text(key: str, before: str, after: str, shift: int) -> None:
    endpoint = Endpoint("http://host/v1", "m", key)
    forms = [key, quote(key, safe=""), json.dumps(key)[1:-1]]
    forms.append(base64.b64encode(b"x" * shift + key.encode() + b"yz").decode())
    forms.append(base64.urlsafe_b64encode(b"x" * shift + key.encode() + b"yz").decode())
    forms.append(base64.b64encode(f"Bearer {key}".encode()).decode())
    for form in forms:
        scrubbed = endpoint.scrub(f"{before}{form}{after}")
        assert form not in scrubbed
        assert "[key]" in scrubbed
        assert key not in scrubbed
    assert key not in repr(endpoint)


@laws
@given(st.text(st.sampled_from("htps:/@.?#[]12ab \\%é"), max_size=30), st.booleans())
def test_a_url_is_refused_or_has_no_secret_in_its_public_form(text: str, whole: bool) -> None:
    url = f"http://{text}" if whole else text
    try:
        endpoint = Endpoint(url, "m")
    except ConfigurationError as error:
        refused = error
    else:
        refused = None
    if refused is not None:
        assert refused.key == "DURA_LLM_BASE_URL"
        assert refused.remedy
    else:
        assert not set("@?#") & set(endpoint.public)
        assert endpoint.public.startswith(("http://", "https://"))


@laws
@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 99))
def test_a_picture_arrives_as_it_is(height: int, width: int, seed: int) -> None:
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)
    _, _, data = data_url(Image("c", pixels)).partition(",")
    arrived = Picture.open(io.BytesIO(base64.b64decode(data)))
    assert np.array_equal(np.asarray(arrived), pixels)


@laws
@given(shaped)
def test_any_list_of_models_has_a_fingerprint(data: Any) -> None:
    for listing in (json.dumps(data), json.dumps({"data": [{"id": "m", "meta": data}]})):
        server = ServerListing.of(listing, "", "m", ())
        assert server.fingerprint("m") == ServerListing.of(listing, "", "m", ()).fingerprint("m")
        assert server.words


@settings(laws, max_examples=40)
@given(status=st.sampled_from([429, 503]) | st.integers(300, 599), most=st.integers(0, 2))
def test_a_request_is_repeated_where_its_server_was_busy_and_nowhere_else(
    status: int, most: int
) -> None:
    asked: list[str] = []

    def respond(request: httpx2.Request) -> httpx2.Response:
        asked.append(request.headers["authorization"])
        headers = {"retry-after": "0.001"}
        return httpx2.Response(status, headers=headers, stream=httpx2.ByteStream(b"{}"))

    client = OpenAiClient(Endpoint("http://127.0.0.1/v1", "m", "sk-0123456789"))
    client._sdks = {os.getpid(): client._sdk(httpx2.MockTransport(respond))}
    causes: list[str] = []
    repeats = Repeats(most, allowed=lambda cause: causes.append(cause) is None)
    answer = client.ask(Request("m", (Message("user", "x"),)), 9.0, repeats=repeats)
    calls = most + 1 if status in (429, 503) else 1
    assert asked == ["Bearer sk-0123456789"] * calls
    assert (answer.attempts, answer.failure) == (calls, "unavailable")
    assert causes == [answer.cause] * (calls - 1)
