"""A record read one episode at a time is the record, whatever else lies in the file."""

from __future__ import annotations

import json

import pytest
from session_records import episode, session_record

from pytest_dura.core import ConfigurationError
from pytest_dura.evidence import SCHEMA_VERSION, bundle, open_record, write_record
from pytest_dura.evidence.files import stream_record

HOSTILE = '}\n ],\n "episodes": [\n  {\n'


@pytest.fixture(autouse=True)
def _streamed(monkeypatch):
    monkeypatch.setattr(bundle, "STREAMED_BYTES", 0)


def whole(file):
    found = json.loads(file.read_text())
    episodes = found.pop("episodes")
    return found, episodes


def test_it_is_what_the_whole_file_says(tmp_path):
    changed = episode("a/clear", 9, invalid_reason=HOSTILE)
    changed["events"][0]["data"] = {"episodes": [{}, {"x": [{}]}], HOSTILE: HOSTILE}
    write_record(
        tmp_path, session_record(tmp_path, command=HOSTILE, episodes=[changed, episode("b", 1)])
    )
    file = tmp_path / "evidence.json"
    found = stream_record(file, json.loads)
    head, episodes = whole(file)
    assert found.head == head
    assert list(found.episodes()) == episodes == list(found.episodes())
    record = open_record(tmp_path / "evidence.json")
    assert record.to_json() == {**head, "episodes": episodes}
    assert found.head == record.head.to_json()


@pytest.mark.parametrize(
    "text",
    [
        '{\n "episodes": [],\n "schema_version": "1"\n}\n',
        '{\n "x": {\n "episodes": [\n  {\n  }\n ]\n}\n}\n',
        '{\n "episodes": [\n  {\n  }\n ],\n "x": {\n "episodes": [\n  {\n  }\n ]\n}\n}\n',
        '{\n "episodes": [\n  {\n  }\n ],\n "episodes": [\n  {\n  }\n ]\n}\n',
        '{\n "episodes": [\n  {\n  },\n ]\n}\n',
        '{\n "episodes": [\n  {\n  }\n  {\n  }\n ]\n}\n',
        '{\n "episodes": [\n  {\n  }\n',
        '{\n "episodes": [\n  {\n "x": {\n  }\n  }\n ]\n}\n',
        '{\n "episodes": [\n ]\n}\n',
        '{"episodes": [{}]}',
        "",
    ],
    ids=range(11),
)
def test_another_layout_is_left_to_whoever_reads_it_as_a_whole(tmp_path, text):
    (tmp_path / "evidence.json").write_text(text)
    assert stream_record(tmp_path / "evidence.json", json.loads) is None


@pytest.mark.parametrize("spoilt", ['  "id": "twice",\n', '  "number": NaN,\n'])
def test_it_is_as_strict(tmp_path, spoilt):
    write_record(tmp_path, session_record(tmp_path))
    file = tmp_path / "evidence.json"
    opening = '"episodes": [\n  {\n'
    file.write_text(file.read_text().replace(opening, f"{opening} {spoilt}", 1))
    with pytest.raises(ConfigurationError, match="no evidence record"):
        open_record(tmp_path / "evidence.json")


def test_another_version_is_told_as_such(tmp_path):
    file = write_record(tmp_path, session_record(tmp_path))
    file.write_text(
        file.read_text().replace(f'"schema_version": "{SCHEMA_VERSION}"', '"schema_version": "99"')
    )
    with pytest.raises(ConfigurationError, match="another version"):
        open_record(tmp_path / "evidence.json")


def test_a_file_that_changes_is_told(tmp_path):
    write_record(tmp_path, session_record(tmp_path))
    record = open_record(tmp_path / "evidence.json")
    (tmp_path / "evidence.json").write_text("{}\n")
    with pytest.raises(ConfigurationError, match="changed while it was read"):
        list(record.episodes())


def test_a_small_one_is_in_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(bundle, "STREAMED_BYTES", 8 << 20)
    write_record(tmp_path, session_record(tmp_path))
    record = open_record(tmp_path / "evidence.json")
    (tmp_path / "evidence.json").unlink()
    assert len(list(record.episodes())) == 6
