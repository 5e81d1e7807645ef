"""What several attempts at an episode, and several looks at it, come to."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.verdicts.episodes import EpisodeVerdict
from pytest_dura.requirements.verdicts.judging import judge_campaign
from pytest_dura.requirements.verdicts.situations import Situation

Data = dict[str, Any]


def test_of(item: str) -> str:
    """The test function of a node id, without its parameters."""
    return item.partition("[")[0]


def question(item: str, verdict: Data) -> tuple[str, ...]:
    """What a verdict answers: who asked, of what, and what was asked."""
    asked = [verdict["check"], verdict["paired"], verdict["method"]]
    asked += [verdict["bound"]["at_most"], verdict["bound"]["confidence"]]
    names = ("requirement", "case", "component")
    return item, *(verdict[name] for name in names), json.dumps(asked, sort_keys=True)


def final_outcomes(told: Sequence[Data]) -> list[Data]:
    """Of several attempts of an item a violation counts before anything else, then the last."""
    final: dict[str, Data] = {}
    for one in told:
        before = final.get(one["item"])
        if before is None or before["verdict"] != "violated":
            final[one["item"]] = one
    return list(final.values())


LOOKED_AT = 50
"""Names of what a test looked at."""
FAILED = 10
"""Episodes with the assertion that failed there."""
WORST_FIRST = ("violated", "missing", "open", "invalid", "satisfied")


def worst_by_episode(final: list[Data]) -> list[EpisodeVerdict]:
    """One verdict for each episode, at which other parameters of a test may look again."""
    names = EpisodeVerdict.__dataclass_fields__
    worst: dict[str, Data] = {}
    for one in sorted(final, key=lambda one: WORST_FIRST.index(one["verdict"])):
        worst.setdefault(one["episode"], one)
    found = sorted(worst.values(), key=lambda one: _run_number(one["episode"]))
    return [EpisodeVerdict.from_json({name: one[name] for name in names}) for one in found]


def judged_looks(
    requirement: Requirement,
    case: str,
    component: str,
    told: Sequence[Data],
    situation: Situation | None = None,
) -> Data:
    """The verdict of a test that looks at one episode at a time, as plain data.

    Args:
        requirement: What it decides; its rate is that of the test.
        case: Id of the case.
        component: Name of the component under test.
        told: All that it told of episodes, with ``item``, ``planned``, ``at_most``, ``confidence``.
        situation: What the case's runs are, if all of them are equal.
    """
    # Tests are a fixed number, and run in no fixed order: no sequential method applies.
    judged_by = replace(
        requirement,
        at_most=told[0]["at_most"],
        confidence=told[0]["confidence"],
        method=None,
        p0=None,
    )
    planned = max(one["planned"] for one in told)
    final = worst_by_episode(final_outcomes(told))
    # Each run is a test of its own here: none is saved where they are all equal.
    whole = len(final) >= planned > 1
    return judge_campaign(
        judged_by,
        case,
        final,
        planned=planned,
        component=component,
        situation=situation if whole else None,
    ).to_json()


def assertions(final: Sequence[Data]) -> Data:
    """What the assertions of a test rest on, over all episodes that it looked at.

    Args:
        final: Of :func:`final_outcomes`.
    """
    told = [(one["episode"], one["assertion"]) for one in final]
    false = Counter(check for _, one in told for check in one["false"])
    failed = sorted((name, one["failed"]) for name, one in told if one["failed"])
    return {
        "alone": all(one["alone"] for _, one in told),
        "by_check": sum(one["by_check"] for _, one in told),
        "observed": sorted({name for _, one in told for name in one["observed"]})[:LOOKED_AT],
        "false": [{"check": name, "episodes": false[name]} for name in sorted(false)[:LOOKED_AT]],
        "failed": [{"episode": name, "message": why} for name, why in failed[:FAILED]],
    }


def _run_number(episode: str) -> tuple[str, int]:
    case, _, run = episode.rpartition("#")
    return case, int(run)
