"""Verdicts and searches in the terminal, and why a verdict is not "supported"."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.plugin.context import replay_command, rerun_command
from pytest_dura.plugin.terminal_tables import (
    WHERE_ALL_ARE,
    WIDTH,
    aligned,
    chain_line,
    keep_worst,
    most_rows,
)
from pytest_dura.reports.columns import Column, Shown, legend, shown_in
from pytest_dura.reports.searches import (
    NOTHING_SUPPORTED,
    baseline_note,
    is_notable_outcome,
    kept_text,
    outcome_entries,
    outcome_headline,
    outcome_rank,
    searcher_name,
    simulations_text,
)
from pytest_dura.reports.tables import SEARCHER_COLUMNS, SearcherRow
from pytest_dura.reports.verdicts import assertion_sentences, figures_text, reading_sentences
from pytest_dura.reports.wording import event_text
from pytest_dura.requirements.campaign_verdicts import failure_entries

if TYPE_CHECKING:
    from pytest_dura.evidence.episode_model import EpisodeEntry
    from pytest_dura.evidence.item_verdicts import ItemVerdict
    from pytest_dura.evidence.model import SessionRecord
    from pytest_dura.evidence.searches import RecordedSearch
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.requirements.searches import SearcherReport, SearchOutcome


LONGEST_TEXT = 2000
"""Characters of a text that is shown in several lines."""
_NO_BREAK = "\N{NO-BREAK SPACE}"
"""Keeps a requirement and its margin on one line, and is shown as a space."""
_VERDICT_COLOURS = {
    "supported": {"green": True},
    "violated": {"red": True},
    "undecided": {"yellow": True},
}


def show_verdicts(context: SessionContext, terminal: Any, record: SessionRecord) -> None:
    """Show every verdict with its figures, then each failure, with ``-v`` alone."""
    verdicts = record.head.verdicts
    if not verdicts or context.config.option.verbose <= 0:
        return
    terminal.line("")
    by_heading: dict[tuple[str, ...], list[ItemVerdict]] = {}
    for verdict in verdicts:
        heading = (
            verdict.verdict,
            _where(verdict),
            figures_text(verdict),
            *reading_sentences(verdict),
        )
        by_heading.setdefault(heading, []).append(verdict)
    for heading, group in by_heading.items():
        _show_alike(terminal, heading, group)
    terminal.line(f"{'':<11}(behind each requirement: its least margin, in the check's unit)")
    failures: dict[tuple[str, ...], list[ItemVerdict]] = {}
    for verdict in verdicts:
        if verdict.verdict != "supported":
            # What is undecided for one reason is shown once for all requirements of a case.
            cause = (
                verdict.reason,
                verdict.first_uncounted.detail if verdict.first_uncounted else "",
            )
            own_key = (verdict.requirement,) if verdict.verdict == "violated" else cause
            failures.setdefault((verdict.case, verdict.component, *own_key), []).append(verdict)
    episodes = _shown_episodes(record, [group[0] for group in failures.values()])
    checks = {requirement.id: requirement.check for requirement in record.head.requirements}
    for group in failures.values():
        check = str(group[0].check or checks.get(group[0].requirement, ""))
        _show_failure(context, terminal, check, group, episodes)


def _show_alike(terminal: Any, heading: tuple[str, ...], verdicts: Sequence[ItemVerdict]) -> None:
    """Show verdicts of a case that differ by requirement and margin alone."""
    status, where, counts, *rests_on = heading
    terminal.write(f"{status:<9}", **_VERDICT_COLOURS[status])
    terminal.line(f"  {where}")
    terminal.line(f"{'':<11}{counts}")
    names = ", ".join(dict.fromkeys(map(_with_margin, verdicts)))
    for line in textwrap.wrap(names, WIDTH - 11, break_on_hyphens=False):
        terminal.line(f"{'':<11}{line.replace(_NO_BREAK, ' ')}")
    for sentence in rests_on:
        for line in textwrap.wrap(sentence, WIDTH - 11, subsequent_indent="  "):
            terminal.line(f"{'':<11}{line}")


def _with_margin(verdict: ItemVerdict) -> str:
    """Write the requirement with its least margin and its vacuous episodes."""
    parts = [] if verdict.margin is None else [f"{verdict.margin:.3g}"]
    if verdict.vacuous:
        parts.append(f"{verdict.vacuous} vacuous")
    requirement = name(verdict.requirement)
    if not parts:
        return requirement
    return f"{requirement}{_NO_BREAK}({f',{_NO_BREAK}'.join(parts)})".replace(" ", _NO_BREAK)


def _where(verdict: ItemVerdict) -> str:
    return f"{name(verdict.case)} ({name(verdict.component)})"


def _show_failure(
    context: SessionContext,
    terminal: Any,
    check: str,
    verdicts: Sequence[ItemVerdict],
    episodes: Mapping[tuple[str, str], EpisodeEntry],
) -> None:
    first = verdicts[0]
    names = ", ".join(dict.fromkeys(name(verdict.requirement) for verdict in verdicts))
    terminal.line("")
    terminal.line(
        f"{first.verdict}: {names} on {_where(first)}",
        **_VERDICT_COLOURS[first.verdict],
    )
    for line in textwrap.wrap(one_line(first.reason, LONGEST_TEXT), WIDTH - 2):
        terminal.line(f"  {line}")
    failed = first.assertion is not None and bool(first.assertion.failed)
    for line in assertion_sentences(first)[: int(failed)]:
        terminal.line(f"  {one_line(line, LONGEST_TEXT)}")
    # Where the check held, what failed is an assertion of the test.
    check_held = failed and not (first.assertion and first.assertion.by_check)
    if check and len(verdicts) == 1 and check != first.requirement and not check_held:
        terminal.line(f"  check:  {check}")
    _show_episode(context, terminal, first, episodes)
    items = list(dict.fromkeys(item for verdict in verdicts for item in verdict.item.split(", ")))
    if len(items) > 1 and all(item.startswith(f"{first.case}::") for item in items):
        items = [first.case]
    for item in items:
        terminal.line(f"  rerun:  {rerun_command(context, item)}")


def _show_episode(
    context: SessionContext,
    terminal: Any,
    verdict: ItemVerdict,
    episodes: Mapping[tuple[str, str], EpisodeEntry],
) -> None:
    """Show the worst episode, or one that did not count, and how to replay it."""
    shown_id = _shown_episode_id(verdict)
    if shown_id is None:
        return
    episode = episodes.get((shown_id, verdict.component))
    for label, text in failure_entries(verdict):
        line = one_line(text, LONGEST_TEXT)
        terminal.line(f"  {f'{label}:':<7} {line}" if label else f"  {line}")
    if verdict.counterexamples:
        if not verdict.counterexamples[0].valid:
            terminal.line(f"  invalid: {episode and episode.invalid_reason}")
        # Events that ended the episode early, if any did.
        for event in episode.events if episode else ():
            if event.kind == "critical":
                terminal.line(f"  event:  {event_text(event)}")
    for fault in episode.faults if episode else ():
        chain = one_line(chain_line(fault), LONGEST_TEXT)
        first, *rest = textwrap.wrap(chain, WIDTH - 12, break_on_hyphens=False)
        terminal.line(f"  fault:  {first}")
        for line in rest:
            terminal.line(f"            {line}")
    terminal.line(f"  replay: {replay_command(context, shown_id)}")


def _shown_episode_id(verdict: ItemVerdict) -> str | None:
    """Return the id of the episode that stands for a verdict that is not "supported"."""
    if verdict.counterexamples:
        return verdict.counterexamples[0].episode
    return None if verdict.first_uncounted is None else verdict.first_uncounted.episode


def _shown_episodes(
    record: SessionRecord, verdicts: Iterable[ItemVerdict]
) -> dict[tuple[str, str], EpisodeEntry]:
    """Return the episodes that stand for verdicts, by id and component, planned ones first.

    The record is read once, since it may have a great many.
    """
    named = [(_shown_episode_id(verdict), verdict.component) for verdict in verdicts]
    keys = {(shown_id, component) for shown_id, component in named if shown_id is not None}
    episodes: dict[tuple[str, str], EpisodeEntry] = {}
    for episode in record.episodes() if keys else ():
        key = episode.id, episode.component
        if key in keys and (key not in episodes or episode.planned > episodes[key].planned):
            episodes[key] = episode
    return episodes


_SEARCH_WIDTH = 80
MOST_CHANGES = 12
_LONGEST_SEARCH_TEXT = 500
"""Characters of a text that is shown in several lines."""
_SEARCH_COLOURS: Mapping[str, dict[str, bool]] = {
    "falsified": {"red": True},
    "not repeatable": {"red": True},
    "undecided": {"yellow": True},
}


def show_searches(context: SessionContext, terminal: Any, record: SessionRecord) -> None:
    """Show every search, with the outcome for each of its requirements."""
    searches = record.head.searches
    if not searches:
        return
    most = most_rows(context)
    ranks = [
        min(outcome_rank(search, outcome) for outcome in search.outcomes) for search in searches
    ]
    shown = keep_worst(searches, ranks, most=most)
    for search in shown:
        terminal.line("")
        _show_search(context, terminal, search)
    if len(shown) < len(searches):
        more = counted(len(searches) - len(shown), "search", "searches")
        terminal.line(f"and {more} more; {WHERE_ALL_ARE}")
    terminal.line("")
    for line in textwrap.wrap(NOTHING_SUPPORTED, _SEARCH_WIDTH):
        terminal.line(line)


def _show_search(context: SessionContext, terminal: Any, search: RecordedSearch) -> None:
    waiver = f" [{search.waiver.kind}]" if search.waiver else ""
    terminal.line(f"search     {name(search.case)} ({name(search.component)}){waiver}")
    for line in _wrapped(f"{simulations_text(search)}; seed {search.seed}", 11):
        terminal.line(line)
    for outcome in search.outcomes:
        _show_outcome(context, terminal, search, outcome)


def _show_outcome(
    context: SessionContext, terminal: Any, search: RecordedSearch, outcome: SearchOutcome
) -> None:
    status, requirement = outcome.status, outcome.requirement
    head = outcome_headline(search, outcome)
    for line in textwrap.wrap(head, _SEARCH_WIDTH, subsequent_indent="  ", break_on_hyphens=False):
        terminal.line(line, **_SEARCH_COLOURS.get(status, {}))
    if note := baseline_note(search, outcome):
        terminal.line(f"  {note}", red=True)
    for label, text in outcome_entries(outcome, MOST_CHANGES):
        for line in _entry(label, text):
            terminal.line(line)
    if is_notable_outcome(search, outcome):
        for line in _searcher_table(search, requirement):
            terminal.line(f"  {line}")
    kept = kept_text(outcome)
    if kept:
        terminal.line(f"  kept:     {kept}")
    if status != "nothing found":
        kept_name = outcome.counterexample.name if kept and outcome.counterexample else None
        terminal.line(f"  rerun:    {rerun_command(context, kept_name or search.item)}")


def _entry(what: str, text: str) -> Iterator[str]:
    lines = textwrap.wrap(
        one_line(text, _LONGEST_SEARCH_TEXT), _SEARCH_WIDTH - 14, break_on_hyphens=False
    )
    head = f"  {what}:" if what else ""
    for number, line in enumerate(lines or [""]):
        yield f"{'' if number else head:<12}{'  ' if number else ''}{line}".rstrip()


def _wrapped(text: str, indent: int) -> list[str]:
    space = " " * indent
    return textwrap.wrap(text, _SEARCH_WIDTH, initial_indent=space, subsequent_indent=space)


def _searcher_table(search: RecordedSearch, requirement: str) -> Iterator[str]:
    """Write the searchers, and below them each trivial baseline by itself."""
    columns = shown_in(SEARCHER_COLUMNS, Shown.TERMINAL)
    nothing = [""] * len(columns)
    rows = [_searcher_line(columns, searcher, requirement) for searcher in search.searchers]
    note = "trivial, each by itself:" if search.baselines else "trivial: none was run"
    rows.append((note, nothing))
    rows += [_searcher_line(columns, baseline, requirement) for baseline in search.baselines]
    names, cells = [searcher for searcher, _ in rows], [figures for _, figures in rows]
    headings = [column.label for column in columns]
    yield from (line.rstrip() for line in aligned("searcher", headings, names, cells))
    yield from textwrap.wrap(legend(columns), _SEARCH_WIDTH - 2)


def _searcher_line(
    columns: Sequence[Column[SearcherRow]], searcher: SearcherReport, requirement: str
) -> tuple[str, list[str]]:
    row = SearcherRow(searcher, requirement)
    return searcher_name(searcher), [column.cell(row).terminal for column in columns]
