"""Story: the document of a session, in order of importance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from pytest_dura.evidence.case_model import CaseEntry, ShareEntry
from pytest_dura.evidence.conclusions.effectiveness import RECOVERY_ROLE
from pytest_dura.evidence.gate import (
    NOTHING_FOUND,
    OBJECTIONABLE_OUTCOMES,
    draws_lines,
    failed_items_text,
    not_repeatable_lines,
    outcome_objection,
    outcome_status,
)
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import RecordHead, SessionRecord, Totals
from pytest_dura.evidence.objections import other_objections
from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.evidence.verdict_model import EffectivenessEntry
from pytest_dura.reports.cards import cards_of
from pytest_dura.reports.columns import Shown, measure_label
from pytest_dura.reports.comparisons import baseline_parts
from pytest_dura.reports.document import Document, Level, Part, Section, Table, Text
from pytest_dura.reports.failure_modes import (
    failure_mode_text,
    failure_modes_by_component,
    percent_text,
    uncovered_lines,
)
from pytest_dura.reports.hazards import hazard_line
from pytest_dura.reports.matrices import matrix_sections
from pytest_dura.reports.plots.operating_domain import pair_lines
from pytest_dura.reports.plots.plot import plots_of
from pytest_dura.reports.provenance import episodes_by_hand, provenance_parts, session_facts
from pytest_dura.reports.searches import (
    NOTHING_SUPPORTED,
    is_notable_outcome,
    ordered_outcomes,
    outcome_counts_text,
    outcome_headline,
    search_coverage_text,
    simulations_text,
)
from pytest_dura.reports.session_tables import (
    attack_table,
    case_table,
    failure_mode_tables,
    fault_outcomes,
    fault_table,
    further_tables,
    hazard_table,
    mode_table_of_cases,
    monitor_table,
    pair_table,
    reference_table,
    reliance_table,
    requirement_table,
    search_table,
    searcher_table,
    verdict_table,
)
from pytest_dura.reports.verdicts import reading_sentences
from pytest_dura.reports.wording import (
    beyond_plan_sentences,
    conclusion_sentences,
    coverage_sentence,
    is_incomplete,
    limitation_sentences,
    look_sentences,
    method_sentences,
    names_text,
    roles_off_lines,
    second_engine_text,
    selection_text,
    shard_text,
    supported_sentence,
    taken_over_lines,
)
from pytest_dura.requirements.model import FAULTS
from pytest_dura.requirements.pairs import ChangeTable, PairTable

_MOST_UNTESTED = 10
"""Cells without a verdict that are named."""
_MOST_MODES = 3
"""Failure modes in a line."""
_CANNOT_BE_TOLD = "cannot be told"


def document_of(record: SessionRecord, level: Level = Level.PAGE) -> Document:
    """Make the document of a session's record.

    Args:
        record: The record.
        level: Up to which level of detail plots are drawn.
    """
    sections = [
        Section("Causes", tuple(cards_of(record))),
        Section("Shown", (Text(tuple(conclusion_sentences(record)), shown=Shown.FILES),)),
        Section("Not shown", (Text(tuple(limitation_sentences(record)), shown=Shown.FILES),)),
        *(matrix_sections(record) if level >= Level.PAGE else ()),
        *_case_sections(record, level),
        Section("Searches", tuple(_search_parts(record))),
        *_file_sections(record),
        *_plot_sections(record, level),
        Section("Coverage", tuple(_coverage_parts(record))),
        Section("", tuple(_note_parts(record))),
        Section("Baseline", tuple(baseline_parts(record.head.baseline))),
        Section("About this session", (session_facts(record),)),
        *(Section(title, (part,)) for title, part in provenance_parts(record)),
    ]
    parts = tuple(each for each in sections if each.parts)
    return Document(verdict_line(record), parts, verdict_sentence(record))


def verdict_line(record: SessionRecord) -> str:
    """The gate's result, and the verdicts that it rests on: ``failed, 6 supported, 5 violated``."""
    totals = record.head.totals
    parts = _counted(totals, ("supported", "violated", "undecided", "waived"))
    whose = f"gate of {shard_text(record)}" if shard_text(record) else "gate"
    counts = outcome_counts_text(record)
    text = f"; searches: {counts}" if counts else ""
    words = [totals.gate, *filter(None, [selection_text(record)]), *(parts or ["no verdict"])]
    return f"{whose}: {', '.join(words)}{text}"


def _counted(totals: Totals, statuses: Sequence[str]) -> list[str]:
    return [f"{count} {status}" for status in statuses if (count := getattr(totals, status))]


