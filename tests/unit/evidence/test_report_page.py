"""The report: what each section says, its bounds, and how its counts are read back."""

from __future__ import annotations

import base64
import hashlib
import re
import tracemalloc
from dataclasses import replace

import pytest
from entries import make
from report_pages import VIOLATING, Page, record_with_trace, unpacked
from session_records import episode, session_record, verdict
from stated_counts import stated_counts

from pytest_dura.evidence.bundle import default_files
from pytest_dura.evidence.case_model import FaultMetricsEntry
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.text import name
from pytest_dura.evidence.verdict_model import LookEntry
from pytest_dura.reports import (
    anchor,
    case_anchor,
    contents,
    generated_argument,
    verdict_anchor,
    wording,
)
from pytest_dura.reports.causes import causes_of
from pytest_dura.reports.columns import Shown, name_cell
from pytest_dura.reports.contents import requirement_anchor
from pytest_dura.reports.document import Entry, Level, Text
from pytest_dura.reports.html import bundle_sections, cards, players
from pytest_dura.reports.html import page as page_module
from pytest_dura.reports.html.page import _environment, render
from pytest_dura.reports.matrices import crossed
from pytest_dura.reports.session_tables import requirement_table
from pytest_dura.reports.story import document_of
from pytest_dura.reports.summary import render as summarised


@pytest.fixture(scope="module")
def html():
    return render(session_record())


def section(html, name):
    """The words of a section, with plain spaces."""
    return Page(re.search(f'<section id="{name}".*?</section>', html, re.DOTALL)[0]).words


def section_html(html, name):
    return re.search(f'<section id="{name}".*?</section>', html, re.DOTALL)[0]


def row(html, anchor):
    pattern = f'<(?:tr|tbody)[^>]* id="{anchor}"[^>]*>.*?</tr>'
    return Page(re.search(pattern, html, re.DOTALL)[0]).words


def test_the_gate_says_why_it_failed_and_that_nobody_reviewed_it(html):
    header = Page(re.search("<header.*?</header>", html, re.DOTALL)[0]).words
    assert header.startswith("✗ Gate failed exit code 1")
    gate = section(html, "overview")
    assert gate.startswith("Of 4 verdicts, 2 violated, 1 undecided, 1 supported")
    assert "✗ violated" in gate
    assert "Commit c0ffee" in gate
    assert "Base seed 0: with it and the packages, the episodes are the same" in gate
    assert "Review generated, unreviewed" in gate
    assert "python -m pytest_dura sign DIR --key=KEY.pem --review=review.yaml" in gate


@pytest.mark.parametrize(
    "changes",
    [
        {"status": "running"},
        {"gate": {"result": "incomplete", "exit_code": 2, "reasons": ["it was killed"]}},
    ],
)
def test_an_incomplete_session_says_so_before_anything_else(changes):
    gate = section(render(session_record(**changes)), "overview")
    assert gate.startswith("Incomplete: the session")


def test_a_gate_that_passed_says_what_it_let_through():
    gate = {"result": "passed", "exit_code": 0, "reasons": [], "warn_undecided": True}
    words = section(render(session_record(gate=gate)), "overview")
    assert "is supported, or waived by name; undecided ones are let through" in words
    gate = {"result": "incomplete", "exit_code": 2, "reasons": []}
    assert "Nothing speaks against it" not in render(session_record(gate=gate))


def test_a_complete_session_is_not_called_incomplete(html):
    assert "ncomplete" not in section(html, "overview")


def test_a_verdict_states_its_counts_bound_margin_and_counterexample(html):
    words = row(html, verdict_anchor("SAF-1", "a/clear+ghost"))
    assert words.startswith(
        "a/clear+ghost ✗ violated 2 / 2 1 0 0 0 0 ≤ 97.5 % at 95 %1 allowed: none"
    )
    assert "-0.5 / 0.5" in words
    assert "1 of 2 valid episodes violated it" in words
    assert f"{VIOLATING} at t = 0.90 s, margin -0.5" in words
    assert f"pytest --dura-replay={VIOLATING!r} --dura-evidence=DIR" in words


def test_a_waiver_is_told_beside_the_word_that_it_excuses(html):
    words = row(html, verdict_anchor("PERF-1", "a/clear"))
    assert "✗ violated ⚑ waived" in words
    assert "⚑ xfail: known" in words


