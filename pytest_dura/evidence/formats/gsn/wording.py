"""How the argument puts verdicts, bounds and coverage into words: propositions, never praise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.formats.stated import also_without, besides, why_no_rate
from pytest_dura.evidence.text import name, one_line

Data = Mapping[str, Any]

TEXT = 400
"""Characters of a text of a user's in an element; the record has all of it."""


def percent(share: float) -> str:
    """A share as a percentage of four digits at most: ``18.1 %``."""
    return f"{100 * share:.4g} %"


def requirement_text(requirement: Data) -> str:
    """The requirement as a proposition, with its bound."""
    return f"{name(requirement['id'])}: {sentence(requirement['text'])} {bound_text(requirement)}"


def bound_text(requirement: Data) -> str:
    """What the requirement asks of a campaign."""
    pairs = requirement["paired"]
    what = "episodes"
    if pairs is not None:
        lacking = name(pairs["without"])
        what = f"pairs of equal seeds, with and without {lacking},"
    if requirement["at_most"] is None:
        return f"Asked for in all {what.rstrip(',')}."
    return (
        f"Violated in at most {percent(requirement['at_most'])} of {what.rstrip(',')}, "
        f"confidence {percent(requirement['confidence'])}."
    )


def place(case: str, component: str, *, several: bool) -> str:
    """The case, and the component where the session has several."""
    return f"{name(case)} [{name(component)}]" if several else name(case)


def verdict_text(verdict: Data, *, several: bool) -> str:
    """The proposition that a verdict is on."""
    where = place(verdict["case"], verdict["component"], several=several)
    bound = verdict["bound"]["at_most"]
    how = "holds in every valid episode of" if bound is None else "keeps its bound in"
    if verdict["without_effect"]:
        how = "is violated in no episode, valid or not, of"
    return f"{name(verdict['requirement'])} {how} {where}."


def evidence_text(verdict: Data) -> str:
    """The counts and the bound of a verdict, as they stand in the record."""
    what = "pairs" if verdict["pairs"] is not None else "episodes"
    runs = f"{verdict['run']} run, {verdict['planned']} planned"
    told = [
        ", ".join([f"n = {verdict['episodes']} valid {what} of {runs}", *besides(verdict)]),
        f"violations: {verdict['violations']}{also_without(verdict)}",
        _upper(verdict),
    ]
    if verdict["margin"] is not None:
        told.append(f"least margin {verdict['margin']:.4g}")
    return "; ".join(told) + "."


def short_evidence(verdict: Data) -> list[str]:
    """The same in three lines of a few characters, for a circle of the picture."""
    upper = verdict["bound"]["upper"]
    bound = "no bound" if upper is None else f"≤ {percent(upper)}"
    return [f"n = {verdict['episodes']}", f"{verdict['violations']} violated", bound]


def _upper(verdict: Data) -> str:
    bound = verdict["bound"]
    method = one_line(str(bound["method"]))
    if bound["upper"] is None:
        return f"no bound on the rate of violations{why_no_rate(verdict)} ({method})"
    return (
        f"rate of violations at most {percent(bound['upper'])} with confidence "
        f"{percent(bound['confidence'])} ({method})"
    )


def waiver_text(verdict: Data) -> str:
    """The doubt that a waiver leaves, with the reason that somebody gave for it."""
    waiver = verdict["waiver"]
    reason = sentence(str(waiver["reason"] or "none was given"))
    return (
        f"Waived ({name(str(waiver['kind']))}), reason: {reason} The verdict stays "
        f"{verdict['verdict']}: a waiver accepts the doubt that remains, and takes none away."
    )


def scenario_text(scenario: str, parameters: list[Data]) -> str:
    """A scenario of the operational domain, with its variation ranges."""
    if not parameters:
        return f"Scenario {name(scenario)}: no parameter varies."
    told = [f"{name(one['parameter'])} {_range_text(one)}" for one in parameters]
    return f"Scenario {name(scenario)}: {'; '.join(told)}."


def _range_text(parameter: Data) -> str:
    drawn, covered = parameter["drawn"], percent(parameter["covered"])
    if parameter["choices"] is None:
        low, high = _figure(parameter["low"]), _figure(parameter["high"])
        return f"in [{low}, {high}], {drawn} drawn, {covered} of its tenths reached"
    choices = names_text([str(one["value"]) for one in parameter["choices"]])
    return f"one of {choices}; {drawn} drawn, {covered} of the choices reached"


def monitor_text(monitor: str, target: str, rows: list[Data]) -> str:
    """The quality of a monitor over all cases in which recovery did not act."""
    names = ("true_positives", "false_negatives", "false_positives", "true_negatives")
    hits, misses, alarms, quiet = (sum(row[key] for row in rows) for key in names)
    raised = (
        f"flagged {hits} of {hits + misses} episodes with a violation"
        if hits + misses
        else "met no violation that it could have missed"
    )
    return (
        f"{name(monitor)} for {name(target)}: {raised}, and {alarms} of {alarms + quiet} without "
        f"one, in {len(rows)} cases."
    )


def names_text(names: list[str], most: int = 8) -> str:
    """Names with commas; of many, the first few and how many more there are."""
    told = ", ".join(name(one) for one in names[:most])
    return f"{told} and {len(names) - most} more" if len(names) > most else told


def _figure(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, int | float) else name(str(value))


def sentence(text: str) -> str:
    """A text of a user's on one line, ended."""
    told = one_line(text, TEXT)
    return told if not told or told[-1] in ".!?)" else f"{told}."
