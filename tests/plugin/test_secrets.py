"""A key that is planted wherever a session could pick it up is in no file of its bundle."""

from __future__ import annotations

import io
import os
import re
import shutil
import stat
import zlib
from base64 import b64decode, b64encode
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
from corridors import requirement, scenario
from mcap.reader import make_reader
from outputs import output

KEY = "Zx9/planted+Q7!wert-uiop"
SHAPED = "sk-proj-Ab3dEf6hIj9kLmN0pQrStUvWxYz012345"
CONFTEST = """
import os
import pytest
from corridor import Reckless
from pytest_dura import Proposal, RoleSpec

class Leaky(Reckless):
    def __init__(self, token="", note=""):
        self.token = token

    def propose(self, view):
        proposal = super().propose(view)
        told = f"asked with {os.environ['PLANNER_API_KEY']} and {self.token}"
        if view.index == 3:
            raise RuntimeError(told)
        return Proposal(proposal.action, told)

@pytest.fixture(scope="session")
def generator():
    note = "Authorization: Bearer " + os.environ["PLANNER_API_KEY"]
    return RoleSpec("conftest:Leaky", {"token": os.environ["SHAPED"], "note": note})
"""


def texts(folder: Path):
    """Every text in every file, as it is and unpacked."""
    for file in folder.rglob("*"):
        if not file.is_file():
            continue
        data = file.read_bytes()
        yield file.name, data
        if file.suffix == ".mcap":
            reader = make_reader(io.BytesIO(data))
            for _, channel, message in reader.iter_messages():
                yield f"{file.name} {channel.topic}", message.data
            for record in reader.iter_metadata():
                yield f"{file.name} metadata", repr(record.metadata).encode()
            for attachment in reader.iter_attachments():
                with np.load(io.BytesIO(attachment.data), allow_pickle=False) as columns:
                    for name in columns.files:
                        yield f"{file.name} {name}", columns[name].tobytes()
        for packed in re.findall(rb"[A-Za-z0-9+/=]{200,}", data):
            yield f"{file.name} packed", unpacked(packed)


def unpacked(packed):
    """What a player's data holds; nothing of what is no such data."""
    try:
        return zlib.decompress(b64decode(packed))
    except (zlib.error, ValueError):
        return b""


@pytest.fixture
def leaking(project, monkeypatch):
    monkeypatch.setenv("PLANNER_API_KEY", KEY)
    monkeypatch.setenv("SHAPED", SHAPED)
    project.write("conftest.py", CONFTEST)
    return project


@pytest.mark.parametrize("workers", [[], ["-n", "2"]], ids=["one process", "xdist"])
def test_a_planted_key_is_in_no_file(leaking, workers):
    command = ["--dura-evidence-level=all", "-o", f"junit_suite_name={KEY}", *workers]
    assert leaking.run("corridor/tight", *command).ret == 1
    evidence = leaking.evidence()
    assert [one.trace is not None for one in evidence.episodes] == [True, True]
    forms = [KEY, SHAPED, quote(KEY, safe=""), b64encode(KEY.encode()).decode().rstrip("=")]
    wide = [form.encode("utf-32-le") for form in forms]  # as numpy keeps texts
    found = [
        (name, form)
        for name, data in texts(leaking.path / "dura-evidence")
        for form in (*(form.encode() for form in forms), *wide)
        if form in data
    ]
    assert found == []
    assert evidence.redacted["PLANNER_API_KEY"] > 0
    assert "[redacted: PLANNER_API_KEY]" in str(evidence.command)


def test_the_key_would_be_found_if_it_were_there(leaking, monkeypatch):
    """The test above looks into every file: with another name nothing is a secret."""
    leaking.write("conftest.py", CONFTEST.replace("PLANNER_API_KEY", "PLAIN"))
    monkeypatch.delenv("PLANNER_API_KEY")
    monkeypatch.setenv("PLAIN", KEY)
    leaking.run("corridor/tight", "--dura-evidence-level=all")
    found = {name.partition(" ")[2] for name, data in texts(leaking.path / "dura-evidence")
             if KEY.encode() in data or KEY.encode("utf-32-le") in data}  # fmt: skip
    assert "/decision" in found
    assert "packed" in found