def test_pairs_are_told_with_and_without_and_their_p():
    pairs = {
        "without": "recovery_planner", "case": "a/clear~recovery_planner", "pairs": 5,
        "only_with": 1, "only_without": 3, "both": 0, "neither": 1, "incomplete": 0,
        "acted_only_with": 0, "acted_only_without": 2, "acted_both": 2, "acted_neither": 4,
        "violated_with": 1, "violated_without": 3, "p_value": 0.625,
    }  # fmt: skip
    one = verdict("SAF-1", "a/clear", ("satisfied",) * 5, pairs=pairs)
    html = render(session_record(verdicts=[one]))
    words = row(html, verdict_anchor("SAF-1", "a/clear"))
    assert (
        "violated only with it 1, only without it 3, both 0, neither 1 of 5; McNemar p = 0.62"
        in words
    )
    assert "SAF-1 a/clear 5 3 1 2 \N{EN DASH} 3 of 3 (29 to 100 %) 4 50 % (4) 0.62" in section(
        html, "monitors"
    )
    # The test's level does not hold where the pairs themselves say when to stop.
    html = render(session_record(verdicts=[{**one, "method": "sprt"}]))
    assert "McNemar p =" not in row(html, verdict_anchor("SAF-1", "a/clear"))


def test_cases_are_told_over_valid_and_over_run_episodes():
    record = session_record()
    metrics = record.head.cases[0].metrics.replace(valid=2, run=3)
    collided = metrics.measures["collided"].replace(valid=1, run=2)
    metrics = metrics.replace(measures={**metrics.measures, "collided": collided})
    html = render(session_record(cases=[record.head.cases[0].replace(metrics=metrics)]))
    assert "1/2 +1*" in row(html, case_anchor("a/clear"))
    dash = "\N{EN DASH}"
    assert f"1.55 ± 0.07 s (2) {dash} {dash} {dash} 0 {dash} 2" in row(html, case_anchor("a/clear"))
    # Sums over the valid runs, of which there are none, are no nought.
    metrics = metrics.replace(valid=0, measures={"collided": collided})
    html = render(session_record(cases=[record.head.cases[0].replace(metrics=metrics)]))
    assert row(html, case_anchor("a/clear")).endswith(f" 0 0 1/0 1/0 +1* {' '.join([dash] * 8)}")


def test_what_the_component_left_to_its_recovery_and_how_it_reacted_stand_beside_it():
    case = session_record().head.cases[0]
    share = {"valid": 1, "run": 1, "share_of_valid": 0.5, "share_of_planned": 0.5}
    switching = {
        "share": 0.125, "takeovers": 3, "switches_per_episode": 3.0,
        "time_to_safe": {"median": 0.2, "max": 0.4, "censored": 0},
    }  # fmt: skip
    metrics = case.metrics.replace(
        rescued=share, reactions={"frozen": 1, "follows the fake": 4}, switching=switching,
        measures={**case.metrics.measures, "uncomfortable": {**share, "valid": 2, "run": 2}},
    )  # fmt: skip
    overall = [{"component": "C", "cases": 2, "metrics": metrics}]
    told = session_record(cases=[case.replace(metrics=metrics)], overall=overall)
    html = render(told)
    figures = "1/2 12.5 % 0 2/2 2 frozen 1, follows the fake 4"
    assert figures in row(html, case_anchor("a/clear")).replace("\N{NO-BREAK SPACE}", " ")
    words = Page(html).words.replace("\N{NO-BREAK SPACE}", " ")
    assert f"All 2 cases 2 / 2 0 0 1/2 1/2 1.55 ± 0.07 s (2) \N{EN DASH} {figures}" in words


def test_what_the_runs_show_of_recovery_and_monitors_is_listed():
    detail = "cannot be told here: nothing happened"
    found = {
        "role": "recovery_planner", "component": "C", "requirement": "R",
        "finding": "cannot be told", "detail": detail,
    }  # fmt: skip
    html = render(session_record(effectiveness=[found]))
    assert f"<li>recovery_planner: {detail}</li>" in section_html(html, "monitors")
    assert f"- recovery\\_planner: {detail}" in summarised(session_record(effectiveness=[found]))


def test_the_map_of_faults_marks_what_is_untested_and_what_has_no_valid_episode():
    undecided = verdict("PERF-1", "a/clear+ghost", ("invalid",) * 3)
    found = [undecided, verdict("SAF-1", "a/clear+ghost", ("satisfied", "violated", "violated"))]
    html = render(session_record(verdicts=found))
    heat = re.search('<table id="faults-2".*?</table>', html, re.DOTALL)[0]
    assert re.search(r'step-4">\s*2/3 ✗', heat)
    assert Page(heat).words.count("? 0 valid") == heat.count('<td class="hollow">') == 1
    assert Page(heat).words.count("○ untested") == heat.count('<td class="untested">') == 4
    assert 'step-0"' not in heat


