from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from traces import ABOUT, simple_trace, traces

from pytest_dura.core import Scene, Tracks
from pytest_dura.evidence import first_difference, pack_columns, unpack_columns

TRACE = simple_trace(8)


@settings(derandomize=True, deadline=None, max_examples=20)
@given(traces())
def test_a_trace_does_not_differ_from_itself(trace):
    assert first_difference(trace, unpack_columns(pack_columns(trace))) is None


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.integers(0, 7), st.integers(0, 63), st.sampled_from(sorted(TRACE.signals)))
def test_one_flipped_bit_is_found_where_it_is(tick, bit, name):
    flipped = TRACE.signals[name].copy()
    flipped.view(np.uint64)[tick] ^= np.uint64(1 << bit)
    found = first_difference(TRACE, replace(TRACE, signals=TRACE.signals | {name: flipped}))
    assert (found.tick, found.time, found.column) == (tick, TRACE.time[tick], f"signals.{name}")
    assert found.recorded == repr(TRACE.signals[name][tick].item())
    assert found.replayed == repr(flipped[tick].item())
    assert found.covered
    assert found.also == ()


def changed(name, tick, value):
    """The trace with another value in a column."""
    recording = TRACE.recording
    if name in TRACE.decisions:
        column = TRACE.decisions[name].astype(object)
        column[tick] = value
        column = column.astype(np.str_ if isinstance(value, str) else TRACE.decisions[name].dtype)
        return replace(TRACE, decisions=TRACE.decisions | {name: column})
    if name == "safety_monitor":
        flags = recording.flags[name].copy()
        flags[tick] = value
        return replace(TRACE, recording=replace(recording, flags={name: flags}))
    texts = list(getattr(recording, name))
    texts[tick] = value
    return replace(TRACE, recording=replace(recording, **{name: tuple(texts)}))


@pytest.mark.parametrize(
    "name, value, column, covered",
    [
        ("executed", "swerve at once", "decisions.executed", True),
        ("verdict", 1, "decisions.verdict", True),
        ("attempts", 3, "decisions.attempts", True),
        ("safety_monitor", 1, "flags.safety_monitor", False),
        ("explanations", "otherwise", "explanations", False),
        ("reasons", "doubt\x00", "reasons", False),
        ("recoveries", "stop", "recoveries", False),
    ],
)
def test_what_was_decided_and_said(name, value, column, covered):
    other = changed(name, 3, value)
    found = first_difference(TRACE, other)
    assert (found.tick, found.column, found.covered) == (3, column, covered)
    assert (first_difference(TRACE, other, covered=True) is not None) == covered


def test_the_scene():
    scene = TRACE.recording.scene
    poses = scene.percept.poses.copy()
    poses[5, 2, 1] += 1
    moved = Scene(scene.lines, scene.truth, Tracks(scene.percept.ids, poses), scene.ego)
    found = first_difference(TRACE, replace(TRACE, recording=replace(TRACE.recording, scene=moved)))
    assert str(found) == "tick 5 (0.500 s), percept.ghost.y: recorded 3.0, replayed 4.0"


def test_the_earliest_tick_comes_first_and_names_the_others():
    found = first_difference(changed("explanations", 5, "late"), changed("executed", 2, "brake"))
    assert (found.tick, found.column, found.also) == (2, "decisions.executed", ())
    same_tick = changed("executed", 5, "brake")
    found = first_difference(changed("explanations", 5, "late"), same_tick)
    assert (found.column, found.also) == ("decisions.executed", ("explanations",))


def test_one_that_ends_earlier():
    short = replace(TRACE, time=TRACE.time[:7])
    found = first_difference(TRACE, short)
    words = "tick 7 (0.700 s), time: recorded 0.7000000000000001, replayed nothing"
    assert str(found).startswith(f"{words}; at this tick also truth.EGO.x, ")


def test_what_belongs_to_no_tick():
    fewer = replace(TRACE, events=[])
    assert str(first_difference(TRACE, fewer)) == (
        "tick 2 (0.200 s), events[0]: recorded alert V1, replayed nothing"
    )
    ended = replace(TRACE, about=ABOUT | {"termination": "goal"})
    assert str(first_difference(TRACE, ended)) == "termination: recorded time, replayed goal"
    silent = replace(TRACE, signals={"gap": TRACE.signals["gap"]})
    assert str(first_difference(TRACE, silent)) == (
        "signals.percept.gap: recorded such a column, replayed nothing"
    )


def test_events_of_the_clock_are_left_out():
    slow = {**TRACE.events[0], "detail": "3 ms", "wall_clock": True}
    fast = {**TRACE.events[0], "detail": "2 ms", "wall_clock": True}
    assert first_difference(replace(TRACE, events=[slow]), replace(TRACE, events=[fast])) is None
