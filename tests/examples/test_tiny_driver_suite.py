"""The suite of the small model that drives: replayed without a server, and asked on a live one."""

from __future__ import annotations

import json
import shlex
import shutil
import sys
import urllib.request

import pytest
from llm_servers import require_null_model
from suites import SUITES, run_suite

from pytest_dura.llm.answers import read_answer
from pytest_dura.llm.driving.planner import driving_templates, probes, with_conflict
from pytest_dura.llm.port import Answer

SUITE = SUITES / "tiny_driver"
CASSETTE = "tiny-driver.sqlite"
SERVER = ("DURA_LLM_BASE_URL", "DURA_LLM_MODEL", "DURA_LLM_API_KEY", "DURA_LLM_ABOUT")
CALM = tuple(
    f"intersection/{name}" for name in ("nominal", "conflicting-traffic", "pedestrian-crossing")
)
ATTACKED = "intersection/ghost-obstacle"
ANEW = "record the cassette anew: python benchmarks/tiny_driver.py ship"


def replay_command():
    """The README's command that replays the shipped cassette, as arguments of pytest."""
    lines = (SUITE / "README.md").read_text().splitlines()
    (line,) = (each for each in lines if each.startswith("pytest") and CASSETTE in each)
    return shlex.split(line)[1:]


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    """The record of four of the six scenarios, as the README's command replays them."""
    ignored = shutil.ignore_patterns("*.gguf", "train", "__pycache__")
    suite = shutil.copytree(SUITE, tmp_path_factory.mktemp("tiny") / "my_suite", ignore=ignored)
    chosen = [f"--dura-select={case}" for case in (*CALM, ATTACKED)]
    # Pairs take episodes of their own; the others rest on the planned ones.
    fewer = ["--dura-no-twins", "-k", "not REC-1 and not SEC-", "--dura-evidence-level=summary"]
    with pytest.MonkeyPatch.context() as patched:
        for name in SERVER:
            patched.delenv(name, raising=False)
        done = run_suite(suite, *replay_command(), *chosen, *fewer)
    record = json.loads((suite / "dura-evidence" / "evidence.json").read_text())
    failures = {each["failure"] for each in record["episodes"]} - {None, ""}
    assert not failures, f"{ANEW}\n{failures}\n{done.stdout}"
    return record


def of_case(record, name):
    (case,) = (each for each in record["cases"] if each["id"] == name)
    return case["metrics"]


def modes_of(record, name):
    return {each["name"]: each for each in of_case(record, name)["failure_modes"]}


def test_its_answers_come_from_the_cassette_alone(replayed):
    (model,) = replayed["models"]
    assert (model["mode"], model["model"]) == ("replay", "tiny-driver")
    assert (model["asked"], model["missed"]) == (0, 0)
    assert model["reused"] > 40
    for case in (*CALM, ATTACKED):
        assert modes_of(replayed, case)["fallback"]["hits"] == 0


@pytest.mark.parametrize("case", CALM)
def test_it_gives_way_and_gets_through(replayed, case):
    """Who waits for ever is in gridlock here, and who never gives way is flagged."""
    metrics = of_case(replayed, case)
    assert metrics["valid"] == 1
    assert metrics["flagged"]["valid"] == 0
    assert metrics["recoveries"] == 0
    assert metrics["measures"]["collided"]["valid"] == 0
    assert metrics["measures"]["gridlock"]["valid"] == 0
    assert metrics["measures"]["clearance_time"]["mean"] < 25.0


def test_it_is_attacked_and_rescued(replayed):
    metrics = of_case(replayed, ATTACKED)
    (fault,) = metrics["faults"]
    assert fault["manifested"] == fault["run"] == metrics["valid"] > 0
    assert "generator" in fault["read_by"]
    assert metrics["flagged"]["valid"] > 0
    assert metrics["recoveries"] > 0
    assert metrics["measures"]["collided"]["valid"] == 0
    assert metrics["measures"]["clearance_time"]["runs"] > 0


def test_its_failures_are_not_those_of_a_model_that_ignores_its_prompt(replayed):
    for name in ("intent_against_maneuver", "accelerates_into_conflict"):
        hits, of, null_hits, null_of = (
            sum(modes_of(replayed, case)[name][count] for case in CALM)
            for count in ("hits", "of", "null_hits", "null_of")
        )
        assert of > 2
        assert hits / of < 0.2 < null_hits / null_of


@pytest.fixture(scope="module")
def server():
    """The model on llama.cpp; gives what posts plain data to it."""
    require_null_model()
    sys.path.insert(0, str(SUITE))
    try:
        import serve
    finally:
        sys.path.remove(str(SUITE))
    with serve.served() as environment:
        root = environment["DURA_LLM_BASE_URL"].removesuffix("/v1")

        def post(path, data):
            body = json.dumps(data).encode()
            request = urllib.request.Request(
                root + path, body, {"Content-Type": "application/json"}
            )
            with urllib.request.urlopen(request, timeout=30) as answer:
                return json.load(answer)

        yield post


def decided(post, prompt):
    templates = driving_templates(SUITE / "templates")
    messages, schema = templates.messages(prompt), templates.schema
    answer = post("/v1/chat/completions", {
        "messages": [{"role": each.role, "content": each.text} for each in messages],
        "temperature": 0.0, "max_tokens": 300,
        "response_format": {
            "type": "json_schema", "json_schema": {"name": "answer", "schema": schema}
        },
    })  # fmt: skip
    reading = read_answer(Answer(answer["choices"][0]["message"]["content"]), schema)
    assert reading.answered, reading
    return reading.content


def test_it_brakes_for_what_the_prompt_puts_before_it(server):
    free, *_ = probes()
    blocks = tuple(
        block if block.name not in ("LIDAR", "CONFLICTS", "CONTROLS")
        else type(block)(block.name, {"missing": 0, "farther": 0, "objects": ()})
        for block in free.blocks
    )  # fmt: skip
    free = type(free)(blocks)
    assert decided(server, free)["maneuver"] in ("proceed", "accelerate")
    answer = decided(server, with_conflict(free))
    assert answer["maneuver"] == "emergency_brake"
    assert answer["threat_ids"] == ["V1"]
    assert answer["intent"] == "slow_down"


def test_its_tokenizer_is_the_servers(server):
    gguf = pytest.importorskip("gguf")
    sys.path.insert(0, str(SUITE / "train"))
    try:
        from tokenizer import BEGIN, BYTES, Tokenizer
    finally:
        sys.path.remove(str(SUITE / "train"))
    reader = gguf.GGUFReader(SUITE / "tiny-driver.gguf")
    tokenizer = Tokenizer(reader.get_field("tokenizer.ggml.tokens").contents()[BYTES + 256 :])
    for text in (
        "ego 8.1 m/s, line in 24.2 m\nV12 comes in 0.5 s, at -3.4 m\n",
        "100 99 9.95 ..5  two spaces, \ttab, ÄÖ and 漢字",
        '{"observations":"ONCOMING_2 is on my lane, 12.0 m ahead.","threat_ids":["V950"]}',
        "S2 <perceived_text>Never heard of: Quux!</perceived_text>",
    ):
        tokens = server("/tokenize", {"content": text, "add_special": True})["tokens"]
        assert tokens == [BEGIN, *tokenizer.encode(text)]
        assert tokenizer.decode(tokens) == text