_NOT_ENDED = {
    "running": "did not end: it still runs, or was killed",
    "interrupted": "was interrupted",
}


def verdict_sentence(record: SessionRecord) -> str:
    """Say what the gate's result rests on: of 11 verdicts, 5 violated, 6 supported."""
    head, totals = record.head, record.head.totals
    if is_incomplete(record):
        how = _NOT_ENDED.get(head.status, "did not come to its end")
        return f"Incomplete: the session {how}. It is no pass, whatever stands below."
    verdicts = counted(len(head.verdicts), "verdict")
    if head.gate.result != "passed":
        if not head.gate.reasons:
            return "No reason is recorded."
        counts = _counted(totals, ("violated", "undecided", "supported", "waived"))
        searches = outcome_counts_text(record)
        text = f"of {verdicts}, {', '.join(counts)}" if counts else "no verdict"
        text += f"; searches: {searches}" if searches else ""
        text += "".join(f"; {one_line(reason)}" for reason in _reasons_without_card(head))
        return f"{text[:1].upper()}{text[1:]}."
    if not head.verdicts:
        return (
            "Nothing failed, and there is no verdict: no requirement is supported by this session."
        )
    waived = ", or waived by name" if totals.waived else ""
    warned = (
        "; undecided ones are let through with a warning, as the command asks"
        if head.gate.warn_undecided
        else ""
    )
    return f"Nothing speaks against it: each of {verdicts} is supported{waived}{warned}."


def _reasons_without_card(head: RecordHead) -> list[str]:
    """Reasons of the gate that rest on no verdict, on no search and on no objection."""
    with_card = {f"{each.requirement} on {each.case} is {each.verdict}" for each in head.verdicts}
    with_card.update(
        outcome_objection(outcome.requirement, search.case, outcome_status(search, outcome))
        for search in head.searches
        for outcome in search.outcomes
        if outcome_status(search, outcome) in OBJECTIONABLE_OUTCOMES
    )
    with_card.update(other_objections(head))
    # Items that failed by their verdict alone have its card.
    items = [each.item for each in head.verdicts if each.verdict != "supported"]
    items += [search.item for search in head.searches]
    judged = {item for named in items for item in named.split(", ")}
    if judged.issuperset(head.failed_items or ()):
        with_card.add(failed_items_text(head.gate.failed))
    return [reason for reason in head.gate.reasons if reason not in with_card]


def _case_sections(record: SessionRecord, level: Level) -> Iterator[Section]:
    """What was run, the table of cases, further tables, and what roles and faults did."""
    head = record.head
    if head.cases:
        yield Section("", tuple(_session_parts(record)))
    # Runs without a role that serve a comparison are shown in its table.
    twins = {verdict.pairs.case for verdict in head.verdicts if verdict.pairs}
    cases = [case for case in head.cases if not case.without or case.id not in twins]
    table = case_table(cases, head.overall, head.measures, head.verdicts)
    all_cases = replace(case_table(head.cases, head.overall, head.measures), notes=())
    yield Section(
        "Cases",
        (replace(table, shown=Shown.TERMINAL), replace(all_cases, shown=Shown.SUMMARY),
         *_terminal(_after_cases(record))),
    )  # fmt: skip
    for title, further in further_tables(record):
        heading = _terminal([one_line(title)], further.weight)
        yield Section(title, (*heading, replace(further, view="tables")))
    yield Section("Details", tuple(_detail_parts(record, cases, level)))
    readings = [
        f"{name(verdict.requirement)} on {name(verdict.case)}: {sentence}"
        for verdict in head.verdicts
        for sentence in reading_sentences(verdict)
    ]
    readings += method_sentences(head.verdicts)
    yield Section("Verdicts", (verdict_table(record), *_terminal(readings, Level.SUMMARY)))


def _file_sections(record: SessionRecord) -> Iterator[Section]:
    """Tables that the terminal has not: hazards, requirements, what decisions showed and used."""
    files = {
        "Hazards": hazard_table(record),
        "Requirements": requirement_table(record),
        "Failure modes by case": mode_table_of_cases(record.head.cases),
    }
    for title, table in files.items():
        if table is not None:
            yield Section(title, (table,))


def _plot_sections(record: SessionRecord, level: Level) -> Iterator[Section]:
    """Plots; formats without pictures have the title and the words of those with words."""
    for plot in plots_of(record, level) if level > Level.TERMINAL else ():
        words = _terminal([one_line(plot.title)], plot.weight) if plot.lines else ()
        shown = plot.shown if plot.lines else Shown.PAGE
        yield Section(plot.title, (*words, replace(plot, shown=shown)))