def test_the_chain_of_a_fault_has_its_counts_outcomes_and_latencies():
    record = session_record()
    chain = make(
        FaultMetricsEntry, id="ghost", target="lidar", run=4, activated=4, manifested=3, followed=3,
        propagated=2, detected=1, recovery=1, recovered=0, judged=3, violated=1,
        read_by=["generator", "watch"],
        detection_latency={"median": 0.25, "max": 1.0},
    )  # fmt: skip
    case = record.head.cases[1]
    cases = [record.head.cases[0], case.replace(metrics=case.metrics.replace(faults=[chain]))]
    words = section(render(session_record(cases=cases)), "faults")
    assert (
        "a/clear+ghost ghost on lidar, read by generator, watch 4/4 3/4 2/3 1/3 1/3 0/1 1/3"
        " 4 tolerated detection 0.25 s" in words
    )
    assert "Activated: it began, of the planned runs" in words
    assert "tolerated, it may have, and nothing was violated after it" in words


def test_untested_cells_and_drawn_parts_of_ranges_are_shown(html):
    words = section(html, "matrix")
    assert "4 of 5 cells" in words
    assert words.count("○ untested") == 2  # the cell, and the legend
    assert "world.wall 2 to 6 6 2.5 to 5 0 2 1 2 1 0 0 0 0 0 4/10 (40 %)" in words.replace(
        "\N{NO-BREAK SPACE}", " "
    )


def test_requirements_without_a_case_and_cases_without_a_requirement_are_orphans():
    html = render(session_record(verdicts=[verdict("SAF-1", "a/clear", ("satisfied",) * 2)]))
    words = section(html, "matrix")
    assert "Orphans Requirements no case tests PERF-1, SEC-1 " in words
    assert "Cases no requirement is judged on a/clear+ghost " in words
    assert section(html, "cases").count("orphan: no requirement is judged on it") == 1
    assert section(html, "requirements").count("untested: no case led to a verdict on it") == 2


def test_a_monitor_is_told_with_n_behind_its_rates(html):
    words = section(html, "monitors")
    assert "SecurityAssessor SAF-1 a/clear+ghost 4" in words
    assert "0.5 (1/2) 1 (1/1)" in words


def test_targets_on_which_a_monitor_did_equally_well_share_a_row():
    one = session_record().head.monitors[0]
    silent = replace(one, true_positives=0, false_positives=0, false_negatives=0)
    others = replace(one, target="SEC-1"), replace(one, target="SAF-2", lead_times=())
    found = [one, *others, silent]
    words = section(render(session_record(monitors=found)), "monitors")
    assert "SecurityAssessor SAF-1, SEC-1 a/clear+ghost" in words
    assert "SecurityAssessor SAF-2 a/clear+ghost" in words
    assert "1 further measurement without a violation and without a flag" in words


def test_bars_are_as_high_as_their_counts(html):
    heights = re.findall('class="bar" x="([^"]*)" y="[^"]*" width="10" height="([^"]*)"', html)
    assert [float(height) for _, height in heights] == [0, 22, 11, 22, 11, 0, 0, 0, 0, 0]
    assert [float(x) for x, _ in heights] == [12 * place for place in range(10)]


def test_a_choice_is_covered_by_what_was_drawn_of_it():
    one = session_record().head.coverage.parameters[0].replace(
        low=None, high=None, least=None, greatest=None, bins=[], covered=0.5,
        choices=[{"value": "left", "count": 6}, {"value": True, "count": 0}],
    )  # fmt: skip
    coverage = {"cells": [], "left_out": 7, "parameters": [one]}
    words = section(render(session_record(coverage=coverage)), "matrix")
    assert "world.wall 2 choices 6 left, True 6 0 1/2 (50 %)" in words
    assert "0 of 7 cells" in words
    assert "7 untested cells are too many to be listed" in words


def test_a_baseline_is_compared_only_where_there_is_one(html):
    assert "Compared with a baseline" not in html
    comparison = {
        "requirement": "SAF-1", "case": "a/clear", "component": "C", "baseline_component": "C",
        "status": "worse", "reason": "", "uncorrected": "worse", "confidence": 0.95,
        "violations": 3,
        "episodes": 9, "baseline_violations": 0, "baseline_episodes": 9, "test": "Fisher",
        "only_now": None, "only_baseline": None, "p_worse": 0.01, "p_better": 1.0,
        "p_worse_holm": 0.02, "p_better_holm": 1.0,
    }  # fmt: skip
    gone = dict.fromkeys(comparison) | {
        "requirement": "SAF-2", "case": "a/clear", "status": "gone", "reason": "",
    }  # fmt: skip
    baseline = {
        "path": "before", "sha256": "5" * 64, "created": "2026-01-01", "status": "complete",
        "base_seed": 0, "component": {"name": None}, "correction": "Holm", "tests": 1,
        "comparisons": [comparison, gone],
    }  # fmt: skip
    words = section(render(session_record(baseline=baseline)), "provenance")
    assert "SAF-1 on a/clear worse 3/9 0/9 0.01 0.02 Fisher" in words
    assert "gone: SAF-2 on a/clear" in words