def test_the_project_names_further_secrets(leaking, monkeypatch):
    leaking.write("conftest.py", CONFTEST.replace("PLANNER_API_KEY", "Plain"))
    monkeypatch.setenv("Plain", KEY)
    monkeypatch.delenv("PLANNER_API_KEY")
    leaking.run("corridor/tight", "--dura-evidence-level=all", "-odura_secrets=other_* PLA?N")
    found = {name for name, data in texts(leaking.path / "dura-evidence")
             if KEY.encode() in data or KEY.encode("utf-32-le") in data}  # fmt: skip
    assert found == set()
    assert leaking.evidence().redacted["Plain"] > 0


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such modes")
def test_episodes_that_are_kept_are_the_users_alone(leaking):
    old = os.umask(0o022)
    try:
        leaking.write("stop", "")
        leaking.run("corridor/tight", "--dura-evidence=made/here", "-p", "stopping")
    finally:
        os.umask(old)
    kept = leaking.path / "made/here/.episodes"
    modes = {stat.S_IMODE(one.stat().st_mode) for one in (kept, *kept.rglob("*")) if one.is_dir()}
    assert modes == {0o700}
    files = [one for one in kept.rglob("*") if one.is_file()]
    assert {one.suffix for one in files} == {".episode", ".sources"}
    assert {stat.S_IMODE(one.stat().st_mode) for one in files} == {0o600}


def test_an_episode_whose_spec_held_a_secret_says_why_it_cannot_be_replayed(leaking):
    leaking.run("corridor/tight")
    result = leaking.run("--dura-replay=corridor/tight#0")
    assert result.ret == 4
    result.stderr.fnmatch_lines(["*what it was run from held a secret*"])


NAMES_THE_KEY = """
import os
from pytest_dura import CheckResult

def names_the_key(episode):
    return CheckResult(False, detail=f"asked with {os.environ['PLANNER_API_KEY']}")
"""


@pytest.mark.parametrize("executor", ["in-process", "processes:1"])
def test_a_key_that_a_check_names_is_in_no_file_and_not_in_the_terminal(leaking, executor):
    """Also where another process calls the check: what comes back from it is redacted here."""
    leaking.write("conftest.py", "")
    leaking.write("naming.py", NAMES_THE_KEY)
    requirement(leaking, "naming:names_the_key")
    scenario(leaking, requirements="[R-1]")
    result = leaking.run_apart("corridor/it", f"--dura-executor={executor}", "--junit-xml=j.xml")
    assert result.ret == 1
    (leaking.path / "dura-evidence" / "printed").write_text(output(result))
    shutil.copy(leaking.path / "j.xml", leaking.path / "dura-evidence")
    found = {name for name, data in texts(leaking.path / "dura-evidence") if KEY.encode() in data}
    assert found == set()
    evidence = leaking.evidence()
    said = [one.verdicts["R-1"].detail for one in evidence.episodes]
    assert said == ["asked with [redacted: PLANNER_API_KEY]"] * 2
    assert evidence.execution.executor == executor.partition(":")[0]


RAISING = """
import logging, os, sys, warnings
import pytest
from corridor import Careful, Watch

KEY, SHAPED = os.environ["PLANNER_API_KEY"], os.environ["SHAPED"]

class ShownError(Exception):
    def __str__(self):
        return chr(10).join(["refused", KEY])

class Loud(Careful):
    def propose(self, view):
        print("asks with", KEY)
        logging.getLogger("loud").warning("asks with %s", SHAPED)
        print("asks with", SHAPED, file=sys.stderr)
        if view.index == 2:
            raise RuntimeError(f"refused: {KEY} {SHAPED}")
        return super().propose(view)

class Broken(Watch):
    def run(self, view):
        raise RuntimeError(f"no answer to {KEY}")

@pytest.fixture(scope="session")
def generator():
    return Loud

@pytest.fixture
def refused():
    raise OSError(13, "refused", f"/keys/{KEY}")

@pytest.fixture
def ends_badly():
    yield
    raise ShownError

@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport():
    report = yield
    report.sections.append(("another plugin", f"asks last with {KEY}"))
    return report
"""
USES = """
import warnings
import pytest
from conftest import KEY, SHAPED, ShownError

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("GAP-1")
def test_component(episode):
    print("it was", KEY)
    assert episode.collided, f"asked with {SHAPED}"

def test_role(orchestrator):
    orchestrator.campaign("corridor/broken").require("always (gap > 0)")

@pytest.mark.parametrize("what", range(3))
def test_plain(what, record_property, ends_badly):
    record_property("asked_with", KEY)
    warnings.warn(f"asks with {KEY}")
    token = KEY
    if what == 0:
        assert token == f"another than {SHAPED}"
    if what == 1:
        try:
            raise ShownError
        except ShownError as error:
            error.add_note(f"asked with {SHAPED}") if hasattr(error, "add_note") else None
            raise KeyError({"asked": [KEY]}) from error

def test_fixture(refused):
    pass

def test_skips():
    pytest.skip(f"{KEY} is over")

@pytest.mark.xfail(reason="it is known")
def test_known():
    raise ShownError
"""


