"""Sections of the report on verdicts: requirements, searches, monitors and provenance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

from pytest_dura.core.codec import encode, fields_as_data
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord, components_under_test
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.reports.columns import Shown, shown_in
from pytest_dura.reports.contents import (
    EpisodeLinks,
    ReportContents,
    case_anchor,
    case_key,
    fault_names,
    faults_by_case,
    requirement_anchor,
    split_folded,
    verdict_anchor,
    verdict_key,
)
from pytest_dura.reports.incidents import KINDS
from pytest_dura.reports.role_tables import (
    ATTACK_COLUMNS,
    MONITOR_COLUMNS,
    PAIR_COLUMNS,
    AttackRow,
    MonitorRow,
    PairRow,
    has_fixed_n,
)
from pytest_dura.reports.searches import (
    NOTHING_SUPPORTED,
    baseline_note,
    counterexample_text,
    is_notable_outcome,
    kept_text,
    outcome_headline,
    outcome_rank,
    parameter_changes,
    search_coverage_text,
    searcher_name,
    shrinking_text,
    simulations_text,
)
from pytest_dura.reports.tables import (
    COMPARISON_COLUMNS,
    SEARCH_COLUMNS,
    SEARCHER_COLUMNS,
    VERDICT_COLUMNS,
    OutcomeRow,
    SearcherRow,
)
from pytest_dura.reports.usage import spending_text
from pytest_dura.reports.verdicts import assertion_sentences
from pytest_dura.requirements.campaign_verdicts import violation_text
from pytest_dura.requirements.model import FAULTS, Requirement
from pytest_dura.requirements.monitoring.quality import MonitorQuality
from pytest_dura.requirements.pairs import PairTable
from pytest_dura.requirements.searches import SearcherReport

Data = Mapping[str, Any]


WORST_FIRST = ("violated", "undecided", "supported")
MAX_COUNTEREXAMPLES = 5
"""Counterexamples of a verdict that are named; the list of episodes has more."""


def requirement_section(
    record: SessionRecord, contents: ReportContents, links: EpisodeLinks
) -> Data:
    """The requirements with their verdicts, the worst first, or else in the record's order."""
    several = len({case.component for case in record.head.cases}) > 1
    rows: dict[str, list[Data]] = {}
    anchors: set[str] = set()
    methods: dict[tuple[str, str], int] = {}
    shown, rest = split_folded(record.head.verdicts, contents.folded, verdict_key)
    faults_of = faults_by_case(record)
    folded: dict[str, list[ItemVerdict]] = {}
    for verdict in rest:
        folded.setdefault(verdict.requirement, []).append(verdict)
    shown.sort(key=_verdict_rank)
    for verdict in shown:
        anchor = verdict_anchor(verdict.requirement, verdict.case)
        own = None if anchor in anchors else anchor
        anchors.add(anchor)
        note = methods.setdefault((verdict.bound.method, verdict.method), len(methods) + 1)
        faults = faults_of.get(verdict_key(verdict), ())
        row = {**_verdict_row(verdict, links), "anchor": own, "note": note, "faults": faults}
        rows.setdefault(verdict.requirement, []).append(row)
    ranks = {verdict.requirement: _verdict_rank(verdict) for verdict in reversed(shown)}
    groups = [
        {
            **encode(requirement),
            "declared": True,
            "anchor": requirement_anchor(requirement.id),
            "rows": rows.pop(requirement.id, []),
            "folded": _folded_verdicts(folded.pop(requirement.id, [])),
        }
        for requirement in sorted(
            record.head.requirements,
            key=lambda own: (ranks.get(own.id, len(WORST_FIRST)), KINDS.index(own.kind)),
        )
    ]
    others = [
        {
            **dict.fromkeys((field.name for field in fields(Requirement)), ""),
            "declared": False,
            "id": name,
            "rows": rows.get(name, []),
            "folded": _folded_verdicts(folded.get(name, [])),
        }
        for name in dict.fromkeys([*rows, *folded])
    ]
    for group in groups + others:
        counts = Counter(row["verdict"] for row in group["rows"])
        counts["supported"] += group["folded"]["number"]
        group["counts"] = {status: counts[status] for status in WORST_FIRST if counts[status]}
    return {
        "groups": groups + others,
        "kinds": sorted({requirement.kind for requirement in record.head.requirements}),
        "faults": fault_names(record, contents.folded),
        "several": several,
        "methods": list(methods),
        "columns": shown_in(VERDICT_COLUMNS, Shown.PAGE),
    }


def _verdict_rank(verdict: ItemVerdict) -> int:
    return WORST_FIRST.index(verdict.verdict)


def _folded_verdicts(verdicts: list[ItemVerdict]) -> Data:
    """Sums of the verdicts without rows; all of them are supported, by valid episodes."""
    margins = [verdict.margin for verdict in verdicts if verdict.margin is not None]
    bounds = [verdict.bound.upper for verdict in verdicts if verdict.bound.upper is not None]
    return {
        "number": len(verdicts),
        "episodes": sum(verdict.episodes for verdict in verdicts),
        "vacuous": sum(verdict.vacuous for verdict in verdicts),
        "margin": min(margins, default=None),
        "upper": max(bounds, default=None),
    }


