"""What a requirement on pairs says of one pair: an episode, and its twin without something."""

from __future__ import annotations

import math
from dataclasses import replace

from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError, describe_error
from pytest_dura.requirements.checks import load_function
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
    requirement: Requirement, episode: Episode, twin: Episode, values: tuple[float, float]
) -> EpisodeVerdict:
    """Whether a measure grew by more than is acceptable.

    A value that is not a number stands for "never", more than any number: an episode without one
    whose twin has one violates the requirement, and a pair without any says nothing.

    Args:
        requirement: A requirement on pairs with a bound on the change.
        episode: The episode.
        twin: The episode of the same seed without something.
        values: The measure of both.
    """
    assert requirement.paired is not None
    bound = requirement.paired.change_at_most
    assert bound is not None
    own, other = values
    word: EpisodeWord
    margin: float | None = None
    if spoilt := next((one for one in (episode, twin) if one.failure is not None), None):
        word, detail = "missing", str(spoilt.failure)
    elif math.isnan(own) and math.isnan(other):
        word, detail = "invalid", "the measure has no value in either run"
    elif math.isnan(own):
        word, detail = "violated", f"it has no value, and {other:.4g} without"
    elif math.isnan(other):
        word, detail = "satisfied", f"it is {own:.4g}, and has no value without"
    else:
        margin = bound - (own - other)
        word = "satisfied" if margin >= 0 else "violated"
        detail = f"it is {own:.4g}, and {other:.4g} without: a change of {own - other:+.4g}"
    invalid = next((one for one in (episode, twin) if one.validity == "invalid"), None)
    if word == "satisfied" and invalid is not None:
        word, detail = "invalid", f"{invalid.id}: {invalid.invalid_reason}"
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


def measured(path: str, episode: Episode) -> float:
    """The measure of an episode; NaN for one that has no value, or is missing.

    Raises:
        ConfigurationError: If the function cannot be imported, fails, or returns no number.
    """
    if episode.failure is not None:
        return math.nan
    function = load_function(path)
    try:
        return float(function(episode))
    except ConfigurationError:
        raise
    except Exception as error:
        raise ConfigurationError(
            f"the measure {path} failed on {episode.id}: {describe_error(error)}",
            key="paired.measure",
            found=path,
            expected="a function of an episode to a number",
            remedy="mend the function; let it return NaN where there is no value",
        ) from error
