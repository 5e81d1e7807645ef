"""Sessions on recorded logs: each log is an episode that is not run, and none is judged in part."""

from __future__ import annotations

import re

import pytest
from recorded_logs import Drive

from pytest_dura import ConfigurationError, read_log
from pytest_dura.__main__ import main
from pytest_dura.evidence import verify_bundle
from pytest_dura.logs.inspection import first_mapping

REQUIREMENTS = """
requirements:
  - {id: LOG-1, text: The gap stays above 3 m., kind: safety, check: always (gap > 3)}
  - {id: LOG-2, text: The gap stays above 9 m., kind: safety, check: always (gap > 9)}
"""
MAPPING = """
time_step: 0.02
signals:
  gap: {topic: /radar, field: range, unit: m}
  speed: {topic: /odom, field: speed, unit: m/s, method: linear}
"""

OWN_TESTS = """
import pytest

@pytest.mark.dura(logs="drives/*.csv")
@pytest.mark.requirement("OWN-1", text="The gap stays above 1 m.", kind="safety")
def test_of_its_own(campaign):
    campaign.require("always (gap > 1)")

@pytest.mark.dura(logs="drives/*.csv")
@pytest.mark.requirement("LOG-2")
def test_of_the_file(campaign):
    campaign.require()
"""


def output(result):
    return result.stdout.str() + result.stderr.str()


@pytest.fixture
def drives(project):
    project.write("requirements.yaml", REQUIREMENTS)
    project.write("mapping.yaml", MAPPING)
    folder = project.path / "drives"
    folder.mkdir()
    project.folder = folder
    return project


def judged(drives, *arguments, logs="drives/*.csv"):
    return drives.run(f"--dura-log={logs}", "--dura-requirements=requirements.yaml", *arguments)


def test_each_log_is_an_episode_and_each_set_a_campaign(drives) -> None:
    for seed in range(3):
        Drive(seed).csv(drives.folder / f"{seed}.csv")
    result = judged(drives)
    assert result.ret == 1, output(result)
    result.assert_outcomes(passed=1, failed=1)
    assert drives.verdict("LOG-1", "drives/csv").verdict == "supported"
    assert drives.verdict("LOG-2", "drives/csv").verdict == "violated"
    record = drives.evidence()
    assert len(record.episodes) == 3
    assert len({episode.digest for episode in record.episodes}) == 3
    assert record.component_under_test.name == "RecordedNotRun"
    assert verify_bundle(drives.path / "dura-evidence").problems == []
    page = (drives.path / "dura-evidence" / "report.html").read_text("utf-8")
    assert "The run was recorded and not run" in page
    assert "m where more than 9 m is required" in page
    assert "No role had objected" not in page
    assert "look at what the log shows" in page.lower()
    again = drives.run("--dura-replay=drives/csv#1")
    assert again.ret == 0, output(again)


def test_one_log_with_a_gap_leaves_the_set_undecided(drives) -> None:
    for seed in range(9):
        Drive(seed).csv(drives.folder / f"{seed}.csv")
    Drive(9, lost=(4.0, 5.0)).csv(drives.folder / "9.csv")
    result = judged(drives)
    assert drives.verdict("LOG-1", "drives/csv").verdict == "undecided"
    assert "the log does not show more" in output(result)
    assert "gap known at 90.05 % of the samples" in output(result)
    assert drives.verdict("LOG-2", "drives/csv").verdict == "violated"


@pytest.mark.parametrize("mode", [[], ["-n", "2"]], ids=["plain", "n2"])
def test_logs_of_an_option_are_judged_by_tests_as_well(drives, mode) -> None:
    """They are one case, to each of whose runs every verdict can go."""
    for seed in range(2):
        Drive(seed).csv(drives.folder / f"{seed}.csv")
    drives.write("test_drives.py", OWN_TESTS)
    result = judged(drives, "test_drives.py", *mode)
    result.assert_outcomes(passed=2, failed=2)
    words = {each.requirement: each.verdict for each in drives.evidence().verdicts}
    assert words == {"LOG-1": "supported", "LOG-2": "violated", "OWN-1": "supported"}
    assert len(drives.evidence().episodes) == 2
    assert "Traceback" not in output(result)


