from __future__ import annotations

import pytest
from outputs import shown_of

EXECUTOR = "auto"

EPISODE_TEST = """
import pytest

@pytest.mark.dura(scenario="corridor/*")
@pytest.mark.requirement("GAP-1")
def test_never_touches(episode):
    assert not episode.collided
    assert episode.robustness("always (gap > 0)") > 0
"""

CAMPAIGN_TEST = """
import pytest

@pytest.mark.dura(scenario="corridor/free", runs=30)
@pytest.mark.requirement("RATE-1", text="It rarely touches anything", kind="safety")
def test_rate(campaign):
    verdict = campaign.require("always (gap > 0)", at_most=0.1, confidence=0.95)
    assert len(campaign.episodes) == verdict.run == 30
"""


@pytest.mark.parametrize("mode", ["n0", "n2"], indirect=True)
def test_one_test_for_each_run(project, mode):
    project.write("test_it.py", EPISODE_TEST)
    result = project.run("test_it.py", "-v", *mode)
    result.assert_outcomes(passed=5)
    assert "test_it.py::test_never_touches[corridor/free#2]" in result.stdout.str()
    verdict = project.evidence().verdicts[0]
    assert (verdict.case, verdict.requirement) == ("corridor/free", "GAP-1")
    assert (verdict.verdict, verdict.planned, verdict.episodes) == ("supported", 3, 3)
    assert verdict.item == "test_it.py::test_never_touches"


def test_failures_count_and_name_their_replay(project):
    project.write("test_it.py", EPISODE_TEST)
    result = project.run("test_it.py", "--dura-generator=corridor:Reckless")
    result.assert_outcomes(failed=5)
    text = result.stdout.str()
    assert "corridor/tight#1, replay: pytest --dura-replay='corridor/tight#1' test_it.py" in text
    assert "violated: safety on corridor/free (Reckless) (1 of 2 causes)" in text
    verdict = project.evidence().verdicts[0]
    assert (verdict.verdict, verdict.violations) == ("violated", 3)
    assert verdict.counterexamples[0].time == pytest.approx(0.5)
    frames = [line for line in text.splitlines() if line.startswith("pytest_dura/")]
    assert frames == []


@pytest.mark.parametrize("mode", ["n2"], indirect=True)
def test_one_test_for_each_case(project, mode):
    project.write("test_it.py", CAMPAIGN_TEST)
    result = project.run("test_it.py", "-v", *mode)
    result.assert_outcomes(passed=1)
    assert "test_rate[corridor/free]" in result.stdout.str()
    evidence = project.evidence()
    assert len(evidence.episodes) == 30
    (verdict,) = evidence.verdicts
    assert verdict.requirement == "RATE-1"
    assert verdict.check == "always (gap > 0)"
    assert verdict.bound.at_most == 0.1
    assert {one.id: one.text for one in evidence.requirements}["RATE-1"] == (
        "It rarely touches anything"
    )


def test_too_few_runs_are_undecided(project):
    project.write("test_it.py", CAMPAIGN_TEST)
    result = project.run("test_it.py", "--dura-runs=10")
    result.assert_outcomes(failed=1)
    text = result.stdout.str()
    assert "undecided: RATE-1 on corridor/free (Careful): 0 of 10" in text
    assert "29" in text
    assert "pytest_dura/" not in text.partition("FAILURES")[2].partition("= dura =")[0]
    relaxed = project.run("test_it.py", "--dura-runs=10", "--dura-undecided=warn")
    relaxed.assert_outcomes(skipped=1)


def test_fault_campaigns_make_cases(project):
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='intersection/ghost-obstacle', "
        "faults=['none', 'ghost-obstacle', ['ghost-obstacle', 'trajectory-spoof']], runs=2)\n"
        "def test_it(episode): pass\n",
    )
    result = project.run("test_it.py", "--collect-only", "-q")
    assert [line for line in result.outlines if "::" in line] == [
        f"test_it.py::test_it[{case}#{run}]"
        for case in (
            "intersection/ghost-obstacle+none",
            "intersection/ghost-obstacle",
            "intersection/ghost-obstacle+ghost-obstacle+trajectory-spoof",
        )
        for run in (0, 1)
    ]


