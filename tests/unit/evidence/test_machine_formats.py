"""What the machine formats say of a session, and that they notice when they were changed."""

import json
import re

import pytest
from session_records import session_record, verdict
from stated_counts import stated_counts

from pytest_dura.evidence import write_record
from pytest_dura.reports import cyclonedx, intoto, summary

PASSED = {"result": "passed", "exit_code": 0, "reasons": []}
SUPPORTED = verdict("SAF-1", "a/clear", ("satisfied",) * 3)
VIOLATED = verdict("SAF-1", "a/clear", ("violated",) * 3)
UNDECIDED = verdict("SAF-1", "a/clear", ("satisfied",), planned=9)
WAIVED = VIOLATED | {"waiver": {"kind": "xfail", "reason": "known"}}


def searched(word):
    """A search, as far as a declaration reads it."""
    outcome = {"requirement": "SAF-1", "status": word}
    return {"case": "a/clear", "waiver": None, "baselines": [], "outcomes": [outcome]}


def statement(tmp_path, **changes):
    record = session_record(tmp_path, **changes)
    write_record(tmp_path, record)
    return intoto.render(record), record


def predicate(tmp_path, **changes):
    return json.loads(statement(tmp_path, **changes)[0])["predicate"]


def declared(**changes):
    return json.loads(cyclonedx.render(session_record(**changes)))


# -- CycloneDX --------------------------------------------------------------------------------


def test_a_violated_verdict_is_a_counter_claim_that_rests_on_its_counterexamples():
    found = declared()["declarations"]
    entry = found["attestations"][0]["map"][1]
    claim = next(one for one in found["claims"] if one["bom-ref"] in entry["counterClaims"])
    assert claim["predicate"].startswith("The evidence refutes that SAF-1 holds on a/clear+ghost")
    entries = {one["bom-ref"]: one for one in found["evidence"]}
    assert [one["url"] for ref in claim["evidence"] for data in entries[ref]["data"]
            for one in [data["contents"]]] == [
        "evidence.json#/verdicts/2", "evidence.json#/episodes/3",
    ]  # fmt: skip
    assert "counterEvidence" not in claim


def test_a_counterexample_speaks_against_a_claim_that_is_supported_all_the_same():
    one = verdict("SEC-1", "a/clear", ("satisfied",) * 30 + ("violated",))
    assert one["verdict"] == "supported"
    found = declared(verdicts=[one])["declarations"]
    assert found["claims"][0]["counterEvidence"] == ["evidence/0/counterexamples"]
    assert found["attestations"][0]["map"][2]["claims"] == ["claim/0"]


@pytest.mark.parametrize(
    "changes, score",
    [
        ({"verdicts": [SUPPORTED]}, 1),
        ({"verdicts": [SUPPORTED, UNDECIDED]}, None),
        ({"verdicts": [UNDECIDED]}, None),
        ({"verdicts": [VIOLATED]}, 0),
        ({"verdicts": [SUPPORTED, VIOLATED]}, 0),
        ({"verdicts": [VIOLATED, UNDECIDED], "status": "running"}, 0),
        ({"verdicts": [WAIVED]}, None),
        ({"verdicts": [SUPPORTED | {"waiver": {"kind": "skip", "reason": ""}}]}, None),
        ({"verdicts": []}, None),
        ({"verdicts": [SUPPORTED], "status": "running"}, None),
        ({"verdicts": [SUPPORTED], "gate": PASSED | {"result": "incomplete"}}, None),
        ({"verdicts": [SUPPORTED], "searches": [searched("falsified")]}, 0),
        ({"verdicts": [SUPPORTED], "searches": [searched("not repeatable")]}, None),
        ({"verdicts": [SUPPORTED], "searches": [searched("nothing found")]}, 1),
    ],
)
def test_conformance_is_shown_refuted_or_has_no_score(changes, score):
    cases = [one for one in session_record().head.cases if one.id == "a/clear"]
    entry = declared(cases=cases, **changes)["declarations"]["attestations"][0]["map"][1]
    assert entry["conformance"].get("score") == score
    rationale = entry["conformance"]["rationale"]
    assert ("not attested" in rationale) == (score is None)
    assert ("was violated" in rationale) == (score == 0)


