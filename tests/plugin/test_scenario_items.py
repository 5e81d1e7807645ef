from __future__ import annotations

from collections import Counter

import pytest

from pytest_dura.evidence.item_verdicts import Waiver

EXECUTOR = "auto"

HERE = "--dura-executor=in-process"
"""Where episodes are simulated is no question of a test on what is selected or told."""

ITEMS = ["corridor/free::GAP-1", "corridor/free::GO-1", "corridor/tight::GAP-1"]


def collected(result):
    return [line for line in result.outlines if "::" in line and not line.startswith(" ")]


def test_scenarios_run_in_every_mode(project, mode):
    result = project.scenarios("-v", *mode)
    result.assert_outcomes(passed=3)
    assert all(item in result.stdout.str() for item in ITEMS)
    evidence = project.evidence()
    assert evidence.status == "complete"
    assert [one.id for one in evidence.episodes] == [
        "corridor/free#0",
        "corridor/free#1",
        "corridor/free#2",
        "corridor/tight#0",
        "corridor/tight#1",
    ]
    assert set(project.verdicts().values()) == {"supported"}


@pytest.mark.parametrize("mode", ["plain", "n2"])
def test_a_violation_fails_the_gate_in_every_mode(reference, mode):
    session = reference(mode)
    result = session.result
    result.assert_outcomes(passed=1, failed=2)
    assert result.ret == 1
    text = result.stdout.str()
    assert "violated: GAP-1 on corridor/tight (Reckless): 2 of 2 valid episodes" in text
    assert "worst:    corridor/tight#0: gap is 0 where more than 0 is required, first at" in text
    assert "Traceback" not in text
    assert ".py:" not in text.partition("FAILURES")[2]
    assert session.verdicts()["corridor/free", "GO-1"] == "supported"
    assert session.verdicts()["corridor/free", "GAP-1"] == "violated"


def test_collection_is_sorted_and_runs_nothing(project):
    result = project.scenarios("--collect-only", "-q")
    assert collected(result) == ITEMS
    assert not (project.path / "dura-evidence").exists()
    assert result.ret == 0


def test_the_builtin_scenarios_are_there(project):
    result = project.run("--dura-scenarios=builtin", "--collect-only", "-q")
    text = result.stdout.str()
    assert "intersection/ghost-obstacle::SAF-1" in text
    assert "corridor/tight::GAP-1" not in text


def test_an_item_is_selected_by_its_node_id(project):
    result = project.run("corridor/free::GO-1", "-v", HERE, "-n", "2")
    result.assert_outcomes(passed=1)
    assert "corridor/free::GO-1" in result.stdout.str()


def test_items_and_functions_are_selected_together(project):
    project.write("test_plain.py", "def test_one(): pass\ndef test_two(): pass\n")
    result = project.run("corridor/free::GO-1", "test_plain.py::test_two", "-v", HERE)
    result.assert_outcomes(passed=2)


def test_a_case_with_other_faults_is_selected_by_its_id(project):
    result = project.run("intersection/ghost-obstacle+none::SAF-1", "--collect-only", "-q")
    assert collected(result) == ["intersection/ghost-obstacle+none::SAF-1"]


def test_an_item_is_selected_from_a_folder_below(project, monkeypatch):
    (project.path / "below").mkdir()
    monkeypatch.chdir(project.path / "below")
    result = project.run("../corridor/free::GO-1", "--rootdir=..", "-c", "../pytest.ini", HERE)
    result.assert_outcomes(passed=1)


def test_a_requirement_that_the_case_does_not_have(project):
    result = project.run("corridor/free::GAP-9")
    assert result.ret == 4
    result.stderr.fnmatch_lines(
        [
            "ERROR: the case 'corridor/free' has no requirement 'GAP-9'",
            "  expected: one of GAP-1, GO-1",
            "  remedy:   did you mean 'GAP-1'?",
        ]
    )


def test_a_path_that_does_not_exist_is_pytests_to_tell(project):
    result = project.run("corridor/fre")
    assert result.ret == 4
    assert "file or directory not found: corridor/fre" in result.stderr.str()


def test_a_path_that_does_not_exist_beside_a_broken_scenario(project):
    project.write("scenarios/broken.yaml", "name: [")
    result = project.run("tsets")
    assert result.ret == 4
    result.stderr.fnmatch_lines(
        ["ERROR: file or directory not found: tsets", "*cannot be read*", "*broken.yaml:1*"]
    )


def test_select_by_keyword(project):
    project.scenarios("-k", "tight", HERE).assert_outcomes(passed=1, deselected=2)
    for chosen, found in (("-k", "GAP-1"), ITEMS[::2]), (("-m", "requirement"), ITEMS):
        assert collected(project.scenarios(*chosen, "--collect-only", "-q")) == found


