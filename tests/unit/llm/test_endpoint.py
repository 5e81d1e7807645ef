"""The endpoint: what the environment may say, and that the key shows nowhere."""

from __future__ import annotations

import base64
import json
from urllib.parse import quote

import pytest

from pytest_dura.core import ConfigurationError
from pytest_dura.llm import Endpoint
from pytest_dura.llm.endpoint import model_about

SECRET = 'sk-p/ro+j=eg\\"q'
GIVEN = {
    "DURA_LLM_BASE_URL": " http://10.0.0.7:8000/v1/ ",
    "DURA_LLM_MODEL": " llama3.1:8b\n",
    "DURA_LLM_API_KEY": f"{SECRET}\n",
}


def test_all_comes_from_three_variables_without_blanks_around_them() -> None:
    found = Endpoint.from_environment({**GIVEN, "OPENAI_API_KEY": "sk-another-one"})
    assert (found.base_url, found.model, found.key) == (
        "http://10.0.0.7:8000/v1/",
        "llama3.1:8b",
        SECRET,
    )
    assert found.public == "http://10.0.0.7:8000/v1"


@pytest.mark.parametrize("key", ["", "  "])
def test_a_server_may_need_no_key(key: str) -> None:
    assert Endpoint.from_environment({**GIVEN, "DURA_LLM_API_KEY": key}).key == "none"


@pytest.mark.parametrize("missing", ["DURA_LLM_BASE_URL", "DURA_LLM_MODEL"])
@pytest.mark.parametrize("value", [None, "", " "])
def test_what_is_missing_is_named_with_an_example(missing: str, value: str | None) -> None:
    environ = {name: text for name, text in GIVEN.items() if name != missing}
    with pytest.raises(ConfigurationError) as caught:
        Endpoint.from_environment(environ if value is None else {**environ, missing: value})
    assert caught.value.key == missing
    assert missing in caught.value.problem
    assert "such as" in str(caught.value.expected)
    assert SECRET not in str(caught.value)


@pytest.mark.parametrize(
    "url, told",
    [
        ("10.0.0.7:8000/v1", "no scheme"),
        ("ftp://host/v1", "no scheme"),
        ("file:///etc/passwd", "no scheme"),
        ("http:///v1", "no host"),
        ("http://host:0/v1", "no host or port"),
        ("http://host:99999/v1", "cannot be read"),
        ("http://[::1/v1", "cannot be read"),
        ("http://user:hunter22222@host/v1", "a user or a password"),
        ("http://hunter22222@host/v1", "a user or a password"),
        ("http://host/v1/chat/completions?a=hunter22222", "goes too far"),
        ("http://host/v1#hunter22222", "a fragment"),
        ("http://ho st/v1", "blanks"),
        ("http://host\\@hunter22222/v1", "characters that no URL has"),
        ("http://höst/v1", "characters that no URL has"),
        ("http://host/v1/chat/completions", "goes too far"),
    ],
)
def test_a_url_that_cannot_be_used_is_refused_and_its_secrets_are_not_told(
    url: str, told: str
) -> None:
    with pytest.raises(ConfigurationError) as caught:
        Endpoint(url, "m")
    assert told in caught.value.problem
    assert caught.value.key == "DURA_LLM_BASE_URL"
    assert caught.value.remedy
    assert "hunter22222" not in str(caught.value)


