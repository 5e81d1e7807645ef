"""The scene of a trace, packed for the player and as a picture at one time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.simulator import Line, Scene, Tracks
from pytest_dura.evidence.text import name, one_line
from pytest_dura.evidence.traces import Trace
from pytest_dura.reports.svg import Point, Svg, document, path_of, points_of, tag

_FARTHEST = 1e6
"""Metres; what is reported farther away, as absurd percepts may be, stands here."""

Ints = NDArray[np.int64]


def scene_data(scene: Scene, text: Callable[[object], str]) -> dict[str, Any]:
    """A scene in cm, mrad and cm/s.

    Args:
        scene: The scene.
        text: Makes an id fit to be shown; two ids that differ stay different.

    Returns:
        ``ego``; ``lines`` of ``[kind, x, y]``; ``truth`` and ``percept``, a list of things
        ``{id, runs, same}``. A run is ``[tick, length, width, x, y, heading, speed]``, the last
        four as lists of differences, one per tick; it ends where the thing is absent or its size
        changes. ``same`` has ``[tick, ticks]`` in which a percept is what the truth is.
    """
    truth = {id_: _rounded_poses(scene.truth, column) for column, id_ in enumerate(scene.truth.ids)}
    return {
        "ego": text(scene.ego),
        "lines": [_line_data(line, text) for line in scene.lines],
        "truth": [_object_data(text(id_), *track, None) for id_, track in truth.items()],
        "percept": [
            _object_data(text(id_), *_rounded_poses(scene.percept, column), truth.get(id_))
            for column, id_ in enumerate(scene.percept.ids)
        ],
    }


def track_data(poses: NDArray[np.float32]) -> list[list[Any]]:
    """The way of one thing as ``runs`` of :func:`scene_data`.

    Args:
        poses: Shape ``(ticks, 6)``; NaN where the thing is absent.
    """
    tracks = Tracks(("",), poses[:, None])
    runs: list[list[Any]] = _object_data("", *_rounded_poses(tracks, 0), None)["runs"]
    return runs


def _line_data(line: Line, text: Callable[[object], str]) -> list[Any]:
    points = line.points[np.isnan(line.points).sum(axis=1) == 0].astype(np.float64)
    points = np.rint(np.clip(points, -_FARTHEST, _FARTHEST) * 100.0).astype(np.int64)
    return [text(line.kind), _differences(points[:, 0]), _differences(points[:, 1])]


def _rounded_poses(tracks: Tracks, column: int) -> tuple[NDArray[np.bool_], Ints]:
    """The ticks at which an object is present, and its poses in cm and mrad."""
    poses = tracks.poses[:, column].astype(np.float64)
    present = np.isnan(poses[:, :2]).sum(axis=1) == 0
    poses = np.clip(np.nan_to_num(poses, nan=0.0), -_FARTHEST, _FARTHEST)
    poses[:, 2] = np.remainder(poses[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    scaled = poses * (100.0, 100.0, 1000.0, 100.0, 100.0, 100.0)
    return present, np.rint(scaled).astype(np.int64)


def _object_data(
    name: str,
    present: NDArray[np.bool_],
    poses: Ints,
    truth: tuple[NDArray[np.bool_], Ints] | None,
) -> dict[str, Any]:
    same = np.zeros_like(present)
    if truth is not None and truth[1].shape == poses.shape:
        same = present & truth[0] & (truth[1] == poses).all(axis=1)
    sizes = poses[:, 4:]
    changes = np.zeros_like(present)
    changes[1:] = (sizes[1:] != sizes[:-1]).any(axis=1)
    runs = []
    for start, stop in _stretches(present & ~same, changes):
        part = poses[start:stop]
        columns = [_differences(part[:, index]) for index in range(4)]
        runs.append([start, int(part[0, 4]), int(part[0, 5]), *columns])
    equal = [[start, stop - start] for start, stop in _stretches(same, np.zeros_like(same))]
    return {"id": name, "runs": runs, "same": equal}


def _stretches(mask: NDArray[np.bool_], cuts: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Half-open intervals in which the mask holds, split where ``cuts`` holds."""
    stretches: list[tuple[int, int]] = []
    start: int | None = None
    for index, (held, cut) in enumerate(zip(mask.tolist(), cuts.tolist(), strict=True)):
        if start is not None and (not held or cut):
            stretches.append((start, index))
            start = None
        if held and start is None:
            start = index
    return stretches if start is None else [*stretches, (start, len(mask))]


