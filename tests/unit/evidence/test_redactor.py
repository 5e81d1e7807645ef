import json
import os
import shlex
import time

import pytest
from entries import make
from session_records import session_record

from pytest_dura.evidence import Redactor, count_redactions, holds_redaction
from pytest_dura.requirements.pairs import Change

SECRET = "tok-AbCdEf0123456789"


@pytest.mark.parametrize(
    "name",
    [
        "GITHUB_TOKEN", "OPENAI_API_KEY", "DB_PASSWORD", "PGPASSWORD", "SSHPASS",
        "AWS_SECRET_ACCESS_KEY", "MY_PWD", "BASIC_AUTH", "GOOGLE_CREDENTIALS", "myservice_apikey",
        "SESSION_COOKIE", "SECRET_2", "GPG_PASSPHRASE", "GITHUB_PAT", "PAT", "SLACK_WEBHOOK_URL",
        "CI_CREDS", "ROBOT_LICENSE", "MOSEK_LICENCE", "AZURE_STORAGE_CONNECTION_STRING",
        "ConnectionStrings", "SENTRY_DSN", "DB_URL", "DATABASE_URI", "REDIS_URL",
    ],
)  # fmt: skip
def test_a_variable_whose_name_speaks_of_a_secret(name):
    redact = Redactor.of_environment({name: SECRET}).redact
    assert redact(f"calls {SECRET}!") == f"calls [redacted: {name}]!"


@pytest.mark.parametrize(
    "name, value",
    [
        ("DURA_LLM_HEADERS", f'{{"X-Org": "my-org-name", "api-key": "{SECRET}"}}'),
        ("DURA_LLM_HEADERS", f"X-Org: my-org-name\nX-Auth-Token:  {SECRET}\n"),
        ("OTLP_HEADERS", f"a=my-org-name,x-api-key={SECRET}"),
        ("PROXY_HEADERS", f"Authorization: Bearer {SECRET}"),
        ("BASE", f"https://my-org-name.test/v1?version=1&sig={SECRET}&a=b"),
    ],
)
def test_headers_and_queries_hold_secrets_by_their_names(name, value):
    redact = Redactor.of_environment({name: value}).redact
    assert redact(f"it is {SECRET} of my-org-name") == f"it is [redacted: {name}] of my-org-name"


@pytest.mark.parametrize(
    "name",
    [
        "PATH", "MONKEY_BUSINESS", "KEYBOARD_LAYOUT", "PWD", "OLDPWD", "SSH_AUTH_SOCK",
        "TOKEN_FILE", "TOKENIZERS_PARALLEL", "AUTHOR", "HOSTNAME", "KEY_PATH", "PYTHONPATH",
        "PATTERN", "DISPATCH", "LICENSED", "MOSEKLM_LICENSE_FILE", "CREDSTORE", "DBUS_SESSION",
        "COMPASS", "DSNAME", "DB_HOST",
    ],
)  # fmt: skip
def test_a_variable_that_holds_no_secret(name):
    assert Redactor.of_environment({name: SECRET}).redact(SECRET) == SECRET


def test_a_variable_that_the_user_calls_a_secret():
    redact = Redactor.of_environment(
        {"Robot_Pin": SECRET, "ROBOT": SECRET[::-1]}, ["robot_*"]
    ).redact
    assert redact(SECRET) == "[redacted: Robot_Pin]"
    assert redact(SECRET[::-1]) == SECRET[::-1]
    assert Redactor.of_environment({"KEY_PATH": SECRET}, ["key_path"]).redact(SECRET) != SECRET


def test_a_url_is_a_secret_and_its_password_another():
    redact = Redactor.of_environment({"DB_URL": "postgres://me:pa%24sword1@host/db"}).redact
    assert (
        redact("pa$sword1") == redact("postgres://me:pa%24sword1@host/db") == "[redacted: DB_URL]"
    )


def test_the_password_in_the_url_of_any_variable():
    redact = Redactor.of_environment({"DATABASE": "postgres://me:pa%24sword1@host/db"}).redact
    assert redact("pa$sword1") == "[redacted: DATABASE]"


