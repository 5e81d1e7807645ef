"""One episode of each case is run twice; where it differs, verdicts on the case are undecided."""

import json
import re

import pytest
from corridors import requirement, scenario
from forked_workers import AVAILABLE

from pytest_dura.__main__ import main

PLANNERS = """
import random
import time

from corridor import Careful
from pytest_dura import Proposal

class Remembers(Careful):
    asked = 0

    def propose(self, view):
        type(self).asked += 1
        return Proposal(1.0 / type(self).asked)

class FlipsCoins(Careful):
    def propose(self, view):
        return Proposal(random.random())

class ReadsTheClock(Careful):
    def propose(self, view):
        return Proposal(time.perf_counter_ns() % 1000 / 1000)
"""
VARIES = {"world": "{wall: 9.0}", "variation": "{world.wall: {min: 8.0, max: 9.0}}"}
SHAKY = ["Remembers", "FlipsCoins", "ReadsTheClock"]
REQUIRED = "-o", "dura_require_repeatable=true"


@pytest.fixture
def planned(project):
    project.write("planners.py", PLANNERS)

    def write(planner, **keys):
        own = {"requirements": "[GAP-1]", "generator": f"planners:{planner}"}
        scenario(project, **(own | keys))
        return project

    return write


def repeat(project, case="corridor/it"):
    (found,) = [one for one in project.evidence().cases if one.id == case]
    return found.repeat


@pytest.fixture
def shaky(planned):
    """A project, and in it a case for each of some components that do not repeat themselves."""

    def write(runs, planners=SHAKY):
        for planner in planners:
            project = planned(planner, name=f"shaky/{planner}", runs=runs)
        return project, [f"corridor/shaky/{planner}" for planner in planners]

    return write


@pytest.mark.parametrize("runs, option", [(3, ()), (1, ("--dura-undecided=warn",))])
def test_verdicts_on_a_component_that_does_not_repeat_itself_are_undecided(shaky, runs, option):
    project, cases = shaky(runs)
    result = project.scenarios(*option, select="corridor/shaky/*")
    assert result.ret == 1
    bundle = project.path / "dura-evidence"
    summary, page = (
        re.search(r"Not repeatable: (.*?)\. An", (bundle / name).read_text()).group(1)
        for name in ("summary.md", "report.html")
    )
    episodes = {one.id: one for one in project.evidence().episodes}
    for case in cases:
        result.stdout.fnmatch_lines([f"*{case}#0 (*): run again in this session it*"])
        found = repeat(project, case)
        assert (found.episode, found.result) == (f"{case}#0", "different")
        assert found.digest != found.repeated_digest
        assert found.digest == episodes[f"{case}#0"].digest
        assert case in summary
        assert case in page
        verdict = project.verdict("GAP-1", case)
        assert (verdict.verdict, verdict.too_few) == ("undecided", False)
        assert verdict.reason.startswith(f"not repeatable: {case}#0")
        assert f"the gate fails: GAP-1 on {case} is undecided" in result.stdout.str()
    assert main(["verify", str(bundle)]) == 0


def test_state_of_a_class_shows_where_a_process_of_its_own_repeats(planned, project):
    planned("Remembers")
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/it')\n"
        "@pytest.mark.requirement('GAP-1')\n"
        "def test_it(episode): pass\n",
    )
    assert project.run("test_it.py", "--dura-executor=processes:2").ret == 1
    assert repeat(project).result == "different"


def test_a_violation_stays_one_where_the_repetition_differs(planned, project):
    requirement(project, "always (gap > 8.95)")
    planned("Remembers", requirements="[R-1]", world="{wall: 9.0}")
    assert project.scenarios(select="corridor/it").ret == 1
    assert project.verdict("R-1").verdict == "violated"
    assert repeat(project).result == "different"


def test_a_verdict_on_pairs_rests_on_the_repetition_of_their_second_runs_too(planned, project):
    paired = {"kind": "recovery", "paired": "{without: recovery_planner}"}
    requirement(project, "always (gap > 0)", "PAIR-1", **paired)
    project.write("planners.py", PLANNERS + SECOND_RUNS)
    keys = {"requirements": "[PAIR-1]", "runs": 3, "recovery_planner": "Brake"}
    scenario(project, generator="planners:CountsRuns", **keys)
    project.scenarios("--dura-executor=in-process", select="corridor/it")
    # By turns: whichever is repeated first meets the turn of the other one.
    assert repeat(project, "corridor/it~recovery_planner").result == "different"
    verdict = project.verdict("PAIR-1")
    assert verdict.verdict == "undecided"
    assert "not repeatable: corridor/it~recovery_planner#0" in verdict.reason
    assert main(["verify", str(project.path / "dura-evidence")]) == 0


SECOND_RUNS = """
class CountsRuns(Careful):
    runs = 0

    def reset(self, context):
        type(self).runs += 1

    def propose(self, view):
        return Proposal(1.0 if type(self).runs % 2 else 0.5)
"""

