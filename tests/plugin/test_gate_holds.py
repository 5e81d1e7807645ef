"""What other plugins and tests do to a session's end: the gate never passes for it."""

from __future__ import annotations

import json

import pytest
from corridors import scenario

FAILING = {"generator": "Reckless", "world": "{wall: 0.5}"}
CAMPAIGN = """
import pytest
@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("GAP-1")
def test_it(campaign):
    campaign.require()
"""


REPLACES = """
import pytest
@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport(item, call):
    yield
    return pytest.TestReport(item.nodeid, item.location, {}, "passed", None, call.when)
"""


def finish(kind, body):
    return f"""
import pytest
@pytest.hookimpl({kind}=True)
def pytest_sessionfinish(session):
    {body}
"""


def gate(project):
    return project.evidence().gate


@pytest.mark.parametrize(
    "conftest",
    [
        finish("tryfirst", "session.exitstatus = 0"),
        finish("trylast", "session.exitstatus = 0"),
        finish("wrapper", "yield; session.exitstatus = 0"),
        finish("trylast", "pytest.exit('enough', returncode=0)"),
    ],
    ids=["before", "after", "around", "exit"],
)
def test_no_plugin_makes_a_failed_session_a_success(project, conftest):
    scenario(project, requirements="[GAP-1]", **FAILING)
    project.write("conftest.py", conftest)
    assert project.run("corridor/it").ret == 1
    assert gate(project).result == "failed"


def test_an_end_that_is_cut_short_before_the_evidence_is_written_is_no_success(project):
    scenario(project, requirements="[GAP-1]")
    project.write("conftest.py", finish("tryfirst", "pytest.exit('enough', returncode=0)"))
    assert project.run("corridor/it").ret == 3
    assert project.evidence().status == "running"


def test_no_test_is_no_pass_though_a_plugin_calls_it_a_success(project):
    scenario(project, requirements="[GAP-1]")
    project.write("conftest.py", finish("tryfirst", "session.exitstatus = 0"))
    assert project.run("corridor/it", "-k", "nothing").ret == 1
    assert gate(project).reasons == ("no test was run",)


@pytest.mark.parametrize(
    "conftest, reason",
    [
        (
            "def pytest_runtest_protocol(item): return item.name.startswith('test_it') or None\n",
            "never reported its outcome",
        ),
        (
            REPLACES,  # the next report carries what the replaced one held
            "GAP-1 on corridor/it is violated",
        ),
    ],
    ids=["not run", "report replaced"],
)
def test_a_test_of_which_nothing_was_heard_is_no_pass(project, conftest, reason):
    scenario(project, requirements="[GAP-1]", **FAILING)
    project.write("conftest.py", conftest)
    project.write("test_it.py", f"{CAMPAIGN}\ndef test_other(): pass\n")
    assert project.run("test_it.py").ret == 1
    assert gate(project).result == "failed"
    assert reason in gate(project).reasons[0]


def test_an_exit_with_code_0_is_an_interrupted_session(project):
    scenario(project, requirements="[GAP-1]")
    project.write(
        "test_it.py", f"{CAMPAIGN}\ndef test_then(): pytest.exit('enough', returncode=0)\n"
    )
    assert project.run("test_it.py", "--dura-undecided=warn").ret == 2
    assert project.evidence().status == "interrupted"
    assert gate(project).result == "incomplete"


def test_a_trace_that_was_removed_meanwhile_fails_the_session(project):
    scenario(project, requirements="[GAP-1]")
    removes = "\nimport shutil\ndef test_then(): shutil.rmtree('dura-evidence/episodes')\n"
    project.write("test_it.py", CAMPAIGN + removes)
    assert project.run("test_it.py").ret == 1
    assert "it is not there as it was written" in gate(project).reasons[0]


def test_a_session_without_verdicts_is_no_pass_to_a_policy(project):
    scenario(project, requirements="[]")
    project.write("test_it.py", "def test_it(orchestrator): orchestrator.run('corridor/it')\n")
    assert project.run("test_it.py", "--dura-export=in-toto").ret == 0
    statement = (project.path / "dura-evidence/test-result.intoto.json").read_text()
    assert json.loads(statement)["predicate"]["result"] == "WARNED"