@pytest.mark.parametrize("workers", [[], ["-n", "2"]], ids=["one process", "xdist"])
def test_a_planted_key_is_in_no_report_and_not_in_the_terminal(leaking, workers):
    scenario(leaking, runs=1)
    scenario(leaking, "broken", runs=1, monitor="conftest:Broken")
    leaking.write("conftest.py", RAISING)
    leaking.write("test_it.py", USES)
    result = leaking.run_apart(
        "test_it.py", "-rA", "--showlocals", "-Wdefault", "--alluredir=allure", *workers,
        "--junit-xml=junit.xml", "-ojunit_logging=all", "-ojunit_family=xunit1",
    )  # fmt: skip
    assert result.ret == 1
    (leaking.path / "printed").write_text(output(result))
    reports = [leaking.path / "junit.xml", leaking.path / "printed"]
    reports += (leaking.path / "allure").iterdir()
    for report in reports:
        for form in (KEY, SHAPED, quote(KEY, safe=""), KEY[:14], SHAPED[:14]):
            assert form.encode() not in report.read_bytes(), report.name
    whole = b"".join(report.read_bytes() for report in reports).decode(errors="replace")
    for told in ("refused: [redacted: PLANNER_API_KEY] [redacted: ", "asks with [redacted",
                 "no answer to [redacted", "asks last with [redacted", "asked with [redacted",
                 "is over"):  # fmt: skip
        assert told in whole


SET_FOR_A_WHILE = """
import os
import pytest

KEPT = {}

@pytest.fixture
def key(monkeypatch):
    monkeypatch.setenv("LATE_API_TOKEN", "correct-horse-" + "battery-9x7")
    KEPT["key"] = os.environ["LATE_API_TOKEN"]

def test_silent(key):
    pass

@pytest.mark.dura(scenario="corridor/it", runs=1)
@pytest.mark.requirement("OWN-1", text="It stays far away.", kind="safety")
def test_speaks(episode, request):
    request.node.user_properties += ["asked with " + KEPT["key"], 5]
    print("asks with", KEPT["key"])
    assert episode.satisfies("always (gap > 100)"), "asked with " + KEPT["key"]
"""


@pytest.mark.parametrize("workers", [[], ["-n", "2"]], ids=["one process", "xdist"])
def test_a_secret_that_was_set_for_one_test_is_known_in_later_ones(leaking, workers):
    leaking.write("conftest.py", "")
    leaking.write("test_it.py", SET_FOR_A_WHILE)
    scenario(leaking, runs=1)
    result = leaking.run_apart("test_it.py", "-p", "no:allure_pytest", "--dist=loadfile", *workers)
    assert result.ret == 1
    assert "INTERNALERROR" not in output(result)
    (leaking.path / "dura-evidence" / "printed").write_text(output(result))
    key = b"correct-horse-battery-9x7"
    assert {name for name, data in texts(leaking.path / "dura-evidence") if key in data} == set()
    assert "asked with [redacted: LATE_API_TOKEN]" in output(result)


def test_reports_of_a_session_without_episodes_stay_as_they_are(leaking):
    leaking.write("conftest.py", "")
    leaking.write("test_it.py", f"def test_it(): assert {KEY!r} == 'another'")
    assert KEY in output(leaking.run("test_it.py"))
