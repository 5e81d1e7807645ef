"""The terminal's section of a session: header, cases, baseline, episodes taken over, gate."""

from __future__ import annotations

import shlex
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pytest_dura.evidence.conclusions.effectiveness import RECOVERY_ROLE
from pytest_dura.evidence.objections import other_objections
from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.plugin.episodes import show_repeats
from pytest_dura.plugin.messages import (
    SafeTerminal,
    indent_if_reserved,
    safe_lines,
    typed_path,
)
from pytest_dura.plugin.roles import (
    none_in_root_conftest,
    overrides_deeper_down,
    root_conftest_with,
)
from pytest_dura.plugin.terminal_brief import brief_lines, show_causes
from pytest_dura.plugin.terminal_tables import (
    MOST_ROWS,
    WHERE_ALL_ARE,
    WIDTH,
    attack_table,
    case_table,
    effectiveness_lines,
    failure_mode_table,
    fault_table,
    further_tables,
    model_lines,
    monitor_table,
    most_rows,
    pair_table,
    reliance_table,
    uncovered_mode_lines,
    usage_table,
    worst_cases,
    wrapped_legend,
)
from pytest_dura.plugin.terminal_verdicts import show_searches, show_verdicts
from pytest_dura.reports.columns import Shown, shown_in
from pytest_dura.reports.tables import COMPARISON_COLUMNS, NO_CHANGE

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pytest

    from pytest_dura.evidence.baseline import Baseline
    from pytest_dura.evidence.case_model import CaseEntry
    from pytest_dura.evidence.model import SessionRecord
    from pytest_dura.evidence.session_model import ResumeEntry, SearchOrigins
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.plugin.episodes import SessionExecutor, SharedEpisodes
    from pytest_dura.plugin.language_models import LanguageModels
    from pytest_dura.plugin.roles import SessionRoles
    from pytest_dura.requirements.comparison import BaselineComparison, ComparedBaseline


_MOST_REASONS = 8
"""Reasons that are shown."""


def _resumed_lines(record: SessionRecord) -> Iterator[str]:
    """Count the episodes taken over and simulated, with reasons for repeated ones."""
    if record.head.resume.resumed:
        yield from _resumed_sentences(record.head.resume, record.head.totals.episodes, "episode")


def _searched_lines(record: SessionRecord) -> Iterator[str]:
    """Count the same for searches, and say why something could not be shared."""
    searched = record.head.resume.searched
    if searched is not None and searched.simulations:
        yield from _resumed_sentences(searched, searched.simulations, "run", " of searches")
    yield from record.head.resume.problems


def _resumed_sentences(
    origins: ResumeEntry | SearchOrigins, count: int, noun: str, suffix: str = ""
) -> Iterator[str]:
    from pytest_dura.evidence.sessions import outdated_reason

    taken, sessions = origins.taken_over, len(origins.sessions)
    origin = f" from {counted(sessions, 'earlier session')}" if taken else ""
    yield f"{counted(taken, noun)}{suffix} taken over{origin}, {count - taken} simulated"
    outdated = sorted(origins.outdated, key=lambda entry: -entry.episodes)
    for entry in outdated[:_MOST_REASONS]:
        repeated = f"{counted(entry.episodes, noun)}{suffix} simulated again"
        yield f"{repeated}: {outdated_reason(entry.changed)}"
    if len(outdated) > _MOST_REASONS:
        rest = sum(entry.episodes for entry in outdated[_MOST_REASONS:])
        yield f"{counted(rest, noun)}{suffix} simulated again for other reasons: see the record"


def _resume_lines(config: pytest.Config, shared: SharedEpisodes) -> Iterator[str]:
    """Say how an incomplete session goes on, if anything of it was kept."""
    if shared.is_whole or not shared.cache.count():
        return
    yield f"to go on: {shared.context.redact(_resume_command(config))}"


def _resume_command(config: pytest.Config) -> str:
    arguments: list[Any] = [*config.invocation_params.args]
    option = "--dura-resume"
    if option not in arguments:
        arguments.append(option)
    return shlex.join(["pytest", *map(str, arguments)])


_BASELINE_COLOURS: Mapping[str, dict[str, bool]] = {
    "worse": {"red": True},
    "better": {"green": True},
}
_BASELINE_NOTE = (
    "(worse), (better): without the correction only; -: no evidence of a change, which is no "
    "evidence that nothing changed"
)


