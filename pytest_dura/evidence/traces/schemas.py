"""JSON Schemas of a trace's channels. Foxglove's have its published field names, and no others."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

Schema = dict[str, Any]

_TEXT: Schema = {"type": "string"}
_NUMBER: Schema = {"type": "number"}
_VALUE: Schema = {"type": ["number", "null"]}
_WHOLE: Schema = {"type": "integer"}


def _object(title: str | None = None, /, **properties: Schema) -> Schema:
    """An object with exactly these fields."""
    return {
        **({} if title is None else {"title": title}),
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _list(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def _by_name(values: Schema) -> Schema:
    return {"type": "object", "additionalProperties": values}


def _moment(title: str, least: Schema) -> Schema:
    nanoseconds: Schema = {"type": "integer", "minimum": 0, "maximum": 999999999}
    return _object(title, sec={"type": "integer", **least}, nsec=nanoseconds)


_TIME = _moment("time", {"minimum": 0})
_DURATION = _moment("duration", {})

SIGNALS: Schema = _object(
    "pytest_dura.Signals",
    tick=_WHOLE,
    time=_NUMBER,
    truth={**_by_name(_VALUE), "description": "As the simulator knows them."},
    percept={**_by_name(_VALUE), "description": "As the sensors report them after faults."},
)
DECISION: Schema = _object(
    "pytest_dura.Decision",
    tick=_WHOLE,
    time=_NUMBER,
    columns={
        "description": "proposed, executed, source, verdict (0 safe, 1 warning, 2 unsafe), "
        "attempts",
        **_by_name({"type": ["string", "number", "boolean", "null"]}),
    },
    explanation=_TEXT,
    reason=_TEXT,
    recovery=_TEXT,
    flags={
        "description": "By monitor: 0 safe, 1 warning, 2 unsafe, -1 not asked.",
        **_by_name(_WHOLE),
    },
    account={
        "description": "What the component told of how it decided; empty if nothing.",
        "type": "object",
    },
)
LOG: Schema = _object(
    "foxglove.Log",
    timestamp=_TIME,
    level={
        "title": "foxglove.LogLevel",
        "oneOf": [
            {"title": title, "const": number}
            for number, title in enumerate(
                ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")
            )
        ],
    },
    message=_TEXT,
    name=_TEXT,
    file=_TEXT,
    line={"type": "integer", "minimum": 0},
)


@cache
def scene_update() -> Schema:
    """``foxglove.SceneUpdate``: cubes, lines and texts; the other primitives are empty lists."""
    xyz = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
    turn = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
    pose = _object("foxglove.Pose", position=xyz, orientation=turn)
    share: Schema = {"type": "number", "minimum": 0, "maximum": 1}
    color = _object("foxglove.Color", r=share, g=share, b=share, a=share)
    truth: Schema = {"type": "boolean"}
    point = _object("foxglove.Point3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
    line_type: Schema = {
        "title": "foxglove.LineType",
        "oneOf": [
            {"title": title, "const": number}
            for number, title in enumerate(("LINE_STRIP", "LINE_LOOP", "LINE_LIST"))
        ],
    }
    nothing: Schema = {"type": "array", "maxItems": 0}
    entity = _object(
        "foxglove.SceneEntity",
        timestamp=_TIME,
        frame_id=_TEXT,
        id=_TEXT,
        lifetime=_DURATION,
        frame_locked=truth,
        metadata=_list(_object("foxglove.KeyValuePair", key=_TEXT, value=_TEXT)),
        arrows=nothing,
        cubes=_list(_object("foxglove.CubePrimitive", pose=pose, size=xyz, color=color)),
        spheres=nothing,
        cylinders=nothing,
        lines=_list(
            _object(
                "foxglove.LinePrimitive",
                type=line_type,
                pose=pose,
                thickness=_NUMBER,
                scale_invariant=truth,
                points=_list(point),
                color=color,
                colors=_list(color),
                indices=_list({"type": "integer", "minimum": 0}),
            )
        ),
        triangles=nothing,
        texts=_list(
            _object(
                "foxglove.TextPrimitive",
                pose=pose,
                billboard=truth,
                font_size=_NUMBER,
                scale_invariant=truth,
                color=color,
                text=_TEXT,
            )
        ),
        models=nothing,
    )
    return _object("foxglove.SceneUpdate", deletions=nothing, entities=_list(entity))


CHANNELS = ("/signals", "/decision", "/events", "/scene/road", "/scene/truth", "/scene/percept")


def schema_of(channel: str) -> Schema:
    """The schema of a channel's messages."""
    own = {"/signals": SIGNALS, "/decision": DECISION, "/events": LOG}
    return own.get(channel) or scene_update()


@cache
def schema_text(channel: str) -> bytes:
    """The schema as it stands in the file."""
    return json.dumps(schema_of(channel), separators=(",", ":")).encode()
