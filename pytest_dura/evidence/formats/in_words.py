"""What a session shows and what it does not, in plain sentences, computed from the record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pytest_dura.evidence.formats.stated import part, roles_off, selected
from pytest_dura.evidence.record.repeats import not_repeatable
from pytest_dura.evidence.record.reuse import why_again
from pytest_dura.evidence.record.searches import CLAIMED, NOTHING
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.evidence.text import name
from pytest_dura.evidence.views.searches import NOTHING_SUPPORTED

Data = Mapping[str, Any]
MOST_NAMES = 8
"""Requirements that a sentence names."""


def shown(record: SessionRecord) -> Iterator[str]:
    """What the verdicts come to. Names in it are a user's, and have to be escaped."""
    verdicts = record["verdicts"]
    if not verdicts:
        yield "No requirement led to a verdict."
        yield from _found_by_searches(record)
        return
    violated = [one for one in verdicts if one["verdict"] == "violated"]
    if violated:
        ids = list(dict.fromkeys(one["requirement"] for one in violated))
        names = ", ".join(map(name, ids[:MOST_NAMES]))
        more = f" and {len(ids) - MOST_NAMES} more" if len(ids) > MOST_NAMES else ""
        yield (
            f"{_share(violated, verdicts)} violated ({names}{more}): the episodes "
            "are named and can be replayed."
        )
    supported = [one for one in verdicts if one["verdict"] == "supported"]
    if supported:
        yield f"{_share(supported, verdicts)} supported.{_weakest(supported)}"
    else:
        yield f"None of {len(verdicts)} verdicts is supported."
    yield from _found_by_searches(record)


def not_shown(record: SessionRecord) -> Iterator[str]:
    """What nobody may conclude from this session."""
    if record["status"] != "complete" or record["gate"]["result"] == "incomplete":
        yield "The session did not come to its end: what it would have shown is not known."
    if which := part(record):
        yield (
            f"This is {which}: of what the others hold it says nothing. `python -m pytest_dura "
            "merge` joins them all, and gates on the whole."
        )
    yield from _left_out(record)
    verdicts, totals = record["verdicts"], record["totals"]
    undecided = [one for one in verdicts if one["verdict"] == "undecided"]
    if undecided:
        blind = sum(one["episodes"] == 0 for one in undecided)
        rest = f", {blind} of them without a single valid episode" if blind else ""
        yield f"{_share(undecided, verdicts)} undecided{rest}: they show neither."
    yield from _one_situation(verdicts)
    waived = [one for one in verdicts if one["waiver"] is not None]
    if waived:
        yield f"{_share(waived, verdicts)} waived: let through by name, not by evidence."
    yield from _found_nothing(record)
    yield from _untried(record)
    early = sum(one["metrics"]["ended_early"] for one in record["cases"])
    if early:
        yield (
            f"{early} of {totals['episodes']} episodes ended early, once every requirement of "
            "their case was decided: the margin of what one satisfies is the least that was still "
            "possible, that of a violation as it was by then; clearance, gridlock, recoveries, "
            "alerts, valid proposals and all other figures are of what was seen by then, and what "
            "would have failed later is not known."
        )
    yield from _not_repeatable(record)
    yield from _taken_over(record)
    spoilt = totals["invalid"] + totals["missing"]
    if spoilt:
        yield (
            f"{totals['invalid']} of {totals['episodes']} episodes are invalid and "
            f"{totals['missing']} missing: they support nothing and enter no n. What one of them "
            "violates fails the gate all the same."
        )
    supported = sum(one["verdict"] == "supported" for one in verdicts)
    if supported:
        yield (
            "That no violation was seen does not mean that there can be none: the bound says how "
            "frequent they may still be."
        )
    yield from _by_assertion(verdicts)
    if supported > 1:
        yield "Each bound holds by itself with its confidence; that all hold at once is less sure."
    recoveries = sum(one["metrics"]["recoveries"] for one in record["cases"] if not one["without"])
    if recoveries:
        yield (
            f"Recovery acted {recoveries} times in valid episodes: what is judged is the component "
            "together with its monitors and its recovery, not the component alone."
        )
    yield (
        "All of it is simulated: nothing is said of conditions that the scenarios and their ranges "
        "do not contain."
    )


def _left_out(record: SessionRecord) -> Iterator[str]:
    """Roles that are switched off, and what was planned and not asked for."""
    for line in roles_off(record):
        yield f"{name(line)}: what it would have seen or done is in no verdict."
    told, which = record["selection"], selected(record)
    if not which:
        return
    left = told["planned"] - told["asked"]
    names = ", ".join(map(name, told["left_out"][:MOST_NAMES]))
    more = f" and {left - MOST_NAMES} more" if left > MOST_NAMES else ""
    yield f"Of its plan the session was asked for a part: {which}." + (
        f" Left out: {names}{more}." if names else ""
    )


