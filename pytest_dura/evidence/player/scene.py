"""The scene of an episode as small whole numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.recording import Line, Scene, Tracks

_FARTHEST = 1e6
"""Metres; what is reported farther away, as absurd percepts may be, stands here."""

Ints = NDArray[np.int64]


def scene_data(scene: Scene, text: Callable[[object], str]) -> dict[str, Any]:
    """A scene in cm, mrad and cm/s.

    Args:
        scene: The scene.
        text: What makes an id fit to be shown; two that differ stay different.

    Returns:
        ``ego``; ``lines`` of ``[kind, x, y]``; ``truth`` and ``percept``, a list of things
        ``{id, runs, same}``. A run is ``[tick, length, width, x, y, heading, speed]``, the last
        four as lists of differences, one per tick; it ends where the thing is absent or its size
        changes. ``same`` has ``[tick, ticks]`` in which a percept is what the truth is.
    """
    truth = {one: _rounded(scene.truth, column) for column, one in enumerate(scene.truth.ids)}
    return {
        "ego": text(scene.ego),
        "lines": [_line(one, text) for one in scene.lines],
        "truth": [_thing(text(one), *found, None) for one, found in truth.items()],
        "percept": [
            _thing(text(one), *_rounded(scene.percept, column), truth.get(one))
            for column, one in enumerate(scene.percept.ids)
        ],
    }


def _line(line: Line, text: Callable[[object], str]) -> list[Any]:
    points = line.points[np.isnan(line.points).sum(axis=1) == 0].astype(np.float64)
    points = np.rint(np.clip(points, -_FARTHEST, _FARTHEST) * 100.0).astype(np.int64)
    return [text(line.kind), _differences(points[:, 0]), _differences(points[:, 1])]


def _rounded(tracks: Tracks, column: int) -> tuple[NDArray[np.bool_], Ints]:
    """Where a thing is present, and its poses in cm and mrad."""
    poses = tracks.poses[:, column].astype(np.float64)
    present = np.isnan(poses[:, :2]).sum(axis=1) == 0
    poses = np.clip(np.nan_to_num(poses, nan=0.0), -_FARTHEST, _FARTHEST)
    poses[:, 2] = np.remainder(poses[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    scaled = poses * (100.0, 100.0, 1000.0, 100.0, 100.0, 100.0)
    return present, np.rint(scaled).astype(np.int64)


def _thing(
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
    """Half-open intervals in which the mask holds, cut in two where ``cuts`` says so."""
    found: list[tuple[int, int]] = []
    start: int | None = None
    for index, (held, cut) in enumerate(zip(mask.tolist(), cuts.tolist(), strict=True)):
        if start is not None and (not held or cut):
            found.append((start, index))
            start = None
        if held and start is None:
            start = index
    return found if start is None else [*found, (start, len(mask))]


def _differences(values: Ints) -> list[int]:
    """The first value, then by how much each differs from the one before."""
    return np.diff(values, prepend=0).tolist()  # type: ignore[no-any-return]
