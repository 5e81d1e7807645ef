"""What the terminal shows first or instead: cards of causes, and a line for each further table."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from pytest_dura.evidence.conclusions.effectiveness import RECOVERY_ROLE
from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.plugin.context import replay_command
from pytest_dura.plugin.terminal_tables import WIDTH, effectiveness_lines
from pytest_dura.reports.causes import Cause, card_entries, card_heading, causes_of
from pytest_dura.reports.failure_modes import (
    failure_mode_text,
    failure_modes_by_component,
    percent_text,
)
from pytest_dura.reports.usage import usage_rows
from pytest_dura.reports.verdicts import reading_sentences
from pytest_dura.reports.wording import (
    beyond_plan_sentences,
    look_sentences,
    names_text,
    supported_sentence,
)
from pytest_dura.requirements.model import FAULTS

if TYPE_CHECKING:
    from pytest_dura.evidence.case_model import CaseEntry
    from pytest_dura.evidence.item_verdicts import ItemVerdict
    from pytest_dura.evidence.model import SessionRecord
    from pytest_dura.plugin.context import SessionContext

_MOST_CARDS = 5
"""Cards without ``-v``."""
_MOST_CARDS_VERBOSE = 100
_MOST_MODES = 3
"""Failure modes in a line."""
_COLOURS = {"violated": {"red": True}, "incomplete": {"red": True}, "undecided": {"yellow": True}}


def show_causes(context: SessionContext, terminal: Any, record: SessionRecord) -> None:
    """Show a card for each cause, the worst first; nothing where every verdict is supported."""
    causes = causes_of(record)
    verbose = context.config.option.verbose > 0
    shown = causes[: _MOST_CARDS_VERBOSE if verbose else _MOST_CARDS]
    for number, cause in enumerate(shown, 1):
        heading = f"{card_heading(cause)} ({number} of {counted(len(causes), 'cause')})"
        for line in textwrap.wrap(heading, WIDTH, subsequent_indent="  "):
            terminal.line(line, **_COLOURS[cause.status])
        for line in _card_lines(context, cause):
            terminal.line(line)
        terminal.line("")
    if len(shown) < len(causes):
        left = Counter(cause.status for cause in causes[len(shown) :])
        counts = ", ".join(f"{count} {status}" for status, count in left.items())
        where = "the report has all of them" if verbose else "-v shows them, as does the report"
        terminal.line(
            f"and {counted(left.total(), 'more cause', 'more causes')}: {counts}; {where}"
        )
        terminal.line("")


def _card_lines(context: SessionContext, cause: Cause) -> Iterator[str]:
    """Lines of a card below its heading; a command stays on one line, however long it is."""
    yield from textwrap.wrap(
        cause.headline, WIDTH, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False
    )
    for label, text in card_entries(cause):
        head = f"  {f'{label}:':<10}"
        if label == "replay" and cause.episode is not None:
            yield f"{head}{replay_command(context, cause.episode)}"
        else:
            yield from textwrap.wrap(
                text, WIDTH, initial_indent=head, subsequent_indent=" " * 12,
                break_on_hyphens=False,
            )  # fmt: skip


def brief_lines(record: SessionRecord, cases: Sequence[CaseEntry]) -> Iterator[str]:
    """Write a line in place of each table that has something to say.

    Args:
        record: Of the session.
        cases: Those of the table of cases.
    """
    head = record.head
    for line in (
        *_failure_mode_lines(cases),
        *_usage_lines(cases),
        *_reliance_lines(record),
        *_fault_lines(cases),
        *_attack_lines(record),
    ):
        yield from textwrap.wrap(line, WIDTH, subsequent_indent="  ")
    yield from effectiveness_lines(head.effectiveness, RECOVERY_ROLE)
    yield from effectiveness_lines(head.effectiveness)
    supported = [supported_sentence(head.verdicts)] if head.verdicts else []
    notes = (*look_sentences(record), *beyond_plan_sentences(record))
    for line in (*_reading_lines(head.verdicts), *supported, *notes):
        yield from textwrap.wrap(line, WIDTH, subsequent_indent="  ")


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


def _usage_lines(cases: Sequence[CaseEntry]) -> Iterator[str]:
    rows = [row.usage for row in usage_rows(cases, None)]
    if rows:
        requests, prompt = sum(row.requests for row in rows), sum(row.prompt for row in rows)
        answers = sum(row.completion for row in rows)
        count = counted(requests, "request")
        yield f"tokens: {prompt} of prompts and {answers} of answers in {count}"


def _reliance_lines(record: SessionRecord) -> Iterator[str]:
    """How often recovery acted and comfort failed, and how the component reacted to attacks."""
    several = len(record.head.overall) > 1
    for total in record.head.overall:
        metrics = total.metrics
        parts = []
        if metrics.rescued is not None and metrics.rescued.valid:
            share = metrics.switching.share if metrics.switching else None
            time = "" if share is None else f" ({percent_text(share)} % of the time)"
            parts.append(f"recovery in {metrics.rescued.valid} of {metrics.valid} runs{time}")
        if metrics.comfort_failed is not None and metrics.comfort_failed.valid:
            parts.append(f"comfort failed in {metrics.comfort_failed.valid}")
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


def _attack_lines(record: SessionRecord) -> Iterator[str]:
    """What pairs with and without faults came to."""
    from pytest_dura.requirements.pairs import ChangeTable, PairTable

    compared = [
        verdict.pairs
        for verdict in record.head.verdicts
        if verdict.pairs is not None and verdict.pairs.without == FAULTS
    ]
    if not compared:
        return
    counted_pairs = [pairs for pairs in compared if isinstance(pairs, PairTable)]
    caused = sum(pairs.only_with for pairs in counted_pairs)
    spared = sum(pairs.only_without for pairs in counted_pairs)
    parts = [f"faults caused {caused} violations, spared {spared}"] if counted_pairs else []
    means = [
        pairs.change.mean
        for pairs in compared
        if isinstance(pairs, ChangeTable) and pairs.change.mean is not None
    ]
    if means:
        parts.append(f"mean cost {min(means):+.2g} to {max(means):+.2g}")
    yield f"attack: {counted(len(compared), 'verdict')} on pairs: {'; '.join(parts)}"
