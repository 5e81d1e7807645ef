"""Wording that reports share: replay commands, and what a session shows or does not."""

from __future__ import annotations

import json
import re
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from operator import itemgetter

from pytest_dura.core.percepts import NOTHING
from pytest_dura.evidence.conclusions.coverage import WORST_FIRST
from pytest_dura.evidence.gate import draws_lines, not_repeatable_lines
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.looks import further_looks
from pytest_dura.evidence.model import RecordHead, SessionRecord
from pytest_dura.evidence.session_model import ResumeEntry, SearchOrigins
from pytest_dura.evidence.sessions import outdated_reason
from pytest_dura.evidence.text import counted, first_few, name, one_line
from pytest_dura.guests import guests
from pytest_dura.reports.hazards import without_evidence_sentences
from pytest_dura.reports.searches import unviolated_sentences, violation_sentences
from pytest_dura.requirements.campaign_verdicts import beyond_plan_text, weakness

NAME_LIMIT = 400
"""Characters of a name in a machine-readable format."""
_SHA256 = re.compile(r"[0-9a-f]{64}")
_EVIDENCE = "--dura-evidence"
_MAX_COMMAND = 100_000
"""Characters of a session's command; no shell takes many more."""
_MOST_NAMES = 8
"""Requirements that a sentence names."""
_MOST_LOOKS = 3
"""Verdicts that were looked at before, with their figures."""


def review_text(record: SessionRecord) -> str:
    """Whether anybody reviewed the evidence: ``generated, unreviewed``, or who decided what, when.

    A review comes from a signed envelope beside the record, whose signature is not checked here.
    """
    review = record.review
    if review is None:
        return "generated, unreviewed"
    gate = record.head.gate.result
    return f"generated; {review.decision}; {review.remarks(gate)}"


def selection_text(record: SessionRecord) -> str:
    """The part of its plan that the session was asked for; empty where it was the whole plan.

    Such as ``1 of 2 planned verdicts asked for, 5 runs instead of 15``.
    """
    selection = record.head.selection
    parts = []
    if selection.asked < selection.planned:
        parts.append(f"{selection.asked} of {selection.planned} planned verdicts asked for")
    if selection.runs is not None:
        declared = " to ".join(map(str, dict.fromkeys(selection.declared_runs)))
        parts.append(f"{counted(selection.runs, 'run')} instead of {declared}")
    return ", ".join(parts)


def roles_off_lines(record: SessionRecord) -> list[str]:
    """Lines on roles that are switched off, and in how many of the cases."""
    cases = [case for case in record.head.cases if not case.without]
    counts = Counter(role for case in cases for role in case.off)
    return [
        f"{role} is OFF in {counts[role]} of {counted(len(cases), 'case')}"
        for role in sorted(counts)
    ]


def shard_text(record: SessionRecord) -> str:
    """The part of a session that the record is, such as ``shard 2 of 5``; empty for a whole one."""
    shard = record.head.shard
    return "" if shard is None else f"shard {shard.index} of {shard.count}"


def merge_text(record: SessionRecord) -> str:
    """Number and places of the sessions that were merged; empty for a session's own record."""
    parts = record.head.merged_from
    if parts is None:
        return ""
    # Which parts have property tests says nothing of where they ran.
    places = [part.environment.to_json() | {"hypothesis": None} for part in parts]
    several = len({json.dumps(place, sort_keys=True) for place in places}) > 1
    count = merged_parts_text(record.head)
    return f"{count}, in environments that differ" if several else f"{count}, in one environment"


def merged_parts_text(head: RecordHead) -> str:
    """Number of the sessions of a merged record: shards, or whole ones among them."""
    parts = head.merged_from or ()
    return counted(len(parts), "shard" if all(part.index for part in parts) else "session")


def second_engine_text(record: SessionRecord) -> str:
    """What a second engine for formulas was compared on; empty without one."""
    # transitional: a head that is not valid is a mapping.
    engine = getattr(record.head, "second_engine", None)
    if engine is None:
        return ""
    text = f"{counted(engine.compared, 'verdict')} also evaluated by {engine.engine} "
    left_out = [f"{number} not: {why}" for why, number in engine.not_compared.items()]
    return "; ".join([text + engine.version, *left_out])


