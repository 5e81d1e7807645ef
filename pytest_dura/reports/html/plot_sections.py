"""Section of the report with plots, and the coverage of the operating domain."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from pytest_dura.core.measures import MeasureInfo
from pytest_dura.evidence.case_model import PairEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import counted, name
from pytest_dura.reports.columns import measure_label, role_name
from pytest_dura.reports.contents import (
    EpisodeLinks,
    ReportContents,
    split_folded,
    verdict_key,
)
from pytest_dura.reports.incidents import KINDS
from pytest_dura.reports.operating_domain import combination_text, pair_text
from pytest_dura.reports.plot_data import (
    ACTED,
    ALERT,
    CHAIN,
    CHANGED,
    NO_ALERT,
    NO_EFFECT,
    NOT_ACTED,
    NOT_FOLLOWED,
    PLANNED,
    UNCHANGED,
    UNKNOWN,
    VIOLATED,
    Arm,
    Differences,
    Numbers,
    PlotData,
    arms_in_order,
)
from pytest_dura.reports.plots import (
    FiveNumbers,
    Flow,
    Frame,
    PairMap,
    Strip,
    five_numbers,
    flow_plot,
    pair_plot,
    strip_plot,
)
from pytest_dura.reports.svg import Svg
from pytest_dura.requirements.campaign_verdicts import Margins

Data = Mapping[str, Any]

MAX_MEASURES = 6
MAX_ROWS = 48
"""Rows of a plot."""
MAX_DOTS = 60
"""Runs of a row that are drawn one by one; of more the box alone."""
MAX_CROSSES = 60
MAX_MARGIN_PLOTS = 40
MAX_MARGIN_ROWS = 16
MAX_OPEN = 6
"""Plots of margins that are unfolded."""
MAX_FLOWS = 6
MAX_MAPS = 8
MAX_MAPPED = 8
"""Parameters of a scenario whose pairs are drawn."""
MAX_LISTED_PAIRS = 20


def plot_section(record: SessionRecord, contents: ReportContents, _links: EpisodeLinks) -> Data:
    """The plots, each with what it leaves out, and the table of pairs.

    Empty where there is nothing to be drawn: no plot is of a single case.
    """
    measures = [each for each in record.head.measures if each.shown == "mean"]
    arms = [Arm.of(case) for case in record.head.cases]
    drawn = arms_in_order(arm for arm in arms if arm.key not in contents.folded)[:MAX_ROWS]
    data = PlotData(
        arms, [each.name for each in measures[:MAX_MEASURES]], [arm.key for arm in drawn]
    )
    for episode in record.episodes():
        data.add(episode)
    shown = [each for each in measures[:MAX_MEASURES] if len(data.measures[each.name]) > 1]
    plots: dict[str, Any] = {
        "measures": [
            _measure_plot(data, each, i, len(arms) - len(drawn)) for i, each in enumerate(shown)
        ],
        "measures_left_out": len(measures[MAX_MEASURES:]),
        "differences": [
            plot
            for i, each in enumerate(shown)
            if (plot := _difference_plot(data, each, i)) is not None
        ],
        **_margin_plots(record, contents),
        "detection": _detection_plot(data),
        **_flows(data),
        **_pair_maps(record),
    }
    drawn_ones = ("measures", "differences", "margins", "detection", "flows", "combinations")
    return plots if any(plots[each] for each in drawn_ones) else {}


def _dots(numbers: Sequence[float]) -> Sequence[float]:
    return numbers if len(numbers) <= MAX_DOTS else ()


def _bounded(rows: Sequence[Strip]) -> tuple[Sequence[Strip], int]:
    return rows[:MAX_ROWS], len(rows[MAX_ROWS:])


def _unit(measure: MeasureInfo) -> str:
    label = name(measure_label(measure))
    return f"{label} in {name(measure.unit)}" if measure.unit else label


def _group(arm: Arm, *, several: bool) -> str:
    return f"{arm.scenario} with {arm.component}" if several else arm.scenario


def _measure_plot(data: PlotData, measure: MeasureInfo, place: int, left_out: int) -> Data:
    known = data.measures[measure.name]
    arms = arms_in_order(data.arms[key] for key in data.arms if key in known)
    several = len({arm.component for arm in arms}) > 1
    rows = [_measure_strip(arm, known[arm.key], _group(arm, several=several)) for arm in arms]
    title = f"{name(measure_label(measure)).capitalize()} by scenario"
    frame = Frame(f"measure-{place}", title, _unit(measure))
    return {
        "measure": measure,
        "title": title,
        "svg": strip_plot(rows, frame),
        "rows": [
            {"arm": arm, "n": len(known[arm.key].of_seed), "none": len(known[arm.key].seeds),
             "five": row.five}
            for arm, row in zip(arms, rows, strict=True)
        ],
        "left_out": left_out,
    }  # fmt: skip


def _measure_strip(arm: Arm, numbers: Numbers, group: str) -> Strip:
    values = list(numbers.of_seed.values())
    apart = len(numbers.seeds)
    note = f"n = {len(values)}" + (f", \N{MULTIPLICATION X} {apart} without" if apart else "")
    note += f", {numbers.left_out} more runs" if numbers.left_out else ""
    five = five_numbers(values)
    return Strip(arm.label, five, _dots(values), (), note, apart > 0, group, arm.form)


def _difference_plot(data: PlotData, measure: MeasureInfo, place: int) -> Data | None:
    known = list(data.differences(measure.name))
    if not known:
        return None
    several = len({each.arm.component for each in known}) > 1
    strips = [_difference_strip(each, _group(each.arm, several=several)) for each in known]
    order = {group: i for i, group in reversed(list(enumerate(each.group for each in strips)))}
    strips.sort(key=lambda strip: order[strip.group])
    rows, left_out = _bounded(strips)
    title = f"Differences of {name(measure_label(measure))} in pairs of equal seeds"
    frame = Frame(
        f"difference-{place}", title, f"with minus without, {_unit(measure)}", right=300.0,
        width=1060.0, zero=True,
    )  # fmt: skip
    return {"measure": measure, "title": title, "svg": strip_plot(rows, frame),
            "left_out": left_out}  # fmt: skip


_EQUAL = 1e-9
"""Differences up to this are rounding: times are sums of steps."""


def _difference_strip(each: Differences, group: str) -> Strip:
    numbers = each.numbers
    less = sum(number < -_EQUAL for number in numbers)
    more = sum(number > _EQUAL for number in numbers)
    note = f"{less} less, {len(numbers) - less - more} equal, {more} more"
    if each.lost or each.gained:
        note += f"; \N{MULTIPLICATION X} {each.lost} lost, {each.gained} gained"
    if each.arm.faults and each.change != "+".join(each.arm.faults):
        label = f"{each.change}, under {'+'.join(each.arm.faults)}"
    else:
        label = each.change
    five = five_numbers(numbers)
    form = each.twin.form if each.twin.without else each.arm.form
    return Strip(label, five, _dots(numbers), (), note, bool(each.lost), group, form)


_STATUS_ORDER = ("violated", "undecided", "supported")


def _margin_plots(record: SessionRecord, contents: ReportContents) -> Data:
    """One plot for each requirement with margins: violated ones first, safety before comfort."""
    by_requirement: dict[str, list[ItemVerdict]] = defaultdict(list)
    bare = 0
    for verdict in record.head.verdicts:
        if verdict.margins is None:
            bare += 1
        else:
            by_requirement[verdict.requirement].append(verdict)
    kinds = {
        requirement.id: KINDS.index(requirement.kind) for requirement in record.head.requirements
    }

    def worst(requirement: str) -> tuple[int, bool, int]:
        own = by_requirement[requirement]
        status = min(_STATUS_ORDER.index(verdict.verdict) for verdict in own)
        clean = not any(verdict.violations for verdict in own)
        return status, clean, kinds.get(requirement, len(KINDS))

    order = sorted((own for own in by_requirement if len(by_requirement[own]) > 1), key=worst)
    plots = [
        _margin_plot(requirement, by_requirement[requirement], i, contents)
        for i, requirement in enumerate(order[:MAX_MARGIN_PLOTS])
    ]
    return {
        "margins": plots,
        "margins_left_out": len(order[MAX_MARGIN_PLOTS:]),
        "without_margins": bare,
        "single": len(by_requirement) - len(order),
    }


def _margin_plot(
    requirement: str, verdicts: Sequence[ItemVerdict], place: int, contents: ReportContents
) -> Data:
    several = len({verdict.component for verdict in verdicts}) > 1
    shown, rest = split_folded(verdicts, contents.folded, verdict_key)
    ordered = sorted(shown, key=lambda verdict: (verdict.margin is None, verdict.margin or 0.0))
    drawn = ordered[:MAX_MARGIN_ROWS]
    rows = [_margin_strip(verdict, several=several) for verdict in drawn]
    violations = sum(verdict.violations for verdict in verdicts)
    frame = Frame(
        f"margin-{place}", f"Margins of {name(requirement)}", "margin, in the unit of the check",
        width=640.0, left=215.0, right=110.0, zero=True, against="violated",
    )  # fmt: skip
    return {
        "requirement": requirement,
        "violating": counted(violations, "violating run") if violations else "",
        "svg": strip_plot(rows, frame),
        "left_out": len(ordered) - len(drawn) + len(rest),
        "open": bool(violations) and place < MAX_OPEN,
    }


def _margin_strip(verdict: ItemVerdict, *, several: bool) -> Strip:
    margins = verdict.margins
    assert margins is not None  # verdicts without any have no row
    crosses = [
        each.margin for each in verdict.counterexamples if each.valid and each.margin is not None
    ]
    note = f"\N{MULTIPLICATION X} {verdict.violations} of {margins.n}"
    if not verdict.violations:
        note = f"0 of {margins.n}"
    label = f"{verdict.case} {verdict.component}" if several else verdict.case
    return Strip(label, _box_of(margins), (), crosses[:MAX_CROSSES], note, verdict.violations > 0)


def _box_of(margins: Margins) -> FiveNumbers | None:
    """The quartiles; of margins without an end those alone that are finite."""
    known = [margins.min, margins.q25, margins.median, margins.q75, margins.max]
    # The quartiles of five numbers are these numbers.
    return five_numbers(each for each in known if each is not None)


def _detection_plot(data: PlotData) -> Data | None:
    strips: list[Strip] = []
    for fault, known in sorted(data.detections.items()):
        group = f"{fault}: manifested in {counted(known.manifested, 'run')}"
        for role, latencies in sorted(known.latencies.items()):
            values = list(latencies)
            note = f"n = {len(values)}"
            strips.append(
                Strip(role_name(role) or "alert", five_numbers(values), _dots(values), (), note,
                      group=group, form="filled")
            )  # fmt: skip
        if known.undetected:
            note = f"\N{MULTIPLICATION X} {known.undetected} of {known.manifested}"
            strips.append(Strip("not detected", None, (), (), note, alarming=True, group=group))
    if not strips:
        return None
    rows, left_out = _bounded(strips)
    frame = Frame(
        "detection", "Detection latency by fault and role", "from activation to the alert, in s",
        right=120.0,
    )  # fmt: skip
    return {"svg": strip_plot(rows, frame), "left_out": left_out}


_OUTCOMES = ("violated", "violated also without it", "tolerated", "contained", "masked", "idle",
             "missing", NOT_FOLLOWED)  # fmt: skip
_ORDER = (
    PLANNED, CHANGED, ALERT, ACTED, UNCHANGED, NO_ALERT, NOT_ACTED, UNKNOWN, NO_EFFECT, *_OUTCOMES
)  # fmt: skip
_ON_ITS_WAY = frozenset({PLANNED, CHANGED, ALERT, ACTED})


def _flows(data: PlotData) -> Data:
    """The chains of the faults that violated most, then of those that ran most."""

    def worst_first(fault: str) -> tuple[int, int, str]:
        ways = data.chains[fault]
        violated = sum(runs for way, runs in ways.items() if way[-1] == VIOLATED)
        return -violated, -ways.total(), fault

    order = sorted(data.chains, key=worst_first)
    flows = []
    for i, fault in enumerate(order[:MAX_FLOWS]):
        flow = Flow(CHAIN, data.chains[fault], _ORDER, frozenset({VIOLATED}), _ON_ITS_WAY)
        title = f"From the fault {name(fault)} to its outcome"
        flows.append({"fault": fault, "svg": flow_plot(flow, f"flow-{i}", title)})
    return {"flows": flows, "flows_left_out": len(order[MAX_FLOWS:])}


def _pair_maps(record: SessionRecord) -> Data:
    known = record.head.coverage.combinations
    if known is None:
        return {"combinations": "", "maps": [], "maps_left_out": 0, "worst": []}
    by_scenario: dict[str, list[PairEntry]] = defaultdict(list)
    for pair in known.worst:
        by_scenario[pair.scenario].append(pair)
    maps = [
        {"scenario": scenario, **_pair_map(scenario, pairs, i)}
        for i, (scenario, pairs) in enumerate(list(by_scenario.items())[:MAX_MAPS])
    ]
    return {
        "combinations": combination_text(known),
        "maps": maps,
        "maps_left_out": len(list(by_scenario)[MAX_MAPS:]),
        "worst": [
            (pair, pair_text(pair)) for pair in known.worst[:MAX_LISTED_PAIRS] if pair.covered < 1
        ],
    }


def _pair_map(scenario: str, pairs: Sequence[PairEntry], place: int) -> Mapping[str, Svg | int]:
    names: dict[str, None] = {}
    for pair in sorted(pairs, key=lambda pair: (pair.first, pair.second)):
        names.update({pair.first: None, pair.second: None})
    parameters = sorted(names)[:MAX_MAPPED]
    shown = [
        PairMap(pair.first, pair.second, pair.counts, pair.met)
        for pair in pairs
        if pair.first in parameters and pair.second in parameters
    ]
    title = f"Pairs of parameters of {name(scenario)}"
    return {
        "svg": pair_plot(parameters, shown, f"pairs-{place}", title),
        "left_out": len(pairs) - len(shown),
    }
