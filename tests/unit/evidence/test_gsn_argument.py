"""The generated argument: what is claimed, what is refuted, and what is left open."""

import json
from dataclasses import replace

import pytest
import yaml
from session_records import REQUIREMENTS, episode, session_record, verdict
from stated_counts import dead_references, elements_of, stated_counts

from pytest_dura.core.codec import encode
from pytest_dura.reports import generated_argument, root_ids, rule_problems
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
    assert found["GTop"]["text"].startswith("Within the tested cells of the operational domain C")
    assert "unreviewed" in found["CReview"]["text"]
    assert [found["CReview"][key] for key in ("reviewer", "reviewDate", "opinion")] == [""] * 3
    assert {"CReview", "CDomain", "CVersions", "ASimulator"} <= set(found["GTop"]["inContextOf"])


def test_a_violation_defeats_its_goal_its_requirement_and_the_top():
    found = elements(session_record())
    goal = by_alias(found, "verdict:SAF-1@a/clear+ghost")
    against = by_alias(found, "challenge:SAF-1@a/clear+ghost")
    counterexample = found[against["supportedBy"][0]]
    assert goal["defeated"]
    assert found[against["challenges"]] == goal
    assert counterexample["replay"] == "pytest --dura-replay='a/clear+ghost#1'"
    assert counterexample["text"] == (
        "Episode a/clear+ghost#1 violates it at t = 0.90 s, margin -0.5, seed 1001."
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


def test_monitors_are_known_only_from_violations_that_they_could_miss():
    record = session_record()
    quiet = replace(record.head.monitors[0], monitor="quiet", true_positives=0)
    found = elements(session_record(monitors=[*record.head.monitors, quiet]))
    known = by_alias(found, "monitor:security_assessor:SAF-1")
    unknown = by_alias(found, "monitor:quiet:SAF-1")
    assert "flagged 1 of 1 episodes with a violation" in known["text"]
    assert unknown["undeveloped"]
    assert "no violation" in unknown["text"]


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
