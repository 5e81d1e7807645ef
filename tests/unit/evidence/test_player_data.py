from __future__ import annotations

import base64
import html
import json
import re
import zlib
from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest
from entries import make
from hypothesis import given, settings
from player_traces import ASTRAY, GHOST, TICKS, UNSEEN, VERDICTS, crossing
from traces import traces

from pytest_dura.core import Recording, Scene, Tracks
from pytest_dura.core.measures import MeasureInfo
from pytest_dura.evidence.text import LIMIT
from pytest_dura.reports import Twin, pack_data, player_assets, player_data, player_page
from pytest_dura.reports.html.player import MAX_MARGINS, content_hash


def unpacked(text):
    return json.loads(zlib.decompress(base64.b64decode(text, validate=True)))


def poses(things, ticks, truth=None):
    """What a reader of the documented encoding makes of it: by id, in m and rad."""
    found = {}
    for thing in things:
        column = np.full((ticks, 6), np.nan)
        for start, length, width, *coded in thing["runs"]:
            values = [list(accumulate(one)) for one in coded]
            stop = start + len(values[0])
            column[start:stop, :4] = np.array(values).T / (100.0, 100.0, 1000.0, 100.0)
            column[start:stop, 4:] = length / 100.0, width / 100.0
        for start, count in thing["same"]:
            column[start : start + count] = truth[thing["id"]][start : start + count]
        found[thing["id"]] = column
    return found


def test_the_scene_is_read_back_to_a_centimetre():
    trace = crossing()
    scene = player_data(trace)["scene"]
    truth = poses(scene["truth"], TICKS)
    percept = poses(scene["percept"], TICKS, truth)
    for tracks, found in [
        (trace.recording.scene.truth, truth),
        (trace.recording.scene.percept, percept),
    ]:
        assert tuple(found) == tracks.ids
        for column, one in enumerate(tracks.ids):
            np.testing.assert_allclose(found[one], tracks.poses[:, column], atol=0.005)
    present = {one: np.flatnonzero(~np.isnan(column[:, 0])) for one, column in percept.items()}
    assert present["GHOST"].tolist() == list(GHOST)
    assert sorted(set(range(TICKS)) - set(present["V1"])) == list(UNSEEN)
    assert np.flatnonzero(percept["EGO"][:, 0] > 4.0).tolist() == list(ASTRAY)
    edge = scene["lines"][0]
    assert edge == ["edge", [-400, 0], [-4000, 8000]]


def test_a_size_that_changes_is_kept():
    sizes = np.zeros((4, 1, 6), np.float32)
    sizes[:, 0, 4] = 4.0, 4.0, 5.0, 5.0
    tracks = Tracks(("A",), sizes)
    scene = player_data(crossing(recording=Recording(scene=Scene((), tracks, tracks, "A"))))
    assert poses(scene["scene"]["truth"], 4)["A"][:, 4].tolist() == [4.0, 4.0, 5.0, 5.0]


def test_headings_stay_close_through_a_full_turn():
    turning = np.zeros((4, 1, 6), np.float32)
    turning[:, 0, 2] = 3.0, 3.5, 7.0, -9.0
    tracks = Tracks(("A",), turning)
    scene = player_data(crossing(recording=Recording(scene=Scene((), tracks, tracks, "A"))))
    found = poses(scene["scene"]["truth"], 4)["A"][:, 2]
    np.testing.assert_allclose(np.cos(found), np.cos(turning[:, 0, 2]), atol=0.001)
    np.testing.assert_allclose(np.sin(found), np.sin(turning[:, 0, 2]), atol=0.001)


def test_numbers_keep_six_digits_and_what_is_no_number_is_told():
    values = np.array([1.23456789, -0.00012345678, 3.0, np.nan, np.inf, -np.inf])
    signals = player_data(crossing(signals={"x": values}))["signals"]
    assert signals["x"] == [1.23457, -0.000123457, 3, None, "inf", "-inf"]
    assert isinstance(signals["x"][2], int)


