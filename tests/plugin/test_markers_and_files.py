"""What a marker names is decided as its requirement file says, or the test does not pass."""

from __future__ import annotations

import pytest
from corridors import expect, requirement, scenario
from outputs import shown_of

PUSHED = {"generator": "Reckless", "world": "{wall: 1.0}"}
PAIRED = "{without: recovery_planner}"


def write_test(project, body, *marks, look="campaign", name="it", runs=3):
    lines = [f"@pytest.mark.{mark}" for mark in marks]
    project.write(
        f"test_{name}.py",
        "import pytest\n"
        f"@pytest.mark.dura(scenario='corridor/it', runs={runs})\n"
        + "\n".join(lines)
        + f"\ndef test_{name}({look}):\n    {body}\n",
    )


OTHERWISE = [
    ({}, "require('always (gap > -100)')", "check"),
    ({}, "require(lambda one: True)", "check"),
    ({}, "require('always (gap > 0)', at_most=0.99)", "at_most"),
    ({}, "require(at_most=0.99)", "at_most"),
    ({}, "require(confidence=0.6)", "confidence"),
    ({"at_most": 0.4}, "require('always (gap > 0)', at_most=0.9)", "at_most"),
    ({"at_most": 0.4, "method": "e-process"}, "require(method='fixed')", "method"),
    ({"at_most": 0.4, "method": "sprt", "p0": 0.1}, "require(p0=0.3)", "p0"),
    ({}, "paired(without='safety_monitor').require('always (gap > 0)')", "paired"),
    ({"paired": PAIRED}, "paired(without='safety_monitor').require()", "paired"),
    ({"check": "", "at_most": 0.4}, "require('always (gap > 0)', at_most=0.9)", "at_most"),
    ({"check": ""}, "require('always (gap > 0)', at_most=0.9)", "at_most"),
]
"""What a file says of a requirement beside its check, what its test calls, and the key refused."""


def write_calls(project, *pairs):
    """A test for each requirement of a file and the call that it makes, by their numbers."""
    for n, (keys, call) in enumerate(pairs):
        requirement(project, **{"check": "always (gap > 0)"} | keys, name=f"R-{n}")
        write_test(project, f"import checks; campaign.{call}", f"requirement('R-{n}')", name=n)
    return [f"test_{n}.py" for n in range(len(pairs))]


def test_a_requirement_of_a_file_cannot_be_decided_otherwise(project):
    scenario(project, recovery_planner="Brake", **PUSHED)
    files = write_calls(project, *((keys, call) for keys, call, _ in OTHERWISE))
    result = project.run(*files)
    result.assert_outcomes(failed=len(OTHERWISE))
    assert result.ret == 1
    told = "is defined in a file, and is decided as it says there"
    for n, (*_, key) in enumerate(OTHERWISE):
        found = project.verdict(f"R-{n}")
        assert (found.verdict, found.run) == ("undecided", 0)
        text = str(shown_of(result)[f"test_{n}"])
        assert f"the requirement 'R-{n}' {told}" in text
        assert f"key:      {key}" in text
        assert "pytest_dura/" not in text


REPEATED = [
    ({}, "require('always  (gap > 0)')"),
    ({"at_most": 0.7}, "require('always (gap > 0)')"),
    ({"at_most": 0.7}, "require('always (gap > 0)', at_most=0.7, confidence=0.95)"),
    ({"check": "checks:touches_nothing"}, "require(checks.touches_nothing)"),
    ({"check": "", "at_most": 0.7}, "require('always (gap > 0)')"),
    ({"paired": PAIRED}, "require('always (gap > 0)')"),
    ({"paired": PAIRED}, "paired(without='recovery_planner').require()"),
    ({"check": ""}, "paired(without='recovery_planner').require('always (gap > 0)')"),
]


def test_what_its_file_says_may_be_repeated(project):
    scenario(project, recovery_planner="Brake")
    result = project.run(*write_calls(project, *REPEATED))
    result.assert_outcomes(passed=len(REPEATED))
    for n, (keys, call) in enumerate(REPEATED):
        found = project.verdict(f"R-{n}")
        assert found.verdict == "supported"
        assert found.bound.at_most == keys.get("at_most")
        assert (found.pairs is not None) is ("paired" in keys or "paired" in call)


def test_a_rate_of_a_file_is_decided_on_all_runs_and_fails_none_of_them(project):
    requirement(project, "always (gap > 0)", at_most=0.9)
    walls = "{world.wall: {choice: [1.0, 20.0]}}"
    scenario(project, variation=walls, **PUSHED)
    write_test(project, "assert episode.ticks", "requirement('R-1')", look="episode", runs=8)
    result = project.run("test_it.py")
    result.assert_outcomes(passed=8)
    found = expect(project, result, "supported")
    assert 0 < found.violations < found.episodes == 8


