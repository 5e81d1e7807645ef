from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from pytest_dura.evidence.item_verdicts import Waiver

KEYS = {
    "schema_version", "status",
    "measures", "created", "tool", "command", "base_seed", "environment",
    "component_under_test", "requirements", "cases", "episodes", "verdicts", "searches", "monitors",
    "baseline", "finished", "evidence_level", "gate", "inputs", "coverage", "timings",
    "require_repeatable", "selection",
    "redacted", "totals", "shard", "merged_from",
    "judgements", "waivers", "doubts", "resume", "execution", "overall", "effectiveness",
    "conclusions", "failed_items", "options",
}  # fmt: skip


def test_the_record_has_the_keys_of_the_design(reference):
    file = reference("plain").path / "dura-evidence/evidence.json"
    evidence = json.loads(file.read_text())
    assert set(evidence) == KEYS
    assert set(evidence["environment"]) >= {"python", "platform", "packages", "git"}
    assert {"id", "text", "kind", "source"} <= set(evidence["requirements"][0])
    assert {"id", "scenario", "faults", "metrics", "component"} <= set(evidence["cases"][0])
    episode = evidence["episodes"][0]
    assert {"id", "case", "seed", "validity", "digest", "trace", "events", "spec"} <= set(episode)
    verdict = evidence["verdicts"][0]
    assert {
        "requirement", "case", "verdict", "planned", "episodes", "violations", "invalid",
        "missing", "vacuous", "bound", "margin", "counterexamples",
    } <= set(verdict)  # fmt: skip
    assert set(verdict["bound"]) >= {"confidence", "upper", "method"}


def test_plain_and_distributed_runs_leave_the_same_record(reference):
    def comparable(mode):
        keys = {"cases", "episodes", "verdicts", "requirements"}
        evidence = reference(mode).evidence().to_json(include=keys)
        for episode in evidence["episodes"]:
            del episode["metrics"]["processing_us"], episode["timings"]["processing_seconds"]
        return evidence

    assert comparable("n2") == comparable("plain")


@pytest.mark.parametrize(
    "fixture, mode",
    [("generator", "plain"), ("simulator", "plain"), ("campaign", "n2"), ("episode", "n0")],
    indirect=["mode"],
)  # fmt: skip
def test_a_forgotten_fixture_of_somebody_else_leaves_nothing_behind(
    pytester, fast_sessions, fixture, mode
):
    pytester.makepyfile(f"def test_it({fixture}): assert {fixture}.is_mine")
    assert pytester.runpytest_inprocess(*mode).ret == 1
    assert not (pytester.path / "dura-evidence").exists()


def test_a_forgotten_marker_leaves_no_earlier_pass_behind(project):
    project.run("corridor/free")
    assert project.evidence().gate.exit_code == 0
    project.write("test_it.py", "def test_it(episode): pass")
    assert project.run().ret == 1
    assert project.evidence().gate.exit_code == 1


def test_no_temporary_file_is_left(reference):
    folder = reference("plain").path / "dura-evidence"
    assert (folder / "evidence.json").exists()
    assert [file.name for file in folder.rglob("*") if file.name.startswith((".", "tmp"))] == []


def test_there_is_no_nan_in_the_record(project):
    project.write(
        "conftest.py",
        "import pytest\n"
        "@pytest.fixture(scope='session')\n"
        "def dura_metrics(): return {'never': lambda episode: float('nan')}\n",
    )
    project.run("corridor/tight")
    text = (project.path / "dura-evidence/evidence.json").read_text()
    json.loads(text, parse_constant=pytest.fail)
    assert project.evidence().episodes[0].metrics.user == {"never": None}


