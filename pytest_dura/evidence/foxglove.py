"""Messages and schemas of a trace's channels, as Foxglove shows them.

Foxglove's schemas have exactly its published field names. In scenes y points upwards and
angles run counter-clockwise, in the frame "map".
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.simulator import Line
from pytest_dura.evidence.text import visible
from pytest_dura.evidence.traces import Trace, without_exchange

Schema = dict[str, Any]

_TEXT_SCHEMA: Schema = {"type": "string"}
_NUMBER_SCHEMA: Schema = {"type": "number"}
_VALUE_SCHEMA: Schema = {"type": ["number", "null"]}
_INTEGER_SCHEMA: Schema = {"type": "integer"}


def _object_schema(title: str | None = None, /, **properties: Schema) -> Schema:
    """Schema of an object with exactly these fields."""
    return {
        **({} if title is None else {"title": title}),
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _list_schema(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def _mapping_schema(values: Schema) -> Schema:
    return {"type": "object", "additionalProperties": values}


def _choice_schema(title: str, *names: str) -> Schema:
    """Schema of a number that stands for one of these names."""
    choices = [{"title": name, "const": number} for number, name in enumerate(names)]
    return {"title": title, "oneOf": choices}


def _time_schema(title: str, least: Schema) -> Schema:
    nanoseconds: Schema = {"type": "integer", "minimum": 0, "maximum": 999999999}
    return _object_schema(title, sec={"type": "integer", **least}, nsec=nanoseconds)


_TIME_SCHEMA = _time_schema("time", {"minimum": 0})
_DURATION_SCHEMA = _time_schema("duration", {})

_SIGNALS_SCHEMA: Schema = _object_schema(
    "pytest_dura.Signals",
    tick=_INTEGER_SCHEMA,
    time=_NUMBER_SCHEMA,
    truth={**_mapping_schema(_VALUE_SCHEMA), "description": "As the simulator knows them."},
    percept={
        **_mapping_schema(_VALUE_SCHEMA),
        "description": "As the sensors report them after faults.",
    },
)
_DECISION_SCHEMA: Schema = _object_schema(
    "pytest_dura.Decision",
    tick=_INTEGER_SCHEMA,
    time=_NUMBER_SCHEMA,
    columns={
        "description": "proposed, executed, source, verdict (0 safe, 1 warning, 2 unsafe), "
        "attempts",
        **_mapping_schema({"type": ["string", "number", "boolean", "null"]}),
    },
    explanation=_TEXT_SCHEMA,
    reason=_TEXT_SCHEMA,
    recovery=_TEXT_SCHEMA,
    flags={
        "description": "By monitor: 0 safe, 1 warning, 2 unsafe, -1 not asked.",
        **_mapping_schema(_INTEGER_SCHEMA),
    },
    account={
        "description": "The component's account of its decision; empty if nothing.",
        "type": "object",
    },
)
_LOG_SCHEMA: Schema = _object_schema(
    "foxglove.Log",
    timestamp=_TIME_SCHEMA,
    level=_choice_schema(
        "foxglove.LogLevel", "UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"
    ),
    message=_TEXT_SCHEMA,
    name=_TEXT_SCHEMA,
    file=_TEXT_SCHEMA,
    line={"type": "integer", "minimum": 0},
)


@cache
def _scene_update_schema() -> Schema:
    """Schema ``foxglove.SceneUpdate`` with cubes, lines and texts; other primitives are empty."""
    xyz = _object_schema("foxglove.Vector3", **dict.fromkeys("xyz", _NUMBER_SCHEMA))
    turn = _object_schema("foxglove.Quaternion", **dict.fromkeys("xyzw", _NUMBER_SCHEMA))
    pose = _object_schema("foxglove.Pose", position=xyz, orientation=turn)
    share: Schema = {"type": "number", "minimum": 0, "maximum": 1}
    color = _object_schema("foxglove.Color", **dict.fromkeys("rgba", share))
    truth: Schema = {"type": "boolean"}
    point = _object_schema("foxglove.Point3", **dict.fromkeys("xyz", _NUMBER_SCHEMA))
    line_type = _choice_schema("foxglove.LineType", "LINE_STRIP", "LINE_LOOP", "LINE_LIST")
    nothing: Schema = {"type": "array", "maxItems": 0}
    entity = _object_schema(
        "foxglove.SceneEntity",
        timestamp=_TIME_SCHEMA,
        frame_id=_TEXT_SCHEMA,
        id=_TEXT_SCHEMA,
        lifetime=_DURATION_SCHEMA,
        frame_locked=truth,
        metadata=_list_schema(
            _object_schema("foxglove.KeyValuePair", key=_TEXT_SCHEMA, value=_TEXT_SCHEMA)
        ),
        arrows=nothing,
        cubes=_list_schema(
            _object_schema("foxglove.CubePrimitive", pose=pose, size=xyz, color=color)
        ),
        spheres=nothing,
        cylinders=nothing,
        lines=_list_schema(
            _object_schema(
                "foxglove.LinePrimitive",
                type=line_type,
                pose=pose,
                thickness=_NUMBER_SCHEMA,
                scale_invariant=truth,
                points=_list_schema(point),
                color=color,
                colors=_list_schema(color),
                indices=_list_schema({"type": "integer", "minimum": 0}),
            )
        ),
        triangles=nothing,
        texts=_list_schema(
            _object_schema(
                "foxglove.TextPrimitive",
                pose=pose,
                billboard=truth,
                font_size=_NUMBER_SCHEMA,
                scale_invariant=truth,
                color=color,
                text=_TEXT_SCHEMA,
            )
        ),
        models=nothing,
    )
    return _object_schema("foxglove.SceneUpdate", deletions=nothing, entities=_list_schema(entity))


CHANNELS = ("/signals", "/decision", "/events", "/scene/road", "/scene/truth", "/scene/percept")


def schema_of(channel: str) -> Schema:
    """Look up the schema of a channel's messages."""
    schemas = {"/signals": _SIGNALS_SCHEMA, "/decision": _DECISION_SCHEMA, "/events": _LOG_SCHEMA}
    return schemas.get(channel) or _scene_update_schema()