def _differences(values: Ints) -> list[int]:
    """The first value, then by how much each differs from the one before."""
    return np.diff(values, prepend=0).tolist()  # type: ignore[no-any-return]


_SIGHT = 56.0
"""Metres across a picture of a large scene."""
_ASPECT = 0.56
"""Height of a picture over its width."""
_BEHIND = 3.0
"""Seconds of the ego's way that are drawn behind it."""
_APART, _NAMED_APART = 0.1, 2.0
"""Metres beyond which a percept differs from the truth, and has a name of its own, as in the
player."""
_MOST_THINGS, _MOST_LABELS, _MOST_POINTS = 40, 6, 900
"""Bounds that keep a picture small, whatever a scene holds. The nearest things are drawn."""
_LONGEST_NAME = 28
_STROKES: dict[str, tuple[str, float, str | None]] = {
    "route": ("#bcd7ee", 1.4, None),
    "stop_line": ("#3c444e", 0.5, None),
    "marking": ("#9aa3ae", 0.15, "4 4"),
    "edge": ("#59636f", 0.2, None),
}
"""Colour, width in metres and dashes of lines; of another kind they are drawn as an edge."""
_INK, _GROUND = "#1a1f26", "#eef0f3"
_BODIES: dict[str, dict[str, object]] = {
    "ego": {"fill": "#0a5ea8", "stroke": "#2b323b"},
    "truth": {"fill": "#6d7783", "stroke": "#2b323b"},
    "missing": {"fill": "none", "stroke": "#3c444e", "stroke_dasharray": "2 3"},
    "percept": {"fill": "none", "stroke": "#c04a00", "stroke_width": 2},
    "ghost": {"fill": "none", "stroke": "#a3246f", "stroke_width": 2, "stroke_dasharray": "6 4"},
    "twin": {"fill": "#0a5ea8", "fill_opacity": "0.3", "stroke": "#0a5ea8", "stroke_width": 1.5,
             "stroke_dasharray": "3 2"},
}  # fmt: skip

Pose = NDArray[np.float64]


class _Camera:
    """Maps metres to places in a picture."""

    def __init__(self, centre: Point, across: float, width: float) -> None:
        self.centre, self.scale = centre, width / across
        self.width, self.height = width, round(width * _ASPECT)

    def __call__(self, x: float, y: float) -> Point:
        """Return the place of a point."""
        return (
            self.width / 2 + (x - self.centre[0]) * self.scale,
            self.height / 2 + (y - self.centre[1]) * self.scale,
        )

    def sees(self, x: float, y: float, room: float = 0.0) -> bool:
        """Whether a point, or one at most ``room`` metres from it, is in the picture."""
        across, down = self(x, y)
        room *= self.scale
        return -room <= across <= self.width + room and -room <= down <= self.height + room


