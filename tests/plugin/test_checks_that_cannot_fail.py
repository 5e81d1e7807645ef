"""What would pass whatever the component does is refused, or named where the gate stands."""

from __future__ import annotations

import pytest
from corridors import requirement, scenario
from outputs import output, shown_of

from pytest_dura.core.codec import encode

REFUSED = "`gap > 0` is judged at the beginning of the episode alone"
CERTAIN = "the formula holds whatever the signals are"


def a_test(body, fixtures="episode", marks=(), **dura):
    given = {"scenario": "corridor/free", "runs": 2} | dura
    told = ", ".join(f"{key}={value!r}" for key, value in given.items())
    lines = [
        "import pytest",
        f"@pytest.mark.dura({told})",
        *(f"@pytest.mark.{one}" for one in marks),
    ]
    return "\n".join([*lines, f"def test_it({fixtures}):", *(f"    {one}" for one in body)]) + "\n"


def test_a_requirement_that_reads_one_sample_is_refused_at_its_line(project):
    requirement(project, "gap > 0")
    scenario(project, requirements="[R-1]")
    result = project.scenarios()
    assert result.ret == 4
    told = output(result)
    assert REFUSED in told
    assert "remedy:   write `always (gap > 0)`" in told
    assert "scenarios/requirements_R-1.yaml:2: `gap" in told
    assert "Traceback" not in told


def test_a_formula_that_holds_always_is_refused_at_its_line(project):
    requirement(project, "always (gap * 0 >= 0)")
    scenario(project, requirements="[R-1]")
    result = project.scenarios()
    assert result.ret == 4
    told = output(result)
    assert CERTAIN in told
    assert "scenarios/requirements_R-1.yaml:2: " in told
    assert "Traceback" not in told


REFUSALS = [
    ("campaign", "campaign.require('(gap > 0) and (always (x < 99))')", REFUSED),
    ("episode", "assert episode.robustness('gap > 0') > 0", REFUSED),
    ("episode", "assert episode.satisfies('gap > 0')", REFUSED),
    ("campaign", "campaign.require('always (gap >= gap)')", CERTAIN),
    ("episode", "assert episode.satisfies('always (gap >= gap)')", CERTAIN),
]


def test_a_formula_of_a_test_or_a_marker_that_cannot_fail_is_refused(project):
    texts = [a_test([body], fixture, runs=1) for fixture, body, _ in REFUSALS]
    texts.append(a_test(["pass"], "campaign", ["falsify('gap > 0')"]))
    for n, text in enumerate(texts):
        texts[n] = text.replace("test_it", f"test_{n}")
    project.write("test_it.py", "".join(texts))
    result = project.run("test_it.py")
    assert result.ret == 1
    result.assert_outcomes(failed=len(REFUSALS), errors=1)
    for n, refusal in enumerate([*(refusal for *_, refusal in REFUSALS), REFUSED]):
        assert refusal in str(shown_of(result)[f"test_{n}"])


def test_a_weak_requirement_is_named_where_its_verdict_stands(project):
    requirement(project, "always (gap > 0)", at_most=0.999)
    requirement(project, "always (gap > 0)", "R-2", at_most=0.2, confidence=0.5001)
    scenario(project, runs=8, requirements="[R-1, R-2]")
    result = project.scenarios(select="corridor/it")
    assert result.ret == 0
    argument = (project.path / "dura-evidence/assurance-case.gsn.yaml").read_text()
    for text in (output(result), *rendered(project), argument):
        for words in ("accepts violations in 99.9 % of runs", "asks for 50.01 % confidence"):
            assert words in " ".join(text.split())
    for name in ("R-1", "R-2"):
        requirement(project, "always (gap > 0)", name, at_most=0.49, confidence=0.8)
    project.scenarios(select="corridor/it")
    assert "weak: " not in (project.path / "dura-evidence/report.html").read_text()


def test_a_check_that_returns_a_number_of_things_decides_nothing(project):
    project.write(
        "counting.py", "def hits(episode):\n    return int((episode.signals['gap'] <= 0).sum())\n"
    )
    requirement(project, "counting:hits")
    scenario(project, requirements="[R-1]")
    result = project.scenarios("--dura-generator=corridor:Careful")
    assert result.ret == 1
    assert project.verdict("R-1").verdict == "undecided"
    assert "returned the int 0, not a truth value" in output(result)
    assert "compare it, as in `count == 0`" in output(result)