@cache
def schema_text(channel: str) -> bytes:
    """Encode the schema for the file."""
    return json.dumps(schema_of(channel), separators=(",", ":")).encode()


Message = tuple[int, str]
"""Simulated time in nanoseconds, and JSON in ASCII."""

MAX_TEXT = 1000
"""Greatest number of characters of a text for viewers; the columns have all of it."""
_PERCEPT = "percept."
_INFO, _WARNING, _ERROR = 2, 3, 4
_LEVELS = {
    **dict.fromkeys(("infrastructure", "component_failure", "critical", "halt"), _ERROR),
    **dict.fromkeys(("unsafe", "alert", "performance_fail", "fault_manifested"), _WARNING),
}


def nanoseconds(time: float) -> int:
    """Convert seconds to nanoseconds; a time that a file cannot hold becomes 0."""
    return round(time * 1e9) if 0.0 <= time < 1e9 else 0


def _foxglove_time(time: int) -> str:
    return f'{{"sec":{time // 10**9},"nsec":{time % 10**9}}}'


class TextCache:
    """Converts texts to JSON, harmless and bounded, each distinct text once."""

    def __init__(self) -> None:
        self._strings: dict[str, str] = {}

    def __call__(self, text: str) -> str:
        """Convert a text to a JSON string."""
        if text not in self._strings:
            self._strings[text] = json.dumps(self.shown(text))
        return self._strings[text]

    def any(self, value: Any) -> str:
        """Convert plain data to JSON, its texts harmless and bounded."""
        return json.dumps(self._plain(value), sort_keys=True)

    @staticmethod
    def shown(text: str) -> str:
        """Make a text harmless and bounded."""
        plain = len(text) <= MAX_TEXT and text.isascii() and text.isprintable()
        return text if plain else visible(text, MAX_TEXT, hashed=True)

    def _plain(self, value: Any) -> Any:
        if isinstance(value, str):
            return self.shown(value)
        if isinstance(value, Mapping):
            return {self.shown(str(key)): self._plain(entry) for key, entry in value.items()}
        return [*map(self._plain, value)] if isinstance(value, (list, tuple)) else value


def signal_messages(trace: Trace, texts: TextCache) -> Iterator[Message]:
    """Yield truth and percept for each tick; ``null`` where there is no number."""
    truth: list[tuple[str, list[str]]] = []
    percept: list[tuple[str, list[str]]] = []
    for name, column in trace.signals.items():
        group = percept if name.startswith(_PERCEPT) else truth
        group.append((texts(name.removeprefix(_PERCEPT)), _numbers(column)))
    time = trace.time.tolist()
    rows = zip(
        _rows([name for name, _ in truth], [column for _, column in truth], len(time)),
        _rows([name for name, _ in percept], [column for _, column in percept], len(time)),
        strict=True,
    )
    for tick, (shown, perceived) in enumerate(rows):
        text = f'"tick":{tick},"time":{_number(time[tick])},"truth":{shown},"percept":{perceived}'
        yield nanoseconds(time[tick]), f"{{{text}}}"


def _rows(names: Sequence[str], columns: Sequence[Sequence[str]], length: int) -> Iterator[str]:
    """Yield an object with these fields for each row."""
    if not names:
        yield from ["{}"] * length
        return
    # Names may have percent signs, which the template would interpret.
    template = "{" + ",".join(f"{name.replace('%', '%%')}:%s" for name in names) + "}"
    for row in zip(*columns, strict=True):
        yield template % row