def test_only_our_own_scripts_and_styles_are_allowed_to_run(html):
    policy = re.search('Content-Security-Policy" content="([^"]*)"', html)[1].replace("&#39;", "'")
    assert policy.startswith("default-src 'none'; ")
    for tag in ("script", "style"):
        text = re.search(f"<{tag}>(.*?)</{tag}>", html, re.DOTALL)[1]
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy
    assert "unsafe" not in policy


def test_a_trace_gives_its_episode_a_player_to_which_the_verdict_links(tmp_path):
    html = render(record_with_trace(tmp_path))
    player = re.search('<details class="player" id="([^"]*)"', html)[1]
    assert f'<a href="#{player}">{VIOLATING}</a>' in html.replace("<wbr>", "")
    assert "octet-stream" in html
    assert stated_counts("report.html", html) == record_with_trace(tmp_path).head.totals.to_json()


@pytest.mark.parametrize(
    "changes, told",
    [
        ({"file": "episodes/gone.mcap"}, "No such file"),
        ({"trace": {"sha256": "0" * 64}}, "the record says another"),
    ],
)
def test_a_trace_that_cannot_be_read_is_told_in_its_place(tmp_path, changes, told):
    html = render(record_with_trace(tmp_path, **changes))
    words = section(html, "episodes")
    assert told in words
    assert "cannot be shown" in words
    assert "octet-stream" not in html


def test_a_trace_outside_the_evidence_is_told_in_its_place(tmp_path):
    record = record_with_trace(tmp_path / "evidence")
    file = tmp_path / "evidence/episodes/one.mcap"
    file.rename(tmp_path / "outside.mcap")
    file.symlink_to(tmp_path / "outside.mcap")
    assert "the file lies outside the evidence" in section(render(record), "episodes")


def test_a_damaged_trace_is_told_in_its_place(tmp_path):
    record = record_with_trace(tmp_path)
    damaged = b"\x89MCAP0\r\n" + b"x" * 500
    (tmp_path / "episodes/one.mcap").write_bytes(damaged)
    changed = {"sha256": hashlib.sha256(damaged).hexdigest(), "bytes": len(damaged)}
    episodes = [
        one if one.trace is None else one.replace(trace=one.trace.replace(**changed))
        for one in record.episodes()
    ]
    record = replace(record, read_episodes=episodes.__iter__)
    assert "trace unreadable" in section(render(record), "episodes")


def test_players_are_bounded_in_number_and_size(tmp_path, monkeypatch):
    record = record_with_trace(tmp_path)
    trace = next(one.trace for one in record.episodes() if one.trace)
    many = [episode("a/clear", run, trace=trace) for run in range(20)]
    found = contents.ReportContents.of(session_record(tmp_path, episodes=many)).candidates
    assert (
        len(players.embed_players(record, found, players.Traces(record)).shown)
        == players.MAX_PLAYERS
    )
    one = len(players.embed_players(record, found[:1], players.Traces(record)).rows[0]["packed"])
    monkeypatch.setattr(players, "MAX_CHARACTERS", 3 * one)
    assert len(players.embed_players(record, found, players.Traces(record)).shown) == 3


def test_players_show_the_worst_of_each_verdict_before_the_second_of_one():
    verdicts = [
        verdict("SAF-1", "a/clear", ("violated",) * 4),
        verdict("PERF-1", "a/clear", ("violated", "satisfied")),
        verdict("SAF-1", "a/clear+ghost", ("violated",) * 2),
    ]
    trace = {"file": "episodes/x.mcap", "sha256": "0" * 64, "bytes": 1, "kept_for": "violation"}
    episodes = [
        episode(case, run, trace=trace) for case in ("a/clear", "a/clear+ghost") for run in range(6)
    ]
    record = session_record(verdicts=verdicts, episodes=episodes)
    found = [one.episode.id for one in contents.ReportContents.of(record).candidates]
    assert found[:4] == ["a/clear#0", "a/clear+ghost#0", "a/clear#1", "a/clear+ghost#1"]
    # Then one of each case that violated nothing.
    assert found[6:8] == ["a/clear#4", "a/clear+ghost#2"]


