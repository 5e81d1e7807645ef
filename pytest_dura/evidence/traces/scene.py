"""The scene of a trace as Foxglove's SceneUpdate: y upwards, angles counter-clockwise, in "map"."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.recording import Line, Scene, Tracks
from pytest_dura.evidence.traces.messages import Message, Texts, moment, nanoseconds
from pytest_dura.evidence.traces.trace import Trace

HEIGHT = 1.5
"""Metres; the scene is flat."""


def _color(red: float, green: float, blue: float, alpha: float) -> str:
    return f'{{"r":{red},"g":{green},"b":{blue},"a":{alpha}}}'


EGO = _color(0.16, 0.47, 0.89, 1.0)
OTHER = _color(0.45, 0.45, 0.48, 1.0)
PERCEIVED = _color(0.98, 0.75, 0.18, 0.35)
GHOST = _color(0.91, 0.16, 0.24, 0.6)
"""Of what is perceived and not there."""
_LINES = {
    "edge": (0.2, _color(0.6, 0.6, 0.6, 1.0)),
    "marking": (0.1, _color(0.85, 0.85, 0.85, 1.0)),
    "stop_line": (0.4, _color(0.95, 0.95, 0.95, 1.0)),
    "route": (0.3, _color(0.16, 0.47, 0.89, 0.5)),
}
_LINE = (0.15, _color(0.7, 0.7, 0.7, 1.0))

_UPRIGHT = '"orientation":{"x":0,"y":0,"z":0,"w":1}'
# x, y, z and w of the orientation; then what does not change, as it is put in beforehand.
_CUBE = (
    '{"pose":{"position":{"x":%%.3f,"y":%%.3f,"z":%s},'
    '"orientation":{"x":0,"y":0,"z":%%.5f,"w":%%.5f}},'
    '"size":{"x":%%.3f,"y":%%.3f,"z":%s},"color":%s}'
)
_TEXT = (
    '{"pose":{"position":{"x":%%.3f,"y":%%.3f,"z":%s},' + _UPRIGHT + "},"
    '"billboard":true,"font_size":12,"scale_invariant":true,"color":%s,"text":%s}'
)


def road_messages(trace: Trace, texts: Texts) -> Iterator[Message]:
    """What does not move, once; on a channel of its own, so that a viewer that jumps finds it."""
    scene = trace.recording.scene
    if scene is not None and scene.lines and len(trace.time):
        time = nanoseconds(float(trace.time[0]))
        lines = ",".join(map(_line, scene.lines))
        yield time, _update(time, texts("road"), lines=lines)


def _line(line: Line) -> str:
    thickness, color = _LINES.get(line.kind, _LINE)
    points = np.asarray(line.points, np.float64)
    points = points[np.isfinite(points).all(axis=1)].tolist()
    told = ",".join(f'{{"x":{x:.3f},"y":{-y:.3f},"z":0}}' for x, y in points)
    return (
        f'{{"type":0,"pose":{{"position":{{"x":0,"y":0,"z":0}},{_UPRIGHT}}},'
        f'"thickness":{thickness},"scale_invariant":false,"points":[{told}],"color":{color},'
        '"colors":[],"indices":[]}'
    )


def truth_messages(trace: Trace, texts: Texts) -> Iterator[Message]:
    """All that is there, tick by tick."""
    scene = trace.recording.scene
    if scene is None:
        return
    ticks = min(len(trace.time), len(scene.truth.poses))
    cubes, labels = _empty(ticks), _empty(ticks)
    for number, name in enumerate(scene.truth.ids):
        poses, color = scene.truth.poses[:ticks, number], EGO if name == scene.ego else OTHER
        _show(poses, _present(poses), color, texts(name), cubes, labels)
    yield from _updates(trace, texts("truth"), cubes, labels)


def percept_messages(trace: Trace, texts: Texts) -> Iterator[Message]:
    """All that is perceived, tick by tick; a ghost has a colour and a name of its own."""
    scene = trace.recording.scene
    if scene is None:
        return
    ticks = min(len(trace.time), len(scene.truth.poses), len(scene.percept.poses))
    cubes, labels = _empty(ticks), _empty(ticks)
    there = _presence(scene, ticks)
    for number, name in enumerate(scene.percept.ids):
        poses = scene.percept.poses[:ticks, number]
        present, real = _present(poses), there.get(name, np.zeros(ticks, bool))
        _show(poses, present & real, PERCEIVED, None, cubes, labels)
        _show(poses, present & ~real, GHOST, texts(f"{name} (ghost)"), cubes, labels)
    yield from _updates(trace, texts("percept"), cubes, labels)


def _presence(scene: Scene, ticks: int) -> Mapping[str, NDArray[np.bool_]]:
    """When each thing is really there, by id."""
    truth: Tracks = scene.truth
    return {name: _present(truth.poses[:ticks, i]) for i, name in enumerate(truth.ids)}


def _present(poses: NDArray[np.float32]) -> NDArray[np.bool_]:
    found: NDArray[np.bool_] = np.isfinite(poses).all(axis=1)
    return found


def _empty(ticks: int) -> list[list[str]]:
    return [[] for _ in range(ticks)]


def _show(
    poses: NDArray[np.float32],
    chosen: NDArray[np.bool_],
    color: str,
    label: str | None,
    cubes: list[list[str]],
    labels: list[list[str]],
) -> None:
    """Add a thing to the ticks that are chosen."""
    ticks = np.flatnonzero(chosen)
    if not len(ticks):
        return
    own = poses[ticks].astype(np.float64)
    half = -own[:, 2] / 2.0
    columns = np.column_stack(
        [own[:, 0], -own[:, 1], np.sin(half), np.cos(half), own[:, 4], own[:, 5]]
    )
    cube = _CUBE % (HEIGHT / 2.0, HEIGHT, color)
    text = None if label is None else _TEXT % (HEIGHT + 0.5, color, label.replace("%", "%%"))
    for tick, row in zip(ticks.tolist(), columns.tolist(), strict=True):
        cubes[tick].append(cube % tuple(row))
        if text is not None:
            labels[tick].append(text % (row[0], row[1]))


def _updates(
    trace: Trace, name: str, cubes: list[list[str]], labels: list[list[str]]
) -> Iterator[Message]:
    for seconds, boxes, own in zip(trace.time.tolist(), cubes, labels, strict=False):
        time = nanoseconds(seconds)
        yield time, _update(time, name, cubes=",".join(boxes), labels=",".join(own))


def _update(time: int, name: str, cubes: str = "", lines: str = "", labels: str = "") -> str:
    """An update with one entity, which stays until the next one of its name."""
    return (
        f'{{"deletions":[],"entities":[{{"timestamp":{moment(time)},"frame_id":"map","id":{name},'
        '"lifetime":{"sec":0,"nsec":0},"frame_locked":false,"metadata":[],"arrows":[],'
        f'"cubes":[{cubes}],"spheres":[],"cylinders":[],"lines":[{lines}],"triangles":[],'
        f'"texts":[{labels}],"models":[]}}]}}'
    )
