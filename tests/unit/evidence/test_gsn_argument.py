"""The generated argument: what is claimed, what is refuted, and what is left open."""

import json
from dataclasses import replace

import pytest
import yaml
from gsn_rules import rule_problems
from session_records import REQUIREMENTS, episode, session_record, verdict
from stated_counts import dead_references, elements_of, stated_counts

from pytest_dura.core.codec import encode
from pytest_dura.reports import generated_argument, root_ids
from pytest_dura.reports.gsn import svg_file, yaml_file

WAIVER = {"kind": "xfail", "reason": "known"}


def elements(record):
    return elements_of(yaml_file.render(record))


def by_alias(found, alias):
    return next(one for one in found.values() if one.get("alias") == alias)


def test_the_file_is_yaml_that_keeps_the_rules():
    text = yaml_file.render(session_record())
    data = yaml.safe_load(text)
    assert data.pop("module")["name"] == "assurance-case"
    assert rule_problems(data) == []
    assert root_ids(data) == ["GTop"]
    told = {id_: one.to_yaml() for id_, one in generated_argument(session_record()).items()}
    assert data == json.loads(json.dumps(told))


def test_the_top_claim_is_bounded_to_what_was_tested_and_reviewed_by_nobody():
    found = elements(session_record())
    assert found["GTop"]["text"].startswith(
        "In the scenarios and under the faults that were tested, C with recovery policy recover "
    )
    assert "unreviewed" in found["CReview"]["text"]
    assert [found["CReview"][key] for key in ("reviewer", "reviewDate", "opinion")] == [""] * 3
    assert {"CReview", "CDomain", "CVersions", "ASampling"} <= set(found["GTop"]["inContextOf"])


def test_a_violation_defeats_its_goal_its_requirement_and_the_top():
    found = elements(session_record())
    goal = by_alias(found, "verdict:SAF-1@a/clear+ghost")
    against = by_alias(found, "challenge:SAF-1@a/clear+ghost")
    counterexample = found[against["supportedBy"][0]]
    assert goal["defeated"]
    assert found[against["challenges"]] == goal
    assert counterexample["replay"] == "pytest --dura-replay='a/clear+ghost#1'"
    assert counterexample["text"] == (
        "Episode a/clear+ghost#1 in evidence.json violates it at t = 0.90 s, margin -0.5, "
        "seed 1001."
    )
    assert found["G-SAF-1"]["defeated"]
    assert found["GTop"]["defeated"]
    assert "CG-SAF-1" in found["CGTop"]["supportedBy"]


def test_a_waiver_keeps_the_doubt_and_does_not_make_the_claim_true():
    waived = verdict("PERF-1", "a/clear", ("violated", "satisfied"), waiver=WAIVER)
    found = elements(session_record(verdicts=[waived]))
    goal = by_alias(found, "verdict:PERF-1@a/clear")
    assert goal["defeated"]
    assert "known" in found[goal["inContextOf"][0]]["text"]
    for id_ in ("G-PERF-1", "GTop"):
        assert "defeated" not in found[id_]
        assert any(one.get("challenges") == id_ for one in found.values())


def test_undecided_verdicts_and_untested_cells_are_undeveloped():
    found = elements(session_record())
    undecided = by_alias(found, "verdict:SEC-1@a/clear+ghost")
    untested = by_alias(found, "untested:PERF-1@a/clear+ghost")
    assert undecided["undeveloped"]
    assert "supportedBy" not in undecided
    assert "only 2 of 4 planned episodes" in undecided["text"]
    assert untested["undeveloped"]


def test_a_violation_within_the_bound_challenges_and_does_not_defeat():
    words = ("violated", *["satisfied"] * 19)
    found = elements(session_record(verdicts=[verdict("SEC-1", "a/clear+ghost", words)]))
    goal = by_alias(found, "verdict:SEC-1@a/clear+ghost")
    against = by_alias(found, "challenge:SEC-1@a/clear+ghost")
    assert "defeated" not in goal
    assert "as many as the bound allows" in against["text"]
    assert "CGTop" not in found


def test_a_solution_refers_to_its_evidence_with_n_violations_and_bound():
    record = session_record()
    found = elements(record)
    goal = by_alias(found, "verdict:SAF-1@a/clear")
    solution = found[goal["supportedBy"][0]]
    assert solution["url"] == "evidence.json#/verdicts/1"
    assert solution["report"].startswith("report.html#verdict-SAF-1-")
    assert "n = 2 valid episodes of 2 run, 2 planned; violations: 0" in solution["text"]
    assert "at most 77.64 % with confidence 95 % (Clopper-Pearson" in solution["text"]
    assert dead_references(yaml_file.render(record), record) == []