def test_equal_logs_do_not_speak_for_those_that_follow(drives) -> None:
    for name in ("0", "1"):
        table = Drive(0).csv(drives.folder / f"{name}.csv").read_text()
        drives.write(f"drives/{name}.csv", table + "\n" * int(name))  # not the very same file
    result = judged(drives)
    assert "all 2 episodes are equal" in output(result)
    assert drives.verdict("LOG-1", "drives/csv").verdict == "undecided"
    drives.write("drives/2.csv", "timestamp,gap [m]\n0,9\n0.05,1\n0.1,9\n")
    result = judged(drives)
    verdict = drives.verdict("LOG-1", "drives/csv")
    assert (verdict.verdict, verdict.run, verdict.saved) == ("violated", 3, 0)
    assert drives.verdict("LOG-2", "drives/csv").violations == 3


def test_a_log_counts_once_in_a_set(drives) -> None:
    Drive(0).csv(drives.folder / "0.csv")
    for name in ("link", "copy"):
        again = drives.folder / f"{name}.csv"
        if name == "link":
            again.symlink_to(drives.folder / "0.csv")
        else:
            again.write_bytes((drives.folder / "0.csv").read_bytes())
        result = judged(drives)
        assert result.ret != 0
        assert "a log is in the set twice" in output(result)
        again.unlink()


def test_a_set_that_changes_while_it_is_judged_is_not_decided(drives) -> None:
    for seed in (1, 2):
        Drive(seed).csv(drives.folder / f"{seed}.csv")
    drives.write(
        "conftest.py",
        """
import shutil

def pytest_runtestloop(session):
    shutil.move("drives/2.csv", "drives/0.csv")
""",
    )
    result = judged(drives)
    assert "the logs of the set are others than when it was collected" in output(result)
    assert drives.verdict("LOG-1", "drives/csv").verdict == "undecided"


def test_sets_of_one_name_are_not_taken_for_each_other(drives) -> None:
    drives.write("drives/a::b.csv", "time,gap\n0,5\n0.1,5\n")
    drives.write("drives/ab.csv", "time,gap\n0,1\n0.1,1\n")
    drives.write(
        "test_names.py",
        """
import pytest

pytestmark = pytest.mark.requirement("OWN-1", text="The gap stays above 3 m.")

@pytest.mark.dura(logs=["drives/a::b.csv", "drives/ab.csv"])
def test_both(campaign):
    campaign.require("always (gap > 3)")

@pytest.mark.dura(logs="drives/a::b.csv")
def test_one(campaign):
    campaign.require("always (gap > 3)")

@pytest.mark.dura(logs="drives/ab.csv")
def test_the_other(campaign):
    campaign.require("always (gap > 3)")
""",
    )
    result = drives.run("test_names.py")
    result.assert_outcomes(passed=1, errors=2)
    assert "'drives/ab.csv' stands for another world elsewhere" in output(result)


@pytest.mark.parametrize("lacking", ["", "nan", "inf"])
def test_a_signal_that_stops_before_its_log_is_not_known_to_its_end(lacking, drives) -> None:
    rows = [f"{i / 20},{5 if i < 40 else lacking}\n" for i in range(100)]
    drives.write("drives/0.csv", "time,gap\n" + "".join(rows))
    result = judged(drives)
    assert drives.verdict("LOG-1", "drives/csv").verdict == "undecided"
    assert "gap known at 40 % of the samples" in output(result)
    log = read_log(drives.folder / "0.csv")
    assert log.time[-1] == pytest.approx(4.95)
    assert [e.detail for e in log.events if e.kind == "gap"] == [
        "no sample from 1.95 to 4.95 s, and at most 0.075 s is bridged"
    ]


def test_logs_are_judged_on_request_in_workers_too(drives) -> None:
    for seed in range(2):
        Drive(seed).csv(drives.folder / f"{seed}.csv")
    result = judged(drives, "-n", "2", "-p", "xdist")
    result.assert_outcomes(passed=1, failed=1)
    assert drives.verdict("LOG-1", "drives/csv").verdict == "supported"


