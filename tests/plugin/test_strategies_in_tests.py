"""Property tests of a project: ``@given(case=strategies.cases(...))`` with ``run_episode``."""

from __future__ import annotations

import re

import pytest
import yaml
from forked_workers import CI_VARIABLES

from pytest_dura.evidence import verify_bundle

HASTY = """
from corridor import Careful
from pytest_dura import Proposal

class Hasty(Careful):
    \"\"\"Loses its mind where the wall is at least 10.3 m away at first.\"\"\"

    def reset(self, context):
        super().reset(context)
        self.first = None

    def propose(self, view):
        gap = view.percept["gap"]
        self.first = self.first or gap
        return Proposal(90.0 if self.first >= 10.3 else 1.0 if gap > 3.0 else 0.0)

class Mended(Careful):
    pass
"""
PROPERTY = """
import pytest
from hypothesis import given
from pytest_dura import strategies

@pytest.mark.dura(verdict=False)
@given(case=strategies.cases("corridor/free"))
def test_holds_everywhere(case, run_episode):
    assert not run_episode(case).collided
"""


@pytest.fixture(autouse=True)
def no_ci(monkeypatch):
    for name in CI_VARIABLES:
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def properties(project):
    project.write("hasty.py", HASTY)
    project.write("test_property.py", PROPERTY)
    return project


def run(project, *arguments, generator="hasty:Hasty", alone=False):
    """A session; apart from this process where it is about what Hypothesis has loaded or kept."""
    given = ["-p", "no:cacheprovider", f"--dura-generator={generator}", *arguments]
    return project.run_apart(*given) if alone else project.run(*given)


def output(result):
    return result.stdout.str() + result.stderr.str()


def found_files(project):
    return sorted(project.path.glob("scenarios/found/*.yaml"))


def test_a_failure_is_found_shrunk_kept_and_collected_from_then_on(properties):
    result = run(properties, "test_property.py")
    assert result.ret == 1
    (file,) = found_files(properties)
    kept = yaml.safe_load(file.read_text())
    assert kept["world"] == {"wall": 10.3}
    assert kept["seed"] == 0
    assert kept["requirements"] == ["GAP-1"]
    text = output(result)
    assert f"kept:      scenarios/found/{file.name}" in text
    assert "differs:   world.wall: 10.3 instead of 10" in text
    assert "violates GAP-1, confirmed by replay with an equal digest" in text
    assert "INTERNALERROR" not in text

    (command,) = re.findall(r"^rerun: +pytest (.*)$", text, re.MULTILINE)
    again = run(properties, *command.replace("'", "").split())
    assert again.ret == 1
    assert properties.verdict("GAP-1", kept["name"]).verdict == "violated"
    collected = run(properties, "--dura-scenarios", "--dura-select=found/*")
    collected.assert_outcomes(failed=1)
    mended = run(properties, "--dura-scenarios", "--dura-select=found/*", generator="hasty:Mended")
    mended.assert_outcomes(passed=1)
    assert properties.verdict("GAP-1", kept["name"]).verdict == "supported"


GIVEN = """
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

@pytest.mark.dura(scenario="corridor/free", runs=1)
@pytest.mark.requirement("GAP-1")
@settings({settings})
@given(limit=st.floats(0, 1))
def test_it({fixture}, limit):
    {asks}
"""
ASKS = {"episode": "assert not episode.collided", "campaign": "campaign.require()"}


@pytest.mark.parametrize("fixture", ["episode", "campaign"])
def test_a_fixture_that_is_the_same_for_all_inputs_is_refused_with_the_remedy(project, fixture):
    asks = {"fixture": fixture, "asks": ASKS[fixture]}
    project.write("test_it.py", GIVEN.format(settings="", **asks))
    result = project.run("test_it.py")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            f"test_it.py:*: @given draws many inputs, and the fixture `{fixture}` is the same *",
            f"  remedy: * take `run_episode` in place of `{fixture}`, draw the case by *",
            "gate: failed, 1 undecided",
        ]
    )
    assert "role or the simulator" not in output(result)
    suppressed = "suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=2"
    project.write("test_it.py", GIVEN.format(settings=suppressed, **asks))
    project.run("test_it.py").assert_outcomes(passed=1)