def test_the_flag_alone_runs_scenarios_only_and_adds_them_to_paths(project):
    project.write("tests/test_plain.py", "def test_one(): pass\n")
    assert collected(project.scenarios("--collect-only", "-q")) == ITEMS
    project.scenarios("tests", HERE).assert_outcomes(passed=4)


def test_without_the_flag_nothing_changes(project):
    project.write("test_plain.py", "def test_one(): pass\n")
    result = project.run()
    result.assert_outcomes(passed=1)
    assert "dura:" not in result.stdout.str()
    assert not (project.path / "dura-evidence").exists()


def test_last_failed_reruns_a_scenario_item_beside_a_function(project):
    project.write("test_plain.py", "def test_good(): pass\ndef test_bad(): assert False\n")
    first = project.scenarios(".", "--dura-generator=corridor:Reckless", HERE)
    first.assert_outcomes(passed=2, failed=3)
    again = project.scenarios(".", "--dura-generator=corridor:Reckless", "--lf", "-v", HERE)
    again.assert_outcomes(failed=3, deselected=1)
    assert "test_good" not in again.stdout.str()


def simulated_once(project):
    """Whether each episode was simulated once, beside the repetition that each case records."""
    evidence = project.evidence()
    lines = {one.id: f"{one.case} {one.seed}" for one in evidence.episodes}
    repeated = [lines[case.repeat.episode] for case in evidence.cases]
    assert (len(lines), len(repeated)) == (5, 2)
    simulated = (project.path / "log").read_text().splitlines()
    return Counter(simulated) == Counter([*lines.values(), *repeated])


def test_an_episode_is_simulated_once_however_many_items_look_at_it(project, monkeypatch):
    monkeypatch.setenv("CORRIDOR_LOG", str(project.path / "log"))
    project.scenarios("--dura-executor=processes:1")  # of several, a new one begins by another one
    assert simulated_once(project)


def test_workers_share_cases_so_that_each_is_simulated_once(project, monkeypatch):
    monkeypatch.setenv("CORRIDOR_LOG", str(project.path / "log"))
    project.scenarios("-n", "2")
    assert simulated_once(project)


def test_runs_are_replaced_and_it_is_said(project):
    result = project.scenarios("--dura-runs=1", HERE)
    assert "dura: --dura-runs=1 replaces the planned number of runs" in result.stdout.str()
    evidence = project.evidence()
    assert len(evidence.episodes) == 2
    assert {case.runs_override for case in evidence.cases} == {1}
    assert {verdict.planned for verdict in evidence.verdicts} == {1}


def test_the_seed_changes_the_runs(project):
    project.scenarios("--dura-seed=1", HERE)
    first = project.evidence()
    project.scenarios("--dura-seed=2", HERE)
    second = project.evidence()
    assert (first.base_seed, second.base_seed) == (1, 2)
    assert first.episodes[0].seed != second.episodes[0].seed
    assert first.episodes[0].digest != second.episodes[0].digest


def test_autouse_fixtures_of_the_root_conftest_apply(project):
    project.write(
        "conftest.py",
        "import pytest\n"
        "@pytest.fixture(autouse=True)\n"
        "def note(request): print('noted', request.node.name)\n",
    )
    result = project.scenarios("-s", HERE)
    assert "noted GAP-1" in result.stdout.str()


def test_xfail_is_a_waiver(project):
    project.write(
        "conftest.py",
        "import pytest\n"
        "def pytest_collection_modifyitems(items):\n"
        "    for item in items:\n"
        "        if item.nodeid == 'corridor/tight::GAP-1':\n"
        "            item.add_marker(pytest.mark.xfail(reason='ticket 7'))\n",
    )
    result = project.run("corridor/tight", "--dura-generator=corridor:Reckless", HERE, "-n", "2")
    result.assert_outcomes(xfailed=1)
    assert result.ret == 0
    (verdict,) = project.evidence().verdicts
    assert verdict.verdict == "violated"
    assert verdict.waiver == Waiver("xfail", "ticket 7")
    assert "[xfail]" in result.stdout.str()


def test_a_scenario_that_nothing_would_judge_is_no_gate(project):
    free = (project.path / "scenarios" / "corridor" / "free.yaml").read_text(encoding="utf-8")
    head = free.partition("requirements:")[0].replace("corridor/free", "corridor/unjudged")
    project.write("scenarios/corridor/unjudged.yaml", head)
    result = project.scenarios("-q")
    assert result.ret == 4
    told = result.stderr.str() + result.stdout.str()
    assert "'corridor/unjudged' has no requirements, so nothing would judge it" in told
    assert "unjudged.yaml" in told
    assert "--dura-select" in told
    assert "Traceback" not in told