def test_a_marker_names_logs_and_a_mapping(drives) -> None:
    for seed in range(2):
        Drive(seed).mcap(drives.folder / f"{seed}.mcap")
    drives.write(
        "test_logs.py",
        """
import pytest

LOGS = pytest.mark.dura(logs="drives/*.mcap", mapping="mapping.yaml")

@LOGS
@pytest.mark.requirement("OWN-1", text="It drives.")
def test_each(log):
    assert log.satisfies("always (speed > 13 and gap > 3)")
    assert not log.satisfies("always (gap > 9)")

@LOGS
@pytest.mark.requirement("OWN-2", text="It keeps a gap.")
def test_all(campaign):
    campaign.require("always (gap > 3)")
""",
    )
    result = drives.run("test_logs.py")
    assert result.ret == 0, output(result)
    result.assert_outcomes(passed=3)
    assert drives.verdict("OWN-2", "drives/mcap").verdict == "supported"


def test_a_function_is_not_satisfied_by_samples_that_are_not_known(drives) -> None:
    Drive(0, lost=(4.0, 5.0)).csv(drives.folder / "0.csv")
    log = read_log(drives.folder / "0.csv")
    assert not log.satisfies(lambda episode: True)
    assert log.robustness("always (gap > 3)") == -float("inf")


def test_bad_logs_are_named_and_never_pass(drives) -> None:
    Drive(0).csv(drives.folder / "0.csv")
    whole = (drives.folder / "0.csv").read_text()
    cases = {
        "truncated": (whole[:-40].rpartition(",")[0], "has 1 of 2 cells"),
        "empty": ("timestamp,gap [m]\n", "no line below a header"),
        "other": (whole.replace("gap [m]", "distance [m]"), "unknown signal 'gap'"),
    }
    for name, (text, _) in cases.items():
        (drives.folder / "bad").mkdir(exist_ok=True)
        drives.write(f"drives/bad/{name}.csv", text)
    for name, (_, problem) in cases.items():
        result = judged(drives, logs=f"drives/bad/{name}.csv")
        assert result.ret != 0
        assert problem in output(result), output(result)
    # Beside a log that can be read, one that cannot leaves the set undecided.
    drives.write("drives/1.csv", cases["truncated"][0])
    result = judged(drives)
    assert drives.verdict("LOG-1", "drives/csv").verdict == "undecided"
    assert "has 1 of 2 cells" in output(result)


def test_units_are_converted_or_refused(tmp_path) -> None:
    pytest.importorskip("pint")
    file = Drive(0).csv(tmp_path / "feet.csv", unit="ft")
    mapping = {"signals": {"gap": {"unit": "m"}}}
    in_feet = read_log(file, {"signals": {"gap": {}}}).signal("gap")
    assert read_log(file, mapping).signal("gap") == pytest.approx(in_feet * 0.3048)
    with pytest.raises(ConfigurationError, match="does not fit") as refused:
        read_log(file, {"signals": {"gap": {"unit": "kg"}}})
    assert "ft" in str(refused.value)


