"""Logs that the libraries of their formats wrote: each is read, whole and block by block."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import numpy as np
import pytest
from recorded_logs import Drive

from pytest_dura import ConfigurationError, read_log
from pytest_dura.logs import reading, streaming
from pytest_dura.logs.formats import mdf4, parquet
from pytest_dura.logs.inspection import inspected
from pytest_dura.logs.mapping import read_mapping

FORMATS = {
    "mcap": ("mcap", "log.mcap", ("/radar", "range"), ("/odom", "speed")),
    "ros2_mcap": ("mcap_ros2", "log.mcap", ("/radar", "range"), ("/odom", "data")),
    "protobuf_mcap": ("mcap_protobuf", "log.mcap", ("/radar", "value"), ("/odom", "value")),
    "ros1_bag": ("rosbags", "log.bag", ("/radar", "data"), ("/odom", "data")),
    "parquet": ("pyarrow", "log.parquet", ("", "radar.range"), None),
    "mdf4": ("asammdf", "log.mf4", ("0", "range"), ("1", "speed")),
}
"""Library, file, and topics and fields of gap and speed, by the method that writes it."""


@pytest.fixture(params=FORMATS)
def log(request, tmp_path):
    """A log with a gap, its drive, and its mapping."""
    library, file, gap, speed = FORMATS[request.param]
    pytest.importorskip(library, reason=f"{library} is in the extra logs alone")
    drive = Drive(2, lost=(4.0, 5.0))
    path = getattr(drive, request.param)(tmp_path / file)
    signals = {"gap": {"topic": gap[0], "field": gap[1], "unit": "m"}}
    if speed is not None:
        signals["speed"] = {"topic": speed[0], "field": speed[1], "unit": "m/s"}
    return drive, path, {"time_step": 0.05, "signals": signals, "time": {"stamps": "receipt"}}


def test_others_writers_are_read_with_their_gaps(log) -> None:
    drive, path, mapping = log
    whole = read_log(path, mapping)
    gap = whole.signal("gap")
    assert np.isnan(gap[82:98]).all()
    start = min(drive.gap_at[0], drive.speed_at[0]) if "speed" in whole.signals else drive.gap_at[0]
    grid = np.arange(80) * 0.05
    held = np.searchsorted(drive.gap_at - start, grid + 1e-9, "right") - 1
    assert gap[1:80] == pytest.approx(drive.gap[held[1:]], abs=1e-9)
    assert any(event.kind == "gap" for event in whole.events)
    if "speed" in whole.signals:
        assert whole.satisfies("always (speed > 13.9 and speed < 15.1)")
    assert any("gaps: 1" in line for line in inspected(str(path)))


def test_they_are_read_block_by_block(log, monkeypatch) -> None:
    _, path, mapping = log
    for module in (reading, parquet, mdf4):
        monkeypatch.setattr(module, "ROWS", 40)
    for name, value in (("_BLOCK", 5), ("_ENOUGH", 40)):
        monkeypatch.setattr(streaming, name, value)
    monkeypatch.setattr(streaming, "APART", 5.0)
    whole = read_log(path, mapping)
    _, blocks = streaming.stream_of(str(path), read_mapping(mapping))
    read = list(blocks)
    assert len(read) > 3
    for name in mapping["signals"]:
        for prefix in ("", "least.", "greatest."):
            parts = np.concatenate([block.get(prefix + name, block[name]) for block in read])
            expected = whole.signals.get(prefix + name, whole.signals[name])
            assert np.array_equal(parts, expected, equal_nan=True), prefix + name


# asammdf's finalizer fails on what it could not open; it runs within this test.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_log_that_is_cut_short_is_never_judged(log) -> None:
    _, path, mapping = log
    data = path.read_bytes()
    for share in (0.5, 0.98):
        path.write_bytes(data[: int(len(data) * share)])
        with pytest.raises(ConfigurationError, match="the log cannot be read"):
            read_log(path, mapping)
    path.write_bytes(b"")
    with pytest.raises(ConfigurationError, match="the log cannot be read"):
        read_log(path, mapping)
    gc.collect()


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_bags_of_ros_2_are_read_in_both_storages(storage, tmp_path) -> None:
    pytest.importorskip("rosbags")
    drive = Drive(0)
    bag = drive.bag(tmp_path / "bag", storage)
    mapping = {"time_step": 0.05, "signals": {"gap": {"topic": "/gap", "field": "data"}}}
    log = read_log(bag, mapping)
    assert log.robustness("always (gap > 3)") == pytest.approx(drive.gap.min() - 3)


@pytest.mark.parametrize("form", ["mcap", "mdf4"])
def test_the_unit_of_a_format_is_not_guessed_from_distances(form, tmp_path) -> None:
    if form == "mdf4":
        pytest.importorskip("asammdf", reason="asammdf is in the extra logs alone")
    drive = Drive(0)
    drive.nanoseconds = lambda at: [round(second * 1e9) for second in at]
    drive.gap_at, drive.gap = np.arange(5) * 0.001, np.arange(5.0) + 1  # at 1 kHz, from 0 on
    if form == "mdf4":
        drive.gap_at *= 10_000  # and once in 10 s
    file = getattr(drive, form)(tmp_path / ("log.mcap" if form == "mcap" else "log.mf4"))
    topic, field = FORMATS[form][2]
    step = float(drive.gap_at[1])
    log = read_log(file, {"time_step": step, "signals": {"g": {"topic": topic, "field": field}}})
    assert log.time[-1] == pytest.approx(4 * step)
    assert log.signal("g").tolist() == [1, 2, 3, 4, 5]


PUBLIC = os.environ.get("DURA_PUBLIC_LOGS", "")


@pytest.mark.skipif(not PUBLIC, reason="DURA_PUBLIC_LOGS names no folder of public logs")
def test_public_logs_are_read_whole_and_block_by_block(monkeypatch) -> None:
    """Such as those in test/asammdf/gui/resources of the source distribution of asammdf."""
    monkeypatch.setattr(mdf4, "ROWS", 500)
    monkeypatch.setattr(streaming, "_BLOCK", 500)
    files = sorted(path for path in Path(PUBLIC).rglob("*") if path.suffix in LOGS)
    assert files
    for file in files:
        for topic in reading.format_of(file).topics(file):
            names = {f"s{place}": name for place, name in enumerate(topic.fields)}
            signals = {key: {"topic": topic.name, "field": name} for key, name in names.items()}
            mapping = {"signals": signals}
            whole = read_log(file, mapping)
            assert len(whole.time) > 1
            mapping["time_step"] = whole.spec.time_step
            _, blocks = streaming.stream_of(str(file), read_mapping(mapping))
            read = list(blocks)
            for name in names:
                parts = np.concatenate([block[name] for block in read])
                assert np.array_equal(parts, whole.signal(name), equal_nan=True), (file, name)


LOGS = (".mf4", ".bag", ".mcap", ".parquet", ".csv")
