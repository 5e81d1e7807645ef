"""A small session record with every kind of verdict and episode, for those who render records."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

from baseline_records import spec
from entries import make

from pytest_dura import Fault
from pytest_dura.core.codec import encode
from pytest_dura.core.mismatches import MismatchError
from pytest_dura.driving import MEASURES
from pytest_dura.evidence import SCHEMA_VERSION, SessionRecord
from pytest_dura.evidence.entry import plain_data
from pytest_dura.evidence.model import RecordHead, WholeRecord
from pytest_dura.provenance import digest_of
from pytest_dura.requirements import EpisodeVerdict, Requirement, judge_campaign

SOURCES = {"m/__init__.py": "e" * 64}
DIGEST = digest_of(SOURCES)
CASES = ("a/clear", "a/clear+ghost", "a/clear~recovery_planner")
REQUIREMENTS = {
    "SAF-1": Requirement("SAF-1", "Never collides.", kind="safety", source="house rule",
                         check="always (gap > 0)", reason="a collision is unacceptable"),
    "SEC-1": Requirement("SEC-1", "Alerts on ghosts.", kind="security", check="gap > 0",
                         at_most=0.4),
    "PERF-1": Requirement("PERF-1", "Clears in 10 s.", kind="performance", check="gap > 0"),
}  # fmt: skip


def episode(case="a/clear", run=0, *, validity="valid", trace=None, **changes):
    """The record of an episode; a case with ``+`` has one fault, which did what validity says."""
    hit = validity != "invalid"
    faults = [
        {
            "id": "ghost", "target": "lidar", "planned_at": 0.5, "activated_at": 0.5,
            "manifested_at": 0.6 if hit else None, "deactivated_at": 1.5,
            "detected_at": 0.7 if hit else None, "detected_by": "security_assessor",
            "pattern": "object_from_nowhere", "recovery_at": None, "recovery": None,
            "recovered_at": None, "activations": 1, "manifest_ticks": 9, "flagged_ticks": 2,
            "by_chance": False, "read_by": ["generator"] if hit else [],
            "manifestation_latency": 0.1, "detection_latency": 0.1,
            "recovery_latency": None, "time_to_recover": None,
            "propagation": "propagated" if hit else None, "propagated_at": 0.8 if hit else None,
            "unknown": "", "outcome": "tolerated", "violated": [], "violated_without": [],
        }
    ] if "+" in case else []  # fmt: skip
    told = {
        "id": f"{case}#{run}", "case": case, "component": "C", "seed": 1000 + run, "planned": True,
        "origin": {"session": None, "changed": None},
        "validity": validity,
        "invalid_reason": "never manifested: ghost" if validity == "invalid" else None,
        "termination": "infrastructure" if validity == "missing" else "goal",
        "failure": "infrastructure: safety_monitor: boom" if validity == "missing" else None,
        "digest": f"{run:02d}" * 32, "trajectory": f"{run:02d}" * 32, "drawn": False,
        "trace": trace,
        "outcome": {
            "flagged": run == 1, "recoveries": 0, "alerts": 1,
            "measures": {
                "collided": run == 1, "clearance_time": 1.5 + run / 10, "gridlock": False,
            },
            "switching": {
                "decisions": 20, "recovered": 0, "recovery_time": 0.0, "takeovers": 0,
                "returns": 0, "time_to_safe": [], "share": 0.0, "switches": 0, "censored": 0,
            },
        },
        "metrics": {
            "violations": {}, "performance": {}, "wall_clock": {}, "robustness_min": {},
            "faults": {"planned": len(faults), "succeeded": int(hit), "detected": 0,
                       "recovered": 0, "impact_ticks": 0},
            "recoveries": 0, "recoveries_succeeded": 0, "alerts": 1, "proposals": 20,
            "valid_proposals": 20, "processing_us": {"generator": 100.0}, "tallies": {},
            "reactions": {},
            "answer_seconds": [], "answer_ages": [], "user": {},
        },
        "faults": faults, "verdicts": {},
        "events": [{"tick": 7, "time": 0.7, "kind": "alert", "subject": "V1",
                    "detail": "object_from_nowhere: appeared", "data": {}}],
        "timings": {"simulated_seconds": 2.0, "processing_seconds": {"generator": 0.002}},
        "spec": spec(run, 1000 + run, case=case),
    }  # fmt: skip
    return told | changes


def verdict(requirement, case, words, *, planned=None, waiver=None, **changes):
    """The real verdict on runs of these words, such as ``("satisfied", "violated")``."""
    found = [
        EpisodeVerdict(
            requirement, f"{case}#{run}", "C", word,
            {"satisfied": 1.5, "violated": -0.5}.get(word), 0.9 if word == "violated" else None,
            f"gap is {word}", 20, 20,
        )
        for run, word in enumerate(words)
    ]  # fmt: skip
    judged = judge_campaign(
        REQUIREMENTS[requirement], case, found, planned=planned or len(words), component="C"
    )
    told = {
        **encode(judged), "check": REQUIREMENTS[requirement].check, "paired": None,
        "also_without": None, "item": f"{case}::{requirement}", "waiver": waiver, "attempts": [],
        "assertion": None,
    }  # fmt: skip
    return told | changes


def hazard(id_, severity=None, **changes):
    """A hazard of a record."""
    return {
        "id": id_, "text": f"State {id_}.", "loss": "L-1: health", "severity": severity,
        "operating_condition": "In rain.", "triggering_condition": "", "source": "STPA",
        "acceptance_criterion": "", "at_most": None,
        **changes,
    }  # fmt: skip


def session_record(directory=Path("nowhere"), **changes):
    """The record of :func:`session_data`."""
    return SessionRecord.of(session_data(**changes), directory)


def session_data(**changes):
    """A failed session: 5 episodes of 2 cases, and one verdict of each word, one waived.

    One cell of requirement x scenario x fault was left untested.
    """
    violated = verdict("SAF-1", "a/clear+ghost", ("satisfied", "violated"))
    waived = verdict(
        "PERF-1", "a/clear", ("violated", "satisfied"), waiver={"kind": "xfail", "reason": "known"}
    )
    told = {
        "schema_version": SCHEMA_VERSION,
        "status": "complete", "created": "2026-01-02T03:04:05+00:00",
        "finished": "2026-01-02T03:05:05+00:00",
        "tool": {"name": "pytest-dura", "version": "0.1.0", "code": "0" * 64},
        "command": "pytest --dura-scenarios", "base_seed": 0, "evidence_level": "violations",
        "require_repeatable": False,
        "environment": {
            "python": "3.11.7", "platform": "Linux", "packages": {"pytest-dura": "0.1.0"},
            "git": {"commit": "c0ffee" + "0" * 34, "dirty": False},
            "cpu_features": ["AVX2"], "machine": "x86_64", "byte_order": "little",
            "blas": "scipy-openblas 0.3.31",
        },
        "inputs": [
            {"path": "scenarios/a/clear.yaml", "kind": "scenario", "sha256": "1" * 64,
             "changed": False},
            {"path": "scenarios/requirements.yaml", "kind": "requirements", "sha256": "2" * 64,
             "changed": False},
            {"path": "dura-cassette.sqlite", "kind": "cassette", "sha256": "b" * 64,
             "changed": False},
        ],
        "component_under_test": {"name": "C", "path": "m:G", "params": {}, "version": "1.2",
                                 "digest": DIGEST, "sources": {DIGEST: SOURCES},
                                 "opaque": False, "distribution": "m",
                                 "file_count": 1,
                                 "files": [{"path": "m.py", "sha256": "e" * 64}]},
        "measures": [encode(one.info(place)) for place, one in enumerate(MEASURES)],
        "facts": [{"table": "rides", "about": "up", "order": 0, "data": {"made": 30},
                   "process": "main"}],
        "gate": {"result": "failed", "exit_code": 1, "warn_undecided": False, "failed": 2,
                 "reasons": ["SAF-1 on a/clear+ghost is violated",
                             "SEC-1 on a/clear+ghost is undecided"]},
        "requirements": [encode(REQUIREMENTS[name]) for name in sorted(REQUIREMENTS)],
        "cases": [_case(name) for name in CASES[:2]],
        "episodes": [
            episode("a/clear", 0), episode("a/clear", 1),
            episode("a/clear+ghost", 0), episode("a/clear+ghost", 1),
            episode("a/clear+ghost", 2, validity="invalid"),
            episode("a/clear+ghost", 3, validity="missing"),
        ],
        "verdicts": [
            waived, verdict("SAF-1", "a/clear", ("satisfied", "satisfied")),
            violated, verdict("SEC-1", "a/clear+ghost", ("satisfied",) * 2, planned=4),
        ],
        "judgements": [], "waivers": {}, "doubts": [], "searches": [],
        "overall": [], "effectiveness": [],
        "monitors": [
            {"case": "a/clear+ghost", "monitor": "security_assessor", "target": "SAF-1",
             "component": "C", "horizon": 5.0, "true_positives": 1, "false_negatives": 0,
             "false_positives": 1, "true_negatives": 0, "late": 0, "early": 0, "untimed": 0,
             "invalid": 1, "missing": 1, "lead_times": [0.2], "delays": [0.1], "false_alarms": 1,
             "hours": 0.001, "episodes": 4, "precision": 0.5, "recall": 1.0,
             "false_positive_rate": 1.0, "false_alarms_per_hour": 1000.0,
             "lead_time": {"min": 0.2, "median": 0.2, "max": 0.2},
             "delay": {"min": 0.1, "median": 0.1, "max": 0.1}},
        ],
        "baseline": None, "shard": None, "merged_from": None,
        "selection": {"planned": 3, "asked": 3, "left_out": [], "runs": None, "declared_runs": []},
        "execution": {"executor": "in-process", "processes": None},
        "resume": {"resumed": False, "session": "5" * 32, "problems": [], "taken_over": 0,
                   "sessions": [], "outdated": [], "searched": None,
                   "sources": {"digest": "6" * 64, "files": 3, "versions": 40}},
        "conclusions": {
            "rides": {"title": "Rides", "about": "Rides of the cabin.", "detail": True,
                      "columns": [{"name": "ride", "meaning": "where to", "unit": ""},
                                  {"name": "made", "meaning": "how often", "unit": ""}],
                      "rows": [["up", 30]], "lines": ["rides: 30 up"]},
        },
        "coverage": {
            "left_out": 0,
            "cells": [
                _cell("PERF-1", "", "violated"), _cell("SAF-1", "", "supported"),
                _cell("SAF-1", "ghost", "violated"), _cell("SEC-1", "ghost", "undecided"),
                _cell("PERF-1", "ghost", None),
            ],
            "parameters": [
                {"scenario": "a/clear", "parameter": "world.wall", "low": 2.0, "high": 6.0,
                 "drawn": 6, "least": 2.5, "greatest": 5.0, "bins": [0, 2, 1, 2, 1, 0, 0, 0, 0, 0],
                 "choices": None, "covered": 0.4},
            ],
        },
        "redacted": {},
        "timings": {"wall_seconds": 60.0, "evidence_seconds": 1.0, "simulated_seconds": 12.0,
                    "processing_seconds": {"generator": 2.0}},
    }  # fmt: skip
    plain = json.loads(json.dumps(told | changes, default=plain_data))
    plain["totals"] = totals(plain)
    with suppress(MismatchError):  # a test may want data that is no valid record
        plain = make(WholeRecord, **plain).to_json()
    return plain


HEADER = {
    name: session_value
    for name, session_value in make(RecordHead, base_seed=0, status="complete").to_json().items()
    if name in (
        "created", "tool", "command", "base_seed", "evidence_level", "require_repeatable",
        "environment", "execution", "shard", "merged_from", "selection",
    )
} | {"resume": {"resumed": False, "session": None, "searched": None, "sources": None}}  # fmt: skip
"""Header of a session, as a :class:`RecordBuilder` takes it."""


def totals(told):
    """What a record of these episodes and verdicts states of itself."""
    validities = [one["validity"] for one in told["episodes"]]
    words = [one["verdict"] for one in told["verdicts"]]
    return {
        "gate": told["gate"]["result"],
        "requirements": len(told["requirements"]),
        "cases": len(told["cases"]),
        "episodes": len(validities),
        **{word: validities.count(word) for word in ("valid", "invalid", "missing")},
        **{word: words.count(word) for word in ("supported", "violated", "undecided")},
        "waived": sum(one["waiver"] is not None for one in told["verdicts"]),
    }


def _case(name):
    scenario, plus, _ = name.partition("+")
    faults = [encode(Fault("ghost-obstacle", "ghost", "lidar", {"at": 0.5}))] if plus else []
    return {
        "id": name, "scenario": scenario, "faults": faults, "component": "C", "without": [],
        "off": [], "requirements": sorted(REQUIREMENTS), "planned": 4 if plus else 2,
        "runs_override": None,
        "order": None,
        "missing_runs": [], "missing_runs_total": 0, "repeat": None,
        "variation": {"world.wall": {"min": 2.0, "max": 6.0}},
        "metrics": {
            "planned": 2, "run": 2, "valid": 2, "invalid": 0, "missing": 0, "ended_early": 0,
            "flagged": {"valid": 1, "run": 1, "share_of_valid": 0.5, "share_of_planned": 0.5},
            "measures": {
                "collided": {"valid": 1, "run": 1, "share_of_valid": 0.5, "share_of_planned": 0.5},
                "clearance_time": {"runs": 2, "mean": 1.55, "sd": 0.07},
            },
            "recoveries": 0, "alerts": 2, "rescued": None, "reactions": {},
            "switching": None, "user": {}, "faults": [],
            "failure_modes": [], "answer_times": None, "answer_ages": None,
        },
    }  # fmt: skip


def _cell(requirement, faults, word):
    return {
        "requirement": requirement, "scenario": "a/clear", "faults": faults,
        "case": "a/clear" + (f"+{faults}" if faults else ""), "verdict": word,
        "component": "C", "applies": "scenario",
    }  # fmt: skip