def _baseline_header(baseline: Baseline | None) -> list[str]:
    if baseline is None:
        return []
    names = sorted({claim.component for claim in baseline.claims})
    which = ", ".join([*names, baseline.session.created])
    lines = [f"dura: compared with the baseline {baseline.session.path} ({which})"]
    if baseline.session.status != "complete":
        lines.append(f"dura: warning: the baseline's session was {baseline.session.status}")
    return lines


def _show_baseline(terminal: Any, record: SessionRecord) -> None:
    """Show comparisons with violations by their figures, and the others by name."""
    baseline = record.head.baseline
    if baseline is None:
        return
    comparisons = baseline.comparisons
    terminal.line("")
    terminal.line(f"baseline {baseline.path}: {_baseline_summary(baseline)}")
    shown = [
        comparison for comparison in comparisons if comparison.test is None or _violated(comparison)
    ]
    rows = [
        comparison
        for status in (*_BASELINE_COLOURS, NO_CHANGE)
        for comparison in shown
        if comparison.status == status
    ]
    if rows:
        columns = shown_in(COMPARISON_COLUMNS, Shown.TERMINAL)
        table = [[column.label for column in columns]]
        table += [[column.cell(entry).terminal for column in columns] for entry in rows]
        widths = [max(len(row[i]) for row in table) for i in range(len(columns))]
        for row, entry in zip(table, [None, *rows], strict=True):
            cells = "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True))
            about = "requirement and case" if entry is None else _name(entry)
            fits = len(cells) + 2 + len(about) <= WIDTH
            lines = [f"{cells}  {about}"] if fits else [cells, f"{'':<{widths[0] + 2}}{about}"]
            for line in lines:
                terminal.line(
                    line, **({} if entry is None else _BASELINE_COLOURS.get(entry.status, {}))
                )
        for line in [*wrapped_legend(columns), *textwrap.wrap(_BASELINE_NOTE, WIDTH)]:
            terminal.line(line)
    for reason, alike in _unremarkable(comparisons).items():
        text = f"{one_line(reason)}: {_requirements_by_case(alike)}"
        for line in textwrap.wrap(text, WIDTH, subsequent_indent="  ", break_on_hyphens=False):
            terminal.line(line)


def _name(comparison: BaselineComparison) -> str:
    return f"{name(comparison.requirement)} on {name(comparison.case)}"


def _baseline_summary(baseline: ComparedBaseline) -> str:
    statuses = [comparison.status for comparison in baseline.comparisons]
    compared = sum(comparison.test is not None for comparison in baseline.comparisons)
    parts = [counted(compared, "comparison")]
    parts += [f"{statuses.count(status)} {status}" for status in ("worse", "better")]
    if baseline.tests != compared:
        parts.append(f"corrected for {baseline.tests}")
    return ", ".join(parts)


def _violated(comparison: BaselineComparison) -> bool:
    return bool(comparison.violations or comparison.baseline_violations)


def _unremarkable(comparisons: Sequence[BaselineComparison]) -> dict[str, list[BaselineComparison]]:
    """Group comparisons without violations, or without a test, by reason."""
    by_reason: dict[str, list[BaselineComparison]] = {}
    for comparison in comparisons:
        if comparison.test is None:
            reason = (
                f"{comparison.status}: {comparison.reason}"
                if comparison.reason
                else comparison.status
            )
        elif not _violated(comparison):
            runs = f"0/{comparison.episodes} now, 0/{comparison.baseline_episodes} then"
            reason = f"{comparison.status}, violated in {runs}"
        else:
            continue
        by_reason.setdefault(reason, []).append(comparison)
    return by_reason


def _requirements_by_case(comparisons: Sequence[BaselineComparison]) -> str:
    cases: dict[str, list[str]] = {}
    for comparison in comparisons:
        cases.setdefault(comparison.case, []).append(comparison.requirement)
    return "; ".join(
        f"{', '.join(map(name, names))} on {name(case)}" for case, names in cases.items()
    )


