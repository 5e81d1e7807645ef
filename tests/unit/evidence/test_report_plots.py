"""Plots of the report: what they draw, what they leave out, and how they read without eyes."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from entries import make
from session_records import episode, session_data, session_record, verdict

from pytest_dura.core.metrics import TracedFault
from pytest_dura.evidence import SessionRecord
from pytest_dura.evidence.case_model import PairEntry
from pytest_dura.reports.html.page import render
from pytest_dura.reports.plots import margins, measures
from pytest_dura.reports.plots.faults import CHAIN, FaultPlots, Flow, chain_of, flow_plot
from pytest_dura.reports.plots.margins import MarginPlots
from pytest_dura.reports.plots.measures import MeasurePlots
from pytest_dura.reports.plots.operating_domain import pair_plot
from pytest_dura.reports.plots.strips import Frame, Strip, five_numbers, strip_plot

FRAME = Frame("p", "Title", "time in s", zero=True, against="violated")


def elements(svg, name, class_=None):
    found = ET.fromstring(svg).iter(name)
    return [each for each in found if class_ is None or each.get("class") == class_]


def texts(svg):
    return [each.text for each in elements(svg, "text")]


def ticks(svg):
    lines = elements(svg, "line", "grid")
    named = [each for each in elements(svg, "text", "tick") if re.fullmatch("-?[0-9.]+", each.text)]
    return {
        float(each.text): float(line.get("x1")) for each, line in zip(named, lines, strict=True)
    }


@pytest.mark.parametrize(
    "numbers, five",
    [
        ([], None),
        ([3.0], (3.0,) * 5),
        ([4.0, 1.0, 2.0, 3.0, 5.0], (1.0, 2.0, 3.0, 4.0, 5.0)),
        ([1.0, 2.0], (1.0, 1.25, 1.5, 1.75, 2.0)),
    ],
)
def test_quartiles(numbers, five):
    assert five_numbers(numbers) == five


def test_numbers_stand_where_the_axis_says_and_violations_have_a_shape_of_their_own():
    strip = Strip("a", (-2.0, 0.0, 2.0, 4.0, 10.0), [0.0, 6.0], [-2.0], "\u00d7 1 of 15", True)
    svg = strip_plot([strip], FRAME)
    at = ticks(svg)
    assert [float(each.get("cx")) for each in elements(svg, "circle")] == [at[0.0], at[6.0]]
    (median,) = elements(svg, "line", "median")
    assert float(median.get("x1")) == at[2.0]
    (box,) = elements(svg, "rect", "box plain")
    assert (float(box.get("x")), float(box.get("width"))) == (
        at[0.0], pytest.approx(at[4.0] - at[0.0], abs=0.2)
    )  # fmt: skip
    (cross,) = elements(svg, "path", "cross")
    left, right = map(float, re.findall(r"[ML]([0-9.]+) ", cross.get("d"))[:2])
    assert (left + right) / 2 == pytest.approx(at[-2.0], abs=0.1)
    (zero,) = elements(svg, "line", "zero")
    assert float(zero.get("x1")) == at[0.0]
    (side,) = elements(svg, "rect", "against")
    assert float(side.get("x")) + float(side.get("width")) == pytest.approx(at[0.0], abs=0.2)
    assert "\u2190 violated" in texts(svg)


def test_a_plot_reads_without_eyes():
    svg = strip_plot([Strip("row", None, note="n = 0", group="g")], FRAME)
    root = ET.fromstring(svg)
    assert root.get("role") == "img"
    named = {each.get("id"): each.text for each in root if each.get("id")}
    title, described = (named[each] for each in root.get("aria-labelledby").split())
    assert (title, described) == ("Title", "g row: no number, n = 0.")


@pytest.mark.parametrize("numbers", [(1e308, -1e308), (5.0, 5.0), (0.0,), ()], ids=str)
def test_odd_numbers_give_a_plot(numbers):
    strip = Strip("a", None, numbers)
    svg = strip_plot([strip, Strip("b", five_numbers(numbers))], FRAME)
    assert "nan" not in svg
    assert "inf" not in svg


WAYS = {
    ("planned", "no effect"): 3,
    ("planned", "changed", "changed", "alert", "acted", "tolerated"): 5,
    ("planned", "changed", "not known", "no alert", "did not act", "violated"): 2,
}


def test_a_flow_counts_states_and_ways_and_ends_where_nothing_follows():
    flow = Flow(CHAIN, WAYS, ("planned", "changed", "no effect"), frozenset({"violated"}))
    assert flow.nodes()[:2] == [{"planned": 10}, {"changed": 7, "no effect": 3}]
    assert flow.links()[0, "planned", "changed"] == 7
    assert not [key for key in flow.links() if key[1] == "no effect"]
    svg = flow_plot(flow, "f", "Flow")
    shown = texts(svg)
    assert {"10", "changed: 7", "no effect: 3", "alert: 5", "tolerated: 5"} <= set(shown)
    # A mark beside the colour.
    assert "\u2715 violated: 2" in shown
    heights = [float(each.get("height")) for each in elements(svg, "rect", "node no")]
    assert heights[0] == pytest.approx(90.0)
    assert len(elements(svg, "path")) == len(flow.links())


def test_the_chain_of_a_fault():
    def fault(**changes):
        return make(TracedFault, **{**episode("a+f")["faults"][0], **changes})

    assert chain_of(fault(manifested_at=None)) == ("planned", "no effect")
    assert chain_of(fault()) == (
        "planned", "changed", "changed", "alert", "did not act", "tolerated",
    )  # fmt: skip
    assert chain_of(fault(propagation=None, detected_at=None, recovery_at=1.0, outcome=None)) == (
        "planned", "changed", "not known", "no alert", "acted", "not followed",
    )  # fmt: skip


def test_maps_of_pairs_mark_cells_that_were_never_drawn():
    maps = [
        PairEntry(
            scenario="s", first=first, second=second, drawn=3, met=met, counts=counts, covered=0.5
        )
        for first, second, counts, met in (
            ("a", "b", [[2, 0], [0, 1]], 2), ("a", "c", [[1], [1]], 2), ("b", "c", [[0], [3]], 1),
        )
    ]  # fmt: skip
    svg = pair_plot(["a", "b", "c"], maps, "m", "Pairs")
    assert len(elements(svg, "polyline", "stroke")) == 3
    assert {"2 of 4", "2 of 2", "1 of 2"} <= set(texts(svg))
    described = next(each for each in ET.fromstring(svg) if each.tag == "desc").text
    assert "a with b: 2 of 4 cells." in described
    first = elements(svg, "rect")[0]  # the least part of the second parameter stands below
    second = elements(svg, "rect")[1]
    assert float(first.get("y")) > float(second.get("y"))


def arms_record(**changes):
    """Runs of a scenario in three arms: without a fault, with one, and with it without recovery."""
    names = ("a/clear", "a/clear+ghost", "a/clear+ghost~recovery_planner")
    data = session_data()
    plan = data["cases"][1]
    data["cases"] = [
        {**data["cases"][0], "id": names[0], "scenario": "a/clear"},
        {**plan, "id": names[1], "scenario": "a/clear"},
        {**plan, "id": names[2], "scenario": "a/clear", "without": ["recovery_planner"]},
    ]
    times = {names[0]: [1.0, 2.0, None], names[1]: [3.0, 2.0, 4.0], names[2]: [2.0, None, None]}
    data["episodes"] = []
    for case, numbers in times.items():
        for run, number in enumerate(numbers):
            made = episode(case, run)
            made["outcome"]["measures"] = {"clearance_time": number}
            data["episodes"].append(made)
    extra = episode(names[0], 7, planned=False), episode(names[1], 8, validity="invalid")
    data["episodes"] += extra
    return SessionRecord.of({**data, **changes}, Path("nowhere"))


def gathered(kind, record):
    made = kind(record.head)
    for each in record.episodes():
        made.add(each)
    return made


def test_pairs_of_equal_seeds_differ_by_the_fault_and_by_the_role():
    fault, role = gathered(MeasurePlots, arms_record()).differences("clearance_time")
    assert (fault.change, fault.arm.case, fault.twin.case) == ("ghost", "a/clear+ghost", "a/clear")
    assert (list(fault.numbers), fault.lost, fault.gained, fault.neither) == ([2.0, 0.0], 0, 1, 0)
    assert (role.change, role.twin.without) == ("recovery planner", ("recovery_planner",))
    assert (list(role.numbers), role.lost, role.gained) == ([1.0], 0, 2)


def test_numbers_are_those_of_valid_planned_runs():
    known = gathered(MeasurePlots, arms_record()).numbers["clearance_time"]
    assert known["a/clear", "C"].of_seed == {1000: 1.0, 1001: 2.0}
    assert known["a/clear", "C"].seeds == {1002}
    assert known["a/clear+ghost", "C"].of_seed == {1000: 3.0, 1001: 2.0, 1002: 4.0}


def test_faults_are_followed_where_no_role_lacks():
    data = gathered(FaultPlots, arms_record())
    assert dict(data.chains["ghost"]) == {
        ("planned", "changed", "changed", "alert", "did not act", "tolerated"): 3,
        ("planned", "no effect"): 1,
    }
    detections = data.detections["ghost"]
    assert (detections.manifested, detections.undetected) == (3, 0)
    assert list(detections.latencies["security_assessor"]) == pytest.approx([0.1] * 3)


def section(record):
    return re.search(r'<section id="plots".*?</section>', render(record), re.DOTALL)[0]


def test_the_page_draws_the_arms_of_a_scenario_side_by_side():
    html = section(arms_record())
    labels = re.findall(r'class="case"[^>]*>([^<]*)<', html)
    assert labels[:3] == ["no fault", "ghost", "ghost, without recovery planner"]
    assert "n = 2, \u2715 1 without" in html
    assert "0 less, 1 equal, 1 more" in html
    assert "From faults to outcomes" in html
    assert "Detection latency" in html
    anchors = re.findall(r' id="([^"]+)"', html)
    assert len(anchors) == len(set(anchors))


def two_cases(requirement, *others):
    """Verdicts on a requirement: supported on one case, and on the other what is asked for."""
    return [
        verdict(requirement, "a/clear", ("satisfied",) * 3),
        verdict(requirement, "a/clear+ghost", others),
    ]


def test_margins_have_a_cross_for_each_violating_run_and_the_violated_ones_come_first():
    record = session_record(
        verdicts=[
            *two_cases("SEC-1", *("satisfied",) * 9),
            *two_cases("PERF-1", "violated", "satisfied"),
            *two_cases("SAF-1", "violated", "violated"),
        ]
    )
    html = section(record)
    order = re.findall(r'<details class="folded-plot"( open)?><summary><b>([^<]*)<', html)
    assert order == [(" open", "SAF-1"), (" open", "PERF-1"), ("", "SEC-1")]
    violated = sum(each.violations for each in record.head.verdicts)
    assert html.count('class="cross"') == violated > 0


def test_no_plot_is_of_a_single_case():
    record = session_record()
    html = section(record)
    assert re.findall(r"<summary><b>([A-Z]+-1)<", html) == ["SAF-1"]
    assert "2 requirements are judged on one case alone" in html
    assert "Clearance time by scenario" in html
    alone = arms_record(cases=session_data()["cases"][:1])
    assert "Clearance time by scenario" not in render(alone)


def test_a_session_without_numbers_has_no_plots():
    html = section(session_record(episodes=[]))
    assert "<figure" not in html
    assert "operating domain" not in html
    assert 'id="plots"' not in render(session_record(episodes=[], verdicts=[], measures=[]))


def test_what_is_too_many_is_counted(monkeypatch):
    monkeypatch.setattr(measures, "MAX_ROWS", 2)
    monkeypatch.setattr(margins, "MAX_PLOTS", 1)
    html = section(arms_record())
    assert "1 more cases are not drawn" in html
    two = [*two_cases("SAF-1", "violated"), *two_cases("PERF-1", "violated")]
    assert "1 more requirements are not drawn" in section(session_record(verdicts=two))
    monkeypatch.setattr(measures, "MAX_RUNS", 2)
    assert "1 more runs" in section(arms_record())


def test_thousands_of_verdicts_give_a_page_of_bounded_size():
    base = verdict("SAF-1", "a/clear+ghost", ("satisfied", "violated"))
    few, many = (
        session_record(verdicts=[{**base, "case": f"c{i}"} for i in range(count)])
        for count in (200, 2_000)
    )

    def size(record):
        (plot,) = MarginPlots(record.head).plots()
        return sum(len(each.svg) for each in plot.pictures), plot.pictures[0].left_out

    assert size(few)[0] == pytest.approx(size(many)[0], rel=0.05)
    assert size(many)[1] == f"{2_000 - margins.MAX_MARGIN_ROWS} more cases are not drawn."
