"""Sessions whose episodes end once all is decided say so, and come to the same verdicts."""

from __future__ import annotations

from corridors import requirement, scenario

from pytest_dura.evidence import verify_bundle

OPTION = "--dura-end=decided"
SOON = "always[0:1.5] (x < 5)"
EARLY = "1 episode ended early, once all was decided"


def bounded(project, check=SOON, **given):
    requirement(project, check)
    given = {"duration": 6.0, "runs": 1, "requirements": "[R-1]"} | given
    scenario(project, **given)


def ends(project):
    return [(one.termination, one.timings.simulated_seconds) for one in project.evidence().episodes]


def test_episodes_end_once_all_is_decided_and_everything_says_so(project):
    bounded(project, runs=2)
    result = project.run("corridor/it", OPTION, "--dura-evidence-level=all")
    result.assert_outcomes(passed=1)
    assert ends(project) == [("decided", 1.5)] * 2
    record = project.evidence()
    assert record.cases[0].metrics.ended_early == 2
    assert record.episodes[0].spec.termination.decided is True
    assert "2 episodes ended early, once all was decided" in result.stdout.str()
    told = "2 of 2 episodes ended early, once every requirement of their case was decided"
    for file in ("report.html", "summary.md"):
        assert told in (project.path / "dura-evidence" / file).read_text()
    assert verify_bundle(project.path / "dura-evidence").problems == []
    assert project.run("--dura-replay=corridor/it#1").ret == 0


def test_without_the_option_no_word_of_it_is_said(project):
    bounded(project)
    result = project.run("corridor/it")
    assert ends(project) == [("time", 6.0)]
    record = project.evidence()
    assert record.cases[0].metrics.ended_early == 0
    assert record.episodes[0].spec.termination.decided is False
    assert "ended early" not in result.stdout.str()
    assert "ended early" not in (project.path / "dura-evidence/summary.md").read_text()


def test_a_scenario_may_ask_for_it_and_the_option_overrules(project):
    bounded(project, requirements="[R-1]\nend_when_decided: true")
    project.run("corridor/it")
    assert ends(project) == [("decided", 1.5)]
    project.run("corridor/it", "--dura-end=complete")
    assert ends(project) == [("time", 6.0)]


def test_verdicts_are_those_of_whole_episodes(project):
    checks = [
        SOON,
        "always (x < 2)",
        "eventually (x > 1.05)",
        "always[0:0] (x > 1)",
        "always (x < 50)",
    ]
    for number, check in enumerate(checks):
        requirement(project, check, name=f"R-{number}")
        for generator in ("Careful", "Reckless"):
            scenario(
                project,
                f"{generator.lower()}{number}",
                generator=generator,
                duration=4.0,
                runs=1,
                world="{wall: 90.0}",
                requirements=f"[R-{number}]",
            )
    select = [f"--dura-select=corridor/{name}*" for name in ("careful", "reckless")]
    found = []
    for option in ("--dura-end=complete", OPTION):
        project.run("--dura-scenarios", *select, option)
        kept = ("verdict", "episodes", "violations", "invalid", "vacuous", "bound")
        verdicts = project.evidence().verdicts
        times = [[x.time for x in one.counterexamples] for one in verdicts]
        found.append(([{key: getattr(one, key) for key in kept} for one in verdicts], times))
        early = [one for one in ends(project) if one[0] == "decided"]
    assert found[0] == found[1]
    assert 3 <= len(early) < len(verdicts) == 10


def test_the_printed_command_ends_episodes_alike(project):
    bounded(project, "always (x < 2)", generator="Reckless")
    result = project.run("corridor/it", OPTION)
    result.assert_outcomes(failed=1)
    assert f"rerun:    pytest corridor/it::R-1 {OPTION}" in result.stdout.str()
    assert EARLY in result.stdout.str()


def test_a_test_that_saw_an_episode_end_early_does_not_pass(project):
    bounded(project)
    project.write(
        "test_it.py",
        "import pytest\n"
        "here = pytest.mark.dura(scenario='corridor/it', runs=1, verdict=False)\n"
        "@here\n"
        "def test_a(episode): assert episode.signals['x'].max() < 100\n"
        "@here\n"
        "def test_b(campaign): assert all(one.signals['x'].max() < 100 for one in campaign)\n"
        "def test_c(orchestrator): assert not orchestrator.run('corridor/it').collided\n",
    )
    result = project.run("test_it.py", OPTION)
    result.assert_outcomes(failed=3)
    told = "invalid: corridor/it#0 ended at 1.5 s, once its requirements were decided"
    assert result.stdout.str().count(told) >= 3
    project.run("test_it.py").assert_outcomes(passed=3)
    project.run("test_it.py", OPTION, "--dura-undecided=warn").assert_outcomes(failed=3)


def test_what_an_episode_violates_fails_its_test_however_it_ended(project):
    requirement(project, "always[0:1.5] (x < 1)")
    scenario(project, duration=6.0, runs=1, requirements="[R-1]")
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/it', runs=1)\n"
        "@pytest.mark.requirement('R-1')\n"
        "def test_it(episode): assert episode.spec\n",
    )
    result = project.run("test_it.py", OPTION, "--dura-undecided=warn")
    assert [termination for termination, _ in ends(project)] == ["decided"]
    result.assert_outcomes(failed=1)
    assert "violated: R-1 on corridor/it#0" in result.stdout.str()


def test_a_test_that_asks_for_a_verdict_gets_that_of_the_whole(project):
    bounded(project)
    project.write("measures.py", "def way(episode):\n    return episode.signals['x'].max()\n")
    project.write(
        "test_it.py",
        "import pytest\n"
        "here = pytest.mark.dura(scenario='corridor/it', runs=1)\n"
        "@here\n"
        f"def test_a(campaign): campaign.require('{SOON}')\n"
        "@here\n"
        "def test_b(campaign): campaign.require('always (x < 100)')\n"
        "@here\n"
        "def test_c(campaign):\n"
        "    pairs = campaign.paired(without='safety_monitor')\n"
        "    pairs.require(measure='measures:way', change_at_most=1.0)\n",
    )
    project.run("test_it.py").assert_outcomes(passed=3)
    result = project.run("test_it.py", OPTION)
    result.assert_outcomes(passed=1, failed=2)
    text = result.stdout.str()
    assert "which does not decide `always (x < 100)`" in text
    assert "ended before its time, once all was decided, in corridor/it" in text


def test_pairs_are_compared_whole(project):
    requirement(project, SOON, name="P-1", paired="{without: safety_monitor}")
    bounded(project, requirements="[R-1, P-1]")
    project.run("corridor/it", OPTION)
    assert {termination for termination, _ in ends(project)} == {"time"}


def test_the_option_swallows_no_path(project):
    bounded(project)
    project.write("test_it.py", "def test_it(): pass\n")
    result = project.run("--dura-end", "test_it.py")
    assert result.ret == 4
    assert "invalid choice: 'test_it.py'" in result.stderr.str()