def test_a_refused_fixture_of_the_users_own_is_left_to_hypothesis(project):
    project.write(
        "test_it.py",
        "import pytest\n"
        "from hypothesis import given, strategies as st\n"
        "@pytest.fixture\n"
        "def episode(): return 'S01E01'\n"
        "@given(number=st.integers())\n"
        "def test_it(episode, orchestrator, number): pass\n",
    )
    result = project.run("test_it.py")
    result.assert_outcomes(failed=1)
    assert "FailedHealthCheck" in result.stdout.str()
    assert "run_episode" not in result.stdout.str()


def test_what_holds_passes_leaves_no_file_and_enters_no_rate(properties):
    result = run(properties, "test_property.py", generator="hasty:Mended")
    result.assert_outcomes(passed=1)
    assert found_files(properties) == []
    record = properties.evidence()
    assert record.verdicts == []
    assert record.episodes == []
    assert record.cases == []
    assert verify_bundle(properties.path / "dura-evidence").problems == []


@pytest.mark.parametrize("profile", ["by itself", "asked for"])
def test_the_profile_has_no_deadline_and_is_told_in_the_evidence(properties, profile):
    properties.write(
        "test_property.py",
        PROPERTY.replace("    assert not", "    import time; time.sleep(0.21)\n    assert not")
        .replace("import given", "import given, settings")
        .replace("@given", "@settings(max_examples=3)\n@given"),
    )
    asked = [] if profile == "by itself" else ["--hypothesis-profile=dura"]
    result = run(properties, "test_property.py", *asked, generator="hasty:Mended", alone=True)
    result.assert_outcomes(passed=1)
    assert properties.evidence().environment.hypothesis.to_json() == {
        "profile": "dura",
        "max_examples": 100,
        "derandomize": False,
        "database": True,
    }


def test_in_a_ci_the_same_cases_are_drawn_each_time(properties, monkeypatch):
    monkeypatch.setenv("CI", "true")
    # Hypothesis looks for a CI while it is imported: a process that starts afresh.
    result = properties.pytester.runpytest_subprocess(
        "test_property.py", "--dura-generator=hasty:Hasty"
    )
    assert result.ret == 1
    assert len(found_files(properties)) == 1
    told = properties.evidence().environment.hypothesis
    assert (told.profile, told.derandomize, told.database) == ("dura", True, False)
    assert not (properties.path / ".hypothesis" / "examples").exists()


def test_a_failure_is_replayed_first_from_the_database_of_hypothesis(properties):
    narrow = HASTY.replace("self.first >= 10.3", "10.3 <= self.first <= 10.35")
    properties.write("hasty.py", narrow)
    test = PROPERTY.replace(
        "    assert not", "    print('ran', case.scenario.world)\n    assert not"
    )
    properties.write("test_property.py", test.replace(
        "@given", "@settings(max_examples=2000)\n@given"
    ).replace("import given", "import given, settings"))  # fmt: skip
    first = run(properties, "test_property.py", alone=True)
    assert first.ret == 1
    second = run(properties, "test_property.py", "-s", alone=True)
    assert second.ret == 1
    ran = re.findall(r"ran \{'wall': ([\d.]+)\}", output(second))
    assert 10.3 <= float(ran[0]) <= 10.35, "the first case is the one that failed"
    assert len(ran) < 100


def test_under_xdist_the_worker_keeps_the_file_and_tells_the_profile(properties):
    result = run(properties, "test_property.py", "-n", "1", alone=True)
    assert result.ret == 1
    (file,) = found_files(properties)
    assert f"kept:      scenarios/found/{file.name}" in output(result)
    assert properties.evidence().environment.hypothesis.profile == "dura"


def test_what_violates_no_requirement_is_told_and_not_kept(properties):
    test = PROPERTY.replace(
        "assert not run_episode(case).collided", "assert run_episode(case).time[-1] < 1"
    )
    properties.write("test_property.py", test)
    result = run(properties, "test_property.py", generator="hasty:Mended")
    assert result.ret == 1
    assert found_files(properties) == []
    assert "violates no requirement of the test or its scenario" in output(result)