def valid_sha256(text: object) -> str | None:
    """The digest, if it is a SHA-256 in hexadecimal."""
    return text if isinstance(text, str) and _SHA256.fullmatch(text) else None


def replay_command(
    episode: str, evidence: str | None = None, others: Mapping[str, str] = NOTHING
) -> str:
    """``pytest --dura-replay='case#run'``, each value quoted for a shell.

    Args:
        episode: Its id.
        evidence: The evidence directory, unless it is the default one.
        others: Of :func:`replay_options`.
    """
    options = {"--dura-replay": episode}
    if evidence is not None:
        options[_EVIDENCE] = evidence
    options.update(others)
    return " ".join(["pytest", *(f"{key}={shlex.quote(value)}" for key, value in options.items())])


def evidence_option(command: str) -> str | None:
    """The evidence directory that a session's command names, if it does; the last one counts."""
    return _option_values(command).get(_EVIDENCE)


def replay_options(command: str) -> dict[str, str]:
    """The options of guests that a replay needs, by the session's command."""
    values = _option_values(command)
    return {
        option: value
        for guest in guests().values()
        for option, value in guest.replayed(values).items()
    }


def entry_command(record: SessionRecord, kind: str, text: str) -> str:
    """The command of a card's entry that is one, as it has to be typed.

    Args:
        record: Of the session.
        kind: ``replay`` or ``rerun``.
        text: Id of the episode, or of the item.
    """
    if kind == "rerun":
        return f"pytest {shlex.quote(text)}"
    session = record.head.command
    return replay_command(text, evidence_option(session), replay_options(session))


@lru_cache(maxsize=1)
def _option_values(command: str) -> Mapping[str, str]:
    """The values of the directory of evidence and of guests' options in a command."""
    if len(command) > _MAX_COMMAND:
        return NOTHING
    try:
        arguments = shlex.split(command)
    except ValueError:  # no shell reads such a command
        return NOTHING
    known = {_EVIDENCE, *(row.key for guest in guests().values() for row in guest.options.rows())}
    values: dict[str, str] = {}
    for argument, following in zip(arguments, [*arguments[1:], None], strict=False):
        option, equals, value = argument.partition("=")
        chosen = value if equals else following
        if option in known and chosen is not None:
            values[option] = chosen
    return values


def names_text(names: Sequence[str], most: int = _MOST_NAMES) -> str:
    """Names with commas; of many, the first few and how many more there are."""
    return first_few([*map(name, names)], most)


def is_incomplete(record: SessionRecord) -> bool:
    """Whether the session ended before all was run."""
    return record.head.status != "complete" or record.head.gate.result == "incomplete"


def gate_title(record: SessionRecord) -> str:
    """The gate's result as a heading, which no part of a session shares with a whole one."""
    gate, shard = record.head.gate, shard_text(record)
    if is_incomplete(record):
        subject = shard.capitalize() or "Session"
        return f"{subject} incomplete ({record.head.status}): this is no pass"
    if shard:
        return f"Gate of {shard} {gate.result}: a part of a session, not the whole"
    return f"Gate {', '.join(filter(None, [gate.result, selection_text(record)]))}"


def conclusion_sentences(record: SessionRecord) -> Iterator[str]:
    """Sentences on what the session shows. Names in them are a user's, and have to be escaped."""
    verdicts = record.head.verdicts
    if not verdicts:
        yield "No requirement led to a verdict."
        yield from violation_sentences(record)
        return
    violated = [verdict for verdict in verdicts if verdict.verdict == "violated"]
    if violated:
        ids = list(dict.fromkeys(verdict.requirement for verdict in violated))
        yield (
            f"{_share(violated, verdicts)} violated ({names_text(ids)}): the episodes "
            "are named and can be replayed."
        )
    yield supported_sentence(verdicts)
    yield from violation_sentences(record)


