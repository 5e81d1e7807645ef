"""An episode as the evidence record holds it, and what a case's episodes come to."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from pytest_dura.core.episode import Episode
from pytest_dura.core.switching import switching
from pytest_dura.evidence.plain import plain


def episode_record(episode: Episode, *, planned: bool) -> dict[str, Any]:
    """Plain data of an episode: what it was run from, what happened, what it measures.

    Args:
        episode: The episode.
        planned: Whether it is part of its case's plan. One whose seed was chosen by hand is not,
            and does not enter the case's rates.
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
            "validity": episode.validity,
            "invalid_reason": episode.invalid_reason,
            "termination": episode.termination,
            "failure": episode.failure,
            "digest": episode.digest,
            "trace": None,
            "outcome": outcome(episode),
            "metrics": episode.metrics.summary(),
            "faults": [{**asdict(fault), **fault.latencies()} for fault in episode.faults],
            "events": [event.to_json() for event in episode.events],
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


def case_metrics(episodes: Sequence[Mapping[str, Any]], planned: int) -> dict[str, Any]:
    """What the planned episodes of a case with one component come to.

    Counts of ``flagged``, ``collided`` and ``gridlock`` are given over valid episodes and over all
    that were run, each with its share: of the valid ones, and of the planned ones.

    Args:
        episodes: Records of :func:`episode_record`.
        planned: Episodes that were planned.
    """
    words = [one["validity"] for one in episodes]
    valid = [one for one in episodes if one["validity"] == "valid"]
    times = [time for one in valid if (time := one["outcome"]["clearance_time"]) is not None]
    has_clearance = any(one["outcome"]["gridlock"] is not None for one in valid)
    clearance = {
        "runs": len(times),
        "mean": statistics.fmean(times) if times else None,
        "sd": statistics.stdev(times) if len(times) > 1 else None,
    }
    return {
        "planned": planned,
        "run": len(episodes),
        "valid": len(valid),
        "invalid": words.count("invalid"),
        "missing": words.count("missing"),
        **{key: _share(key, episodes, valid, planned) for key in _COUNTED},
        "clearance_time": clearance if has_clearance else None,
        "recoveries": sum(one["outcome"]["recoveries"] for one in valid),
        "alerts": sum(one["outcome"]["alerts"] for one in valid),
        "switching": _switching(valid),
        "user": _user_metrics(valid),
    }


def _switching(valid: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """How control was shared over the valid episodes: see :class:`Switching` for the terms."""
    found = [one["outcome"]["switching"] for one in valid]
    found = [one for one in found if one["decisions"]]
    decisions = sum(one["decisions"] for one in found)
    if not found:
        return None
    times = [time for one in found for time in one["time_to_safe"] if time is not None]
    return {
        "share": sum(one["recovered"] for one in found) / decisions,
        "takeovers": sum(one["takeovers"] for one in found),
        "switches_per_episode": sum(one["switches"] for one in found) / len(found),
        "time_to_safe": {
            "median": statistics.median(times) if times else None,
            "max": max(times) if times else None,
            "censored": sum(one["censored"] for one in found),
        },
    }


_COUNTED = ("flagged", "collided", "gridlock")


def _share(
    key: str, run: Sequence[Mapping[str, Any]], valid: Sequence[Mapping[str, Any]], planned: int
) -> dict[str, Any] | None:
    if all(one["outcome"][key] is None for one in run):
        return None
    in_valid = sum(bool(one["outcome"][key]) for one in valid)
    in_run = sum(bool(one["outcome"][key]) for one in run)
    return {
        "valid": in_valid,
        "run": in_run,
        "share_of_valid": in_valid / len(valid) if valid else None,
        "share_of_planned": in_run / planned if planned else None,
    }


def _user_metrics(valid: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Mean of each user-defined metric, over the valid episodes in which it has a value."""
    columns: dict[str, list[float]] = {}
    for one in valid:
        for name, value in one["metrics"]["user"].items():
            column = columns.setdefault(name, [])
            if value is not None:
                column.append(value)
    return {
        name: {"mean": statistics.fmean(column) if column else None, "runs": len(column)}
        for name, column in columns.items()
    }
