from __future__ import annotations

import json
import math

import numpy as np
import pytest

from pytest_dura import ConfigurationError
from pytest_dura.evidence import bundle, files
from pytest_dura.evidence.plain import plain
from pytest_dura.evidence.session_record import SessionRecord


def test_plain_data_holds_builtins_only():
    made = plain(
        {
            "a": np.float64(1.5),
            "b": (np.int64(2), [True, None]),
            3: np.array([1.0, np.nan]),
            "inf": -math.inf,
            "flag": np.bool_(True),
        }
    )
    assert made == {"a": 1.5, "b": [2, [True, None]], "3": [1.0, None], "inf": None, "flag": True}
    assert [type(made[key]) for key in ("a", "flag")] == [float, bool]


def test_what_is_no_data_is_refused():
    with pytest.raises(TypeError, match="object is not plain data"):
        plain({"a": [object()]})


RECORD = {"schema_version": "1", "text": "gap ≥ 0.5", "number": 0.1, "cases": [], "episodes": []}


def write(folder, record):
    return bundle.write_record(folder, SessionRecord.of(record, folder))


def test_what_is_written_and_read_back_is_equal(tmp_path):
    file = write(tmp_path / "new" / "folder", RECORD)
    assert bundle.read_record(file.parent) == RECORD


def test_a_failed_write_leaves_the_old_record_and_no_rubbish(tmp_path, monkeypatch):
    write(tmp_path, RECORD)

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(ConfigurationError, match="No space left on device"):
        write(tmp_path, {**RECORD, "number": 2})
    assert [file.name for file in tmp_path.iterdir()] == ["evidence.json"]
    assert json.loads((tmp_path / "evidence.json").read_text()) == RECORD


def test_reading_explains_what_is_wrong(tmp_path):
    with pytest.raises(ConfigurationError, match="there is no evidence here"):
        bundle.read_record(tmp_path)
    (tmp_path / "evidence.json").write_bytes(b"\xff\x00")
    with pytest.raises(ConfigurationError, match="this is no evidence record"):
        bundle.read_record(tmp_path)
