from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

README = Path(__file__).parents[2] / "README.md"
CONFTEST = """
import pytest
from pytest_dura import Generator, Proposal

class Mine(Generator):
    def propose(self, view):
        return Proposal(0.5)

@pytest.fixture(scope="session")
def generator():
    return Mine
"""


@pytest.mark.parametrize("mode", ["n2", "without xdist"], indirect=True)
def test_the_root_conftest_swaps_the_component_in_every_mode(project, mode):
    project.write("conftest.py", CONFTEST)
    result = project.run("corridor/tight", *mode)
    result.assert_outcomes(passed=1)
    text = result.stdout.str()
    assert "component under test from the fixture `generator` in conftest.py" in text
    assert "component under test: Mine" in text
    evidence = project.evidence()
    assert evidence.component_under_test.name == "Mine"
    assert len(evidence.component_under_test.digest) == 64
    for kind in ("cases", "episodes", "verdicts"):
        assert {one.component for one in getattr(evidence, kind)} == {"Mine"}


def test_a_class_in_the_root_conftest_is_found_beside_another_conftest(project):
    project.write("conftest.py", CONFTEST)
    project.write("tests/conftest.py", "import pytest\nclass Mine: pass\n")
    project.write(
        "tests/test_it.py", "def test_it(orchestrator): orchestrator.run('corridor/tight')\n"
    )
    result = project.run("tests", "corridor/tight")
    result.assert_outcomes(passed=2)


def test_an_override_deeper_down_is_for_its_own_tests(project):
    project.write("conftest.py", CONFTEST)
    project.write("tests/conftest.py", CONFTEST.replace("Mine", "Deeper"))
    look = "def test_it(orchestrator):\n    found = orchestrator.run('corridor/tight')\n"
    look += "    assert found.spec.component == '{}'\n"
    project.write("tests/test_it.py", look.format("Deeper (tests)"))
    project.write("test_top.py", look.format("Mine"))
    project.write(
        "tests/test_fixture.py",
        "import pytest\n"
        "@pytest.fixture(scope='module')\n"
        "def name(orchestrator): return orchestrator.run('corridor/tight').spec.component\n"
        "def test_it(name): assert name == 'Deeper (tests)'\n",
    )
    result = project.run("test_top.py", "tests", "corridor/tight", "-v")
    result.assert_outcomes(passed=4)
    text = result.stdout.str()
    assert "warning: tests/conftest.py overrides `generator`, which scenario items do not" in text
    assert "corridor/tight (Deeper (tests))" in text
    names = {one.component for one in project.evidence().verdicts}
    assert names == {"Mine"}


def test_components_of_one_name_in_two_folders_are_told_apart(project):
    for folder, speed in (("a", "0.5"), ("b", "0.25")):
        project.write(f"{folder}/conftest.py", CONFTEST.replace("0.5", speed))
        project.write(
            f"{folder}/test_{folder}.py",
            "import pytest\n"
            "@pytest.mark.dura(scenario='corridor/tight', runs=1)\n"
            "@pytest.mark.requirement('GAP-1')\n"
            "def test_it(episode): pass\n",
        )
    result = project.run("a", "b")
    result.assert_outcomes(passed=2)
    evidence = project.evidence()
    assert [one.component for one in evidence.verdicts] == ["Mine (a)", "Mine (b)"]
    first = evidence.component_under_test
    (second,) = first.others
    assert (first.name, second.name) == ("Mine (a)", "Mine (b)")
    assert first.digest != second.digest


OVERRIDE = """
import pytest
from pytest_dura import RoleSpec

@pytest.fixture(scope="module")
def generator():
    return RoleSpec({path!r}, {params!r})

@pytest.mark.dura(scenario="corridor/tight", runs=1)
@pytest.mark.requirement("GAP-1")
def test_it(episode): pass
"""


def test_classes_of_one_name_in_two_modules_pass_no_gate(project):
    for module in ("old", "new"):
        code = "from corridor import Careful\n\n\nclass Planner(Careful):\n    pass\n"
        project.write(f"{module}.py", code)
        project.write(f"test_{module}.py", OVERRIDE.format(path=f"{module}:Planner", params={}))
    result = project.run("test_old.py", "test_new.py")
    evidence = project.evidence()
    assert (evidence.gate.result, result.ret) == ("failed", 1)
    told = "several components are called Planner, and verdicts go by that name: new:Planner, old:"
    assert any(told in reason for reason in evidence.gate.reasons)
    first = evidence.component_under_test
    assert [first.path, *(one.path for one in first.others)] == [
        "new:Planner",
        "old:Planner",
    ]