def _by_assertion(verdicts: list[Data]) -> Iterator[str]:
    """Verdicts that rest on nothing but what tests assert."""
    found = [
        one
        for one in verdicts
        if one["verdict"] == "supported" and one["assertion"] and one["assertion"]["alone"]
    ]
    if found:
        yield (
            f"{_share(found, verdicts)} supported by assertions of tests alone: what holds is what "
            "a test asserts of what it looked at, and whether that is the requirement is not shown."
        )


def _outcomes(record: SessionRecord, words: tuple[str, ...]) -> list[tuple[Data, Data]]:
    """Searches and their outcomes of these words."""
    return [
        (search, outcome)
        for search in record["searches"]
        for outcome in search["outcomes"]
        if outcome["word"] in words
    ]


def _found_by_searches(record: SessionRecord) -> Iterator[str]:
    """What searches violated, confirmed or not."""
    for word, how in zip(CLAIMED, ("confirmed by replay", "and not each time again"), strict=True):
        found = _outcomes(record, (word,))
        if found:
            told = [f"{name(one['requirement'])} on {name(by['case'])}" for by, one in found]
            names = ", ".join(dict.fromkeys(told[:MOST_NAMES]))
            more = f" and {len(told) - MOST_NAMES} more" if len(told) > MOST_NAMES else ""
            yield f"Violated in a search, {how}: {names}{more}. It is part of no rate."


def _found_nothing(record: SessionRecord) -> Iterator[str]:
    found = _outcomes(record, (NOTHING, "undecided"))
    if found:
        several = "" if len(found) == 1 else "s"
        most = max(search["simulations"] for search, _ in found)
        yield (
            f"Searches found nothing against {len(found)} requirement{several} on a case, in up to "
            f"{most} simulations each: that supports none of them. {NOTHING_SUPPORTED}"
        )


def _one_situation(verdicts: list[Data]) -> Iterator[str]:
    equal = [one for one in verdicts if one.get("situation") is not None]
    if equal:
        rests = "rests" if len(equal) == 1 else "rest"
        yield (
            f"{len(equal)} of {len(verdicts)} verdicts {rests} on runs that are all equal: however "
            "many they are, they show one situation, and no rate."
        )


def _not_repeatable(record: SessionRecord) -> Iterator[str]:
    found = [name(one["id"]) for one in record["cases"] if any(not_repeatable([one]))]
    if found:
        names = ", ".join(dict.fromkeys(found[:MOST_NAMES]))
        more = f" and {len(found) - MOST_NAMES} more" if len(found) > MOST_NAMES else ""
        yield (
            f"Not repeatable: {names}{more}. An episode of each, run twice in this session, came "
            "out differently: what is said of them may come out differently, too."
        )


def _taken_over(record: SessionRecord) -> Iterator[str]:
    """What this session did not simulate itself."""
    reuse, run = record["reuse"], record["totals"]["episodes"]
    if reuse["mode"] == "none":
        return
    several = len(reuse["sessions"])
    whose = f" from {several} earlier session{'' if several == 1 else 's'}" if several else ""
    yield (
        f"{reuse['taken_over']} of {run} episodes were taken over{whose}, since nothing that they "
        "are known to rest on had changed: what their code reads or imports unseen is not known."
    )
    for one in reuse["outdated"][:MOST_NAMES]:
        yield (
            f"{one['episodes']} of {run} episodes were simulated again: "
            f"{why_again(map(name, one['changed']))}."
        )
    searched = reuse["searched"]
    if searched is not None and searched["taken_over"]:
        yield (
            f"{searched['taken_over']} of {searched['simulations']} simulations of searches were "
            "taken over from earlier sessions, under the same conditions; replays never are."
        )


def _untried(record: SessionRecord) -> Iterator[str]:
    cells, left_out = record["coverage"]["cells"], record["coverage"]["left_out"]
    untested = left_out + sum(one["verdict"] is None for one in cells)
    if untested:
        yield (
            f"{untested} of {len(cells) + left_out} combinations of requirement, scenario and "
            "faults were not tried."
        )
    unheard = sum(one["missing_runs_total"] for one in record["cases"])
    if unheard:
        yield f"{unheard} planned episodes were not run."


def _share(part: list[Data], whole: list[Data]) -> str:
    return f"{len(part)} of {len(whole)} verdicts {'is' if len(part) == 1 else 'are'}"


def _weakest(supported: list[Data]) -> str:
    """The greatest bound of them, with its confidence and its n."""
    known = [one for one in supported if one["bound"]["upper"] is not None]
    if not known:
        return ""
    worst = max(known, key=lambda one: float(one["bound"]["upper"]))
    told = worst["bound"]
    return (
        f" The weakest bound among them: at most {100 * told['upper']:.3g} % of such episodes "
        f"violate the requirement, with {100 * told['confidence']:.3g} % confidence "
        f"(n = {worst['episodes']})."
    )
