from __future__ import annotations

import json
from html import unescape
from xml.etree import ElementTree as ET

import pytest
from corridors import IDLE, requirement, scenario
from outputs import shown_of

from pytest_dura.evidence import open_record, verify_bundle
from pytest_dura.reports.document import Level
from pytest_dura.reports.story import document_of


def failing(project, name, *arguments):
    result = project.run(f"corridor/{name}", *arguments)
    text = result.stdout.str() + result.stderr.str()
    assert "Traceback" not in text
    assert "INTERNALERROR" not in text
    assert "pytest_dura/" not in text
    assert result.ret == 1
    return result, text


@pytest.mark.parametrize(
    "generator, words",
    [
        ("Raises", "Raises raised ValueError: out of ideas (corridor.py:"),
        ("ReturnsNaN", "ReturnsNaN failed: no valid action: the action nan is no finite number"),
    ],
)
def test_a_component_that_fails_is_judged(project, generator, words):
    scenario(project, "fails", generator=generator)
    judged(project, words)


def test_a_component_that_hangs_is_judged_in_a_worker_too(project):
    scenario(project, "fails", generator="Hangs")
    judged(project, "Hangs overran its wall-clock time budget", "--dura-time-budget=0.2", "-n", "2")


def judged(project, words, *mode):
    result, text = failing(project, "fails", *mode)
    result.assert_outcomes(failed=2)
    # One cause has one card, with what is undecided by it and what is violated.
    card = " ".join(text.partition("violated: performance on corridor/fails (")[2].split())
    assert words in card
    assert ", in 2 of 2 runs. GO-1: 2 of 2 runs violate it" in card
    assert "GAP-1: undecided, 0 of 2 runs violate it" in card
    assert " (1 of 1 cause)" in text
    # pytest's own sections on both items name what came first, of a violation as well.
    own = text.partition("= FAILURES =")[2].partition("= dura =")[0].splitlines()
    lines = [line for line in own if line.startswith(("component:", "worst:", "rerun:"))]
    assert [line.partition(":")[0] for line in lines] == ["component", "rerun"] * 2
    assert all(words in line for line in lines[::2])
    assert "Repair " in card.partition("next:")[2]
    # The fallback keeps the ego where it is: that is no achievement of the component.
    assert project.verdicts() == {
        ("corridor/fails", "GAP-1"): "undecided",
        ("corridor/fails", "GO-1"): "violated",
    }
    assert "the component made a valid proposal at only 0 of" in text
    events = project.evidence().episodes[0].events
    assert events[0].kind == "component_failure"


@pytest.mark.parametrize("mode", ["n2"], indirect=True)
def test_the_whole_traceback_is_in_the_record_and_in_a_card_of_the_page(project, mode):
    scenario(project, "fails", generator="Raises")
    project.run("corridor/fails", *mode, "--junit-xml=junit.xml", "--alluredir=allure")
    record = project.evidence()
    trace = record.episodes[0].events[0].traceback
    assert trace.startswith("Traceback (most recent call last):\n")
    assert trace.endswith('    raise ValueError("out of ideas")\nValueError: out of ideas')
    assert 'File "corridor.py", line ' in trace
    entries = [
        entry
        for card in document_of(open_record(project.path / "dura-evidence/evidence.json")).cards
        for entry in card.entries
        if entry.label == "traceback"
    ]
    assert [(each.text, each.kind, each.weight) for each in entries] == [
        (trace, "code", Level.PAGE)
    ]
    page = unescape((project.path / "dura-evidence/report.html").read_text())
    assert 'raise ValueError("out of ideas")' in page
    assert verify_bundle(project.path / "dura-evidence").problems == []
    properties = ET.parse(project.path / "junit.xml").iter("property")
    shown = [each.get("value") for each in properties if each.get("name") == "card_traceback"]
    assert shown == [trace, trace]
    for file in (project.path / "allure").glob("*-result.json"):
        description = json.loads(file.read_text())["description"]
        assert f"traceback:\n\n```\n{trace}\n```" in description
        assert ", in 2 of 2 runs" in description or "in each of 2 runs" in description


@pytest.mark.parametrize("mode", ["plain", "n2"], indirect=True)
def test_a_role_that_fails_is_infrastructure(project, mode):
    scenario(project, "broken", monitor="Broken")
    result, text = failing(project, "broken", *mode)
    result.assert_outcomes(failed=2)
    start = "infrastructure: safety_monitor at tick 0 (t = 0.0 s): RuntimeError: no opinion"
    assert any(line.startswith(start) for line in text.splitlines())
    assert "undecided: GAP-1 on corridor/broken" in text
    assert set(project.verdicts().values()) == {"undecided"}
    evidence = project.evidence()
    assert evidence.episodes[0].validity == "missing"
    assert evidence.episodes[0].events[-1].traceback.endswith("RuntimeError: no opinion")
    assert evidence.verdicts[0].missing == 2
    assert "0 (2)" in text