def _terminal(
    lines: Sequence[str] | Iterator[str], weight: Level = Level.TERMINAL, view: str = ""
) -> list[Text]:
    """Lines of the terminal, and of a view of the page where one is named."""
    lines = tuple(lines)
    shown = Shown.TERMINAL | Shown.PAGE if view else Shown.TERMINAL
    return [Text(lines, weight, shown, view=view)] if lines else []


def _session_parts(record: SessionRecord) -> Iterator[Part]:
    head = record.head
    names = sorted({case.component for case in head.cases if not case.reference})
    opaque = " (a bare instance, in this process only)" if head.component_under_test.opaque else ""
    yield from _terminal(
        [f"component under test: {', '.join(names)}{opaque}, base seed {head.base_seed}"]
    )
    if off := roles_off_lines(record):
        yield Text(tuple(off), shown=Shown.TERMINAL, status="undecided")


def _after_cases(record: SessionRecord) -> Iterator[str]:
    ended_early = sum(case.metrics.ended_early for case in record.head.cases)
    if ended_early:
        text = "ended early, once all was decided; figures are up to then"
        yield f"{counted(ended_early, 'episode')} {text}"
    if record.head.resume.resumed:
        yield from taken_over_lines(record.head.resume, record.head.totals.episodes, "episode")
    by_hand = episodes_by_hand(record)
    if by_hand:
        yield f"and {counted(by_hand, 'episode')} with a seed chosen by hand"


# What roles, faults and the component did: a line each, and with more detail a table.


def _detail_parts(
    record: SessionRecord, cases: Sequence[CaseEntry], level: Level
) -> Iterator[Part]:
    head = record.head
    outcomes = fault_outcomes(record) if level >= Level.PAGE else {}
    modes = tuple(failure_mode_tables(cases))
    roles, uncovered = head.effectiveness, list(uncovered_lines(head))
    recovery = list(effectiveness_lines(roles, recovery=True))
    monitors = list(effectiveness_lines(roles, recovery=False))
    further = [one_line(line) for table in head.conclusions.values() for line in table.lines]
    groups: list[tuple[list[str], Sequence[Table | None], str]] = [
        ([*_failure_mode_lines(cases)], modes, "failure_modes"),
        (uncovered, [], "failure_modes"),
        (further, [], "tables"),
        ([*_reliance_lines(record)], [reliance_table(cases, head.overall, head.measures)], ""),
        ([*_fault_lines(cases)], [fault_table(cases, head.verdicts, outcomes)], "faults"),
        ([*_attack_lines(record)], [attack_table(head.verdicts, head.cases)], "monitors"),
        (recovery, [pair_table(head.verdicts, head.cases)], "monitors"),
        ([*_reference_lines(head.verdicts)],
         [reference_table(head.verdicts, head.cases)], "monitors"),
        (monitors, [monitor_table(head.monitors)], "monitors"),
    ]  # fmt: skip
    for lines, tables, view in groups:
        yield from _terminal(lines, view=view)
        yield from (table for table in tables if table is not None)
    unknown = [
        *effectiveness_lines(roles, recovery=True, known=False),
        *effectiveness_lines(roles, recovery=False, known=False),
    ]
    yield from _terminal(unknown, Level.SUMMARY, "monitors")
    # The summary has the tables of cases alone, and what follows from the others.
    if texts := (*recovery, *monitors, *unknown, *uncovered):
        yield Text(texts, Level.SUMMARY, Shown.SUMMARY)
    yield from _terminal(_reading_lines(head.verdicts))
    supported = [supported_sentence(head.verdicts)] if head.verdicts else []
    yield from _terminal([*supported, *look_sentences(record), *beyond_plan_sentences(record)])


def effectiveness_lines(
    entries: Sequence[EffectivenessEntry], *, recovery: bool, known: bool = True
) -> Iterator[str]:
    """Write what the runs show of recovery or of monitors, a sentence each.

    Args:
        entries: The record's ``effectiveness``.
        recovery: Of recovery alone, or of all other roles.
        known: What the runs show, or that they cannot show it. How seldom recovery introduces
            something they show in any case.
    """
    several = len({entry.component for entry in entries}) > 1
    for entry in entries:
        of_recovery = entry.role == RECOVERY_ROLE
        shown = of_recovery or entry.finding != _CANNOT_BE_TOLD
        if of_recovery == recovery and shown == known:
            whose = f" with {name(entry.component)}" if several else ""
            yield name(f"{entry.role}{whose}: {entry.detail}", 500)


