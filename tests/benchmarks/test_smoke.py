"""Every script of benchmarks/ runs in its smallest setting and prints its tables."""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from llm_servers import require_null_model

REPOSITORY = Path(__file__).parents[2]
BENCHMARKS = REPOSITORY / "benchmarks"
SMALLEST = {
    "collection_cost.py": ["--tests", "1000", "2000", "--repeats", "1", "--arms", "2"],
    "detection_table.py": [
        *("--runs", "1", "--free-runs", "1", "--jobs", "1", "--faults", "bias"),
        *("--free-scenarios", "intersection/nominal"),
    ],
    "detector_cost.py": ["--scenario", "intersection/nominal", "--repeats", "1"],
    "drafts.py": [
        *("--models", "scripted", "--rounds", "1", "--only", "there already", "contradictory"),
        *("--scenario", "intersection/sudden/leader-brakes"),
    ],
    "early_decision.py": ["--budget", "3"],
    "early_end.py": ["--runs", "1", "--repeats", "1"],
    "evidence_cost.py": ["--select", "*/nominal", "--runs", "1", "--levels", "all"],
    "evidence_memory.py": ["--episodes", "8", "16"],
    "executors.py": ["--runs", "1", "--repeats", "1", "--select", "*/nominal"],
    "falsification_table.py": [
        *("--seeds", "1", "--budget", "3"),
        *("--only", "CC1", "stopping", "swing"),
    ],
    "falsify_cost.py": ["--budget", "1", "--repeats", "1"],
    "failure_regions.py": ["--budget", "12", "--runs", "2", "--only", "cart pole"],
    "growth.py": ["--episodes", "8", "--items", "8", "--kinds", "items", "--repeats", "1"],
    "qualification.py": [
        *("--select", "*/nominal", "--runs", "1", "--processes", "1", "--without", "SAF-4"),
        *("--mutants", "driving.generator.harsh"),
    ],
    "ros1_processes.py": ["--episodes", "2", "--seconds", "0.5"],
    "rare_rate.py": ["--plain", "50", "--runs", "3", "--repetitions", "2"],
    "fault_table.py": ["--runs", "1", "--jobs", "1", "--faults", "bias", "brightness"],
    "against_gym.py": ["--episodes", "1"],
    "hidden_violations.py": ["--campaigns", "3"],
    "injector_cost.py": ["--runs", "1", "--repeats", "1", "--select", "*/nominal"],
    "install.py": ["--list"],
    "intersection_search.py": [
        *("--seeds", "1", "--budget", "1", "--jobs", "1"),
        *("--planners", "reactive", "--scenarios", "conflicting-traffic"),
    ],
    "kills.py": ["--trials", "1", "--only", "child"],
    "late_planner.py": ["--runs", "1", "--jobs", "1", "--latency", "1.5"],
    "layered.py": ["--pairs", "1"],
    "links.py": ["--seconds", "0.5", "--ticks", "20", "--wires", "in process", "pipe", "dds"],
    "llm_defects.py": [
        *("--runs", "1", "--jobs", "1", "--only"),
        *("claims a car T9 that is not shown", "slow", "with numbers"),
    ],
    "llm_concurrency.py": [
        *("--runs", "1", "--seconds", "0.01", "--select", "brief/*"),
        *("--path", str(Path(__file__).with_name("scenarios"))),
    ],
    "llm_replay.py": [
        *(
            "--runs",
            "1",
            "--select",
            "brief/*",
            "--path",
            str(Path(__file__).with_name("scenarios")),
        ),
    ],
    "loop_cost.py": ["--runs", "1", "--repeats", "1"],
    "mutants.py": ["--list"],
    "paper_suite.py": [
        *("--runs", "1", "--untrained-runs", "1", "--select", "intersection/[gt]*"),
    ],
    "paper_table.py": ["--runs", "1", "--jobs", "1", "--generator", "reactive"],
    "plugin_cost.py": ["--pairs", "1", "--kind", "cached"],
    "prices.py": [],
    "recoveries.py": ["--runs", "1", "--jobs", "1", "--select", "*/nominal"],
    "report_page.py": ["--verdicts", "40", "--repeats", "1"],
    "recorded_logs.py": ["0.1"],
    "streamed_logs.py": ["5", "0.8"],
    "open_loop.py": ["1", "ghost-obstacle"],
    "criticality_speed.py": ["60"],
    "residual_limits.py": ["--runs", "1", "--draws", "1", "--select", "*/nominal"],
    "session_scale.py": ["--runs", "1", "--requirement-runs", "1", "--select", "*/nominal"],
    "shrinking.py": [
        *("--numbers", "1", "--tries", "4", "--budget", "10", "--jobs", "1"),
        *("--select", "*/conflicting-traffic"),
    ],
    "structure.py": [],
    "structure_counts.py": [],
    "stl_speed.py": ["--repeats", "1", "--traces", "3"],
    "sequential_cost.py": ["--campaigns", "20", "--budget", "100"],
    "times_in_view.py": [
        *("--runs", "2", "--jobs", "1", "--select", "intersection/sudden/give-way-run"),
    ],
    "text_rule.py": [
        *("--runs", "1", "--jobs", "1", "--every", "10"),
        *("--wording", "paraphrased", "--manner", "keen"),
    ],
    "two_simulators.py": ["--runs", "1", "--timed", "1", "--select", "*/nominal"],
}
NOT_A_SCRIPT = {"characteristics.py", "machine.py", "reads.py", "stl_alarms.py"}
TAKES_MINUTES = {"same_results.py", "held_sessions.py"}
"""Run whole sessions, of another checkout and of twelve kinds."""
NEEDS_NETCONVERT = {"sumo_network.py"}
"""Of a wheel of 440 MB; what it makes without it, ``test_sumo_network.py`` compares."""
HEADERS = {
    "against_gym.py": ["times faster"],
    "collection_cost.py": ["kB more per test"],
    "detection_table.py": ["manifested", "false alarms"],
    "detector_cost.py": ["us/tick"],
    "drafts.py": ["what it catches, or why not", "scripted"],
    "early_decision.py": ["saved"],
    "early_end.py": ["looking"],
    "evidence_cost.py": ["share of session"],
    "evidence_memory.py": ["MB more per 1000"],
    "executors.py": ["time against the pool", "a process starts and imports, s"],
    "falsification_table.py": ["portfolio"] * 3,
    "falsify_cost.py": ["beside the plant, ms"],
    "failure_regions.py": ["violations"],
    "growth.py": ["ms more for each", "of memory"],
    "qualification.py": ["no difference", "no difference", "without SAF-4"],
    "rare_rate.py": ["splitting"],
    "ros1_processes.py": ["us a tick", "jitter ms (95 %)"],
    "fault_table.py": ["rule_based", "propagated"],
    "hidden_violations.py": ["counted as open"],
    "injector_cost.py": ["share of a tick"],
    "install.py": ["asked for by"],
    "intersection_search.py": ["bang-bang"],
    "kills.py": ["simulated twice"],
    "late_planner.py": ["mean change s"],
    "layered.py": ["it adds, ms (interval)"],
    "links.py": ["us a tick", "jitter ms (95 %)"],
    "llm_defects.py": ["runs that show it", "runs that accuse it"],
    "llm_concurrency.py": ["requests at once"],
    "llm_replay.py": ["session"],
    "loop_cost.py": [
        "ratio to highway-env without Generator",
        "ratio to highway-env without Generator",
        "part of the loop, us/tick",
    ],
    "mutants.py": ["defects"],
    "paper_suite.py": ["here: flag %", "fine-tuned", "null component"],
    "paper_table.py": [
        "gridlock",
        "p (Fisher)",
        "flagged only attacked / only free",
        "prevented",
    ],
    "plugin_cost.py": ["unused plugin"],
    "prices.py": ["new file; no other is edited", "edited; no other is", "new file of a project"],
    "recoveries.py": [
        *("unnecessary", "us/call", "unavoidable", "prevented of these"),
        *("introduced, % of the others", "gridlock only with the first", "refused"),
    ],
    "report_page.py": ["height, px"],
    "recorded_logs.py": [],
    "streamed_logs.py": [],
    "open_loop.py": ["latency s"],
    "criticality_speed.py": [],
    "residual_limits.py": ["noise of odometry", "threshold found"],
    "session_scale.py": ["times faster", "requirements on one campaign"],
    "shrinking.py": ["need a fault"],
    "structure.py": ["measure"],
    "structure_counts.py": ["measure", "its twin"],
    "stl_speed.py": ["with verdict", "us per sample", "parse"],
    "sequential_cost.py": [
        "mean runs, SPRT",
        "mean runs, e-process",
        "0 violations certify 5% after n runs",
        "rate 0.3",
    ],
    "times_in_view.py": ["caution"],
    "text_rule.py": ["flag %", "reason of the flag"],
    "two_simulators.py": ["verdicts that agree", "p", "times"],
}