def test_a_fault_that_never_manifests_has_more_runs_follow(project):
    scenario(project, "idle", runs=5, faults=IDLE, fault_injector="Idle")
    result, text = failing(project, "idle")
    result.assert_outcomes(failed=2)
    assert "invalid:  corridor/idle#0: never manifested: ghost-obstacle" in text
    (verdict, _) = project.evidence().verdicts
    # One run in five may be replaced.
    assert (verdict.planned, verdict.run, verdict.invalid) == (5, 6, 6)
    assert [one.id for one in project.evidence().episodes][-1] == "corridor/idle#5"


TEST = """
import pytest

@pytest.mark.dura(scenario="corridor/{}")
@pytest.mark.requirement("GAP-1")
def test_it(episode):
    assert not episode.collided
"""


def test_a_test_cannot_pass_on_an_invalid_episode(project):
    """Whether it names a requirement of the scenario, one of its own, or none."""
    scenario(project, "idle", faults=IDLE, fault_injector="Idle")
    text = TEST.format("idle")
    project.write("test_known.py", text)
    project.write("test_own.py", text.replace('"GAP-1"', "'OWN-1', text='It keeps away.'"))
    without = text.replace('@pytest.mark.requirement("GAP-1")\n', "")
    project.write("test_none.py", without.replace('idle")', 'idle", verdict=False)'))
    result = project.run("test_known.py", "test_own.py", "test_none.py")
    result.assert_outcomes(failed=6)
    told = "invalid: corridor/idle#0: never manifested: ghost-obstacle"
    assert result.stdout.str().partition("= dura =")[0].count(told) >= 3
    verdicts = [(one.requirement, one.verdict, one.invalid) for one in project.evidence().verdicts]
    assert sorted(verdicts) == [("GAP-1", "undecided", 2), ("OWN-1", "undecided", 2)]


def test_a_violation_on_an_invalid_episode_is_a_violation(project):
    scenario(
        project,
        "idle",
        world="{wall: 1.0}",
        generator="Reckless",
        faults=IDLE,
        fault_injector="Idle",
    )
    project.write("test_it.py", TEST.format("idle"))
    project.run("test_it.py").assert_outcomes(failed=2)
    (verdict,) = project.evidence().verdicts
    assert (verdict.verdict, verdict.violations) == ("violated", 0)
    assert (verdict.without_effect, verdict.invalid, verdict.episodes) == (2, 2, 0)
    assert verdict.reason.startswith("violated, without effect of the fault")


def test_a_test_cannot_pass_on_a_missing_episode(project):
    scenario(project, "collapses", world="{breaks_at: 3}")
    project.write("test_it.py", TEST.format("collapses"))
    result = project.run("test_it.py")
    result.assert_outcomes(failed=2)
    assert "infrastructure: simulator at tick 2" in result.stdout.str()
    (verdict,) = project.evidence().verdicts
    assert (verdict.verdict, verdict.missing) == ("undecided", 2)


@pytest.mark.parametrize(
    "broken, error",
    [
        ("episode.colided", "AttributeError: "),
        ("{}['speed']", "KeyError: 'speed'"),
        ("episode.satisfies('always (gapp > 0)')", "unknown signal 'gapp' in the formula"),
    ],
)
def test_a_broken_test_says_nothing_of_the_component(project, broken, error):
    project.write("test_it.py", TEST.format("tight").replace("episode.collided", broken))
    result = project.run("test_it.py")
    result.assert_outcomes(failed=2)
    (verdict,) = project.evidence().verdicts
    assert (verdict.verdict, verdict.missing) == ("undecided", 2)
    assert verdict.reason.startswith("2 of 2 episodes are not judged, since the test failed")
    assert verdict.first_uncounted.detail.startswith(f"the test failed: {error}")
    card = " ".join(result.stdout.str().partition("= dura =")[2].split())
    assert f"A run is not judged: the test failed: {error}" in card
    assert "role or the simulator" not in card
    assert "infrastructure" not in card
    assert verify_bundle(project.path / "dura-evidence").problems == []


