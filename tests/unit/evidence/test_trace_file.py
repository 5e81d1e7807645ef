from __future__ import annotations

import io
import json
import pickle
import struct
import tracemalloc
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from handmade import handmade
from mcap.reader import make_reader
from mcap.writer import Writer
from traces import same, simple_trace

from pytest_dura.core import ConfigurationError, Recording
from pytest_dura.evidence import (
    Trace,
    mcap,
    pack_columns,
    read_trace,
    trace_bytes,
    unpack_columns,
    write_trace,
)
from pytest_dura.evidence.foxglove import (
    CHANNELS,
    EGO_COLOR,
    GHOST_COLOR,
    PERCEIVED_COLOR,
    schema_of,
)
from pytest_dura.evidence.mcap import COLUMNS_ATTACHMENT

# As published: https://github.com/foxglove/foxglove-sdk, schemas/jsonschema.
PUBLISHED = {
    "foxglove.Log": "timestamp level message name file line",
    "foxglove.SceneUpdate": "deletions entities",
    "foxglove.SceneEntity": "timestamp frame_id id lifetime frame_locked metadata arrows cubes "
    "spheres cylinders lines triangles texts models",
    "foxglove.CubePrimitive": "pose size color",
    "foxglove.LinePrimitive": "type pose thickness scale_invariant points color colors indices",
    "foxglove.TextPrimitive": "pose billboard font_size scale_invariant color text",
    "foxglove.Pose": "position orientation",
    "foxglove.Quaternion": "x y z w",
    "foxglove.Vector3": "x y z",
    "foxglove.Point3": "x y z",
    "foxglove.Color": "r g b a",
    "foxglove.KeyValuePair": "key value",
    "time": "sec nsec",
    "duration": "sec nsec",
}


def messages(data, topic=None):
    """Time and content of each message, by the library's own reader."""
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    return [
        (message.log_time, json.loads(message.data))
        for _, _, message in reader.iter_messages(topics=topic)
    ]


def entity(data, topic, tick):
    (found,) = messages(data, topic)[tick][1]["entities"]
    return found


def test_the_file_is_what_foxglove_reads():
    reader = make_reader(io.BytesIO(trace_bytes(simple_trace())), validate_crcs=True)
    assert reader.get_header().library == "pytest-dura"  # the bytes change with no version
    summary = reader.get_summary()
    assert [one.topic for one in summary.channels.values()] == list(CHANNELS)
    assert {one.message_encoding for one in summary.channels.values()} == {"json"}
    assert {one.encoding for one in summary.schemas.values()} == {"jsonschema"}
    names = {one.name for one in summary.schemas.values()}
    assert {"foxglove.SceneUpdate", "foxglove.Log"} < names
    assert summary.statistics.message_count == 4 + 3 + 1 + 1 + 4 + 4
    (attachment,) = reader.iter_attachments()
    assert (attachment.name, attachment.media_type) == (COLUMNS_ATTACHMENT, "application/x-npz")
    assert {one.name for one in reader.iter_metadata()} == {"trace", "about"}


def titled(schema):
    if isinstance(schema, dict):
        if "properties" in schema and "title" in schema:
            yield schema["title"], " ".join(schema["properties"])
        for one in schema.values():
            yield from titled(one)


def test_the_schemas_have_the_published_fields():
    found = {name: fields for channel in CHANNELS for name, fields in titled(schema_of(channel))}
    assert {name: found[name] for name in PUBLISHED} == PUBLISHED