def test_a_run_by_hand_is_not_blamed_for_the_violation_of_its_namesake():
    found = verdict("SAF-1", "a/clear", ("violated",))
    episodes = [episode("a/clear", 0), episode("a/clear", 0, planned=False, seed=77)]
    listed = contents.ReportContents.of(session_record(verdicts=[found], episodes=episodes)).listed
    assert [(one.violates, one.episode.planned) for one in listed] == [
        (("SAF-1",), True),
        ((), False),
    ]


def test_a_case_counts_runs_that_were_not_planned():
    episodes = [
        episode("a/clear", 0), episode("a/clear", 1, planned=False),
        episode("a/clear+ghost", 2, validity="invalid"), episode("a/clear", 3),
    ]  # fmt: skip
    cases = contents.ReportContents.of(session_record(episodes=episodes)).cases
    assert cases["a/clear", "C"]["valid"] == 3


def test_anchors_tell_apart_parts_that_read_alike():
    assert anchor("x", "-", "a") != anchor("x", "", "-a")
    assert anchor("x", "a", "b") != anchor("x", "a-b")
    assert requirement_anchor("SAF-1") == "requirement-SAF-1"


def many_episodes(count):
    """A record whose episodes are made when they are read."""
    plain = [episode("a/clear", run % 90) for run in range(90)]
    told = {"flagged": False, "measures": {"collided": False, "gridlock": False}}
    digests = {"digest": "f" * 64, "trajectory": "f" * 64}
    for one in plain:
        one["outcome"] |= told
    typed = EpisodeEntry.from_data
    plain = [typed(one) for one in plain]

    def read():
        for run in range(count):
            if run == count - 1:
                yield typed(episode("a/clear", run, validity="missing", **digests))
            elif run == count - 2:
                yield typed(episode("a/clear", run, validity="invalid", **digests))
            else:
                yield plain[run % 90].replace(id=f"a/clear#{run}")

    record = session_record(episodes=[])
    record = record.changed(totals=record.head.totals.replace(episodes=count))
    return replace(record, read_episodes=read)


def test_many_episodes_are_counted_and_the_remarkable_ones_listed():
    html = render(many_episodes(1500))
    words = section(html, "episodes")
    assert "1000 of 1500 episodes" in words
    assert "500 are left out" in words
    assert words.index("a/clear#1499") < words.index("a/clear#1498") < words.index("a/clear#7 ")
    counts = stated_counts("report.html", html)
    assert [counts[key] for key in ("episodes", "valid", "invalid", "missing")] == [
        1500,
        1498,
        1,
        1,
    ]


def test_memory_does_not_grow_with_the_number_of_episodes():
    def peak(count):
        record = many_episodes(count)
        tracemalloc.start()
        contents.ReportContents.of(record)
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return used

    assert peak(6000) < peak(2000) + 200_000


def test_a_matrix_has_the_fewer_headings_in_its_columns():
    def cells(table):
        return [[column.cell(row).page for column in table.columns] for _, row in table.rows]

    one, three = [name_cell("r")], [name_cell(name) for name in "xyz"]
    wide = crossed(one, three, lambda i, j: f"{i} {j}", "Fault")
    assert [column.title for column in wide.columns] == ["Fault", "r"]
    assert cells(wide) == [["x", "0 0"], ["y", "0 1"], ["z", "0 2"]]
    high = crossed(three, one, lambda i, j: f"{i} {j}", "Fault")
    assert [column.title for column in high.columns] == ["Requirement", "r"]
    assert cells(high) == [["x", "0 0"], ["y", "1 0"], ["z", "2 0"]]


SURE = {
    "check": "gap > 0", "run": 2, "pairs": None, "open": [], "invalid": 0, "missing": 0, "saved": 0,
}  # fmt: skip
RUN = contents.BriefEpisode.of(EpisodeEntry.from_data(episode("case", 1)))


@pytest.mark.parametrize(
    "verdict_, episode_, word",
    [
        ({}, {}, "satisfied"),
        # Of the third run this verdict, which looked at two, knows nothing.
        ({}, {"run": 2}, "not judged"),
        ({"check": ""}, {"run": 2}, "satisfied"),
        ({}, {"planned": False}, "not judged"),
        ({}, {"validity": "invalid"}, "invalid"),
        ({}, {"validity": "missing"}, "missing"),
        ({"open": ["case#1"]}, {}, "open"),
        ({"open": ["case#0"]}, {}, "satisfied"),
        ({"pairs": {}}, {}, "not violated"),
        ({"invalid": 1}, {}, "not violated"),
        ({"saved": 1}, {}, "not violated"),
    ],
)
def test_a_player_says_satisfied_only_where_the_record_does(verdict_, episode_, word):
    asked = make(ItemVerdict, **SURE | verdict_)
    assert players._satisfied_verdict(asked, replace(RUN, **episode_))[0] == word