def _numbers(column: Any) -> list[str]:
    values = column.tolist()
    if column.dtype.kind == "f" and not np.isfinite(column).all():
        return [_number(value) for value in values]
    if column.dtype.kind == "b":
        return [str(value).lower() for value in values]
    return [*map(repr, values)]


def _number(value: float) -> str:
    return repr(value) if math.isfinite(value) else "null"


def decision_messages(trace: Trace, texts: TextCache) -> Iterator[Message]:
    """Yield a message for each decision, at the time of its tick."""
    recording = trace.recording
    time = trace.time.tolist()
    columns = {name: column for name, column in trace.decisions.items() if column.ndim == 1}
    length = min([len(time), *map(len, columns.values())]) if columns else 0
    cells = [
        [*map(texts, column.tolist())] if column.dtype.kind == "U" else _numbers(column)
        for column in columns.values()
    ]
    decisions = _rows([*map(texts, columns)], [column[:length] for column in cells], length)
    monitors = [(name, flag) for name, flag in recording.flags.items() if len(flag) >= length]
    flags = _rows(
        [texts(name) for name, _ in monitors], [_numbers(flag[:length]) for _, flag in monitors],
        length,
    )  # fmt: skip
    remarks = [
        (*map(texts, column[:length]), *['""'] * (length - len(column)))
        for column in (recording.explanations, recording.reasons, recording.recoveries)
    ]
    accounts = map(texts.any, map(without_exchange, recording.accounts[:length]))
    account_texts = (*accounts, *["{}"] * (length - len(recording.accounts)))
    rows = zip(decisions, flags, *remarks, account_texts, strict=True)
    for tick, (columns_text, flag, explanation, reason, recovery, account) in enumerate(rows):
        message = (
            f'"tick":{tick},"time":{_number(time[tick])},"columns":{columns_text},'
            f'"explanation":{explanation},"reason":{reason},"recovery":{recovery},"flags":{flag},'
            f'"account":{account}'
        )
        yield nanoseconds(time[tick]), f"{{{message}}}"


def event_messages(trace: Trace, texts: TextCache) -> Iterator[Message]:
    """Yield events as log messages: ``kind subject: detail``."""
    for event in trace.events:
        seconds = event.get("time")
        time = nanoseconds(float(seconds)) if isinstance(seconds, (int, float)) else 0
        kind, subject, detail = (str(event.get(key, "")) for key in ("kind", "subject", "detail"))
        message = f"{kind} {subject}" + (f": {detail}" if detail else "")
        text = (
            f'"timestamp":{_foxglove_time(time)},"level":{_LEVELS.get(kind, _INFO)},'
            f'"message":{texts(message)},"name":{texts(kind)},"file":"","line":0'
        )
        yield time, f"{{{text}}}"


_OBJECT_HEIGHT = 1.5
"""Metres, for a scene that is flat."""


def _color(red: float, green: float, blue: float, alpha: float) -> str:
    return f'{{"r":{red},"g":{green},"b":{blue},"a":{alpha}}}'


EGO_COLOR = _color(0.16, 0.47, 0.89, 1.0)
_OTHER_COLOR = _color(0.45, 0.45, 0.48, 1.0)
PERCEIVED_COLOR = _color(0.98, 0.75, 0.18, 0.35)
GHOST_COLOR = _color(0.91, 0.16, 0.24, 0.6)
"""Colour of objects that are perceived and not there."""
_LINES = {
    "edge": (0.2, _color(0.6, 0.6, 0.6, 1.0)),
    "marking": (0.1, _color(0.85, 0.85, 0.85, 1.0)),
    "stop_line": (0.4, _color(0.95, 0.95, 0.95, 1.0)),
    "route": (0.3, _color(0.16, 0.47, 0.89, 0.5)),
}
_LINE = (0.15, _color(0.7, 0.7, 0.7, 1.0))

_UPRIGHT = '"orientation":{"x":0,"y":0,"z":0,"w":1}'
# Formatted twice: first with what is constant for an object, then with its pose.
_CUBE_MARKER = (
    '{"pose":{"position":{"x":%%.3f,"y":%%.3f,"z":%s},'
    '"orientation":{"x":0,"y":0,"z":%%.5f,"w":%%.5f}},'
    '"size":{"x":%%.3f,"y":%%.3f,"z":%s},"color":%s}'
)
_TEXT_MARKER = (
    '{"pose":{"position":{"x":%%.3f,"y":%%.3f,"z":%s},' + _UPRIGHT + "},"
    '"billboard":true,"font_size":12,"scale_invariant":true,"color":%s,"text":%s}'
)


def road_messages(trace: Trace, texts: TextCache) -> Iterator[Message]:
    """Yield what does not move, once, on a channel of its own for viewers that jump."""
    scene = trace.recording.scene
    if scene is not None and scene.lines and len(trace.time):
        time = nanoseconds(float(trace.time[0]))
        lines = ",".join(map(_line, scene.lines))
        yield time, _update(time, texts("road"), lines=lines)