def test_metrics_of_the_users_own(project):
    project.write(
        "conftest.py",
        "import pytest\n"
        "@pytest.fixture(scope='session')\n"
        "def dura_metrics(): return {'farthest': lambda episode: episode.signals['x'].max()}\n",
    )
    result = project.run("corridor/tight", "-n", "2")
    result.assert_outcomes(passed=1)
    (case,) = project.evidence().cases
    (measured,) = case.metrics.user.items()
    name, figure = measured
    assert (name, figure.mean, figure.runs) == ("farthest", pytest.approx(1.0), 2)
    header, row = [line for line in result.outlines if line.startswith(("case ", "corridor/tight "))
                   and "%" not in line.partition("flag")[0]][-2:]  # fmt: skip
    assert header.split()[-1] == "farthest"
    assert row.split()[-1] == "1"


def test_items_that_never_ran_are_undecided(project):
    text = (project.path / "scenarios/corridor/tight.yaml").read_text()
    (project.path / "scenarios/corridor/a.yaml").write_text(
        text.replace("corridor/tight", "corridor/a").replace("Careful", "Reckless")
    )
    result = project.scenarios("-x")
    assert result.ret == 1
    evidence = project.evidence()
    assert evidence.status == "interrupted"
    words = {(one.case, one.requirement): one for one in evidence.verdicts}
    assert words["corridor/a", "GAP-1"].verdict == "violated"
    never = words["corridor/tight", "GAP-1"]
    assert (never.verdict, never.planned, never.run) == ("undecided", 2, 0)
    assert "0 of 2 planned episodes" in never.reason
    assert never.component == "Careful"
    assert {case.id for case in evidence.cases} >= {"corridor/a", "corridor/tight"}


def test_a_worker_that_dies_leaves_its_campaign_undecided(project):
    text = (project.path / "scenarios/corridor/tight.yaml").read_text()
    (project.path / "scenarios/corridor/deadly.yaml").write_text(
        text.replace("corridor/tight", "corridor/deadly").replace("wall: 4.0", "dies: true")
    )
    result = project.scenarios("-n", "2")
    assert result.ret == 1
    words = project.verdicts()
    assert words["corridor/deadly", "GAP-1"] == "undecided"
    assert words["corridor/free", "GAP-1"] == "supported"
    assert words["corridor/tight", "GAP-1"] == "supported"
    assert "undecided: safety on corridor/deadly (Careful)" in result.stdout.str()


def test_a_skipped_item_is_undecided_and_waived(project):
    project.write(
        "conftest.py",
        "import pytest\n"
        "def pytest_collection_modifyitems(items):\n"
        "    items[0].add_marker(pytest.mark.skip(reason='no time'))\n",
    )
    project.run("corridor/tight").assert_outcomes(skipped=1)
    (verdict,) = project.evidence().verdicts
    assert verdict.verdict == "undecided"
    assert verdict.waiver == Waiver("skip", "Skipped: no time")