@pytest.mark.parametrize("value", ["numpy.float32(0.75)", "fractions.Fraction(3, 4)"])
def test_a_rate_may_be_a_number_of_any_kind(project, value):
    scenario(project)
    body = f"import numpy, fractions; campaign.require('always (gap > 0)', at_most={value})"
    write_test(project, body, "requirement('R-1', text='Rarely.')")
    found = expect(project, project.run("test_it.py"), "supported")
    assert found.bound.at_most == 0.75


@pytest.mark.parametrize(
    "call, key",
    [
        ("require('always (gap > 0)', at_most='few')", "at_most"),
        ("require('always (gap > 0)', confidence=float('nan'))", "confidence"),
        (
            "paired('safety_monitor').require(measure='checks:farthest', change_at_most=1e999)",
            "change_at_most",
        ),
    ],
)
def test_what_is_no_finite_number_is_told(project, call, key):
    scenario(project)
    write_test(project, f"campaign.{call}")
    result = project.run("test_it.py")
    result.assert_outcomes(failed=1)
    assert f"{key} is a finite number" in result.stdout.str()
    assert "pytest_dura/" not in result.stdout.str()


@pytest.mark.parametrize(
    "marks, look, message",
    [
        (
            ["requirement('GAP-1', text='It may touch something.')"],
            "campaign",
            "the marker gives the requirement 'GAP-1' another meaning than a requirement file",
        ),
        (
            ["requirement('GAP-1', kind='performance')"],
            "episode",
            "the marker gives the requirement 'GAP-1' another meaning than a requirement file",
        ),
        (
            ["requirement('GAP-1')", "requirement('GO-1')"],
            "campaign",
            "a test on a campaign decides one requirement, and its markers name several",
        ),
        (
            ["requirement('R-1')"],
            "episode",
            "the requirement 'R-1' is about pairs of runs, and the test looks at one",
        ),
    ],
)
def test_a_marker_that_cannot_be_decided_is_one_error(project, marks, look, message):
    requirement(project, "always (gap > 0)", paired=PAIRED)
    scenario(project)
    write_test(project, "pass", *marks, look=look)
    result = project.run("test_it.py")
    result.assert_outcomes(errors=1)
    assert result.ret == 1
    result.stdout.fnmatch_lines([f"test_it.py:*: {message}"])


def test_two_markers_must_mean_the_same(project):
    scenario(project)
    for name, text in (("a", "Never."), ("b", "Rarely.")):
        body = "campaign.require('always (gap > 0)')"
        write_test(project, body, f"requirement('R-1', text='{text}')", name=name)
    result = project.run("test_a.py", "test_b.py")
    assert result.ret == 1
    assert result.parseoutcomes()["errors"] >= 1
    assert "gives the requirement 'R-1' another meaning than another marker" in result.stdout.str()


def test_what_is_wrong_with_a_file_is_told_at_its_place(project):
    requirement(project, "always (gap >")
    write_test(project, "pass")
    result = project.run("test_it.py")
    result.stdout.fnmatch_lines(["*scenarios/requirements_R-1.yaml:2: *"])


@pytest.mark.parametrize(
    "check, rate, passed, word",
    [
        ("always (gap > 0)", {}, 0, "violated"),
        ("checks:touches_nothing", {}, 0, "violated"),
        ("eventually[0:60] (x >= 900)", {}, 0, "undecided"),
        ("always (gap > 0)", {"at_most": 0.1}, 2, "violated"),
    ],
    ids=["formula", "function", "window past the end", "rate"],
)
def test_a_test_on_an_episode_passes_by_its_requirement_or_not_at_all(
    project, check, rate, passed, word
):
    requirement(project, check, **rate)
    scenario(project, **PUSHED)
    write_test(project, "pass", "requirement('R-1')", look="episode", runs=2)
    result = project.run("test_it.py")
    result.assert_outcomes(passed=passed, failed=2 - passed)
    expect(project, result, word)


def test_a_verdict_on_something_else_does_not_decide_a_requirement(project):
    scenario(project)
    body = "orchestrator.campaign('corridor/free').require('always (gap > -1)')"
    write_test(project, body, "requirement('GAP-1')", look="campaign, orchestrator")
    result = project.run("test_it.py")
    result.assert_outcomes(failed=1)
    expect(project, result, "undecided", requirement="GAP-1")
    assert "undecided: the test never asked for a verdict on GAP-1; " in result.stdout.str()


