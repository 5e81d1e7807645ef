"""Verdicts in words: counts, bounds, waivers and sentences, for every format and the terminal.

A rate never stands without its n and its confidence. Propositions are never of praise.
"""

from __future__ import annotations

from pytest_dura.evidence.item_verdicts import ItemVerdict, Waiver
from pytest_dura.evidence.text import counted, first_few, name, one_line
from pytest_dura.requirements.campaign_verdicts import SITUATIONS, weakness
from pytest_dura.requirements.model import Requirement

MAX_TEXT = 400
"""Characters of a user's text in a sentence; the record has all of it."""
_LONGEST_TEXT = 2000
"""Characters of a text that is shown in several lines."""


def sample_text(verdict: ItemVerdict) -> str:
    """Runs that a verdict rests on: ``12 valid of 15 run, 15 planned; 0 violations``."""
    text = (
        f"{verdict.episodes} valid of {verdict.run} run, {verdict.planned} planned; "
        f"{counted(verdict.violations, 'violation')}"
        f"{fault_free_violations_text(verdict)}"
    )
    return ", ".join([text, *other_run_counts(verdict)])


def other_run_counts(verdict: ItemVerdict) -> list[str]:
    """Other counts of a verdict's runs that are not zero: ``2 ended before it was decided``."""
    counts = {
        "ended before it was decided": len(verdict.open),
        "violated without effect of the fault": verdict.without_effect,
        "invalid": verdict.invalid,
        "missing": verdict.missing,
        "vacuous": verdict.vacuous,
    }
    return [f"{count} {what}" for what, count in counts.items() if count]


def fault_free_violations_text(verdict: ItemVerdict) -> str:
    """Number of a verdict's violations that are not the faults' doing; empty if none is known."""
    count = verdict.also_without
    return f" ({count} of them also without the faults)" if count else ""


def rate_bound(verdict: ItemVerdict) -> str:
    """The bound on the rate of violations with its confidence, or that there is none."""
    bound, weak = verdict.bound, _weakness_note(verdict)
    if bound.upper is None:
        return f"no bound{no_rate_reason(verdict)}{weak}"
    return f"rate <= {bound.upper:.3g} at {bound.confidence:g} confidence{weak}"


def _weakness_note(verdict: ItemVerdict) -> str:
    """That little is asked for, after a comma; else empty."""
    weak = weakness(verdict.bound.at_most, verdict.bound.confidence)
    return f", {weak}" if weak else ""


def no_rate_reason(verdict: ItemVerdict) -> str:
    """Reason for which there is no rate, after a colon: all runs are equal; else empty."""
    return "" if verdict.situation is None else f": {SITUATIONS[verdict.situation]}"


def assertion_sentences(verdict: ItemVerdict) -> list[str]:
    """Sentences on what a verdict rests on where assertions of a test decided it.

    There is none for a verdict by checks alone. Names in it are a user's, and have to be escaped.
    """
    assertion = verdict.assertion
    if assertion is None:
        return []
    seen = first_few(assertion.observed) or "nothing"
    sentences = [
        f"failed: {failure.message}, in {failure.episode}" for failure in assertion.failed[:1]
    ]
    if assertion.alone:
        sentences.append(f"by assertion: the test looked at {seen}")
    elif assertion.observed:
        sentences.append(f"by its check, and by assertion: the test looked at {seen}")
    for entry in assertion.false:
        episodes = counted(entry.episodes, "episode")
        sentences.append(f"false in {episodes} with which the test passed: {entry.check}")
    return sentences


def reading_sentences(verdict: ItemVerdict) -> list[str]:
    """List what assertions decided and read; what failed is shown with the failure."""
    sentences = [one_line(sentence, _LONGEST_TEXT) for sentence in assertion_sentences(verdict)]
    return [
        sentence for sentence in sentences if not sentence.startswith(("failed: ", "by its check"))
    ]


def part_text(share: float) -> str:
    """A share as a percentage of four digits at most: ``18.1 %``."""
    return f"{100 * share:.4g} %"


def requirement_text(requirement: Requirement) -> str:
    """The requirement as a proposition, with its bound."""
    return f"{name(requirement.id)}: {as_sentence(requirement.text)} {_bound_text(requirement)}"


