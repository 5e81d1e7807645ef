"""Recorded drives: the signals of a simulation from its poses, and no mirrored world is judged."""

from __future__ import annotations

import numpy as np
import pytest
from recorded_drives import poses, simulated, sizes, written

from pytest_dura import ConfigurationError, read_log
from pytest_dura.driving.bodies import NO_BODIES, BodyList
from pytest_dura.driving.criticality import Encounters, exposure
from pytest_dura.driving.traffic_rules import LEADER_CAP

ALIKE = ("gap", "ttc", "speed", "required_deceleration", "pet", "near_misses", "collided")


@pytest.fixture(scope="module")
def drive():
    """A drive with much traffic, without a collision."""
    episode, ticks = simulated(run=0)
    assert not episode.ever("collided")
    return episode, ticks


def mapping(ticks, **options):
    objects = {"objects": sizes(ticks)} | options
    return {"time_step": 0.1, "world": {"driving": {"axes": "left-handed", **objects}}}


def test_a_log_of_poses_has_the_signals_of_the_simulation(drive, tmp_path) -> None:
    episode, ticks = drive
    log = read_log(written(tmp_path / "log.csv", poses(ticks)), mapping(ticks))
    for name in ALIKE:
        assert log.signal(name) == pytest.approx(episode.signal(name), abs=1e-9), name
    assert episode.signal("pet").min() < 1.0
    assert log.recording.scene.truth.ids[0] == "EGO"
    assert log.recording.scene.truth.poses.shape[0] == len(ticks)


def test_near_misses_are_events_and_counted_over_time_and_way(tmp_path) -> None:
    t = np.arange(0, 20, 0.1)
    columns = {"ego.x": 10 * t, "ego.y": 0 * t, "V1.x": 100 + 0 * t, "V1.y": -8 + 0 * t}
    # It comes out of a side road up to a metre beside the ego's path, and back.
    columns["V1.y"] = np.where(t < 8.5, -8 + np.maximum(t - 7, 0) * 4, -2 - (t - 8.5) * 4)
    columns["V1.heading"] = np.where(t < 8.5, np.pi / 2, -np.pi / 2)
    columns["V1.vx"], columns["V1.vy"] = 0 * t, np.where((t > 7) & (t < 8.5), 4.0, -4.0 * (t > 8.5))
    mapped = {"time_step": 0.1, "world": {"driving": {}}}
    mapped["world"]["driving"]["axes"] = "left-handed"
    log = read_log(written(tmp_path / "log.csv", columns), mapped)
    (event,) = [each for each in log.events if each.kind == "near_miss"]
    assert event.subject == "V1"
    assert "time to collision down to" in event.detail
    assert log.signal("near_misses")[-1] == 1.0
    total = exposure([log, log])
    assert total.near_misses == 2
    assert total.hours == pytest.approx(2 * 19.9 / 3600)
    assert total.kilometres == pytest.approx(2 * 0.199)
    assert total.per_hour == pytest.approx(2 / total.hours)
    assert total.per_kilometre == pytest.approx(2 / 0.398)


def turned(columns, **how):
    """Columns with some keys changed."""
    return {
        name: how[key](column) if (key := name.rpartition(".")[2]) in how else column
        for name, column in columns.items()
    }


def over(column):
    return -column


@pytest.mark.parametrize(
    "how, named",
    [
        ({"heading": over}, "turn the other way, as in left-handed axes"),
        ({"heading": lambda column: column + np.pi}, "headings point against the motion"),
        ({"heading": lambda column: np.pi / 2 - column}, "headings are those of a compass"),
        ({"heading": np.degrees}, "headings are in degrees"),
        ({"heading": lambda column: column + 1.0}, "headings do not go with the motion"),
        ({"vy": over}, "velocities are mirrored"),
        ({"vx": over, "vy": over}, "velocities point against the motion"),
        ({"y": over, "heading": over, "vy": over}, "oncoming traffic passes on the wrong side"),
    ],
)
def test_a_mirrored_world_is_named_before_anything_is_judged(how, named, drive, tmp_path) -> None:
    _, ticks = drive
    file = written(tmp_path / "log.csv", turned(poses(ticks), **how))
    with pytest.raises(ConfigurationError, match=named) as refused:
        read_log(file, mapping(ticks))
    assert str(file) in str(refused.value)


