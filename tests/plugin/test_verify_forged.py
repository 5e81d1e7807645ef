"""Records that were changed in one place, and what only recomputing them finds.

The formats, which would give each change away, are left out of account: a forger renders them anew.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.bundle import read_session_record
from pytest_dura.evidence.model import Counts, SessionRecord
from pytest_dura.evidence.verify import (
    RejudgedCount,
    derived_problems,
    trace_problems,
    verify_bundle,
)
from pytest_dura.evidence.verify_record import record_problems

PROJECT = Path(__file__).with_name("project")
NUDGED = """
name: corridor/nudged
simulator: corridor:Corridor
duration: 2.0
runs: 6
world: {wall: 10.0}
variation: {world.wall: {min: 3.0, max: 11.0}}
roles:
  generator: corridor:Reckless
  safety_monitor: oddities:Early
  fault_injector: %s
faults: [{type: noise, id: g, target: gap, activation: {at: 0.1}, duration: once}]
requirements: [GAP-1, RATE-1, SEQ-1]
"""
RATES = """
requirements:
  - {id: RATE-1, text: t, kind: safety, check: always (gap > 0.01), at_most: 0.97, confidence: 0.6}
  - {id: SEQ-1, text: t, kind: safety, check: always (gap > 0), at_most: 0.6, method: e-process}
"""
TESTS = """
import pytest
@pytest.mark.dura(scenario="corridor/paired", runs=3)
def test_pairs(campaign):
    campaign.paired(without="recovery_planner").require("always (gap > 0)")

def test_by_hand(orchestrator):
    orchestrator.run("corridor/free", seed=7)

