"""What the formats say of searches: the record's figures, and never that anything is met."""

from __future__ import annotations

import json
import re

import pytest
import yaml
from gsn_rules import rule_problems
from report_pages import Page
from searches import entry
from session_records import session_record, verdict
from stated_counts import elements_of, stated_counts

from pytest_dura.evidence import all_formats, write_record
from pytest_dura.reports import intoto, outcome_headline, summary
from pytest_dura.reports.cards import search_card
from pytest_dura.reports.gsn import yaml_file
from pytest_dura.reports.html.page import render
from pytest_dura.reports.searches import failure_lines, simulations_text

PASSED = {"result": "passed", "exit_code": 0, "warn_undecided": False, "failed": 0, "reasons": []}
SUPPORTED = [verdict("SAF-1", "a/clear", ("satisfied",) * 4)]
WAIVER = {"kind": "xfail", "reason": "ticket 7"}
WORDS = ("falsified", "not repeatable", "undecided", "nothing found")


def record_of(*searches, **changes):
    return session_record(searches=list(searches), **changes)


def met_by_a_baseline(name="SAF-1"):
    one = entry("nothing found")
    return {**one, "baselines": [
        {**one["baselines"][0], "first": {**one["baselines"][0]["first"], name: 3}},
    ]}  # fmt: skip


@pytest.mark.parametrize("words", [(word,) for word in WORDS] + [("falsified", "nothing found")])
def test_every_format_states_the_counts_of_the_record(tmp_path, words):
    record = session_record(tmp_path, searches=[entry(*words)])
    write_record(tmp_path, record)
    for one in all_formats():
        assert stated_counts(one, one.render(record)) == record.head.totals.to_json(), one.FILE


def test_no_format_says_that_a_search_shows_a_requirement(tmp_path):
    record = session_record(
        tmp_path, searches=[entry("nothing found", "nothing found")], verdicts=[], gate=PASSED
    )
    write_record(tmp_path, record)
    pages = [Page(render(record)).words, summary.render(record), yaml_file.render(record)]
    for text in pages:
        told = " ".join(text.split())
        assert "supports no requirement" in told
        assert re.search(r"nothing found in 37 simulations|nothing found \| - \|", told)
        about = re.findall(r"[^.|]*\bsearch[^.|]*", told.lower())
        assert about
        assert not [one for one in about if re.search(r"\b(safe|holds|verified)\b", one)]
    assert "each verdict below is supported" not in pages[0]


def test_the_headline_of_each_word():
    told = {}
    for word in WORDS:
        (one,) = record_of(entry(word)).head.searches
        told[word] = outcome_headline(one, one.outcomes[0])
    nothing = "nothing found in 37 simulations: least robustness 0.125, coverage 85 % of each range"
    assert told["nothing found"].startswith(f"SAF-1: {nothing}")
    assert told["undecided"].startswith(f"undecided: SAF-1: {nothing}")
    assert told["falsified"] == (
        "falsified: SAF-1 violated at simulation 21, by cma-es; confirmed by 1 equal replay"
    )
    assert told["not repeatable"] == (
        "not repeatable: SAF-1 violated at simulation 21, by cma-es; and in 3 of 10 replays, "
        "2 of them equal"
    )


def test_a_failing_test_says_what_was_violated_and_the_card_the_rest():
    record = record_of(entry("falsified", "nothing found"))
    (one,) = record.head.searches
    assert list(failure_lines(one)) == [
        (
            "falsified: SAF-1 on a/clear (C) violated at simulation 21, by cma-es; "
            "confirmed by 1 equal replay"
        ),
        "worst:     gap is -0.25 where more than 0 is required, first at t = 3.40 s",
        "kept:      scenarios/found/a-clear-saf-1.yaml, which --dura-scenarios runs from now on",
        outcome_headline(one, one.outcomes[1], " on a/clear (C)"),
    ]
    card = search_card(one, one.outcomes[0], {"gap": "m"})
    assert card.headline.endswith(
        "gap is -0.25 m where more than 0 m is required, first at t = 3.40 s."
    )
    entries = [(entry.label, entry.text) for entry in card.entries]
    assert ("simpler", "from 11 to 4 parameters that differ (41 simulations)") in entries
    assert ("inputs", "world.ego.speed: 9 instead of 8 m/s") in entries
    assert ("searched", f"{simulations_text(one)}; seed {one.seed}") in entries
    assert ("trivial", "random seeds none in 37; bang-bang at 30") in entries
    assert entries[-2][0] == "rerun"


def section(text, heading="Searches"):
    return text.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]


def test_the_summary_has_a_row_for_each_requirement_with_the_baselines_beside_it():
    text = section(summary.render(record_of(entry("nothing found"), entry("falsified"))))
    header, _, first, second = [line for line in text.split("\n") if line.startswith("|")]
    assert "trivial baselines alone" in header
    assert first == (
        "| falsified | - | `SAF-1` | `a/clear` | `C` | 21 of 100 | -0.25 | cma-es | "
        "random seeds none in 37; bang-bang at 30 | `world.ego.speed` 9 instead of 8 m/s, "
        "`world.wall` 2 instead of 4, `faults.delay` delay, added, "
        "`faults.delay.activation.at` 2 instead of 0 s; kept in "
        "`scenarios/found/a-clear-saf-1.yaml` |"
    )
    assert second.startswith("| nothing found | - | `SAF-1` | `a/clear` | `C` | 37 of 100 | 0.125 ")
    assert second.endswith("| coverage 85 % of each range, 48 % of their pairs |")