def test_what_is_declared_is_no_mirror(drive, tmp_path) -> None:
    episode, ticks = drive
    flipped = turned(poses(ticks), y=over, heading=over, vy=over)
    file = written(tmp_path / "log.csv", flipped)
    right = read_log(file, mapping(ticks, axes="right-handed"))
    left = read_log(file, mapping(ticks, traffic="left"))
    for log in (right, left):
        assert log.signal("gap") == pytest.approx(episode.signal("gap"), abs=1e-9)
    with pytest.raises(ConfigurationError, match="wrong side"):
        read_log(file, mapping(ticks, axes="right-handed", traffic="left"))


def test_an_ego_on_the_wrong_side_is_judged_where_that_is_declared(drive, tmp_path) -> None:
    _, ticks = drive
    file = written(tmp_path / "log.csv", turned(poses(ticks), y=over, heading=over, vy=over))
    with pytest.raises(ConfigurationError, match="`traffic: either`"):
        read_log(file, mapping(ticks))
    log = read_log(file, mapping(ticks, traffic="either"))
    assert np.isfinite(log.signal("gap")).all()
    headings = turned(poses(ticks), heading=over)
    with pytest.raises(ConfigurationError, match="headings turn the other way"):
        read_log(written(tmp_path / "turned.csv", headings), mapping(ticks, traffic="either"))