@pytest.mark.parametrize("value", ["", "short", "********", "password", "PRODUCTION", "verdicts"])
def test_what_is_too_ordinary_to_be_looked_for_is_told(value):
    redactor = Redactor.of_environment({"MY_SECRET": value})
    assert redactor.redact(f"a {value} here") == f"a {value} here"
    assert redactor.ignored == ({"MY_SECRET"} if value else set())


def test_what_the_environment_has_later_is_learnt():
    redactor = Redactor.of_environment({"A_KEY": SECRET})
    redactor.learn({"B_KEY": "another-secret"})
    assert redactor.redact(f"{SECRET} another-secret") == "[redacted: A_KEY] [redacted: B_KEY]"
    redactor.learn({"A_KEY": "a-rotated-one", "B_KEY": "another-secret"})
    assert redactor.redact(f"{SECRET} a-rotated-one") == "[redacted: A_KEY] [redacted: A_KEY]"


def test_the_environment_of_the_process_is_read_whenever_it_changes(monkeypatch):
    redactor = Redactor.of_environment(os.environ)
    for value in ("first-0f1e2d3c", "second-4b5a6978", "first-0f1e2d3c"):
        monkeypatch.setenv("SOME_LATE_TOKEN", value)
        redactor.learn(os.environ)
        assert redactor.redact(f"{value}!") == "[redacted: SOME_LATE_TOKEN]!"
    monkeypatch.delenv("SOME_LATE_TOKEN")
    redactor.learn(os.environ)
    assert redactor.redact("second-4b5a6978") == "[redacted: SOME_LATE_TOKEN]"


@pytest.mark.parametrize(
    "text, told",
    [
        ("key sk-abcd1234efgh5678ijkl", "key [redacted: API key]"),
        ("sk_live_abcd1234efgh", "[redacted: API key]"),
        ("ghp_" + "a1" * 18, "[redacted: GitHub token]"),
        ("github_pat_" + "a1_" * 12, "[redacted: GitHub token]"),
        ("glpat-abcdefghij1234567890", "[redacted: GitLab token]"),
        ("AKIAIOSFODNN7EXAMPLE.", "[redacted: AWS key]."),
        ("xoxb-123456789012-abcdef", "[redacted: Slack token]"),
        ("eyJhbGciOiJIUzI1NiJ9.eyJzdWIiOiIxIn0.c2lnbmF0dXJl", "[redacted: JSON web token]"),
        ("Authorization: Bearer abcdefgh", "Authorization: Bearer [redacted: authorization]"),
        ("'authorization': 'Basic dTpw9999'", "'authorization': 'Basic [redacted: authorization]'"),
        ("bearer abcdefghij123456", "bearer [redacted: authorization]"),
        ("https://me:hunter2@host/x", "https://me:[redacted: URL password]@host/x"),
        ("https://a1b2c3d4e5f6a7b8@host", "https://[redacted: URL password]@host"),
        ("run --api-key=abc --seed=1", "run --api-key=[redacted: option] --seed=1"),
        ("run --my-token 'a b' x", "run --my-token [redacted: option] x"),
        ("C(api_key='abc', n=1)", "C(api_key=[redacted: assignment], n=1)"),
        ("OPENAI_API_KEY=abcdefg1", "OPENAI_API_KEY=[redacted: assignment]"),
        (
            "-----BEGIN RSA PRIVATE KEY-----\nMIIE\n-----END RSA PRIVATE KEY-----\nrest",
            "[redacted: private key]\nrest",
        ),
        ("-----BEGIN PRIVATE KEY-----\\nMIIE cut off", "[redacted: private key]"),
    ],
)
def test_a_secret_is_known_by_its_shape(text, told):
    assert Redactor().redact(text) == told


@pytest.mark.parametrize(
    "text",
    [
        "risk-assessment-of-the-whole-scenario-2",
        "https://docs.example.org/a?b=c",
        "the bearer of bad news and a basic functionality",
        "pytest --dura-scenarios --dura-seed=1 --maxfail 3",
        "the key: always (gap > 0)",
        "token: Wait",
        "MASKIA0000000000000000",
    ],
)
def test_a_harmless_text_is_left_alone(text):
    assert Redactor().redact(text) == text