def test_the_summary_names_what_a_search_found_among_what_is_not_supported():
    found = [entry("falsified", "nothing found", waiver=WAIVER), entry("undecided", item="other")]
    text = summary.render(record_of(*found, verdicts=SUPPORTED))
    cards = re.findall(r"^## Cause \d, (.*?)(?=^## |^\| gate)", text, re.MULTILINE | re.DOTALL)
    assert any(card.startswith("undecided: SAF-1 on a/clear (C)\n") for card in cards)
    falsified = cards[-1]  # what is waived comes last
    assert falsified.startswith("falsified: SAF-1 on a/clear (C) \\[xfail\\]\n")
    assert "violated at simulation 21, by cma-es; confirmed by 1 equal replay" in falsified
    assert "- inputs: world.ego.speed: 9 instead of 8 m/s" in falsified


def test_a_session_without_searches_has_no_section_of_them():
    assert "## Searches" not in summary.render(session_record())
    assert 'id="searches"' not in render(session_record())
    assert "search" not in yaml_file.render(session_record())


def test_the_report_shows_who_violated_it_and_what_was_changed():
    page = Page(render(record_of(entry("falsified", waiver=WAIVER))))
    assert page.ids["searches"] == 1
    for told in (
        "37 of 100 simulations", "falsified", "[xfail]", "world.ego.speed", "9 instead of 8 m/s",
        "from 11 to 4 parameters that differ (41 simulations)", "Trivial, each by itself:",
        "random seeds 37 none 0.5", "bang-bang 37 30 -0.25", "cma-es (learns) 25 9 -0.25",
        "kept in scenarios/found/a-clear-saf-1.yaml", "Waived ticket 7",
    ):  # fmt: skip
        assert told in page.words, told


def test_the_sentences_name_what_a_search_violated_and_support_nothing_by_what_it_did_not():
    text = summary.render(record_of(entry("falsified", "nothing found"), verdicts=SUPPORTED))
    assert "Violated in a search, confirmed by replay: SAF-1 on a/clear" in text.replace("\\", "")
    assert "found nothing against 1 requirement on a case, in up to 37" in text
    alone = summary.render(record_of(entry("not repeatable"), verdicts=[]))
    assert "Violated in a search, and not each time again: SAF-1 on a/clear" in alone


def elements(*searches, **changes):
    found = elements_of(yaml_file.render(record_of(*searches, **changes)))
    assert rule_problems(found) == []
    return found


def test_a_counterexample_defeats_a_requirement_on_all_episodes():
    found = elements(entry("falsified"), verdicts=SUPPORTED)
    assert found["G-SAF-1"]["defeated"]
    assert found["GTop"]["defeated"]
    against = found["CG-SAF-1"]
    assert against["text"] == "SAF-1 is violated in 0 of 1 judged case and by what 1 search found."
    (solution,) = (found[one] for one in against["supportedBy"])
    assert solution["url"] == "evidence.json#/searches/0/outcomes/0"
    assert solution["text"].startswith("A search of a/clear with C: falsified: SAF-1 violated at")
    goal = next(one for one in found.values() if one.get("alias") == "verdict:SAF-1@a/clear")
    assert "defeated" not in goal  # its counts are its own


def test_a_waived_counterexample_challenges_and_defeats_nothing():
    found = elements(entry("falsified", waiver=WAIVER), verdicts=SUPPORTED)
    assert "defeated" not in found["G-SAF-1"]
    assert found["CG-SAF-1"]["text"].endswith("Waivers accept all of these violations.")
    assert found["CGTop"]["text"].endswith("Waivers accept all of these violations.")


def test_a_counterexample_challenges_a_bound_on_a_rate_and_does_not_defeat_it():
    one = entry("falsified")
    one["outcomes"][0].update(requirement="SEC-1", check="gap > 0")
    found = elements(one, verdicts=SUPPORTED)
    assert "defeated" not in found["G-SEC-1"]
    assert "Waivers" not in found["CG-SEC-1"]["text"]
    assert "CG-SEC-1" in found["CGTop"]["supportedBy"]


def test_what_found_nothing_is_a_context_and_supports_no_goal():
    found = elements(entry("nothing found"), verdicts=SUPPORTED)
    (context,) = (one for one in found.values() if one.get("alias") == "searched:SAF-1")
    assert "nothing found in 37 simulations" in context["text"]
    assert "CG-SAF-1" not in found
    ids = {id_ for id_, one in found.items() if one is context}
    assert ids <= set(found["G-SAF-1"]["inContextOf"])
    assert not any(ids & set(one.get("supportedBy", ())) for one in found.values())


def result(tmp_path, *searches):
    record = session_record(tmp_path, searches=list(searches), verdicts=SUPPORTED, gate=PASSED)
    write_record(tmp_path, record)
    return json.loads(intoto.render(record))["predicate"]["result"]


def test_a_test_result_with_a_waived_counterexample_is_a_warning(tmp_path):
    assert result(tmp_path) == "PASSED"
    assert result(tmp_path, entry("nothing found")) == "PASSED"
    assert result(tmp_path, entry("falsified", waiver=WAIVER)) == "WARNED"
    assert result(tmp_path, entry("falsified")) == "FAILED"
    assert result(tmp_path, met_by_a_baseline()) == "FAILED"


def test_a_violation_that_a_baseline_alone_met_is_told_everywhere():
    one = met_by_a_baseline()
    assert "violated by a baseline" in section(summary.render(record_of(one)))
    assert "violated by a baseline" in Page(render(record_of(one))).words
    text = yaml.safe_load(yaml_file.render(record_of(one, verdicts=SUPPORTED)))
    assert text["G-SAF-1"]["defeated"]
