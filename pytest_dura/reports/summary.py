"""``summary.md``: the session on one page of GitHub-flavoured Markdown, for the page of a CI job.

GitHub takes at most 1024 KiB. Each table has its share of that and begins with what failed;
what does not fit is left out, and a sentence says how much. No text of a user is a link, a
mention, HTML or the end of a cell.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, groupby
from typing import TypeVar

from pytest_dura.evidence.case_model import ShareEntry
from pytest_dura.evidence.conclusions.totals import verdict_counts
from pytest_dura.evidence.gate import OBJECTIONABLE_OUTCOMES, outcome_status
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord, components_under_test
from pytest_dura.evidence.session_model import (
    LanguageModelEntry,
    PriceEntry,
)
from pytest_dura.evidence.text import code, markdown, name
from pytest_dura.reports.causes import Cause, card_entries, card_heading, causes_of
from pytest_dura.reports.columns import Column, Shown, measure_label, shown_in
from pytest_dura.reports.concluded import TableShown, concluded_tables
from pytest_dura.reports.failure_modes import (
    NULL_NOTE,
    decision_age_lines,
    decision_time_lines,
    failure_modes_by_component,
    judge_agreement_lines,
    unavailability_text,
    uncovered_lines,
)
from pytest_dura.reports.hazards import HAZARD_COLUMNS, hazards_by_need
from pytest_dura.reports.operating_domain import combination_text, pair_text
from pytest_dura.reports.role_tables import FailureModeRow, failure_mode_columns
from pytest_dura.reports.searches import ordered_outcomes, outcome_headline
from pytest_dura.reports.tables import (
    REQUIREMENT_COLUMNS,
    SEARCH_COLUMNS,
    VERDICT_COLUMNS,
    OutcomeRow,
    RequirementRow,
    case_columns,
)
from pytest_dura.reports.usage import spending_text, usage_columns, usage_rows
from pytest_dura.reports.verdicts import (
    assertion_sentences,
    rate_bound,
    sample_text,
    waiver_note,
)
from pytest_dura.reports.wording import (
    conclusion_sentences,
    evidence_option,
    is_incomplete,
    limitation_sentences,
    merge_text,
    model_options,
    replay_command,
    review_text,
    second_engine_text,
    selection_text,
    shard_text,
)
from pytest_dura.requirements.campaign_verdicts import Counterexample, violation_text
from pytest_dura.requirements.model import Requirement


def _model_lines(record: SessionRecord, most: int) -> Iterator[str]:
    """A line for each entry of the record's key ``models``.

    Args:
        record: Of the session.
        most: The greatest number of lines; a last line says how many entries are left out.
    """
    models = record.head.models
    yield from (_model_line(model, record.head.llm_price) for model in models[:most])
    if len(models) > most:
        yield f"- and {len(models) - most} more language models"


def _model_line(model: LanguageModelEntry, price: PriceEntry | None) -> str:
    capabilities = model.capabilities or {}
    level = _name(str(capabilities.get("structured", "unknown")))
    enforcement = "enforced" if capabilities.get("enforced") else "not enforced"
    about = f" ({_name(model.about)})" if model.about else ""
    text = (
        f"- language model of {_name(model.component)}: {_name(model.model)}{about} at "
        f"{_name(model.base_url)}, {model.mode}, structured output {level} ({enforcement}), "
        f"fingerprint {_name(model.fingerprint)}; {model.asked} answers from the server, "
        f"{model.reused} from the cassette, {model.injected} injected faults, "
        f"{model.missed} missed"
    )
    if spending := spending_text(model, price):
        text += f"; {markdown(spending, 400)}"
    if unavailability := unavailability_text(model, _name):
        text += f"; {unavailability}"
    cassette = model.cassette
    if cassette is None:
        return text
    return f"{text}; cassette {_name(cassette.file)}, SHA-256 {_name(cassette.sha256)}"


def _name(text: str | None) -> str:
    return code(name(text or "")) or "-"


def _provenance_lines(record: SessionRecord, most: int) -> Iterator[str]:
    """The section on provenance, with at most so many components and models."""
    tool, environment = record.head.tool, record.head.environment
    git = environment.git
    commit = _name(git.commit) + (" with local changes" if git.dirty else "")
    yield from ["", "## Provenance", ""]
    for component in components_under_test(record)[:most]:
        version = f", version {_name(str(component.version))}" if component.version else ""
        digest = f", SHA-256 {_name(component.digest)}" if component.digest else ", no digest"
        yield f"- component under test: {_name(component.name)}{version}{digest}"
    yield from _model_lines(record, most)
    yield from [f"- merged from {shards}"] if (shards := merge_text(record)) else []
    yield f"- commit: {commit}"
    yield f"- tool: {_name(tool.name)} {_name(tool.version)}"
    yield f"- Python {_name(environment.python)} on {_name(environment.platform)}"
    yield from [f"- formulas: {markdown(text)}"] if (text := second_engine_text(record)) else []
    yield f"- base seed: {record.head.base_seed}"
    yield f"- created {_name(record.head.created)}, finished {_name(record.head.finished)}"
    yield f"- command: {code(record.head.command, 1000) or '-'}"
    yield f"- {review_text(record)}"


def _search_failures(record: SessionRecord) -> Iterator[str]:
    """A line for each outcome that the gate does not accept, or that is waived."""
    for search, outcome in ordered_outcomes(record):
        if outcome_status(search, outcome) in OBJECTIONABLE_OUTCOMES:
            yield (
                f"- **search: {code(name(outcome.requirement))}** on "
                f"{code(name(search.case))}, component {code(name(search.component))}"
                f"{waiver_note(search.waiver, markdown)}: "
                f"{markdown(outcome_headline(search, outcome), 400)}"
            )


Row = TypeVar("Row")
FILE = "summary.md"
MAX_BYTES = 1024 * 1024
"""Bytes that GitHub takes."""

_KIB = 1024
_SHARES = {"causes": 60 * _KIB, "failures": 240 * _KIB, "verdicts": 320 * _KIB,
           "requirements": 100 * _KIB, "cases": 150 * _KIB, "failure modes": 30 * _KIB,
           "searches": 40 * _KIB, "tables": 20 * _KIB, "hazards": 40 * _KIB}  # fmt: skip
"""Bytes of the tables; the rest is for what has a small bound: the head, reasons, provenance."""
_REASONS = 20
_MAX_CELLS = 10
_VERDICT_ORDER = ("violated", "undecided", "supported")


def render(record: SessionRecord) -> str:
    """The page as text, of at most ``MAX_BYTES`` bytes in UTF-8."""
    verdicts = sorted(record.head.verdicts, key=_urgency)
    failures = [verdict for verdict in verdicts if verdict.verdict != "supported"]
    searched, cases = [OutcomeRow(*pair) for pair in ordered_outcomes(record)], record.head.cases
    lines = [
        *_head_lines(record),
        *_cause_lines(record),
        *_count_lines(record),
        *_conclusion_lines(record),
        *_section(
            "Not supported",
            [],
            chain(_failure_lines(record, failures), _search_failures(record)),
            "failures",
        ),
        *chain.from_iterable(map(_further_table, concluded_tables(record))),
        *(_table("Searches", SEARCH_COLUMNS, searched, "searches") if searched else ()),
        *_table("Verdicts", VERDICT_COLUMNS, verdicts, "verdicts"),
        *_hazard_table(record),
        *_table("Requirements", REQUIREMENT_COLUMNS, _requirement_rows(record), "requirements"),
        *_table("Cases", case_columns(cases, record.head.measures), cases, "cases"),
        *_overall_lines(record),
        *_failure_mode_section(record),
        *_coverage_lines(record),
        *_provenance_lines(record, _MAX_CELLS),
    ]
    return "\n".join(lines) + "\n"


def _urgency(verdict: ItemVerdict) -> tuple[bool, int]:
    """Sort key: what makes the gate fail comes first, violations before what is undecided."""
    status = verdict.verdict
    return status == "supported" or verdict.waiver is not None, _VERDICT_ORDER.index(status)


def _head_lines(record: SessionRecord) -> Iterator[str]:
    gate = record.head.gate
    shard = shard_text(record)
    if is_incomplete(record):
        subject = shard.capitalize() or "Session"
        yield f"# {subject} incomplete ({record.head.status}): this is no pass"
    elif shard:
        yield f"# Gate of {shard} {gate.result}: a part of a session, not the whole"
    else:
        yield f"# Gate {', '.join(filter(None, [gate.result, selection_text(record)]))}"


def _cause_lines(record: SessionRecord) -> Iterator[str]:
    """A card for each cause, the worst first, as many as fit; nothing where all is supported."""
    causes = causes_of(record)
    room, shown = _SHARES["causes"], 0
    for number, cause in enumerate(causes, 1):
        heading = markdown(f"Cause {number}, {card_heading(cause)}", 400)
        card = ["", f"## {heading}", "", f"**{markdown(cause.headline, 800)}**", ""]
        for label, text in card_entries(cause):
            card.append(f"- {label}: {_card_text(record, cause, label, text)}")
        room -= sum(len(line.encode()) + 1 for line in card)
        if room < 0:
            break
        shown += 1
        yield from card
    if shown < len(causes):
        more = len(causes) - shown
        yield from ["", f"_{more} more causes are in the report._"]


def _card_text(record: SessionRecord, cause: Cause, label: str, text: str) -> str:
    if label == "replay":
        command = _replay(record.head.command, cause.episode or "")
        return command or "by its id in the record"
    return code(text) if label in ("check", "episode") else markdown(text, 800)


def _count_lines(record: SessionRecord) -> Iterator[str]:
    counts, gate = record.head.totals.to_json(), record.head.gate
    yield from ["", f"| {' | '.join(counts)} |", f"|{' --- |' * len(counts)}"]
    yield f"| {' | '.join(map(str, counts.values()))} |"
    yield ""
    yield from (f"- {markdown(reason, 300) or 'no reason'}" for reason in gate.reasons[:_REASONS])
    if len(gate.reasons) > _REASONS:
        yield f"- and {len(gate.reasons) - _REASONS} more reasons"


def _conclusion_lines(record: SessionRecord) -> Iterator[str]:
    for heading, sentences in (
        ("Shown", conclusion_sentences(record)),
        ("Not shown", limitation_sentences(record)),
    ):
        yield from [
            "",
            f"**{heading}**",
            "",
            *(f"- {markdown(sentence, 400)}" for sentence in sentences),
        ]


def _table(
    heading: str, columns: Sequence[Column[Row]], rows: Iterable[Row], share: str
) -> Iterator[str]:
    """A heading and a table, with as many of its rows as fit into its share."""
    columns = shown_in(columns, Shown.SUMMARY)
    cells = ((column.cell(row).summary for column in columns) for row in rows)
    lines = (f"| {' | '.join(row)} |" for row in cells)
    yield from _section(heading, [column.name for column in columns], lines, share)


def _section(heading: str, columns: list[str], rows: Iterable[str], share: str) -> Iterator[str]:
    """A heading with as many of its rows as fit into its share."""
    yield from ["", f"## {heading}", ""]
    if columns:
        yield from [f"| {' | '.join(columns)} |", f"|{' --- |' * len(columns)}"]
    room, total, shown = _SHARES[share], 0, 0
    for row in rows:
        total += 1
        room -= len(row.encode()) + 1
        if room >= 0:
            shown += 1
            yield row
    if not total:
        yield from ["", "None."]
    if shown < total:
        yield ""
        yield (
            f"_{total - shown} of {total} are left out here, to stay below the limit of a summary; "
            "the report and evidence.json have all._"
        )


def _failure_lines(record: SessionRecord, failures: list[ItemVerdict]) -> Iterator[str]:
    """One row each; requirements of a case that are undecided for the same reason share one."""
    for (first, rest), same in groupby(failures, lambda failure: _failure_context(record, failure)):
        names = ", ".join(_name(verdict.requirement) for verdict in same)
        yield f"- **{first}: {names}{rest}"


def _failure_context(record: SessionRecord, verdict: ItemVerdict) -> tuple[str, str]:
    """The text on a verdict before and after the name of its requirement."""
    text = (
        f" on {_name(verdict.case)}, component {_name(verdict.component)}: "
        f"{markdown(verdict.reason, 400) or 'no reason'}. "
        f"{sample_text(verdict)}; {rate_bound(verdict)}."
    )
    for line in assertion_sentences(verdict):
        text += f"\n  - {markdown(line, 600)}"
    if verdict.counterexamples:
        text += "\n  - " + _counterexample(record, verdict.counterexamples)
    return f"{verdict.verdict}**{waiver_note(verdict.waiver, markdown)}", text


def _counterexample(record: SessionRecord, counterexamples: Sequence[Counterexample]) -> str:
    first = counterexamples[0]
    when = violation_text(first.time, first.margin, valid=first.valid)
    text = f"counterexample {_name(first.episode)}{when}"
    if len(counterexamples) > 1:
        text += f", and {len(counterexamples) - 1} more"
    command = _replay(record.head.command, first.episode)
    return text + (f"; replay: {command}" if command else "; replay by its id in the record")


def _replay(session: str, episode: str) -> str:
    """The command, where it can be shown as it has to be typed."""
    command = replay_command(episode, evidence_option(session), model_options(session))
    unchanged = name(command, 400) == command and "\\|" not in command and "  " not in command
    return code(command) if unchanged else ""


def _requirement_rows(record: SessionRecord) -> Iterator[RequirementRow]:
    of_each: dict[str, list[ItemVerdict]] = defaultdict(list)
    for verdict in record.head.verdicts:
        of_each[verdict.requirement].append(verdict)
    counts = {each.id: verdict_counts(of_each[each.id]) for each in record.head.requirements}
    cells = record.head.coverage.cells
    untested = Counter(cell.requirement for cell in cells if cell.verdict is None)
    more = " or more" if record.head.coverage.left_out else ""

    def failing(requirement: Requirement) -> tuple[bool, bool]:
        own = counts[requirement.id]
        return not own["violated"], not own["undecided"]

    for requirement in sorted(record.head.requirements, key=failing):
        own = counts[requirement.id]
        yield RequirementRow(requirement, own, f"{untested[requirement.id]}{more}")


def _hazard_table(record: SessionRecord) -> Iterator[str]:
    """A row for each hazard, those without evidence first; nothing where there are none."""
    if rows := hazards_by_need(record):
        yield from _table("Hazards", HAZARD_COLUMNS, rows, "hazards")


def _overall_lines(record: SessionRecord) -> Iterator[str]:
    """All cases of each component together, and what the runs show of recovery and monitors.

    No rows of a table: the rows of cases are counted.
    """
    for total in record.head.overall:
        metrics = total.metrics
        truths = {
            measure_label(measure): metrics.measures.get(measure.name)
            for measure in record.head.measures
            if measure.shown != "mean"
        }
        rates = {"flagged": metrics.flagged, **truths, "rescued": metrics.rescued}
        rates["comfort failed"] = metrics.comfort_failed
        counts = [
            f"{rate.valid} {markdown(label, 64)}"
            for label, rate in rates.items()
            if isinstance(rate, ShareEntry)
        ]
        runs = f"{metrics.valid} valid of {metrics.planned} planned runs"
        whose = f"all {total.cases} cases of {_name(total.component)}"
        yield from ["", f"- {whose}: {', '.join([runs, *counts])}"]
    effectiveness = record.head.effectiveness
    if effectiveness:
        yield ""
    for effect in effectiveness[:_MAX_CELLS]:
        whose = f"{_name(effect.role)} with {_name(effect.component)}"
        yield f"- {whose}: {markdown(effect.detail, 400)}"
    if len(effectiveness) > _MAX_CELLS:
        yield f"- and {len(effectiveness) - _MAX_CELLS} more in the report"


def _further_table(table: TableShown) -> Iterator[str]:
    """A further table of the session."""
    yield from _table(markdown(table.title, 100), table.columns, table.rows, "tables")
    if table.about:
        yield from ["", markdown(table.about, 400)]


def _failure_mode_section(record: SessionRecord) -> Iterator[str]:
    """Over all cases; nothing where no component gave accounts."""
    cases = record.head.cases
    rows = [
        FailureModeRow(mode, component)
        for component, modes in failure_modes_by_component(cases).items()
        for mode in modes
    ]
    if rows:
        yield from _table("Failure modes", failure_mode_columns(), rows, "failure modes")
        yield from [
            "",
            *(f"- answers of {_name(whose)}: {text}" for whose, text in decision_time_lines(cases)),
        ]
        for whose, text in decision_age_lines(cases):
            yield f"- decisions of {_name(whose)} came into force at an age of {text}"
        for whose, text in judge_agreement_lines(cases):
            yield f"- {text} of {_name(whose)}"
        for whose, text in uncovered_lines(record.head, _name):
            yield f"- {text} of {_name(whose)}"
        yield f"- {NULL_NOTE}"
    price = record.head.llm_price
    if used := usage_rows(cases, price):
        yield from _table("Tokens", usage_columns(price), used, "cases")


def _coverage_lines(record: SessionRecord) -> Iterator[str]:
    cells, left_out = record.head.coverage.cells, record.head.coverage.left_out
    untested = [cell for cell in cells if cell.verdict is None]
    yield from ["", "## Coverage", ""]
    yield (
        f"{len(cells) - len(untested)} of {len(cells) + left_out} cells of requirement x scenario "
        f"x fault have a verdict; {len(untested) + left_out} untested."
    )
    for cell in untested[:_MAX_CELLS]:
        yield f"- untested: {_name(cell.requirement)} on {_name(cell.case)}"
    if len(untested) + left_out > _MAX_CELLS:
        yield f"- and {len(untested[_MAX_CELLS:]) + left_out} more"
    yield from _operating_domain_lines(record)


_MAX_PAIRS = 5


def _operating_domain_lines(record: SessionRecord) -> Iterator[str]:
    """Pairs of parameters, those least covered by name."""
    combinations = record.head.coverage.combinations
    if combinations is not None:
        yield from ["", combination_text(combinations)]
        for pair in combinations.worst[:_MAX_PAIRS]:
            names = f"{_name(pair.first)} with {_name(pair.second)} of {_name(pair.scenario)}"
            if pair.covered < 1:
                yield f"- {names}: {pair_text(pair)}"
