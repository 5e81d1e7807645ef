"""Runs that end early, and runs in which a fault had no effect: what they count as, and where."""

from __future__ import annotations

import json
import re
from xml.etree import ElementTree as ET

import pytest
from corridors import IDLE, expect, requirement, scenario

from pytest_dura.__main__ import main
from pytest_dura.requirements import upper_bound

CRASHES = '''
"""A corridor that crashes, or reaches its goal, at a tick that the world names."""

from corridor import Corridor
from pytest_dura import Assessed, Assessment, SafetyMonitor, Tick


class Crashes(Corridor):
    def reset(self, scenario, seed):
        world = scenario["world"]
        self.crash, self.goal = world.get("crash", 0), world.get("goal", 0)
        return super().reset(scenario, seed)

    def _tick(self):
        made = super()._tick()
        crashed = self.crash and self.index >= self.crash
        return Tick(
            made.index, made.time, made.truth, made.channels,
            critical="ran into VICTIM" if crashed else None,
            goal=bool(self.goal and self.index >= self.goal),
        )


class CrashesAtHalf(Corridor):
    """Crashes once it has gone half a metre."""

    def _tick(self):
        made = super()._tick()
        critical = "ran into VICTIM" if self.x >= 0.5 else None
        return Tick(made.index, made.time, made.truth, made.channels, critical=critical)


class Refuses(SafetyMonitor):
    def run(self, view):
        return Assessment(Assessed.UNSAFE, reasons=("no further",))
'''


@pytest.fixture
def crashing(project):
    """The project with the module `crashes`."""
    project.write("crashes.py", CRASHES)
    return project


def crash(project, check, *, world="{crash: 2}", duration=1.0, **keys):
    """The scenario `corridor/it` on `Crashes`, judged by one requirement R-1."""
    requirement(project, check, at_most=keys.pop("at_most", None))
    wanted = {"requirements": "[R-1]", "runs": 3, **keys}
    scenario(project, simulator="crashes:Crashes", world=world, duration=duration, **wanted)


LATE = "always[0.5:0.8] (x < 50)"
"""A window that begins after the crash."""


def test_runs_that_crash_before_a_window_count_as_violations(crashing):
    sees = "requirements: [{id: SEES-1, text: No crash., kind: safety, check: 'always (x < 0.15)'}]"
    crashing.write("scenarios/requirements_SEES-1.yaml", sees)
    variation = "{world.crash: {choice: [2, 0, 0, 0, 0, 0, 0, 0]}}"
    crash(
        crashing, LATE, at_most=0.05, runs=80, variation=variation, requirements="[R-1, SEES-1]"
    )  # fmt: skip
    result = crashing.run("corridor/it::R-1")
    found = expect(crashing, result, "undecided", "ended before it was decided")
    opened = len(found.open)
    assert 3 <= opened <= 20
    assert (found.episodes, found.violations, found.run) == (80, 0, 80)
    assert found.bound.upper == upper_bound(opened, 80, 0.95)
    assert f"{opened} ended before it was decided" in result.stdout.str()
    ends = {one.id: one.termination for one in crashing.evidence().episodes}
    assert {name for name, end in ends.items() if end == "critical"} == set(found.open)


def test_one_open_run_leaves_a_requirement_without_a_rate_undecided(crashing):
    crash(crashing, LATE, variation="{world.crash: {choice: [2, 0]}}", runs=6)
    result = crashing.run("corridor/it")
    found = expect(crashing, result, "undecided", "ended before it was decided (")
    assert 0 < len(found.open) < 6
    assert re.search(r"\d of 6 valid episodes ended before it was decided \(\d critical\)",
                     found.reason)  # fmt: skip


DUE = ["eventually[0:0.9] (x >= 100)", "(x < 100) until (x >= 100)", "not always[0:0.9] (x < 100)"]


def test_an_eventuality_that_is_due_at_a_crash_is_violated(crashing):
    for number, check in enumerate(DUE):
        requirement(crashing, check, f"DUE-{number}")
    crash(crashing, "eventually (x >= 100)", requirements="[R-1, DUE-0, DUE-1, DUE-2]")
    result = crashing.run("corridor/it")
    for name in ("R-1", "DUE-0", "DUE-1", "DUE-2"):
        reason = "valid episodes violated it"
        found = expect(crashing, result, "violated", reason, requirement=name)
        assert (found.violations, found.open) == (found.episodes, ())