def test_what_is_not_known_of_an_object_is_not_known_of_the_gap(drive, tmp_path) -> None:
    _, ticks = drive
    columns = poses(ticks)
    whole = read_log(written(tmp_path / "whole.csv", columns), mapping(ticks))
    name = min(whole.recording.scene.truth.ids[1:])
    there = np.flatnonzero(np.isfinite(columns[f"{name}.x"]))
    lost = there[len(there) // 2 : len(there) // 2 + 8]
    for key in ("x", "y", "heading", "vx", "vy"):
        columns[f"{name}.{key}"][lost] = np.nan
    log = read_log(written(tmp_path / "log.csv", columns), mapping(ticks))
    assert np.isnan(log.signal("gap")[lost[1:-1]]).all()
    assert whole.satisfies("always (gap >= 0)")
    assert not log.satisfies("always (gap >= 0)")
    near = whole.signal("near_misses")[-1]
    assert whole.satisfies(f"always (near_misses <= {near})")
    assert not log.satisfies(f"always (near_misses <= {near})")


def test_a_leader_is_found_on_the_arc_that_the_ego_drives_on(tmp_path) -> None:
    t = np.arange(0, 10, 0.1)
    radius, speed, gap = 30.0, 8.0, 20.0
    columns = {}
    for name, at in (("ego", speed * t / radius), ("V1", (speed * t + gap) / radius)):
        columns[f"{name}.x"], columns[f"{name}.y"] = radius * np.sin(at), -radius * np.cos(at)
        columns[f"{name}.heading"] = at
    log = read_log(written(tmp_path / "log.csv", columns), {"world": {"driving": {}}})
    inner = log.signal("leader_gap")[5:-5]
    assert inner == pytest.approx(gap - 5.0, abs=0.1)
    assert log.signal("time_headway")[5:-5] == pytest.approx(inner / speed, rel=0.02)
    assert log.signal("drac")[5:-5] == pytest.approx(0.0, abs=0.01)
    # Straight on it is no leader.
    columns["V1.x"], columns["V1.y"] = 8 * t + 20, -radius + 0 * t
    columns["V1.heading"] = 0 * t
    log = read_log(written(tmp_path / "log.csv", columns), {"world": {"driving": {}}})
    assert log.signal("leader_gap")[40] == LEADER_CAP


def test_a_mapping_of_a_world_that_does_not_fit_is_refused(drive, tmp_path) -> None:
    _, ticks = drive
    columns = poses(ticks)
    file = written(tmp_path / "log.csv", columns)
    with pytest.raises(ConfigurationError, match="axes"):
        read_log(file, {"world": {"driving": {"axes": "upside down"}}})
    with pytest.raises(ConfigurationError, match="drivin"):
        read_log(file, {"world": {"drivin": {}}})
    with pytest.raises(ConfigurationError, match="no poses of 'V99'"):
        read_log(file, mapping(ticks, objects={"V99": {}}))
    without = {name: each for name, each in columns.items() if not name.startswith("ego")}
    with pytest.raises(ConfigurationError, match="no poses of 'ego'"):
        read_log(written(tmp_path / "no.csv", without), {"world": {"driving": {}}})


def straight(**columns):
    """Columns of 10 s at 10 Hz, of numbers or of functions of the time."""
    time = np.arange(0, 10, 0.1)
    return {
        name.replace("__", "."): column(time) if callable(column) else np.full(len(time), column)
        for name, column in columns.items()
    }


def test_who_drives_backwards_all_the_time_is_no_mirror_where_that_is_said(tmp_path) -> None:
    columns = straight(
        ego__x=lambda t: -5 * t, ego__y=0.0, ego__heading=0.0, V1__x=-80.0, V1__y=0.0
    )
    file = written(tmp_path / "log.csv", columns)
    mapped = {"time_step": 0.1, "world": {"driving": {}}}
    with pytest.raises(ConfigurationError, match="point against the motion") as refused:
        read_log(file, mapped)
    assert "reverses: true" in str(refused.value)
    said = {"time_step": 0.1, "world": {"driving": {"objects": {"ego": {"reverses": True}}}}}
    log = read_log(file, said)
    assert log.signal("speed") == pytest.approx(-5.0)
    assert log.satisfies("always (gap > 20)")
    forward = straight(ego__x=lambda t: 5 * t, ego__y=0.0, ego__heading=0.0)
    forward = written(tmp_path / "forward.csv", forward)
    with pytest.raises(ConfigurationError, match="point against the motion"):
        read_log(forward, said)
    # A speed with a sign says so by itself; without a heading it follows from the motion.
    signed = written(tmp_path / "signed.csv", columns | straight(ego__speed=-5.0))
    assert read_log(signed, mapped).signal("speed") == pytest.approx(-5.0)
    bare = {name: each for name, each in columns.items() if name != "ego.heading"}
    assert read_log(written(tmp_path / "bare.csv", bare), said).signal("speed") == pytest.approx(-5)


def test_a_side_is_clear_only_beyond_a_metre(tmp_path) -> None:
    mapped = {"time_step": 0.1, "world": {"driving": {}}}
    for beside, is_refused in ((-0.3, False), (-3.0, True), (3.0, False)):
        columns = straight(
            ego__x=lambda t: 5 * t, ego__y=0.0,
            V1__x=lambda t: 80 - 5 * t, V1__y=beside,
        )  # fmt: skip
        file = written(tmp_path / "log.csv", columns)
        if is_refused:
            with pytest.raises(ConfigurationError, match="passes on the wrong side"):
                read_log(file, mapped)
        else:
            read_log(file, mapped)


@pytest.mark.parametrize("how", ["gone", "leapt", "same"])
def test_two_objects_with_one_id_are_two_near_misses(how) -> None:
    ticks = 40
    ego = np.zeros((ticks, 5))
    ego[:, 0], ego[:, 3] = 0.8 * np.arange(ticks), 8.0
    rows = np.full((ticks, 7), np.nan)
    for first in (10, 15):  # half a second later
        for tick in range(first, first + 5):
            rows[tick] = ego[tick, 0] + 8.0, 0.0, 0.0, 0.0, 0.0, 0.6, 0.6
    if how == "same":  # moves along, and is not near for a while
        rows[10:20, 3] = 8.0
        rows[[10, 11, 18], 3] = 0.0
        rows[20:30] = rows[19]
        rows[20:30, 0] += 0.8 * np.arange(1, 11)
    if how == "gone":
        rows[14] = np.nan
    if how == "leapt":
        rows[10:15, 3] = rows[15:20, 3] = 0.0
        rows[15:20, 1] = 0.5
        rows[15:20, 0] += 6.0
        rows[20:] = [200.0, 50.0, 0.0, 0.0, 0.0, 0.6, 0.6]
    there = np.isfinite(rows).all(axis=1)
    bodies = [BodyList(("V1",), rows[i : i + 1]) if there[i] else NO_BODIES for i in range(ticks)]
    found = Encounters(ego, bodies, 0.1).near_misses()
    assert len(found) == (1 if how == "same" else 2), found
