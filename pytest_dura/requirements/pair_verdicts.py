"""What a requirement on pairs says of one pair: an episode, and its twin without something."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.requirements.checks import check_name, load_function
from pytest_dura.requirements.episodes import EpisodeVerdict, EpisodeWord
from pytest_dura.requirements.model import Requirement


def pair_verdict(with_it: EpisodeVerdict, without: EpisodeVerdict) -> EpisodeVerdict:
    """Whether something made an episode violate a check: violated with it, satisfied without it.

    The margin is that of the implication "satisfied without it implies satisfied with it". A pair
    of which one run is missing or invalid is so itself: there is nothing to compare.

    Args:
        with_it: Verdict on the episode.
        without: Verdict on its twin of the same seed.
    """
    words = with_it.verdict, without.verdict
    spoilt = next((one for one in ("missing", "invalid") if one in words), None)
    if spoilt is not None:
        side = with_it if with_it.verdict == spoilt else without
        detail = f"{side.episode}: {side.detail}"
        return replace(with_it, verdict=side.verdict, margin=None, time=None, detail=detail)
    margins = with_it.margin, without.margin
    margin = None
    if margins[0] is not None and margins[1] is not None:
        margin = max(margins[0], -margins[1])
    if words == ("violated", "satisfied"):
        detail = f"violated only with it: {with_it.detail}"
        return replace(with_it, margin=margin, detail=detail)
    detail = f"{words[0]} with it, {words[1]} without it"
    return replace(
        with_it, verdict="satisfied", margin=margin, time=None, detail=detail, vacuous=False
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
        values: The measure of both; ``None`` of a run that is invalid or missing.
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
    )


def _compared(
    episode: Episode, twin: Episode, values: tuple[float | None, float | None], bound: float
) -> tuple[EpisodeWord, float | None, str]:
    own, other = values
    if own is None or other is None:
        spoilt = [one for one in (episode, twin) if one.validity != "valid"]
        missing = next((one for one in spoilt if one.failure is not None), None)
        if missing is not None:
            return "missing", None, f"{missing.id}: {missing.failure}"
        return "invalid", None, f"{spoilt[0].id}: {spoilt[0].invalid_reason}"
    if not math.isfinite(own):
        if not math.isfinite(other):
            return "invalid", None, "the measure has no value in either run"
        return "violated", None, f"the measure has no value, and {other:.4g} without"
    if not math.isfinite(other):
        return "satisfied", None, f"the measure is {own:.4g}, and has no value without"
    detail = f"the measure is {own:.4g}, and {other:.4g} without: {own - other:+.4g}"
    margin = bound - (own - other)
    return ("satisfied" if margin >= 0 else "violated"), margin, detail


def measured(measure: str | Callable[[Episode], float], episode: Episode) -> float:
    """The measure of an episode; NaN for none.

    Raises:
        ConfigurationError: If the function cannot be imported, fails, or returns no number.
    """
    function = load_function(measure) if isinstance(measure, str) else measure
    try:
        return float(function(episode))
    except ConfigurationError:
        raise
    except Exception as error:
        name = check_name(measure)
        raise ConfigurationError(
            f"the measure {name} failed on {episode.id}: {describe_error(error)}",
            key="paired.measure",
            found=name,
            expected="a function of an episode to a number",
            remedy="mend the function; let it return NaN where there is no value",
        ) from error
