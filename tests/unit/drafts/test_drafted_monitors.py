"""Monitors that a language model drafts: what they would warn of, and who lets them in."""

from __future__ import annotations

import pytest
import yaml
from drafting_model import draft, drafting

from pytest_dura.__main__ import main
from pytest_dura.campaign.runner import Runner
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.library import load_library
from pytest_dura.requirements.monitoring.stl_monitor import StlSafetyMonitor

SCENARIO = """
name: road/crossing
simulator: driving
duration: 8.0
runs: 2
policy: recover
world:
  ego: {distance: 50.0, speed: 8.0}
  vehicles: [{id: W, arm: west, distance: 42.0, speed: 9.0}]
requirements: [SAF-1, PERF-1]
"""
NEAR = "historically[0:0.2] (percept.gap > 1.5)"


def near(formula=NEAR, *bounds, name="NEAR-1", **changed):
    return draft(formula, *bounds or (("percept.gap", 1.5, "m"),), name=name,
                 text="The ego never comes near.", **changed)  # fmt: skip


@pytest.fixture
def run(tmp_path, capsys, monkeypatch):
    """`run(*rounds, arguments)` lets a scripted model draft monitors; code, output, requests."""
    monkeypatch.chdir(tmp_path)
    for name in ("DURA_LLM_API_KEY", "DURA_LLM_HEADERS", "DURA_LLM_EXTRA_BODY", "DURA_LLM_ABOUT"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "suite").mkdir()
    (tmp_path / "suite" / "crossing.yaml").write_text(SCENARIO)

    def drafted(*rounds, arguments=("--rounds=1",), warns_of="SAF-1"):
        with drafting(*rounds) as server:
            code = main([
                "draft", "--domain=driving", "Warn before the ego touches anything",
                "--suite=suite", "--scenario=road/*", f"--warns-of={warns_of}",
                f"--llm={server.base_url}/{server.model}", *arguments,
            ])  # fmt: skip
        return code, capsys.readouterr(), server.requests

    return drafted


def test_what_warns_of_no_violation_or_tells_nothing_apart_is_refused_with_its_reason(run):
    refused = {
        "NEAR-2": (near("always (percept.gap > 1.5)", name="NEAR-2"), "cannot know the future"),
        "NEAR-3": (near("gap > 1.5", ("gap", 1.5, "m"), name="NEAR-3"), "unknown signal 'gap'"),
        "NEAR-4": (
            near(NEAR, ("percept.gap", 1.5, "s"), name="NEAR-4"),
            "stated in 's', and its unit is m",
        ),
        "NEAR-5": (near("percept.gap >= 0", name="NEAR-5", bounds=[]), "it always holds"),
        "FAST-1": (
            near("percept.speed < 60", ("percept.speed", 60, "m/s"), name="FAST-1"),
            "constant: it alarms in none of",
        ),
        "FAST-2": (
            near("percept.speed > 60", ("percept.speed", 60, "m/s"), name="FAST-2"),
            "is both satisfied and without an alarm",
        ),
    }
    code, printed, requests = run([each for each, _ in refused.values()])
    assert code == 1
    lines = printed.out.splitlines()
    for name, (_, reason) in refused.items():
        (line,) = [each for each in lines if each.strip().startswith(f"{name} refused: ")]
        assert reason in line
    (system,) = [
        each.json["messages"][0]["content"] for each in requests
        if each.body and "requirements for tests" in str(each.json)
    ]  # fmt: skip
    assert "warn, while the system runs, of\nviolations of SAF-1" in system
    assert "- percept.gap [m]" in system
    assert "- gap [m]" not in system


def test_a_monitor_acts_once_a_person_has_signed_it_and_a_scenario_names_it(run, tmp_path, capsys):
    code, printed, _ = run([near()], arguments=["--rounds=1", "-o", "monitors.yaml"])
    assert code == 0, printed
    assert "NEAR-1 kept: historically[0:0.2] (percept.gap > 1.5); as a monitor of SAF-1, " in (
        printed.out
    )
    file = tmp_path / "monitors.yaml"

    def entry():
        (found,) = yaml.safe_load(file.read_text())["requirements"]
        return found

    source = " ".join(entry()["source"].split())
    assert source.startswith("drafted, not reviewed: scripted, server ")
    assert "without recovery it warns of 1 of 1 violated runs" in source

    # No scenario names it: it judges nothing, signed or not.
    library = load_library([tmp_path / "suite", file])
    assert "NEAR-1" in library.requirements
    assert all("NEAR-1" not in each.requirements for each in library.scenarios.values())

    with pytest.raises(ConfigurationError, match="a draft that no person has signed"):
        StlSafetyMonitor(NEAR, draft=entry())
    named = SCENARIO + yaml.safe_dump({
        "roles": {"stl_monitor": {"path": "stl", "params": {"formula": NEAR, "draft": entry()}}}
    })  # fmt: skip
    place = tmp_path / "suite" / "crossing.yaml"
    place.write_text(named)
    with pytest.raises(ConfigurationError, match="a draft that no person has signed"):
        Runner.of(tmp_path / "suite", generator="aggressive").run("road/crossing")

    (tmp_path / "review.yaml").write_text(
        "who: A. Person\nwhen: 2026-11-28\nwhat: bound and units\ndecision: accepted\n"
    )
    assert main(["review", "monitors.yaml", "review.yaml"]) == 0
    capsys.readouterr()
    signed = {"formula": NEAR, "draft": entry()}
    unhindered = SCENARIO.replace("recover", "log_only")  # its own monitor would come first
    place.write_text(
        unhindered + yaml.safe_dump({"roles": {"stl_monitor": {"path": "stl", "params": signed}}})
    )
    episode = Runner.of(tmp_path / "suite", generator="aggressive").run("road/crossing")
    assert episode.failure is None
    assert episode.metrics.flags["stl_monitor"]

    # A signature is one on this formula, this text and this source.
    with pytest.raises(ConfigurationError, match="it is a draft of `always"):
        StlSafetyMonitor(NEAR.replace("1.5", "0.5"), draft=entry())
    with pytest.raises(ConfigurationError, match="changed after a person signed it"):
        StlSafetyMonitor(NEAR, draft={**entry(), "text": "Else."})
    for broken in ({**entry(), "more": 1}, {**entry(), "source": 3}, {**entry(), "source": "mine"}):
        with pytest.raises(ConfigurationError, match="no entry of a file of drafts"):
            StlSafetyMonitor(NEAR, draft=broken)


@pytest.mark.parametrize("given", ["SAF-99", "PERF-1", "SAF-3"])
def test_a_requirement_that_no_chosen_scenario_can_violate_is_refused_first(run, given):
    code, printed, requests = run([near()], warns_of=given)
    assert code == 2
    assert given in printed.err
    assert not [each for each in requests if "requirements for tests" in str(each.body)]


def test_traces_show_no_monitor_at_work(run):
    code, printed, _ = run([near()], arguments=["--traces=suite"])
    assert code == 2
    assert "monitors are run anew, without recovery" in printed.err