def test_the_option_and_a_fixture_together_are_a_usage_error(project):
    project.write("conftest.py", CONFTEST)
    result = project.run("corridor/tight", "--dura-generator=corridor:Reckless")
    assert result.ret == 4
    result.stderr.fnmatch_lines(
        [
            "ERROR: the component under test is given twice",
            "  found:    '--dura-generator and the fixture `generator` in conftest.py'",
        ]
    )


def test_the_option_and_a_fixture_deeper_down(project):
    project.write("tests/conftest.py", CONFTEST)
    project.write("tests/test_it.py", "def test_it(run_episode): pass\n")
    result = project.run("tests", "--dura-generator=corridor:Reckless")
    result.assert_outcomes(errors=1)
    assert "the component under test is given twice" in result.stdout.str()
    assert "fixtures.py" not in result.stdout.str()


def test_both_names_overridden_in_a_class_are_refused_there_alone(project):
    project.write(
        "test_it.py",
        """
import pytest

def test_before(orchestrator):
    assert orchestrator.run("corridor/tight").id

class TestTwice:
    @pytest.fixture
    def generator(self): return "corridor:Careful"

    @pytest.fixture
    def dura_generator(self): return "corridor:Reckless"

    def test_one(self, orchestrator): pass

    def test_other(self, orchestrator): pass

def test_after(orchestrator):
    assert orchestrator.run("corridor/tight").id
""",
    )
    result = project.run("test_it.py", "-v")
    text = result.stdout.str()
    assert text.count("the fixture `generator` and the fixture `dura_generator`") >= 2
    for name, outcome in (
        ("test_before", "PASSED"), ("TestTwice::test_one", "ERROR"),
        ("TestTwice::test_other", "ERROR"), ("test_after", "PASSED"),
    ):  # fmt: skip
        assert f"test_it.py::{name} {outcome}" in text


def test_the_option_names_the_component(project):
    result = project.run("corridor/tight", "--dura-generator=corridor:Reckless")
    assert "dura: component under test Reckless, base seed 0" in result.stdout.str()
    under_test = project.evidence().component_under_test
    assert (under_test.name, under_test.path) == ("Reckless", "corridor:Reckless")


RETURNS = """
import pytest
import corridor
from pytest_dura import RoleSpec, factory

@factory
def make():
    return corridor.Reckless()

@pytest.fixture(scope="session")
def generator():
    return {}
"""


@pytest.mark.parametrize(
    "value, name",
    [
        ("corridor.Reckless", "Reckless"),
        ("make", "make"),
        ("RoleSpec('corridor:Reckless')", "Reckless"),
        ("'corridor:Reckless'", "Reckless"),
        ("corridor.Reckless()", "Reckless"),
    ],
)
def test_what_a_role_fixture_may_return(project, value, name):
    project.write("conftest.py", RETURNS.replace("{}", value))
    result = project.run("corridor/tight")
    result.assert_outcomes(failed=1)
    (verdict,) = project.evidence().verdicts
    assert (verdict.component, verdict.verdict) == (name, "violated")


def test_a_bare_instance_is_said_in_terminal_and_evidence(project):
    project.write("conftest.py", RETURNS.replace("{}", "corridor.Reckless()"))
    result = project.run("corridor/tight")
    assert "Reckless (a bare instance, in this process only)" in result.stdout.str()
    evidence = project.evidence()
    assert evidence.component_under_test.opaque is True
    assert evidence.episodes[0].spec.roles["generator"].opaque is True
    replay = project.run("--dura-replay=corridor/tight#0")
    assert replay.ret == 4
    replay.stderr.fnmatch_lines(["ERROR: corridor:Reckless was given as a bare instance*"])


@pytest.mark.parametrize(
    "value, line",
    [
        ("None", "the generator cannot be switched off"),
        ("7", "what the fixture `generator` returned is not a Generator"),
        ("corridor.NoGenerator", "what the fixture `generator` returned is not a Generator"),
        # From Python 3.14 on, `inspect` takes it for a function.
        (
            "__import__('functools').partial(corridor.Careful)",
            "what the fixture `generator` returned is not a Generator",
        ),
        ("corridor.Watch()", "what the fixture `generator` returned is not a Generator"),
    ],
)
def test_what_a_role_fixture_may_not_return(project, value, line):
    project.write("conftest.py", RETURNS.replace("{}", value))
    result = project.run("corridor/tight")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines([line, "  remedy:   *"])
    assert "Traceback" not in result.stdout.str()
    assert project.verdicts() == {("corridor/tight", "GAP-1"): "undecided"}