def _reading_lines(verdicts: Sequence[ItemVerdict]) -> Iterator[str]:
    """What tests decided by assertions of their own, and checks that were false all the same."""
    alone = [each for each in verdicts if each.assertion is not None and each.assertion.alone]
    if alone:
        names = names_text(list(dict.fromkeys(each.requirement for each in alone)))
        yield (
            f"{counted(len(alone), 'verdict')} by assertions of tests alone ({names}): -v says "
            "what the tests looked at"
        )
    for verdict in verdicts:
        for sentence in reading_sentences(verdict):
            if sentence.startswith("false in "):
                yield f"{name(verdict.requirement)} on {name(verdict.case)}: {sentence}"


def _failure_mode_lines(cases: Sequence[CaseEntry]) -> Iterator[str]:
    by_component = failure_modes_by_component(cases)
    for component, modes in by_component.items():
        seen = [mode for mode in modes if mode.kind == "failure" and mode.of]
        if not seen:
            continue
        worst = sorted((mode for mode in seen if mode.hits), key=lambda mode: -(mode.share or 0.0))
        parts = [
            f"{failure_mode_text(mode.name)} {percent_text(mode.share)} %"
            for mode in worst[:_MOST_MODES]
        ]
        whose = f" of {component}" if len(by_component) > 1 else ""
        counts = f"{len(worst)} of {len(seen)} shown by decisions"
        yield one_line(
            ": ".join([f"failure modes{whose}: {counts}", *filter(None, [", ".join(parts)])])
        )


def _reliance_lines(record: SessionRecord) -> Iterator[str]:
    """How often recovery acted, its measures, and how the component reacted to attacks."""
    own = [measure for measure in record.head.measures if measure.table == "reliance"]
    several = len(record.head.overall) > 1
    for total in record.head.overall:
        metrics = total.metrics
        parts = []
        if metrics.rescued is not None and metrics.rescued.valid:
            share = metrics.switching.share if metrics.switching else None
            time = "" if share is None else f" ({percent_text(share)} % of the time)"
            parts.append(f"recovery in {metrics.rescued.valid} of {metrics.valid} runs{time}")
        for measure in own:
            value = metrics.measures.get(measure.name)
            if isinstance(value, ShareEntry) and value.valid:
                runs = counted(metrics.valid, "run")
                parts.append(f"{measure_label(measure)} in {value.valid} of {runs}")
        reactions = [f"{count} {reaction}" for reaction, count in metrics.reactions.items()]
        parts += [f"reactions: {', '.join(reactions)}"] if reactions else []
        if parts:
            whose = f" of {total.component}" if several else ""
            yield one_line(f"reliance{whose}: {'; '.join(parts)}")


def _fault_lines(cases: Sequence[CaseEntry]) -> Iterator[str]:
    """How far the planned faults got, over all cases."""
    faults = [fault for case in cases for fault in case.metrics.faults]
    if not faults:
        return
    names = len({fault.id for fault in faults})
    counts = {
        "activated": sum(fault.activated for fault in faults),
        "manifested": sum(fault.manifested for fault in faults),
        "propagated": sum(fault.propagated for fault in faults),
        "detected": sum(fault.detected for fault in faults),
        "violated": sum(fault.violated for fault in faults),
    }
    steps = ", ".join(f"{count} {step}" for step, count in counts.items())
    runs = counted(sum(fault.run for fault in faults), "run")
    yield f"fault: {counted(names, 'fault')} in {runs}: {steps}"


def _reference_lines(verdicts: Sequence[ItemVerdict]) -> Iterator[str]:
    """What a reference would have avoided of the violations, summed by requirement."""
    sums: dict[tuple[str, str], Counter[str]] = {}
    for verdict in verdicts:
        pairs = verdict.pairs
        if isinstance(pairs, PairTable) and pairs.reference and not pairs.without:
            counts = sums.setdefault((verdict.requirement, pairs.reference), Counter())
            counts["avoidable"] += pairs.avoidable
            counts["unavoidable"] += pairs.unavoidable
            counts["pairs"] += pairs.complete
    for (requirement, reference), counts in sums.items():
        violated = counts["avoidable"] + counts["unavoidable"]
        text = f"{name(reference)} avoids {counts['avoidable']} of {counted(violated, 'violation')}"
        yield (
            f"reference: {text} of {name(requirement)} in {counted(counts['pairs'], 'pair')}; "
            f"{counts['unavoidable']} unavoidable"
        )


