"""Undecided fails the gate; an option excuses valid runs that are merely too few."""

from __future__ import annotations

import pytest
from corridors import IDLE, expect, requirement, scenario

from pytest_dura.__main__ import main

KINDS = {
    "vacuous": ("always (gap < 0 -> x > 1)", {}, {}, "(vacuous)"),
    "invalid share": (
        "always (gap > 0)",
        {"faults": IDLE, "fault_injector": "Idle"},
        {},
        "3 of 3 episodes are invalid, more than 20%",
    ),
    "a window past the end": (
        "always ((x > 0.25) implies eventually[0:0.3] (x >= 9))",
        {},
        {},
        "episodes are invalid",
    ),
    "missing": ("always (gap > 0)", {"world": "{breaks_at: 2}"}, {}, "2 of 2 episodes are missing"),
    "too few runs": ("always (gap > 0)", {}, {"at_most": 0.1}, "does not support 0.1"),
    "budget used up": (
        "always (gap > 0)",
        {"runs": "{until: decided, at_most: 8}"},
        {"at_most": 0.1},
        "e-process at 0.95 confidence has not decided on at most 0.1 within 8 runs",
    ),
}


TOO_FEW = {"too few runs", "budget used up"}


def of_each_kind(project, *, always="", **given):
    """Write a case and a requirement for each kind, and return where they are."""
    cases = {}
    for number, kind in enumerate(KINDS):
        check, situation, rate, _ = KINDS[kind]
        requirement(project, always or check, f"R-{number}", **rate)
        own = {"requirements": f"[R-{number}]"} | given | situation
        if always and kind == "missing":
            own["world"] = "{wall: 1.0, breaks_at: 4}"
        scenario(project, f"kind-{number}", **own)
        cases[kind] = {"requirement": f"R-{number}", "case": f"corridor/kind-{number}"}
    return cases


def test_undecided_fails_the_gate_and_is_relaxed_to_a_skip_where_runs_are_too_few(project):
    cases = of_each_kind(project)
    result = project.scenarios("-v", select="corridor/kind-*")
    result.assert_outcomes(failed=len(KINDS))
    first = result.stdout.str().partition("= dura =")[0]
    for kind, place in cases.items():
        expect(project, result, "undecided", KINDS[kind][-1], **place)
        assert f"undecided: {place['requirement']} on {place['case']}" in first

    relaxed = project.scenarios("--dura-undecided=warn", "-rs", "-v", select="corridor/kind-*")
    relaxed.assert_outcomes(skipped=len(TOO_FEW), failed=len(KINDS) - len(TOO_FEW))
    for kind, place in cases.items():
        found = expect(project, relaxed, "undecided", KINDS[kind][-1], ret=1, **place)
        assert found.too_few == (kind in TOO_FEW)
    assert project.evidence().gate.result == "failed"
    assert main(["verify", str(project.path / "dura-evidence")]) == 0

    few = [cases[kind]["case"] for kind in TOO_FEW]
    assert project.run(*few, "--dura-undecided=warn").ret == 0
    assert project.evidence().gate.result == "passed"
    assert main(["verify", str(project.path / "dura-evidence")]) == 0


CAMPAIGN_TEST = """
import pytest

@pytest.mark.dura(scenario="corridor/it", runs=3)
@pytest.mark.requirement("OWN-1", text="As it should be.")
def test_it(campaign):
    campaign.require({check}{rate})
"""


def test_a_campaign_test_on_too_few_runs_is_relaxed_to_a_skip(project):
    scenario(project)
    vacuous = CAMPAIGN_TEST.format(check="'always (gap < 0 -> x > 1)'", rate="")
    few = CAMPAIGN_TEST.format(check="'always (gap > 0)'", rate=", at_most=0.1")
    project.write("test_it.py", vacuous + few.replace("OWN-1", "OWN-2").replace("_it", "_few"))
    result = project.run("test_it.py", "--dura-undecided=warn")
    result.assert_outcomes(skipped=1, failed=1)
    expect(project, result, "undecided", "(vacuous)", requirement="OWN-1", ret=1)
    project.run("test_it.py").assert_outcomes(failed=2)
    result = project.run("test_it.py", "-k", "few", "--dura-undecided=warn")
    result.assert_outcomes(skipped=1, deselected=1)
    expect(project, result, "undecided", "does not support 0.1", requirement="OWN-2", ret=0)


def test_a_partial_run_is_relaxed_but_recorded(project):
    scenario(project)
    body = CAMPAIGN_TEST.replace("(campaign)", "(episode)")
    body = body.replace("campaign.require(", "assert episode.ticks > 0, (")
    project.write("test_it.py", body.format(check="", rate=""))
    result = project.run("test_it.py", "-k", "it and 0", "--dura-undecided=warn")
    result.assert_outcomes(passed=1, deselected=2)
    reason = "only 1 of 3 planned episodes were run"
    expect(project, result, "undecided", reason, requirement="OWN-1", ret=0)


