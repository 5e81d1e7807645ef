"""An episode with all that the player shows: made by hand, so that each tick is known."""

from __future__ import annotations

import numpy as np
from traces import ABOUT

from pytest_dura.core import Line, Recording, Scene, Tracks
from pytest_dura.evidence import Trace

TICKS = 41
GHOST = range(10, 20)
UNSEEN = range(24, 30)
ASTRAY = range(30, 35)
BRAKING = range(25, 32)
VIOLATED_AT = 3.6
VERDICTS = (
    {"requirement": "SAF-1", "verdict": "violated", "time": VIOLATED_AT, "margin": -0.5,
     "check": "always (gap > 0)"},
    {"requirement": "PERF-1", "verdict": "satisfied", "time": None, "margin": 1.5,
     "check": "always (speed <= 15)"},
    {"requirement": "SEC-1", "verdict": "invalid", "time": None, "margin": None, "check": None},
)  # fmt: skip


def crossing(**changes):
    """4 s northwards: a ghost, a car that is not perceived, a believed pose that is off, a crash.

    Each decision at tick k proposes ``go k``; in ``BRAKING`` the recovery acts.
    """
    ticks = np.arange(TICKS)
    poses = np.full((TICKS, 2, 6), np.nan, np.float32)
    poses[:, :, 4:] = 5.0, 2.0
    poses[:, 0, :4] = [(2.0, 30.0 - tick, -np.pi / 2, 10.0) for tick in ticks]
    poses[:, 1, :4] = [(20.0 - tick / 2, -4.0, 3.1, 5.0) for tick in ticks]
    seen = poses.copy()
    seen[UNSEEN, 1] = np.nan
    seen[ASTRAY, 0, 0] += 3.0
    ghost = np.full((TICKS, 1, 6), np.nan, np.float32)
    ghost[GHOST] = 2.0, 5.0, -np.pi / 2, 0.0, 4.5, 1.8
    lines = tuple(
        Line(kind, np.array(points, np.float32))
        for kind, points in [
            ("edge", [(-4, -40), (-4, 40)]), ("edge", [(6, -40), (6, 40)]),
            ("marking", [(0, -40), (0, 40)]), ("stop_line", [(0, 4), (4, 4)]),
            ("route", [(2, 40), (2, -40)]),
        ]
    )  # fmt: skip
    scene = Scene(
        lines,
        Tracks(("EGO", "V1"), poses),
        Tracks(("EGO", "V1", "GHOST"), np.concatenate([seen, ghost], axis=1)),
        "EGO",
    )
    gap = np.linspace(20.0, -2.0, TICKS)
    perceived = gap.copy()
    perceived[GHOST] = 3.0
    decided = range(TICKS - 1)
    braking = [tick in BRAKING for tick in decided]
    told = {
        "about": ABOUT | {"id": "a/crossing#0", "termination": "critical"},
        "time": ticks * 0.1,
        "signals": {
            "gap": gap, "percept.gap": perceived, "speed": np.full(TICKS, 10.0),
            "ttc": np.where(ticks < 5, np.inf, 4.0), "collided": (ticks >= 36).astype(float),
        },
        "decisions": {
            "verdict": np.array([2 * one for one in braking], np.int8),
            "source": np.array(["recovery" if one else "proposal" for one in braking], np.str_),
            "proposed": np.array([f"go {tick}" for tick in decided], np.str_),
            "executed": np.array(
                ["brake" if one else f"go {tick}" for tick, one in enumerate(braking)], np.str_
            ),
            "attempts": np.zeros(TICKS - 1, np.int16),
        },
        "events": [
            _event(10, "fault_activated", "ghost"), _event(10, "fault_manifested", "ghost"),
            _event(12, "alert", "GHOST", "object_from_nowhere: appeared"),
            _event(20, "fault_deactivated", "ghost"), _event(25, "recovery", "brake", "too near"),
        ],
        "recording": Recording(
            tuple(f"the way is clear at {tick}" for tick in decided),
            tuple("safety_monitor: too near" if one else "" for one in braking),
            tuple("brake: too near" if one else "" for one in braking),
            {
                "safety_monitor": np.array([2 if one else 0 for one in braking], np.int8),
                "security_assessor": np.array(
                    [-1 if tick < 3 else int(tick in GHOST) for tick in decided], np.int8
                ),
            },
            scene,
        ),
    }  # fmt: skip
    return Trace(**(told | changes))


def without_scene():
    """The same in a domain that has no scene."""
    recording = crossing().recording
    return crossing(
        recording=Recording(
            recording.explanations, recording.reasons, recording.recoveries, recording.flags
        )
    )


def _event(tick, kind, subject, detail=""):
    return {
        "tick": tick, "time": tick * 0.1, "kind": kind, "subject": subject, "detail": detail,
        "data": {},
    }  # fmt: skip