def test_stamps_are_read_by_magnitude_and_clocks_that_are_set_are_refused(tmp_path) -> None:
    file = tmp_path / "log.csv"

    def log(stamps):
        file.write_text("time,a\n" + "".join(f"{stamp},{i}\n" for i, stamp in enumerate(stamps)))
        return read_log(file)

    start = 1_764_288_000
    for unit, factor in (("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)):
        stamps = [start * factor + i * factor for i in range(20)]
        assert log(stamps).time[-1] == pytest.approx(19.0), unit
    assert log([i * 50 for i in range(20)]).time[-1] == pytest.approx(0.95)
    swapped = log([0, 1, 3, 2, *range(4, 30)])
    assert any("1 samples are out of order" in event.detail for event in swapped.events)
    assert swapped.signal("a").tolist()[:5] == [0, 1, 3, 2, 4]
    doubled = log([0, 1, 1, *range(2, 30)])
    assert any("1 stamps are doubled" in event.detail for event in doubled.events)
    assert not doubled.satisfies("always (a != 1)")
    for stamps, by in (
        ([*range(20), *range(5, 25)], "-14"),
        ([*range(20), *range(40_000, 40_020)], "+39981"),
    ):
        with pytest.raises(ConfigurationError, match="was set: it jumps by") as refused:
            log(stamps)
        assert by in str(refused.value)


def test_topics_on_two_clocks_do_not_overlap(tmp_path) -> None:
    file = Drive(0).mcap(tmp_path / "log.mcap", header_offset=-(10**12))
    mapping = {
        "time_step": 0.02,
        "signals": {"gap": {"topic": "/radar", "field": "range"}, "speed": {"topic": "/odom"}},
    }
    with pytest.raises(ConfigurationError, match="do not overlap in time"):
        read_log(file, mapping)
    log = read_log(file, mapping | {"time": {"stamps": "receipt"}})
    assert log.satisfies("always (gap > 3 and speed > 13)")


def test_a_mapping_that_does_not_fit_is_refused_with_what_there_is(tmp_path) -> None:
    file = Drive(0).mcap(tmp_path / "log.mcap")
    for signal, problem, found in (
        ({"topic": "/rada"}, "no topic '/rada'", "/radar"),
        ({"topic": "/radar", "field": "rang"}, "no field 'rang'", "range"),
        ({"topic": "/radar", "field": "frame"}, "'frame' is not a number", "range"),
    ):
        with pytest.raises(ConfigurationError, match=problem) as refused:
            read_log(file, {"signals": {"gap": signal}})
        assert found in str(refused.value)
    table = Drive(0).csv(tmp_path / "log.csv")
    with pytest.raises(ConfigurationError, match=r"(?s)no topic '/radar'.*leave `topic` out"):
        read_log(table, {"signals": {"gap": {"topic": "/radar", "field": "range"}}})
    damaged = tmp_path / "cut.mcap"
    damaged.write_bytes(file.read_bytes()[:-2000])
    with pytest.raises(ConfigurationError, match="the log cannot be read"):
        read_log(damaged, MAPPING_OF_MCAP)


MAPPING_OF_MCAP = {"signals": {"gap": {"topic": "/radar", "field": "range"}}}


def test_what_is_made_of_several_fields_has_as_many_as_it_takes(tmp_path) -> None:
    file = tmp_path / "table.csv"
    file.write_text("time,x,y,z\n0,1,2,3\n0.1,1,2,3\n")
    for combine, fields in (("yaw", ["x", "y"]), ("difference", ["x", "y", "z"]), ("sum", ["x"])):
        mapping = {"signals": {"gap": {"field": fields, "combine": combine}}}
        with pytest.raises(ConfigurationError, match=f"{fields[-1]} with {combine}"):
            read_log(file, mapping)


@pytest.mark.parametrize("step", ["0", "-1", "nan", "inf"])
def test_a_step_that_is_no_step_is_refused(step, tmp_path, capsys) -> None:
    file = Drive(0).csv(tmp_path / "0.csv")
    command = ["logs", "judge", str(file), "--check", "always (gap > 9)", f"--time-step={step}"]
    assert main(command) == 2
    assert "a finite number of seconds above 0" in "".join(capsys.readouterr())
    with pytest.raises(ConfigurationError, match="a finite number of seconds above 0"):
        read_log(file, time_step=float(step))


def test_whole_numbers_beyond_all_dates_are_numbers(tmp_path) -> None:
    file = tmp_path / "table.csv"
    file.write_text("time,x\n0,1\n1,90000000000000000000000\n")
    assert read_log(file).signal("x").tolist() == [1, 9e22]


def test_a_bag_of_ros_2_is_read(tmp_path) -> None:
    pytest.importorskip("rosbags")
    drive = Drive(0)
    bag = drive.bag(tmp_path / "bag")
    mapping = {
        "time_step": 0.02,
        "signals": {
            "gap": {"topic": "/gap", "field": "data"},
            "speed": {
                "topic": "/odom",
                "field": ["twist.linear.x", "twist.linear.y"],
                "combine": "norm",
                "method": "nearest",
            },
        },
    }
    log = read_log(bag, mapping)
    assert log.satisfies("always (gap > 3 and speed > 13)")
    assert log.robustness("always (speed > 13)") == pytest.approx(drive.speed.min() - 13, abs=1e-6)
    assert any("stamps are the recorder's" in event.detail for event in log.events)
    next(bag.glob("*.db3")).write_bytes(b"not a database")
    with pytest.raises(ConfigurationError, match="the log cannot be read"):
        read_log(bag, mapping)


def test_a_table_in_parquet_is_read(tmp_path) -> None:
    pyarrow = pytest.importorskip("pyarrow", reason="pyarrow is in the extra logs alone")
    from pyarrow import parquet

    drive = Drive(0)
    columns = {"timestamp": drive.nanoseconds(drive.gap_at), "gap": drive.gap.tolist()}
    columns["note"] = ["x"] * len(drive.gap)
    parquet.write_table(pyarrow.table(columns), tmp_path / "log.parquet")
    log = read_log(tmp_path / "log.parquet")
    assert log.robustness("always (gap > 3)") == pytest.approx(drive.gap.min() - 3)
    (tmp_path / "cut.parquet").write_bytes((tmp_path / "log.parquet").read_bytes()[:-20])
    with pytest.raises(ConfigurationError, match="the log cannot be read"):
        read_log(tmp_path / "cut.parquet")


def test_a_measurement_in_mdf_4_is_read(tmp_path) -> None:
    asammdf = pytest.importorskip("asammdf", reason="asammdf is in the extra logs alone")
    drive = Drive(0)
    measurement = asammdf.MDF(version="4.10")
    for at, values, name, unit in (
        (drive.gap_at, drive.gap, "gap", "m"),
        (drive.speed_at, drive.speed * 3.6, "speed", "km/h"),
    ):
        signal = asammdf.Signal(samples=values, timestamps=at, name=name, unit=unit)
        measurement.append([signal])
    file = measurement.save(tmp_path / "log.mf4")
    mapping = {
        "time_step": 0.02,
        "signals": {
            "gap": {"topic": "0", "unit": "m"},
            "speed": {"topic": "1", "unit": "m/s", "method": "linear"},
        },
    }
    log = read_log(file, mapping)
    assert log.satisfies("always (gap > 3 and speed > 13 and speed < 16)")


def test_a_log_is_inspected_and_a_first_mapping_written(tmp_path, capsys) -> None:
    file = Drive(0, lost=(4.0, 5.0)).mcap(tmp_path / "log.mcap")
    mapping = tmp_path / "mapping.yaml"
    assert main(["logs", "inspect", str(file), "--mapping", str(mapping)]) == 0
    shown = capsys.readouterr().out
    assert "/radar: Any" in shown
    assert re.search(r"gaps: 1, the longest from 3\.9\d* to 4\.99", shown), shown
    assert "frame: str, not a number" in shown
    assert "from 2025-11-28" in shown
    assert read_log(file, mapping).signal("radar_range") is not None
    assert "radar_range" in first_mapping(str(file))


@pytest.mark.parametrize(
    "arguments, problem",
    [
        (["inspect", "{0}/0.csv", "--mapping", "{0}/none/m.yaml"], "the mapping cannot be written"),
        (["inspect", "{0}"], "name the logs in it"),
        (["inspect", "{0}/twice.csv"], "two columns are called 'gap'"),
        (["judge", "{0}/text.csv", "--check", "always (gap > 3)"], "holds a text, not a number"),
        (["judge", "{0}/stamp.csv", "--check", "always (gap > 3)"], "1 of 3 stamps, the first at"),
        (
            [
                *("scenario-from-log", "{0}/0.csv", "--check=always (gap > 9)"),
                *("--output={0}/s.yaml", "--before=nan"),
            ],
            "a finite number of seconds before",
        ),
    ],
)
def test_what_a_command_cannot_do_is_named_with_a_remedy(
    arguments, problem, tmp_path, capsys
) -> None:
    Drive(0).csv(tmp_path / "0.csv")
    (tmp_path / "twice.csv").write_text("time,gap,gap [m]\n0,1,2\n")
    (tmp_path / "text.csv").write_text('time;gap\n0;"5,1"\n1;"5,1"\n')
    (tmp_path / "stamp.csv").write_text("time,gap\n0,5\nnan,5\n0.2,5\n")
    assert main(["logs", *(each.format(tmp_path) for each in arguments)]) == 2
    shown = "".join(capsys.readouterr())
    assert problem in shown
    assert "remedy:" in shown
