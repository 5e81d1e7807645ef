"""The plugin in sessions of other people: their collection, markers and fixtures are theirs."""

from __future__ import annotations

import re

import pytest
from outputs import shown_of

PLAIN = """
import unittest
import pytest

def test_plain():
    pass

@pytest.mark.requirement("of somebody else", level=3)
def test_marked_by_somebody_else():
    pass
"""
WRONG = {
    "no episode": (
        "@pytest.mark.dura(scenario='corridor/free')\ndef test_wrong(): pass",
        "*the marker dura runs nothing, since the test looks at no episode",
    ),
    "unknown scenario": (
        "@pytest.mark.dura(scenario='corridor/fre')\ndef test_wrong(episode): pass",
        "*no scenario matches 'corridor/fre'",
    ),
    "somebody else's dura": (
        "@pytest.mark.dura\n@pytest.mark.parametrize('x', [1])\ndef test_wrong(x): pass",
        "*the marker dura runs nothing, since the test looks at no episode",
    ),
    "somebody else's falsify": (
        "@pytest.mark.falsify('x', 'y')\ndef test_wrong(): pass",
        "*the marker falsify searches nothing*",
    ),
    "unknown requirement": (
        "@pytest.mark.requirement('GAPP-1')\ndef test_wrong(run_episode): pass",
        "*the requirement 'GAPP-1' has no text",
    ),
    "misspelt": (
        "@pytest.mark.requirment('X-1')\ndef test_wrong(run_episode): pass",
        "*there is no marker 'requirment', so that it would do nothing",
    ),
    "unittest": (
        """class TestCase(unittest.TestCase):
    @pytest.mark.dura(scenario='corridor/free')
    def test_wrong(self): pass
""",
        "the marker dura runs nothing here: a test of unittest.TestCase*",
    ),
}


def written(project, *texts):
    """A file with these tests beside plain ones, of which each is called by its number."""
    named = [
        re.sub("test_wrong|class TestCase", rf"\g<0>_{n}", text) for n, text in enumerate(texts)
    ]
    project.write("test_it.py", "\n\n".join([PLAIN, *named]))


def test_a_wrong_marker_fails_its_test_alone(project):
    written(project, *(text for text, _ in WRONG.values()))
    result = project.run("test_it.py", "-W", "ignore::pytest.PytestUnknownMarkWarning", "-n", "2")
    result.assert_outcomes(passed=2, errors=len(WRONG))
    assert result.ret == 1
    shown = {name.rpartition("_")[2]: lines for name, lines in shown_of(result).items()}
    for n, (_, message) in enumerate(WRONG.values()):
        shown[str(n)].fnmatch_lines([message])
    assert "INTERNALERROR" not in result.stdout.str() + result.stderr.str()
    assert "hooks.py" not in result.stdout.str()


def test_nothing_excuses_a_wrong_marker(project):
    texts = []
    for wrong in ("no episode", "unknown scenario", "unittest"):
        for excuse in ("xfail", "xfail(run=False)", "skip", "skipif(True, reason='x')"):
            text = WRONG[wrong][0].replace("@pytest.mark.dura", f"@pytest.mark.{excuse}\n@@", 1)
            indent = "    " if wrong == "unittest" else ""
            texts.append(text.replace("@@", f"{indent}@pytest.mark.dura"))
    written(project, *texts)
    result = project.run("test_it.py", "--dura-evidence=out")
    result.assert_outcomes(passed=2, errors=12)
    assert result.ret == 1
    gate = project.evidence("out").gate
    assert gate.result == "failed"
    for n in range(12):
        assert any(f"test_wrong_{n}: a marker cannot be used" in reason for reason in gate.reasons)


def test_a_session_of_wrong_markers_alone_fails_the_gate(project):
    project.write("test_it.py", "import pytest\n" + WRONG["unknown scenario"][0])
    result = project.run("test_it.py")
    assert result.ret == 1
    assert project.evidence().gate.result == "failed"