def test_a_violation_is_never_relaxed(project):
    always = "always (gap > 0) and always[0:0.5] (gap > 0)"
    cases = of_each_kind(project, always=always, world="{wall: 1.0}", generator="Reckless")
    result = project.scenarios("--dura-undecided=warn", "-v", select="corridor/kind-*")
    result.assert_outcomes(failed=len(KINDS))
    for kind, place in cases.items():
        if kind == "invalid share":  # violated, without effect of the fault
            found = expect(project, result, "violated", "without effect of the fault", **place)
            assert found.without_effect == found.run > 0
        else:
            found = expect(project, result, "violated", **place)
            assert found.violations == found.run > 0


def looks(project):
    return [(look.base_seed, look.planned) for look in project.evidence().looks or ()]


NAMED = "R-1 on corridor/it was looked at before"


def test_a_new_plan_on_a_fresh_seed_is_a_further_look_and_names_the_earlier_ones(project):
    requirement(project, "always (gap > 0)", at_most=0.1)
    scenario(project, requirements="[R-1]", runs=3)
    assert NAMED not in project.run("corridor/it").stdout.str()
    assert project.evidence().looks is None
    assert NAMED not in project.run("corridor/it").stdout.str()  # the same episodes again
    second = project.run("corridor/it", "--dura-seed=1")
    third = project.run("corridor/it", "--dura-seed=2", "--dura-runs=40")
    assert third.ret == 0
    assert looks(project) == [(0, 3), (1, 3)]
    bundle = project.path / "dura-evidence"
    assert main(["verify", str(bundle)]) == 0
    assert "in 1 earlier plan (0 of 3 violated at base seed 0)" in flat(second.stdout.str())
    text = f"{NAMED}, in 2 earlier plans (0 of 3 violated at base seed 0; 0 of 3 violated at base"
    for found in (third.stdout.str(), (bundle / "summary.md").read_text()):
        assert text in flat(found)


def test_looks_outlast_a_session_that_tells_of_no_component(project):
    requirement(project, "always (gap > 0)", at_most=0.1)
    scenario(project, requirements="[R-1]", runs=3)
    project.run("corridor/it")
    project.write("test_broken.py", "import nowhere\n")
    project.run("--dura-scenarios", "test_broken.py")
    result = project.run("corridor/it", "--dura-seed=1")
    assert looks(project) == [(0, 3)]
    assert NAMED in flat(result.stdout.str())


def test_looks_at_another_check_are_not_looks_at_this_one(project):
    requirement(project, "always (gap > 5)", at_most=0.1)
    scenario(project, requirements="[R-1]", runs=3)
    project.run("corridor/it")
    requirement(project, "always (gap > 0)", at_most=0.1)
    assert NAMED not in flat(project.run("corridor/it", "--dura-seed=1").stdout.str())


def test_looks_at_another_component_are_not_looks_at_this_one(project):
    requirement(project, "always (gap > 0)", at_most=0.1)
    scenario(project, requirements="[R-1]", runs=3, generator="planners:Own")
    project.write("planners.py", "from corridor import Careful\n\nclass Own(Careful):\n    pass\n")
    project.scenarios(select="corridor/it")
    project.write(
        "planners.py", "from corridor import Careful\n\nclass Own(Careful):\n    speed = 2\n"
    )
    result = project.scenarios("--dura-seed=1", select="corridor/it")
    assert looks(project) == [(0, 3)]
    assert NAMED not in result.stdout.str()


def test_a_baseline_of_the_same_component_is_an_earlier_look(project):
    requirement(project, "always (gap > 0)", at_most=0.1)
    scenario(project, requirements="[R-1]", runs=3)
    project.run("corridor/it", "--dura-evidence=first")
    project.run("corridor/it", "--dura-evidence=first", "--dura-seed=1")
    result = project.run("corridor/it", "--dura-seed=2", "--dura-baseline=first")
    assert looks(project) == [(0, 3), (1, 3)]
    assert NAMED in flat(result.stdout.str())


@pytest.mark.parametrize("content", ["[]", "{", '{"looks": 3}', '{"component_under_test": 1}'])
def test_evidence_that_cannot_be_read_has_no_looks(project, content):
    scenario(project)
    (project.path / "dura-evidence").mkdir()
    project.write("dura-evidence/evidence.json", content)
    result = project.run("corridor/it", "--dura-evidence=dura-evidence")
    assert "Traceback" not in result.stdout.str() + result.stderr.str()


def flat(text):
    return " ".join(text.split())