def supported_sentence(verdicts: list[ItemVerdict]) -> str:
    """How many of a session's verdicts are supported, their weakest bound, weak requirements."""
    supported = [verdict for verdict in verdicts if verdict.verdict == "supported"]
    if not supported:
        none = f"None of {len(verdicts)} verdicts is" if verdicts[1:] else "The one verdict is not"
        return f"{none} supported.{_weak_requirements(verdicts)}"
    return (
        f"{_share(supported, verdicts)} supported.{_weakest_bound(supported)}"
        f"{_mostly_vacuous(supported)}{_weak_requirements(verdicts)}"
    )


def _mostly_vacuous(supported: list[ItemVerdict]) -> str:
    """Sentence that names verdicts whose condition held in less than half of the runs."""
    rarely = [
        f"{name(verdict.requirement)} on {name(verdict.case)}, whose condition did not hold in "
        f"{verdict.vacuous} of {counted(verdict.episodes, 'run')}"
        for verdict in supported
        if 2 * verdict.vacuous > verdict.episodes
    ]
    more = f"; and {len(rarely) - _MOST_NAMES} more" if len(rarely) > _MOST_NAMES else ""
    return f" Mostly vacuous: {'; '.join(rarely[:_MOST_NAMES])}{more}." if rarely else ""


def _weak_requirements(verdicts: list[ItemVerdict]) -> str:
    """Sentence that names the requirements that ask for little; empty without any."""
    weak = {
        f"{name(verdict.requirement)} {weakness(*limits).removeprefix('weak: ')}": None
        for verdict in verdicts
        if weakness(*(limits := (verdict.bound.at_most, verdict.bound.confidence)))
    }
    more = f"; and {len(weak) - _MOST_NAMES} more" if len(weak) > _MOST_NAMES else ""
    return f" Weak: {'; '.join(list(weak)[:_MOST_NAMES])}{more}." if weak else ""


def limitation_sentences(record: SessionRecord) -> Iterator[str]:
    """Sentences on what the session does not show."""
    if is_incomplete(record):
        yield "The session did not come to its end: what it would have shown is not known."
    if part := shard_text(record):
        yield (
            f"This is {part}: of what the others hold it says nothing. `python -m pytest_dura "
            "merge` joins them all, and gates on the whole."
        )
    yield from without_evidence_sentences(record)
    yield from _left_out(record)
    verdicts, totals = record.head.verdicts, record.head.totals
    undecided = [verdict for verdict in verdicts if verdict.verdict == "undecided"]
    if undecided:
        without_valid = sum(verdict.episodes == 0 for verdict in undecided)
        rest = f", {without_valid} of them without a single valid episode" if without_valid else ""
        they = "it shows" if len(undecided) == 1 else "they show"
        yield f"{_share(undecided, verdicts)} undecided{rest}: {they} neither."
    yield from _one_situation(verdicts)
    yield from look_sentences(record)
    yield from beyond_plan_sentences(record)
    waived = [verdict for verdict in verdicts if verdict.waiver is not None]
    if waived:
        yield f"{_share(waived, verdicts)} waived: let through by name, not by evidence."
    yield from unviolated_sentences(record)
    yield from _untested(record)
    early = sum(case.metrics.ended_early for case in record.head.cases)
    if early:
        yield (
            f"{early} of {totals.episodes} episodes ended early, once every requirement of "
            "their case was decided: the margin of what one satisfies is the least that was still "
            "possible, that of a violation as it was by then; measures, recoveries, "
            "alerts, valid proposals and all other figures are of what was seen by then, and what "
            "would have failed later is not known."
        )
    yield from _not_repeatable(record)
    yield from _taken_over(record)
    excluded = totals.invalid + totals.missing
    if excluded:
        yield (
            f"{totals.invalid} of {totals.episodes} episodes are invalid and "
            f"{totals.missing} missing: they support nothing and enter no n. What one of them "
            "violates fails the gate all the same."
        )
    if totals.supported:
        yield (
            "That no violation was seen does not mean that there can be none: the bound says how "
            "frequent they may still be."
        )
    yield from _by_assertion(verdicts)
    if totals.supported > 1:
        yield "Each bound holds by itself with its confidence; that all hold at once is less sure."
    recoveries = sum(case.metrics.recoveries for case in record.head.cases if not case.without)
    if recoveries:
        yield (
            f"Recovery acted {recoveries} times in valid episodes: what is judged is the component "
            "together with its monitors and its recovery, not the component alone."
        )
    yield (
        "All of it is simulated: no claim is made for conditions that the scenarios and their "
        "ranges do not contain."
    )


