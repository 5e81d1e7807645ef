"""Recording: what a viewer shows of an episode beside its signals; the digest leaves it out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

POSE = ("x", "y", "heading", "speed", "length", "width")
"""The columns of :attr:`Tracks.poses`: m, m, rad, m/s, m, m."""


@dataclass(frozen=True)
class Line:
    """A fixed line of the scene, such as the edge of a lane.

    Args:
        kind: Such as ``edge``, ``marking``, ``stop_line`` or ``route``.
        points: In metres, shape ``(k, 2)``.
    """

    kind: str
    points: NDArray[np.float32]


@dataclass(frozen=True)
class Tracks:
    """Where things were, tick by tick.

    Args:
        ids: One id per thing; the same thing has the same id in the truth and in the percept.
        poses: Shape ``(ticks, things, 6)``, see :data:`POSE`; NaN where a thing is absent.
    """

    ids: tuple[str, ...]
    poses: NDArray[np.float32]


@dataclass(frozen=True)
class Scene:
    """The world from above, in metres and radians; x to the right, y downwards, angles clockwise.

    Args:
        lines: What does not move.
        truth: What the simulator knows.
        percept: What the sensors reported after faults. What is in it and not in the truth is a
            ghost.
        ego: Id of the thing that the component steers.
    """

    lines: tuple[Line, ...]
    truth: Tracks
    percept: Tracks
    ego: str


@dataclass(frozen=True)
class Recording:
    """What was said at each decision, and the scene.

    Args:
        explanations: The component's explanation of its proposal, one per decision.
        reasons: Why the proposal was doubted or refused, one per decision; empty where it was not.
        recoveries: Name and explanation of the recovery action, one per decision; empty where
            there was none.
        flags: By monitor, what it said at each decision: 0 safe, 1 warning, 2 unsafe, -1 where it
            was not asked. Shape ``(decisions,)``.
        scene: If the simulator can tell it.
        problem: Why there is no scene, where the simulator failed to tell it.
        accounts: What the component told of each decision; empty if it told nothing of any.
    """

    explanations: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()
    recoveries: tuple[str, ...] = ()
    flags: Mapping[str, NDArray[np.int8]] = field(default_factory=dict)
    scene: Scene | None = None
    problem: str | None = None
    accounts: tuple[Mapping[str, Any], ...] = ()