def header(
    context: SessionContext,
    *,
    roles: SessionRoles,
    models: LanguageModels,
    executor: SessionExecutor,
    shared: SharedEpisodes,
    baseline: Baseline | None,
) -> list[str]:
    """Name component under test, base seed, what will run, and what is probably not meant."""
    config, options, plan = context.config, context.options, context.plan
    parts = [f"base seed {options.seed}"]
    component = _component(context, roles)
    if component:
        parts.insert(0, f"component under test {component}")
    if plan:
        runs = sum(options.runs or planned.case.scenario.planned for planned in plan)
        parts.append(f"{counted(len(plan), 'case')}, {counted(runs, 'episode')}")
    lines = [*models.replayed(), "dura: " + ", ".join(parts)]
    if options.runs is not None:
        lines.append(f"dura: --dura-runs={options.runs} replaces the planned number of runs")
    if options.shard is not None:
        lines.append(f"dura: {options.shard} of that; the others run elsewhere")
    lines += [f"dura: {role} is OFF: {where}" for role, where in _switched_off(context)]
    lines += executor.header()
    lines += [f"dura: {line}" for line in shared.lines]
    lines += models.header()
    lines += _baseline_header(baseline)
    if plan:
        lines += [f"dura: warning: {warning}" for warning in context.library().warnings]
        lines += [
            f"dura: warning: {file} overrides `{role}`, which scenario items do not see; "
            "move the fixture to the root conftest.py"
            for file, role in overrides_deeper_down(config)
        ]
    return [safe_line for line in lines for safe_line in safe_lines(context.redact(line))]


def _switched_off(context: SessionContext) -> list[tuple[str, str]]:
    """List the roles that run nowhere, as far as known before anything runs, and why."""
    places = {
        role: f"the fixture in {file}" for file, role in none_in_root_conftest(context.config)
    }
    for planned in context.plan:
        for role in planned.case.roles_off({}):
            places.setdefault(role, f"the scenario {planned.case.scenario.name}")
    return sorted(places.items())


def unused_requirements(context: SessionContext) -> list[str]:
    """Warn of requirements that nothing decides, which is probably not meant."""
    lines = (
        f"dura: warning: {place}: no scenario and no collected test uses the requirement {name!r}"
        for name, place in context.unused.items()
    )
    return [safe_line for line in lines for safe_line in safe_lines(line)]


def _component(context: SessionContext, roles: SessionRoles) -> str:
    """Name the component, or where it comes from, as far as known before anything runs."""
    if context.options.generator is not None:
        return roles.default("generator").label
    conftest = root_conftest_with(context.config, "generator")
    if conftest is not None:
        return f"from the fixture `generator` in {conftest}"
    names = {planned.case.roles({})["generator"].label for planned in context.plan}
    return ", ".join(sorted(names))


def summary(
    context: SessionContext,
    terminal: Any,
    record: SessionRecord,
    *,
    file: Path | None,
    objections: list[str],
    notes: list[str],
    shared: SharedEpisodes,
) -> None:
    """Show cases, verdicts and failures, from the record alone.

    Args:
        context: The session's context.
        terminal: pytest's own.
        record: Of the session that has ended.
        file: The record's file, if it could be written.
        objections: What stands against the session beside its verdicts.
        notes: Where episodes were simulated against what an option says.
        shared: What was taken over, and what can be.
    """
    head = record.head
    shown = head.cases or head.searches or head.baseline or head.shard
    if not shown and not any(_searched_lines(record)):
        return
    terminal.section("dura", "=")
    terminal = SafeTerminal(terminal)
    if not context.active:  # then there was no header
        for line in shared.lines:
            terminal.line(line)
    show_causes(context, terminal, record)
    if record.head.cases:
        _show_cases(context, terminal, record)
    show_verdicts(context, terminal, record)
    show_searches(context, terminal, record)
    for line in _searched_lines(record):
        terminal.line(line)
    show_repeats(terminal, record, objections)
    _show_baseline(terminal, record)
    for note in notes:
        terminal.line(note)
    _show_second_engine(terminal, record)
    _show_hazards(terminal, record)
    # Those of the record have cards.
    carded = set(other_objections(head))
    _show_objections(terminal, [each for each in objections if each not in carded])
    terminal.line("")
    if file is not None:
        terminal.line(_gate_line(record))
        if record.head.shard:
            terminal.line("a part of a session: `python -m pytest_dura merge` gates on the whole")
        page = typed_path(_page(file), context.config.invocation_params.dir)
        terminal.line(f"evidence: {page}")
        for line in _resume_lines(context.config, shared):
            terminal.line(line)


def _show_second_engine(terminal: Any, record: SessionRecord) -> None:
    from pytest_dura.reports.wording import second_engine_text

    if text := second_engine_text(record):
        terminal.line(f"formulas: {text}")


def _show_hazards(terminal: Any, record: SessionRecord) -> None:
    from pytest_dura.reports.hazards import hazard_line

    if text := hazard_line(record):
        terminal.line(text)