OWN = "requirement('OWN-1', text='It stays near.')"


def rendered(project):
    return [
        (project.path / "dura-evidence" / name).read_text()
        for name in ("summary.md", "report.html")
    ]


@pytest.mark.parametrize("mode", ["n2"], indirect=True)
def test_a_verdict_by_assertion_says_so_and_what_the_test_looked_at(project, mode):
    body = ["assert episode.signals['gap'].min() > 0", "assert not episode.collided"]
    project.write("test_it.py", a_test(body, marks=[OWN]))
    result = project.run("test_it.py", *mode)
    assert result.ret == 0
    found = project.verdict("OWN-1", "corridor/free")
    assert (found.verdict, found.check) == ("supported", "")
    assert encode(found.assertion) == {
        "alone": True, "by_check": 0, "observed": ["collided", "signals.gap"], "false": [],
        "failed": [],
    }  # fmt: skip
    told = "by assertion: the test looked at collided, signals.gap"
    brief = "1 verdict by assertions of tests alone (OWN-1): -v says what the tests looked at"
    assert brief in " ".join(output(result).split())
    assert told in output(project.run("test_it.py", "-v", *mode))
    assert "1 of 1 verdicts is supported by assertions of tests alone" in rendered(project)[0]
    assert told in rendered(project)[1]


def test_a_verdict_by_the_own_check_of_a_requirement_says_nothing_of_assertions(project):
    project.write("test_it.py", a_test(["pass"], marks=["requirement('GAP-1')"]))
    result = project.run("test_it.py")
    assert result.ret == 0
    found = project.verdict("GAP-1", "corridor/free").assertion
    assert (found.alone, found.observed) == (False, ())
    assert "by assertion" not in output(result)


def test_a_test_that_looks_at_nothing_supports_nothing(project):
    bodies = ("pass", "assert episode.id[0] == 'c' and episode.spec.run < 9", "print(episode)")
    text = ""
    for n, body in enumerate(bodies):
        own = OWN.replace("OWN-1", f"OWN-{n}")
        text += a_test([body], marks=[own]).replace("test_it", f"test_{n}")
    project.write("test_it.py", text)
    result = project.run("test_it.py")
    assert result.ret == 1
    for n in range(len(bodies)):
        assert project.verdict(f"OWN-{n}", "corridor/free").verdict == "undecided"
        told = str(shown_of(result)[f"test_{n}"])
        assert "invalid: the test looked at nothing of corridor/free#" in told
    relaxed = project.run("test_it.py", "--dura-undecided=warn")
    relaxed.assert_outcomes(failed=2 * len(bodies))


def test_a_formula_that_is_false_in_a_passing_test_is_shown(project):
    body = [
        "episode.satisfies('always (gap > 50)')",
        "assert episode.robustness('always (gap > 0)') > 0",
        "assert episode.robustness('eventually (x > 99)') < 0",
    ]
    project.write("test_it.py", a_test(body, marks=[OWN]))
    result = project.run("test_it.py")
    assert result.ret == 0
    found = project.verdict("OWN-1", "corridor/free").assertion
    assert encode(found.false) == [
        {"check": "always (gap > 50)", "episodes": 2},
        {"check": "eventually (x > 99)", "episodes": 2},
    ]
    told = "false in 2 episodes with which the test passed: always (gap > 50)"
    assert told in output(result)
    assert told.replace(">", "&gt;") in rendered(project)[1]


FAILS = ["x = episode.signals['x'].max()", "assert x < 0.5, 'too far'"]


def test_what_failed_is_shown_and_not_a_check_that_held(project):
    project.write("test_it.py", a_test(FAILS, marks=["requirement('GAP-1')"]))
    result = project.run("test_it.py", "--junitxml=junit.xml", "-n2")
    told = output(result).partition("violated: safety on corridor/free")[2].splitlines()
    card = " ".join(" ".join(told).partition("  replay:")[0].split())
    assert "GAP-1: 2 of 2 runs violate it; failed: too far; assert " in card
    assert "< 0.5 (test_it.py:6), in corridor/free#0" in card
    assert "[always (gap > 0)]" not in card
    found = project.verdict("GAP-1", "corridor/free")
    assert found.assertion.by_check == 0
    assert [one.episode[-2:] for one in found.assertion.failed] == ["#0", "#1"]
    assert "(test_it.py:6)" in found.assertion.failed[0].message
    for page in rendered(project):
        assert "failed: too far; assert" in page
    assert "0.5 (test_it.py:6)" in (project.path / "junit.xml").read_text()