DECLARED = {
    "component": "class Declares(ReadsTheClock):\n    repeatable = False\n",
    "simulator": "from corridor import Corridor\n\n"
    "class Declares(Corridor):\n"
    "    repeatable = False\n"
    "    def blow(self, seed):\n"
    "        return time.perf_counter()\n",
}


@pytest.mark.parametrize("declared_by", ["component", "simulator", "session"])
def test_runs_of_what_declares_that_it_does_not_repeat_itself_count_as_draws(planned, declared_by):
    roles = {
        "component": {"planner": "Declares"},
        "simulator": {"planner": "Careful", "simulator": "planners:Declares"},
        "session": {"planner": "ReadsTheClock"},
    }
    project = planned(**roles[declared_by], runs=3)
    project.write("planners.py", PLANNERS + "\n" + DECLARED.get(declared_by, ""))
    arguments = ["-o", "dura_repeatable=false"] if declared_by == "session" else []
    result = project.scenarios(*arguments, "--junit-xml=junit.xml", select="corridor/it")
    assert result.ret == 0
    found = repeat(project)
    what = (
        "the session sets dura_repeatable = false"
        if declared_by == "session"
        else f"the {declared_by} Declares declares repeatable = False"
    )
    assert (found.result, found.declared) == ("different", what)
    verdict = project.verdict("GAP-1")
    assert verdict.verdict == "supported"
    assert verdict.reason.endswith(f"; the runs count as draws: {what}")
    bundle = project.path / "dura-evidence"
    texts = [result.stdout.str(), (project.path / "junit.xml").read_text()]
    texts += [(bundle / name).read_text() for name in ("summary.md", "report.html")]
    texts += [(bundle / "assurance-case.gsn.yaml").read_text()]
    for text in texts:
        assert what in " ".join(text.replace("\\_", "_").split())
    assert "not repeatable" not in result.stdout.str()
    assert main(["verify", str(bundle)]) == 0
    assert project.scenarios(*arguments, *REQUIRED, select="corridor/it").ret == 1


def test_where_it_is_required_it_fails_the_gate(shaky):
    project, cases = shaky(2)
    result = project.scenarios(*REQUIRED, select="corridor/shaky/*")
    assert result.ret == 1
    reasons = project.evidence().gate.reasons
    for case in cases:
        assert any(reason.startswith(f"not repeatable: {case}#0") for reason in reasons)
    assert main(["verify", str(project.path / "dura-evidence")]) == 0


def test_one_that_repeats_itself_passes_and_its_repetition_is_part_of_no_count(planned):
    project = planned("Careful", runs=4, **VARIES)
    result = project.scenarios(*REQUIRED, select="corridor/it")
    assert result.ret == 0
    assert "not repeatable" not in result.stdout.str()
    found = repeat(project)
    assert (found.result, found.digest) == ("equal", found.repeated_digest)
    assert len(project.evidence().episodes) == project.verdict("GAP-1").run == 4
    assert main(["verify", str(project.path / "dura-evidence")]) == 0


def simulations(project, monkeypatch, *arguments):
    log = project.path / "log"
    log.unlink(missing_ok=True)
    monkeypatch.setenv("CORRIDOR_LOG", str(log))
    result = project.scenarios(*arguments, select="corridor/it")
    return result, len(log.read_text().splitlines())


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        pytest.param(("-n2",), marks=pytest.mark.skipif(not AVAILABLE, reason="no os.fork")),
        ("--dura-executor=processes:2",),
    ],
    ids=["one process", "xdist", "executor"],
)
def test_a_case_is_repeated_once_however_many_requirements_and_processes_there_are(
    planned, monkeypatch, arguments
):
    project = planned("Careful", runs=4, duration=1.5, requirements="[GAP-1, GO-1]", **VARIES)
    result, count = simulations(project, monkeypatch, *arguments)
    assert result.ret == 0
    assert count == 5
    assert repeat(project).result == "equal"


@pytest.mark.parametrize(
    "argument, planners",
    [
        # What it remembers is of its process, in which nothing else may be repeated first.
        ("-n2", SHAKY[:1]),
        ("-n2", SHAKY[1:]),
    ],
)
def test_it_is_found_wherever_episodes_are_simulated(shaky, argument, planners):
    if argument == "-n2" and not AVAILABLE:
        pytest.skip("no os.fork")
    project, cases = shaky(3, planners)
    assert project.scenarios(*REQUIRED, argument, select="corridor/shaky/*").ret == 1
    assert {repeat(project, case).result for case in cases} == {"different"}