def test_signals_and_decisions():
    data = trace_bytes(simple_trace())
    time, signals = messages(data, "/signals")[3]
    assert time == 300_000_000
    assert signals == {
        "tick": 3, "time": pytest.approx(0.3), "truth": {"gap": 1.0}, "percept": {"gap": 3.5},
    }  # fmt: skip
    assert messages(data, "/signals")[0][1]["percept"] == {"gap": None}
    time, decision = messages(data, "/decision")[2]
    assert time == 200_000_000
    columns = {
        "verdict": 2, "source": "recovery", "proposed": "drive", "executed": "brake", "attempts": 0,
    }  # fmt: skip
    assert decision == {
        "tick": 2, "time": 0.2, "columns": columns, "explanation": "keep going 2",
        "reason": "too near", "recovery": "brake: too near", "flags": {"safety_monitor": 2},
        "account": {},
    }  # fmt: skip
    assert messages(data, "/events") == [
        (
            200_000_000,
            {"timestamp": {"sec": 0, "nsec": 200_000_000}, "level": 3, "message": "alert V1",
             "name": "alert", "file": "", "line": 0},
        )
    ]  # fmt: skip


def test_the_scene_is_turned_upright():
    """In the trace y points down and angles go clockwise: to head for +90 degrees is to go down."""
    data = trace_bytes(simple_trace())
    found = entity(data, "/scene/truth", 3)
    ego, standing = found["cubes"]
    assert ego["pose"]["position"] == {"x": 3.0, "y": -1.0, "z": 0.75}
    turn = ego["pose"]["orientation"]
    assert (turn["z"], turn["w"]) == pytest.approx((-np.sqrt(0.5), np.sqrt(0.5)), abs=1e-5)
    assert ego["size"] == {"x": 5.0, "y": 2.0, "z": 1.5}
    assert ego["color"] == json.loads(EGO_COLOR) != standing["color"]
    assert [one["text"] for one in found["texts"]] == ["EGO", "V1"]
    assert found["frame_id"] == "map"
    ((time, road),) = messages(data, "/scene/road")
    assert time == 0
    (line,) = road["entities"][0]["lines"]
    assert line["points"] == [{"x": -5.0, "y": -2.0, "z": 0}, {"x": 30.0, "y": -2.0, "z": 0}]


def test_a_ghost_is_what_is_perceived_and_not_there():
    data = trace_bytes(simple_trace())
    before, after = (entity(data, "/scene/percept", tick) for tick in (1, 2))
    assert [one["color"] for one in before["cubes"]] == [json.loads(PERCEIVED_COLOR)] * 2
    assert [one["color"] for one in after["cubes"]] == [
        *[json.loads(PERCEIVED_COLOR)] * 2,
        json.loads(GHOST_COLOR),
    ]
    assert before["texts"] == []
    assert [one["text"] for one in after["texts"]] == ["ghost (ghost)"]


def test_hostile_texts_are_shown_harmless_and_kept_exactly():
    hostile = "<script>\x1b[31m\u202e\ud800\x00" + "x" * 2000
    recording = replace(simple_trace().recording, explanations=(hostile, "%s", "../" * 9))
    trace = simple_trace(recording=recording)
    shown = [one["explanation"] for _, one in messages(trace_bytes(trace), "/decision")]
    assert shown[0].startswith("<script>\\x1b[31m\\u202e\\ud800\\x00x")
    assert len(shown[0]) <= 1000
    assert "(2016 characters" in shown[0]
    assert shown[1:] == ["%s", "../" * 9]
    assert unpack_columns(pack_columns(trace)).recording.explanations[0] == hostile


def test_an_episode_without_a_scene_or_a_tick(tmp_path):
    bare = simple_trace(recording=Recording(problem="the simulator cannot show it"))
    assert messages(trace_bytes(bare), "/scene/truth") == []
    empty = replace(
        bare, time=np.empty(0), signals={}, decisions={"verdict": np.empty(0, np.int8)}, events=[]
    )
    write_trace(tmp_path / "it.mcap", empty)
    assert same(read_trace(tmp_path / "it.mcap"), empty)


