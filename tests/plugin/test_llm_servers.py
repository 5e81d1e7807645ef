"""Sessions with servers that are reached as users' are: own authority, gateway, cloud, streams."""

from __future__ import annotations

import json
import ssl
import sys
from pathlib import Path

import openai.resources.chat  # noqa: F401 - in-process runs forget what they imported
import pytest
from test_llm_planner_sessions import accounts, answers, brief, run
from test_secrets import texts

import pytest_dura.llm.capabilities
import pytest_dura.llm.driving.planner  # noqa: F401 - see above
from pytest_dura.evidence import verify_bundle
from pytest_dura.llm import Cassette
from pytest_dura.llm.record import models_of

SUPPORT = str(Path(__file__).parents[1] / "support")
if SUPPORT not in sys.path:
    sys.path.insert(0, SUPPORT)

import server_dialects as dialects  # noqa: E402 - support modules lie elsewhere
from llm_servers import scripted_server  # noqa: E402
from tls_servers import certificate, tunnel  # noqa: E402

__all__ = ["certificate", "scripted_server", "tunnel"]

KEY, ORGANISATION = "sk-planted-0123456789", "org-planted-98765"
SIGNATURE, GATEWAY = "planted-sig-1357", "planted-gw-24680"
ALONE = "{decide_every: 10, samples: 1, beside: [], stream: true}"


def drives(request):
    return answers(request) if "EGO" in request.prompt else "The sea is wide."


@pytest.fixture
def cloud(scripted_server, monkeypatch):
    """A cloud's API behind a gateway, which the environment names."""
    behave = dialects.cloud(drives, key=KEY, organisation=ORGANISATION)

    def tells_all(exchange):
        """Every third answer repeats what it was sent."""
        sent = exchange.request.headers
        if "EGO" in exchange.request.prompt and len(server.requests) % 3 == 0:
            told = f"{sent['authorization']} {sent['x-gateway-token']} {exchange.request.path}"
            dialects.refusal(exchange, 400, f"{told} {sent['openai-organization']}")
            return
        behave(exchange)

    server = scripted_server(otherwise=tells_all, models=dialects.listing("my-model"))
    headers = {"OpenAI-Organization": ORGANISATION, "X-Gateway-Token": f"Bearer {GATEWAY}"}
    for name, value in {
        "DURA_LLM_BASE_URL": f"{server.base_url}?sig={SIGNATURE}",
        "DURA_LLM_MODEL": "my-model",
        "DURA_LLM_API_KEY": KEY,
        "DURA_LLM_HEADERS": json.dumps(headers),
        "DURA_LLM_RETRIES": "2",
    }.items():
        monkeypatch.setenv(name, value)
    return server


def test_a_cloud_s_secrets_are_in_no_file_and_its_ways_in_the_record(project, cloud):
    brief(project, params="{decide_every: 5, samples: 1, beside: []}")
    result = run(project, "--dura-llm=record", "--dura-evidence-level=all", "-rA")
    assert any(f"sig={SIGNATURE}" in one.path for one in cloud.requests)
    assert any(GATEWAY in one.headers["x-gateway-token"] for one in cloud.requests)
    (model,) = models_of(project.evidence())
    can = model.capabilities
    assert (can["structured"], can["tokens"], can["temperature"]) == (
        "tool", "max_completion_tokens", False
    )  # fmt: skip
    abilities = "vision no, seed yes, refused max_tokens, temperature, at most * s for a decision"
    result.stdout.fnmatch_lines([f"*structured output tool (enforced), {abilities}"])
    assert model.repeated > 0
    told = project.evidence().to_json(include={"episodes"})
    assert "HTTP 400: Bearer [key] [key] /v1/chat/completions?sig=[key]" in json.dumps(told)
    files = dict(texts(project.path))
    printed = result.stdout.str() + result.stderr.str()
    for secret in (KEY, ORGANISATION, SIGNATURE, GATEWAY):
        assert secret not in printed
        assert [name for name, data in files.items() if secret.encode() in data] == []
    assert verify_bundle(project.path / "dura-evidence").intact


def test_a_session_of_streams_is_recorded_and_replayed(project, scripted_server, monkeypatch):
    behave = dialects.vllm(drives, thoughts="Nobody comes.", pause=0.02)
    server = scripted_server(otherwise=behave, models=dialects.VLLM_MODELS, keep_alive=True)
    monkeypatch.setenv("DURA_LLM_BASE_URL", server.base_url)
    monkeypatch.setenv("DURA_LLM_MODEL", "my-org/my-model")
    brief(project, params=ALONE)
    run(project, "--dura-llm=record", "--dura-evidence=one").assert_outcomes(passed=1)
    server.close()
    run(project, "--dura-llm=replay", "--dura-evidence=two").assert_outcomes(passed=1)
    (one,), (two,) = (project.evidence(name).episodes for name in ("one", "two"))
    assert (one.digest, one.metrics.answer_seconds) == (two.digest, two.metrics.answer_seconds)
    assert accounts(one)["fallback"] == (0, 3)
    streamed = [request for request in server.requests if request.json.get("stream")]
    assert len(streamed) == 3
    tape = Cassette(project.path / "dura-cassette.sqlite", writable=False)
    answers = [one.answer for one in tape.exchanges()]
    assert {one.thoughts for one in answers} == {"Nobody comes."}
    assert all(0.02 <= one.first_token <= one.seconds for one in answers)
    assert verify_bundle(project.path / "one").intact


def test_a_session_reaches_its_server_through_a_proxy_and_trusts_its_own_authority(
    project, scripted_server, tunnel, certificate, monkeypatch
):
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    server = scripted_server(otherwise=dialects.vllm(drives), keep_alive=True, tls=context)
    proxy = tunnel(("127.0.0.1", server.port))
    for name in ("HTTP_PROXY", "ALL_PROXY", "NO_PROXY", "SSL_CERT_DIR"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)
    for name, value in {
        "DURA_LLM_BASE_URL": "https://model.test/v1",
        "DURA_LLM_MODEL": "m",
        "HTTPS_PROXY": proxy.address.replace("me:pass", "me:planted-pass-13579"),
        "SSL_CERT_FILE": str(certificate),
    }.items():
        monkeypatch.setenv(name, value)
    brief(project, params=ALONE)
    result = run(project, "--dura-llm=record")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["dura: language model m at https://model.test/v1 (record), *"])
    assert accounts(project.evidence().episodes[0])["fallback"] == (0, 3)
    assert {head[0] for head in proxy.asked} == {"connect model.test:443 http/1.1"}
    files = texts(project.path)
    assert [name for name, data in dict(files).items() if b"planted-pass" in data] == []

    monkeypatch.delenv("SSL_CERT_FILE")
    result = run(project, "--dura-evidence=two")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert "certificate verify failed" in result.stderr.str()