def frame_svg(
    trace: Trace, time: float, *, twin: Trace | None = None, width: int = 480, label: str
) -> Svg:
    """Draw the scene of a trace from above at a time, as the player shows it.

    Colours are attributes, so that the picture stands alone; its elements have classes, by which
    the style of a page changes them.

    Args:
        trace: The episode.
        time: Simulated seconds; the last tick that is not after it is drawn.
        twin: The run without the fault or without a role, whose ego is drawn as a shadow.
        width: Width in pixels.
        label: What the picture shows, in words.

    Returns:
        A picture below 15 kB; an empty text where the trace has no scene or no tick.
    """
    scene = trace.recording.scene
    tick = _tick_at(trace, time)
    if scene is None or tick is None:
        return Svg("")
    truth, percept = _poses_at(scene.truth, tick), _poses_at(scene.percept, tick)
    camera = _camera(scene, truth, float(width))
    ego = truth.get(scene.ego)
    shadow, shadow_way = None, Svg("")
    if twin is not None and twin.recording.scene is not None:
        beside = _tick_at(twin, time)
        if beside is not None:
            shadow = _poses_at(twin.recording.scene.truth, beside).get(twin.recording.scene.ego)
            shadow_way = _way(twin, twin.recording.scene, beside, camera, dashed=True)
    parts = [
        tag("rect", class_="dura-f-ground", width="100%", height="100%", fill=_GROUND),
        *_lines(scene, camera),
        shadow_way,
        _way(trace, scene, tick, camera, dashed=False),
        *_things(scene, truth, percept, camera, shadow),
        *_labels(_names(scene, truth, percept, ego, shadow), camera),
        *_ruler(camera),
    ]
    return document(
        width, camera.height, *filter(None, parts),
        class_="dura-frame", role="img", aria_label=one_line(label, 300),
    )  # fmt: skip


def _tick_at(trace: Trace, time: float) -> int | None:
    """The last tick that is not after a time, or the first one."""
    if not len(trace.time) or not math.isfinite(time):
        return None
    return max(int(np.searchsorted(trace.time, time + 1e-6, side="right")) - 1, 0)


def _poses_at(tracks: Tracks, tick: int) -> dict[str, Pose]:
    """Poses of what is present at a tick, by id."""
    if tick >= len(tracks.poses):
        return {}
    rows = tracks.poses[tick].astype(np.float64)
    return {
        id_: np.nan_to_num(row) for id_, row in zip(tracks.ids, rows, strict=True)
        if np.isfinite(row[:2]).all() and np.abs(row[:2]).max() < _FARTHEST
    }  # fmt: skip


def _camera(scene: Scene, truth: dict[str, Pose], width: float) -> _Camera:
    """Look at the ego, and a little to where it heads; a small scene is shown whole."""
    points = [line.points for line in scene.lines if len(line.points)]
    points += [row[None, :2].astype(np.float32) for row in truth.values()]
    everything = np.concatenate(points) if points else np.zeros((1, 2), np.float32)
    everything = everything[np.isfinite(everything).all(axis=1)]
    everything = everything if len(everything) else np.zeros((1, 2), np.float32)
    low, high = everything.min(axis=0), everything.max(axis=0)
    whole = 1.3 * max(float(high[0] - low[0]), float(high[1] - low[1]) / _ASPECT)
    ego = truth.get(scene.ego)
    if 0.0 < whole <= _SIGHT or ego is None:
        centre = (float(low[0] + high[0]) / 2, float(low[1] + high[1]) / 2)
        return _Camera(centre, min(max(whole, 2.0), 4 * _SIGHT), width)
    ahead = 0.12 * _SIGHT
    centre = (
        float(ego[0]) + ahead * math.cos(ego[2]),
        float(ego[1]) + ahead * _ASPECT * math.sin(ego[2]),
    )
    return _Camera(centre, _SIGHT, width)


def _lines(scene: Scene, camera: _Camera) -> Iterator[Svg]:
    """The fixed lines as far as they are in sight, one path for each kind."""
    paths: dict[str, list[str]] = {}
    room = _MOST_POINTS
    for line in scene.lines:
        for piece in _pieces(line, camera):
            room -= len(piece)
            if room >= 0:
                kind = line.kind if line.kind in _STROKES else "edge"
                paths.setdefault(kind, []).append(path_of(piece))
    metre = min(camera.scale, camera.width / _SIGHT)  # lines of a small place are narrower
    for kind in sorted(paths, key=list(_STROKES).index):
        stroke, wide, dashes = _STROKES[kind]
        yield tag(
            "path", class_=f"dura-f-{kind.replace('_', '-')}", d="".join(paths[kind]), fill="none",
            stroke=stroke, stroke_width=max(1.2, wide * metre), stroke_dasharray=dashes,
            stroke_linejoin="round",
        )  # fmt: skip