def _line(line: Line) -> str:
    thickness, color = _LINES.get(line.kind, _LINE)
    points = np.asarray(line.points, np.float64)
    points = points[np.isfinite(points).all(axis=1)].tolist()
    text = ",".join(f'{{"x":{x:.3f},"y":{-y:.3f},"z":0}}' for x, y in points)
    return (
        f'{{"type":0,"pose":{{"position":{{"x":0,"y":0,"z":0}},{_UPRIGHT}}},'
        f'"thickness":{thickness},"scale_invariant":false,"points":[{text}],"color":{color},'
        '"colors":[],"indices":[]}'
    )


def truth_messages(trace: Trace, texts: TextCache) -> Iterator[Message]:
    """Yield the true scene, tick by tick."""
    scene = trace.recording.scene
    if scene is None:
        return
    canvas = _Canvas(min(len(trace.time), len(scene.truth.poses)))
    for number, name in enumerate(scene.truth.ids):
        poses = scene.truth.poses[: canvas.ticks, number]
        canvas.show(
            poses, _present(poses), EGO_COLOR if name == scene.ego else _OTHER_COLOR, texts(name)
        )
    yield from canvas.updates(trace, texts("truth"))


def percept_messages(trace: Trace, texts: TextCache) -> Iterator[Message]:
    """Yield the perceived scene, tick by tick; ghosts have their own colour and name."""
    scene = trace.recording.scene
    if scene is None:
        return
    canvas = _Canvas(min(len(trace.time), len(scene.truth.poses), len(scene.percept.poses)))
    truth = scene.truth
    # Ticks at which each object is there in truth.
    presence = {name: _present(truth.poses[: canvas.ticks, i]) for i, name in enumerate(truth.ids)}
    for number, name in enumerate(scene.percept.ids):
        poses = scene.percept.poses[: canvas.ticks, number]
        present, real = _present(poses), presence.get(name, np.zeros(canvas.ticks, bool))
        canvas.show(poses, present & real, PERCEIVED_COLOR)
        canvas.show(poses, present & ~real, GHOST_COLOR, texts(f"{name} (ghost)"))
    yield from canvas.updates(trace, texts("percept"))


def _present(poses: NDArray[np.float32]) -> NDArray[np.bool_]:
    return np.array(np.isfinite(poses).all(axis=1), np.bool_)


class _Canvas:
    """Collects the primitives to be shown at each tick."""

    def __init__(self, ticks: int) -> None:
        self.ticks = ticks
        self._cubes: list[list[str]] = [[] for _ in range(ticks)]
        self._labels: list[list[str]] = [[] for _ in range(ticks)]

    def show(
        self, poses: NDArray[np.float32], when: NDArray[np.bool_], color: str, label: str = ""
    ) -> None:
        """Add an object to the ticks at which it is visible."""
        ticks = np.flatnonzero(when)
        visible_poses = poses[ticks].astype(np.float64)
        half = -visible_poses[:, 2] / 2.0
        columns = np.column_stack(
            [
                visible_poses[:, 0],
                -visible_poses[:, 1],
                np.sin(half),
                np.cos(half),
                visible_poses[:, 4],
                visible_poses[:, 5],
            ]
        )
        cube = _CUBE_MARKER % (_OBJECT_HEIGHT / 2.0, _OBJECT_HEIGHT, color)
        text = _TEXT_MARKER % (_OBJECT_HEIGHT + 0.5, color, label.replace("%", "%%"))
        for tick, row in zip(ticks.tolist(), columns.tolist(), strict=True):
            self._cubes[tick].append(cube % tuple(row))
            if label:
                self._labels[tick].append(text % (row[0], row[1]))

    def updates(self, trace: Trace, name: str) -> Iterator[Message]:
        """Yield an update for each tick."""
        for tick, seconds in enumerate(trace.time[: self.ticks].tolist()):
            time = nanoseconds(seconds)
            cubes, labels = ",".join(self._cubes[tick]), ",".join(self._labels[tick])
            yield time, _update(time, name, cubes=cubes, labels=labels)


def _update(time: int, name: str, cubes: str = "", lines: str = "", labels: str = "") -> str:
    """Write an update with an entity, which stays until the next one of its name."""
    return (
        f'{{"deletions":[],"entities":[{{"timestamp":{_foxglove_time(time)},"frame_id":"map","id":{name},'
        '"lifetime":{"sec":0,"nsec":0},"frame_locked":false,"metadata":[],"arrows":[],'
        f'"cubes":[{cubes}],"spheres":[],"cylinders":[],"lines":[{lines}],"triangles":[],'
        f'"texts":[{labels}],"models":[]}}]}}'
    )
