"""One episode of each case is run twice in a session, and said to be repeatable or not."""

import json
import re

import pytest
from corridors import scenario
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


@pytest.mark.parametrize("runs", [1, 3])
def test_a_component_that_does_not_repeat_itself_is_told(shaky, runs):
    project, cases = shaky(runs)
    result = project.scenarios(select="corridor/shaky/*")
    assert result.ret == 0
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


def test_where_it_is_required_it_fails_the_gate(shaky):
    project, cases = shaky(2)
    result = project.scenarios(*REQUIRED, select="corridor/shaky/*")
    assert result.ret == 1
    reasons = sorted(project.evidence().gate.reasons)
    for reason, case in zip(reasons, sorted(cases), strict=True):
        assert reason.startswith(f"not repeatable: {case}#0")
        assert result.stdout.str().count(f"not repeatable: {case}#0") == 1
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
        ("--dura-executor=processes:1", SHAKY),
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
    project.scenarios(select="corridor/it")
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
    reuse = "--dura-reuse=kept"
    assert simulations(project, monkeypatch, reuse)[1] == 3
    assert simulations(project, monkeypatch, reuse)[1] == 1
    assert repeat(project).result == "equal"


def test_a_repetition_that_fails_is_told(planned):
    project = planned("Careful", simulator="planners:Breaks", runs=1)
    project.write(
        "planners.py",
        PLANNERS
        + """
from corridor import Corridor

class Breaks(Corridor):
    resets = 0

    def reset(self, scenario, seed):
        type(self).resets += 1
        if type(self).resets > 1:
            raise RuntimeError("worn out")
        return super().reset(scenario, seed)
""",
    )
    result = project.scenarios(*REQUIRED, select="corridor/it")
    assert result.ret == 1
    assert repeat(project).result == "failed"
    (told,) = re.findall(r"not repeatable: corridor/it#0 .*", " ".join(result.stdout.str().split()))
    assert re.search(r"the repetition failed: .*worn out", told)


@pytest.mark.parametrize(
    "change, told",
    [
        (lambda found: found.update(result="equal"), "the digests of its repetition are not equal"),
        (lambda found: found.update(digest="0" * 64), "is not recorded with that digest"),
    ],
)
def test_a_forged_repetition_is_found(planned, capsys, change, told):
    project = planned("FlipsCoins")
    project.scenarios(select="corridor/it")
    file = project.path / "dura-evidence/evidence.json"
    record = json.loads(file.read_text())
    change(next(one for one in record["cases"] if one["id"] == "corridor/it")["repeat"])
    file.write_text(json.dumps(record))
    assert main(["verify", str(file.parent)]) != 0
    assert told in capsys.readouterr().out
