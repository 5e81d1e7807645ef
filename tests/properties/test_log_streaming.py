"""A log read block by block: its signals, and its verdicts, are those of the log as a whole."""

from __future__ import annotations

import os
from collections import Counter
from threading import Thread

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_logs import Drive

from pytest_dura import ConfigurationError, read_log
from pytest_dura.logs import reading, streaming
from pytest_dura.logs.formats import csv as csv_format
from pytest_dura.logs.judging import judge_log, watched_lines
from pytest_dura.logs.mapping import read_mapping
from pytest_dura.requirements.checks import read_formula
from pytest_dura.requirements.episode_verdicts import evaluate_episode

CHECKS = (
    "always (a > -2)",
    "always (a > 1 implies eventually[0:1] (b < 2))",
    "eventually (a > 2 and b < 0)",
    "always (once[0:2] (a > -1))",
    "always (b > 1 implies (a < 2 since b > 0))",
)
STEP = 0.25


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch):
    monkeypatch.setattr(csv_format, "ROWS", 7)
    monkeypatch.setattr(streaming, "_BLOCK", 5)
    monkeypatch.setattr(streaming, "_ENOUGH", 5)
    monkeypatch.setattr(streaming, "APART", 5.0)


def test_a_log_read_block_by_block_is_the_log_as_a_whole(tmp_path) -> None:
    file = tmp_path / "log.csv"
    statuses: Counter[str] = Counter()
    methods = st.sampled_from(["hold", "linear", "nearest"])

    @settings(max_examples=300, derandomize=True, deadline=None)
    @given(
        methods,
        methods,
        st.sampled_from([0.0, 0.1, 0.4]),
        st.sampled_from([0.0, 0.05, 0.3]),
        st.integers(0, 2**31),
    )
    def law(first, second, lacking, jitter, seed) -> None:
        random = np.random.default_rng(seed)
        count = int(random.integers(12, 90))
        time = np.arange(count) * STEP + random.uniform(-jitter, jitter, count)
        keep = np.ones(count, bool)
        gap = int(random.integers(0, count))
        keep[gap : gap + int(random.integers(0, 30))] = False
        keep[[0, -1]] = True
        lines = ["time,a,b"]
        for at in time[keep] - time.min():
            cells = [
                "" if random.random() < lacking else str(int(v)) for v in random.integers(-3, 4, 2)
            ]
            lines.append(f"{at:.3f},{cells[0]},{cells[1]}")
        lines[1] = f"{lines[1].partition(',')[0]},0,0"
        file.write_text("\n".join(lines) + "\n")
        mapping = {
            "time_step": STEP,
            "signals": {
                "a": {"method": first, "longest_gap": 0.6},
                "b": {"method": second, "longest_gap": 1.1},
            },
        }
        whole = read_log(file, mapping)
        _, blocks = streaming.stream_of(str(file), read_mapping(mapping))
        read = list(blocks)
        for name in ("a", "b"):
            for prefix in ("", "least.", "greatest."):
                parts = [block.get(prefix + name, block[name]) for block in read]
                expected = whole.signals.get(prefix + name, whole.signals[name])
                assert np.array_equal(np.concatenate(parts), expected, equal_nan=True)
        found, _ = judge_log(file, mapping, {check: check for check in CHECKS})
        for check in CHECKS:
            expected, _ = evaluate_episode(read_formula(check), whole)
            ours = found[check]
            assert (ours.status, ours.lower, ours.upper, ours.time) == (
                expected.status, expected.lower, expected.upper, expected.time,
            )  # fmt: skip
            assert (ours.margin, ours.vacuous) == (expected.margin, expected.vacuous)
            statuses[ours.status] += 1

    law()
    assert min(statuses.values()) > 100, statuses


def test_what_no_formula_reads_has_its_part_in_the_time_of_a_log(tmp_path) -> None:
    """The step, the time 0 and the end are those of all signals, whatever is judged."""
    file = tmp_path / "log.csv"
    statuses: Counter[str] = Counter()
    checks = ("always (a > -2)", "eventually (a > 2)", "eventually[0:1] (a > 2)")
    signals = {"a": {"longest_gap": 0.6}, "b": {"longest_gap": 1.1}}

    @settings(max_examples=200, derandomize=True, deadline=None)
    @given(st.sampled_from(checks), st.integers(0, 30), st.integers(1, 60), st.integers(0, 2**31))
    def law(check, first, length, seed) -> None:
        random = np.random.default_rng(seed)
        lines = [f"{i * STEP},{v},{i}\n" for i, v in enumerate(random.integers(-3, 4, 60).tolist())]
        for i in (*range(first), *range(first + length, 60)):
            lines[i] = f"{i * STEP},,{i}\n"
        file.write_text("time,a,b\n" + "".join(lines))
        for mapping in (None, {"time_step": STEP, "signals": signals}):
            expected, _ = evaluate_episode(read_formula(check), read_log(file, mapping))
            ours = judge_log(file, mapping, {"x": check})[0]["x"]
            assert (ours.status, ours.lower, ours.upper, ours.time) == (
                expected.status, expected.lower, expected.upper, expected.time,
            )  # fmt: skip
            statuses[ours.status] += 1

    law()
    assert min(statuses[each] for each in ("satisfied", "undecided", "violated")) > 20, statuses