def test_a_marker_that_a_conftest_adds_late_runs_nothing_and_fails(project):
    project.write(
        "conftest.py",
        "import pytest\n"
        "@pytest.hookimpl(trylast=True)\n"
        "def pytest_collection_modifyitems(items):\n"
        "    items[0].add_marker(pytest.mark.dura(scenario='corridor/free'))\n",
    )
    project.write("test_it.py", PLAIN)
    result = project.pytester.runpytest_subprocess("test_it.py")
    result.assert_outcomes(passed=1, errors=1)
    assert result.ret == 1


SHORT = [
    "simulator",
    "generator",
    "orchestrator",
    "episode",
    "campaign",
    "run_episode",
    "recovery_planner",
]


def test_all_fixtures_have_long_names(project):
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/free', runs=2)\n"
        "@pytest.mark.requirement('GAP-1')\n"
        "def test_episode(dura_episode): assert not dura_episode.collided\n"
        "@pytest.mark.dura(scenario='corridor/free', runs=2)\n"
        "@pytest.mark.requirement('GAP-1')\n"
        "def test_campaign(dura_campaign): dura_campaign.require('always (gap > 0)')\n"
        "@pytest.mark.dura(verdict=False)\n"
        "def test_runner(dura_orchestrator, dura_run_episode):\n"
        "    first = dura_orchestrator.run('corridor/free', seed=3)\n"
        "    assert first.digest == dura_run_episode('corridor/free', 3).digest\n",
    )
    for setting in ([], ["-o", "dura_short_fixtures=false"]):
        project.run("test_it.py", *setting).assert_outcomes(passed=4)
        assert project.verdicts() == {("corridor/free", "GAP-1"): "supported"}


def test_a_test_on_a_long_name_that_decides_nothing_fails(project):
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/free', runs=1)\n"
        "def test_it(dura_episode): pass\n",
    )
    result = project.run("test_it.py")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*undecided: the test ended without a verdict*"])


def test_short_names_are_left_to_others(project):
    project.write(
        "test_it.py",
        "import pytest\n"
        f"@pytest.mark.parametrize('name', {SHORT})\n"
        "def test_short(request, name):\n"
        "    with pytest.raises(pytest.FixtureLookupError):\n"
        "        request.getfixturevalue(name)\n",
    )
    result = project.run("test_it.py", "-o", "dura_short_fixtures=false")
    result.assert_outcomes(passed=len(SHORT))


OVERRIDE = (
    "import pytest, corridor\n"
    "@pytest.fixture(scope='session')\n"
    "def {name}(): return corridor.Reckless\n"
)


@pytest.mark.parametrize("setting", ["true", "false"])
def test_the_component_is_overridden_by_its_long_name(project, setting):
    project.write("conftest.py", OVERRIDE.format(name="dura_generator"))
    result = project.scenarios("-o", f"dura_short_fixtures={setting}", select="corridor/free")
    assert project.verdict("GAP-1", "corridor/free").component == "Reckless"
    assert result.ret == 1
    given = project.scenarios("--dura-generator=corridor:Careful", select="corridor/free")
    assert given.ret == 4


def test_a_generator_of_somebody_else_is_no_component(project):
    project.write(
        "conftest.py", OVERRIDE.format(name="generator").replace("corridor.Reckless", "7")
    )
    result = project.scenarios("-o", "dura_short_fixtures=false", select="corridor/free")
    assert result.ret == 0
    result = project.scenarios(select="corridor/free")
    assert result.ret == 1


def test_a_component_that_is_overridden_twice_is_refused(project):
    names = ("generator", "dura_generator")
    project.write("conftest.py", "".join(OVERRIDE.format(name=name) for name in names))
    result = project.scenarios(select="corridor/free")
    assert result.ret != 0
    assert "the component under test is given twice" in result.stdout.str() + result.stderr.str()


def test_a_wrong_setting_of_short_names_is_refused(project):
    project.write("test_it.py", PLAIN)
    result = project.run("test_it.py", "-o", "dura_short_fixtures=no")
    assert result.ret == 4
    result.stderr.fnmatch_lines(["*the ini setting dura_short_fixtures is true or false"])