def test_state_that_other_episodes_leave_behind_shows(planned):
    """One episode right after itself would be equal: the state changes with the fourth one."""
    project = planned("Tires", runs=4, **VARIES)
    text = """
class Tires(Careful):
    resets = 0

    def reset(self, context):
        type(self).resets += 1

    def propose(self, view):
        return Proposal(1.0 if type(self).resets < 4 else 0.5)
"""
    project.write("planners.py", PLANNERS + text)
    project.scenarios("--dura-executor=processes:1", select="corridor/it")
    assert repeat(project).result == "different"


def test_a_bare_instance_is_repeated_in_this_process(project):
    project.write("planners.py", PLANNERS)
    scenario(project, requirements="[GAP-1]")
    project.write(
        "conftest.py",
        """
        import pytest
        import planners

        @pytest.fixture(scope="session")
        def generator():
            return planners.FlipsCoins()
    """.replace("\n        ", "\n"),
    )
    assert project.scenarios(*REQUIRED, select="corridor/it").ret == 1
    assert repeat(project).result == "different"


def test_tests_on_single_episodes_are_repeated_after_the_last_of_them(project):
    project.write("planners.py", PLANNERS)
    scenario(project, generator="planners:Remembers", requirements="[GAP-1]", runs=3)
    project.write(
        "test_it.py",
        """
import pytest

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("GAP-1")
def test_it(episode):
    assert not episode.collided
""",
    )
    project.run()
    assert repeat(project).result == "different"


def test_an_episode_that_was_taken_over_is_compared_with_one_of_this_session(planned, monkeypatch):
    project = planned("Careful", **VARIES)
    project.write("stop", "")
    assert simulations(project, monkeypatch, "-p", "stopping")[1] == 3
    again = simulations(project, monkeypatch, "-p", "stopping", "--dura-resume")
    assert again[1] == 1
    assert repeat(project).result == "equal"


@pytest.mark.parametrize("declared", [False, True])
def test_a_failed_repetition_leaves_verdicts_undecided_whatever_is_declared(planned, declared):
    project = planned("Careful", simulator="planners:Breaks", runs=1)
    project.write(
        "planners.py",
        PLANNERS
        + """
from corridor import Corridor

class Breaks(Corridor):
    resets = 0
    repeatable = NOT_DECLARED

    def reset(self, scenario, seed):
        type(self).resets += 1
        if type(self).resets > 1:
            raise RuntimeError("worn out")
        return super().reset(scenario, seed)
""".replace("NOT_DECLARED", str(not declared)),
    )
    result = project.scenarios("--dura-undecided=warn", select="corridor/it")
    assert result.ret == 1
    assert repeat(project).result == "failed"
    assert bool(repeat(project).declared) == declared
    assert project.verdict("GAP-1").verdict == "undecided"
    (told,) = re.findall(r"not repeatable: corridor/it#0 .*", " ".join(result.stdout.str().split()))
    assert re.search(r"the repetition failed: .*worn out", told)


def test_where_it_is_required_a_case_that_was_never_repeated_does_not_pass(planned):
    project = planned("Careful", simulator="oddities:TurnsNaN")
    result = project.scenarios(*REQUIRED, "--dura-undecided=warn", select="corridor/it")
    assert result.ret == 1
    assert repeat(project) is None
    reasons = [one for one in project.evidence().gate.reasons if "repeated" in one]
    assert len(reasons) == 1
    assert "no episode of corridor/it" in reasons[0]


def test_where_it_is_required_a_repetition_cannot_be_taken_out_of_the_record(planned, capsys):
    project = planned("Careful", **VARIES)
    assert project.scenarios(*REQUIRED, select="corridor/it").ret == 0
    file = project.path / "dura-evidence/evidence.json"
    record = json.loads(file.read_text())
    next(one for one in record["cases"] if one["id"] == "corridor/it")["repeat"] = None
    file.write_text(json.dumps(record))
    capsys.readouterr()
    assert main(["verify", str(file.parent)]) != 0
    assert '/gate/result: found "passed", expected "failed"' in capsys.readouterr().out


@pytest.fixture
def flipped(project, planned, made_once):
    """A session whose repetition differs, to be altered."""

    def run():
        planned("FlipsCoins").scenarios(select="corridor/it")

    made_once(project, "a repetition that differs", run)
    return project


@pytest.mark.parametrize(
    "change, told",
    [
        (lambda found: found.update(result="equal"), "the digests of its repetition are not equal"),
        (lambda found: found.update(digest="0" * 64), "is not recorded with that digest"),
        (
            lambda found: found.update(
                result="skipped", repeated_digest=None, declared="a live language model answers"
            ),
            "was not repeated for the sake of a live model, and none was asked",
        ),
    ],
)
def test_a_forged_repetition_is_found(flipped, capsys, change, told):
    file = flipped.path / "dura-evidence/evidence.json"
    record = json.loads(file.read_text())
    change(next(one for one in record["cases"] if one["id"] == "corridor/it")["repeat"])
    file.write_text(json.dumps(record))
    assert main(["verify", str(file.parent)]) != 0
    assert told in capsys.readouterr().out
