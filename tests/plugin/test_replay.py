from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlparse
from urllib.request import url2pathname

import pytest
from sealing import alter, seal

from pytest_dura.evidence import read_trace, write_trace


def test_a_replay_has_the_same_digest(project):
    project.run("corridor/free")
    before = (project.path / "dura-evidence/evidence.json").read_bytes()
    digest = project.evidence().episodes[1].digest
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


def faster(project):
    """From tick 1 on the component goes on faster."""
    source = (project.path / "corridor.py").read_text()
    project.write("corridor.py", source.replace("Proposal(1.0 if", "Proposal(1.5 if"))


def page(result):
    """What the player's URL leads to."""
    (line,) = [line for line in result.outlines if line.startswith("  player: ")]
    return Path(url2pathname(urlparse(line.removeprefix("  player: ")).path))


def test_a_replay_that_differs_says_where_first(project):
    project.run("corridor/free")
    faster(project)
    result = project.run("--dura-replay=corridor/free#0")
    assert result.ret == 1
    first = "tick 0 (0.000 s), decisions.proposed: recorded 1.0, replayed 1.5"
    result.stdout.fnmatch_lines(
        [
            "  DIFFERENT: the code, a package or the platform has changed, *",
            f"  first difference: {first}; at this tick also decisions.executed",
            "  player: file:///*/dura-evidence-replay/corridor-free-0-*.html",
        ]
    )
    assert "corridor/free#0" in page(result).read_text()


def test_a_replay_that_differs_where_no_trace_was_kept(project):
    project.run("corridor/free")
    faster(project)
    result = project.run("--dura-replay=corridor/free#1")
    assert result.ret == 1
    result.stdout.fnmatch_lines(
        ["  no trace of it was kept (--dura-evidence-level=all keeps each)", "  it is not known *"]
    )


def test_a_replay_leaves_the_bundle_as_it_is_wherever_it_lies(project):
    project.run("corridor/free")
    (project.path / "elsewhere").mkdir()
    copy = shutil.copytree(project.path / "dura-evidence", project.path / "elsewhere/copy")
    before = {one: one.read_bytes() for one in copy.rglob("*") if one.is_file()}
    assert any(one.suffix == ".mcap" for one in before)
    shutil.rmtree(project.path / "dura-evidence")
    result = project.run("--dura-replay=corridor/free#0", "--dura-evidence=elsewhere/copy")
    assert result.ret == 0
    assert "first difference" not in result.stdout.str()
    assert page(result).parent == project.path / "elsewhere/copy-replay"
    assert {one: one.read_bytes() for one in copy.rglob("*") if one.is_file()} == before
    assert not (project.path / "dura-evidence").exists()


def tampered(project, change):
    """Another trace in the place of the one that was kept, and the record of that."""
    record = project.evidence().to_json()
    told = record["episodes"][0]["trace"]
    file = project.path / "dura-evidence" / told["file"]
    told.update(write_trace(file, change(read_trace(file))))
    project.write("dura-evidence/evidence.json", json.dumps(record))
    seal(project.path / "dura-evidence")


def test_a_trace_of_another_episode_is_found_at_its_tick(project):
    project.run("corridor/free")

    def change(trace):
        trace.signals["gap"][7] += 0.5
        return trace

    tampered(project, change)
    result = project.run("--dura-replay=corridor/free#0")
    assert result.ret == 1
    place = "tick 7 (0.700 s), signals.gap: recorded *, replayed *"
    result.stdout.fnmatch_lines(
        ["  the same", f"  yet the trace that was kept is of another episode: {place}"]
    )


def test_what_the_digest_leaves_out_may_differ(project):
    project.run("corridor/free")

    def change(trace):
        texts = ("otherwise\x1b[31m", *trace.recording.explanations[1:])
        return replace(trace, recording=replace(trace.recording, explanations=texts))

    tampered(project, change)
    result = project.run("--dura-replay=corridor/free#0")
    assert result.ret == 0
    place = r"tick 0 (0.000 s), explanations: recorded otherwise\x1b[[]31m, replayed ''"
    result.stdout.fnmatch_lines([f"  what the digest leaves out is not the same: {place}"])


@pytest.mark.parametrize(
    "damage, line, code",
    [
        (lambda file: file.unlink(), "  its trace episodes/*.mcap is not there any more", 0),
        (lambda file: file.write_bytes(b"\x89MCAP0"), "  its trace cannot be compared:", 1),
        (
            lambda file: write_trace(file, replace(read_trace(file), signals={})),
            "    *.mcap: the trace is not the one that was recorded: its SHA-256 is another",
            1,
        ),
    ],
)
def test_a_damaged_trace(project, damage, line, code):
    project.run("corridor/free")
    (file,) = (project.path / "dura-evidence/episodes").iterdir()
    damage(file)
    seal(project.path / "dura-evidence")
    result = project.run("--dura-replay=corridor/free#0")
    result.stdout.fnmatch_lines(["  the same", line])
    assert result.ret == code
    assert page(result).exists()


def test_a_record_that_leads_out_of_the_bundle(project):
    project.run("corridor/free")
    name = "episodes/../../secret-0123abcd.mcap"
    alter(
        project.path / "dura-evidence",
        lambda record: record["episodes"][0]["trace"].update(file=name),
    )
    result = project.run("--dura-replay=corridor/free#0")
    assert result.ret == 4
    assert "this record is damaged" in result.stderr.str()


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
    assert project.evidence().episodes[0].termination == "violation"
    assert project.run("--dura-replay=corridor/ends#0").ret == 0


def no_episodes(record):
    record.pop("episodes")


DAMAGES = [
    no_episodes,
    lambda record: record["episodes"].insert(0, 7),
    lambda record: record["episodes"][0].pop("spec"),
    lambda record: record["episodes"][0].pop("digest"),
    lambda record: record["episodes"][0]["spec"].update(roles=3),
    lambda record: record["episodes"][0]["spec"].update(faults=[{"type": "none"}]),
    lambda record: record["episodes"][0]["spec"]["termination"].update(time_limit=1e308),
]


def test_a_damaged_record(project):
    project.run("corridor/free")
    file = project.path / "dura-evidence/evidence.json"
    whole = file.read_text()
    for damage in DAMAGES:
        file.write_text(whole)
        alter(project.path / "dura-evidence", damage)
        result = project.run("--dura-replay=corridor/free#0")
        assert result.ret == 4
        result.stderr.fnmatch_lines(["ERROR: *evidence.json: th* record is damaged*", "  remedy:*"])
        assert "Traceback" not in result.stderr.str()
