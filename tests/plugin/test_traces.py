"""Which episodes leave a trace in the evidence, and that it is theirs."""

from __future__ import annotations

import base64
import errno
import hashlib
import json
import re
import zlib

import pytest
from corridors import IDLE, scenario
from outputs import output

from pytest_dura.__main__ import main
from pytest_dura.evidence import mcap, trace_path

BY_HAND = """
import pytest

@pytest.mark.parametrize("seed", [1, 2])
def test_by_hand(orchestrator, seed):
    orchestrator.run("corridor/free", seed=7)
    episode = orchestrator.run("corridor/free", seed=seed)
    assert seed == 1

@pytest.mark.dura(scenario="corridor/tight", runs=3)
@pytest.mark.requirement("GAP-1")
def test_each(episode):
    assert episode.spec.run != 1

def test_nothing_of_ours():
    assert False
"""


def kept(project, folder="dura-evidence"):
    """What was kept of each episode, whose trace is read back."""
    found = {}
    directory = project.path / folder
    files = set()
    for episode in project.evidence(folder).episodes:
        told = episode.trace
        if told is None:
            continue
        assert told.file == trace_path(episode.to_json())
        data = (directory / told.file).read_bytes()
        assert (hashlib.sha256(data).hexdigest(), len(data)) == (told.sha256, told.bytes)
        about = mcap.read_trace(directory / told.file).about
        assert {key: getattr(episode, key) for key in about} == dict(about)
        files.add(told.file)
        found[episode.id, episode.seed if not episode.planned else None] = told.kept_for
    on_disk = {f"episodes/{one.name}" for one in directory.glob("episodes/*")}
    assert on_disk == files
    return {
        name if seed is None else f"{name} by {seed}": why for (name, seed), why in found.items()
    }


@pytest.mark.parametrize(
    "level, generator, expected",
    [
        ("summary", "Reckless", {}),
        ("violations", "Careful", {"tight#0": "sample"}),
        ("all", "Careful", {"tight#0": "all", "tight#1": "all"}),
        ("all", "Reckless", {"tight#0": "violation", "tight#1": "violation"}),
    ],
)
def test_levels(project, level, generator, expected):
    options = [f"--dura-evidence-level={level}", f"--dura-generator=corridor:{generator}"]
    project.run("corridor/tight", *options)
    assert kept(project) == {f"corridor/{name}": why for name, why in expected.items()}
    assert project.evidence().evidence_level == level


@pytest.mark.parametrize("workers", [[], ["-n", "2"]], ids=["one process", "xdist"])
def test_tests_on_single_episodes(project, workers):
    """Without any option of ours: the controller learns late that there is something to keep."""
    project.write("tests/test_it.py", BY_HAND)
    project.write("dura-evidence/episodes/old-0123abcd.mcap", "of an earlier session")
    assert project.run("tests", *workers).ret == 1
    found = kept(project)
    assert found.pop("corridor/tight#1") == "violation"
    assert found.pop("corridor/free#0 by 2") == "violation"
    # In each process the first one of a case is a sample.
    assert set(found.values()) == {"sample"}
    assert workers or found == {"corridor/free#0 by 7": "sample", "corridor/tight#0": "sample"}


def test_of_missing_episodes_the_first_is_kept(project):
    text = (project.path / "scenarios/corridor/tight.yaml").read_text()
    project.write(
        "scenarios/corridor/tight.yaml", text.replace("wall: 4.0", "wall: 4.0, breaks_at: 3")
    )
    project.run("corridor/tight")
    assert kept(project) == {"corridor/tight#0": "missing"}


def test_an_invalid_episode_is_no_sample(project):
    scenario(project, faults=IDLE, fault_injector="Idle", requirements="[GAP-1]", runs=1)
    project.run("corridor/it")
    assert project.evidence().episodes[0].validity == "invalid"
    assert kept(project) == {}


