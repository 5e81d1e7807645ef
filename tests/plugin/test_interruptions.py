"""Ctrl-C once or twice, at any moment: the record says so, the episodes stay, a resume goes on."""

from __future__ import annotations

import pytest
from corridors import scenario
from outputs import output

from pytest_dura.evidence import verify_bundle

EXECUTOR = "auto"

CONFTEST = """
import os, signal
import pytest
from pytest_dura.reports import summary

MOMENTS = os.environ.get("MOMENTS", "").split()
if MOMENTS:  # what a shell starts in the background ignores the key
    signal.signal(signal.SIGINT, signal.default_int_handler)

def now(moment):
    if moment in MOMENTS:
        MOMENTS.remove(moment)
        os.kill(os.getpid(), signal.SIGINT)

@pytest.fixture(scope="session")
def held():
    yield
    now("fixture")

class Early:
    @pytest.hookimpl(tryfirst=True)
    def pytest_keyboard_interrupt(self): now("interrupt")
    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self): now("finish_first")

class Late:
    @pytest.hookimpl(trylast=True)
    def pytest_sessionstart(self): now("start")
    @pytest.hookimpl(trylast=True)
    def pytest_collection_finish(self): now("collected")
    @pytest.hookimpl(trylast=True)
    def pytest_runtest_logreport(self, report):
        if report.when == "call": now("report")
    @pytest.hookimpl(trylast=True)
    def pytest_terminal_summary(self): now("summary")
    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self): now("finish_last")

def pytest_configure(config):
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(Early())
        config.pluginmanager.register(Late())
        really = summary.render
        def render(record):
            now("render")
            return really(record)
        summary.render = render
        config.add_cleanup(lambda: setattr(summary, "render", really))
"""
TESTS = """
import pytest
from conftest import now

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("GAP-1")
def test_dura(campaign, held):
    campaign.require()

def test_plain(held):
    now("plain")

def test_that_an_interruption_leaves_out():
    assert {holds}
"""


@pytest.fixture
def interrupted(project, monkeypatch):
    """Runs a session with Ctrl-C at these moments; without it a test of the session fails."""

    def run(moments, *arguments):
        scenario(project, requirements="[GAP-1]")
        project.write("conftest.py", CONFTEST)
        project.write("test_it.py", TESTS.format(holds=False))
        monkeypatch.setenv("MOMENTS", moments)
        result = project.run_apart("test_it.py", *arguments)
        monkeypatch.delenv("MOMENTS")
        project.write("test_it.py", TESTS.format(holds=True))
        return result

    return run


def check(project, result):
    assert result.ret != 0
    record = project.evidence()
    assert (record.status, record.gate.result) == ("interrupted", "incomplete")
    assert record.gate.exit_code != 0
    assert verify_bundle(project.path / "dura-evidence").problems


@pytest.mark.parametrize(
    "moments, kept",
    [
        ("collected interrupt", 0),
        ("report interrupt", 2),
        ("plain", 2),
        ("plain interrupt", 2),
        ("fixture interrupt", 2),
        ("plain render", 2),
        ("plain summary", 2),
    ],
)
def test_what_never_ran_leaves_no_complete_session(project, interrupted, moments, kept):
    result = interrupted(moments)
    check(project, result)
    resumed = project.run("test_it.py", "--dura-resume")
    assert resumed.ret == 0, output(resumed)
    assert f"resuming: {kept} episodes of the interrupted session" in output(resumed)
    record = project.evidence()
    assert (record.status, record.gate.result) == ("complete", "passed")
    assert record.resume.taken_over == kept
    assert not (project.path / "dura-evidence/.episodes").exists()


@pytest.mark.parametrize("moments", ["start", "finish_first", "render", "summary", "finish_last"])
def test_an_end_that_is_interrupted_leaves_the_episodes(project, interrupted, moments):
    result = interrupted(moments, "corridor/it")  # which begins the record before the collection
    check(project, result)
    assert "dura: the session was interrupted; --dura-resume goes on" in output(result)
    resumed = project.run("test_it.py", "--dura-resume")
    assert resumed.ret == 0, output(resumed)
    assert project.evidence().resume.taken_over == (0 if moments == "start" else 2)


@pytest.mark.parametrize("moments", ["report interrupt", "finish_last"])
def test_the_controller_of_workers_is_interrupted(project, interrupted, moments):
    result = interrupted(moments, "corridor/it", "-n", "2")
    check(project, result)
    assert (project.path / "dura-evidence/.episodes").is_dir()
    resumed = project.run("test_it.py", "--dura-resume")
    assert resumed.ret == 0, output(resumed)