def method_sentences(verdicts: Sequence[ItemVerdict]) -> Iterator[str]:
    """Say by which method runs and bounds were decided, each once, and which runs that saved."""
    groups: dict[tuple[str, str], dict[str, None]] = {}
    for verdict in verdicts:
        method = one_line(verdict.method), one_line(verdict.bound.method)
        groups.setdefault(method, {})[verdict.requirement] = None
    for (runs, bound), names in groups.items():
        whose = f" of {names_text(list(names))}" if len(groups) > 1 else ""
        yield f"method{whose}: {runs}; {bound}"
    for verdict in verdicts:
        if verdict.saved:
            place = f"{name(verdict.requirement)} on {name(verdict.case)}"
            yield f"{place}: {verdict.saved} of {counted(verdict.planned, 'run')} saved"


def look_sentences(record: SessionRecord) -> Iterator[str]:
    """Name the verdicts on a rate before which earlier sessions looked at the same campaign."""
    looks = []
    for verdict, earlier in further_looks(record):
        seen = [
            f"{look.violations} of {look.episodes} violated at base seed {look.base_seed}"
            for look in earlier[-_MOST_NAMES:]
        ]
        plans = f"in {counted(len(earlier), 'earlier plan')} ({'; '.join(seen)})"
        looks.append((f"{name(verdict.requirement)} on {name(verdict.case)}", plans))
    if len(looks) == 1:
        ((place, plans),) = looks
        yield f"{place} was looked at before, {plans}: its confidence holds for one look."
    elif looks:
        named = first_few([f"{place} {plans}" for place, plans in looks], _MOST_LOOKS)
        yield (
            f"{len(looks)} verdicts on rates were looked at before, and the confidence of each "
            f"holds for one look: {named}."
        )


def beyond_plan_sentences(record: SessionRecord) -> Iterator[str]:
    """Name the runs that lie beyond the decision of a verdict, and so enter nothing."""
    for verdict in record.head.verdicts:
        if verdict.beyond_plan:
            place = f"{name(verdict.requirement)} on {name(verdict.case)}"
            yield f"{place}: {beyond_plan_text(verdict)}."


def _left_out(record: SessionRecord) -> Iterator[str]:
    """Roles that are switched off, and what was planned and not asked for."""
    for line in roles_off_lines(record):
        yield f"{name(line)}: what it would have seen or done is in no verdict."
    selection, part = record.head.selection, selection_text(record)
    if not part:
        return
    left_out = selection.planned - selection.asked
    names = ", ".join(map(name, selection.left_out[:_MOST_NAMES]))
    more = f" and {left_out - _MOST_NAMES} more" if left_out > _MOST_NAMES else ""
    yield f"Of its plan the session was asked for a part: {part}." + (
        f" Left out: {names}{more}." if names else ""
    )


def _by_assertion(verdicts: list[ItemVerdict]) -> Iterator[str]:
    asserted = [
        verdict
        for verdict in verdicts
        if verdict.verdict == "supported" and verdict.assertion and verdict.assertion.alone
    ]
    if asserted:
        yield (
            f"{_share(asserted, verdicts)} supported by assertions of tests alone: what holds is "
            "what a test asserts of what it looked at, and whether that is the requirement is not "
            "shown."
        )


def _one_situation(verdicts: list[ItemVerdict]) -> Iterator[str]:
    equal = [verdict for verdict in verdicts if verdict.situation is not None]
    if equal:
        rests = "rests" if len(equal) == 1 else "rest"
        yield (
            f"{len(equal)} of {len(verdicts)} verdicts {rests} on runs that are all equal: however "
            "many they are, they show one situation, and no rate."
        )