def test_a_violation_is_at_the_first_tick_that_is_not_before_it():
    def tick(time):
        (verdict,) = player_data(crossing(), [VERDICTS[0] | {"time": time}])["verdicts"]
        return verdict["tick"]

    # 3 * 0.1 is a hair above 0.3, and what was computed otherwise may be a hair above that.
    found = [tick(time) for time in (0.0, 0.3, 0.3 + 1e-9, 3.61, 99.0, None)]
    assert found == [0, 3, 3, 37, TICKS - 1, None]


def test_margins_are_those_of_formulas_once_each_and_of_what_was_violated_first():
    verdicts = [
        VERDICTS[1],
        {"requirement": "REC-1", "verdict": "not violated", "check": "always (gap > 0)"},
        {"requirement": "FUN-1", "verdict": "satisfied", "check": "checks:in_words"},
        VERDICTS[0],
    ]
    first, second = player_data(crossing(), verdicts)["margins"]
    assert (first["formula"], first["requirements"]) == ("gap > 0", ["SAF-1", "REC-1"])
    assert (first["violated"], second["violated"]) == (True, False)
    np.testing.assert_allclose(first["values"], crossing().signals["gap"], atol=1e-4)
    assert second["values"] == [5] * TICKS


def test_margins_are_bounded():
    verdicts = [
        {"requirement": f"R-{one}", "verdict": "satisfied", "check": f"always (gap > -{one})"}
        for one in range(100)
    ]
    assert len(player_data(crossing(), verdicts)["margins"]) == MAX_MARGINS


def test_faults_have_intervals():
    def event(tick, kind, subject):
        return {"tick": tick, "kind": kind, "subject": subject}

    events = [
        event(2, "fault_activated", "a"), event(3, "fault_activated", "b"),
        event(4, "fault_manifested", "a"), event(6, "fault_deactivated", "a"),
        event(8, "fault_activated", "a"), event(7, "fault_deactivated", "unheard of"),
    ]  # fmt: skip
    assert player_data(crossing(events=events))["faults"] == [
        {"id": "a", "from": 2, "to": 6, "manifested": [4]},
        {"id": "b", "from": 3, "to": TICKS - 1, "manifested": []},
        {"id": "a", "from": 8, "to": TICKS - 1, "manifested": []},
    ]


def test_a_collision_is_an_event_once():
    measures = [
        make(MeasureInfo, signal="collided", event="collision"), make(MeasureInfo, signal=None)
    ]  # fmt: skip
    data = player_data(crossing(), (), measures)
    assert data["marks"] == [["collided", "collision"]]
    assert [row[:2] for row in data["events"]].count([36, "collision"]) == 1
    assert not any(row[1] == "collision" for row in player_data(crossing())["events"])
    told = [{"tick": 36, "kind": "collision", "subject": "V1", "detail": "into V1"}]
    again = player_data(crossing(events=told), (), measures)
    assert again["events"] == [[36, "collision", "V1", "into V1"]]


def test_texts_are_bounded_and_names_stay_apart():
    many = TICKS - 1
    recording = Recording(explanations=("x" * 1_000_000,) * many)
    names = {"a" * 1000 + end: np.zeros(TICKS) for end in "xy"}
    data = player_data(crossing(recording=recording, signals=names))
    (text,) = data["explanations"]["words"]
    assert len(text) <= LIMIT
    assert text.endswith("(1000000 characters)")
    assert len(data["signals"]) == 2


@settings(derandomize=True, deadline=None, max_examples=40)
@given(traces())
def test_any_trace_is_packed_and_unpacked(trace):
    data = player_data(trace)
    text = pack_data(data)
    assert re.fullmatch(r"[A-Za-z0-9+/]*=*", text)
    assert unpacked(text) == data


def test_the_policy_allows_the_pages_own_script_and_style_alone():
    page = player_page(crossing(), VERDICTS)
    policy = html.unescape(re.search(r'Security-Policy" content="([^"]*)"', page)[1])
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    styles = re.findall(r"<style>(.*?)</style>", page, re.DOTALL)
    assert (len(scripts), len(styles)) == (1, 1)
    assert rules["default-src"] == "'none'"
    assert rules["script-src"] == content_hash(scripts[0])
    assert rules["style-src"] == content_hash(styles[0])
    assert "unsafe" not in policy
    assert unpacked(re.search(r'id="episode">([^<]*)<', page)[1]) == player_data(
        crossing(), VERDICTS
    )