def tables(output: str) -> list[tuple[list[str], list[list[str]]]]:
    """Headers and rows of each Markdown table."""
    found = []
    for block in re.findall(r"(?:^\|.*\|$\n?)+", output, flags=re.MULTILINE):
        headers, _, *rows = (
            [cell.strip() for cell in line.strip("|").split("|")] for line in block.splitlines()
        )
        found.append((headers, rows))
    return found


def test_peers_that_cannot_be_had_are_skipped_with_a_reason(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("PIP_INDEX_URL", "http://127.0.0.1:9/")
    for name in ("PIP_EXTRA_INDEX_URL", "PIP_FIND_LINKS"):
        monkeypatch.setenv(name, "")
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    monkeypatch.setenv("PIP_RETRIES", "0")
    script = BENCHMARKS / "peers" / "falsification.py"
    given = ["--peers", "verifai", "--seeds", "1", "--budget", "1", "--folder", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, str(script), *given, "--only", "none"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"^verifai: skipped: .+", done.stdout, flags=re.MULTILINE)


def test_points_that_come_over_a_pipe_are_evaluated_on_this_side(tmp_path) -> None:
    sys.path.insert(0, str(BENCHMARKS))
    try:
        systems = importlib.import_module("falsification.development").SYSTEMS
        first = runpy.run_path(str(BENCHMARKS / "peers" / "falsification.py"))["first"]
    finally:
        sys.path.remove(str(BENCHMARKS))
    other = tmp_path / "proposer.py"
    other.write_text(
        "import json, sys\n"
        "for level in (0.5, 0.6, 1.0):\n"
        "    print(json.dumps([level] * int(sys.argv[2])), flush=True)\n"
        "    if not sys.stdin.readline().strip():\n"
        "        break\n"
    )
    propose = [sys.executable, str(other), "peer"]
    assert first(propose, systems["cart"], "cart far", 1, 10) == 3
    with pytest.raises(RuntimeError, match="peer ended after 3 of 10 points"):
        first(propose, systems["cart"], "cart at rest", 1, 10)


def test_each_script_is_tried_here() -> None:
    scripts = {file.name for file in BENCHMARKS.glob("*.py")}
    assert scripts - NOT_A_SCRIPT - TAKES_MINUTES - NEEDS_NETCONVERT == set(SMALLEST)


@pytest.mark.parametrize("script", SMALLEST)
def test_the_script_prints_its_tables(script, tmp_path, forked_workers) -> None:
    if script == "llm_replay.py":
        require_null_model()
    if script == "report_page.py":
        pytest.importorskip("playwright")
        if shutil.which("chromium") is None:
            pytest.skip("there is no chromium on the path")
    if script == "two_simulators.py":
        pytest.importorskip("libsumo")
    if script == "ros1_processes.py":
        found = map(importlib.util.find_spec, ("rospy", "rosmaster"))
        if not all(found):
            pytest.skip("rospy is not installed for this Python")
    if script == "stl_speed.py":
        pytest.importorskip("rtamt", reason="rtamt cannot be imported from Python 3.13 on")
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    done = subprocess.run(
        forked_workers.command(str(BENCHMARKS / script), *SMALLEST[script]),
        cwd=tmp_path,
        env=kept,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    printed = tables(done.stdout)
    assert len(printed) == len(HEADERS[script])
    for (headers, rows), expected in zip(printed, HEADERS[script], strict=True):
        assert expected in headers
        assert rows
        assert all(len(row) == len(headers) for row in rows)
    assert not list(tmp_path.iterdir())