def test_references_that_lead_nowhere_are_found():
    record = session_record()
    shorter = replace(record, head=record.head.replace(verdicts=record.head.verdicts[:1]))
    told = dead_references(yaml_file.render(record), shorter)
    assert any("evidence.json#/verdicts/3" in one for one in told)
    assert not any("evidence.json#/verdicts/0," in one for one in told)


def test_a_trace_that_is_not_there_is_found(tmp_path):
    trace = {"file": "episodes/x.mcap", "sha256": "0" * 64, "bytes": 1, "kept_for": "violation"}
    runs = [episode("a/clear+ghost", 1, trace=trace)]
    record = session_record(tmp_path, episodes=runs)
    told = dead_references(yaml_file.render(record), record)
    assert len(told) == 1
    assert "episodes/x.mcap" in told[0]


@pytest.mark.parametrize("gate", ["incomplete", "failed"])
def test_an_incomplete_session_claims_nothing(gate):
    changes = {
        "status": "interrupted",
        "gate": {"result": gate, "exit_code": 1, "reasons": ["the session was killed"]},
    }
    record = session_record(**changes)
    found = elements(record)
    assert root_ids(found) == ["GIncomplete"]
    assert found["GIncomplete"]["text"].startswith("INCOMPLETE SESSION")
    assert found["GTop"]["undeveloped"]
    assert "supportedBy" not in found["GTop"]
    assert "INCOMPLETE SESSION" in svg_file.render(record)
    assert stated_counts(yaml_file, yaml_file.render(record)) == record.head.totals.to_json()


def monitor_goal(*rows):
    """The goal on a monitor of these counts: hits, misses, false alarms, quiet runs."""
    (listed,) = session_record().head.monitors
    keys = ("true_positives", "false_negatives", "false_positives", "true_negatives")
    made = [replace(listed, **dict(zip(keys, row, strict=True))) for row in rows]
    found = elements(session_record(monitors=made))
    return by_alias(found, "monitor:security_assessor:SAF-1"), found


def test_a_monitor_that_warns_is_supported_with_bound_and_confidence():
    goal, found = monitor_goal((7, 0, 1, 9), (2, 0, 0, 10))
    assert goal["text"].endswith("warned of at least 71.69 % of these, with 95 % confidence.")
    (solution,) = goal["supportedBy"]
    assert "warned of 9 of 9; alarms in 1 of 20 runs without; 2 cases" in found[solution]["text"]
    assert "defeated" not in found["GMonitors"]


@pytest.mark.parametrize("counts", [(0, 9, 0, 0), (0, 9, 5, 5), (9, 0, 8, 0), (3, 6, 6, 3)])
def test_a_monitor_that_tells_nothing_defeats_its_goal(counts):
    """It warned of none, or raises alarms as often where there is nothing to warn of."""
    goal, found = monitor_goal(counts)
    assert goal["defeated"]
    assert found["GMonitors"]["defeated"]
    assert found["CGMonitors"]["challenges"] == "GMonitors"
    # No verdict rests on monitors, so that the claim on the component stands as it did.
    assert found["GTop"].get("defeated") == elements(session_record())["GTop"].get("defeated")


@pytest.mark.parametrize(
    "counts, why",
    [
        ((9, 0, 0, 0), "without a run that has nothing to warn of, precision says nothing"),
        ((0, 0, 3, 6), "nothing happened that it could have missed"),
        ((1, 0, 0, 1), "these are too few runs"),
    ],
)
def test_what_is_not_known_of_a_monitor_is_undeveloped(counts, why):
    goal, found = monitor_goal(counts)
    assert goal["undeveloped"]
    assert why in goal["text"]
    assert "defeated" not in found["GMonitors"]


def test_the_top_goal_and_its_strategy_speak_of_the_same_requirements():
    found = elements(session_record())
    what = "safety, security and performance requirements"
    assert found["GTop"]["text"].endswith(f"meets its {what}.")
    assert found["SKinds"]["text"] == f"Argument over the {what}, kind by kind."
    assert found["SKinds"]["supportedBy"] == ["GSafety", "GSecurity", "GPerformance"]


def test_goals_of_verdicts_are_propositions_with_bound_and_confidence():
    found = elements(session_record())
    supported, violated, undecided = (
        by_alias(found, f"verdict:{alias}")["text"]
        for alias in ("SAF-1@a/clear", "SAF-1@a/clear+ghost", "SEC-1@a/clear+ghost")
    )
    about = REQUIREMENTS["SAF-1"].text
    assert supported == (
        f"SAF-1 in a/clear without faults: {about} Violated in at most 77.64 % of such runs, with "
        "95 % confidence."
    )
    assert violated == f"SAF-1 in a/clear under ghost: {about} Violated in none of such runs."
    assert "in at most 40 % of such runs, with 95 % confidence. Undecided: only" in undecided