def _pieces(line: Line, camera: _Camera) -> Iterator[list[Point]]:
    """Stretches of a line that are near the picture, without points too close to see."""
    piece: list[Point] = []
    points = line.points.astype(np.float64)
    for start, end in zip(points[:-1].tolist(), points[1:].tolist(), strict=True):
        near = all(map(math.isfinite, (*start, *end))) and _crosses(camera, start, end)
        if not near:
            if len(piece) > 1:
                yield piece
            piece = []
            continue
        piece = piece or [camera(*start)]
        place = camera(*end)
        if math.dist(place, piece[-1]) >= 1.5:
            piece.append(place)
    if len(piece) > 1:
        yield piece


def _crosses(camera: _Camera, start: list[float], end: list[float]) -> bool:
    """Whether the box around two points meets the picture."""
    (left, top), (right, bottom) = camera(*start), camera(*end)
    return (
        min(left, right) <= camera.width and max(left, right) >= 0
        and min(top, bottom) <= camera.height and max(top, bottom) >= 0
    )  # fmt: skip


def _way(trace: Trace, scene: Scene, tick: int, camera: _Camera, *, dashed: bool) -> Svg:
    """The ego's way in the last seconds."""
    if scene.ego not in scene.truth.ids:
        return Svg("")
    first = int(np.searchsorted(trace.time, trace.time[tick] - _BEHIND))
    rows = scene.truth.poses[first : tick + 1, scene.truth.ids.index(scene.ego), :2]
    rows = rows[np.isfinite(rows).all(axis=1)]
    path = path_of(camera(x, y) for x, y in rows[-200:].astype(float).tolist())
    return tag(
        "path", class_="dura-f-way", d=path, fill="none", stroke="#0a5ea8",
        stroke_width="1.5" if dashed else "2", stroke_dasharray="3 3" if dashed else None,
    )  # fmt: skip


def _nearest(things: dict[str, Pose], camera: _Camera, ego: str = "") -> list[tuple[str, Pose]]:
    """Things in the picture, the ones that are nearest to its middle first."""
    seen = [
        (id_, pose) for id_, pose in things.items()
        if id_ != ego and camera.sees(float(pose[0]), float(pose[1]), float(max(pose[4:6])) / 2)
    ]  # fmt: skip
    seen.sort(key=lambda thing: math.dist(thing[1][:2].tolist(), camera.centre))
    return seen[:_MOST_THINGS]


def _things(
    scene: Scene,
    truth: dict[str, Pose],
    percept: dict[str, Pose],
    camera: _Camera,
    shadow: Pose | None,
) -> Iterator[Svg]:
    """Footprints: what is true, the twin's ego, and what was perceived where that differs."""
    if shadow is not None:
        yield from _body(shadow, "twin", camera)
    for id_, pose in reversed(_nearest(truth, camera, scene.ego)):
        yield from _body(pose, "truth" if id_ in percept else "missing", camera)
    if scene.ego in truth:
        yield from _body(truth[scene.ego], "ego", camera)
    for id_, pose in reversed(_nearest(percept, camera)):
        true = truth.get(id_)
        if true is None:
            yield from _body(pose, "ghost", camera)
        elif _apart(true, pose) > _APART:
            yield from _body(pose, "percept", camera)


def _body(pose: Pose, kind: str, camera: _Camera) -> Iterator[Svg]:
    """A footprint, and an arrow to where it heads."""
    x, y, heading = (float(value) for value in pose[:3])
    long = max(min(float(pose[4]), _SIGHT), 5 / camera.scale) / 2
    wide = max(min(float(pose[5]), _SIGHT), 4 / camera.scale) / 2
    cosine, sine = math.cos(heading), math.sin(heading)

    def corner(ahead: float, aside: float) -> Point:
        return camera(x + ahead * cosine - aside * sine, y + ahead * sine + aside * cosine)

    outline = points_of(
        [corner(long, wide), corner(long, -wide), corner(-long, -wide), corner(-long, wide)]
    )
    yield tag("polygon", class_=f"dura-f-{kind}", points=outline, **_BODIES[kind])
    if kind in ("ego", "truth"):
        size = min(long * 0.6, wide * 1.4)
        tip = long * 0.84
        arrow = [corner(tip, 0.0), corner(tip - size, size / 2), corner(tip - size, -size / 2)]
        yield tag("polygon", class_="dura-f-arrow", points=points_of(arrow), fill="#ffffff")