def test_what_was_violated_comes_first():
    html = render(session_record())
    ids = re.findall(r'<tbody class="requirement entry" id="requirement-([A-Z]+-1)"', html)
    assert ids == ["SAF-1", "PERF-1", "SEC-1"]  # of the violated ones, safety first
    rows = section(html, "requirements")
    assert rows.index("a/clear+ghost ✗ violated") < rows.index("a/clear ✓ supported")


def test_a_card_leads_to_its_verdict(html):
    card = re.search(r"<article.*?</article>", html, re.DOTALL)[0]
    assert f'href="#{verdict_anchor("SAF-1", "a/clear+ghost")}">SAF-1</a>' in card


def test_a_cell_of_the_heat_map_says_on_what_it_rests_and_whether_that_is_enough():
    one = verdict("SAF-1", "a/clear+ghost", ("violated", "invalid", "invalid"))
    words = section(render(session_record(verdicts=[one])), "faults")
    assert "1/1 ✗ SEC" in words
    one = verdict("SAF-1", "a/clear+ghost", ("satisfied",), planned=3)
    html = render(session_record(verdicts=[one]))
    assert "? undecided 0/1 SEC" in section(html, "faults")
    assert '<td class="step-0">' not in html
    one = verdict("SAF-1", "a/clear+ghost", ("violated", "satisfied"))
    assert "1/2 ✗ SEC" in section(render(session_record(verdicts=[one])), "faults")


def test_coverage_tells_verdicts_without_any_run():
    record = session_record()
    words = section(render(record), "matrix")
    assert "4 of 5 cells" in words
    assert "(1 supported, 1 undecided, 2 violated); 1 is untested." in words
    verdicts = [
        replace(one, run=0) if one.verdict == "undecided" else one for one in record.head.verdicts
    ]
    words = section(render(session_record(verdicts=verdicts)), "matrix")
    assert "1 have one without any run that was judged" in words


def test_provenance_tells_inputs_that_changed_and_over_what_a_digest_is():
    record = session_record()
    inputs = [
        {"path": "a.py", "kind": "test", "sha256": None, "changed": False},
        {"path": "b.py", "kind": "test", "sha256": "ab" * 32, "changed": True},
    ]
    under_test = record.head.component_under_test.replace(digest="ef" * 32, file_count=12)
    html = render(session_record(inputs=inputs, component_under_test=under_test))
    words = section(html, "provenance")
    assert "a.py test could not be read" in words
    assert f"{'ab' * 32} changed while the session ran" in words
    assert f"SHA-256 {'ef' * 32} over 12 files" in section(html, "overview")
    assert record.head.environment.blas in words


def test_episodes_that_violated_something_are_listed_first(html):
    pattern = (
        r'<tbody class="entry" id="episode-[^"]*" data-validity="(\w+)" data-violates="([^"]*)"'
    )
    told = [(validity, bool(violates)) for validity, violates in re.findall(pattern, html)]
    assert [each for each in told if each[1]] == told[:2]
    assert [validity for validity, _ in told[2:]][:2] == ["missing", "invalid"]
    listed = re.search(r'<table id="episode-list".*?</table>', html, re.DOTALL)[0]
    assert Page(listed).words.index(VIOLATING) < Page(listed).words.index("a/clear+ghost#3")


def test_a_cause_is_told_with_its_picture_and_leads_to_its_player(tmp_path):
    html = render(record_with_trace(tmp_path))
    card = re.search(r'<article class="card is-violated".*?</article>', html, re.DOTALL)[0]
    words = Page(card).words
    assert "▶ Play it Safety on a/clear+ghost (C)" in words
    assert "SAF-1 1 of 2 runs violates it: gap is -0.5 where more than 0 is required" in words
    assert "first at t = 0.90 s. Never collides. always (gap > 0)" in words
    assert f"Episode {VIOLATING}" in words
    assert f"pytest --dura-replay={VIOLATING!r}" in words
    assert '<div class="picture"><svg' in card
    player = re.search('<details class="player" id="([^"]*)"', html)[1]
    assert f'<a class="button" href="#{player}">' in card


