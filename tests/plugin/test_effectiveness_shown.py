"""Bad recoveries and monitors in real sessions: what the runs show, and where they cannot."""

from __future__ import annotations

import pytest

CONFTEST = """
import pytest
from pytest_dura import Assessment, Recovery, RecoveryPlanner, SafetyMonitor


class Accelerates(RecoveryPlanner):
    def run(self, view):
        return Recovery("accelerate", "away", "runs for it")


class Silent(SafetyMonitor):
    def run(self, view):
        return Assessment()


@pytest.fixture(scope="session")
def {role}():
    return {value}
"""


def session(project, scenario, *arguments, **roles):
    for role, value in roles.items():
        project.write("conftest.py", CONFTEST.format(role=role, value=value))
    items = [f"intersection/{scenario}::{name}" for name in ("REC-1", "SAF-1")]
    # With -v also what cannot be told; `test_terminal.py` holds that it is left out otherwise.
    result = project.run("-v", *items, *arguments)
    evidence = project.evidence()
    found = {one.role: (one.finding, one.detail) for one in evidence.effectiveness}
    shown = " ".join(" ".join(result.outlines).split())
    page = (project.path / "dura-evidence" / "report.html").read_text()
    for role, (_, detail) in found.items():
        assert f"{role}: {detail}" in shown
        assert f"{role}: {detail}" in page
    return {role: finding for role, (finding, _) in found.items()}


@pytest.mark.parametrize(
    "generator, role, value, findings",
    [
        (
            "aggressive", "recovery_planner", "'alert'",
            {"recovery_planner": "changed nothing", "safety_monitor": "warned"},
        ),
        (
            # What the component does anyway; beside a careful one it does no harm here.
            "aggressive", "recovery_planner", "Accelerates",
            {"recovery_planner": "changed nothing", "safety_monitor": "warned"},
        ),
        (
            "reactive", "recovery_planner", "Accelerates",
            {"recovery_planner": "cannot be told", "safety_monitor": "cannot be told"},
        ),
        (
            "aggressive", "safety_monitor", "Silent",
            {"recovery_planner": "never acted", "safety_monitor": "silent"},
        ),
        (
            "aggressive", "recovery_planner", "'emergency_brake'",
            {"recovery_planner": "prevented", "safety_monitor": "warned"},
        ),
    ],
)  # fmt: skip
def test_what_the_runs_show_stands_in_terminal_report_and_record(
    project, generator, role, value, findings
):
    options = ("--dura-runs=3", f"--dura-generator={generator}")
    assert session(project, "conflicting-traffic", *options, **{role: value}) == findings


def test_where_nothing_happens_nothing_can_be_told(project):
    found = session(project, "nominal", "--dura-runs=1")
    assert found == {"recovery_planner": "cannot be told", "safety_monitor": "cannot be told"}