def _apart(pose: Pose, other: Pose) -> float:
    return math.dist(pose[:2].tolist(), other[:2].tolist())


def _names(
    scene: Scene,
    truth: dict[str, Pose],
    percept: dict[str, Pose],
    ego: Pose | None,
    shadow: Pose | None,
) -> list[tuple[str, Pose]]:
    """What is written at things, the most telling first."""
    names = [] if ego is None else [(name(scene.ego), ego)]
    ghosts = [(f"{name(id_)} (ghost)", pose) for id_, pose in percept.items() if id_ not in truth]
    believed = percept.get(scene.ego)
    if ego is not None and believed is not None and _apart(believed, ego) > _NAMED_APART:
        ghosts.append(("believed", believed))
    if shadow is not None and (ego is None or _apart(shadow, ego) > _NAMED_APART):
        names.append(("twin", shadow))
    others = [
        (name(id_) + ("" if id_ in percept else " (not perceived)"), pose)
        for id_, pose in truth.items() if id_ != scene.ego
    ]  # fmt: skip
    if ego is not None:
        for group in (ghosts, others):
            group.sort(key=lambda thing: _apart(thing[1], ego))
    return names + ghosts + others


def _labels(names: list[tuple[str, Pose]], camera: _Camera) -> Iterator[Svg]:
    """Names above things; of those that would cover another the lesser one is left out."""
    placed: list[tuple[float, float, float]] = []
    for text, pose in names:
        if len(placed) == _MOST_LABELS:
            return
        x, y = camera(float(pose[0]), float(pose[1]))
        if not (0 <= x <= camera.width and 0 <= y <= camera.height):
            continue
        shown = text if len(text) <= _LONGEST_NAME else f"{text[: _LONGEST_NAME - 1]}…"
        half = 3.6 * len(shown) + 2
        reach = min(math.hypot(pose[4], pose[5]) / 2 * camera.scale, 30.0) + 4
        x = min(max(x, half + 2), camera.width - half - 2)
        for down in (y - reach, y + reach + 10, y - reach - 14):
            clear = all(
                abs(down - other) >= 13 or x + half < left or x - half > right
                for left, right, other in placed
            )
            if clear and 12 <= down <= camera.height - 4:
                placed.append((x - half, x + half, down))
                yield tag(
                    "text", shown, class_="dura-f-label", x=x, y=down, text_anchor="middle",
                    font_family="system-ui, sans-serif", font_size=12, font_weight=600, fill=_INK,
                    stroke=_GROUND, stroke_width=3, paint_order="stroke", stroke_linejoin="round",
                )  # fmt: skip
                break


def _ruler(camera: _Camera) -> Iterator[Svg]:
    """A length in metres, in the corner."""
    metres = next(
        (step for step in (0.5, 1, 2, 5, 10, 20, 50, 100) if step * camera.scale >= 44), 200
    )
    down, long = camera.height - 8, metres * camera.scale
    path = path_of([(8, down - 4), (8, down), (8 + long, down), (8 + long, down - 4)])
    yield tag("path", class_="dura-f-ruler", d=path, fill="none", stroke=_INK, stroke_width=1.5)
    yield tag(
        "text", f"{metres:g} m", class_="dura-f-label", x=12, y=down - 5, fill=_INK,
        font_family="system-ui, sans-serif", font_size=11, stroke=_GROUND, stroke_width=3,
        paint_order="stroke",
    )  # fmt: skip
