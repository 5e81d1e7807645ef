"""Evidence records to compare, with the verdicts that real judging gives."""

from __future__ import annotations

from hashlib import sha256

from entries import make

from pytest_dura.core.codec import encode
from pytest_dura.evidence import SCHEMA_VERSION
from pytest_dura.evidence.model import WholeRecord
from pytest_dura.requirements import EpisodeVerdict, Requirement, judge_campaign
from pytest_dura.requirements.judgements import Judgement, RunJudgement
from pytest_dura.requirements.runs import CheckVerdict


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


def runs_of_cases(verdicts):
    """The most runs of each case and component."""
    most = {}
    for one in verdicts:
        key = one["case"], one["component"]
        most[key] = max(most.get(key, 0), one["run"])
    return most


def digest(case, component, run):
    return sha256(f"{case} {component} {run}".encode()).hexdigest()


def judgement(one):
    """The line from which a verdict follows, as far as it says so of single runs."""
    violating = {entry["episode"] for entry in one["counterexamples"]}
    bound = one["bound"]
    runs = [
        RunJudgement(
            digest(one["case"], one["component"], run), run,
            verdict=CheckVerdict(
                "violated" if f"{one['case']}#{run}" in violating
                else "invalid" if run >= one["run"] - one["invalid"] else "satisfied",
                None, None, "", vacuous=False,
            ),
        )
        for run in range(one["run"])
    ]  # fmt: skip
    return Judgement(
        "campaign", one["requirement"], one["case"], one["component"], one["planned"],
        one["check"], at_most=bound["at_most"], confidence=bound["confidence"], runs=tuple(runs),
        item=one["item"], decides=one["item"], attempt=1,
    )  # fmt: skip


def record(*verdicts, seed=0, walls=None, **changes):
    """The record of these verdicts; ``walls`` is the value of the world's wall in each run."""
    episodes = [
        {
            "id": f"{case}#{run}", "case": case, "component": component, "planned": True,
            "validity": "valid", "failure": None, "invalid_reason": None,
            "digest": digest(case, component, run),
            "spec": spec(run, 1000 * seed + run, (walls or [4.0])[run % len(walls or [4.0])], case),
        }
        for (case, component), most in runs_of_cases(verdicts).items()
        for run in range(most)
    ]  # fmt: skip
    told = {
        "schema_version": SCHEMA_VERSION,
        "status": "complete", "created": "2026-01-02T03:04:05+00:00",
        "base_seed": seed, "component_under_test": {"name": "C", "digest": "d" * 64},
        "requirements": [{"id": "R", "check": "gap > 0", "paired": None}],
        "cases": [{"id": case, "component": component, "scenario": case, "faults": [],
                   "variation": {"world.wall": {"min": 1.0, "max": 9.0}}}
                  for case, component in runs_of_cases(verdicts)],
        "judgements": [encode(judgement(one)) for one in verdicts],
        "episodes": episodes, "verdicts": list(verdicts),
    }  # fmt: skip
    return make(WholeRecord, **told | changes).to_json()
