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
    canvas = _Canvas(min(len(trace.time), len(scene.truth.poses)))
    for number, name in enumerate(scene.truth.ids):
        poses = scene.truth.poses[: canvas.ticks, number]
        canvas.show(poses, _present(poses), EGO if name == scene.ego else OTHER, texts(name))
    yield from canvas.updates(trace, texts("truth"))


def percept_messages(trace: Trace, texts: Texts) -> Iterator[Message]:
    """All that is perceived, tick by tick; a ghost has a colour and a name of its own."""
    scene = trace.recording.scene
    if scene is None:
        return
    canvas = _Canvas(min(len(trace.time), len(scene.truth.poses), len(scene.percept.poses)))
    there = _presence(scene, canvas.ticks)
    for number, name in enumerate(scene.percept.ids):
        poses = scene.percept.poses[: canvas.ticks, number]
        present, real = _present(poses), there.get(name, np.zeros(canvas.ticks, bool))
        canvas.show(poses, present & real, PERCEIVED)
        canvas.show(poses, present & ~real, GHOST, texts(f"{name} (ghost)"))
    yield from canvas.updates(trace, texts("percept"))


def _presence(scene: Scene, ticks: int) -> Mapping[str, NDArray[np.bool_]]:
    """When each thing is really there, by id."""
    truth: Tracks = scene.truth
    return {name: _present(truth.poses[:ticks, i]) for i, name in enumerate(truth.ids)}


def _present(poses: NDArray[np.float32]) -> NDArray[np.bool_]:
    return np.array(np.isfinite(poses).all(axis=1), np.bool_)


class _Canvas:
    """What is to be shown at each of so many ticks."""

    def __init__(self, ticks: int) -> None:
        self.ticks = ticks
        self._cubes: list[list[str]] = [[] for _ in range(ticks)]
        self._labels: list[list[str]] = [[] for _ in range(ticks)]

    def show(
        self, poses: NDArray[np.float32], when: NDArray[np.bool_], color: str, label: str = ""
    ) -> None:
        """Add a thing to the ticks at which it is to be seen."""
        ticks = np.flatnonzero(when)
        own = poses[ticks].astype(np.float64)
        half = -own[:, 2] / 2.0
        columns = np.column_stack(
            [own[:, 0], -own[:, 1], np.sin(half), np.cos(half), own[:, 4], own[:, 5]]
        )
        cube = _CUBE % (HEIGHT / 2.0, HEIGHT, color)
        text = _TEXT % (HEIGHT + 0.5, color, label.replace("%", "%%"))
        for tick, row in zip(ticks.tolist(), columns.tolist(), strict=True):
            self._cubes[tick].append(cube % tuple(row))
            if label:
                self._labels[tick].append(text % (row[0], row[1]))

    def updates(self, trace: Trace, name: str) -> Iterator[Message]:
        """One for each tick."""
        for tick, seconds in enumerate(trace.time[: self.ticks].tolist()):
            time = nanoseconds(seconds)
            cubes, labels = ",".join(self._cubes[tick]), ",".join(self._labels[tick])
            yield time, _update(time, name, cubes=cubes, labels=labels)


def _update(time: int, name: str, cubes: str = "", lines: str = "", labels: str = "") -> str:
    """An update with one entity, which stays until the next one of its name."""
    return (
        f'{{"deletions":[],"entities":[{{"timestamp":{moment(time)},"frame_id":"map","id":{name},'
        '"lifetime":{"sec":0,"nsec":0},"frame_locked":false,"metadata":[],"arrows":[],'
        f'"cubes":[{cubes}],"spheres":[],"cylinders":[],"lines":[{lines}],"triangles":[],'
        f'"texts":[{labels}],"models":[]}}]}}'
    )
