from __future__ import annotations

import json
import math

import numpy as np
import pytest
from session_records import session_data

from pytest_dura import ConfigurationError
from pytest_dura.core import files
from pytest_dura.evidence import (
    MANIFEST_FILE,
    SessionRecord,
    all_formats,
    bundle,
    plain_data,
)


def test_plain_data_holds_builtins_only():
    made = plain_data(
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
        plain_data({"a": [object()]})


RECORD = session_data(command="gap ≥ 0.5")


def write(folder, record):
    return bundle.write_record(folder, SessionRecord.of(record, folder))


def read(folder):
    return bundle.open_record(folder / "evidence.json").to_json()


def test_what_is_written_and_read_back_is_equal(tmp_path):
    file = write(tmp_path / "new" / "folder", RECORD)
    assert read(file.parent) == RECORD


def test_a_failed_write_leaves_the_old_record_and_no_rubbish(tmp_path, monkeypatch):
    write(tmp_path, RECORD)

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(ConfigurationError, match="No space left on device"):
        write(tmp_path, {**RECORD, "base_seed": 2})
    assert [file.name for file in tmp_path.iterdir()] == ["evidence.json"]
    assert json.loads((tmp_path / "evidence.json").read_text()) == RECORD


def test_reading_explains_what_is_wrong(tmp_path):
    with pytest.raises(ConfigurationError, match="there is no evidence here"):
        read(tmp_path)
    (tmp_path / "evidence.json").write_bytes(b"\xff\x00")
    with pytest.raises(ConfigurationError, match="this is no evidence record"):
        read(tmp_path)


def test_the_text_is_that_of_the_whole_record_at_once(tmp_path):
    record = {**RECORD, "command": "line\nbreak", "redacted": {"a\n": 1}}
    for told in (record, {**record, "episodes": []}):
        text = write(tmp_path, told).read_text()
        assert json.loads(text) == told
        assert text == json.dumps(json.loads(text), indent=1, ensure_ascii=False) + "\n"


def test_what_a_terminal_would_act_on_is_escaped_and_letters_are_themselves(tmp_path):
    record = {**RECORD, "command": "naïve 漢字 😀 \x1b[31m\x7f\x9b2J\u202e\u2028\U000e0041\ufeff"}
    text = write(tmp_path, record).read_text()
    assert "naïve 漢字 😀 " in text
    assert text.replace("\n", "").isprintable()
    assert read(tmp_path) == record


def test_a_name_that_is_no_text_can_be_written_and_read(tmp_path):
    record = {**RECORD, "command": "caf\udce9"}
    write(tmp_path, record)
    assert read(tmp_path) == record


def test_a_link_is_replaced_and_never_followed(tmp_path):
    outside = tmp_path / "outside"
    outside.write_text("mine")
    folder = tmp_path / "evidence"
    folder.mkdir()
    (folder / "evidence.json").symlink_to(outside)
    with pytest.raises(ConfigurationError, match="symbolic link"):
        read(folder)
    write(folder, RECORD)
    assert outside.read_text() == "mine"
    assert read(folder) == RECORD


def test_a_record_without_episodes_is_none(tmp_path):
    (tmp_path / "evidence.json").write_text(json.dumps({**RECORD, "episodes": {}}))
    with pytest.raises(ConfigurationError, match="damaged") as error:
        read(tmp_path)
    assert (error.value.key, error.value.found) == ("/episodes", "object")
    assert error.value.expected == "array"


def test_every_file_of_a_bundle_is_known_to_whoever_clears_it():
    known = {MANIFEST_FILE, *(one.FILE for one in all_formats())}
    assert set(bundle.rendered_files()) == known


def test_a_session_that_begins_removes_what_is_left_of_the_last_one(tmp_path):
    folder, outside = tmp_path / "evidence", tmp_path / "outside"
    write(folder, RECORD)
    own = [*bundle.rendered_files(), ".evidence.json-x7", ".session-q",
           "episodes/a-0123abcd.mcap", "episodes/.b-0123abcd.mcap-x7_y"]  # fmt: skip
    others = ["notes.txt", "report.html.bak", "episodes/notes.txt", "reduced/evidence.json",
              ".hidden", "episodes/drive.mcap", "episodes/.drive.mcap-x7"]  # fmt: skip
    for name in (*own, *others):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("old")
    outside.write_text("mine")
    (folder / "report.html").unlink()
    (folder / "report.html").symlink_to(outside)
    new = {**RECORD, "command": "new"}
    bundle.begin_bundle(SessionRecord.of(new, folder))
    left = {str(one.relative_to(folder)) for one in folder.rglob("*") if not one.is_dir()}
    assert left == {"evidence.json", *others}
    assert read(folder) == new
    assert outside.read_text() == "mine"


def test_a_linked_folder_of_traces_is_not_followed(tmp_path):
    folder, outside = tmp_path / "evidence", tmp_path / "outside"
    outside.mkdir()
    (outside / "a.mcap").write_text("mine")
    write(folder, RECORD)
    (folder / "episodes").symlink_to(outside)
    bundle.clear_bundle(folder)
    assert not (folder / "episodes").exists()
    assert (outside / "a.mcap").read_text() == "mine"


def test_files_of_others_are_left_alone_where_no_record_was(tmp_path):
    (tmp_path / "summary.md").write_text("mine")
    bundle.begin_bundle(SessionRecord.of(RECORD, tmp_path))
    assert (tmp_path / "summary.md").read_text() == "mine"
