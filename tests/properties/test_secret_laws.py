"""No form of a secret gets through, wherever it was planted; all else stays as it is."""

from __future__ import annotations

import base64
import html
import json
import shlex
from urllib.parse import quote, quote_plus

from hypothesis import assume, given, settings
from hypothesis import strategies as st
from session_records import session_record

from pytest_dura.evidence import Redactor, count_redactions
from pytest_dura.evidence.redaction import is_common

SETTINGS = settings(derandomize=True, deadline=None, max_examples=60)
SECRETS = st.text(
    st.characters(codec="utf-8", exclude_characters="\0"), min_size=8, max_size=40
).filter(lambda text: not is_common(text.strip()) and text.strip() == text)
RECORD = session_record().to_json()


def encoded(secret, before):
    data = (before + secret).encode()
    return [
        secret,
        json.dumps(secret)[1:-1],
        json.dumps(json.dumps(secret))[3:-3],
        repr(secret)[1:-1],
        quote(secret),
        quote(secret, safe=""),
        quote_plus(secret),
        html.escape(secret),
        data.hex(),
        base64.b64encode(data).decode(),
        base64.urlsafe_b64encode(data).decode(),
        shlex.join(["pytest", f"--x={secret}"]),
    ]


def places(data, path=()):
    """The path of each text and each key."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield (*path, key), True
            yield from places(value, (*path, key))
    elif isinstance(data, list):
        for i, value in enumerate(data):
            yield from places(value, (*path, i))
    elif isinstance(data, str):
        yield path, False


PLACES = list(places(RECORD))


def planted(data, path, text, *, key):
    head, *rest = path
    copy = dict(data) if isinstance(data, dict) else list(data)
    if rest:
        copy[head] = planted(data[head], rest, text, key=key)
    elif key:
        copy[f"{head} {text}"] = copy.pop(head)
    else:
        copy[head] = f"{copy[head]} {text}"
    return copy


@SETTINGS
@given(secret=SECRETS, place=st.sampled_from(PLACES), form=st.integers(0, 11),
       before=st.text(max_size=3))  # fmt: skip
def test_a_planted_secret_is_nowhere_in_the_output(secret, place, form, before):
    text = encoded(secret, before)[form]
    assume(text not in json.dumps(RECORD, ensure_ascii=False))
    path, key = place
    data = planted(RECORD, path, text, key=key)
    redactor = Redactor.of_environment({"PLANTED_KEY": secret})
    assume(not redactor.ignored)
    found = redactor.redact(data)
    for told in (json.dumps(found, ensure_ascii=False), json.dumps(found)):
        for one in (text, *encoded(secret, "")[:10]):
            assert one not in told.replace("[redacted: PLANTED_KEY]", "")
    assert count_redactions(found)["PLANTED_KEY"] >= 1


@SETTINGS
@given(secret=SECRETS, place=st.sampled_from(PLACES), form=st.integers(0, 11))
def test_what_is_redacted_was_suspected(secret, place, form):
    path, key = place
    data = planted(RECORD, path, encoded(secret, "")[form], key=key)
    redactor = Redactor.of_environment({"PLANTED_KEY": secret})
    others = [{"a": "harmless"}, ("b", 1.5)]
    assert redactor.redact(data) == data or redactor.may_change([*others, data])
    assert not redactor.may_change(others)


@SETTINGS
@given(secret=SECRETS, text=st.text(max_size=20))
def test_a_secret_learnt_later_is_found_in_what_was_searched_before(secret, text):
    texts, redactor = [f"{text}{secret}", "name"], Redactor()
    assume(not redactor.may_change(texts))
    assert redactor.redact(texts) is texts
    redactor.learn({"PLANTED_KEY": secret})
    assume(not redactor.ignored)
    assert redactor.may_change(texts)
    assert count_redactions(redactor.redact(texts))["PLANTED_KEY"] >= 1


@SETTINGS
@given(secret=SECRETS, text=st.text(max_size=60))
def test_redacting_twice_is_redacting_once(secret, text):
    redact = Redactor.of_environment({"A_KEY": secret}).redact
    once = redact({"a": f"{text}{secret}{text}", secret: [text]})
    assert redact(once) == once


@SETTINGS
@given(text=st.text(st.characters(exclude_characters="-=:"), max_size=60))
def test_texts_without_secrets_stay_as_they_are(text):
    assume("f0f1f2f3f4f5" not in text)
    assert Redactor.of_environment({"A_KEY": "f0f1f2f3f4f5f6f7"}).redact(text) == text
