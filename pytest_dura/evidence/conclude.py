"""Conclude: whatever follows from a record's cases, episodes and judgements, in one pass.

The session that writes the record, its verification and a merge conclude it alike. Each module of
``conclusions/`` is one table of the record.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

from pytest_dura.evidence.conclusions.attribution import Attribution
from pytest_dura.evidence.conclusions.cases import Cases
from pytest_dura.evidence.conclusions.components import Components
from pytest_dura.evidence.conclusions.conclusion import Conclusion
from pytest_dura.evidence.conclusions.coverage import Coverage
from pytest_dura.evidence.conclusions.effectiveness import Effectiveness
from pytest_dura.evidence.conclusions.judgements import Judgements
from pytest_dura.evidence.conclusions.monitors import Monitors
from pytest_dura.evidence.conclusions.searches import Searches
from pytest_dura.evidence.conclusions.tables import Tables
from pytest_dura.evidence.conclusions.totals import Totals
from pytest_dura.evidence.conclusions.verdicts import CaseKey, Verdicts, runs_beyond_plan
from pytest_dura.evidence.entry import JsonObject
from pytest_dura.evidence.gate import Gate
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.redaction import count_redactions
from pytest_dura.evidence.session_model import InputEntry

CONCLUSIONS: Sequence[type[Conclusion]] = (
    Components,
    Judgements,
    Searches,
    Monitors,
    Verdicts,
    Attribution,
    Cases,
    Effectiveness,
    Coverage,
    Tables,
    Totals,
)
"""In order: each may read what those before it concluded."""


def conclude(
    record: SessionRecord, conclusions: Sequence[type[Conclusion]] = CONCLUSIONS
) -> SessionRecord:
    """Add what follows from a record's cases, requirements, judgements and episodes.

    Args:
        record: With its cases, requirements, judgements, waivers, doubts, searches and monitors.
        conclusions: What to conclude; default: all.
    """
    concluded = _add_tables(record, record, conclusions, {})
    beyond = runs_beyond_plan(concluded.head.verdicts)
    if beyond:  # which the verdicts alone tell
        others = [table for table in conclusions if table not in (Verdicts, Totals)]
        concluded = _add_tables(concluded, record, others, beyond)
    return concluded


def _add_tables(
    concluded: SessionRecord,
    record: SessionRecord,
    conclusions: Sequence[type[Conclusion]],
    beyond: Mapping[CaseKey, Collection[int]],
) -> SessionRecord:
    """Add what some tables conclude.

    Args:
        concluded: What they are added to.
        record: As it was before anything was concluded.
        conclusions: The tables.
        beyond: Numbers of planned runs that lie beyond every decision, and enter none of them.
    """
    tables = [conclusion(record.head) for conclusion in conclusions]
    for episode in record.episodes():
        runs = beyond.get((episode.case, episode.component), ())
        if not (episode.planned and episode.spec.run in runs):
            for table in tables:
                table.add(episode)
    for table in tables:
        concluded = concluded.changed(**table.concluded(concluded.head))
    return concluded


def contradictions(record: SessionRecord) -> Iterator[str]:
    """Yield what the lines of a record cannot say together, which nothing is concluded from.

    The head, an episode, a search, a judgement each know what they cannot say by themselves, and
    each table what the lines that it rests on cannot say of each other.
    """
    yield from record.head.contradictions()
    tables = [conclusion(record.head) for conclusion in CONCLUSIONS]
    for episode in record.episodes():
        for problem in episode.contradictions():
            yield f"episode {episode.id}: {problem}"
        for table in tables:
            yield from table.check(episode)
    for table in tables:
        yield from table.check_head()


_AFTERWARDS = ("redacted", "totals")
"""Keys that are added after redactions are counted."""


def complete(
    record: SessionRecord,
    *,
    finished: str | None,
    gate: Gate,
    inputs: Iterable[InputEntry | JsonObject],
    wall_seconds: float,
    evidence_seconds: float,
    redact: Callable[[Any], Any],
) -> SessionRecord:
    """Complete a concluded record with gate, inputs, times, redactions and totals, once.

    Args:
        record: Of :func:`conclude`.
        finished: When the session ended, in ISO 8601; ``None`` as long as it runs.
        gate: Whether the session passed.
        inputs: Every input file, with its digest.
        wall_seconds: From the session's start until now.
        evidence_seconds: Part of them that the controller spent on gathering the evidence; traces
            are written where the episodes run, and rendering follows.
        redact: Removes secrets from plain data; episodes lost theirs where they were run.
    """
    head = record.head
    seconds = {"wall_seconds": wall_seconds, "evidence_seconds": evidence_seconds}
    whole = record.changed(
        finished=finished,
        gate=gate,
        inputs=list(inputs),
        timings=head.timings.replace(**seconds),
        totals=head.totals.replace(gate=gate.result),
    )
    plain = redact(whole.head.to_json())
    redactions = count_redactions({key: plain[key] for key in plain if key not in _AFTERWARDS})
    redactions.update(head.redacted)
    return whole.changed(**{**plain, "redacted": dict(sorted(redactions.items()))})