@pytest.mark.parametrize("mode", [[], ["-n", "2"]], ids=["plain", "n2"])
def test_a_killed_session_does_not_read_as_a_pass(project, mode):
    project.scenarios()
    assert project.evidence().status == "complete"
    project.write(
        "slow.py",
        "import time\n"
        "from corridor import Careful\n"
        "class Slow(Careful):\n"
        "    def propose(self, view):\n"
        "        time.sleep(0.3)\n"
        "        return super().propose(view)\n",
    )
    process = subprocess.Popen(
        [sys.executable, "-m", "pytest", "corridor/tight", "--dura-generator=slow:Slow", *mode],
        cwd=project.path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60
    while project.evidence().status == "complete" and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    evidence = project.evidence()
    assert evidence.status == "running"
    assert {one["verdict"] for one in evidence.verdicts} <= {"undecided"}


def test_different_digests_of_one_episode_fail_the_session(project):
    for name in ("a", "b"):
        project.write(
            f"test_{name}.py",
            "import pytest\n"
            "@pytest.mark.dura(scenario='corridor/unsteady')\n"
            "@pytest.mark.requirement('OWN-1', text='As it should be.')\n"
            "def test_it(campaign): campaign.require('always (gap >= 0)')\n",
        )
    text = (project.path / "scenarios/corridor/tight.yaml").read_text()
    (project.path / "scenarios/corridor/unsteady.yaml").write_text(
        text.replace("corridor/tight", "corridor/unsteady").replace(":Corridor", ":Unsteady")
    )
    # No process can take over what another one's bare instance did.
    project.write(
        "conftest.py",
        "import corridor\n"
        "import pytest\n"
        "@pytest.fixture(scope='session')\n"
        "def generator(): return corridor.Careful()\n",
    )
    # Plain `each` makes both workers run both tests.
    result = project.run("test_a.py", "test_b.py", "--tx", "2*popen", "--dist", "each")
    assert "infrastructure: nondeterministic: the episode corridor/unsteady#" in result.stdout.str()
    assert result.ret == 1
    assert set(project.verdicts().values()) == {"undecided"}


def test_reruns_keep_every_attempt(project):
    """As pytest-rerunfailures does it, which is no dependency of ours."""
    project.write(
        "conftest.py",
        "import pytest\n"
        "from _pytest.runner import runtestprotocol\n"
        "import corridor\n"
        "@pytest.fixture(scope='session')\n"
        "def dura_metrics(): return {}\n"
        "def pytest_runtest_protocol(item, nextitem):\n"
        "    for outcome in ('rerun', None):\n"
        "        for report in runtestprotocol(item, nextitem=nextitem, log=False):\n"
        "            if outcome and report.when == 'call': report.outcome = outcome\n"
        "            item.ihook.pytest_runtest_logreport(report=report)\n"
        "        item._initrequest()\n"
        "    return True\n"
        "def pytest_report_teststatus(report):\n"
        "    if report.outcome == 'rerun': return 'rerun', 'R', 'RERUN'\n",
    )
    project.run("corridor/tight", "--dura-generator=corridor:Reckless")
    (verdict,) = project.evidence().verdicts
    assert verdict.verdict == "violated"
    assert [attempt.verdict for attempt in verdict.attempts] == ["violated"]
    assert verdict.waiver is None  # it failed each time


def test_the_record_of_an_earlier_session_is_gone_before_the_first_test_runs(project):
    project.scenarios()
    assert project.evidence().status == "complete"
    project.write(
        "test_it.py",
        "import json\n"
        "from pathlib import Path\n"
        "def test_it(orchestrator):\n"
        "    record = json.loads(Path('dura-evidence/evidence.json').read_text())\n"
        "    assert (record['status'], record['verdicts']) == ('running', [])\n",
    )
    project.run("test_it.py", "-p", "no:xdist").assert_outcomes(passed=1)


def test_evidence_that_cannot_be_written_in_the_end_fails_the_session(project):
    project.write(
        "test_it.py",
        "import shutil, pathlib, pytest\n"
        "@pytest.mark.dura(scenario='corridor/tight')\n"
        "@pytest.mark.requirement('GAP-1')\n"
        "def test_it(campaign):\n"
        "    campaign.require()\n"
        "    shutil.rmtree('ev')\n"
        "    pathlib.Path('ev').write_text('')\n",
    )
    result = project.run("test_it.py", "--dura-evidence=ev")
    result.assert_outcomes(passed=1)
    assert result.ret == 1
    text = result.stdout.str() + result.stderr.str()
    assert "the evidence cannot be written: File exists" in text
    assert "Traceback" not in text


def test_a_name_that_is_no_text_is_kept(project):
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/tight', runs=1)\n"
        "@pytest.mark.requirement('OWN-1', text='t')\n"
        "def test_it(campaign):\n"
        "    campaign.require(check)\n"
        "def check(episode):\n"
        "    raise OSError('no file \\udcff')\n",
    )
    result = project.run("test_it.py")
    assert result.ret == 1
    assert "no file \udcff" in project.verdict("OWN-1", "corridor/tight").first_uncounted.detail
