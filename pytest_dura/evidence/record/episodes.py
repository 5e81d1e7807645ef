"""An episode as the evidence record holds it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from pytest_dura.core.episode import Episode
from pytest_dura.core.switching import switching
from pytest_dura.evidence.plain import plain
from pytest_dura.evidence.record.reuse import OWN
from pytest_dura.requirements.verdicts.situations import Situations, varies


def episode_record(
    episode: Episode, *, planned: bool, origin: Mapping[str, Any] = OWN
) -> dict[str, Any]:
    """Plain data of an episode: what it was run from, what happened, what it measures.

    Args:
        episode: The episode.
        planned: Whether it is part of its case's plan. One whose seed was chosen by hand is not,
            and does not enter the case's rates.
        origin: The earlier ``session`` that it was taken over from, or what ``changed`` since one
            simulated an episode of its name.
    """
    # The recorded timeouts stand in for the clock when the episode is replayed.
    spec = replace(episode.spec, timeouts=episode.timeouts).to_json()
    record: dict[str, Any] = plain(
        {
            "id": episode.id,
            "case": episode.spec.case,
            "component": episode.spec.component,
            "seed": episode.spec.seed,
            "planned": planned,
            "origin": dict(origin),
            "validity": episode.validity,
            "invalid_reason": episode.invalid_reason,
            "termination": episode.termination,
            "failure": episode.failure,
            "digest": episode.digest,
            "trajectory": episode.trajectory,
            "drawn": episode.drawn,
            "trace": None,
            "outcome": outcome(episode),
            "metrics": episode.metrics.summary(),
            "faults": [{**asdict(fault), **fault.latencies()} for fault in episode.faults],
            "events": [event.to_json() for event in episode.events],
            "timings": {
                "simulated_seconds": episode.time[-1] if episode.ticks else 0.0,
                "processing_seconds": {
                    role: sum(nanoseconds) / 1e9
                    for role, (_, nanoseconds) in episode.metrics.processing_ns.items()
                },
            },
            "spec": spec,
        }
    )
    return record


def outcome(episode: Episode) -> dict[str, Any]:
    """The figures of the case table; ``None`` where the domain has no such signal.

    ``clearance_time`` is the time at which ``cleared`` was first raised, in seconds; gridlock is
    not to have cleared when the episode's time was up.
    """
    cleared_at = None
    gridlock = None
    cleared = episode.signals.get("cleared")
    if cleared is not None:
        raised = np.flatnonzero(cleared > 0.5)
        cleared_at = float(episode.time[raised[0]]) if len(raised) else None
        gridlock = cleared_at is None and episode.termination in ("time", "iterations")
    return {
        "flagged": episode.flagged,
        "collided": episode.collided if "collided" in episode.signals else None,
        "clearance_time": cleared_at,
        "gridlock": gridlock,
        "recoveries": len(episode.metrics.recoveries),
        "alerts": episode.metrics.alerts,
        "switching": switching(episode).to_json(),
    }


def situations_of(case: Mapping[str, Any]) -> Situations:
    """What takes in the runs of a recorded case and says whether they are all equal."""
    return Situations(varies=varies(case["variation"], {one["id"] for one in case["faults"]}))


def add_run(situations: Situations, episode: Mapping[str, Any]) -> None:
    """Take in a recorded episode."""
    situations.add_run(
        episode["case"],
        episode["spec"]["run"],
        episode["trajectory"],
        valid=episode["validity"] == "valid",
        drawn=episode["drawn"],
    )
