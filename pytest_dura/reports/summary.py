"""``summary.md``: the session on one page of GitHub-flavoured Markdown, for the page of a CI job.

GitHub takes at most 1024 KiB. Each table has its share of that and begins with what failed;
what does not fit is left out, and a sentence says how much. No text of a user is a link, a
mention, HTML or the end of a cell.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, groupby

from pytest_dura.evidence.case_model import (
    CaseEntry,
    CaseMetricsEntry,
    MeasuredNumbers,
    RequirementEntry,
    ShareEntry,
)
from pytest_dura.evidence.conclude import verdict_counts
from pytest_dura.evidence.gate import OBJECTIONABLE_OUTCOMES, outcome_status
from pytest_dura.evidence.model import SessionRecord, components_under_test
from pytest_dura.evidence.search_model import SearchEntry, SearchOutcomeEntry
from pytest_dura.evidence.session_model import (
    LanguageModelEntry,
    MeasureEntry,
)
from pytest_dura.evidence.text import code, markdown, name
from pytest_dura.evidence.verdict_model import CounterexampleEntry, VerdictEntry
from pytest_dura.reports.searches import (
    baselines_text,
    kept_text,
    ordered_outcomes,
    outcome_headline,
    parameter_changes,
    search_coverage_text,
)
from pytest_dura.reports.tables import (
    NULL_NOTE,
    decision_age_lines,
    decision_time_lines,
    failure_mode_text,
    failure_modes_by_component,
    measure_label,
    percent_text,
)
from pytest_dura.reports.verdicts import (
    assertion_sentences,
    rate_bound,
    sample_text,
    waiver_note,
)
from pytest_dura.reports.wording import (
    UNREVIEWED,
    conclusion_sentences,
    evidence_option,
    is_incomplete,
    limitation_sentences,
    merge_text,
    model_options,
    replay_command,
    second_engine_text,
    selection_text,
    shard_text,
)
from pytest_dura.requirements.campaign_verdicts import violation_text


def _model_lines(models: Sequence[LanguageModelEntry], most: int) -> Iterator[str]:
    """A line for each entry of the record's key ``models``.

    Args:
        models: The entries.
        most: The greatest number of lines; a last line says how many entries are left out.
    """
    yield from map(_model_line, models[:most])
    if len(models) > most:
        yield f"- and {len(models) - most} more language models"


def _model_line(model: LanguageModelEntry) -> str:
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
    yield from _model_lines(record.head.models, most)
    yield from [f"- merged from {shards}"] if (shards := merge_text(record)) else []
    yield f"- commit: {commit}"
    yield f"- tool: {_name(tool.name)} {_name(tool.version)}"
    yield f"- Python {_name(environment.python)} on {_name(environment.platform)}"
    yield from [f"- formulas: {markdown(text)}"] if (text := second_engine_text(record)) else []
    yield f"- base seed: {record.head.base_seed}"
    yield f"- created {_name(record.head.created)}, finished {_name(record.head.finished)}"
    yield f"- command: {code(record.head.command, 1000) or '-'}"
    yield f"- {UNREVIEWED}"


_SEARCH_COLUMNS = ["search", "waiver", "requirement", "case", "component", "simulations",
           "robustness",
           "found by", "trivial baselines alone", "counterexample"]  # fmt: skip
MOST_CHANGES = 6


def _search_rows(record: SessionRecord) -> Iterator[str]:
    """Rows of a table with :data:`_SEARCH_COLUMNS`."""
    for search, outcome in ordered_outcomes(record):
        yield f"| {' | '.join(_search_cells(search, outcome))} |"


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


def _search_cells(search: SearchEntry, outcome: SearchOutcomeEntry) -> Iterator[str]:
    status = outcome_status(search, outcome)
    yield "violated by a baseline" if status == "baseline" else status
    yield "-" if search.waiver is None else "waived"
    for text in (outcome.requirement, search.case, search.component):
        yield code(name(text)) or "-"
    yield f"{outcome.simulations} of {search.budget}"
    yield "-" if outcome.best is None else f"{outcome.best:.4g}"
    yield "-" if outcome.searcher is None else markdown(outcome.searcher, 100)
    yield markdown(baselines_text(search, outcome.requirement), 1000)
    yield _search_counterexample(search, outcome)


def _search_counterexample(search: SearchEntry, outcome: SearchOutcomeEntry) -> str:
    """Its changes and its file; without a counterexample, how much the search covered."""
    counterexample = outcome.counterexample
    if counterexample is None:
        return f"coverage {search_coverage_text(search)}"
    changes = [
        f"{code(path)} {markdown(how, 100)}"
        for path, how in parameter_changes(counterexample, MOST_CHANGES)
    ]
    more = len(counterexample.changes) - len(changes)
    text = ", ".join(changes) or "the case as it stands"
    text += f" and {more} more" if more > 0 else ""
    kept = kept_text(outcome)
    return f"{text}; kept in {code(kept)}" if kept else text


FILE = "summary.md"
MAX_BYTES = 1024 * 1024
"""Bytes that GitHub takes."""

_KIB = 1024
_SHARES = {"failures": 300 * _KIB, "verdicts": 320 * _KIB, "requirements": 100 * _KIB,
           "cases": 150 * _KIB, "failure modes": 30 * _KIB, "searches": 40 * _KIB}  # fmt: skip
"""Bytes of the tables; the rest is for what has a small bound: the head, reasons, provenance."""
_REASONS = 20
_MAX_CELLS = 10
_VERDICT_ORDER = ("violated", "undecided", "supported")


def render(record: SessionRecord) -> str:
    """The page as text, of at most ``MAX_BYTES`` bytes in UTF-8."""
    verdicts = sorted(record.head.verdicts, key=_urgency)
    failures = [verdict for verdict in verdicts if verdict.verdict != "supported"]
    lines = [
        *_head_lines(record),
        *_conclusion_lines(record),
        *_section(
            "Not supported",
            [],
            chain(_failure_lines(record, failures), _search_failures(record)),
            "failures",
        ),
        *(
            _section("Searches", _SEARCH_COLUMNS, _search_rows(record), "searches")
            if record.head.searches
            else ()
        ),
        *_section("Verdicts", _VERDICT_COLUMNS, map(_verdict_row, verdicts), "verdicts"),
        *_section("Requirements", _REQUIREMENT_COLUMNS, _requirement_rows(record), "requirements"),
        *_case_section(record),
        *_overall_lines(record),
        *_failure_mode_section(record),
        *_coverage_lines(record),
        *_provenance_lines(record, _MAX_CELLS),
    ]
    return "\n".join(lines) + "\n"


def _urgency(verdict: VerdictEntry) -> tuple[bool, int]:
    """Sort key: what makes the gate fail comes first, violations before what is undecided."""
    status = verdict.verdict
    return status == "supported" or verdict.waiver is not None, _VERDICT_ORDER.index(status)


def _head_lines(record: SessionRecord) -> Iterator[str]:
    counts, gate = record.head.totals.to_json(), record.head.gate
    shard = shard_text(record)
    if is_incomplete(record):
        subject = shard.capitalize() or "Session"
        yield f"# {subject} incomplete ({record.head.status}): this is no pass"
    elif shard:
        yield f"# Gate of {shard} {gate.result}: a part of a session, not the whole"
    else:
        yield f"# Gate {', '.join(filter(None, [gate.result, selection_text(record)]))}"
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


def _failure_lines(record: SessionRecord, failures: list[VerdictEntry]) -> Iterator[str]:
    """One row each; requirements of a case that are undecided for the same reason share one."""
    for (first, rest), same in groupby(failures, lambda failure: _failure_context(record, failure)):
        names = ", ".join(_name(verdict.requirement) for verdict in same)
        yield f"- **{first}: {names}{rest}"


def _failure_context(record: SessionRecord, verdict: VerdictEntry) -> tuple[str, str]:
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


def _counterexample(record: SessionRecord, counterexamples: list[CounterexampleEntry]) -> str:
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


_VERDICT_COLUMNS = ["verdict", "waiver", "requirement", "case", "component", "valid n",
             "violations",
             "open", "without effect", "invalid", "missing", "upper bound"]  # fmt: skip
_REQUIREMENT_COLUMNS = [
    "requirement",
    "kind",
    "text",
    "supported",
    "violated",
    "undecided",
    "untested",
]
_CASE_COLUMNS = ["case", "component", "planned", "run", "valid", "invalid", "missing", "flagged"]
_FAILURE_MODE_COLUMNS = [
    "failure mode",
    "kind",
    "component",
    "decisions",
    "share %",
    "null %",
    "episodes",
]


def _table_row(cells: Iterable[object]) -> str:
    return f"| {' | '.join(str(cell) for cell in cells)} |"


def _verdict_row(verdict: VerdictEntry) -> str:
    counts = [verdict.episodes, verdict.violations, len(verdict.open)]
    counts += [verdict.without_effect, verdict.invalid, verdict.missing]
    waiver = "-" if verdict.waiver is None else "waived"
    names = map(_name, (verdict.requirement, verdict.case, verdict.component))
    return _table_row([verdict.verdict, waiver, *names, *counts, rate_bound(verdict)])


def _requirement_rows(record: SessionRecord) -> Iterator[str]:
    of_each: dict[str, list[VerdictEntry]] = defaultdict(list)
    for verdict in record.head.verdicts:
        of_each[verdict.requirement].append(verdict)
    counts = {each.id: verdict_counts(of_each[each.id]) for each in record.head.requirements}
    cells = record.head.coverage.cells
    untested = Counter(cell.requirement for cell in cells if cell.verdict is None)
    more = " or more" if record.head.coverage.left_out else ""

    def failing(requirement: RequirementEntry) -> tuple[bool, bool]:
        own = counts[requirement.id]
        return not own["violated"], not own["undecided"]

    for requirement in sorted(record.head.requirements, key=failing):
        own = counts[requirement.id]
        numbers = (own[status] for status in ("supported", "violated", "undecided"))
        texts = (markdown(text, 200) or "-" for text in (requirement.kind, requirement.text))
        yield _table_row(
            [_name(requirement.id), *texts, *numbers, f"{untested[requirement.id]}{more}"]
        )


def _case_section(record: SessionRecord) -> Iterator[str]:
    measures = record.head.measures
    shown = [markdown(measure_label(measure), 64) for measure in measures]
    columns = [*_CASE_COLUMNS, *shown, "rescued", "comfort failed", "reactions"]
    rows = (_case_row(case, measures) for case in record.head.cases)
    yield from _section("Cases", columns, rows, "cases")


def _case_row(case: CaseEntry, measures: Sequence[MeasureEntry]) -> str:
    metrics = case.metrics
    figures = [_measure_text(measure, metrics) for measure in measures]
    shares = (metrics.flagged, metrics.rescued, metrics.comfort_failed)
    rates = [_rate_text(share, metrics.valid) for share in shares]
    reactions = ", ".join(f"{_name(kind)} {n}" for kind, n in metrics.reactions.items())
    counts = (metrics.planned, metrics.run, metrics.valid, metrics.invalid, metrics.missing)
    names = (_name(case.id), _name(case.component))
    return _table_row([*names, *counts, rates[0], *figures, *rates[1:], reactions or "-"])


def _measure_text(measure: MeasureEntry, metrics: CaseMetricsEntry) -> str:
    value = metrics.measures.get(measure.name)
    if measure.shown != "mean":
        return _rate_text(value if isinstance(value, ShareEntry) else None, metrics.valid)
    if not isinstance(value, MeasuredNumbers) or value.mean is None:
        return "-"
    return f"{value.mean:.2f} {markdown(measure.unit, 64)} (n = {value.runs})"


def _rate_text(rate: ShareEntry | None, valid: int) -> str:
    """Write how often something happened in valid runs, and with a star in others."""
    shown = "-" if rate is None else f"{rate.valid} of {valid}"
    beyond = 0 if rate is None else rate.run - rate.valid
    return f"{shown}, {beyond}*" if beyond else shown


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


def _failure_mode_section(record: SessionRecord) -> Iterator[str]:
    """Over all cases; nothing where no component gave accounts."""
    cases = record.head.cases
    rows = [
        _table_row([
            _name(failure_mode_text(mode.name)), mode.kind, _name(component),
            f"{mode.hits} of {mode.of}", percent_text(mode.share),
            percent_text(mode.null_share),
            f"{mode.episodes} of {mode.of_episodes}",
        ])
        for component, modes in failure_modes_by_component(cases).items()
        for mode in modes
    ]  # fmt: skip
    if rows:
        yield from _section("Failure modes", _FAILURE_MODE_COLUMNS, rows, "failure modes")
        yield from [
            "",
            *(f"- answers of {_name(whose)}: {text}" for whose, text in decision_time_lines(cases)),
        ]
        for whose, text in decision_age_lines(cases):
            yield f"- decisions of {_name(whose)} came into force at an age of {text}"
        yield f"- {NULL_NOTE}"


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