def test_a_declared_case_without_a_verdict_leaves_conformance_open():
    entry = declared(verdicts=[SUPPORTED])["declarations"]["attestations"][0]["map"][1]
    assert "score" not in entry["conformance"]
    assert "1 untested" in entry["conformance"]["rationale"]


def test_cells_and_cases_that_nobody_declared_do_not_count_against_conformance():
    cases = session_record().head.cases
    ghost = cases[1].replace(requirements=["SEC-1"])
    by_hand = cases[1].replace(id="a/clear+none", planned=0)
    switched_off = cases[1].replace(id="a/clear~recovery_planner", without=["recovery_planner"])
    for extra in (ghost, by_hand, switched_off):
        record = declared(verdicts=[SUPPORTED], cases=[cases[0], extra])
        assert record["declarations"]["attestations"][0]["map"][1]["conformance"]["score"] == 1


def test_a_bound_never_stands_without_its_n_nor_as_a_confidence():
    text = cyclonedx.render(session_record(verdicts=[SUPPORTED]))
    description = json.loads(text)["declarations"]["evidence"][0]["description"]
    assert description == (
        "3 valid of 3 run, 3 planned; 0 violations; rate <= 0.632 at 0.95 confidence "
        "(Clopper-Pearson, one-sided, fixed n)"
    )
    assert '"confidence":' not in text
    assert '"affirmation":' not in text


def test_the_serial_number_is_that_of_the_record():
    numbers = {declared(base_seed=seed)["serialNumber"] for seed in (0, 0, 1)}
    assert len(numbers) == 2


def test_a_verdict_on_an_unknown_requirement_cannot_be_declared():
    with pytest.raises(ValueError, match="X-1, which is not among the requirements"):
        cyclonedx.render(session_record(verdicts=[SUPPORTED | {"requirement": "X-1"}]))


# -- in-toto ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "verdicts, gate, status, result",
    [
        ([SUPPORTED], "passed", "complete", "PASSED"),
        ([SUPPORTED, WAIVED], "passed", "complete", "WARNED"),
        ([UNDECIDED], "passed", "complete", "WARNED"),
        ([VIOLATED], "passed", "complete", "FAILED"),
        ([SUPPORTED], "failed", "complete", "FAILED"),
        ([SUPPORTED], "incomplete", "complete", "FAILED"),
        ([SUPPORTED], "passed", "interrupted", "FAILED"),
    ],
)
def test_the_result_follows_the_gate(tmp_path, verdicts, gate, status, result):
    changes = {"verdicts": verdicts, "gate": PASSED | {"result": gate}, "status": status}
    assert predicate(tmp_path, **changes)["result"] == result


def test_an_undecided_test_has_failed_and_a_waived_one_is_warned(tmp_path):
    found = predicate(tmp_path)
    assert found["passedTests"] == ["a/clear::SAF-1"]
    assert found["warnedTests"] == ["a/clear::PERF-1"]
    assert found["failedTests"] == ["a/clear+ghost::SAF-1", "a/clear+ghost::SEC-1"]


def test_verdicts_on_one_pair_are_told_apart(tmp_path):
    same = [SUPPORTED, SUPPORTED | {"component": "D"}, SUPPORTED | {"component": "D", "item": "t"}]
    assert predicate(tmp_path, verdicts=[*same, same[0]])["passedTests"] == [
        "a/clear::SAF-1 [C] (a/clear::SAF-1)",
        "a/clear::SAF-1 [D] (a/clear::SAF-1)",
        "a/clear::SAF-1 [D] (t)",
        "a/clear::SAF-1 [C] (a/clear::SAF-1) #2",
    ]


def test_a_component_without_a_digest_is_no_subject(tmp_path):
    none = {"name": "C", "path": "m:G", "params": {}, "version": None, "digest": None}
    found = json.loads(statement(tmp_path, component_under_test=none)[0])
    assert [one["name"] for one in found["subject"]] == ["evidence.json"]
    assert found["predicate"]["configuration"][0]["annotations"]["components"] == ["C"]