def test_each_question_of_a_test_has_a_verdict_of_its_own(project):
    scenario(project, recovery_planner="Brake")
    body = """campaign.require('always (gap > 0)')
    campaign.require('always (gap > 0)', at_most=0.7)
    for role in ('recovery_planner', 'safety_monitor'):
        campaign.paired(without=role).require('always (gap > 0)')"""
    write_test(project, body, "requirement('OWN-1', text='Keeps away.')")
    project.run("test_it.py").assert_outcomes(passed=1)
    found = project.evidence().verdicts
    assert [(one.bound.at_most, one.pairs and one.pairs.without) for one in found] == [
        (None, None),
        (0.7, None),
        (None, "recovery_planner"),
        (None, "safety_monitor"),
    ]


def test_a_message_that_begins_like_ours_is_a_violation_all_the_same(project):
    scenario(project)
    body = "assert episode.collided, 'invalid: no such thing'"
    write_test(project, body, "requirement('OWN-1', text='Hits.')", look="episode")
    result = project.run("test_it.py")
    expect(project, result, "violated", requirement="OWN-1")


def test_a_formula_that_cannot_be_judged_is_no_violation(project):
    scenario(project)
    body = "assert episode.robustness('always (gapp > 0)') > 0"
    write_test(project, body, "requirement('OWN-1', text='Keeps away.')", look="episode")
    result = project.run("test_it.py")
    result.assert_outcomes(failed=3)
    reason = "3 of 3 episodes are not judged, since the test failed"
    expect(project, result, "undecided", reason, requirement="OWN-1")


@pytest.mark.parametrize("look", ["orchestrator", "run_episode"])
def test_an_unknown_id_is_told_of_tests_that_choose_their_episodes_too(project, look):
    lines = ["import pytest", "@pytest.mark.requirement('GAPP-1')", f"def test_it({look}): pass"]
    project.write("test_it.py", "\n".join(lines))
    result = project.run("test_it.py")
    result.assert_outcomes(errors=1)
    assert "the requirement 'GAPP-1' has no text" in result.stdout.str()


def test_a_glob_that_matches_no_scenario_is_told(project):
    requirement(project, "always (gap >= 0)", applies_to="[corridor/tight, coridor/*]")
    result = project.run("corridor/tight")
    result.assert_outcomes(passed=2)
    told = "requirements_R-1.yaml:2: the requirement 'R-1' applies to 'coridor/*', which matches no"
    assert told in result.stdout.str()
    assert "'corridor/tight', which" not in result.stdout.str()


@pytest.mark.parametrize(
    "check, detail",
    [
        ("'always (x < 5)'", "which does not decide `always (x < 5)`"),
        ("lambda one: one.signals['x'].max() < 5", "ended at a violation of something else"),
    ],
    ids=["formula", "function"],
)
def test_an_episode_that_ended_at_a_violation_decides_nothing_else(project, check, detail):
    scenario(project, requirements="[GAP-1]\nend_at_violation: true", **PUSHED)
    write_test(project, f"campaign.require({check})", "requirement('OWN-1', text='Stays.')")
    found = expect(project, project.run("test_it.py"), "undecided", requirement="OWN-1")
    assert detail in found.first_uncounted.detail
    project.run("corridor/it").assert_outcomes(failed=1)
    assert project.verdict("GAP-1").verdict == "violated"


@pytest.mark.parametrize(
    "change",
    [
        "one.signals['gap'] = one.signals['gap'] + 100",
        "one.signals.update(gap=one.time + 100)",
        "one.signals['gap'] += 100",
        "one.signals = {}",
        "one.failure = 'infrastructure: none'",
    ],
)
def test_a_test_cannot_change_what_another_one_judges(project, change):
    scenario(project, **PUSHED)
    write_test(project, f"for one in campaign: {change}", name="a", runs=2)
    write_test(project, "campaign.require()", "requirement('GAP-1')", name="b", runs=2)
    result = project.run("test_a.py", "test_b.py")
    result.assert_outcomes(failed=2)
    expect(project, result, "violated", requirement="GAP-1")


def test_a_column_may_be_added_to_a_copy(project):
    scenario(project)
    body = "copy.deepcopy(episode.signals)['own'] = dict(episode.signals)['own'] = episode.time"
    write_test(project, f"import copy; {body}", look="episode")
    file = project.path / "test_it.py"
    file.write_text(file.read_text().replace("runs=3)", "runs=3, verdict=False)"))
    project.run("test_it.py").assert_outcomes(passed=3)


def test_a_marker_on_a_test_that_takes_no_fixtures_is_no_pass(project):
    project.write(
        "test_it.py",
        "import unittest, pytest\n"
        "class Test(unittest.TestCase):\n"
        "    @pytest.mark.dura(scenario='corridor/tight')\n"
        "    @pytest.mark.requirement('GAP-1')\n"
        "    def test_it(self): pass\n",
    )
    result = project.run("test_it.py")
    assert result.ret == 1
    assert "the marker dura runs nothing here" in result.stdout.str()