def _not_repeatable(record: SessionRecord) -> Iterator[str]:
    cases = [name(case.id) for case in record.head.cases if any(not_repeatable_lines([case]))]
    if cases:
        yield (
            f"Not repeatable: {first_few(list(dict.fromkeys(cases)))}. An episode of each, run "
            "twice in this session, came out differently: verdicts on them are undecided, unless "
            "they are violated."
        )
    for line in draws_lines(record.head.cases):
        yield f"{one_line(line[:1].upper() + line[1:])}. Equal seeds may give other episodes."


def taken_over_lines(
    origins: ResumeEntry | SearchOrigins, count: int, noun: str, suffix: str = ""
) -> Iterator[str]:
    """Count what was taken over and simulated, with reasons for what was repeated."""
    taken, sessions = origins.taken_over, len(origins.sessions)
    origin = f" from {counted(sessions, 'earlier session')}" if taken else ""
    yield f"{counted(taken, noun)}{suffix} taken over{origin}, {count - taken} simulated"
    outdated = sorted(origins.outdated, key=lambda entry: -entry.episodes)
    for entry in outdated[:_MOST_NAMES]:
        repeated = f"{counted(entry.episodes, noun)}{suffix} simulated again"
        yield f"{repeated}: {outdated_reason(map(name, entry.changed))}"
    if len(outdated) > _MOST_NAMES:
        rest = sum(entry.episodes for entry in outdated[_MOST_NAMES:])
        yield f"{counted(rest, noun)}{suffix} simulated again for other reasons: see the record"


def _taken_over(record: SessionRecord) -> Iterator[str]:
    """Sentences on what this session did not simulate itself."""
    resume = record.head.resume
    if not resume.resumed:
        return
    lines = [*taken_over_lines(resume, record.head.totals.episodes, "episode")]
    searched = resume.searched
    if searched is not None and searched.taken_over:
        lines += taken_over_lines(searched, searched.simulations, "run", " of searches")
    yield from (f"{line}." for line in lines)
    if resume.taken_over:
        yield (
            "What was taken over rests on equal Python files of the project and equal versions of "
            "packages: what code reads by itself is not compared."
        )


def coverage_sentence(record: SessionRecord) -> str:
    """Say how many cells of requirement, scenario and faults have which verdict."""
    cells, left_out = record.head.coverage.cells, record.head.coverage.left_out
    counts = Counter[str | None](cell.verdict for cell in cells)
    untested = counts.pop(None, 0) + left_out
    known = [f"{counts[own]} {own}" for own in reversed(WORST_FIRST) if counts[own]]
    verdicts = f" ({', '.join(known)})" if known else ""
    return (
        f"{counts.total()} of {len(cells) + left_out} cells of requirement, scenario and faults "
        f"have a verdict{verdicts}; {untested} {'is' if untested == 1 else 'are'} untested."
    )


def _untested(record: SessionRecord) -> Iterator[str]:
    cells, left_out = record.head.coverage.cells, record.head.coverage.left_out
    untested = left_out + sum(cell.verdict is None for cell in cells)
    if untested:
        yield (
            f"{untested} of {len(cells) + left_out} cells of requirement, scenario and faults were "
            "not tried."
        )
    not_run = sum(case.missing_runs_total for case in record.head.cases)
    if not_run:
        yield f"{not_run} planned episodes were not run."


def _share(part: list[ItemVerdict], whole: list[ItemVerdict]) -> str:
    return f"{len(part)} of {len(whole)} verdicts {'is' if len(part) == 1 else 'are'}"


def _weakest_bound(supported: list[ItemVerdict]) -> str:
    """The greatest bound of them, with its confidence and its n."""
    known = [
        (verdict.bound.upper, verdict) for verdict in supported if verdict.bound.upper is not None
    ]
    if not known:
        return ""
    upper, worst = max(known, key=itemgetter(0))
    return (
        f" The weakest bound among them: at most {100 * upper:.3g} % of such episodes "
        f"violate the requirement, with {100 * worst.bound.confidence:.3g} % confidence "
        f"(n = {worst.episodes})."
    )
