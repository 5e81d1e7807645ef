"""Evidence records to compare, with the verdicts that real judging gives."""

from __future__ import annotations

from entries import make

from pytest_dura.core.codec import encode
from pytest_dura.evidence import SCHEMA_VERSION
from pytest_dura.evidence.model import WholeRecord
from pytest_dura.requirements import EpisodeVerdict, Requirement, judge_campaign


def spec(run, seed, wall=4.0, case="a/b"):
    return {
        "case": case, "run": run, "seed": seed, "timeouts": [], "policy": "recover",
        "simulator": {"path": "m:S", "params": {}},
        "roles": {"generator": {"path": "m:G", "params": {}}},
        "scenario": {"name": case, "duration": 2.0, "world": {"wall": wall}},
        "faults": [], "time_step": 0.1, "time_budget": 5.0,
        "termination": {"time_limit": 2.0, "goal": True, "violation": False, "iterations": None},
    }  # fmt: skip


def verdict(runs, violating=(), case="a/b", component="C", requirement="R", **changes):
    """The real verdict on so many runs; ``changes`` are put over it."""
    found = [
        EpisodeVerdict(
            requirement, f"{case}#{run}", component,
            "violated" if run in violating else "satisfied", None, None, "", 1, 1,
        )
        for run in range(runs)
    ]  # fmt: skip
    judged = judge_campaign(
        Requirement(requirement), case, found, planned=runs, component=component
    )
    item = f"{case}::{requirement}"
    return {**encode(judged), "check": "gap > 0", "paired": None, "item": item} | changes


def record(*verdicts, seed=0, walls=None, **changes):
    """The record of these verdicts; ``walls`` is the value of the world's wall in each run."""
    episodes = [
        {
            "case": one["case"], "component": one["component"], "planned": True,
            "spec": spec(run, 1000 * seed + run, (walls or [4.0])[run % len(walls or [4.0])],
                         one["case"]),
        }
        for one in verdicts
        for run in range(one["run"])
    ]  # fmt: skip
    told = {
        "schema_version": SCHEMA_VERSION,
        "status": "complete", "created": "2026-01-02T03:04:05+00:00",
        "base_seed": seed, "component_under_test": {"name": "C", "digest": "d" * 64},
        "requirements": [{"id": "R", "check": "gap > 0", "paired": None}],
        "episodes": episodes, "verdicts": list(verdicts),
    }  # fmt: skip
    return make(WholeRecord, **told | changes).to_json()
