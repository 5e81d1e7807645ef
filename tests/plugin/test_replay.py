from __future__ import annotations

import json

import pytest


def test_a_replay_has_the_same_digest(project):
    project.run("corridor/free")
    before = (project.path / "dura-evidence/evidence.json").read_bytes()
    digest = project.evidence()["episodes"][1]["digest"]
    result = project.run("--dura-replay=corridor/free#1")
    assert result.ret == 0
    result.stdout.fnmatch_lines(
        [
            "corridor/free#1 (Careful, seed *): time after 2.0 s",
            f"  recorded digest {digest}",
            f"  replayed digest {digest}",
            "  the same",
        ]
    )
    assert (project.path / "dura-evidence/evidence.json").read_bytes() == before


def test_a_replay_that_differs(project):
    project.run("corridor/free")
    source = (project.path / "corridor.py").read_text()
    project.write("corridor.py", source.replace("Proposal(1.0 if", "Proposal(1.5 if"))
    result = project.run("--dura-replay=corridor/free#1")
    assert result.ret == 1
    assert "DIFFERENT" in result.stdout.str()


def test_the_printed_command_replays_a_timeout_exactly(project):
    text = (project.path / "scenarios/corridor/tight.yaml").read_text()
    (project.path / "scenarios/corridor/hangs.yaml").write_text(
        text.replace("corridor/tight", "corridor/hangs")
        .replace("Careful", "Hangs")
        .replace("duration: 2.0", "duration: 0.4\ntime_budget: 0.1")
        .replace("[GAP-1]", "[GO-1]")
    )
    result = project.run("corridor/hangs", "--dura-evidence=out")
    assert result.ret == 1
    command = "pytest --dura-replay='corridor/hangs#0' --dura-evidence=out"
    assert f"replay:   {command}" in result.stdout.str()
    # A recorded timeout is repeated, not waited for: the component is not called again.
    source = (project.path / "corridor.py").read_text()
    project.write("corridor.py", source.replace("time.sleep(60)", "raise RuntimeError('called')"))
    replay = project.run("--dura-replay=corridor/hangs#0", "--dura-evidence=out")
    assert replay.ret == 0


def test_a_component_of_a_conftest_is_found_again(project):
    project.write(
        "tests/conftest.py",
        "import pytest\n"
        "from corridor import Reckless\n"
        "class Mine(Reckless): pass\n"
        "@pytest.fixture(scope='session')\n"
        "def generator(): return Mine\n",
    )
    project.write(
        "tests/test_it.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/tight')\n"
        "def test_it(episode): assert not episode.collided\n",
    )
    result = project.run("tests")
    line = next(line for line in result.outlines if "replay: pytest" in line)
    assert line.endswith("pytest --dura-replay='corridor/tight#0' tests")
    assert project.run("--dura-replay=corridor/tight#0", "tests").ret == 0


def test_an_unknown_episode(project):
    project.run("corridor/free")
    result = project.run("--dura-replay=corridor/free#7")
    assert result.ret == 4
    result.stderr.fnmatch_lines(
        [
            "ERROR: the evidence has no episode 'corridor/free#7'",
            "  expected: case#run, such as corridor/free#*",
        ]
    )


@pytest.mark.parametrize(
    "content, line",
    [
        (None, "ERROR: *evidence.json: there is no evidence here"),
        ("{", "ERROR: *evidence.json: this is no evidence record (JSONDecodeError)"),
        ("[]", "ERROR: *evidence.json: this is no evidence record (TypeError)"),
        (json.dumps({"schema_version": "0"}), "ERROR: *was written by another version*"),
    ],
)
def test_no_evidence_to_replay_from(project, content, line):
    if content is not None:
        project.write("dura-evidence/evidence.json", content)
    result = project.run("--dura-replay=corridor/free#0")
    assert result.ret == 4
    result.stderr.fnmatch_lines([line, "  remedy:   *"])
    assert "Traceback" not in result.stderr.str()


def test_an_episode_that_may_end_at_a_violation(project):
    text = (project.path / "scenarios/corridor/tight.yaml").read_text()
    (project.path / "scenarios/corridor/ends.yaml").write_text(
        text.replace("corridor/tight", "corridor/ends").replace("Careful", "Reckless")
        .replace("runs: 2", "runs: 1\nend_at_violation: true")
    )  # fmt: skip
    project.run("corridor/ends")
    assert project.evidence()["episodes"][0]["termination"] == "violation"
    assert project.run("--dura-replay=corridor/ends#0").ret == 0


@pytest.mark.parametrize(
    "damage",
    [
        lambda record: record.pop("episodes"),
        lambda record: record["episodes"].insert(0, 7),
        lambda record: record["episodes"][0].pop("spec"),
        lambda record: record["episodes"][0].pop("digest"),
        lambda record: record["episodes"][0]["spec"].update(roles=3),
        lambda record: record["episodes"][0]["spec"].update(faults=[{"type": "none"}]),
        lambda record: record["episodes"][0]["spec"]["termination"].update(time_limit=1e308),
    ],
)
def test_a_damaged_record(project, damage):
    project.run("corridor/free")
    record = project.evidence()
    damage(record)
    project.write("dura-evidence/evidence.json", json.dumps(record))
    result = project.run("--dura-replay=corridor/free#0")
    assert result.ret == 4
    result.stderr.fnmatch_lines(["ERROR: *evidence.json: the record is damaged (*", "  remedy:*"])
    assert "Traceback" not in result.stderr.str()