def _show_objections(terminal: Any, objections: list[str]) -> None:
    for objection in objections[:MOST_ROWS]:
        terminal.line(indent_if_reserved(objection), red=True)
    if len(objections) > MOST_ROWS:
        text = f"and {len(objections) - MOST_ROWS} more like the last one; evidence.json has them"
        terminal.line(text, red=True)


def _gate_line(record: SessionRecord) -> str:
    """Write the gate's result, and the verdicts that it rests on."""
    from pytest_dura.reports.searches import outcome_counts_text
    from pytest_dura.reports.wording import selection_text, shard_text

    totals = record.head.totals
    counted_verdicts = {
        "supported": totals.supported,
        "violated": totals.violated,
        "undecided": totals.undecided,
        "waived": totals.waived,
    }
    parts = [f"{count} {status}" for status, count in counted_verdicts.items() if count]
    whose = f"gate of {shard_text(record)}" if shard_text(record) else "gate"
    counts = outcome_counts_text(record)
    text = f"; searches: {counts}" if counts else ""
    words = [totals.gate, *filter(None, [selection_text(record)]), *(parts or ["no verdict"])]
    return f"{whose}: {', '.join(words)}{text}"


def _page(file: Path) -> Path:
    """Return the page to open: the report, or the record where there is no report."""
    report = file.with_name("report.html")
    return report if report.is_file() else file


def _show_cases(context: SessionContext, terminal: Any, record: SessionRecord) -> None:
    """Show what was run, and the tables of its results."""
    from pytest_dura.reports.wording import roles_off_lines

    terminal.line(
        f"component under test: {_component_names(record)}, base seed {record.head.base_seed}"
    )
    for line in roles_off_lines(record):
        terminal.line(line, yellow=True)
    if context.options.runs is not None:
        terminal.line(f"--dura-runs={context.options.runs} replaced the planned number of runs")
    terminal.line("")
    # Runs without a role that serve a comparison are shown in its table.
    twins = {verdict.pairs.case for verdict in record.head.verdicts if verdict.pairs}
    shown = [case for case in record.head.cases if not case.without or case.id not in twins]
    most = most_rows(context)
    listed = worst_cases(shown, record.head.verdicts, most=most)
    for line in case_table(listed, record.head.overall, record.head.measures):
        terminal.line(line)
    if len(listed) < len(shown):
        text = "those with the worst verdicts are shown"
        terminal.line(
            f"and {counted(len(shown) - len(listed), 'case')} more: {text}; {WHERE_ALL_ARE}"
        )
    ended_early = sum(case.metrics.ended_early for case in record.head.cases)
    if ended_early:
        text = "ended early, once all was decided; figures are up to then"
        terminal.line(f"{counted(ended_early, 'episode')} {text}")
    for line in _resumed_lines(record):
        terminal.line(line)
    by_hand = sum(not episode.planned for episode in record.episodes())
    if by_hand:
        terminal.line(f"and {counted(by_hand, 'episode')} with a seed chosen by hand")
    for line in further_tables(record, most):
        terminal.line(line)
    if context.config.option.verbose <= 0:
        terminal.line("")
        for line in [
            *brief_lines(record, shown),
            *uncovered_mode_lines(record.head),
            *model_lines(record.head.models, record.head.llm_price),
        ]:
            terminal.line(indent_if_reserved(line))
        return
    _show_tables(terminal, record, shown)


def _show_tables(terminal: Any, record: SessionRecord, cases: Sequence[CaseEntry]) -> None:
    """Show all tables beside that of the cases, with their legends."""
    head = record.head
    for lines in (
        [
            *failure_mode_table(cases, by_case=True),
            *uncovered_mode_lines(head),
            *model_lines(head.models, head.llm_price),
        ],
        usage_table(cases, head.llm_price),
        reliance_table(cases, head.overall),
        fault_table(cases),
        attack_table(head.verdicts, head.cases),
        [
            *pair_table(head.verdicts, head.cases),
            *effectiveness_lines(head.effectiveness, RECOVERY_ROLE),
        ],
        [*monitor_table(head.monitors), *effectiveness_lines(head.effectiveness)],
    ):
        for line in lines and ["", *lines]:
            terminal.line(line)


def _component_names(record: SessionRecord) -> str:
    names = sorted({case.component for case in record.head.cases})
    opaque = record.head.component_under_test.opaque
    return ", ".join(names) + (" (a bare instance, in this process only)" if opaque else "")