def test_by_hand(project):
    project.write(
        "test_it.py",
        "def test_it(orchestrator):\n"
        "    first = orchestrator.run('corridor/free', seed=7)\n"
        "    again = orchestrator.run('corridor/free', seed=7)\n"
        "    other = orchestrator.run('corridor/free', run=1)\n"
        "    assert first is again\n"
        "    assert first.spec.seed == 7 != other.spec.seed\n"
        "    assert other.id == 'corridor/free#1'\n",
    )
    result = project.run("test_it.py")
    result.assert_outcomes(passed=1)
    assert "1 episode with a seed chosen by hand" in result.stdout.str()
    evidence = project.evidence()
    assert [one.planned for one in evidence.episodes] == [False, True]
    assert evidence.cases[0].metrics.run == 1


def test_run_episode_suits_hypothesis(project):
    project.write(
        "test_it.py",
        "import pytest\n"
        "from hypothesis import given, settings, strategies as st\n"
        "@pytest.mark.dura(verdict=False)\n"
        "@settings(max_examples=5, deadline=None, database=None)\n"
        "@given(seed=st.integers(0, 1000))\n"
        "def test_it(run_episode, seed):\n"
        "    assert not run_episode('corridor/free', seed=seed).collided\n",
    )
    project.run("test_it.py").assert_outcomes(passed=1)
    assert len(project.evidence().episodes) > 1


def test_an_unknown_name_by_hand_shows_the_users_line_only(project):
    project.write(
        "test_it.py", "def test_it(orchestrator):\n    orchestrator.run('corridor/fre')\n"
    )
    result = project.run("test_it.py")
    result.assert_outcomes(failed=1)
    text = result.stdout.str()
    assert "no scenario matches 'corridor/fre'" in text
    assert "did you mean 'corridor/free'?" in text
    assert "runner.py" not in text
    assert "cases.py" not in text


WRONG = [
    (
        ["dura(scenario='corridor/fre')"],
        "episode",
        ["*test_it.py:*: no scenario matches 'corridor/fre'", "*did you mean 'corridor/free'?"],
    ),
    (
        ["dura(scenario='corridor/free', faults=['ghost'])"],
        "campaign",
        ["*test_it.py:*: unknown fault 'ghost'", "*ghost-obstacle*"],
    ),
    (
        ["dura(scenaro='corridor/free')"],
        "episode",
        ["*the marker dura cannot be used*", "*did you mean 'scenario'?"],
    ),
    (["dura(scenario=3)"], "episode", ["*wrong `scenario`", "*found:*3"]),
    (["dura(scenario='corridor/free', runs=0)"], "episode", ["*wrong `runs`", "*at least 1*"]),
    (["dura(scenario='corridor/free', faults=7)"], "episode", ["*wrong `faults`"]),
    (["dura(scenario='corridor/free', faults=[])"], "episode", ["*wrong `faults`"]),
    (["dura(scenario='corridor/free', faults=[None])"], "episode", ["*wrong `faults`"]),
    (
        ["dura(scenario='corridor/free')", "dura(scenario='corridor/tight')"],
        "episode",
        [
            "*several markers dura, of which one alone would count",
            "*name all scenarios in one*",
        ],
    ),
    (["dura(scenario='corridor/free')"], "orchestrator", ["*the marker dura runs nothing*"]),
    (
        ["dura(scenario='corridor/free')", "requirement(['GAP-1', 'GO-1'])"],
        "episode",
        ["*the id of a requirement is a text", "*one marker each"],
    ),
    (
        ["dura(scenario='corridor/free')", "requirement('SAF-99')"],
        "episode",
        [
            "*test_it.py:*: the requirement 'SAF-99' has no text",
            '*requirement("SAF-99", text=*',
        ],
    ),
    (
        ["dura(scenario='corridor/free')", "requirement('X', text='t', kind='safty')"],
        "episode",
        ["*no kind of requirement 'safty'", "*safety, security*"],
    ),
]
"""Markers, the arguments of the test that has them, and what is said of them."""


def test_a_marker_that_cannot_be_used_is_one_error(project):
    text = "import pytest\n"
    for n, (marks, arguments, _) in enumerate(WRONG):
        text += "".join(f"@pytest.mark.{mark}\n" for mark in marks)
        text += f"def test_{n}({arguments}): pass\n"
    project.write("test_it.py", text)
    result = project.run("test_it.py")
    assert result.ret == 1
    result.assert_outcomes(errors=len(WRONG))
    shown = shown_of(result)
    for n, (*_, lines) in enumerate(WRONG):
        shown[f"test_{n}"].fnmatch_lines(lines)
    assert "Traceback" not in result.stdout.str()


MARKED_PARAMETER = "pytest.param(0.5, marks=pytest.mark.dura(scenario='corridor/free', runs=1))"