def _bound_text(requirement: Requirement) -> str:
    """The bound that the requirement sets a campaign."""
    pairs = requirement.paired
    what = "episodes"
    if pairs is not None:
        lacking = f"with and without {name(pairs.without)}"
        if pairs.prevents:
            lacking += f" whose violation without it {name(pairs.reference)} avoids"
        elif pairs.reference:
            lacking = f"of the component and of {name(pairs.reference)}"
        what = f"pairs of equal seeds, {lacking},"
    if requirement.at_most is None:
        return f"Asked for in all {what.rstrip(',')}."
    weak = weakness(requirement.at_most, requirement.confidence)
    return (
        f"Violated in at most {part_text(requirement.at_most)} of {what.rstrip(',')}, "
        f"confidence {part_text(requirement.confidence)}{f' ({weak})' if weak else ''}."
    )


def verdict_proposition(verdict: ItemVerdict) -> str:
    """The proposition that a verdict decides on its runs, with bound and confidence.

    What is supported states what was shown; what is not states what was asked for.
    """
    runs = "pairs of such runs" if verdict.pairs is not None else "such runs"
    bound = verdict.bound
    rate = bound.upper if verdict.verdict == "supported" else bound.at_most
    if rate is not None:
        sure = part_text(bound.confidence)
        return f"Violated in at most {part_text(rate)} of {runs}, with {sure} confidence."
    if verdict.verdict == "supported":
        count = f"{verdict.violations or 'none'} of the {verdict.episodes} {runs}"
        return f"Violated in {count}; no bound on their rate{no_rate_reason(verdict)}."
    valid = ", valid or not" if verdict.without_effect else ""
    return f"Violated in none of {runs}{valid}."


def evidence_text(verdict: ItemVerdict) -> str:
    """The counts and the bound of a verdict, as they stand in the record."""
    what = "pairs" if verdict.pairs is not None else "episodes"
    runs = f"{verdict.run} run, {verdict.planned} planned"
    parts = [
        ", ".join([f"n = {verdict.episodes} valid {what} of {runs}", *other_run_counts(verdict)]),
        f"violations: {verdict.violations}{fault_free_violations_text(verdict)}",
        _upper_text(verdict),
    ]
    if verdict.margin is not None:
        parts.append(f"least margin {verdict.margin:.4g}")
    return "; ".join(parts) + "."


def _upper_text(verdict: ItemVerdict) -> str:
    bound = verdict.bound
    method = one_line(bound.method)
    if bound.upper is None:
        return f"no bound on the rate of violations{no_rate_reason(verdict)} ({method})"
    return (
        f"rate of violations at most {part_text(bound.upper)} with confidence "
        f"{part_text(bound.confidence)} ({method}){_weakness_note(verdict)}"
    )


def waiver_text(waiver: Waiver, status: str) -> str:
    """The doubt that a waiver leaves on a verdict, with the reason given for it."""
    reason = as_sentence(waiver.reason or "none was given")
    return (
        f"Waived ({name(waiver.kind)}), reason: {reason} The verdict stays "
        f"{status}: a waiver accepts the doubt that remains, and takes none away."
    )


def as_sentence(text: str) -> str:
    """A text of a user's on one line, ended."""
    line = one_line(text, MAX_TEXT)
    return line if not line or line[-1] in ".!?)" else f"{line}."


def challenge_text(verdict: ItemVerdict, where: str, listed: int) -> str:
    """The violations against a verdict's proposition, and how many of them are not listed."""
    how = {
        "violated": "",
        "supported": ", as many as the bound allows",
        "undecided": ", which decide nothing yet",
    }[verdict.verdict]
    what = "pairs" if verdict.pairs is not None else "episodes"
    place = f"{name(verdict.requirement)} in {where}"
    rest = len(verdict.counterexamples) - listed
    more = f" {rest} more stand in the record." if listed and rest > 0 else ""
    if verdict.without_effect and not verdict.violations:
        return (
            f"{verdict.without_effect} of {verdict.invalid} invalid {what} violate "
            f"{place}, without effect of the fault.{more}"
        )
    return (
        f"{verdict.violations} of {verdict.episodes} valid {what} violate "
        f"{place}{how}{fault_free_violations_text(verdict)}.{more}"
    )
