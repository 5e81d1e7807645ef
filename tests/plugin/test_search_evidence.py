"""Searches of a session: told apart from its verdicts, and no way past the gate."""

from __future__ import annotations

import re
import textwrap
from dataclasses import replace

import pytest

from pytest_dura.core import ConfigurationError
from pytest_dura.evidence import merge_bundles, open_record, verify_bundle
from pytest_dura.evidence.item_verdicts import Waiver
from pytest_dura.evidence.parts import Part, check_alike

SEARCHED = """
name: corridor/searched
simulator: corridor:Corridor
duration: 2.0
runs: 3
world: {wall: 10.0}
variation: {world.wall: {min: 0.5, max: 11.0}}
roles: {generator: "corridor:Reckless"}
requirements: [GAP-1, GO-1]
"""
REAL = """
import pytest

@pytest.mark.dura(scenario="corridor/searched")
@pytest.mark.requirement("GAP-1")
def test_found(campaign):
    campaign.falsify(budget=20)

@pytest.mark.dura(scenario="corridor/searched")
def test_nothing(campaign):
    found = campaign.falsify("always (gap > -1)", budget=20)
    assert found.outcomes[0].status == "nothing found"

@pytest.mark.dura(scenario="corridor/tight")
@pytest.mark.requirement("GAP-1")
def test_campaign(campaign):
    campaign.require()
"""
HANDMADE = """
import pytest
from pytest_dura.campaign import SearchEnded
from searches import falsification

{mark}
@pytest.mark.dura(scenario="corridor/tight")
def test_it(campaign):
    case = campaign.case
    made = falsification({words}, case=case.id, component=campaign.component)
    campaign.runner.events.emit(SearchEnded(case, made))
    {then}
"""


def handmade(project, *words, mark="", then="", options=()):
    told = ", ".join(map(repr, words))
    project.write("test_it.py", HANDMADE.format(words=told, mark=mark, then=then))
    return project.run("test_it.py", *options)


def bundle(project, folder="dura-evidence"):
    return verify_bundle(project.path / folder).problems


@pytest.fixture
def searched(project):
    project.write("scenarios/corridor/searched.yaml", SEARCHED)
    project.write("test_search.py", REAL)
    return project


def words(evidence):
    return {
        (one.item.partition("[")[0], outcome.requirement): outcome.status
        for one in evidence.searches
        for outcome in one.outcomes
    }


FOUND = {
    ("test_search.py::test_found", "GAP-1"): "falsified",
    ("test_search.py::test_nothing", "always (gap > -1)"): "nothing found",
}


def test_a_search_leaves_a_record_that_verifies_and_counts_in_no_verdict(searched):
    result = searched.run("test_search.py")
    result.assert_outcomes(failed=1, passed=2)
    evidence = searched.evidence()
    assert words(evidence) == FOUND
    assert [(one.case, one.verdict) for one in evidence.verdicts] == [
        ("corridor/tight", "supported")
    ]
    assert {one.case for one in evidence.episodes} == {"corridor/tight"}
    assert [one.id for one in evidence.cases] == ["corridor/tight"]
    assert "@" not in str([evidence.episodes, evidence.cases, evidence.verdicts])
    found = next(one for one in evidence.searches if "test_found" in one.item)
    assert found.scenario == "corridor/searched"
    assert found.roles["generator"] == "corridor:Reckless"
    assert evidence.gate.reasons == (
        "GAP-1 on corridor/searched is falsified by a search", "1 test item failed",
    )  # fmt: skip
    hashed = {(one.kind, one.path) for one in evidence.inputs}
    assert ("scenario", "scenarios/corridor/searched.yaml") in hashed
    assert str(searched.path) not in str(evidence.searches)
    assert bundle(searched) == []
    shown = result.stdout.str().partition("= dura =")[2]
    assert "falsified: GAP-1 on corridor/searched (Reckless) (1 of 1 cause)" in shown
    assert "  GAP-1 violated at simulation" in shown
    assert "random seeds" in shown
    rerun = re.search(r"kept: .*\n.*\n  rerun:    pytest (\S+)\n", shown)
    again = searched.run(rerun.group(1))
    again.assert_outcomes(failed=1)
    (verdict,) = searched.evidence().verdicts
    assert (verdict.requirement, verdict.verdict) == ("GAP-1", "violated")


def test_a_search_beside_a_test_of_fewer_runs_of_its_case_verifies(project):
    """A search runs no episode of the case, and so plans none of those that the test asks for."""
    tests = """
        import pytest

        @pytest.mark.dura(scenario="corridor/free")
        @pytest.mark.requirement("GAP-1")
        def test_search(campaign):
            campaign.falsify(budget=3)

        @pytest.mark.dura(scenario="corridor/free", runs=1)
        @pytest.mark.requirement("GAP-1")
        def test_one(episode):
            assert episode.signal("gap").min() > 0
    """
    project.write("test_it.py", textwrap.dedent(tests))
    project.run("test_it.py").assert_outcomes(passed=2)
    (case,) = project.evidence().cases
    assert (case.id, case.planned) == ("corridor/free", 1)
    assert bundle(project) == []


