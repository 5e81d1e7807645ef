"""What a test on one episode says of a requirement, together with the requirement's own check."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import ConfigurationError

if TYPE_CHECKING:
    from pytest_dura.requirements.model import Requirement
    from pytest_dura.requirements.verdicts import JudgedEpisode
    from pytest_dura.requirements.verdicts.episodes import EpisodeVerdict, EpisodeWord


def outcome_of_test(
    requirement: Requirement,
    requirements: Sequence[Requirement],
    episode: JudgedEpisode,
    error: BaseException | None,
    failed: str = "",
) -> dict[str, Any]:
    """The verdict of a test on an episode: by its outcome, and by the requirement's own check.

    Args:
        requirement: What the test decides.
        requirements: Those of the episode's case.
        episode: The episode.
        error: What the test raised, if anything.
        failed: Which of its own assertions failed, of :func:`failed_assertion`; empty if none did.
    """
    from pytest_dura.plugin.observed_episode import looks_at
    from pytest_dura.requirements.verdicts.episodes import EARLY_ENDS, is_unseen_crash

    word, detail = word_of_test(episode, error)
    failed = failed if word == "violated" else ""
    detail = failed or detail
    margin = time = None
    judged = judged_by_own_check(requirement, episode)
    if judged is not None and judged.verdict == "violated":
        word, margin, time = "violated", judged.margin, judged.time
        detail = detail or judged.detail
    elif judged is not None and word == "satisfied" and judged.verdict != "satisfied":
        word, detail = judged.verdict, judged.detail
    vacuous = word == "satisfied" and judged is not None and judged.vacuous
    return {
        "requirement": requirement.id,
        "episode": episode.id,
        "component": episode.spec.component,
        "verdict": word,
        "margin": margin,
        "time": time,
        "detail": detail,
        "proposals": episode.metrics.proposals,
        "valid_proposals": episode.metrics.valid_proposals,
        "vacuous": vacuous,
        "idle": list(episode.idle_faults),
        "without_effect": word == "violated" and episode.validity == "invalid",
        "ended": episode.termination if episode.termination in EARLY_ENDS else "",
        "unseen_crash": word != "violated" and is_unseen_crash(episode, requirements),
        "assertion": {
            "alone": judged is None,
            "by_check": judged is not None and judged.verdict == "violated",
            "observed": looks_at(episode).names,
            "false": [] if failed else list(looks_at(episode).false),
            "failed": failed,
        },
    }


def failed_assertion(item: pytest.Item, found: pytest.ExceptionInfo[BaseException]) -> str:
    """What of a test failed: its message with what was compared, and the line in its file."""
    from pytest_dura.evidence.text import one_line

    error = found.value
    lines = [line for line in str(error).split("\n") if line.strip()]
    # Behind a message of the test's own stands what pytest makes of the comparison.
    compared = [line for line in lines[1:] if line.startswith("assert ")]
    told = "; ".join([*lines[:1], *compared[:1]]) or type(error).__name__
    own = [entry for entry in found.traceback if entry.path == item.path]
    if not own:
        return one_line(told, 500)
    place = item.nodeid.partition("::")[0]
    return f"{one_line(told, 500)} ({place}:{own[-1].lineno + 1})"


def judged_by_own_check(requirement: Requirement, episode: JudgedEpisode) -> EpisodeVerdict | None:
    """What the requirement's own check says; ``None`` without one, and where none can be asked."""
    if not requirement.check or requirement.paired is not None:
        return None
    from pytest_dura.requirements.verdicts.episodes import judge_episode

    try:
        return judge_episode(requirement, episode)
    except ConfigurationError:  # the check is about signals of another domain
        return None


def word_of_test(episode: JudgedEpisode, error: BaseException | None) -> tuple[EpisodeWord, str]:
    """What the outcome of a test says of the episode that it looked at, and why."""
    first = str(error).partition("\n")[0] if error is not None else ""
    if episode.failure is not None:
        return "missing", episode.failure
    if error is None:
        return "satisfied", ""
    spoilt = isinstance(error, pytest.fail.Exception) and first.startswith("invalid: ")
    if spoilt or isinstance(error, pytest.skip.Exception):
        return "invalid", first
    if isinstance(error.__context__, ConfigurationError):
        return "missing", f"infrastructure: the test cannot be judged: {first}"
    if isinstance(error, (AssertionError, pytest.fail.Exception)):
        return "violated", first
    return "missing", f"infrastructure: the test raised {type(error).__name__}: {first}"