def test_verdicts_are_metadata_and_change_nothing_else(tmp_path):
    data = trace_bytes(simple_trace(), [{"requirement": "SAF-1", "verdict": "violated"}])
    found = {one.name: one.metadata for one in make_reader(io.BytesIO(data)).iter_metadata()}
    assert json.loads(found["verdicts"]["0"]) == {"requirement": "SAF-1", "verdict": "violated"}
    (tmp_path / "it.mcap").write_bytes(data)
    assert same(read_trace(tmp_path / "it.mcap"), simple_trace())


def test_nothing_half_written_stays(tmp_path, monkeypatch):
    def full(*_):
        raise OSError("no space left")

    monkeypatch.setattr("os.fdopen", full)
    with pytest.raises(OSError, match="no space left"):
        write_trace(tmp_path / "it.mcap", simple_trace())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "change",
    [
        {"signals": {"gap": np.zeros(3)}},
        {"signals": {"gap": np.zeros(4, np.float32)}},
        {"time": np.zeros((4, 1))},
        {"decisions": {"verdict": np.array([object()] * 3)}},
    ],
)
def test_what_is_no_trace_is_refused(change):
    with pytest.raises(ValueError, match="the column"):
        pack_columns(simple_trace(**change))


def file_with(columns, version="1"):
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    writer.add_metadata("trace", {"schema_version": version})
    for data in columns:
        writer.add_attachment(0, 0, COLUMNS_ATTACHMENT, "", data)
    writer.finish()
    return stream.getvalue()


def archive(changes):
    """The columns with other members."""
    source = zipfile.ZipFile(io.BytesIO(pack_columns(simple_trace())))
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as target:
        for name in source.namelist():
            data = changes.get(name, source.read(name))
            if data is not None:
                target.writestr(name, data)
    return stream.getvalue()


class Bomb:
    def __reduce__(self):
        return (pytest.fail, ("it was run",))


def pickled():
    stream = io.BytesIO()
    array = np.array([Bomb()], object)
    np.lib.format.write_array_header_1_0(stream, np.lib.format.header_data_from_array_1_0(array))
    return stream.getvalue() + pickle.dumps(array)


def column(array):
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def texts(**changes):
    data = np.load(io.BytesIO(pack_columns(simple_trace())))["texts"].tobytes()
    return column(np.frombuffer(json.dumps(json.loads(data) | changes).encode(), np.uint8))


HUGE = np.lib.format.header_data_from_array_1_0(np.zeros(0)) | {"shape": (10**15,)}


def huge():
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, HUGE)
    return stream.getvalue()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x89MCAP0\r\n",
        b"\x89MCAP0\r\n" * 9,
        b"PK\x03\x04",
        file_with([]),
        file_with([b"no archive"]),
        file_with([pack_columns(simple_trace())] * 2),
        file_with([archive({"time.npy": None})]),
        file_with([archive({"time.npy": pickled()})]),
        file_with([archive({"time.npy": huge()})]),
        file_with([archive({"time.npy": column(np.zeros(5))})]),
        file_with([archive({"signals.npy": column(np.zeros((9, 4)))})]),
        file_with([archive({"flags.npy": column(np.zeros((1, 3)))})]),
        file_with([archive({"truth.npy": column(np.zeros((4, 2, 7), np.float32))})]),
        file_with([archive({"said.reasons.npy": column(np.array([0, 9, 0], np.int32))})]),
        file_with([archive({"said.reasons.npy": column(np.array([0, -1, 0], np.int32))})]),
        file_with([archive({"time.npy": column(np.zeros(4)) + bytes(8)})]),
        file_with([archive({"texts.npy": column(np.frombuffer(b"[" * 99999, np.uint8))})]),
        file_with([archive({"texts.npy": texts(signals=3)})]),
        file_with([archive({"texts.npy": texts(events=[3])})]),
        file_with([archive({"texts.npy": texts(scene={"truth": []})})]),
        file_with([archive({"texts.npy": texts(decisions={"x": {"dtype": "O", "table": []}})})]),
        file_with(
            [archive({"texts.npy": texts(decisions={"x": {"dtype": "<U999999999", "table": []}})})]
        ),
        file_with([archive({})], version="2"),
    ],
)
def test_a_damaged_or_hostile_file_is_one_error(tmp_path, data):
    file = tmp_path / "it.mcap"
    file.write_bytes(data)
    with pytest.raises(ConfigurationError, match=r"no trace|another version"):
        read_trace(file)