class TestInstance:
    @pytest.fixture(scope="session")
    def generator(self):
        import corridor
        return corridor.Careful()

    def test_it(self, orchestrator):
        orchestrator.run("corridor/tight", seed=8)
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A session with campaigns of different lengths on one case, pairs, and a bare instance."""
    folder = tmp_path_factory.mktemp("forged")
    shutil.copytree(PROJECT, folder, dirs_exist_ok=True)
    scenarios = folder / "scenarios"
    injector = "pytest_dura.faults.injector:CampaignInjector"
    (scenarios / "corridor/nudged.yaml").write_text(NUDGED % injector)
    idle = (NUDGED % "corridor:Idle").replace("corridor/nudged", "corridor/idle")
    (scenarios / "corridor/idle.yaml").write_text(idle)
    paired = NUDGED.replace("corridor/nudged", "corridor/paired").replace("11.0}}", "4.0}}")
    paired = paired.replace("fault_injector: %s", "recovery_planner: corridor:Brake")
    paired = paired.replace("faults: [{", "description: '").replace("once}]", "once'")
    (scenarios / "corridor/paired.yaml").write_text(paired)
    (scenarios / "rates.yaml").write_text(RATES)
    (folder / "test_it.py").write_text(TESTS)
    environment = {name: one for name, one in os.environ.items() if name != "PYTEST_ADDOPTS"}
    subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_it.py",
         "--dura-scenarios", "--dura-select=corridor/*"],
        cwd=folder, env=environment, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    return folder / "dura-evidence"


def problems_of(made, record):
    """What a record and the traces say against it."""
    found, rejudged = SessionRecord.of(record, made), RejudgedCount()
    told = list(record_problems(found, Counts.of(found)))
    told += trace_problems(found, rejudged)
    return told + list(derived_problems(found, rejudged))


def verdict(record, **wanted):
    (found, *_) = [
        one for one in record["verdicts"] if all(one[key] == wanted[key] for key in wanted)
    ]
    return found


def episode(record, which):
    return next(one for one in record["episodes"] if which(one))


def test_the_session_is_intact_though_its_campaigns_are_of_different_lengths(made):
    assert verify_bundle(made).problems == []
    verdicts = read_session_record(made)["verdicts"]
    runs = {one["run"] for one in verdicts if one["case"] == "corridor/idle"}
    assert len(runs) > 1
    assert any(one["pairs"] for one in verdicts)


CHANGES = {
    "invalid episodes count as valid": lambda r: verdict(
        r, requirement="GAP-1", case="corridor/idle"
    ).update(reason="all is well"),
    "a sequential bound": lambda r: verdict(r, requirement="SEQ-1")["bound"].update(upper=0.01),
    "the method of a bound": lambda r: verdict(r, requirement="RATE-1")["bound"].update(
        method="exact enough"
    ),
    "another rate": lambda r: verdict(r, requirement="RATE-1")["bound"].update(at_most=0.99),
    "another check": lambda r: verdict(r, requirement="RATE-1").update(check="always (gap > -1)"),
    "the bound on pairs": lambda r: verdict(r, paired=paired(r))["bound"].update(upper=0.01),
    "the p-value of pairs": lambda r: verdict(r, paired=paired(r))["pairs"].update(p_value=0.5),
    "pairs in which recovery acted": lambda r: verdict(r, paired=paired(r))["pairs"].update(
        acted_only_without=0
    ),
    "fewer runs than there were": lambda r: verdict(r, case="corridor/free").update(
        run=2, planned=2, episodes=2
    ),
    "a better margin": lambda r: verdict(r, case="corridor/free").update(margin=50.0),
    "better quartiles": lambda r: verdict(r, case="corridor/free")["margins"].update(q25=-1.0),
    "another reason": lambda r: verdict(r, verdict="supported").update(reason="it is good"),
    "runs that were saved": lambda r: verdict(r, case="corridor/free").update(saved=2),
    "counterexamples in another order": lambda r: max(
        r["verdicts"], key=lambda one: len(one["counterexamples"])
    )["counterexamples"].reverse(),
    "a verdict twice": lambda r: r["verdicts"].append(r["verdicts"][-1]),
    "untested cells are left out": lambda r: r["coverage"].update(
        cells=[one for one in r["coverage"]["cells"] if one["verdict"]]
    ),
    "parameters are covered": lambda r: r["coverage"]["parameters"][0].update(covered=1.0),
    "a figure of a case": lambda r: r["cases"][0]["metrics"].update(alerts=99),
    "a chain": lambda r: episode(r, lambda one: one["faults"])["faults"][0].update(detected_at=0.2),
    "a fault that was not violated through": lambda r: episode(r, lambda one: one["faults"])[
        "faults"
    ][0].update(outcome="violated also without it"),
    "a latency": lambda r: episode(r, lambda one: one["faults"])["faults"][0].update(
        manifestation_latency=0.3
    ),
    "violations also without the faults": lambda r: verdict(
        r, requirement="GAP-1", case="corridor/nudged"
    ).update(also_without=0),
    "a fault that manifested": lambda r: episode(r, lambda one: one["case"] == "corridor/idle")[
        "faults"
    ][0].update(manifested_at=0.1),
    "other faults in the spec": lambda r: episode(r, lambda one: one["faults"])["spec"].update(
        faults=[]
    ),
    "missing runs": lambda r: r["cases"][0].update(missing_runs_total=2),
    "runs that replaced the plan": lambda r: r["cases"][0].update(runs_override=99),
    "rates of a monitor": lambda r: r["monitors"][0].update(precision=0.123),
    "times of a monitor": lambda r: r["monitors"][0].update(lead_times=[], lead_time=None),
    "simulated time": lambda r: r["timings"].update(simulated_seconds=1e6),
    "redactions": lambda r: r["redacted"].update(API_KEY=1),
    "another base seed": lambda r: r.update(base_seed=77),
    "an episode by hand as planned": lambda r: episode(r, lambda one: not one["planned"]).update(
        planned=True
    ),
    "an episode by hand twice": lambda r: r["episodes"].append(
        episode(r, lambda one: not one["planned"])
    ),
    "a violation without its trace": lambda r: episode(
        r, lambda one: one["trace"] and one["trace"]["kept_for"] == "violation"
    ).update(trace=None),
    "a trace for another reason": lambda r: episode(
        r, lambda one: one["trace"] and one["trace"]["kept_for"] == "violation"
    )["trace"].update(kept_for="sample"),
    "every trace is missing": lambda r: r.update(evidence_level="all"),
    "traces where there are none": lambda r: r.update(evidence_level="summary"),
    "the outcome of a traced episode": lambda r: episode(r, lambda one: one["trace"])[
        "outcome"
    ].update(clearance_time=0.01),
    "a component of another name": lambda r: r["component_under_test"].update(name="Saint"),
    "no inputs": lambda r: r.update(inputs=[]),
    "a reason of the gate is left out": lambda r: r["gate"].update(reasons=["something"]),
    "the exit code": lambda r: r["gate"].update(exit_code=0),
    "a number that is not finite": lambda r: r["timings"].update(simulated_seconds=float("inf")),
    "an incomplete gate": lambda r: r["gate"].update(result="incomplete"),
}


def paired(record):
    return next(one["paired"] for one in record["verdicts"] if one["paired"])


@pytest.mark.parametrize("change", CHANGES.values(), ids=list(CHANGES))
def test_what_follows_from_the_rest_is_computed_again(made, change):
    record = json.loads((made / "evidence.json").read_text())
    before = json.dumps(record)
    change(record)
    assert json.dumps(record) != before
    record["totals"] = Counts.of(SessionRecord.of(record, made)).to_json()
    assert problems_of(made, record)


@pytest.mark.parametrize(
    "before, after",
    [
        ('"status": "complete"', '"status": "running", "status": "complete"'),
        ('"wall_seconds": ', '"wall_seconds": NaN, "wall_seconds_": '),
        ('"inputs": [', '"inputs": [' + "[" * 3000),
    ],
    ids=["a key twice", "NaN", "nested"],
)
def test_what_is_no_record_is_refused(made, tmp_path, before, after):
    text = (made / "evidence.json").read_text()
    assert before in text
    (tmp_path / "evidence.json").write_text(text.replace(before, after, 1))
    with pytest.raises(ConfigurationError, match="no evidence record"):
        read_session_record(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
@pytest.mark.parametrize("name", ["evidence.json", "summary.md", "manifest.json", "trace"])
def test_a_pipe_in_place_of_a_file_blocks_nobody(made, tmp_path, name):
    bundle = shutil.copytree(made, tmp_path / "bundle")
    file = bundle / name if name != "trace" else next(bundle.glob("episodes/*"))
    file.unlink()
    os.mkfifo(file)
    assert not verify_bundle(bundle).intact
