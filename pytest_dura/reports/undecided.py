"""Obstacles: why a verdict is undecided, and what would decide it."""

from __future__ import annotations

from dataclasses import dataclass

from pytest_dura.evidence.gate import NOT_REPEATABLE
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.reports.incidents import (
    OwnFailures,
    own_failure_key,
    own_failure_step,
)
from pytest_dura.requirements.campaign_verdicts import (
    FEW_PROPOSALS,
    REPEATED,
    SITUATIONS,
    STOPPED,
    TEST_FAILED,
    rate_advice,
)
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.shortfalls import own_failure_clause

_MAX_DETAIL = 300


@dataclass(frozen=True)
class Obstacle:
    """The first reason why a verdict is undecided.

    Args:
        key: Equal for verdicts that one measure would decide.
        headline: What stands in the way, without a full stop.
        next_step: What would decide it.
        episode: A run that shows it; ``None`` without any.
        shows_event: Whether that run's grave event belongs to it.
        cause: What it shares with violations of one cause; empty where no event is known.
    """

    key: str
    headline: str
    next_step: str
    episode: str | None = None
    shows_event: bool = False
    cause: str = ""


def obstacle_of(verdict: ItemVerdict, requirement: Requirement, failures: OwnFailures) -> Obstacle:
    """Name the first obstacle of an undecided verdict: what comes before others explains them.

    Args:
        verdict: An undecided one.
        requirement: That it is on.
        failures: How often the component failed by itself in the runs of the case.
    """
    known = (
        _stopped(verdict), _missing(verdict), _own_failure(verdict, failures),
        _not_repeatable(verdict), _unseen_crash(verdict), _not_run(verdict), _invalid(verdict),
        _open(verdict),
        _one_situation(verdict), _vacuous(verdict),
    )  # fmt: skip
    return next(filter(None, known), None) or _by_rate(verdict, requirement)


def _stopped(verdict: ItemVerdict) -> Obstacle | None:
    _, sign, why = verdict.reason.partition(STOPPED)
    if not sign:
        return None
    return Obstacle(
        f"stopped {why}",
        f"No run of {name(verdict.case)} could be judged: {one_line(why, 2 * _MAX_DETAIL)}",
        "Mend what it names, and run the session again.",
    )


def _missing(verdict: ItemVerdict) -> Obstacle | None:
    uncounted = verdict.first_uncounted
    if not verdict.missing or uncounted is None or uncounted.verdict != "missing":
        return None
    detail = one_line(uncounted.detail, _MAX_DETAIL).removeprefix("infrastructure: ")
    if detail.startswith(TEST_FAILED):
        return Obstacle(
            detail,
            f"A run is not judged: {detail}",
            "Mend the test, whose traceback pytest shows, and run the session again.",
            uncounted.episode,
        )
    return Obstacle(
        f"missing {detail}",
        f"A run is missing, since a role or the simulator failed: {detail}",
        "Repair what failed there, and run the session again.",
        uncounted.episode,
    )


def _own_failure(verdict: ItemVerdict, failures: OwnFailures) -> Obstacle | None:
    """The component failed in each run, or so often that too little that it did was judged."""
    event = failures.event
    if event is None or not (failures.everywhere or FEW_PROPOSALS in verdict.reason):
        return None
    return Obstacle(
        own_failure_key(event),
        own_failures_text(verdict, failures),
        own_failure_step(name(verdict.component), event.detail),
        failures.episode,
        cause=own_failure_key(event),
    )


def own_failures_text(verdict: ItemVerdict, failures: OwnFailures) -> str:
    """What the component did by itself, when first, and in how many runs of the case."""
    event = failures.event
    assert event is not None, "of a component that failed"
    what = own_failure_clause(name(verdict.component), one_line(event.detail, _MAX_DETAIL))
    count = "each" if failures.everywhere else str(failures.failed)
    runs = f"{count} of {counted(failures.runs, 'run')} of {name(verdict.case)}"
    return f"{what} at t = {event.time:.2f} s, in {runs}"


def _not_repeatable(verdict: ItemVerdict) -> Obstacle | None:
    _, sign, difference = verdict.reason.partition(NOT_REPEATABLE)
    if not sign:
        return None
    return Obstacle(
        f"repeat {verdict.case}",
        f"Not repeatable: {one_line(difference, _MAX_DETAIL)}",
        "Draw what is random from the episode's seed, and keep nothing from episode to episode; "
        "or declare it (`repeatable = False`), so that the runs count as draws.",
    )


