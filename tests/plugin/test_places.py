from __future__ import annotations

import ntpath
from pathlib import PureWindowsPath

import pytest

from pytest_dura.plugin import messages


@pytest.mark.parametrize(
    "file, told",
    [("C:\\work\\ev\\report.html", "ev\\report.html"), ("D:\\ev\\x.html", "D:\\ev\\x.html")],
)
def test_evidence_on_another_drive_is_told_in_full(monkeypatch, file, told):
    monkeypatch.setattr(messages.os.path, "relpath", ntpath.relpath)
    assert messages.typed_path(PureWindowsPath(file), PureWindowsPath("C:\\work")) == told
