"""Items in JUnit files: properties, which pytest writes with every ``junit_family``.

There is one group per requirement, in order, which begins with ``requirement``; ``xunit1`` adds
file and line of the test. A JUnit file shows the last attempt at an item alone: one that is run
again has a property for each attempt, ``attempt_1`` and so on, whose value is JSON: what pytest
made of it, seconds, the beginning of its failure, and the verdicts by then.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.evidence.junit import junit_name
from pytest_dura.evidence.text import one_line, visible
from pytest_dura.plugin.context import replay_command
from pytest_dura.plugin.items.outcomes import ItemJudged, ItemResult, episode_of, target_of
from pytest_dura.plugin.session.item_cards import card_of, command_of, draws_of
from pytest_dura.reports.pens.items import card_properties

if TYPE_CHECKING:
    from pytest_dura.campaign.events import EventStream
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.requirements.episode_verdicts import EpisodeVerdict
    from pytest_dura.requirements.judgements import Judgement

Properties = list[tuple[str, str]]

_COUNTS = ("planned", "run", "violations", "without_effect", "invalid", "missing", "vacuous")
_NAMES = {"requirement", "case", "component", "item", "episode", "counterexample"}
_PROPERTIES_KEY = pytest.StashKey[Properties]()
_ATTEMPTS = pytest.StashKey[list[dict[str, Any]]]()
_MAX_MESSAGE = 200


def subscribe(context: SessionContext, events: EventStream) -> None:
    """Report what items come to, and the attempts at them.

    Args:
        context: The session's context.
        events: On which the plugin emits :class:`ItemJudged`.
    """
    events.subscribe(ItemJudged, partial(_add_properties, context))
    events.subscribe(ItemJudged, _add_attempts)


def _add_properties(context: SessionContext, event: ItemJudged) -> None:
    """Put an item's results among its properties, which cross processes with its reports."""
    item = event.item
    earlier = item.stash.get(_PROPERTIES_KEY, [])  # of an earlier attempt
    others = [entry for entry in item.user_properties if entry not in earlier]
    ours = _properties(context, event)
    item.stash[_PROPERTIES_KEY] = ours
    item.user_properties[:] = [*others, *ours]
    event.report.user_properties = list(item.user_properties)


def _properties(context: SessionContext, event: ItemJudged) -> Properties:
    properties: list[tuple[str, Any]] = [
        ("item", event.item.nodeid),
        ("base_seed", context.options.seed),
        *_episode_properties(context, event.item),
    ]
    for result in event.results:
        properties += _result_properties(context, result)
        properties.append(("draws", draws_of(context, result.case)))
        if (card := card_of(context, event, result)) is not None:
            properties += card_properties(card, command_of(context))
    return [(name, _value(name, value)) for name, value in properties if value not in (None, "")]


def _value(name: str, value: Any) -> str:
    """Escape a value: plain text that XML and other processes can take."""
    text = str(value)
    if name == "card_traceback":
        return visible(text)
    return junit_name(text) if name in _NAMES else one_line(text)


def _episode_properties(context: SessionContext, item: pytest.Item) -> Iterator[tuple[str, Any]]:
    episode = episode_of(item)
    if episode is None:
        return
    yield "episode", episode.id
    yield "seed", episode.spec.seed
    yield "digest", episode.digest
    yield "validity", episode.validity
    if target_of(item) is not None:  # by its id alone another session finds no other episode
        yield "replay", replay_command(context, episode.id)


def _result_properties(context: SessionContext, result: ItemResult) -> Iterator[tuple[str, Any]]:
    requirement = result.requirement
    yield "requirement", requirement.id
    yield "kind", requirement.kind
    yield "case", result.case.id if result.case else result.verdict and result.verdict.case
    yield "component", result.component
    if result.judged is not None and result.judgement is not None:
        yield from _outcome_properties(result.judged, result.judgement)
    if result.verdict is not None:
        yield from _verdict_properties(context, result)


def _outcome_properties(judged: EpisodeVerdict, judgement: Judgement) -> Iterator[tuple[str, Any]]:
    assertion = judgement.assertion
    assert assertion is not None
    yield "episode_verdict", judged.verdict
    yield "planned", judgement.planned
    yield "at_most", judgement.at_most
    yield "margin", judged.margin
    yield "violated_at", judged.time
    yield "detail", judged.detail
    yield "decided_by", "assertion" if assertion.alone else "check and assertion"
    yield "observed", ", ".join(assertion.observed)
    for check in assertion.false:
        yield "false_check", check


def _verdict_properties(context: SessionContext, result: ItemResult) -> Iterator[tuple[str, Any]]:
    verdict = result.verdict
    assert verdict is not None
    yield "verdict", verdict.verdict
    yield "reason", verdict.reason
    yield "valid", verdict.episodes
    for key in _COUNTS:
        yield key, getattr(verdict, key)
    yield "open", len(verdict.open)
    bound = verdict.bound
    yield "bound_upper", bound.upper
    yield "bound_confidence", bound.confidence
    yield "bound_method", bound.method
    yield "at_most", bound.at_most
    yield "margin", verdict.margin
    if verdict.counterexamples:
        episode = verdict.counterexamples[0].episode
        yield "counterexample", episode
        run = int(episode.rpartition("#")[2])
        seed = None if result.case is None else result.case.seed(run, context.options.seed)
        yield "counterexample_seed", seed
        yield "replay", replay_command(context, episode)


def _add_attempts(event: ItemJudged) -> None:
    item, report = event.item, event.report
    attempts = item.stash.setdefault(_ATTEMPTS, [])
    crash = getattr(report.longrepr, "reprcrash", None)
    attempts.append(
        {
            "outcome": report.outcome,
            "seconds": round(report.duration, 3),
            "message": one_line(str(crash.message), _MAX_MESSAGE) if crash else "",
            "verdicts": {result.requirement.id: result.status for result in event.results},
        }
    )
    if len(attempts) == 1:
        return
    ours: list[tuple[str, object]] = [
        (f"attempt_{i}", json.dumps(each)) for i, each in enumerate(attempts, 1)
    ]
    item.user_properties[:] = [entry for entry in item.user_properties if entry not in ours] + ours
    report.user_properties = list(item.user_properties)
