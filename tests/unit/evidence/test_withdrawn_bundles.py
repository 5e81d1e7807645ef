"""A bundle that cannot be written as a whole never reads as a pass."""

from __future__ import annotations

import errno

import pytest
from session_records import session_record

from pytest_dura import ConfigurationError
from pytest_dura.evidence import bundle, files, open_record, write_record


def passing(folder, **changes):
    gate = {"result": "passed", "exit_code": 0, "reasons": []}
    return session_record(folder, gate=gate, **changes)


def running(folder):
    gate = {"result": "incomplete", "exit_code": 3, "reasons": ["it is running"]}
    write_record(folder, session_record(folder, status="running", gate=gate))


def disk_full_from(monkeypatch, number):
    """The first files can be written, and from this one on nothing more."""
    written = iter(range(10**6))
    really = files.write_file

    def write(file, chunks):
        if next(written) >= number:
            raise ConfigurationError("the evidence cannot be written: " + errno.errorcode[28])
        return really(file, chunks)

    monkeypatch.setattr(bundle, "write_file", write)
    monkeypatch.setattr("pytest_dura.evidence.bundle.write_file", write)


@pytest.mark.parametrize("number", [0, 1, 4])
def test_a_disk_that_is_full_leaves_no_pass(tmp_path, monkeypatch, number):
    running(tmp_path)
    disk_full_from(monkeypatch, number)
    with pytest.raises(ConfigurationError, match="ENOSPC"):
        bundle.write_bundle(passing(tmp_path))
    assert not {*bundle.rendered_files()} & {file.name for file in tmp_path.iterdir()}
    if number == 0:
        assert open_record(tmp_path / "evidence.json").head.status == "running"
    else:
        assert not (tmp_path / "evidence.json").exists(), "there was no room to take it back"


def test_ctrl_c_while_files_are_written_leaves_a_record_that_says_so(tmp_path, monkeypatch):
    running(tmp_path)

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(bundle, "manifest_text", stopped)
    with pytest.raises(KeyboardInterrupt):
        bundle.write_bundle(passing(tmp_path))
    assert [file.name for file in tmp_path.iterdir()] == ["evidence.json"]
    record = open_record(tmp_path / "evidence.json")
    assert (record.head.status, record.head.gate.result) == ("interrupted", "incomplete")
    assert record.head.gate.exit_code == 1
    assert record.head.totals.gate == "incomplete"
    (why,) = record.head.gate.reasons
    assert why.startswith("infrastructure: the evidence could not be written as a whole: Keyboard")