def test_a_check_that_is_violated_is_shown_beside_a_failed_assertion(project):
    project.write("test_it.py", a_test(FAILS, marks=["requirement('GAP-1')"]))
    result = project.run("test_it.py", "--dura-generator=corridor:Reckless")
    told = output(result).partition("violated: safety on corridor/free")[2]
    card = " ".join(told.partition("  replay:")[0].split())
    assert "too far; assert " in card
    assert "[always (gap > 0)]" in card
    assert project.verdict("GAP-1", "corridor/free").assertion.by_check == 2


CRASH = """
from corridor import Corridor
from pytest_dura import Tick
class Crash(Corridor):
    def _tick(self):
        tick = super()._tick()
        hit = "ran into VICTIM" if tick.truth["gap"] <= 0 else None
        return Tick(tick.index, tick.time, tick.truth, tick.channels, critical=hit)
"""


def test_junit_and_allure_carry_what_ended_the_episode(project):
    project.write("crash.py", CRASH)
    scenario(project, simulator="crash:Crash", requirements="[GAP-1]", generator="Reckless")
    result = project.scenarios("--junitxml=junit.xml", "--alluredir=allure", select="corridor/it")
    assert "  At t = 0.50 s ran into VICTIM." in output(result)
    assert "At t = 0.50 s ran into VICTIM" in output(result)
    junit = (project.path / "junit.xml").read_text()
    assert '<property name="card_headline" value="At t = 0.50 s ran into VICTIM.' in junit
    (found,) = (project.path / "allure").glob("*-result.json")
    assert "At t = 0.50 s ran into VICTIM" in found.read_text().replace("\\\\", "")


NOTHING = "undecided: the test ended without a verdict"


WITHOUT = [
    ("episode", "assert not episode.collided", "name what it decides"),
    ("campaign", "assert len(campaign.episodes) == 2", "call campaign.require(check)"),
    ("run_episode", "run_episode('corridor/free')", "say that it decides nothing"),
]


def test_a_test_without_a_verdict_fails_unless_it_says_that_it_decides_nothing(project):
    text = said = ""
    for fixture, body, _ in WITHOUT:
        marked = fixture != "run_episode"
        one = a_test([body], fixture).replace("test_it", f"test_{fixture}")
        text += one if marked else one.replace("@pytest.mark.dura", "# ")
        quiet = {"verdict": False} if marked else {"verdict": False, "scenario": None, "runs": None}
        one = a_test([body], fixture, **quiet).replace("scenario=None, runs=None, ", "")
        said += one.replace("test_it", f"test_{fixture}")
    project.write("test_it.py", text)
    result = project.run("test_it.py")
    assert result.ret == 1
    shown = shown_of(result)
    for fixture, _, remedy in WITHOUT:
        assert f"{NOTHING}; " in str(shown[f"test_{fixture}"])
        assert remedy in str(shown[f"test_{fixture}"])
    project.write("test_it.py", said)
    assert project.run("test_it.py").ret == 0


def test_a_test_by_hand_and_fixtures_of_other_people_need_no_verdict(project):
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.fixture\n"
        "def campaign(orchestrator): return orchestrator.run('corridor/free')\n"
        "def test_own(campaign): assert not campaign.collided\n"
        "def test_by_hand(orchestrator, generator): orchestrator.run('corridor/free')\n",
    )
    assert project.run("test_it.py").ret == 0


def test_a_test_that_skips_itself_came_to_no_verdict(project):
    ways = [a_test([f"pytest.{way}('no')"]).replace("_it", f"_{way}") for way in ("skip", "xfail")]
    project.write("test_it.py", "".join(ways))
    result = project.run("test_it.py")
    assert result.ret == 1
    for way in ("skip", "xfail"):
        told = f"test_it.py::test_{way}[corridor/free#0] ended without a verdict"
        assert told in output(result)
    assert project.run("test_it.py", "--dura-undecided=warn").ret == 1


