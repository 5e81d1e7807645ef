"""docs/llm-servers.md: each recipe as it stands, against a scripted server of its dialect."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
import server_dialects as dialects
from models import ALONE, PLANNER, said

from pytest_dura.core import ConfigurationError, RoleSpec, Termination
from pytest_dura.execution import run_episode
from pytest_dura.library import case_with_faults, load_library
from pytest_dura.llm import Endpoint, Message, OpenAiClient, Request, session
from pytest_dura.llm.capabilities import probe

PAGE = (Path(__file__).parents[3] / "docs" / "llm-servers.md").read_text()
KEY, ORGANISATION = "sk-0123456789abcdef", "org-0123456789"
AZURE_KEY, VERSION = "0123456789abcdef0123456789abcdef", "2024-10-21"


def said_to(text):
    return Message("user", text)


SEA = "The sea is wide."


def recipe(heading):
    """The variables that the recipe under a heading exports."""
    section = PAGE.split(f"\n### {heading}\n")[1].split("\n## ")[0].split("\n### ")[0]
    block = re.search(r"```sh\n(.*?)```", section, flags=re.DOTALL)[1]
    lines = [shlex.split(line) for line in block.splitlines()]
    assert all(line[0] == "export" and len(line) == 2 for line in lines)
    return dict(line[1].split("=", 1) for line in lines)


def drives(request):
    """The text of a model that drives, and answers the probe in prose."""
    return said("proceed") if "maneuver" in request.prompt else SEA


DIALECTS = {
    "vLLM": (dialects.vllm(drives), dialects.VLLM_MODELS),
    "llama.cpp": (dialects.llama_cpp(drives), dialects.LLAMA_CPP_MODELS),
    "Ollama": (dialects.ollama(drives), dialects.OLLAMA_MODELS),
    "A cloud API": (
        dialects.cloud(drives, key=KEY, organisation=ORGANISATION), dialects.listing("my-model")
    ),
    "Azure": (dialects.azure(drives, key=AZURE_KEY, version=VERSION), None),
}  # fmt: skip


@pytest.fixture
def serving(scripted_server):
    """``serving(heading)`` gives the recipe's environment, for a loopback server, and that."""

    def start(heading, behaviour=None):
        usual, models = DIALECTS[heading]
        server = scripted_server(otherwise=behaviour or usual, models=models, keep_alive=True)
        environ = recipe(heading)
        url = re.sub(r"^https?://[^/]+", server.base_url[:-3], environ["DURA_LLM_BASE_URL"])
        return {**environ, "DURA_LLM_BASE_URL": url}, server

    return start


def probed(environ):
    endpoint = Endpoint.from_environment(environ)
    return probe(OpenAiClient(endpoint), endpoint, 10.0, pause=0.0)


@pytest.mark.parametrize(
    "heading, level, fields, context",
    [
        ("vLLM", "json_schema", ("max_tokens", True), 8192),
        ("llama.cpp", "json_schema", ("max_tokens", True), 4096),
        ("Ollama", "json_schema", ("max_tokens", True), None),
        ("A cloud API", "tool", ("max_completion_tokens", False), None),
        ("Azure", "json_schema", ("max_tokens", True), None),
    ],
)
def test_the_probe_finds_how_to_speak_to_each(serving, heading, level, fields, context) -> None:
    environ, server = serving(heading)
    found = probed(environ)
    assert (found.structured, found.enforced) == (level, True)
    assert (found.tokens, found.temperature) == fields
    assert (found.context, found.seed, found.vision) == (context, True, False)
    for name in () if found.temperature else ("max_tokens", "temperature"):
        assert name in found.words["fields"]
    assert KEY not in json.dumps(found.to_json())
    assert server.requests


_LIBRARY = []