def test_values_under_names_that_speak_of_secrets():
    data = {"params": {"api_key": "x", "max_tokens": 5, "X-Auth-Token": "y", "token": ""}}
    assert Redactor().redact(data) == {
        "params": {
            "api_key": "[redacted: parameter]",
            "max_tokens": 5,
            "X-Auth-Token": "[redacted: parameter]",
            "token": "",
        }
    }
    assert Redactor().redact(["--token", "x", "--seed", "1"])[1:3] == [
        "[redacted: option]",
        "--seed",
    ]


def test_keys_that_differed_by_their_secrets_alone_stay_two():
    redactor = Redactor.of_environment({"A_KEY": SECRET})
    found = redactor.redact({SECRET: 1, "[redacted: A_KEY]": 2})
    assert sorted(found.values()) == [1, 2]


def test_the_beginning_of_a_secret_that_was_cut_off():
    redactor = Redactor.of_environment({"A_KEY": SECRET})
    for cut in (f"{SECRET[:14]}…", f"{SECRET[:12]}...", f"...{SECRET[-13:]}"):
        assert SECRET[:12] not in redactor.redact(cut)
        assert SECRET[-12:] not in redactor.redact(cut)
        assert "[redacted: A_KEY]" in redactor.redact(cut)
    assert redactor.redact(SECRET[:11] + "...") == SECRET[:11] + "..."


def test_a_secret_does_not_hide_in_what_looks_redacted():
    redactor = Redactor.of_environment({"A_KEY": SECRET})
    assert SECRET not in redactor.redact(f"[redacted: {SECRET}]")


def test_what_is_redacted_is_not_taken_for_another_secret():
    redactor = Redactor.of_environment({"A_KEY": SECRET, "B_PASSWORD": "A_KEYS_VALUE"})
    assert redactor.redact(f"--token {SECRET}") == "--token [redacted: A_KEY]"
    assert redactor.redact(f"password='{SECRET}'") == "password='[redacted: A_KEY]'"
    assert redactor.redact({"password": SECRET}) == {"password": "[redacted: A_KEY]"}


def test_redactions_are_counted_by_name():
    data = {"a": ["[redacted: A_KEY] and [redacted: A_KEY]"], "[redacted: option]": 1}
    assert count_redactions(data) == {"A_KEY": 2, "option": 1}
    assert count_redactions(json.dumps(data)) == count_redactions(data)
    assert holds_redaction({"params": {"x": "[redacted: A_KEY]"}})
    assert not holds_redaction({"params": {"x": "redacted", "y": 1.0}})


def test_the_command_of_a_session():
    value = 'it\'s $ecret "really"'
    redactor = Redactor.of_environment({"A_KEY": value})
    command = shlex.join(["pytest", f"--my-option={value}", value])
    assert "ecret" not in redactor.redact(command)


def test_a_record_without_secrets_is_the_same_object():
    record = session_record().head.to_json()
    assert Redactor.of_environment({"A_KEY": SECRET}).redact(record) is record


@pytest.mark.parametrize(
    "text",
    [
        "sk-" * 10**5, "eyJ-" * 10**5, "token=" * 10**5, "--token " * 10**5, "://a:" * 10**5,
        "-----BEGIN PRIVATE KEY-----" * 10**4, "authorization" * 10**4, "--a-" * 10**5 + "token",
        "A" * 10**6 + " token=", f"{SECRET[:14]}…" * 10**4, "[redacted: " * 10**5 + SECRET,
        "password='" * 10**5, "--token '" * 10**5,
    ],
    ids=lambda text: text[:12],
)  # fmt: skip
def test_hostile_texts_take_no_longer_than_others(text):
    redactor = Redactor.of_environment({"A_KEY": SECRET})
    began = time.process_time()
    redactor.redact(text)
    assert time.process_time() - began < 2.0


def test_marks_are_counted_in_entries_too_whatever_their_fields_are_called():
    change = make(Change, values=[1.5], lost=["x [redacted: MY_KEY]"])
    assert count_redactions([change]) == {"MY_KEY": 1}
