"""Logs played to roles: faults and detectors act as in simulations, and commands change nothing."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from recorded_drives import poses, simulated, sizes, written
from recorded_logs import Drive

from pytest_dura import ConfigurationError, Orchestrator, RoleSpec
from pytest_dura.domains import DOMAINS
from pytest_dura.library import expand_cases
from pytest_dura.logs.simulator import log_scenario

MAPPING = {"time_step": 0.1, "world": {"driving": {"axes": "left-handed", "junction": [0, 0]}}}
ROLES = {"residual_monitor": RoleSpec(DOMAINS["driving"].short_names["residual_monitor"]["cusum"])}


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A drive of the rule-based planner, and the log of its poses."""
    episode, ticks = simulated("intersection/congested", 0, "rule_based")
    file = written(tmp_path_factory.mktemp("logs") / "drive.csv", poses(ticks))
    mapping = yaml.safe_load(yaml.safe_dump(MAPPING))
    mapping["world"]["driving"]["objects"] = sizes(ticks)
    return episode, file, mapping


def played(file, mapping, faults=("none",), **roles):
    """The episodes of a log under faults."""
    scenario = log_scenario(str(file), mapping, played=True)
    for case in expand_cases([scenario], list(faults)):
        spec = case.spec(0, 0, {**ROLES, **roles})
        episode = Orchestrator.build(spec).run(spec)
        assert episode.failure is None, episode.failure
        yield episode


def alerts(episode):
    return {event.detail.partition(":")[0] for event in episode.events if event.kind == "alert"}


def test_a_component_agrees_with_the_drive_that_it_drove(drive) -> None:
    driven, file, mapping = drive
    (episode,) = played(file, mapping)
    assert len(episode.time) == len(driven.time)
    assert np.ptp(driven.signal("acceleration")) > 3
    # What the actuators of the simulation did not follow is all that differs.
    for name in ("command_error", "gap", "speed", "near_misses", "required_deceleration"):
        assert episode.signal(name) == pytest.approx(driven.signal(name), abs=1e-6), name
    assert episode.events[0].kind == "recorded"
    assert "in open loop" in episode.events[0].detail
    reckless = RoleSpec(DOMAINS["driving"].short_names["generator"]["aggressive"])
    (other,) = played(file, mapping, generator=reckless)
    mean = [each.signal("command_error").mean() for each in (episode, other)]
    assert mean[1] > mean[0] + 1
    assert other.signal("gap").tolist() == episode.signal("gap").tolist()


def test_detectors_see_faults_that_are_laid_over_a_log(drive) -> None:
    _, file, mapping = drive
    faults = ("none", "ghost-obstacle", "gnss-jump", "trajectory-spoof")
    clean, ghost, jump, spoof = played(file, mapping, faults)
    assert alerts(clean) == set()
    assert "object_from_nowhere" in alerts(ghost)
    assert "residual" in alerts(jump)
    assert spoof.faults[0].detection_latency is not None
    for episode in (ghost, jump, spoof):
        assert episode.faults[0].manifested_at is not None
        assert episode.signal("gap").tolist() == clean.signal("gap").tolist()


def test_percepts_and_scene_of_a_log_are_those_of_the_drive(drive) -> None:
    driven, file, mapping = drive
    (episode,) = played(file, mapping)
    for name in ("percept.gap", "percept.speed", "percept.ttc"):
        assert episode.signal(name) == pytest.approx(driven.signal(name), abs=1e-6)


def test_what_cannot_be_played_is_refused(drive, tmp_path) -> None:
    _, file, mapping = drive
    lines = file.read_text().splitlines()
    cut = tmp_path / "cut.csv"
    cut.write_text("\n".join([*lines[:20], *lines[40:]]) + "\n")
    (case,) = expand_cases([log_scenario(str(cut), mapping, played=True)])
    spec = case.spec(0, 0, {})
    with pytest.raises(ConfigurationError, match="has gaps"):
        Orchestrator.build(spec).run(spec)
    blind = {"type": "brightness", "id": "dark", "activation": {"at": 1.0}}
    with pytest.raises(ConfigurationError, match="camera_front"):
        list(played(file, mapping, [blind]))


def test_sessions_lay_faults_over_logs(project, drive) -> None:
    _, file, mapping = drive
    project.write("drive.csv", file.read_text())
    project.write("mapping.yaml", yaml.safe_dump(mapping))
    project.write(
        "test_open.py",
        """
import pytest

@pytest.mark.dura(logs="drive.csv", mapping="mapping.yaml", faults=["none", "ghost-obstacle"])
@pytest.mark.requirement("OPEN-1", text="It asks for what the driver did, to 5 m/s2.")
def test_near_the_driver(campaign):
    campaign.require("always (command_error < 5)")
""",
    )
    result = project.run("test_open.py")
    output = result.stdout.str()
    assert "open-loop/drive.csv " in output.partition("component under test")[2]
    page = (project.path / "dura-evidence" / "report.html").read_text("utf-8")
    assert "open-loop/drive.csv" in page
    for case in ("open-loop/drive.csv", "open-loop/drive.csv+ghost-obstacle"):
        assert project.verdict("OPEN-1", case).verdict == "supported", output


def test_a_log_without_a_world_is_played_to_a_component_that_reads_its_channel(project) -> None:
    Drive(0).csv(project.path / "gap.csv")
    project.write(
        "conftest.py",
        """
import pytest
from pytest_dura import Generator, Proposal

class Reader(Generator):
    def propose(self, view):
        return Proposal("recorded", f"a gap of {view.percept['log']['gap']:.0f} m")

@pytest.fixture(scope="session")
def generator():
    return Reader
""",
    )
    project.write(
        "test_open.py",
        """
import pytest

BIAS = {"type": "bias", "id": "far", "target": "log.gap",
        "activation": {"at": 2.0}, "parameters": {"offset": 50}}

@pytest.mark.dura(logs="gap.csv", faults=["none", BIAS])
@pytest.mark.requirement("OPEN-2", text="The gap stays above 3 m.")
def test_gap(log):
    assert log.satisfies("always (gap > 3)")
    assert bool(log.faults) == (log.spec.case != "open-loop/gap.csv")
    assert all(fault.manifested_at for fault in log.faults)
""",
    )
    result = project.run("test_open.py")
    for case in ("open-loop/gap.csv", "open-loop/gap.csv+far"):
        assert project.verdict("OPEN-2", case).verdict == "supported", result.stdout.str()
