"""``--dura-shard=K/N``: which items a shard keeps, and what its evidence says of itself."""

from __future__ import annotations

import json
import re

import pytest
from corridors import scenario

from pytest_dura.evidence import all_formats, verify_bundle

TESTS = """
import pytest

@pytest.mark.dura(scenario="corridor/*", verdict=False)
def test_each_run(episode):
    assert not episode.collided

@pytest.mark.dura(scenario="corridor/*")
@pytest.mark.requirement("GAP-1")
def test_each_case(campaign):
    campaign.require()

def test_by_hand(orchestrator):
    assert not orchestrator.run("corridor/tight").collided

@pytest.mark.parametrize("number", [3, 1, 2])
def test_of_somebody_else(number):
    assert number
"""


def ran(project, *arguments):
    """Node ids that a session of the project ran, in their order."""
    result = project.run("-v", "-p", "no:randomly", *arguments)
    told = [line for line in result.outlines if " PASSED" in line]
    return [re.search(r"\S+::\S+", line)[0] for line in told]


def shards(project, count, *arguments):
    return [ran(project, f"--dura-shard={number}/{count}", *arguments)
            for number in range(1, count + 1)]  # fmt: skip


@pytest.mark.parametrize("arguments", [[], ["-k", "each or tight"]], ids=["all", "k"])
def test_shards_with_the_same_arguments_run_everything_once(project, arguments):
    project.write("test_it.py", TESTS)
    arguments = ["test_it.py", "--dura-scenarios", "--dura-select=corridor/*", *arguments]
    whole = ran(project, *arguments)
    found = shards(project, 3, *arguments)
    assert len(whole) == (14 if len(arguments) == 3 else 8)
    assert sorted(item for shard in found for item in shard) == sorted(whole)
    assert all(found[:2])  # with -k there are two units alone
    # Each keeps the order in which the whole session would run them.
    assert all(shard == [item for item in whole if item in shard] for shard in found)
    for case in ("corridor/free", "corridor/tight"):
        holders = [shard for shard in found
                   if any(case in item for item in shard)]  # fmt: skip
        assert len(holders) == 1


def test_the_workers_of_a_shard_run_the_same_as_one_process(project):
    project.write("test_it.py", TESTS)
    arguments = ["test_it.py", "--dura-shard=2/2"]
    plain = ran(project, *arguments)
    told = project.evidence().shard
    assert sorted(ran(project, *arguments, "-n", "2")) == sorted(plain) != []
    assert project.evidence().shard == told
    assert told.plan is not None


def test_a_worker_that_dies_does_not_take_the_plan_along(project):
    text = (project.path / "scenarios/corridor/tight.yaml").read_text()
    (project.path / "scenarios/corridor/deadly.yaml").write_text(
        text.replace("corridor/tight", "corridor/deadly").replace("wall: 4.0", "dies: true")
    )
    result = project.scenarios("--dura-shard=1/1", "-n", "2")
    assert result.ret == 1
    evidence = project.evidence()
    assert evidence.status == "complete"
    assert [one.name for one in evidence.shard.holds] == [
        "corridor/deadly", "corridor/free", "corridor/tight",
    ]  # fmt: skip
    assert project.verdicts()["corridor/deadly", "GAP-1"] == "undecided"


@pytest.mark.parametrize(
    "kind, wait", [("trylast", "result = None"), ("wrapper=True, tryfirst", "result = yield")]
)
def test_a_plugin_that_chooses_later_chooses_before_the_split(project, kind, wait):
    """The second one chooses as ``--lf`` does."""
    project.write("test_it.py", TESTS)
    project.write(
        "conftest.py",
        "import pytest\n"
        f"@pytest.hookimpl({kind}=True)\n"
        "def pytest_collection_modifyitems(items):\n"
        f"    {wait}\n"
        "    items[:] = [one for one in items if 'somebody' in one.name]\n"
        "    return result\n",
    )
    found = shards(project, 3, "test_it.py")
    assert sorted(map(len, found)) == [1, 1, 1]


@pytest.mark.parametrize("arguments", [[], ["-n", "1"]], ids=["one", "worker"])
def test_items_that_a_plugin_takes_out_after_the_split_are_not_lost(project, arguments):
    project.write("test_it.py", TESTS)
    project.write(
        "conftest.py",
        "import pytest\n"
        "@pytest.hookimpl(tryfirst=True)\n"
        "def pytest_collection_finish(session):\n"
        "    session.items[:] = [one for one in session.items if '[3]' in one.name]\n",
    )
    result = project.run("test_it.py", "--dura-shard=1/1", "-k", "somebody", *arguments)
    assert result.ret == 1
    (told,) = project.evidence().gate.reasons
    assert "a plugin took out 2 of 3 items after the session was split" in told
    assert "the first of them test_it.py::test_of_somebody_else[1]" in told
    assert told in " ".join(result.stdout.str().split())