def test_the_page_writes_the_document_once(html):
    document = document_of(session_record())
    page = Page(html)
    words = page.words
    assert html.count('class="gate-word"') == 1
    assert words.count(document.sentence) == 1
    for card in document.cards:
        assert card.headline in words
        for entry in card.entries:
            if entry.kind in ("text", "code"):
                # What stands between backticks is set as code.
                assert " ".join(entry.text.replace("`", "").split()) in words
    for each in document.sections:
        for part in each.parts_for(Shown.PAGE, Level.PAGE):
            if isinstance(part, Text):
                assert all(words.count(line) == 1 for line in part.lines)


@pytest.mark.parametrize("view", ["requirements", "cases", "monitors"])
def test_the_columns_of_a_table_are_explained_below_it_for_those_who_cannot_point(html, view):
    text = section_html(html, view)
    below = text.partition('<details class="meanings">')[2].partition("</details>")[0]
    pointed = re.findall(r'<abbr title="([^"]+)">[^<]+</abbr>', text.partition("</thead>")[0])
    assert pointed
    assert all(meaning in below for meaning in pointed)


def test_a_text_of_several_lines_is_folded_below_its_last_one():
    trace = "Traceback:\n  File a.py\nValueError: <odd>"
    entry = _environment().get_template("macros.html").module.entry
    text = str(entry(Entry("trace", trace, "code"), str))
    assert "<summary>ValueError: &lt;odd&gt;</summary><pre>Traceback:\n  File a.py" in text


def test_rows_of_very_long_tables_are_packed_and_nothing_is_lost(monkeypatch):
    record, plain = session_record(), render(session_record())
    assert "packed" not in re.sub("<script>.*?</script>", "", plain, flags=re.DOTALL)
    monkeypatch.setattr(page_module, "MAX_PLAIN_ROWS", 1)
    monkeypatch.setattr(page_module, "KEPT_ROWS", 1)
    html = render(record)
    assert html.count('class="packed"') >= 3  # verdicts, cases, the matrix
    whole = unpacked(html)
    assert Page(whole).ids == Page(plain).ids
    assert Page(whole).elements["tr"] == Page(plain).elements["tr"] > Page(html).elements["tr"]
    assert stated_counts("report.html", whole) == record.head.totals.to_json()


def test_views_without_anything_to_show_are_not_in_the_navigation():
    record = session_record()
    cases = [case.replace(faults=[]) for case in record.head.cases]
    nothing = {"monitors": [], "effectiveness": [], "hazards": [], "conclusions": {}}
    html = render(session_record(cases=cases, **nothing))
    views = re.findall(r'<li><a href="#([^"]+)">', html.partition("</nav>")[0])
    assert {"overview", "requirements", "cases", "episodes", "matrix", "files"} <= set(views)
    assert not {"faults", "monitors", "failure-modes", "searches", "tables", "hazards"} & set(views)


def test_without_a_commit_no_word_of_one_is_said():
    environment = session_record().head.environment
    git = environment.git.replace(commit=None, dirty=None)
    words = section(render(session_record(environment=environment.replace(git=git))), "overview")
    assert "Run it again" in words
    assert "commit" not in words


def test_episodes_beside_the_plan_are_explained_where_they_are_counted():
    case = session_record().head.cases[0]
    arm = case.replace(id="a/clear~monitor", without=["safety_monitor"])
    arm = arm.replace(metrics=arm.metrics.replace(run=1))
    words = section(render(session_record(cases=[case, arm])), "overview")
    planned = "2 of 2 planned, 1 of the same seeds without safety_monitor, to compare with"
    assert f"6 episodes: {planned}, 3 with a seed chosen by hand" in words


def test_a_test_that_fails_by_itself_is_named_beside_the_verdicts():
    gate = {"result": "failed", "exit_code": 1, "failed": 1, "reasons": ["1 test item failed"]}
    record = session_record(gate=gate, failed_items=["test_it.py::test_own"])
    words = section(render(record), "overview")
    assert words.startswith("Of 4 verdicts, 2 violated, 1 undecided, 1 supported, 1 waived; 1 test")


def test_an_item_that_fails_by_its_verdict_is_counted_as_that_verdict_alone():
    failed = next(each.item for each in session_record().head.verdicts if each.violations)
    gate = {"result": "failed", "exit_code": 1, "failed": 1, "reasons": ["1 test item failed"]}
    words = section(render(session_record(gate=gate, failed_items=[failed])), "overview")
    assert words.startswith("Of 4 verdicts, 2 violated, 1 undecided, 1 supported, 1 waived.")


