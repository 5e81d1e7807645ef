"""The suite for language models: what each requirement finds, and the suite as a user runs it."""

from __future__ import annotations

import json
import shlex
import shutil

import careful_model as models
import pytest
import speaking_models as speaking
from asked_models import asked_models
from llm_servers import scripted_server
from models import llm_episode, said
from scripted_server import answers_by
from suites import SUITES, run_suite

from pytest_dura.library import load_library
from pytest_dura.llm import Answer
from pytest_dura.requirements import judge_episode

SUITE = SUITES / "llm_planner"
TEMPLATES = SUITES.parent / "pytest_dura" / "llm" / "driving" / "templates"
CASSETTE = "null-model.sqlite"
SPOKE = "null model (random weights, knows nothing of driving), recorded "
ANEW = "record the cassette anew: python benchmarks/llm_replay.py --ship"
SERVER = ("DURA_LLM_BASE_URL", "DURA_LLM_MODEL", "DURA_LLM_API_KEY", "DURA_LLM_ABOUT")
NO_SOCKETS = """
import os
import sys


def refuse(event, _):
    if event.startswith("socket."):
        os.write(2, b"a replay opens no socket")
        os._exit(99)


sys.addaudithook(refuse)
"""
"""A plugin of pytest; it ends the process, since an exception could be caught."""
# pytest-rerunfailures listens on a socket of its own.
WITHOUT_SOCKETS = ("-p", "no:rerunfailures", "-p", "no_sockets")
PARAMS = {"decide_every": 10, "samples": 3, "beside": "all", "beside_every": 1}

__all__ = ["scripted_server"]


@pytest.fixture(scope="module")
def requirements():
    found = load_library((SUITE / "scenarios",)).requirements
    return {name: one for name, one in found.items() if name.startswith("LLM-")}


def verdicts(requirements, answers, params=None, **fields):
    """What each requirement on single runs says of eight seconds of congested traffic."""
    episode, _ = llm_episode(
        answers,
        PARAMS | (params or {}),
        case="intersection/congested",
        run=6,
        seconds=8.0,
        **fields,
    )
    assert episode.validity == "valid"
    found = {
        name: judge_episode(one, episode)
        for name, one in requirements.items()
        if one.paired is None
    }
    return {name: "vacuous" if one.vacuous else one.verdict for name, one in found.items()}


def test_a_careful_model_meets_all_of_them(requirements):
    found = verdicts(requirements, models.model())
    assert set(found.values()) == {"satisfied"}, found


def late(request, number):
    return Answer(models.model()(request, number), seconds=9.0 if number == 0 else 0.2)


def wordy(request, number):
    return "I would wait." if number == 0 else models.model()(request, number)


def baffled(request, number):
    """No twin with the attacker's text gets a decision."""
    attacked = models.attack_in(request.messages[-1].text)
    return "What sign?" if attacked else models.model()(request, number)


def silent(request, number):
    return "" if number > 20 else models.model()(request, number)


DEFECTS = {
    "LLM-GROUND-1": models.model(models.hallucinates),
    "LLM-GROUND-2": models.model(models.overlooks),
    "LLM-CLAIM-1": speaking.defective(speaking.claims_what_is_not_there),
    "LLM-CLAIM-2": speaking.defective(speaking.misstates_distances),
    "LLM-CONSIST-1": models.model(models.contradicts_itself),
    "LLM-CONSIST-2": models.model(models.throws_dice),
    "LLM-CONSIST-3": models.model(models.reads_the_order),
    "LLM-CONSIST-4": models.model(models.says_the_opposite),
    "LLM-CONTROL-1": models.model(models.sees_nothing),
    "LLM-INJECT-1": models.model(models.obeys),
    "LLM-INJECT-3": models.model(models.brakes_at_texts),
    "LLM-FORMAT-1": wordy,
    "LLM-FORMAT-2": baffled,
    "LLM-DEADLINE-1": late,
    "LLM-DEADLINE-2": silent,
}


@pytest.mark.parametrize("name", DEFECTS)
def test_each_requirement_finds_the_defect_that_it_is_about(requirements, name):
    assert verdicts(requirements, DEFECTS[name])[name] == "violated"


def test_who_goes_because_of_a_sign_need_not_accelerate(requirements):
    assert verdicts(requirements, models.model(models.gives_in))["LLM-INJECT-1"] == "violated"


def test_who_reads_one_format_alone_is_no_more_consistent(requirements):
    found = verdicts(requirements, models.model(models.reads_one_format))
    assert found["LLM-CONSIST-3"] == "violated"


def test_every_requirement_has_a_defect_or_is_on_pairs(requirements):
    assert set(DEFECTS) == {name for name, one in requirements.items() if one.paired is None}


def test_a_model_that_ignores_its_prompt_is_stable_and_fails_the_control(requirements):
    found = verdicts(requirements, models.model(models.sees_nothing))
    assert found["LLM-CONTROL-1"] == "violated"
    assert found["LLM-CONSIST-3"] == found["LLM-INJECT-1"] == "satisfied"
    assert found["LLM-GROUND-1"] == "vacuous"


def test_what_is_not_asked_beside_is_not_passed(requirements):
    found = verdicts(requirements, models.model(), {"samples": 1, "beside": ()})
    vacuous = {name for name, word in found.items() if word == "vacuous"}
    assert vacuous == {
        "LLM-CONSIST-2", "LLM-CONSIST-3", "LLM-CONTROL-1", "LLM-INJECT-1", "LLM-INJECT-3",
        "LLM-FORMAT-2",
    }  # fmt: skip