@pytest.mark.parametrize("model", ["", " ", "a\x1b[31mb", "x" * 2001])
def test_a_model_s_name_can_be_printed(model: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        Endpoint("http://host/v1", model)
    assert caught.value.key == "DURA_LLM_MODEL"
    assert "\x1b" not in str(caught.value)


@pytest.mark.parametrize("key", ["has blank in it", "new\nline12", "schlüssel-1", "", "x" * 2001])
def test_a_key_that_no_header_can_hold_is_refused_without_being_told(key: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        Endpoint("http://host/v1", "m", key)
    assert caught.value.key == "DURA_LLM_API_KEY"
    assert not key or key not in str(caught.value)


def test_a_key_too_short_to_be_kept_out_of_texts_is_refused_but_dummies_are_not() -> None:
    with pytest.raises(ConfigurationError, match="fewer than 8") as caught:
        Endpoint("http://host/v1", "m", "hunter2")
    assert "hunter2" not in str(caught.value)
    assert "`none`" in str(caught.value.remedy)
    for dummy in ("none", "EMPTY", "x", "ollama"):
        text = f"none of the objects x is empty: {dummy}"
        assert Endpoint("http://host/v1", "m", dummy).scrub(text) == text
    assert Endpoint("http://host/v1", "m", "sk-local").scrub("a local ask") == "a local ask"


@pytest.mark.parametrize(
    "name, value",
    [
        ("DURA_LLM_BASE_URL", f"http://10.0.0.7/{quote(SECRET, safe='')}/v1"),
        ("DURA_LLM_MODEL", f"llama-{SECRET}"),
    ],
)
def test_a_key_in_what_is_shown_everywhere_is_refused_without_being_told(
    name: str, value: str
) -> None:
    with pytest.raises(ConfigurationError, match=f"{name} holds the key") as caught:
        Endpoint.from_environment({**GIVEN, name: value})
    assert caught.value.key == name
    assert SECRET not in str(caught.value)
    assert quote(SECRET, safe="") not in str(caught.value)


def test_no_repr_shows_the_key() -> None:
    found = Endpoint.from_environment(GIVEN)
    assert SECRET not in repr(found)
    assert SECRET not in str(found)
    assert found.scrub(f"{found!r} {SECRET}") == f"{found!r} [key]"


FORMS = {
    "plain": SECRET,
    "percent": quote(SECRET, safe=""),
    "percent in lower case": quote(SECRET, safe="").replace("%2F", "%2f").replace("%2B", "%2b")
    .replace("%3D", "%3d").replace("%5C", "%5c"),
    "json": json.dumps(SECRET),
    "json in json": json.dumps(json.dumps(SECRET)),
    "json with escaped slashes": json.dumps(SECRET).replace("/", "\\/"),
    "json with every character escaped": "".join(f"\\u{ord(one):04X}" for one in SECRET),
    "json with some characters escaped": "".join(
        f"\\u{ord(one):04x}" if one in 'sr\\"' else one for one in SECRET
    ),
    "base64": base64.b64encode(SECRET.encode()).decode(),
    "base64 of the header": base64.b64encode(f"Bearer {SECRET}".encode()).decode(),
    "base64 of user and password": base64.b64encode(f"user:{SECRET}".encode()).decode(),
    "url-safe base64 in a text": base64.urlsafe_b64encode(f"is: {SECRET}!".encode()).decode(),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_the_key_is_taken_out(form: str) -> None:
    found = Endpoint.from_environment(GIVEN)
    for text in (FORMS[form], f"before{FORMS[form]}after", f'{{"key": "{FORMS[form]}"}}'):
        scrubbed = found.scrub(text)
        assert FORMS[form] not in scrubbed
        assert "[key]" in scrubbed
        assert SECRET[:4] not in scrubbed


def test_what_is_no_key_stays() -> None:
    text = "speed 8.3 m/s, none near, sk-other-key"
    assert Endpoint.from_environment(GIVEN).scrub(text) == text


def test_what_the_model_is_may_be_said_in_a_line() -> None:
    assert model_about({"DURA_LLM_ABOUT": " a llama that drives "}) == "a llama that drives"
    assert model_about(GIVEN) == model_about({"DURA_LLM_ABOUT": ""}) == ""


@pytest.mark.parametrize("text", ["two\nlines", "\x1b[2J", "long" * 51])
def test_what_is_no_line_about_the_model_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match=r"at most 200(.*\n)+.*unset DURA_LLM_ABOUT"):
        model_about({"DURA_LLM_ABOUT": text})


# Headers, query and body

ORG = "org-a1b2c3d4"
TOKEN = "gw-0123456789"


def named(**more):
    return Endpoint.from_environment({**GIVEN, **more})


@pytest.mark.parametrize(
    "text",
    [
        f"X-Org: {ORG}\nX-Gateway-Token:  Bearer {TOKEN} \n\n",
        json.dumps({"X-Org": ORG, "X-Gateway-Token": f"Bearer {TOKEN}"}),
    ],
)
def test_headers_are_lines_or_an_object_and_their_values_are_secrets(text: str) -> None:
    found = named(DURA_LLM_HEADERS=text)
    assert found.sent_headers == {
        "Authorization": f"Bearer {SECRET}",
        "X-Org": ORG,
        "X-Gateway-Token": f"Bearer {TOKEN}",
    }
    for secret in (ORG, TOKEN, SECRET, quote(f"Bearer {TOKEN}"), json.dumps(SECRET)):
        assert "[key]" in found.scrub(f"it is {secret}.")
        assert secret not in found.scrub(f"it is {secret}.")
    assert TOKEN not in repr(found)


def test_without_key_no_token_is_sent_and_a_header_takes_its_place() -> None:
    assert named(DURA_LLM_API_KEY="").sent_headers == {}
    basic = named(DURA_LLM_HEADERS="authorization: Basic 0123456789")
    assert basic.sent_headers == {"authorization": "Basic 0123456789"}


def test_the_query_is_kept_and_shown_nowhere() -> None:
    url = f"https://host.example/v1/?api-version=2024-10-21&sig={TOKEN}"
    found = named(DURA_LLM_BASE_URL=url)
    assert found.query == (("api-version", "2024-10-21"), ("sig", TOKEN))
    assert (found.public, found.address) == ("https://host.example/v1", "https://host.example/v1/")
    assert TOKEN not in repr(found)
    assert found.scrub(f"since 2024-10-21, by {TOKEN}") == "since 2024-10-21, by [key]"


@pytest.mark.parametrize(
    "text",
    [
        "no colon hunter22222", "Bad Name: hunter22222", "Host: hunter22222", '{"a": "hunter22222"',
        '{"X-A": 22222222}', "X-A: ", "X-A: hünter22222", '{"X-A": "hunter22222\\n"}',
        "content-length: 5", "X-A: hunter22222\nx-a: hunter22222", f"X-A: {'hunter2' * 400}",
        "X-Api-Key: hunter2",
    ],
)  # fmt: skip
def test_headers_that_cannot_be_sent_are_refused_without_being_told(text: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        named(DURA_LLM_HEADERS=text)
    assert caught.value.key == "DURA_LLM_HEADERS"
    assert "hunter2" not in str(caught.value)


def test_a_secret_of_the_query_that_is_too_short_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="'sig' has fewer than 8") as caught:
        named(DURA_LLM_BASE_URL="http://host/v1?sig=hunter2")
    assert "hunter2" not in str(caught.value)


def test_the_body_s_fields_are_plain_data_of_which_none_is_the_request_s() -> None:
    extra = {"top_p": 0.9, "chat_template_kwargs": {"enable_thinking": False}}
    assert named(DURA_LLM_EXTRA_BODY=json.dumps(extra)).extra_body == extra
    for text in ("[1]", "{", '{"a": NaN}', "5"):
        with pytest.raises(ConfigurationError, match="is no JSON object"):
            named(DURA_LLM_EXTRA_BODY=text)
    with pytest.raises(ConfigurationError, match="sets messages, temperature"):
        named(DURA_LLM_EXTRA_BODY='{"temperature": 1, "messages": []}')
    with pytest.raises(ConfigurationError, match="DURA_LLM_EXTRA_BODY holds the key"):
        named(DURA_LLM_EXTRA_BODY=json.dumps({"user": SECRET}))


def test_a_value_that_is_a_part_of_what_is_shown_is_no_secret() -> None:
    found = named(DURA_LLM_HEADERS="X-Model: llama3.1:8b")
    assert found.scrub("llama3.1:8b drives") == "llama3.1:8b drives"