def test_contexts_name_component_recovery_scenarios_and_seeds():
    found = elements(session_record())
    component = found["CComponent"]["text"]
    assert "Component under test: C, from m:G, version 1.2, SHA-256 22ee" in component
    assert "Recovery policy: recover. Recovery planner: " in found["CRecovery"]["text"]
    assert "Recovery acted in 0 of 6 judged runs" in found["CRecovery"]["text"]
    assert "Scenarios: a/clear. Faults: ghost." in found["CDomain"]["text"]
    assert "6 episodes with seeds from 1000 to 1003" in found["CSeeds"]["text"]
    assert "C-scenario:a/clear" in found


def test_what_no_session_shows_is_undeveloped():
    head = session_record().head
    component = head.component_under_test

    def with_git(commit, *, dirty):
        git = head.environment.git.replace(commit=commit, dirty=dirty)
        return head.environment.replace(git=git)

    for changes, more in (
        ({}, set()),
        ({"environment": with_git(None, dirty=False)}, {"GCommit"}),
        ({"environment": with_git("c0" * 20, dirty=True)}, {"GCommit"}),
        ({"component_under_test": component.replace(opaque=True)}, {"GComponent"}),
    ):
        found = elements(session_record(**changes))
        assert {*found["SBasis"]["supportedBy"]} == {"GSimulator", "GTool"} | more
        assert all(found[id_]["undeveloped"] for id_ in found["SBasis"]["supportedBy"])
        assert "SBasis" in found["GTop"]["supportedBy"]


def test_ids_are_readable_and_the_same_in_another_session():
    found = elements(session_record())
    other = elements(session_record(verdicts=[verdict("SAF-1", "a/clear+ghost", ["satisfied"])]))
    assert {
        "G-SAF-1",
        "G-SAF-1@a/clear+ghost",
        "Sn-SAF-1@a/clear+ghost",
    } <= found.keys() & other.keys()
    assert "G-untested:PERF-1@a/clear+ghost" in found
    assert not any("=" in id_ for id_ in found)


def test_a_session_without_anything_has_an_argument_too():
    nothing = session_record(
        requirements=[], cases=[], episodes=[], verdicts=[], monitors=[],
        component_under_test={"name": None, "version": None},
        coverage={"cells": [], "left_out": 0, "parameters": []},
    )  # fmt: skip
    text = yaml_file.render(nothing)
    assert elements_of(text)["SKinds"]["undeveloped"]
    for one in (yaml_file, svg_file):
        assert stated_counts(one, one.render(nothing)) == nothing.head.totals.to_json()


def test_the_policy_is_that_of_the_judged_cases_and_not_of_their_comparison():
    record = session_record()
    alone = episode("a/clear~recovery_planner", 0)
    alone["spec"]["policy"] = "log_only"
    found = elements(session_record(episodes=[*record.episodes(), alone]))
    assert "with recovery policy recover meets" in found["GTop"]["text"]
    assert "log_only" not in found["CComponent"]["text"]


def test_twin_verdicts_and_several_components_are_told_apart():
    one = verdict("SAF-1", "a/clear", ("satisfied",))
    record = session_record(verdicts=[one, one, {**one, "component": "D"}])
    found = elements(record)
    aliases = [node["alias"] for node in found.values() if "verdict:" in node.get("alias", "")]
    assert sorted(aliases) == [
        "verdict:SAF-1@a/clear [C]", "verdict:SAF-1@a/clear [C] (2)", "verdict:SAF-1@a/clear [D]"
    ]  # fmt: skip
    assert stated_counts(yaml_file, yaml_file.render(record)) == record.head.totals.to_json()


def test_a_verdict_on_an_unlisted_requirement_is_refused():
    with pytest.raises(ValueError, match="PERF-1, which is not listed"):
        generated_argument(session_record(requirements=[]))


def test_what_looks_like_a_number_to_yaml_1_2_is_quoted():
    given = {**encode(REQUIREMENTS["SAF-1"]), "source": "1e3"}
    record = session_record(
        requirements=[given], verdicts=[], coverage={"cells": [], "left_out": 0, "parameters": []}
    )
    assert '\n  source: "1e3"\n' in yaml_file.render(record)


def test_a_parameter_with_choices_names_them():
    found = session_record().head.coverage
    choices = [{"value": "left", "count": 2}, {"value": "right", "count": 0}]
    (spread,) = found.parameters
    chosen = spread.replace(parameter="world.turn", low=None, high=None, choices=choices)
    record = session_record(
        coverage=found.replace(parameters=[spread, chosen.replace(covered=0.5)])
    )
    text = by_alias(elements(record), "scenario:a/clear")["text"]
    assert "world.wall in [2, 6], 6 drawn, 40 % of its tenths reached" in text
    assert "world.turn one of left, right; 6 drawn, 50 % of the choices reached" in text