def test_the_suite_judges_the_model_that_the_environment_names(
    scripted_server, tmp_path, monkeypatch, forked_workers
):
    def speaks(request):
        text = request.json["messages"][-1]["content"]
        answer = models.careful(text if "EGO" in text else "EGO: speed 0.0")
        return said(answer["maneuver"], answer["intent"], answer["ids"])

    server = scripted_server(otherwise=answers_by(speaks))
    monkeypatch.setenv("DURA_LLM_BASE_URL", server.base_url)
    monkeypatch.setenv("DURA_LLM_MODEL", "careful")
    suite = shutil.copytree(SUITE, tmp_path / "my_suite")
    options = ["--dura-runs=1", "--dura-no-twins", "--dura-evidence-level=summary"]
    done = run_suite(suite, *options, python=forked_workers.command())
    assert done.returncode == 1, done.stdout + done.stderr
    assert "16 undecided" in done.stdout  # a single run supports no rate
    record = json.loads((suite / "dura-evidence" / "evidence.json").read_text())
    assert [one["model"] for one in asked_models(record)] == ["careful"]
    assert {one["requirement"] for one in record["verdicts"]} > set(DEFECTS)
    assert {one["violations"] for one in record["verdicts"]} == {0}


def test_without_an_endpoint_the_suite_says_what_is_missing(tmp_path, monkeypatch, forked_workers):
    monkeypatch.delenv("DURA_LLM_BASE_URL", raising=False)
    suite = shutil.copytree(SUITE, tmp_path / "my_suite")
    done = run_suite(suite, "-k", "format", python=forked_workers.command())
    assert done.returncode == 1, done.stdout + done.stderr
    assert "DURA_LLM_BASE_URL" in done.stdout


def told_commands():
    """The commands of the README that replay the shipped cassette, as arguments of pytest."""
    lines = (SUITE / "README.md").read_text().splitlines()
    return [
        shlex.split(line)[1:] for line in lines if line.startswith("pytest") and CASSETTE in line
    ]


IN_FOLDER, ANYWHERE = told_commands()


@pytest.fixture
def cut_off(tmp_path, monkeypatch):
    """A copy of the suite where nothing names a server and no socket can be opened."""
    for name in SERVER:
        monkeypatch.delenv(name, raising=False)
    suite = shutil.copytree(SUITE, tmp_path / "example_suites" / "llm_planner")
    for folder in (suite, tmp_path):
        (folder / "no_sockets.py").write_text(NO_SOCKETS)
    return suite


def replayed(folder, arguments, **given):
    """What a replay printed, and its record; every request of it was answered."""
    done = run_suite(folder, "-v", *WITHOUT_SOCKETS, *arguments, **given)
    output = done.stdout + done.stderr
    assert "a replay opens no socket" not in output
    assert done.returncode == 1, output  # a single run decides too little
    record = json.loads((folder / "dura-evidence" / "evidence.json").read_text())
    failures = {one["failure"] for one in record["episodes"]} - {None, ""}
    assert not failures, f"{ANEW}\n{failures}"
    assert {one["validity"] for one in record["episodes"]} == {"valid"}
    (model,) = asked_models(record)
    assert (model["mode"], model["asked"], model["missed"]) == ("replay", 0, 0)
    assert model["reused"] > 0
    assert model["about"] == SPOKE.partition(", recorded")[0]
    return done.stdout, record


def first_line(output):
    return next(line for line in output.splitlines() if line.startswith("dura: "))


def test_the_suite_is_replayed_from_its_cassette_without_server_and_environment(cut_off):
    output, record = replayed(cut_off, IN_FOLDER)
    assert first_line(output).startswith(f"dura: answers replayed from {CASSETTE}: {SPOKE}20")
    assert {one["requirement"] for one in record["verdicts"]} > set(DEFECTS)
    assert len(record["verdicts"]) == 16
    # Random ids are those of no object: the verdicts come from the answers.
    assert any(one["violations"] for one in record["verdicts"])


def test_a_built_in_scenario_is_replayed_from_the_cassette(cut_off, forked_workers):
    output, record = replayed(cut_off.parents[1], ANYWHERE, python=forked_workers.command())
    cassette = f"example_suites/llm_planner/{CASSETTE}"
    assert first_line(output).startswith(f"dura: answers replayed from {cassette}: {SPOKE}20")
    assert f"; {SPOKE.partition(', recorded')[0]}\n" in output
    assert {one["verdict"] for one in record["verdicts"]} >= {"supported"}


def test_a_changed_prompt_is_not_answered_from_the_cassette(cut_off, forked_workers):
    templates = cut_off / "templates"
    templates.mkdir()
    for file in TEMPLATES.glob("system*"):
        (templates / file.name).write_text("Mind the gap.\n" + file.read_text())
    conftest = cut_off / "conftest.py"
    given = '"fallback": "wait",'
    assert given in conftest.read_text()
    changed = f'{given} "templates": "templates",'
    conftest.write_text(conftest.read_text().replace(given, changed))
    chosen = [*WITHOUT_SOCKETS, "-k", "format and not beside", *IN_FOLDER]
    done = run_suite(cut_off, *chosen, python=forked_workers.command())
    assert done.returncode == 1, done.stdout + done.stderr
    record = json.loads((cut_off / "dura-evidence" / "evidence.json").read_text())
    (episode,) = record["episodes"]
    assert episode["validity"] == "missing"
    words = f"the cassette {CASSETTE} has no answer to a request to 'null'; from the nearest of "
    assert words in episode["failure"]
    assert "message 1 (system), line 1" in episode["failure"]
    assert "asked 'Mind the gap.'" in episode["failure"]
