"""The hook ``pytest_dura_event``: which events it is called with, where, and what if it raises."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import fields
from pathlib import Path
from typing import get_args

import pytest
from corridors import IDLE, scenario

from pytest_dura.campaign import SessionEvent

PAGE = (Path(__file__).parents[2] / "docs" / "events.md").read_text("utf-8")
NOTES = """
import json, os

def pytest_dura_event(event):
    fields = {name: str(getattr(event, name)) for name in type(event).__slots__}
    note = [type(event).__name__, os.environ.get("PYTEST_XDIST_WORKER", ""), fields]
    with open("{file}", "a") as file:
        file.write(json.dumps(note) + "\\n")
"""
TESTS = """
import pytest
from hypothesis import given, settings
from pytest_dura import strategies

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("OWN-1", text="Pairs.")
def test_pairs(campaign):
    campaign.paired(without="recovery_planner").require("always (gap > -100)")

@pytest.mark.dura(scenario="corridor/free", verdict=False)
def test_search(campaign):
    campaign.falsify("always (gap > -100)", budget=3)

@pytest.mark.dura(verdict=False)
@settings(max_examples=2, derandomize=True)
@given(case=strategies.cases("corridor/free"))
def test_property(case, run_episode):
    run_episode(case)
"""


@pytest.fixture
def eventful(project):
    """A project whose session emits every kind of event, and notes each in ``events.txt``."""
    scenario(project, faults=IDLE, fault_injector="Idle", recovery_planner="Brake")
    project.write("conftest.py", NOTES.replace("{file}", "events.txt"))
    project.write("test_it.py", TESTS)
    return project


def notes(project, file="events.txt"):
    return [json.loads(line) for line in (project.path / file).read_text().splitlines()]


def verdicts(project, file="events.txt"):
    return sorted(
        fields["verdict"] for kind, _, fields in notes(project, file) if kind == "VerdictReached"
    )


@pytest.mark.parametrize("workers", [["-n", "2"]], ids=["n2"])
def test_each_kind_of_event_is_seen_where_its_item_runs(eventful, workers, monkeypatch):
    # This test may be a worker's itself.
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    eventful.run("--dura-scenarios", "--dura-select=corridor/*", "test_it.py", *workers)
    seen = notes(eventful)
    # Facts are those of qualification, whose own tests see them.
    kinds = {kind.__name__ for kind in get_args(SessionEvent)} - {"FactEstablished"}
    assert {kind for kind, _, _ in seen} == kinds
    places = {place for _, place, _ in seen}
    assert places <= {"gw0", "gw1"} if workers else places == {""}
    assert len(verdicts(eventful)) == len(eventful.evidence().verdicts)
    uses = Counter(fields["case"] for kind, _, fields in seen if kind == "EpisodeUsed")
    assert uses


def test_events_are_as_many_with_workers_as_without(project):
    project.write("conftest.py", NOTES.replace("{file}", "events.txt"))
    project.scenarios()
    plain = Counter(kind for kind, _, _ in notes(project))
    (project.path / "events.txt").unlink()
    project.scenarios("-n", "2")
    assert Counter(kind for kind, _, _ in notes(project)) == plain
    assert plain["VerdictReached"] == 3


def test_a_plugin_and_a_conftest_see_the_same(project):
    project.write("conftest.py", NOTES.replace("{file}", "conftest.txt"))
    project.write("follower.py", NOTES.replace("{file}", "follower.txt"))
    project.scenarios("-p", "follower")
    assert notes(project, "conftest.txt") == notes(project, "follower.txt") != []


def test_the_example_of_the_documentation_works(project):
    (example,) = re.findall(r"```python\n(# conftest\.py\n.*?)```", PAGE, re.DOTALL)
    project.write("conftest.py", example)
    project.scenarios("--dura-generator=corridor:Reckless").assert_outcomes(failed=2, passed=1)
    assert sorted((project.path / "verdicts.txt").read_text().splitlines()) == [
        "violated: GAP-1 on corridor/free",
        "violated: GAP-1 on corridor/tight",
    ]


def test_the_documentation_names_every_event_with_its_fields():
    rows = dict(re.findall(r"^\| `(\w+)` \|[^|]*\| (.*) \|$", PAGE, re.MULTILINE))
    known = {
        kind.__name__: [field.name for field in fields(kind)] for kind in get_args(SessionEvent)
    }
    assert {name: re.findall(r"`(\w+)`", row) for name, row in rows.items()} == known


RAISES = """
import pytest

def pytest_dura_event(event):
    if type(event).__name__ == "{kind}":
        {statement}
"""


@pytest.mark.parametrize(
    "statement",
    ["raise ValueError('not today')", "pytest.fail('not today')", "pytest.skip('not today')"],
)
def test_a_hook_that_raises_fails_its_items_and_the_gate(project, statement):
    hook = RAISES.format(kind="VerdictReached", statement=statement)
    project.write("conftest.py", hook)
    result = project.scenarios("-n", "2")
    result.assert_outcomes(failed=3)
    assert result.ret == 1
    message = r"conftest\.py:6: the hook pytest_dura_event raised at VerdictReached: .*not today"
    text = result.stdout.str()
    assert re.search(rf"^E? *{message}", text, re.MULTILINE)
    section = " ".join(text.partition("= dura =")[2].split())
    card = r"incomplete: the session \S+ of \d+ causes?\) infrastructure: "
    assert re.search(rf"{card}{message}", section)
    assert "INTERNALERROR" not in text + result.stderr.str()
    assert project.evidence().gate.result == "failed"


def test_a_hook_that_raises_fails_the_gate_though_the_test_catches_it(project):
    hook = RAISES.format(kind="EpisodeUsed", statement="raise ValueError('not today')")
    project.write("conftest.py", hook)
    project.write(
        "test_it.py",
        "def test_it(orchestrator):\n"
        "    try:\n"
        "        orchestrator.run('corridor/free')\n"
        "    except Exception:\n"
        "        pass\n",
    )
    result = project.run("test_it.py")
    result.assert_outcomes(passed=1)
    assert result.ret == 1
    result.stdout.fnmatch_lines(
        ["  infrastructure: conftest.py:6: the hook pytest_dura_event raised*"]
    )


def test_a_hook_that_raises_leaves_an_episode_test_without_an_episode(project):
    hook = RAISES.format(kind="EpisodeUsed", statement="raise ValueError('not today')")
    project.write("conftest.py", hook)
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/free', runs=1)\n"
        "@pytest.mark.requirement('OWN-1', text='Holds.')\n"
        "def test_it(episode): assert episode.ticks\n",
    )
    result = project.run("test_it.py")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(
        ["*conftest.py:6: the hook pytest_dura_event raised at EpisodeUsed*"]
    )


def test_a_hook_may_end_the_session(project):
    hook = RAISES.format(kind="VerdictReached", statement="pytest.exit('seen enough')")
    project.write("conftest.py", hook)
    result = project.scenarios()
    assert "seen enough" in result.stdout.str() + result.stderr.str()
    assert "the hook pytest_dura_event raised" not in result.stdout.str()
    assert result.ret != 0
    assert project.evidence().status == "interrupted"