def test_the_campaigns_digest_is_that_of_the_plan(tmp_path):
    def digest(**changes):
        return predicate(tmp_path, **changes)["configuration"][0]["digest"]

    assert digest() == digest(verdicts=[], created="2027-01-01T00:00:00+00:00")
    assert digest() != digest(base_seed=1)


def test_a_statement_needs_its_record(tmp_path):
    with pytest.raises(ValueError, match="has to be written before"):
        intoto.render(session_record(tmp_path))


# -- summary ----------------------------------------------------------------------------------


def test_the_summary_begins_with_the_gate_and_what_failed():
    text = summary.render(session_record())
    assert text.startswith("# Gate failed\n")
    order = [text.index(f"Cause {number}, {card}") for number, card in (
        (1, "violated: safety"), (2, "undecided: security"), (3, "violated: performance"),
    )]  # fmt: skip
    assert re.search(
        r"^\| violated \| waived \| `PERF-1` .*; waived, xfail: known \|$", text, re.MULTILINE
    )
    assert order == sorted(order)
    assert "replay: `pytest --dura-replay='a/clear+ghost#1'`" in text
    assert "- untested: PERF-1 on a/clear+ghost" in text
    assert "generated, unreviewed" in text


def test_requirements_that_are_undecided_for_the_same_reason_share_a_row():
    other = UNDECIDED | {"requirement": "PERF-1"}
    apart = UNDECIDED | {"requirement": "SEC-1", "reason": "another one"}
    text = summary.render(session_record(verdicts=[UNDECIDED, other, apart]))
    (card,) = re.findall(
        r"^## Cause \d, undecided.*?(?=^## |^\| gate)", text, re.MULTILINE | re.DOTALL
    )
    (named,) = re.findall(r"^- (\S+): undecided, 0 of \d runs? violate it", card, re.MULTILINE)
    (alike,) = re.findall(r"^- and: (.*): undecided for the same reason$", card, re.MULTILINE)
    assert sorted([named, *alike.split(", ")]) == ["PERF-1", "SAF-1", "SEC-1"]
    assert text.count("| another one |") == 1


def test_untested_cells_that_are_not_listed_are_counted():
    coverage = session_record().head.coverage
    text = summary.render(session_record(coverage=coverage.replace(left_out=100)))
    assert "4 of 105 cells" in text
    assert "101 are untested" in text
    assert re.search(r"^\| `PERF-1` \| .* \| 1 or more \|$", text, re.MULTILINE)
    assert "- and 100 more" not in summary.render(session_record())
    assert "- and 100 more" in text


@pytest.mark.parametrize(
    "changes", [{"status": "interrupted"}, {"gate": PASSED | {"result": "incomplete"}}]
)
def test_an_incomplete_session_never_reads_as_a_pass(changes):
    text = summary.render(session_record(**({"gate": PASSED} | changes)))
    assert text.startswith("# Session incomplete")
    assert "Gate passed" not in text


def test_a_replay_command_names_the_directory_of_the_evidence():
    text = summary.render(session_record(command="pytest -q '--dura-evidence=my out'"))
    assert "`pytest --dura-replay='a/clear+ghost#1' --dura-evidence='my out'`" in text


def test_a_command_that_cannot_be_shown_as_it_is_is_not_shown():
    worst = {"episode": "a\x1b#0", "time": None, "margin": None, "valid": True}
    bad = VIOLATED | {"counterexamples": [worst]}
    text = summary.render(session_record(verdicts=[bad]))
    assert "--dura-replay" not in text
    assert "replay: by its id in the record" in text


def test_a_summary_that_is_too_long_keeps_the_failures_and_says_what_it_leaves_out():
    long = "y" * 110
    many = [SUPPORTED | {"case": f"{long}{one}"} for one in range(6000)]
    record = session_record(verdicts=[*many, VIOLATED, UNDECIDED])
    text = summary.render(record)
    assert len(text.encode()) <= summary.MAX_BYTES
    assert re.search(r"_\d+ of 6002 are left out here", text)
    rows = re.findall(r"^\| (violated|undecided|supported) ", text, re.MULTILINE)
    assert rows[:3] == ["violated", "undecided", "supported"]
    assert stated_counts(summary, text) == record.head.totals.to_json()