def _unseen_crash(verdict: ItemVerdict) -> Obstacle | None:
    if not verdict.unseen_crashes:
        return None
    return Obstacle(
        f"crash {verdict.case}",
        "A run ended critical, and no requirement of its case sees it",
        "State a requirement that this end violates, or find out why none of them does.",
        verdict.unseen_crashes[0],
        shows_event=True,
    )


def _not_run(verdict: ItemVerdict) -> Obstacle | None:
    left = verdict.planned - verdict.run - verdict.saved
    if left <= 0:
        return None
    was = "was" if left == 1 else "were"
    return Obstacle(
        "not run",
        f"{left} of {counted(verdict.planned, 'planned run')} of {name(verdict.case)} {was} not "
        "run",
        "Run what is missing: `--dura-resume` goes on with what was simulated.",
    )


def _invalid(verdict: ItemVerdict) -> Obstacle | None:
    uncounted = verdict.first_uncounted
    if verdict.episodes and (uncounted is None or uncounted.verdict != "invalid"):
        return None
    detail = "no run was valid" if uncounted is None else one_line(uncounted.detail, _MAX_DETAIL)
    return Obstacle(
        f"invalid {verdict.case}",
        f"{verdict.invalid} of {counted(verdict.run, 'run')} of {name(verdict.case)} are invalid: "
        f"{detail}",
        "Let the fault act on what a role reads, while it is read, or let the run last until the "
        "requirement is decided.",
        None if uncounted is None else uncounted.episode,
    )


def _open(verdict: ItemVerdict) -> Obstacle | None:
    if not verdict.open:
        return None
    return Obstacle(
        f"open {verdict.case}",
        f"{counted(len(verdict.open), 'run')} of {name(verdict.case)} ended before "
        f"{name(verdict.requirement)} was decided",
        "Look at what ended them: what would have followed is not known.",
        verdict.open[0],
        shows_event=True,
    )


def _one_situation(verdict: ItemVerdict) -> Obstacle | None:
    if verdict.situation is None:
        return None
    step = (
        "Declare what varies between its runs (`variation` of the scenario)."
        if verdict.situation == REPEATED
        else "Widen the declared variation, or vary what the component can perceive."
    )
    return Obstacle(
        f"situation {verdict.situation}",
        f"All runs of {name(verdict.case)} are equal: {SITUATIONS[verdict.situation]}",
        step,
    )


def _vacuous(verdict: ItemVerdict) -> Obstacle | None:
    prevents = verdict.paired is not None and verdict.paired.prevents
    # Where there was nothing to prevent, a run is none of the counted ones.
    if not verdict.vacuous or verdict.vacuous < verdict.episodes or (prevents and verdict.episodes):
        return None
    return Obstacle(
        f"vacuous {verdict.requirement}",
        f"The condition of {name(verdict.requirement)} held in no run, so that nothing was judged",
        "Add a scenario in which its condition comes to hold.",
    )


def _by_rate(verdict: ItemVerdict, requirement: Requirement) -> Obstacle:
    """Too few runs for the rate that is asked for, or another reason of the verdict's own."""
    worst = verdict.counterexamples[0].episode if verdict.counterexamples else None
    at_most, upper = requirement.at_most, verdict.bound.upper
    if at_most is None or upper is None or upper <= at_most:
        reason = one_line(verdict.reason, _MAX_DETAIL)
        return Obstacle(
            f"other {reason}", f"{name(verdict.requirement)}: {reason}",
            "Look at its reason in the report: no number of runs alone decides it.", worst,
        )  # fmt: skip
    violations = verdict.violations + len(verdict.open)
    place = f"{name(verdict.requirement)} on {name(verdict.case)}"
    violate = "violates" if violations == 1 else "violate"
    counts = f"{violations} of {verdict.episodes} {violate} {place}"
    if violations > at_most * verdict.episodes:
        headline = (
            f"More runs violate it than are allowed, too few to be sure: {counts}, where "
            f"{100 * at_most:.3g} % are allowed"
        )
    else:
        headline = (
            f"Too few runs to tell: {counts}, so that up to {100 * upper:.3g} % of such runs may, "
            f"where {100 * at_most:.3g} % are allowed"
        )
    advice = rate_advice(violations, verdict.episodes, at_most, requirement.confidence)
    return Obstacle(
        f"rate {verdict.requirement}", headline, f"{advice[0].upper()}{advice[1:]}.", worst
    )
