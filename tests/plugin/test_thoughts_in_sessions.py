"""Prompts and answers of a language model in traces, report and replay, without secrets."""

from __future__ import annotations

import base64
import json
import re
import sys
import zlib
from pathlib import Path
from urllib.parse import urlparse
from urllib.request import url2pathname

import openai.resources.chat  # noqa: F401 - in-process runs forget what they imported
import pytest

import pytest_dura.llm.capabilities
import pytest_dura.llm.driving.planner  # noqa: F401 - see above
from pytest_dura.evidence import read_trace, verify_bundle

SUPPORT = str(Path(__file__).parents[1] / "support")
if SUPPORT not in sys.path:
    sys.path.insert(0, SUPPORT)

from llm_servers import scripted_server  # noqa: E402 - support modules lie elsewhere
from models import said  # noqa: E402
from scripted_server import answers_by  # noqa: E402

__all__ = ["scripted_server"]

SECRET = "hunter2-and-some-more"
SCENARIO = """
name: brief/crossing
simulator: driving
duration: 2
runs: 1
time_budget: 30
world: {ego: {speed: 5.0, distance: 60.0}}
roles:
  generator:
    path: llm
    params: {decide_every: 10, beside_every: 2, beside: [blind, reordered, injected]}
faults:
  - {type: prompt-text, target: controls, activation: {at: 0.0},
     parameters: {text: "</script><b>closed</b>"}}
requirements: [SLOW-1]
"""
REQUIREMENTS = """
requirements:
  - {id: SLOW-1, text: It stands., kind: safety, check: always (speed < 1)}
"""


def answers(request):
    """Gives away what it must not, which is also in the prompt of its next decision."""
    return said("proceed", observations="<i>", reasoning=f"the key is {SECRET}")


def packed(page):
    (data,) = re.findall(r'<script type="application/octet-stream"[^>]*>([^<]+)</script>', page)
    return zlib.decompress(base64.b64decode(data)).decode()


@pytest.fixture
def session(project, scripted_server, monkeypatch):
    project.write("scenarios/brief.yaml", SCENARIO)
    project.write("scenarios/slow.yaml", REQUIREMENTS)
    server = scripted_server(otherwise=answers_by(answers))
    monkeypatch.setenv("DURA_LLM_BASE_URL", server.base_url)
    monkeypatch.setenv("DURA_LLM_MODEL", server.model)
    monkeypatch.setenv("ROADSIDE_SECRET", SECRET)
    project.scenarios("--dura-no-twins", "--dura-llm=record", select="brief/*")
    return project


def test_report_and_replay_show_prompt_answer_and_variants_without_secrets(session):
    (episode,) = session.evidence().episodes
    evidence = session.path / "dura-evidence"
    assert verify_bundle(evidence).problems == []
    report = (evidence / "report.html").read_text()
    result = session.run(f"--dura-replay={episode.id}", "--dura-llm=replay")
    (line,) = [line for line in result.outlines if line.startswith("  player: ")]
    replay = Path(url2pathname(urlparse(line.removeprefix("  player: ")).path)).read_text()
    assert "  the same" in result.outlines
    for page in (report, replay):
        text = packed(page)
        assert SECRET not in text
        thoughts = json.loads(text)["panels"]["thoughts"]
        first, second = thoughts["decisions"]
        assert [first["tick"], second["tick"]] == [0, 10]
        roles = [role for role, _, _ in first["messages"]]
        assert (roles[0], roles[-1]) == ("system", "user")
        # What all decisions share is there once.
        assert first["messages"][:-1] == second["messages"][:-1]
        prompts = [thoughts["texts"][one["messages"][-1][1]] for one in (first, second)]
        assert prompts[0].startswith("EGO: ")
        assert "(/script)(b)closed(/b)" in prompts[0]  # as the template makes it
        assert "the key is" in prompts[1]
        answer = json.loads(thoughts["texts"][first["answer"]])
        assert answer["maneuver"] == first["maneuver"] == "proceed"
        assert first["words"][0] == ["observations", "<i>"]
        assert answer["reasoning"].startswith("the key is ")
        assert [twin[:2] for twin in first["beside"]] == [
            ["again", "answered"], ["reordered", "answered"],
        ]  # fmt: skip
        assert not second["beside"]
        assert first["seconds"] > 0.0


def test_the_trace_has_the_words_and_no_secret(session):
    (episode,) = session.evidence().episodes
    file = session.path / "dura-evidence" / episode.trace.file
    trace = read_trace(file)
    told = [account["exchange"] for account in trace.recording.accounts if account["decided"]]
    assert len(told) == 2
    assert all("EGO: " in exchange["messages"][-1]["text"] for exchange in told)
    assert SECRET not in str(trace.recording.accounts)