def test_cases_that_share_runs_without_faults_are_one_unit(project):
    faults = "[{type: bias, target: gap, activation: {at: 0.1}, parameters: {offset: 0.1}}]"
    injector = "pytest_dura.faults.injector:CampaignInjector"
    project.write(
        "scenarios/requirements_pair.yaml",
        "requirements:\n  - {id: P-1, text: No worse., kind: safety, check: always (gap > 0), "
        "paired: {without: faults}}\n",
    )
    for name in ("one", "two"):
        scenario(project, name, faults=faults, fault_injector=injector, runs=2,
                 requirements="[P-1]" if name == "one" else "[GAP-1]")  # fmt: skip
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario=['corridor/one', 'corridor/two'], faults=['none'])\n"
        "@pytest.mark.requirement('GAP-1')\n"
        "def test_bare(campaign): campaign.require()\n",
    )
    selected = ["--dura-select=corridor/one", "--dura-select=corridor/two"]
    project.run("test_it.py", "--dura-scenarios", *selected, "--dura-shard=1/1")
    held = {one.name: one for one in project.evidence().shard.holds}
    assert sorted(held) == ["corridor/one", "corridor/two", "corridor/two+none"]
    assert (held["corridor/one"].items, held["corridor/one"].episodes) == (2, 4)
    assert held["corridor/two"].episodes == 2


def test_a_shard_that_rightly_has_nothing_to_run_ends_well(project):
    result = project.scenarios("--dura-shard=3/3", "-n", "2")
    assert result.ret == 0
    evidence = project.evidence()
    assert (evidence.gate.result, evidence.status) == ("passed", "complete")
    assert (evidence.shard.units, evidence.shard.holds) == (2, [])
    assert "gate of shard 3 of 3: passed, no verdict" in result.outlines
    assert verify_bundle(project.path / "dura-evidence").problems == []


def test_a_shard_of_a_session_without_any_test_ends_as_that_does(project):
    project.write("test_nothing.py", "")
    result = project.run("test_nothing.py", "--dura-shard=1/3")
    assert result.ret == 5
    assert project.evidence().gate.result == "failed"


def test_everything_says_that_a_shard_is_a_part(project):
    exports = ("--dura-export=cyclonedx", "--dura-export=in-toto", "--dura-export=needs")
    result = project.scenarios("--dura-shard=1/2", *exports)
    text = result.stdout.str()
    assert "dura: shard 1 of 2 of that; the others run elsewhere" in text
    assert "dura: shard 1 of 2 holds 1 of 2 units, 2 items, 3 episodes" in text
    assert "gate of shard 1 of 2: passed, 2 supported" in text
    assert not re.search("^gate: ", text, re.MULTILINE)
    folder = project.path / "dura-evidence"
    silent = [one.FILE for one in all_formats()
              if "hard 1 of 2" not in (folder / one.FILE).read_text()]  # fmt: skip
    # The picture wraps the words of the argument's elements over its lines.
    assert silent in ([], ["assurance-case.svg"])
    summary = (folder / "summary.md").read_text()
    assert summary.startswith("# Gate of shard 1 of 2 passed: a part of a session, not the whole")
    statement = json.loads((folder / "test-result.intoto.json").read_text())
    assert statement["predicate"]["result"] == "WARNED"
    attested = json.loads((folder / "cyclonedx.json").read_text())["declarations"]["attestations"]
    assert not any("score" in one["conformance"] for one in attested[0]["map"])
    assert verify_bundle(folder).problems == []


def test_a_whole_session_is_none(project):
    result = project.scenarios()
    assert project.evidence().shard is project.evidence().merged_from is None
    assert "shard" not in result.stdout.str()


@pytest.mark.parametrize(
    "given",
    [
        "0/3",
        "4/3",
        "2",
        "2/",
        "/3",
        "a/b",
        "-1/3",
        "1/0",
        "2/5/7",
        "²/3",
        "1/10001",
        "1/" + "9" * 5000,
    ],
)
def test_a_shard_that_cannot_be_is_refused(project, given):
    result = project.scenarios(f"--dura-shard={given}")
    assert result.ret == 4
    text = result.stderr.str()
    assert "--dura-shard takes the number of a shard and how many there are" in text
    assert f"found:    '{given[:20]}" in text
    assert "remedy:   for example --dura-shard=2/5" in text


@pytest.mark.parametrize(
    "other",
    ["--dura-list", "--dura-replay=x#1", "--dura-reduce=x#1", "--dura-baseline=x",
     "--dura-llm=record"],
)  # fmt: skip
def test_what_is_about_a_whole_session_takes_no_shard(project, other):
    result = project.scenarios("--dura-shard=1/2", other)
    assert result.ret == 4
    name = other.partition("=")[0]
    assert f"--dura-shard and {name} exclude each other" in result.stderr.str()


def test_options_on_which_results_depend_are_recorded(project):
    others = ["--dura-seed=5", "--dura-evidence-level=all", "--dura-undecided=warn", "--runxfail"]
    others += ["-o", "xfail_strict=true", "-o", "junit_suite_name=shard-1"]
    project.scenarios("--dura-shard=1/2", "--dura-runs=3", "--dura-no-twins", *others)
    assert project.evidence().options == {
        "--dura-no-twins": "true",
        "--dura-runs": '"3"',
        "--override-ini": '["xfail_strict=true"]',
        "--runxfail": "true",
    }