@pytest.mark.parametrize("text", player_assets(), ids=["script", "style"])
def test_script_and_style_end_no_element_and_reach_nothing(text):
    assert "</" not in text
    assert "<!--" not in text
    for word in ("http:", "https:", "//cdn", "innerHTML", "eval(", "@import", "url("):
        assert word not in text.replace("http://www.w3.org/2000/svg", "")


def test_the_page_is_the_same_each_time_and_small():
    assert player_page(crossing(), VERDICTS) == player_page(crossing(), VERDICTS)
    assert len(pack_data(player_data(crossing(), VERDICTS))) < 3000


def test_what_the_component_told_is_shown_line_by_line():
    accounts = ({"cited": ["V1"], "intent": "hold"},) * 2 + ({},)
    told = player_data(crossing(recording=Recording(accounts=accounts)))["accounts"]
    assert told == {"words": ['cited: ["V1"]\nintent: "hold"', ""], "at": [0, 0, 1]}
    assert player_data(crossing())["accounts"] == {"words": [], "at": []}


# The same seed without something


def shortened(trace, ticks):
    recording = trace.recording
    scene = recording.scene
    truth = Tracks(scene.truth.ids, scene.truth.poses[:ticks])
    return replace(
        trace,
        time=trace.time[:ticks],
        signals={name: column[:ticks] for name, column in trace.signals.items()},
        decisions={name: column[: ticks - 1] for name, column in trace.decisions.items()},
        recording=replace(recording, scene=replace(scene, truth=truth)),
    )


def test_a_twin_is_its_ego_at_the_same_times_until_it_ends():
    trace = crossing()
    (twin,) = player_data(trace, twins=[Twin("recovery_planner", shortened(trace, 21))])["twins"]
    assert (twin["label"], twin["ended"]) == ("without RecoveryPlanner", "critical at 2.00 s")
    assert twin["last"] == 20
    assert twin["acted"] is None
    way = poses([{"id": "", "runs": twin["runs"], "same": []}], TICKS)[""]
    own = trace.recording.scene.truth.poses[:, 0]
    np.testing.assert_allclose(way[:21], own[:21], atol=0.005)
    assert np.isnan(way[21:]).all()


def test_the_first_difference_of_a_twin_is_of_what_was_measured():
    trace = crossing()
    gap = trace.signals["gap"].copy()
    gap[7:] += 1.0
    executed = trace.decisions["executed"].copy()
    executed[9] = "slow"
    other = replace(
        trace,
        signals=trace.signals | {"gap": gap},
        decisions=trace.decisions | {"executed": executed},
    )
    (twin,) = player_data(trace, twins=[Twin("faults", other)])["twins"]
    assert twin["difference"] == [7, "gap: 16.15 here, 17.15 there"]
    assert twin["acted"] == [9, "go 9 here, slow there"]
    (same,) = player_data(trace, twins=[Twin("faults", crossing())])["twins"]
    assert (same["difference"], same["acted"], same["last"]) == (None, None, None)


@pytest.mark.parametrize(
    "check, time, until",
    [
        ("eventually (speed > 11)", 4.0, 40),
        ("eventually[0:2] (speed > 11)", 2.0, 20),
        ("always (gap > 5 implies eventually[0:1] (gap > 50))", 1.0, 10),
        ("not (always (speed > 5))", 4.0, 40),
        ("(gap > 0) until (speed > 11)", None, 40),
        ("always (gap > 0)", 3.6, None),
        ("not (eventually (gap < 0))", 3.6, None),
        ("(eventually (gap < 0)) implies (always (speed > 11))", 0.0, None),
    ],
)
def test_what_has_to_come_about_is_open_until_it_is_lost(check, time, until):
    verdict = {**VERDICTS[0], "check": check, "time": time}
    (margin,) = player_data(crossing(), [verdict])["margins"]
    assert margin["open"] == until