def test_an_archive_that_unpacks_to_more_than_any_trace(monkeypatch):
    data = pack_columns(simple_trace())
    monkeypatch.setattr("pytest_dura.evidence.mcap.MAX_UNPACKED_BYTES", -20_000)
    with pytest.raises(ValueError, match="larger than"):
        unpack_columns(data)


def test_a_member_that_unpacks_to_more_than_it_declares():
    """Sixteen megabytes that say that they are a column of four, and are not even unpacked."""
    honest, lie = column(np.zeros(4)), column(np.zeros(2**21))
    data = archive({"time.npy": lie})
    size = struct.pack("<L", len(lie))
    assert data.count(size) == 2  # in the member's own header, and in the index
    data = data.replace(size, struct.pack("<L", len(honest)))
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="damaged"):
            unpack_columns(data)
        assert tracemalloc.get_traced_memory()[1] < len(lie) / 4
    finally:
        tracemalloc.stop()


def test_there_is_no_file(tmp_path):
    with pytest.raises(ConfigurationError, match="cannot be read: No such file"):
        read_trace(tmp_path / "it.mcap")


def told_episode(*accounts):
    """An episode whose recording holds these accounts."""
    found = handmade(len(accounts) + 1)
    found.decisions = {"verdict": np.zeros(len(accounts), np.int8)}
    found.recording = Recording(accounts=accounts)
    return found


def test_what_the_component_told_stands_beside_its_decision():
    account = {"decided": True, "cited": ["V1", "\x1b[31m"], "null": {"cited": []}, "seconds": 0.5}
    trace = Trace.of(told_episode(account, {}))
    # The null component told it of itself, and a time would differ in every run.
    kept = {"decided": True, "cited": ["V1", "\x1b[31m"]}
    assert trace.recording.accounts == (kept, {})
    data = trace_bytes(trace)
    assert unpack_columns(pack_columns(trace)).recording.accounts == (kept, {})
    shown = [one["account"] for _, one in messages(data, "/decision")]
    assert shown == [{"decided": True, "cited": ["V1", "\\x1b[31m"]}, {}]


def test_secrets_are_taken_out_of_accounts():
    def redact(data):
        return json.loads(json.dumps(data).replace("hunter2", "***"))

    trace = Trace.of(told_episode({"cited": ["hunter2"]}, {}))
    assert trace.without_secrets(redact).recording.accounts == ({"cited": ["***"]}, {})


def test_columns_of_before_there_were_accounts_are_read():
    with zipfile.ZipFile(io.BytesIO(pack_columns(simple_trace()))) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    del members["accounts.npy"]
    texts = np.load(io.BytesIO(members["texts.npy"])).tobytes()
    told = json.loads(texts)
    del told["accounts"]
    array = np.frombuffer(json.dumps(told).encode(), np.uint8)
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array, version=(1, 0))
    members["texts.npy"] = stream.getvalue()
    old = io.BytesIO()
    with zipfile.ZipFile(old, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    assert same(unpack_columns(old.getvalue()), simple_trace())


@pytest.mark.parametrize("text", ["[]", '{"a":' * 50 + "1" + "}" * 50, '{"a":NaN}'])
def test_an_account_that_no_component_could_have_given_is_damage(text, monkeypatch):
    trace = simple_trace(recording=Recording(accounts=({"a": 1},) * 3))
    honest = mcap._compact
    monkeypatch.setattr(mcap, "_compact", lambda one: text if one == {"a": 1} else honest(one))
    data = pack_columns(trace)
    with pytest.raises(ValueError, match="damaged"):
        unpack_columns(data)