@pytest.mark.parametrize("heading", DIALECTS)
@pytest.mark.parametrize("stream", [False, True])
def test_the_planner_drives_by_each_recipe(serving, tmp_path, heading, stream) -> None:
    environ, server = serving(heading)
    if not _LIBRARY:
        _LIBRARY.append(load_library(()))
    case = case_with_faults(_LIBRARY[0].scenarios["intersection/nominal"], "none")
    params = ALONE | {"decide_every": 5, "stream": stream, "history": 0}

    def drive(models):
        with session.using(models):
            generator = RoleSpec(PLANNER, params)
            generator = replace(generator, params=generator.resolve().resolve_parameters(params))
            spec = replace(case.spec(0, 0, {"generator": generator}), termination=Termination(1.0))
            return run_episode(replace(spec, time_budget=10.0), recorded=True)

    tape = tmp_path / "tape.sqlite"
    recording = session.ModelSession("record", tape, environ=environ)
    recorded = drive(recording)
    recording.close()
    outcomes = [one["outcome"] for one in recorded.recording.accounts if one["decided"]]
    assert outcomes == ["answered"] * 2
    assert drive(session.ModelSession("replay", tape, environ={})).digest == recorded.digest
    assert server.requests[-1].json.get("stream") == (True if stream else None)
    for name in environ:
        if name in ("DURA_LLM_API_KEY", "DURA_LLM_HEADERS"):
            for secret in re.findall(r"[\w-]{12,}", environ[name])[-1:]:
                assert secret.encode() not in tape.read_bytes()


def test_the_recipe_for_vllm_keeps_the_model_from_thinking(serving) -> None:
    environ, server = serving("vLLM")
    quiet = OpenAiClient(Endpoint.from_environment(environ))
    request = Request("m", (), extra=quiet.endpoint.extra_body)
    server._otherwise = dialects.vllm(lambda _: "{}")
    request = replace(request, messages=(said_to("Where?"),))
    assert quiet.ask(request, 5.0).thoughts == ""
    assert quiet.ask(replace(request, extra={}), 5.0).thoughts == "V1 comes. I wait."


def test_the_cloud_s_limit_is_waited_for_as_its_recipe_says(serving) -> None:
    busy = dialects.cloud(drives, key=KEY, organisation=ORGANISATION, busy=5)
    environ, server = serving("A cloud API", busy)
    models = session.ModelSession("live", environ=environ)
    assert models.describe().capabilities["structured"] == "tool"
    server.requests.clear()
    request = Request("my-model", (said_to("Which maneuver?"),), temperature=None,
                      tokens="max_completion_tokens")  # fmt: skip
    answer = models.ask(request, 5.0)
    assert (answer.failure, answer.attempts, len(server.requests)) == ("", 6, 6)
    with pytest.raises(ConfigurationError, match=r"HTTP 429: (.*\n)+.*raise DURA_LLM_RETRIES"):
        session.ModelSession("live", environ=environ | {"DURA_LLM_RETRIES": "2"}).describe("m2")


def test_azure_s_filter_refuses(serving) -> None:
    environ, server = serving("Azure")
    client = OpenAiClient(Endpoint.from_environment(environ))
    answer = client.ask(Request("d", (said_to("Tell me how to hurt."),)), 5.0)
    assert answer.failure == "refused"
    assert server.requests[0].path.endswith(f"/chat/completions?api-version={VERSION}")


@pytest.mark.parametrize(
    "heading, change, words",
    [
        ("A cloud API", {"DURA_LLM_API_KEY": "sk-another-key-1"}, "check DURA_LLM_API_KEY"),
        ("A cloud API", {"DURA_LLM_HEADERS": ""}, "No such organization"),
        ("Azure", {"DURA_LLM_HEADERS": ""}, "invalid subscription key"),
        ("Ollama", {"DURA_LLM_MODEL": "another:8b"}, "the server lists my-model:8b"),
    ],
)
def test_what_a_recipe_lacks_is_one_clear_error(serving, heading, change, words) -> None:
    environ, _ = serving(heading)
    with pytest.raises(ConfigurationError, match=re.escape(words)) as caught:
        probed(environ | change)
    assert "sk-another-key-1" not in str(caught.value)
