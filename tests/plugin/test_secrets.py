"""A key that is planted wherever a session could pick it up is in no file of its bundle."""

from __future__ import annotations

import io
import os
import re
import stat
import zlib
from base64 import b64decode, b64encode
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
from mcap.reader import make_reader

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
        leaking.run("corridor/tight", "--dura-reuse=kept/here")
    finally:
        os.umask(old)
    kept = leaking.path / "kept/here"
    modes = {stat.S_IMODE(one.stat().st_mode) for one in (kept, *kept.rglob("*")) if one.is_dir()}
    assert modes == {0o700}
    files = [one for one in kept.rglob("*") if one.is_file()]
    assert {stat.S_IMODE(one.stat().st_mode) for one in files} == {0o600}


def test_an_episode_whose_spec_held_a_secret_says_why_it_cannot_be_replayed(leaking):
    leaking.run("corridor/tight")
    result = leaking.run("--dura-replay=corridor/tight#0")
    assert result.ret == 4
    result.stderr.fnmatch_lines(["*what it was run from held a secret*"])