@pytest.mark.parametrize("own", ["", "@pytest.mark.dura(scenario='corridor/free', runs=1)\n"])
@pytest.mark.parametrize("arguments", [[], ["--collect-only"]])
def test_a_marker_on_a_parameter_is_refused_at_collection(project, own, arguments):
    project.write(
        "test_it.py",
        "import pytest\n"
        f"@pytest.mark.parametrize('limit', [0.1, {MARKED_PARAMETER}])\n"
        f"{own}"
        "def test_it(episode, limit): assert episode.satisfies(f'always (gap >= {limit})')\n",
    )
    result = project.run("test_it.py", *arguments)
    assert result.ret == pytest.ExitCode.INTERRUPTED
    result.stdout.fnmatch_lines(
        [
            "test_it.py:2: a dura marker on a parameter of parametrize is not read",
            "  remedy: * name all scenarios there, dura(scenario=[*",
        ]
    )
    assert "add the marker" not in result.stdout.str()


def test_a_marker_on_a_parameter_that_a_conftest_gives_is_refused(project):
    own = "    if 'limit' in metafunc.fixturenames:\n"
    gives = f"        metafunc.parametrize('limit', [{MARKED_PARAMETER}])\n"
    project.write(
        "test_it.py",
        f"import pytest\ndef pytest_generate_tests(metafunc):\n{own}{gives}"
        "def test_it(episode, limit): assert not episode.collided\n",
    )
    result = project.run("test_it.py")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["test_it.py:5: a dura marker on a parameter of * is not read"])


def test_a_parameter_may_say_that_the_test_decides_nothing(project):
    project.write(
        "test_it.py",
        "import pytest\n"
        "nothing = pytest.param(7, marks=pytest.mark.dura(verdict=False))\n"
        "@pytest.mark.parametrize('seed', [nothing])\n"
        "def test_it(run_episode, seed): run_episode('corridor/free', seed=seed)\n",
    )
    project.run("test_it.py").assert_outcomes(passed=1)


def test_episode_without_a_marker(project):
    project.write("test_it.py", "def test_it(episode): pass\n")
    result = project.run("test_it.py")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["the fixture `episode` needs to know which scenario to run"])
    assert "fixtures.py" not in result.stdout.str()


def test_markers_are_registered(project):
    project.write("test_it.py", EPISODE_TEST)
    project.run("test_it.py", "--strict-markers").assert_outcomes(passed=5)


def test_a_fixture_named_episode_of_the_users_own_is_left_alone(project):
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.fixture\n"
        "def episode(): return 'S01E01'\n"
        "@pytest.fixture\n"
        "def generator(): return 7\n"
        "def test_it(episode, generator): assert episode == 'S01E01'\n",
    )
    project.run("test_it.py").assert_outcomes(passed=1)


def test_a_campaign_test_that_asks_for_no_verdict_does_not_pass(project):
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/free', runs=2)\n"
        "@pytest.mark.requirement('RATE-1', text='It rarely touches anything')\n"
        "def test_rate(campaign):\n"
        "    assert not any(one.collided for one in campaign.episodes)\n",
    )
    result = project.run("test_it.py")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*undecided: the test never asked for a verdict on RATE-1; *"])


def test_what_ends_before_it_decides_is_undecided_for_each_test_case_and_requirement(project):
    project.write(
        "test_it.py",
        """
import pytest

@pytest.fixture
def broken():
    raise OSError("no rig")

@pytest.mark.dura(scenario="corridor/*", runs=2)
@pytest.mark.requirement("GAP-1")
def test_one(broken, episode): pass

@pytest.mark.dura(scenario="corridor/free", runs=3)
@pytest.mark.requirement("RATE-1", text="It rarely touches anything", kind="safety")
def test_other(broken, campaign): pass

@pytest.mark.dura(scenario="corridor/free", runs=2)
@pytest.mark.requirement("GAP-1")
def test_decides(episode):
    assert episode.robustness("always (gap > 0)") > 0
""",
    )
    result = project.run("test_it.py")
    result.assert_outcomes(errors=5, passed=2)
    found = {
        (verdict.item.partition("::")[2], verdict.case, verdict.requirement, verdict.planned):
            verdict.verdict
        for verdict in project.evidence().verdicts
    }  # fmt: skip
    one, other = "test_one", "test_other[corridor/free]"
    assert found == {
        (one, "corridor/free", "GAP-1", 2): "undecided",
        (one, "corridor/tight", "GAP-1", 2): "undecided",
        (other, "corridor/free", "RATE-1", 3): "undecided",
        ("test_decides", "corridor/free", "GAP-1", 2): "supported",
    }