def test_a_marker_that_says_two_things_is_refused(project):
    project.write("test_it.py", a_test(["pass"], marks=[OWN], verdict=False))
    result = project.run("test_it.py")
    assert result.ret == 1
    result.assert_outcomes(errors=1)
    assert "names a requirement, and says that it decides nothing" in output(result)


def test_a_misspelt_marker_is_named(project):
    misspelt = OWN.replace("requirement", "requirment")
    project.write("test_it.py", a_test(["assert not episode.collided"], marks=[misspelt]))
    result = project.run("test_it.py", "-W", "default")
    assert result.ret == 1
    result.assert_outcomes(errors=1)
    assert "there is no marker 'requirment'" in output(result)
    assert "did you mean 'requirement'?" in output(result)
    project.write("pytest.ini", "[pytest]\nmarkers = requirment: another thing\n")
    assert "there is no marker" not in output(project.run("test_it.py", "-W", "default"))


def test_markers_of_tests_that_are_not_ours_are_left_alone(project):
    project.write(
        "test_it.py",
        "import pytest\n@pytest.mark.filterwarnings('ignore')\n"
        "@pytest.mark.requirements('X')\ndef test_it(): pass\n",
    )
    assert project.run("test_it.py", "-W", "ignore").ret == 0


TWO = a_test(["assert not episode.collided"], marks=[OWN]) + a_test(
    ["campaign.require('always (gap > 0)')"], "campaign"
).replace("test_it", "test_rate")
TAKES_OUT = """
import pytest
@pytest.hookimpl({how})
def pytest_collection_modifyitems(items):
    items[:] = [one for one in items if "rate" not in one.name]
"""


@pytest.mark.parametrize(
    "arguments, conftest",
    [
        (["-k", "not rate"], None),
        (["--deselect", "test_it.py::test_rate"], None),
        ([], "tryfirst=True"),
        (["-n2"], "trylast=True"),
    ],
)
def test_what_is_left_out_of_the_plan_stands_beside_the_gate(project, arguments, conftest):
    project.write("test_it.py", TWO)
    if conftest is not None:
        project.write("conftest.py", TAKES_OUT.format(how=conftest))
    result = project.run("test_it.py", *arguments)
    told = "passed, 1 of 2 planned verdicts asked for"
    assert f"gate: {told}, 1 supported" in output(result)
    found = project.evidence().selection
    assert (found.planned, found.asked) == (2, 1)
    assert found.left_out == ["test_it.py::test_rate on corridor/free"]
    summary, report = rendered(project)
    assert summary.startswith(f"# Gate {told}\n")
    assert "Left out: test" in summary
    assert "1 of 2 planned verdicts asked for" in report.partition("</h2>")[0]


def test_fewer_runs_than_planned_stand_beside_the_gate(project):
    project.write("test_it.py", TWO)
    result = project.run("test_it.py", "--dura-runs=1")
    assert "gate: passed, 1 run instead of 2, 2 supported" in output(result)
    more = project.run("test_it.py", "--dura-runs=3")
    assert "gate: passed, 2 supported" in output(more)


def test_scenario_items_that_are_left_out_count_too(project):
    result = project.scenarios("-k", "GAP")
    assert "gate: passed, 2 of 3 planned verdicts asked for, 2 supported" in output(result)
    assert project.evidence().selection.left_out == ["corridor/free::GO-1"]


@pytest.mark.parametrize("body", ["return None", "pass"])
def test_a_role_that_is_switched_off_is_shown_as_off(project, body):
    project.write(
        "conftest.py",
        f"import pytest\n@pytest.fixture(scope='session')\ndef safety_monitor():\n    {body}\n",
    )
    result = project.scenarios()
    assert "dura: safety_monitor is OFF: the fixture in conftest.py" in output(result)
    told = "safety_monitor is OFF in 2 of 2 cases"
    assert f"\n{told}\n" in output(result)
    assert [one.off for one in project.evidence().cases] == [["safety_monitor"]] * 2
    assert told.replace("_", "\\_") in rendered(project)[0]
    assert told in rendered(project)[1]