@pytest.mark.parametrize("form", ["csv", "mcap", "bag"])
def test_topics_of_other_rates_are_read_block_by_block(form, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(reading, "ROWS", 50)
    if form == "bag":
        pytest.importorskip("rosbags")
    file = getattr(Drive(1, lost=(4.0, 5.0)), form)(
        tmp_path / ("bag" if form == "bag" else f"log.{form}")
    )
    signals = {
        "csv": {"gap": {}},
        "mcap": {
            "gap": {"topic": "/radar", "field": "range"},
            "speed": {"topic": "/odom", "field": "speed", "method": "linear"},
        },
        "bag": {
            "gap": {"topic": "/gap", "field": "data"},
            "speed": {"topic": "/odom", "field": "twist.linear.x", "method": "nearest"},
        },
    }[form]
    mapping = {"time_step": 0.02, "signals": signals}
    whole = read_log(file, mapping)
    _, blocks = streaming.stream_of(str(file), read_mapping(mapping))
    read = list(blocks)
    assert len(read) > 3
    for name in signals:
        parts = [block[name] for block in read]
        assert np.array_equal(np.concatenate(parts), whole.signal(name), equal_nan=True)


def test_what_is_not_known_block_by_block_is_refused(tmp_path) -> None:
    file = tmp_path / "log.csv"
    times = [*range(60), *(30 + i / 4 for i in range(4)), *range(60, 90)]
    file.write_text("time,a\n" + "".join(f"{time},1\n" for time in times))
    with pytest.raises(ConfigurationError, match="come too late in the file"):
        judge_log(file, None, {"x": "always (a > 0)"})
    for check, problem in (
        ("always (eventually (a > 0))", "needs the whole trace"),
        ("always (c > 0)", "unknown signal 'c'"),
    ):
        with pytest.raises(ConfigurationError, match=problem):
            judge_log(Drive(0).csv(tmp_path / "g.csv"), None, {"x": check.replace("a >", "gap >")})


def live(text: str, checks, *, mapping=None, pieces: int = 7):
    """Watch a stream that comes in pieces; returns the lines and the exit code."""
    reading_end, writing_end = os.pipe()

    def write() -> None:
        with os.fdopen(writing_end, "wb", buffering=0) as stream:
            data = text.encode()
            for start in range(0, len(data), pieces):
                stream.write(data[start : start + pieces])

    writer = Thread(target=write)
    writer.start()
    shown, lines = [], watched_lines(mapping, checks, STEP, reading_end)
    try:
        while True:
            shown.append(next(lines))
    except StopIteration as end:
        return shown, end.value
    finally:
        writer.join()
        os.close(reading_end)


def test_a_live_stream_is_judged_as_the_log_of_it(tmp_path) -> None:
    random = np.random.default_rng(4)
    values = random.integers(-3, 4, 200)
    table = "time,a\n" + "".join(f"{i * STEP},{v}\n" for i, v in enumerate(values.tolist()))
    objects = "".join(f'{{"time": {i * STEP}, "a": {v}}}\n' for i, v in enumerate(values.tolist()))
    file = tmp_path / "log.csv"
    file.write_text(table)
    check = "(historically[0:1] (a > -3)) or (a > 2)"
    now = evaluate_at_each_sample(check, values)
    expected = [
        f"{index * STEP:g} s: x {'holds' if now[index] else 'is violated'}"
        for index in range(200)
        if now[index] != (now[index - 1] if index else True)
    ]
    whole, _ = judge_log(file, None, {"x": f"always ({check})"}, time_step=STEP)
    for text in (table, objects):
        shown, code = live(text, {"x": check})
        assert shown[:-1] == expected
        assert len(expected) > 8
        assert f"violated at {whole['x'].time:g} s" in shown[-1]
        assert code == 1
    assert live(table, {"x": "a >= -3"})[1] == 0


def evaluate_at_each_sample(check, values):
    """Whether a formula holds at each sample, by its definition."""
    before = [values[max(i - 4, 0) : i + 1] for i in range(len(values))]
    assert check == "(historically[0:1] (a > -3)) or (a > 2)"
    return [bool((past > -3).all() or past[-1] > 2) for past in before]


def test_a_live_stream_with_a_gap_is_not_known_there(tmp_path) -> None:
    lines = [f"{i * STEP},1\n" for i in range(40) if not 10 < i < 30]
    shown, code = live("time,a\n" + "".join(lines), {"x": "a > 0"})
    assert shown[:2] == ["2.75 s: x is not known", "7.5 s: x holds"]
    assert shown[2].startswith("undecided: x")
    assert code == 1
    with pytest.raises(ConfigurationError, match="cannot know the future"):
        live("time,a\n0,1\n", {"x": "always (eventually[0:1] (a > 0))"})
    with pytest.raises(ConfigurationError, match="was set: it jumps"):
        live(f'{{"time": 0, "a": 1}}\n{{"time": {10**22}, "a": 1}}\n', {"x": "a > 0"})
    with pytest.raises(ConfigurationError, match="a line is not JSON"):
        live('{"time": 0, "a": 1}\nnonsense\n', {"x": "a > 0"})


def test_a_signal_of_every_fourth_line_is_waited_for(tmp_path) -> None:
    lines = [f"{i * STEP},{'' if i % 4 else i % 8},{i}\n" for i in range(61)]
    mapping = {"time_step": STEP, "signals": {"a": {"method": "linear"}, "b": {}}}
    file = tmp_path / "log.csv"
    file.write_text("time,a,b\n" + "".join(lines))
    whole = read_log(file, mapping)
    header, first, *_ = file.read_text().splitlines()
    read = read_mapping(mapping)
    stream = streaming.LogStream(
        "live", [csv_format.topic_of(file, header, first)], read, live=True
    )
    given = (
        block
        for number, line in enumerate(lines, 2)  # each as soon as it is written
        for block in csv_format.columns_of(file, header, [line], number, stream.wanted)
    )
    made = list(stream.blocks(given))
    assert len(made) > 10
    for name in ("a", "b"):
        column = np.concatenate([block[name] for block in made])
        assert column.tolist() == whole.signal(name).tolist()
    assert whole.signal("a")[:5].tolist() == [0, 1, 2, 3, 4]
