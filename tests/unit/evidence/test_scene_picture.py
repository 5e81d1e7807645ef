"""The scene of a trace as a picture at one time."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from player_traces import crossing, without_scene

from pytest_dura.core import Line, Tracks
from pytest_dura.reports import frame_svg

SVG = "{http://www.w3.org/2000/svg}"


def drawn(trace, time, **options):
    text = frame_svg(trace, time, **({"label": "what happens"} | options))
    assert len(text) < 15_000
    return ET.fromstring(text)


def shapes(picture, look):
    return [each for each in picture.iter() if each.get("class") == f"dura-f-{look}"]


def labels(picture):
    return {each.text for each in picture.iter(f"{SVG}text")}


def middle(shape):
    corners = np.array([pair.split(",") for pair in shape.get("points").split()], float)
    return corners.mean(axis=0)


def with_scene(trace, **changes):
    recording = trace.recording
    return replace(trace, recording=replace(recording, scene=replace(recording.scene, **changes)))


def test_a_picture_has_a_label_and_what_is_there():
    picture = drawn(crossing(), 0.0)
    assert (picture.get("role"), picture.get("aria-label")) == ("img", "what happens")
    assert len(shapes(picture, "ego")) == len(shapes(picture, "route")) == 1
    assert "EGO" in labels(picture)


def test_things_stand_where_they_are_at_the_time():
    trace = crossing()
    picture = drawn(trace, 3.6)
    ego, other = (middle(shapes(picture, look)[0]) for look in ("ego", "truth"))
    poses = trace.recording.scene.truth.poses[36, :, :2]
    expected = poses[1] - poses[0]
    scale = float(picture.get("width")) / 56.0
    assert (other - ego) / scale == pytest.approx(expected, abs=0.2)


def test_a_time_between_ticks_is_that_of_the_tick_before():
    assert frame_svg(crossing(), 3.69, label="") == frame_svg(crossing(), 3.6, label="")


def test_ghosts_and_what_was_not_perceived_differ_from_the_truth():
    assert labels(drawn(crossing(), 1.5)) >= {"GHOST (ghost)"}
    assert len(shapes(drawn(crossing(), 1.5), "ghost")) == 1
    unseen = drawn(crossing(), 2.6)
    assert len(shapes(unseen, "missing")) == 1
    assert not shapes(unseen, "truth")
    assert len(shapes(drawn(crossing(), 3.2), "percept")) == 1  # where the ego believes to be


def test_the_ego_of_the_twin_is_a_shadow_at_the_same_time():
    scene = crossing().recording.scene
    poses = scene.truth.poses.copy()
    poses[:, 0, 1] += 8.0
    twin = with_scene(crossing(), truth=Tracks(scene.truth.ids, poses))
    assert not shapes(drawn(crossing(), 3.6), "twin")
    picture = drawn(crossing(), 3.6, twin=twin)
    ego, shadow = (middle(shapes(picture, look)[0]) for look in ("ego", "twin"))
    scale = float(picture.get("width")) / 56.0
    assert (shadow - ego) / scale == pytest.approx((0.0, 8.0), abs=0.2)
    assert "twin" in labels(picture)


def test_without_a_scene_or_a_tick_there_is_nothing():
    assert frame_svg(without_scene(), 0.0, label="") == ""
    assert frame_svg(crossing(), float("nan"), label="") == ""


def test_a_crowd_and_long_lines_stay_small():
    scene, count = crossing().recording.scene, 2_000
    poses = np.full((41, count, 6), np.nan, np.float32)
    poses[:] = (0.0, 0.0, 0.3, 1.0, 4.5, 1.8)
    poses[:, :, 0] = np.linspace(-1e7, 1e7, count)
    poses[:, 1:500, 0] = np.linspace(-20, 20, 499)
    crowd = Tracks(tuple(f"thing with a long name {i}" for i in range(count)), poses)
    angle = np.linspace(0, 700, 20_000)
    coil = Line("edge", np.stack([20 * np.cos(angle), angle / 20], axis=1).astype(np.float32))
    lines = (coil, Line("strange", np.full((3, 2), np.nan, np.float32)))
    trace = with_scene(crossing(), lines=lines, truth=crowd, percept=scene.percept)
    picture = drawn(trace, 1.0)
    assert shapes(picture, "missing")
    assert not re.search("nan|inf", frame_svg(trace, 1.0, label="x"))