def test_a_halt_leaves_open_what_was_to_hold_always(crashing):
    crash(crashing, "always (x < 50)", world="{}", monitor="crashes:Refuses")
    file = crashing.path / "scenarios/corridor/it.yaml"
    file.write_text(file.read_text() + "policy: halt\n")
    result = crashing.run("corridor/it")
    found = expect(crashing, result, "undecided", "ended before it was decided")
    assert len(found.open) == found.episodes > 0


AT_GOAL = {
    "R-1": (LATE, "undecided"),
    "R-2": ("always[0.1:0.8] (x < 50)", "supported"),
    "R-3": ("always (x < 50)", "supported"),
    "R-4": ("eventually[0:0.8] (x >= 50)", "violated"),
}


def test_an_end_by_goal_is_judged_on_the_trace_as_it_stands(crashing):
    # The first window lies behind the end altogether: such passes are vacuous.
    for name, (check, _) in AT_GOAL.items():
        requirement(crashing, check, name)
    crash(crashing, LATE, world="{goal: 2}", requirements="[R-1, R-2, R-3, R-4]")
    result = crashing.run("corridor/it")
    for name, (_, word) in AT_GOAL.items():
        found = expect(crashing, result, word, requirement=name, ret=1)
        assert (found.open, found.invalid) == ((), 0)
        assert ("vacuous" in found.reason) == (word == "undecided")


def test_a_window_beyond_the_duration_is_refused_at_its_place(crashing):
    crash(crashing, "eventually[0:60] (x >= 100)")
    result = crashing.run("corridor/it")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    told = result.stderr.str()
    assert "requirements_R-1.yaml:2: the windows of the formula reach beyond the episodes" in told
    assert "which looks 60 s ahead" in told
    assert "the scenario's duration of 1 s" in told


def test_a_crash_that_no_requirement_sees_is_undecided(crashing):
    crash(crashing, "eventually (x >= 0)")
    result = crashing.run("corridor/it")
    reason = "a crash that no requirement sees: corridor/it#0"
    found = expect(crashing, result, "undecided", reason)
    assert len(found.unseen_crashes) == found.run
    assert found.open == ()


def test_a_crash_that_another_requirement_sees_is_no_obstacle(crashing):
    sees = "requirements: [{id: SEES-1, text: No crash., kind: safety, check: 'always (x < 0.15)'}]"
    crashing.write("scenarios/requirements_SEES-1.yaml", sees)
    crash(crashing, "eventually (x >= 0)", requirements="[R-1, SEES-1]")
    result = crashing.run("corridor/it")
    expect(crashing, result, "supported", ret=1)
    expect(crashing, result, "violated", requirement="SEES-1")


PAIRED = {"kind": "security", "paired": "{without: faults}"}
STOPPED = "[{type: bias, target: gap, activation: {at: 0.1}, parameters: {offset: -8.0}}]"
"""With this fault the component `Careful` stands still."""


@pytest.mark.parametrize(
    "simulator, crashed",
    [("crashes:Crashes", "corridor/it#0"), ("crashes:CrashesAtHalf", "corridor/it+none#0")],
    ids=["both runs", "the run without faults"],
)
def test_a_requirement_on_pairs_sees_the_crash_of_neither_run(crashing, simulator, crashed):
    """Both runs satisfy the first check and violate the second one."""
    requirement(crashing, "always (gap > 0)", **PAIRED)
    requirement(crashing, "always (x < 0.05)", "R-2", **PAIRED)
    scenario(
        crashing, simulator=simulator, world="{crash: 3}", duration=1.0, runs=3, faults=STOPPED,
        requirements="[R-1, R-2]",
    )  # fmt: skip
    result = crashing.run("corridor/it", "--dura-undecided=warn")
    reason = f"a crash that no requirement sees: {crashed} and 2 more ended critical"
    for name in ("R-1", "R-2"):
        found = expect(crashing, result, "undecided", reason, requirement=name)
        assert len(found.unseen_crashes) == found.run == 3
    assert main(["verify", str(crashing.path / "dura-evidence")]) == 0


def test_a_requirement_on_single_runs_sees_the_crash_of_a_pair(crashing):
    sees = "requirements: [{id: SEES-1, text: No crash., kind: safety, check: 'always (x < 0.4)'}]"
    crashing.write("scenarios/requirements_SEES-1.yaml", sees)
    requirement(crashing, "always (gap > 0)", **PAIRED)
    scenario(
        crashing, simulator="crashes:CrashesAtHalf", duration=1.0, runs=3, faults=STOPPED,
        requirements="[R-1, SEES-1]",
    )  # fmt: skip
    assert crashing.run("corridor/it").ret == 0
    assert set(crashing.verdicts().values()) == {"supported"}