def test_a_generator_with_a_constructor_that_needs_something(project):
    project.write(
        "needy.py",
        "from corridor import Careful\n"
        "class Needy(Careful):\n    def __init__(self, model): pass\n"
        "class Unlucky(Careful):\n    def __init__(self): raise OSError('no weights')\n",
    )
    result = project.run("corridor/tight", "--dura-generator=needy:Needy")
    assert result.ret == 4
    result.stderr.fnmatch_lines(["ERROR: needy:Needy cannot be built without parameters*"])
    result, text = failing(project, "tight", "--dura-generator=needy:Unlucky")
    assert "needy:Unlucky cannot be built: OSError: no weights" in text


def test_no_test_passes_on_missing_episodes(project):
    scenario(project, "collapses", world="{breaks_at: 3}")
    by_hand = "def test_{0}({0}): assert not {0}{1}('corridor/collapses').collided\n"
    campaign = TEST.format("collapses").replace(
        "test_it(episode):\n    assert not episode.collided",
        "test_campaign(campaign):\n    assert not any(one.collided for one in campaign)",
    )
    text = campaign + by_hand.format("run_episode", "") + by_hand.format("orchestrator", ".run")
    project.write("test_it.py", text)
    result = project.run("test_it.py")
    result.assert_outcomes(failed=3)
    for name, shown in shown_of(result).items():
        assert "infrastructure: simulator at tick 2" in str(shown), name
        assert "(in corridor/collapses#0)" in str(shown), name
    assert "pytest_dura/" not in result.stdout.str()


def test_a_campaign_of_invalid_episodes_carries_no_pass(project):
    scenario(project, "idle", faults=IDLE, fault_injector="Idle")
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/idle')\n"
        "def test_it(campaign): assert not any(one.collided for one in campaign.episodes)\n",
    )
    result = project.run("test_it.py")
    result.assert_outcomes(failed=1)
    assert "undecided: 3 of 3 episodes are invalid (corridor/idle#0: never" in result.stdout.str()
    project.run("test_it.py", "--dura-undecided=warn").assert_outcomes(failed=1)


def test_the_gate_fails_on_a_verdict_for_which_no_test_failed(project):
    scenario(project, "useless", generator="ReturnsNaN", runs=3)
    project.write("test_it.py", TEST.format("useless"))
    result = project.run("test_it.py")
    result.assert_outcomes(passed=3)
    assert result.ret == 1
    assert "the gate fails: GAP-1 on corridor/useless is undecided, though" in result.stdout.str()
    assert project.run("test_it.py", "--dura-undecided=warn").ret == 1
    project.write("test_it.py", TEST.format("tight"))
    assert project.run("test_it.py").ret == 0
    assert project.run("test_it.py", "-k", "tight and 0").ret == 1


SOMETIMES = """
from corridor import Careful
from pytest_dura import stream

class Sometimes(Careful):
    def reset(self, context):
        self.fails = stream(context.seed, "mood").random() < 0.4

    def propose(self, view):
        if self.fails:
            raise ValueError("out of ideas")
        return super().propose(view)
"""


@pytest.mark.parametrize(
    "seed, asked, runs, because",
    [
        (0, "GAP-1", 2, ""),
        (0, "GAP-1, GO-1", 2, ""),
        (1, "OFTEN-1", 1, "Too few runs to tell: 1 of 3 violates OFTEN-1 on corridor/fails"),
    ],
)
def test_a_card_names_what_a_component_raised_in_some_runs(project, seed, asked, runs, because):
    project.write("sometimes.py", SOMETIMES)
    requirement(
        project, "eventually (cleared >= 1)", "OFTEN-1", at_most="0.4", confidence="0.95"
    )  # fmt: skip
    scenario(
        project, "fails", generator="sometimes:Sometimes", runs=3, duration=2.0,
        requirements=f"[{asked}]",
    )  # fmt: skip
    _, text = failing(project, "fails", f"--dura-seed={seed}")
    assert project.verdicts()["corridor/fails", asked.partition(",")[0]] == "undecided"
    assert " (1 of 1 cause)" in text, "what the same exception leaves undecided has no second card"
    (card,) = document_of(open_record(project.path / "dura-evidence/evidence.json")).cards
    assert because in card.headline
    assert "Sometimes raised ValueError: out of ideas (sometimes.py:" in card.headline
    assert f"in {runs} of 3 runs" in card.headline
    entries = {entry.label: entry.text for entry in card.entries}
    assert entries["next"].startswith("Repair Sometimes first, at sometimes.py:")
    assert 'raise ValueError("out of ideas")' in entries["traceback"]
    first = entries["episode"].partition(";")[0]
    (replayed,) = (each for each in project.evidence().episodes if each.id == first)
    assert replayed.events[0].kind == "component_failure"
