from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading

import llm_servers
import null_model
import openai
import pytest

INTENTS = ["slow_down", "hold", "speed_up"]
SCHEMA = {
    "type": "object",
    "properties": {
        "observations": {"type": "string", "maxLength": 160},
        "threat_ids": {
            "type": "array",
            "items": {"type": "string", "maxLength": 8},
            "maxItems": 3,
        },
        "intent": {"enum": INTENTS},
        "confidence": {"type": "number"},
    },
    "required": ["observations", "threat_ids", "intent", "confidence"],
    "additionalProperties": False,
}
FORMAT = {"type": "json_schema", "json_schema": {"name": "d", "strict": True, "schema": SCHEMA}}
SYSTEM = "You drive the car. " * 50
TEXTS = ["V1 gap 3.2 m", "P1 crosses ahead, V2 yields", "red light " * 20, "the road is empty"]
PROGRAM = [sys.executable, null_model.__file__]


@contextlib.contextmanager
def asking(server):
    """A function that gives a completion: ``ask(text, **options)``; its connections are closed."""
    address = {"base_url": server.base_url, "api_key": "none"}
    with openai.OpenAI(**address, max_retries=0, timeout=30) as client:
        yield asked(client, server)


def asked(client, server):
    def ask(text, **options):
        messages = [{"role": "system", "content": SYSTEM}, {"role": "user", "content": text}]
        settings = {"response_format": FORMAT, "temperature": 0, "seed": 7, "max_tokens": 600}
        return client.chat.completions.create(
            model=server.model, messages=messages, **{**settings, **options}
        )

    return ask


@pytest.fixture(scope="module")
def ask(null_server):
    with asking(null_server) as ask:
        yield ask


def text_of(completion):
    return completion.choices[0].message.content


@pytest.fixture
def program(null_server):
    """``program(*arguments)`` starts the program and gives it with its first line."""
    started = []

    def start(*arguments):
        process = subprocess.Popen(
            [*PROGRAM, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        return process, process.stdout.readline()

    yield start
    for process in started:
        with process:
            process.kill()


def test_the_model_file_has_the_same_bytes_each_time_and_others_for_another_seed(
    null_server, tmp_path
):
    paths = [tmp_path / name for name in ("one", "two", "other")]
    for path, seed in zip(paths, (1, 1, 2), strict=True):
        null_model.write_model(path, seed)
    one, two, other = (path.read_bytes() for path in paths)
    assert one == two
    assert one != other
    assert len(one) < 600_000


def test_an_answer_obeys_the_schema(ask):
    for seed, temperature in [(1, 0), (2, 1), (3, 1), (4, 1)]:
        completion = ask("EGO v=8", seed=seed, temperature=temperature)
        answer = json.loads(text_of(completion))
        assert list(answer) == SCHEMA["required"]
        assert len(answer["observations"]) <= 160
        assert len(answer["threat_ids"]) <= 3
        assert answer["intent"] in INTENTS
        assert isinstance(answer["confidence"], int | float)
        assert completion.choices[0].finish_reason == "stop"
        assert completion.usage.prompt_tokens > len(SYSTEM)
        assert 0 < completion.usage.completion_tokens < 600


def test_the_prompt_and_the_seed_matter(ask):
    assert len({text_of(ask(text)) for text in TEXTS}) > 1
    assert len({text_of(ask("V1", seed=seed, temperature=1)) for seed in range(4)}) > 1


def test_equal_requests_have_equal_answers_between_others_and_at_once(ask):
    first = {text: text_of(ask(text)) for text in TEXTS}
    later = []

    def client(order):
        later.extend((text, text_of(ask(text))) for text in order)

    clients = [
        threading.Thread(target=client, args=(order,)) for order in (TEXTS, TEXTS[::-1], TEXTS[2:])
    ]
    for one in clients:
        one.start()
    for one in clients:
        one.join(timeout=30)
    assert len(later) == 10
    assert [answer for text, answer in later if answer != first[text]] == []


def test_another_process_gives_the_same_answers(null_server, tmp_path):
    with null_model.null_model_server(tmp_path) as other:
        assert other.base_url != null_server.base_url
        answers = []
        for server in (other, null_server):
            with asking(server) as ask:
                answers.append([text_of(ask(text)) for text in TEXTS])
    assert other.process.returncode == 0
    assert answers[0] == answers[1]


def test_the_limits_are_those_of_a_real_server(ask):
    with pytest.raises(openai.BadRequestError, match="exceeds the available context size"):
        ask("x" * null_model.CONTEXT)
    pixel = {"type": "image_url", "image_url": {"url": "data:image/png;base64,iVBORw0KGgo="}}
    with pytest.raises(openai.InternalServerError, match="image input is not supported"):
        ask([{"type": "text", "text": "what is this"}, pixel])
    assert ask("V1", max_tokens=9).choices[0].finish_reason == "length"
    answer = ask("V1", response_format={"type": "json_object"})
    assert isinstance(json.loads(text_of(answer)), dict)


def test_the_program_names_its_address_and_ends_with_its_input(program):
    process, line = program()
    assert line.startswith("DURA_LLM_BASE_URL=http://127.0.0.1:")
    assert line.endswith("/v1 DURA_LLM_MODEL=null\n")
    assert process.poll() is None
    process.stdin.close()
    assert process.wait(timeout=10) == 0


@pytest.mark.skipif(os.name == "nt", reason="there are no such signals")
def test_the_program_ends_upon_a_signal_and_after_its_time(program):
    told, _ = program()
    told.send_signal(signal.SIGTERM)
    assert told.wait(timeout=10) == 0
    alone, line = program("--at-most", "0.1")
    assert "DURA_LLM_BASE_URL" in line
    assert alone.wait(timeout=10) == 0


def test_a_server_that_does_not_start_says_why(null_server, tmp_path):
    (tmp_path / f"null-{null_model.SEED}.gguf").write_bytes(b"no model")
    with (
        pytest.raises(RuntimeError, match=r"did not start(?s:.*)Failed to init server"),
        null_model.null_model_server(tmp_path),
    ):
        pass


@pytest.mark.parametrize(
    "required, outcome", [("0", pytest.skip.Exception), ("1", pytest.fail.Exception)]
)
def test_a_missing_wheel_skips_or_fails_where_it_is_required(monkeypatch, required, outcome):
    monkeypatch.setenv("DURA_REQUIRE_LLM", required)
    with pytest.raises(outcome, match="gguf not installed"):
        llm_servers.require_null_model("gguf not installed")
