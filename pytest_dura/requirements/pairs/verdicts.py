"""What a requirement on pairs says of one pair: an episode, and its twin without something."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from pytest_dura.core.boundary import Boundary
from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.requirements.checks import check_name, load_function
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.verdicts.episodes import EpisodeVerdict, EpisodeWord

_ROUNDING = 1e-9
"""Share of the greatest value by which a growth may miss the bound and still equals it: times are
multiples of a time step that has no exact float, such as 8.3 s and 6.3 s."""


def check_comparison(requirement: Requirement) -> None:
    """Refuse a requirement on pairs that does not say, or says twice, what is compared.

    Raises:
        ConfigurationError: Without a check and a measure, with both, and for a measure without a
            bound on its change or such a bound without a measure.
    """
    paired = requirement.paired
    if paired is None:
        return
    measure, bound = paired.measure, paired.change_at_most
    given = {"check": requirement.check, "measure": measure}
    named = [f"{key} {value}" for key, value in given.items() if value]
    if len(named) != 1:
        raise ConfigurationError(
            "pairs are compared by a check or by a measure",
            key="paired.measure" if named else "check",
            found=" and ".join(named) or "neither",
            expected="one of them",
            remedy="leave one out" if named else "add `check`, or `measure` and `change_at_most`",
        )
    if bool(measure) != (bound is not None):
        raise ConfigurationError(
            "`measure` and `change_at_most` go together",
            key="paired.change_at_most",
            found=measure or bound,
            expected="both or neither",
            remedy="add the other one" if measure else "add `measure`, or leave the bound out",
        )


def pair_verdict(with_it: EpisodeVerdict, without: EpisodeVerdict) -> EpisodeVerdict:
    """Whether something made an episode violate a check: violated with it, satisfied without it.

    The margin is that of the implication "satisfied without it implies satisfied with it". A pair
    of which one run is missing or invalid is so itself: there is nothing to compare. One in which
    the check's condition held in neither run is vacuous.

    Args:
        with_it: Verdict on the episode.
        without: Verdict on its twin of the same seed.
    """
    words = with_it.verdict, without.verdict
    spoilt = next((one for one in ("missing", "invalid") if one in words), None)
    if spoilt is not None:
        return _as_side(with_it, with_it if with_it.verdict == spoilt else without, spoilt)
    if "open" in words and words[0] != "satisfied" and words[1] != "violated":
        return _as_side(with_it, with_it if words[0] == "open" else without, "open")
    if (with_it.without_effect or without.without_effect) and words != ("violated", "satisfied"):
        # Nothing was violated only with it, and the runs are no sample of runs with the fault.
        side = with_it if with_it.without_effect else without
        return _as_side(with_it, side, "invalid")
    margins = with_it.margin, without.margin
    margin = None
    if margins[0] is not None and margins[1] is not None:
        margin = max(margins[0], -margins[1])
    if words == ("violated", "satisfied"):
        detail = f"violated only with it: {with_it.detail}"
        return replace(with_it, margin=margin, detail=detail)
    detail = f"{words[0]} with it, {words[1]} without it"
    vacuous = with_it.vacuous and without.vacuous
    return replace(
        with_it, verdict="satisfied", margin=margin, time=None, detail=detail, vacuous=vacuous
    )


def _as_side(with_it: EpisodeVerdict, side: EpisodeVerdict, verdict: EpisodeWord) -> EpisodeVerdict:
    """The pair as invalid, missing or open as one of its runs is."""
    twin = "" if side is with_it else f", in {side.episode}"
    return replace(
        with_it,
        verdict=verdict,
        margin=None,
        time=None,
        detail=f"{side.detail}{twin}",
        without_effect=False,
        ended=side.ended,
    )


def change_verdict(
    requirement: Requirement,
    episode: Episode,
    twin: Episode,
    values: tuple[float | None, float | None],
) -> EpisodeVerdict:
    """Whether a measure grew by more than is acceptable.

    A value that is not finite stands for "never", which is more than any number: an episode
    without a value whose twin has one violates the requirement, and a pair without any says
    nothing.

    Args:
        requirement: A requirement on pairs with a bound on the change.
        episode: The episode.
        twin: The episode of the same seed without something.
        values: The measure of both; ``None`` of a run that is invalid or missing, or not whole.
    """
    assert requirement.paired is not None
    bound = requirement.paired.change_at_most
    assert bound is not None
    word, margin, detail = _compared(episode, twin, values, bound)
    return EpisodeVerdict(
        requirement=requirement.id,
        episode=episode.id,
        component=episode.spec.component,
        verdict=word,
        margin=margin,
        time=None,
        detail=detail,
        proposals=episode.metrics.proposals,
        valid_proposals=episode.metrics.valid_proposals,
        idle=episode.idle_faults,
    )


def _compared(
    episode: Episode, twin: Episode, values: tuple[float | None, float | None], bound: float
) -> tuple[EpisodeWord, float | None, str]:
    own, other = values
    if own is None or other is None:
        pair = (episode, twin)
        spoilt = [one for one in pair if one.validity != "valid" or one.termination == "decided"]
        missing = [one for one in spoilt if one.failure is not None]
        side = [*missing, *spoilt][0]
        why = side.failure or side.invalid_reason or "ended before its time, once all was decided"
        detail = f"{why}, in {side.id}"
        return ("missing" if missing else "invalid"), None, detail
    if not math.isfinite(own):
        if not math.isfinite(other):
            return "invalid", None, "the measure has no value in either run"
        return "violated", None, f"the measure has no value, and {other:.4g} without"
    if not math.isfinite(other):
        return "satisfied", None, f"the measure is {own:.4g}, and has no value without"
    detail = f"the measure is {own:.4g}, and {other:.4g} without: {own - other:+.4g}"
    margin = bound - (own - other)
    if abs(margin) <= _ROUNDING * max(abs(own), abs(other), abs(bound)):
        margin = 0.0
    return ("satisfied" if margin >= 0 else "violated"), margin, detail


def measured(measure: str | Callable[[Episode], float], episode: Episode) -> float:
    """The measure of an episode; NaN for none.

    Raises:
        ConfigurationError: If the function cannot be imported, fails, or returns no number.
    """
    function = load_function(measure) if isinstance(measure, str) else measure
    try:
        with Boundary() as boundary:
            return float(function(episode))
    except ConfigurationError:
        raise
    except BaseException as error:
        boundary.let_pass(error)
        name = check_name(measure)
        raise ConfigurationError(
            f"the measure {name} failed on {episode.id}: {describe_error(error)}",
            key="paired.measure",
            found=name,
            expected="a function of an episode to a number",
            remedy="mend the function; let it return NaN where there is no value",
        ) from error