def told(project, folder="dura-evidence"):
    searches = project.evidence(folder).to_json(include={"searches"})["searches"]
    for one in searches:
        for outcome in one["outcomes"]:
            if outcome["counterexample"]:
                outcome["counterexample"].update(file=None, name=None)  # a new one each time
    return searches


def test_merged_shards_have_the_searches_of_the_whole(searched):
    searched.run("test_search.py")
    plain = told(searched)
    for index in (1, 2):
        searched.run("test_search.py", f"--dura-shard={index}/2", f"--dura-evidence=part{index}")
    parts = [searched.path / "part1", searched.path / "part2"]
    merged = merge_bundles(parts, searched.path / "whole")
    assert told(searched, "whole") == plain
    assert "GAP-1 on corridor/searched is falsified by a search" in merged.gate.reasons
    assert bundle(searched, "whole") == []


def test_a_search_that_two_parts_made_counts_once_and_may_not_differ(project):
    project.write("test_it.py", HANDMADE.format(words="'nothing found'", mark="", then=""))
    project.run("test_it.py", "--dura-evidence=one")
    project.run("test_it.py", "--dura-evidence=two")
    merge_bundles([project.path / "one", project.path / "two"], project.path / "whole")
    assert told(project, "whole") == told(project, "one")
    parts = [Part(open_record(project.path / name / "evidence.json"), name)
             for name in ("one", "two")]  # fmt: skip
    (search,) = parts[0].head.searches
    other = replace(search, budget=search.budget + 1)
    parts[1] = Part(parts[1].record.changed(searches=[other]), "two")
    with pytest.raises(ConfigurationError, match="parts were not made alike"):
        check_alike(parts)


SWALLOWED = "the gate fails: SAF-1 on corridor/tight is falsified by a search, though every"


def test_a_test_that_passes_all_the_same_does_not_make_the_gate_pass(project):
    result = handmade(project, "falsified")
    result.assert_outcomes(passed=1)
    assert result.ret == 1
    assert SWALLOWED in result.stdout.str()
    assert project.evidence().gate.result == "failed"


@pytest.mark.parametrize("word", ["undecided", "not repeatable"])
def test_no_option_excuses_a_search_that_is_undecided_or_not_repeatable(project, word):
    assert handmade(project, word, options=["--dura-undecided=warn"]).ret == 1


def test_an_expected_failure_waives_what_its_search_found(project):
    mark = 'pytestmark = pytest.mark.xfail(reason="ticket 7")'
    result = handmade(project, "falsified", mark=mark, then="pytest.fail('found')")
    result.assert_outcomes(xfailed=1)
    assert result.ret == 0
    (found,) = project.evidence().searches
    assert found.waiver == Waiver("xfail", "ticket 7")
    assert "corridor/tight (Careful) [xfail]" in result.stdout.str()


def test_a_skip_in_the_middle_waives_nothing(project):
    result = handmade(project, "falsified", then="pytest.skip('not today')")
    result.assert_outcomes(skipped=1)
    assert result.ret == 1


def test_a_session_of_searches_alone_supports_nothing(project):
    result = handmade(project, "nothing found")
    result.assert_outcomes(passed=1)
    shown = result.stdout.str().partition("= dura =")[2]
    assert "gate: passed, no verdict; searches: 1 nothing found" in shown
    shown = " ".join(shown.split())
    assert "search: SAF-1 on corridor/tight (Careful): nothing found in 37 simulations: " in shown
    assert not re.search(r"supported|\bsafe\b|holds|verified", shown)


def test_who_looked_is_a_table_with_v_and_all_fits_into_the_columns(project):
    result = handmade(project, "falsified", "nothing found", options=["-v"])
    shown = result.stdout.str().partition("= dura =")[2].partition("evidence:")[0]
    assert "trivial, each by itself:" in shown
    assert max(map(len, shown.splitlines())) <= 100


def test_quiet_sessions_show_searches_as_they_show_verdicts(project):
    assert "falsified: SAF-1" in handmade(project, "falsified", options=["-q"]).stdout.str()


def test_what_workers_tell_is_the_same_and_holds_no_secret(project, monkeypatch):
    monkeypatch.setenv("SERVICE_TOKEN", "correct-horse-battery-staple")
    secret = "detail='token correct-horse-battery-staple'"
    made = f"outcomes=[outcome('falsified', counterexample=counterexample({secret}))]"
    text = HANDMADE.format(words=made, mark="", then="")
    project.write("test_it.py", text.replace("import falsification", "import *"))
    project.run("test_it.py")
    plain = told(project)
    result = project.run("test_it.py", "-n", "1")
    assert told(project) == plain
    assert "[redacted: SERVICE_TOKEN]" in str(plain)
    assert "correct-horse" not in result.stdout.str()
    for file in (project.path / "dura-evidence").rglob("*"):
        assert file.is_dir() or b"correct-horse" not in file.read_bytes()