def test_none_switches_a_role_off(project):
    project.write(
        "conftest.py",
        "import pytest\n@pytest.fixture(scope='session')\ndef safety_monitor(): return None\n",
    )
    project.run("corridor/free", "--dura-generator=corridor:Reckless")
    (case,) = project.evidence().cases
    assert case.metrics.flagged.valid == 0
    assert "safety_monitor" not in project.evidence().episodes[0].spec.roles


def test_another_role_and_another_simulator(project):
    project.write(
        "conftest.py",
        "import pytest, corridor\n"
        "class Short(corridor.Corridor):\n"
        "    def reset(self, scenario, seed):\n"
        "        scenario['world']['wall'] = 0.5\n"
        "        return super().reset(scenario, seed)\n"
        "@pytest.fixture(scope='session')\n"
        "def simulator(): return Short\n"
        "@pytest.fixture(scope='session')\n"
        "def recovery_planner(): return corridor.Brake\n"
        "@pytest.fixture(scope='session')\n"
        "def safety_monitor(): return corridor.Watch\n",
    )
    project.run("corridor/tight", "--dura-generator=corridor:Reckless").assert_outcomes(passed=1)
    (case,) = project.evidence().cases
    assert case.metrics.recoveries == 2


def test_an_override_that_wraps_the_default(project):
    project.write(
        "conftest.py",
        "import pytest\n"
        "@pytest.fixture(scope='session')\n"
        "def generator(generator): return generator\n",
    )
    project.run("corridor/tight").assert_outcomes(passed=1)
    assert project.evidence().component_under_test.name == "Careful"


def readme_planner():
    """The README's own planner, and the command that judges it."""
    block = r"```python\n# (planner\.py)\n(.*?)```\n\n```sh\npytest (.*?)\n```"
    file, code, arguments = re.search(block, README.read_text(), re.DOTALL).groups()
    return file, code, shlex.split(arguments)


def printed(result, kind):
    """The arguments of a command that a session printed."""
    line = next(line for line in result.outlines if line.strip().startswith(f"{kind}:"))
    return shlex.split(line.partition(" pytest ")[2])


def test_the_planner_of_the_readme_is_judged_as_printed(pytester, fast_sessions):
    file, code, arguments = readme_planner()
    # It never enters the junction, so that something is violated and commands are printed.
    (pytester.path / file).write_text(code.replace('"proceed"', '"wait"'))
    few = ["--dura-select=intersection/nominal", "--dura-runs=1"]
    result = pytester.runpytest_inprocess(*arguments, *few)
    assert result.ret == 1
    result.stdout.fnmatch_lines(
        ["violated: *(MyPlanner) (1 of * causes)", "component under test: MyPlanner, *"]
    )
    replay, rerun = printed(result, "replay"), printed(result, "rerun")
    assert pytester.runpytest_inprocess(*replay).ret == 0
    again = pytester.runpytest_inprocess(*rerun)
    again.assert_outcomes(failed=1)


def test_other_processes_find_the_planner_as_well(pytester, fast_sessions):
    file, code, (_, component) = readme_planner()
    (pytester.path / file).write_text(code)
    result = pytester.runpytest_inprocess(
        "intersection/nominal::SAF-1", component, "--dura-runs=1", "-n", "2"
    )
    result.assert_outcomes(passed=1)
    assert "simulated in pytest's own process" not in result.stdout.str()


def test_the_list_resolves_the_component(pytester, fast_sessions):
    file, code, arguments = readme_planner()
    arguments = ["--dura-list", *arguments]
    missing = pytester.runpytest_inprocess(*arguments)
    assert missing.ret == 4
    missing.stderr.fnmatch_lines(["ERROR: cannot import 'planner:MyPlanner'*", "  remedy: *"])
    (pytester.path / file).write_text(code)
    assert pytester.runpytest_inprocess(*arguments).ret == 0


def test_what_is_installed_goes_before_the_projects_own_modules(pytester, fast_sessions):
    (pytester.path / "yaml.py").write_text("raise SystemExit('the wrong one')")
    result = pytester.runpytest_inprocess("--dura-list", "--dura-generator=yaml:Planner")
    result.stderr.fnmatch_lines(["*module 'yaml' has no attribute 'Planner'*"])


def test_a_session_of_somebody_else_finds_no_more_than_before(pytester, fast_sessions):
    pytester.makepyfile(
        **{
            "tests/test_it": """
        import pytest
        def test_it():
            with pytest.raises(ImportError):
                import own_module_in_the_root
    """
        }
    )
    pytester.makepyfile(own_module_in_the_root="")
    pytester.runpytest_inprocess().assert_outcomes(passed=1)