def test_a_requirement_of_the_marker_comes_before_those_of_the_scenario(properties):
    properties.write(
        "scenarios/mine.yaml",
        "requirements: [{id: FAR-1, text: Far., kind: safety, check: always (gap > 1)}]\n",
    )
    properties.write(
        "test_property.py",
        PROPERTY.replace("@given", '@pytest.mark.requirement("FAR-1")\n@given').replace(
            "from hypothesis", "import pytest\nfrom hypothesis"
        ),
    )
    assert run(properties, "test_property.py").ret == 1
    (file,) = found_files(properties)
    assert yaml.safe_load(file.read_text())["requirements"] == ["FAR-1"]


def test_a_requirement_without_a_check_is_passed_over(properties):
    marker = '@pytest.mark.requirement("TXT-1", text="As it should be.")\n@given'
    test = PROPERTY.replace("@given", marker).replace("from hypo", "import pytest\nfrom hypo", 1)
    properties.write("test_property.py", test)
    assert run(properties, "test_property.py").ret == 1
    (file,) = found_files(properties)
    assert yaml.safe_load(file.read_text())["requirements"] == ["GAP-1"]


def test_what_does_not_repeat_itself_is_not_kept(properties):
    properties.write(
        "hasty.py",
        "import os\n" + HASTY.replace("90.0 if", "90.0 + os.urandom(1)[0] if"),
    )
    result = run(properties, "test_property.py")
    assert result.ret == 1
    assert found_files(properties) == []
    assert "0 of them with an equal digest: no file is kept" in output(result)


def test_a_simulator_that_breaks_is_no_pass(properties):
    properties.write(
        "scenarios/corridor/free.yaml",
        """
name: corridor/free
simulator: corridor:Corridor
duration: 2.0
world: {wall: 10.0, breaks_at: 3}
variation: {world.wall: {min: 9.0, max: 11.0}}
roles: {generator: "corridor:Careful"}
requirements: [GAP-1]
""",
    )
    result = run(properties, "test_property.py", generator="hasty:Mended")
    result.assert_outcomes(failed=1)
    assert "infrastructure" in output(result)
    assert found_files(properties) == []


def test_where_no_case_is_valid_there_is_no_pass(properties):
    properties.write(
        "scenarios/corridor/free.yaml",
        """
name: corridor/free
simulator: corridor:Corridor
duration: 2.0
world: {wall: 10.0}
variation: {world.wall: {min: 9.0, max: 11.0}}
roles: {generator: "corridor:Careful", fault_injector: "corridor:Idle"}
faults: [{type: bias, target: gap, activation: {at: 0.1}}]
requirements: [GAP-1]
""",
    )
    few = PROPERTY.replace("import given", "import given, settings")
    few = few.replace("@given", "@settings(max_examples=20)\n@given")
    kept = few.replace('"corridor/free"', '"corridor/free", leave_out=False')
    properties.write("test_property.py", kept)
    result = run(properties, "test_property.py", generator="hasty:Mended")
    result.assert_outcomes(failed=1)
    assert re.search(
        r"undecided: none of \d+ cases is valid \(.*never manifested: bias", output(result)
    )
    relaxed = run(properties, "test_property.py", "--dura-undecided=warn", generator="hasty:Mended")
    relaxed.assert_outcomes(failed=1)
    properties.write("test_property.py", few)
    result = run(properties, "test_property.py", generator="hasty:Mended")
    result.assert_outcomes(passed=1)


def test_an_unknown_scenario_is_one_error(properties):
    properties.write("test_property.py", PROPERTY.replace("corridor/free", "corridor/fre"))
    result = run(properties, "test_property.py")
    result.assert_outcomes(failed=1)
    assert "no case matches 'corridor/fre'" in output(result)
    assert "did you mean 'corridor/free'?" in output(result)
    assert "Traceback" not in output(result)