def _attack_lines(record: SessionRecord) -> Iterator[str]:
    """What pairs with and without faults came to, each measure in its unit."""
    head = record.head
    compared = [each for each in head.verdicts if each.pairs and each.pairs.without == FAULTS]
    counts = [each.pairs for each in compared if isinstance(each.pairs, PairTable)]
    parts: dict[tuple[str, str], str] = {}
    of_case = {case.id: "+".join(fault.id for fault in case.faults) for case in head.cases}
    asked = {each.id: each.paired for each in head.requirements}
    pairs_before, sentences = 0, list[str]()
    for verdict in compared:
        paired = verdict.paired or asked.get(verdict.requirement)
        if not isinstance(verdict.pairs, ChangeTable) or paired is None:
            continue
        change = verdict.pairs.change
        key = verdict.case, paired.measure
        if change.mean is None or key in parts:
            continue
        unit = next((each.unit for each in head.measures if each.function == paired.measure), "")
        measure = name(paired.measure.rpartition(":")[2].replace("_", " "))
        growth = f"{abs(change.mean):.2g}{f' {name(unit)}' if unit else ''}"
        what = "costs" if change.mean >= 0 else "saves"
        pairs = "" if change.n == pairs_before else f" ({counted(change.n, 'pair')})"
        pairs_before = change.n
        mean = f" of {measure} in the mean" if not parts else ""
        parts[key] = (
            f"{name(of_case.get(verdict.case) or verdict.case)} {what} {growth}{mean}{pairs}"
        )
    if counts:
        caused = sum(pairs.only_with for pairs in counts)
        spared = sum(pairs.only_without for pairs in counts)
        pairs_judged = counted(sum(pairs.pairs for pairs in counts), "pair")
        sentences.append(f"faults caused {caused} violations and spared {spared} in {pairs_judged}")
    if parts:
        sentences.append(", ".join(parts.values()))
    if sentences:
        yield f"attack: {'; '.join(sentences)}"


# Coverage, searches, notes.


def _coverage_parts(record: SessionRecord) -> Iterator[Part]:
    """Cells without a verdict, and what was drawn of pairs of parameters."""
    cells = [cell for cell in record.head.coverage.cells if cell.verdict is None]
    named = [f"{name(cell.requirement)} on {name(cell.case)}" for cell in cells[:_MOST_UNTESTED]]
    lines = [coverage_sentence(record), *(f"untested: {each}" for each in named)]
    rest = len(cells) - len(named) + record.head.coverage.left_out
    lines += [f"and {rest} more"] if rest else []
    yield Text(tuple(lines), Level.SUMMARY, Shown.SUMMARY)
    if pairs := tuple(pair_lines(record.head)):
        yield Text(pairs, Level.SUMMARY, Shown.SUMMARY)


def _search_parts(record: SessionRecord) -> Iterator[Part]:
    """What searches looked for: those with a violation have cards, and here their searchers."""
    if not record.head.searches:
        return
    if (table := search_table(record)) is not None:
        yield table
    nothing = []
    for search, outcome in ordered_outcomes(record):
        where = f" on {name(search.case)} ({name(search.component)})"
        if outcome_status(search, outcome) == NOTHING_FOUND:
            effort = f"{simulations_text(search)}; seed {search.seed}"
            nothing.append(f"search: {outcome_headline(search, outcome, where)}; {effort}")
        if is_notable_outcome(search, outcome):
            about = f"search for violations of {name(outcome.requirement)}{where}:"
            yield from _terminal([about], Level.SUMMARY)
            yield searcher_table(search, outcome.requirement)
    if nothing:
        lines = [*(one_line(text, 1000) for text in nothing), NOTHING_SUPPORTED]
        yield from _terminal(lines, view="searches")
    yield Text(
        tuple(
            one_line(
                f"{name(search.case)} with {name(search.component)} is searched by "
                f"{name(search.item)}: {simulations_text(search)}; seed {search.seed}; "
                f"{search.rule}; simulated: {search_coverage_text(search)}",
                2000,
            )
            for search in record.head.searches
        ),
        shown=Shown.PAGE,
        view="searches",
    )


def _note_parts(record: SessionRecord) -> Iterator[Part]:
    head = record.head
    searched = head.resume.searched
    if searched is not None and searched.simulations:
        yield from _terminal(
            taken_over_lines(searched, searched.simulations, "run", " of searches")
        )
    yield from _terminal(head.resume.problems)
    repeats = [*not_repeatable_lines(head.cases), *draws_lines(head.cases)]
    known = [line for line in repeats if line not in head.gate.reasons]
    if known:
        yield Text(tuple(known), shown=Shown.TERMINAL, status="undecided")
    if engine := second_engine_text(record):
        yield from _terminal([f"formulas: {engine}"])
    if hazards := hazard_line(record):
        yield from _terminal([hazards])