def test_verdicts_that_were_looked_at_before_share_a_sentence(monkeypatch):
    head = session_record().head
    look = make(LookEntry, violations=0, episodes=3, base_seed=7)
    looks = [(each, [look]) for each in head.verdicts]
    monkeypatch.setattr(wording, "further_looks", lambda _: looks)
    (sentence,) = wording.look_sentences(session_record())
    assert sentence.startswith("4 verdicts on rates were looked at before, and the confidence of")
    place = f"{looks[0][0].requirement} on {looks[0][0].case}"
    assert f"{place} in 1 earlier plan (0 of 3 violated at base seed 7)" in sentence
    assert sentence.endswith(" and 1 more.")


def test_cards_are_bounded_and_the_rest_is_folded():
    count = cards.OPEN_CARDS + 4
    cases = [f"a/c{number}" for number in range(count)]
    entry = session_record().head.cases[0]
    record = session_record(
        cases=[entry.replace(id=case) for case in cases],
        verdicts=[verdict("SAF-1", case, ("violated",)) for case in cases],
        episodes=[episode(case, 0, seed=place) for place, case in enumerate(cases)],
    )
    html = render(record)
    opened, _, folded = section_html(html, "overview").partition('<details class="more">')
    assert opened.count("<article") == cards.OPEN_CARDS
    more = len(causes_of(record)) - cards.OPEN_CARDS
    assert folded.count("<article") == more > 0
    assert f"{more} more causes" in Page(folded).words


def test_the_argument_is_a_tree_with_what_speaks_against_it_first(html):
    tree = section_html(html, "argument")
    words = Page(tree).words
    assert tree.index('class="countergoal') < tree.index('class="strategy')
    assert "Goal GTop" in words
    argument = generated_argument(session_record())
    drawn = set(re.findall(r'<span class="kind">\w+</span> <span class="id">([^<]+)</span>', tree))
    supporting = {id_ for id_, each in argument.items() if each.kind in ("Goal", "Solution")}
    assert {name(id_) for id_ in supporting} <= drawn


def test_a_large_argument_is_cut_off_below_and_says_so(monkeypatch):
    monkeypatch.setattr(bundle_sections, "_MAX_ELEMENTS", 4)
    words = section(render(session_record()), "argument")
    assert "elements are not in this tree" in words
    assert "Goal GTop" in words


def test_every_file_of_a_bundle_is_linked(tmp_path):
    html = render(record_with_trace(tmp_path))
    links = set(Page(section_html(html, "files")).links)
    assert links >= {f"./{file}" for file in ("evidence.json", "manifest.json", *default_files())}
    assert "episodes/ 1 trace as MCAP" in section(html, "files")
    assert "./episodes/one.mcap" in Page(section_html(html, "episodes")).links
    assert "summary.md the session in Markdown" in section(html, "files")


def test_a_mcnemar_test_without_a_pair_has_no_p():
    pairs = dict.fromkeys(
        ("only_with", "only_without", "both", "neither", "acted_both", "acted_neither"), 0
    ) | {
        "without": "recovery_planner",
        "pairs": 3,
        "incomplete": 3,
        "p_value": 1.0,
    }
    one = verdict("SAF-1", "a/clear", ("invalid",) * 3, pairs=pairs)
    words = section(render(session_record(verdicts=[one])), "monitors")
    assert "SAF-1 a/clear 0 (+3 incomplete) 0 0 0 \N{EN DASH} \N{EN DASH} 0 \N{EN DASH}" in words


@pytest.mark.parametrize(
    "text, written",
    [
        ("read `a < <b>` or `c`", "read <code>a &lt; &lt;b&gt;</code> or <code>c</code>"),
        ("an odd ` and <b>", "an odd ` and &lt;b&gt;"),
    ],
)
def test_what_stands_between_backticks_is_set_as_code_and_never_as_markup(text, written):
    entry = _environment().get_template("macros.html").module.entry
    assert str(entry(Entry("next", text), str)).strip() == written


def test_a_name_breaks_behind_its_separators_and_is_no_markup():
    place = _environment().get_template("macros.html").module.place
    assert "a/<wbr>b+<wbr>c~<wbr>d&lt;i&gt;" in str(place("a/b+c~d<i>", None))


def test_a_table_of_requirements_has_no_column_of_zeros():
    table = requirement_table(session_record())
    names = [column.name for column in table.columns]
    assert names == [
        "requirement",
        "kind",
        "text",
        "supported",
        "violated",
        "undecided",
        "untested",
    ]
    supported = [verdict("SAF-1", "a/clear", ("satisfied",))]
    coverage = {"cells": [], "parameters": [], "left_out": 0}
    record = session_record(verdicts=supported, coverage=coverage)
    columns = requirement_table(record).columns
    assert [column.name for column in columns] == ["requirement", "kind", "text", "supported"]