def test_a_crash_is_not_seen_by_a_requirement_on_pairs(crashing):
    """Such a requirement asks whether two runs differ: both may violate its check, and pass."""
    paired = {"paired": "{without: safety_monitor}"}
    requirement(crashing, "always (x < 0.15)", "PAIR-1", **paired)
    requirement(crashing, "eventually (x >= 0)", "PAIR-2", **paired)
    crash(crashing, "eventually (x >= 0)", requirements="[R-1, PAIR-1, PAIR-2]")
    result = crashing.run("corridor/it")
    reason = "a crash that no requirement sees: corridor/it#0"
    found = expect(crashing, result, "undecided", reason)
    assert len(found.unseen_crashes) == found.run


def test_an_invalid_run_that_violates_fails_the_gate_in_words_of_its_own(project):
    requirement(project, "always (gap > 0)")
    scenario(
        project, world="{wall: 1.0}", generator="Reckless", faults=IDLE, fault_injector="Idle",
        requirements="[R-1]",
    )  # fmt: skip
    result = project.run("corridor/it", "--dura-undecided=warn")
    found = expect(project, result, "violated", "violated, without effect of the fault, in 3 of 3")
    assert (found.episodes, found.violations, found.invalid) == (0, 0, 3)
    assert (found.without_effect, found.bound.upper) == (3, None)
    assert [one.valid for one in found.counterexamples] == [False] * 3
    assert "valid episodes violated it" not in result.stdout.str()


def test_a_rate_is_not_supported_beside_invalid_runs_that_violate(project):
    requirement(project, "always (gap > 3)", at_most=0.9)
    late = "{choice: [0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.4]}"  # after 0.4 s nothing is decided
    scenario(
        project, runs=30, requirements="[R-1]", world="{wall: 99.0}",
        faults="[{type: ghost-obstacle, activation: {at: 0.1}}]",
        variation=f"{{faults.ghost-obstacle.activation.at: {late},"
        " world.wall: {choice: [3.2, 99.0]}}",
        fault_injector="oddities:Nudge",
    )  # fmt: skip
    result = project.run("corridor/it")
    found = expect(project, result, "undecided", "violated, without effect of the fault")
    assert found.without_effect > 0
    assert 0 < found.violations < found.episodes
    assert found.bound.upper == upper_bound(found.violations, found.episodes, 0.95)


def test_every_format_agrees_on_runs_without_effect_of_the_fault(project):
    requirement(project, "always (gap > 0)")
    scenario(
        project, world="{wall: 1.0}", generator="Reckless", faults=IDLE, fault_injector="Idle",
        requirements="[R-1]",
    )  # fmt: skip
    outputs = ["--junit-xml=junit.xml", "--alluredir=allure", "--dura-export=cyclonedx"]
    result = project.run("corridor/it", "-v", *outputs)
    words = "violated, without effect of the fault, in 3 of 3 invalid episodes"
    folder = project.path / "dura-evidence"
    terminal = " ".join(result.stdout.str().split())
    assert words in terminal
    counts = "R-1: 0 of 0 runs violate it, 3 violated without effect of the fault, 3 invalid"
    assert counts in terminal
    assert re.search(r"corridor/it +0 \(2\) .*\+3\*", result.stdout.str())
    report = (folder / "report.html").read_text()
    assert words in report
    assert "3 of 3 valid" not in report
    assert re.search(r"0/0\s*<small><abbr[^>]*>\+3\*", report)
    summary = (folder / "summary.md").read_text()
    assert "0 of 0, 3\\*" in summary or "0 of 0, 3*" in summary
    gsn = (folder / "assurance-case.gsn.yaml").read_text()
    assert "3 of 3 invalid episodes violate R-1" in " ".join(gsn.split())
    cyclonedx = (folder / "cyclonedx.json").read_text()
    assert "3 violated without effect of the fault" in cyclonedx
    xml = ET.parse(project.path / "junit.xml")
    properties = {one.get("name"): one.get("value") for one in xml.iter("property")}
    assert (properties["valid"], properties["violations"]) == ("0", "0")
    assert (properties["without_effect"], properties["invalid"]) == ("3", "3")
    results = [json.loads(file.read_text()) for file in project.path.glob("allure/*result.json")]
    assert any(words in json.dumps(one) for one in results)
