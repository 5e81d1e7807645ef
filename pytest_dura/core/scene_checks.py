"""Whether a scene has the types and shapes that traces and players rely on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pytest_dura.core.recording import POSE, Line, Scene, Tracks


def scene_problems(scene: Any, ticks: int) -> Iterator[tuple[str, str]]:
    """What is wrong with a scene, and how to mend it. Its values may be anything.

    Args:
        scene: What a simulator's ``scene`` returned.
        ticks: How many ticks it was given.
    """
    if not isinstance(scene, Scene):
        yield f"scene is a {type(scene).__name__}", "return a pytest_dura.Scene, or None"
        return
    lines = scene.lines
    if not isinstance(lines, tuple) or not all(isinstance(one, Line) for one in lines):
        yield "lines is no tuple of Line", "return a tuple of pytest_dura.Line"
    else:
        for number, line in enumerate(lines):
            yield from _line_problems(f"lines[{number}]", line)
    for name in ("truth", "percept"):
        yield from _tracks_problems(name, getattr(scene, name), ticks)
    if not isinstance(scene.ego, str):
        yield f"ego is a {type(scene.ego).__name__}", "give the id of what the component steers"


def value_problems(scene: Scene) -> Iterator[tuple[str, str]]:
    """What is wrong with the values of a scene of right types, where no fault is about."""
    for number, line in enumerate(scene.lines):
        if not np.isfinite(line.points).all():
            yield f"lines[{number}].points is not finite", "give x and y in metres"
    for name in ("truth", "percept"):
        poses = getattr(scene, name).poses
        absent = np.isnan(poses).any(axis=2)
        if np.isinf(poses).any() or not np.isnan(poses[absent]).all():
            yield (
                f"{name}.poses is not finite where something is present",
                "give all of a pose, or NaN for all of it where the thing is absent",
            )
    if scene.ego not in scene.truth.ids:
        yield (
            f"ego is {scene.ego!r}, which is not in truth.ids",
            "name the thing that the component steers",
        )


def _line_problems(name: str, line: Line) -> Iterator[tuple[str, str]]:
    if not isinstance(line.kind, str):
        yield f"{name}.kind is a {type(line.kind).__name__}", "name the kind of the line"
    shape = np.shape(line.points)
    if not _is_float32(line.points) or len(shape) != 2 or shape[1] != 2:
        yield (
            f"{name}.points is {_told(line.points)}, expected float32 of shape (k, 2)",
            "give x and y in metres as float32",
        )


def _tracks_problems(name: str, tracks: Any, ticks: int) -> Iterator[tuple[str, str]]:
    if not isinstance(tracks, Tracks):
        yield f"{name} is a {type(tracks).__name__}", "return pytest_dura.Tracks"
        return
    ids = tracks.ids
    if not isinstance(ids, tuple) or not all(isinstance(one, str) for one in ids):
        yield f"{name}.ids is no tuple of texts", "name each thing by a text"
        return
    if len(set(ids)) < len(ids):
        twice = next(one for one in ids if ids.count(one) > 1)
        yield f"{name}.ids has {twice!r} more than once", "give each thing an id of its own"
    expected = (ticks, len(ids), len(POSE))
    if not _is_float32(tracks.poses) or np.shape(tracks.poses) != expected:
        yield (
            f"{name}.poses is {_told(tracks.poses)}, expected float32 of shape {expected}",
            "give a pose for each tick and each thing as float32, NaN where it is absent",
        )


def _is_float32(array: Any) -> bool:
    return isinstance(array, np.ndarray) and array.dtype == np.float32


def _told(array: Any) -> str:
    return f"{getattr(array, 'dtype', type(array).__name__)} of shape {np.shape(array)}"