def test_a_trace_that_cannot_be_written_is_told_once_and_fails_the_session(project, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(mcap, "write_trace", full)
    result = project.run("corridor/tight", "--dura-evidence-level=all")
    assert result.ret == 1
    result.assert_outcomes(passed=1)
    told = (
        "infrastructure: the trace of corridor/tight#0 cannot be written: No space left on device"
    )
    assert told in output(result)
    reasons = [line for line in output(result).splitlines() if "infrastructure: " in line]
    assert reasons == [f"  {told}."]  # of two traces that could not be written
    assert kept(project) == {}
    assert project.evidence().gate.result == "failed"


def test_traces_of_an_earlier_session_go_and_nothing_else(project):
    outside = project.path / "precious-0123abcd.mcap"
    outside.write_text("not ours")
    project.run("corridor/tight", "--dura-evidence-level=all")
    folder = project.path / "dura-evidence/episodes"
    (folder / "precious-0123abcd.mcap").symlink_to(outside)
    (folder / ".precious-0123abcd.mcap-x7").write_text("half of one")
    project.run("corridor/tight")
    assert kept(project) == {"corridor/tight#0": "sample"}
    assert outside.read_text() == "not ours"


HARMED = {
    "duration": 2.0, "runs": 3, "world": "{wall: 4.0}", "monitor": "oddities:Early",
    "recovery_planner": "oddities:Push",
}  # fmt: skip
PAIRS = """
import pytest

@pytest.mark.dura(scenario="corridor/it")
def test_alone(campaign):
    with pytest.raises(pytest.fail.Exception):
        campaign.require("always (gap > 0)")

@pytest.mark.dura(scenario="corridor/it")
def test_pairs(campaign):
    campaign.paired(without="recovery_planner").require("always (gap > 0)")
"""


def players_of(project):
    """What the players of the report play, by episode."""
    page = (project.path / "dura-evidence/report.html").read_text()
    texts = re.findall(r'<script type="application/octet-stream">([^<]+)</script>', page)
    data = [json.loads(zlib.decompress(base64.b64decode(text))) for text in texts]
    return {each["about"]["id"]: each for each in data}


@pytest.mark.parametrize("order", [("test_alone", "test_pairs"), ("test_pairs", "test_alone")])
def test_the_worst_counterexample_has_its_twin_beside_it(project, order):
    scenario(project, **HARMED)
    project.write("test_it.py", PAIRS)
    project.run(*(f"test_it.py::{name}" for name in order))
    worst = project.evidence().verdicts[0].counterexamples[0].episode
    number = worst.rpartition("#")[2]
    reasons = kept(project)
    assert reasons[f"corridor/it~recovery_planner#{number}"] == "twin"
    assert sorted(reasons.values()) == ["twin", "violation", "violation", "violation"]
    players = players_of(project)
    (twin,) = players[worst]["twins"]
    assert (twin["id"], twin["label"]) == (
        f"corridor/it~recovery_planner#{number}", "without RecoveryPlanner",
    )  # fmt: skip
    tick, text = twin["acted"]
    trace = mcap.read_trace(project.path / "dura-evidence" / next(
        one.trace.file for one in project.evidence().episodes if one.id == worst))  # fmt: skip
    assert text.startswith(f"{trace.decisions['executed'][tick]} here, ")
    assert trace.decisions["source"][tick] == "recovery"
    assert not any(each["twins"] for id_, each in players.items() if id_ != worst)
    assert main(["verify", str(project.path / "dura-evidence")]) == 0
    replayed = project.run(f"--dura-replay={worst}")
    replayed.stdout.fnmatch_lines(["  the same seed without RecoveryPlanner: it is shown beside*"])


@pytest.mark.parametrize("level", ["summary", "all"])
def test_other_levels_keep_no_twins(project, level):
    scenario(project, **HARMED)
    project.write("test_it.py", PAIRS)
    project.run("test_it.py", f"--dura-evidence-level={level}")
    assert "twin" not in kept(project).values()


def test_the_run_without_faults_is_a_twin_as_well(project):
    scenario(project, faults=IDLE, fault_injector="oddities:Nudge", **HARMED)
    project.write("test_it.py", PAIRS.replace('"recovery_planner"', '"faults"'))
    project.run("test_it.py")
    worst = project.evidence().verdicts[0].counterexamples[0].episode
    twin = worst.replace("#", "+none#")
    assert kept(project)[twin] in ("sample", "twin")  # the worst may be the first run
    assert [each["label"] for each in players_of(project)[worst]["twins"]] == ["without faults"]
