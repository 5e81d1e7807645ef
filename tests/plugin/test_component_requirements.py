"""Requirements that come with a component: a language model's failure modes decide the gate."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import openai.resources.chat  # noqa: F401 - in-process runs forget what they imported
import pytest

import pytest_dura.llm.capabilities
import pytest_dura.llm.driving.planner  # noqa: F401 - see above
from pytest_dura.evidence import verify_bundle

SUPPORT = str(Path(__file__).parents[1] / "support")
if SUPPORT not in sys.path:
    sys.path.insert(0, SUPPORT)

from llm_servers import scripted_server  # noqa: E402 - support modules lie elsewhere
from scripted_server import answers_by  # noqa: E402
from speaking_models import SOUND, answer_of, plan_of  # noqa: E402

__all__ = ["scripted_server"]

CROSSING = """
name: brief/crossing
simulator: driving
duration: 1.5
runs: 9
time_budget: 30
world:
  ego: {distance: 60.0, speed: 8.0}
  vehicles:
    - {id: EAST, arm: east, turn: straight, distance: 30.0, speed: 9.0}
    - {id: WEST, arm: west, turn: straight, distance: 35.0, speed: 9.0}
variation: {world.ego.distance: {min: 60.0, max: 61.0}}
requirements: [SAF-1]
"""
NOTHING = "EGO: speed 0.0\nLIDAR: no objects"


def serve(scripted_server, monkeypatch, speaks, **changes):
    """Let a model answer that speaks in a way, with these changes of its answers."""

    def answers(request):
        text = request.json["messages"][-1]["content"]
        plan = plan_of(text if "EGO" in text else NOTHING)
        return json.dumps(answer_of(plan, speaks, **changes))

    server = scripted_server(otherwise=answers_by(answers), keep_alive=True)
    monkeypatch.setenv("DURA_LLM_BASE_URL", server.base_url)
    monkeypatch.setenv("DURA_LLM_MODEL", server.model)


def run(project, *arguments):
    project.write("scenarios/brief.yaml", CROSSING)
    options = ("--dura-generator=llm", "--dura-no-twins", *arguments)
    return project.scenarios(*options, select="brief/*")


@pytest.fixture
def verdicts(project):
    return lambda: {name: verdict for (_, name), verdict in project.verdicts().items()}


def test_a_model_that_speaks_and_cites_soundly_passes_the_gate(
    project, scripted_server, monkeypatch, verdicts
):
    serve(scripted_server, monkeypatch, SOUND["with numbers"])
    result = run(project)
    found = verdicts()
    assert len(found) == 14
    assert set(found.values()) == {"supported"}, found
    assert result.ret == 0
    assert "no requirement covers" not in result.stdout.str()


def test_a_model_that_hallucinates_fails_it(project, scripted_server, monkeypatch, verdicts):
    claims = [{"id": "V77", "kind": "truck", "ahead_m": 9.0, "arrives_s": 1.0}]
    serve(scripted_server, monkeypatch, SOUND["plainly"], claims=claims, threat_ids=["V99"])
    result = run(project)
    found = verdicts()
    failed = {name for name, verdict in found.items() if verdict == "violated"}
    assert failed == {"LLM-GROUND-1", "LLM-CLAIM-1"}
    assert result.ret == 1
    # What has no requirement of its own is named below the table.
    text = " ".join(result.stdout.str().split())
    assert "no requirement covers threat ids untrue (18 of 18)" in text
    for name in ("summary.md", "report.html"):
        assert "no requirement covers" in (project.path / "dura-evidence" / name).read_text()
    assert verify_bundle(project.path / "dura-evidence").problems == []


OWN = """
requirements:
  - id: LLM-GROUND-1
    text: It may cite what it likes.
    kind: safety
    check: always (proposal.threat_ids_unperceived < 1.5)
    reason: ours
"""


def test_a_requirement_of_the_same_id_takes_its_place(
    project, scripted_server, monkeypatch, verdicts
):
    serve(scripted_server, monkeypatch, SOUND["plainly"], threat_ids=["V99"])
    project.write("scenarios/requirements_own.yaml", OWN)
    result = run(project, "--dura-runs=1", "-k", "GROUND-1")
    assert verdicts() == {"LLM-GROUND-1": "supported"}
    assert "defined twice" not in result.stdout.str()


def test_they_apply_to_no_component_that_does_not_bring_them(project):
    project.write("scenarios/brief.yaml", CROSSING)
    project.scenarios("--dura-runs=1", select="brief/*")
    assert {name for _, name in project.verdicts()} == {"SAF-1"}


BRINGING = """
from pathlib import Path

from pytest_dura import Generator, Proposal


class Planner(Generator):
    requirement_files = (Path(__file__).with_name("mine.yaml"),)

    def propose(self, view):
        return Proposal("wait")
"""
MINE = """
requirements:
  - {id: MINE-1, text: t, kind: safety, applies_to: ["*"], check: always (speed < 99)}
  - {id: MINE-2, text: t, kind: safety, applies_to: ["*"], check: always (no_such_signal < 99)}
  - {id: MINE-3, text: t, kind: safety, applies_to: ["other/*"], check: always (speed < 99)}
"""


def test_a_component_of_ones_own_brings_what_its_scenarios_can_decide(project):
    project.write("bringing.py", BRINGING)
    project.write("mine.yaml", MINE)
    project.write("scenarios/brief.yaml", CROSSING)
    options = ("--dura-generator=bringing:Planner", "--dura-runs=1")
    project.scenarios(*options, select="brief/*")
    assert {name for _, name in project.verdicts()} == {"SAF-1", "MINE-1"}


def test_a_mistake_in_a_file_that_comes_with_a_component_is_told_with_its_place(project):
    project.write("bringing.py", BRINGING)
    project.write("mine.yaml", MINE.replace("always (speed < 99)}", "always (speed <)}", 1))
    project.write("scenarios/brief.yaml", CROSSING)
    result = project.scenarios("--dura-generator=bringing:Planner", select="brief/*")
    assert result.ret == 4
    assert "mine.yaml" in result.stderr.str() + result.stdout.str()
    assert "Traceback" not in result.stderr.str()