def _verdict_row(verdict: ItemVerdict, links: EpisodeLinks) -> Data:
    shown = verdict.counterexamples[:MAX_COUNTEREXAMPLES]
    return {
        **{field.name: getattr(verdict, field.name) for field in fields(verdict)},
        "verdict_entry": verdict,
        "case_anchor": links.known(case_anchor(verdict.case)),
        "worst": [
            {
                **{
                    field.name: getattr(counterexample, field.name)
                    for field in fields(counterexample)
                },
                "link": links.of_episode(counterexample.episode, verdict.component),
                "when": violation_text(
                    counterexample.time, counterexample.margin, valid=counterexample.valid
                ),
            }
            for counterexample in shown
        ],
        "by_assertion": assertion_sentences(verdict),
        "more": len(verdict.counterexamples) - len(shown),
        "pairs": verdict.pairs if isinstance(verdict.pairs, PairTable) else None,
        "fixed_n": has_fixed_n(verdict),
    }


def monitor_section(record: SessionRecord, _contents: ReportContents, _links: EpisodeLinks) -> Data:
    """Monitors with violations or alarms, how many had neither, and the pairs with recovery."""
    monitors = [
        monitor
        for monitor in record.head.monitors
        if monitor.true_positives + monitor.false_negatives + monitor.false_positives
    ]
    switching = {case_key(case): case.metrics.switching for case in record.head.cases}
    attacks: list[AttackRow] = []
    pairs: list[PairRow] = []
    for verdict in record.head.verdicts:
        anchor = verdict_anchor(verdict.requirement, verdict.case)
        if verdict.pairs is not None and verdict.pairs.without == FAULTS:
            attacks.append(AttackRow(verdict, anchor))
        elif isinstance(verdict.pairs, PairTable):
            pairs.append(
                PairRow(verdict, verdict.pairs, switching.get(verdict_key(verdict)), anchor)
            )
    horizons = sorted({monitor.horizon for monitor in monitors if monitor.horizon is not None})
    return {
        "rows": _joined_targets(monitors),
        "horizons": horizons,
        "silent": len(record.head.monitors) - len(monitors),
        "columns": shown_in(MONITOR_COLUMNS, Shown.PAGE),
        "pairs": pairs,
        "pair_columns": shown_in(PAIR_COLUMNS, Shown.PAGE),
        "attacks": attacks,
        "attack_columns": shown_in(ATTACK_COLUMNS, Shown.PAGE),
        "effectiveness": record.head.effectiveness,
        "several": len({effect.component for effect in record.head.effectiveness}) > 1,
    }


def _joined_targets(monitors: list[MonitorQuality]) -> list[MonitorRow]:
    """Monitors, those that differ in nothing but their target joined into a row."""
    same: dict[MonitorQuality, list[MonitorQuality]] = {}
    for monitor in monitors:
        same.setdefault(replace(monitor, target=""), []).append(monitor)
    return [MonitorRow(alike[0], [entry.target for entry in alike]) for alike in same.values()]


_MAX_SEARCHES = 200
"""Searches that are shown; the record has all."""
MOST_CHANGES = 50


def search_section(record: SessionRecord, _contents: ReportContents, _links: EpisodeLinks) -> Data:
    """The searches, the worst first, with a row for each of their requirements."""
    if not record.head.searches:
        return {}
    ordered = sorted(record.head.searches, key=_search_rank)
    return {
        "searches": [
            {
                **fields_as_data(search),
                "searched": simulations_text(search),
                "coverage": search_coverage_text(search),
                "rows": list(_outcome_rows(search)),
            }
            for search in ordered[:_MAX_SEARCHES]
        ],
        "columns": shown_in(SEARCH_COLUMNS, Shown.PAGE),
        "searcher_columns": shown_in(SEARCHER_COLUMNS, Shown.PAGE),
        "left_out": len(ordered[_MAX_SEARCHES:]),
        "note": NOTHING_SUPPORTED,
    }


def _search_rank(search: RecordedSearch) -> int:
    return min(outcome_rank(search, outcome) for outcome in search.outcomes)


def _outcome_rows(search: RecordedSearch) -> Iterator[Data]:
    for outcome in search.outcomes:
        name, counterexample = outcome.requirement, outcome.counterexample
        notable = is_notable_outcome(search, outcome)
        yield {
            **fields_as_data(outcome),
            "row": OutcomeRow(search, outcome),
            "headline": outcome_headline(search, outcome),
            "baseline_alone": baseline_note(search, outcome),
            "own": _searcher_rows(search.searchers, name) if notable else [],
            "alone": _searcher_rows(search.baselines, name) if notable else [],
            "worst": ""
            if counterexample is None
            else counterexample_text(counterexample, outcome.check),
            "kept": kept_text(outcome),
            "simpler": "" if counterexample is None else shrinking_text(counterexample),
            "changes": []
            if counterexample is None
            else parameter_changes(counterexample, MOST_CHANGES),
            "more": 0 if counterexample is None else len(counterexample.changes[MOST_CHANGES:]),
        }


def _searcher_rows(
    searchers: Sequence[SearcherReport], requirement: str
) -> list[tuple[str, SearcherRow]]:
    return [(searcher_name(each), SearcherRow(each, requirement)) for each in searchers]


def provenance_section(
    record: SessionRecord, _contents: ReportContents, _links: EpisodeLinks
) -> Data:
    """Components, packages, inputs and timings, and the comparisons with the baseline."""
    return {
        "components": components_under_test(record),
        "models": [
            (model, spending_text(model, record.head.llm_price)) for model in record.head.models
        ],
        "packages": sorted(record.head.environment.packages.items()),
        "redacted": sorted(record.head.redacted.items()),
        "inputs": record.head.inputs,
        "timings": record.head.timings,
        "processing": sorted(record.head.timings.processing_seconds.items()),
        "baseline": record.head.baseline,
        "comparison_columns": shown_in(COMPARISON_COLUMNS, Shown.PAGE),
    }
