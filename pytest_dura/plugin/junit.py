"""Properties of a test for JUnit files, and whoever else reads pytest's ``user_properties``.

pytest writes them with every ``junit_family``; ``xunit1`` adds file and line of the test. There is
one group per requirement, in order, which begins with ``requirement``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.evidence.junit import junit_name
from pytest_dura.evidence.text import one_line
from pytest_dura.plugin.context import replay_command
from pytest_dura.plugin.outcomes import ItemResult, episode_of, target_of
from pytest_dura.reports.wording import event_text

if TYPE_CHECKING:
    from pytest_dura.core.episode import Episode
    from pytest_dura.plugin.context import SessionContext


Properties = list[tuple[str, str]]

_COUNTS = ("planned", "run", "violations", "without_effect", "invalid", "missing", "vacuous")
_NAMES = {"requirement", "case", "component", "item", "episode", "counterexample"}
_PROPERTIES_KEY = pytest.StashKey[Properties]()


def add_properties(
    context: SessionContext,
    item: pytest.Item,
    report: pytest.TestReport,
    results: Sequence[ItemResult],
) -> None:
    """Put what an item came to among its properties; they cross processes with its reports."""
    earlier = item.stash.get(_PROPERTIES_KEY, [])  # of an earlier attempt
    others = [entry for entry in item.user_properties if entry not in earlier]
    ours = _properties(context, item, results)
    item.stash[_PROPERTIES_KEY] = ours
    item.user_properties[:] = [*others, *ours]
    report.user_properties = list(item.user_properties)


def _properties(
    context: SessionContext, item: pytest.Item, results: Sequence[ItemResult]
) -> Properties:
    properties: list[tuple[str, Any]] = [
        ("item", item.nodeid),
        ("base_seed", context.options.seed),
        *_episode_properties(context, item),
    ]
    for result in results:
        properties += _result_properties(context, result)
    return [(name, _value(name, value)) for name, value in properties if value not in (None, "")]


def _value(name: str, value: Any) -> str:
    """Plain text without anything that XML or another process could not take."""
    text = str(value)
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
    yield "case", result.case.id if result.case else (result.verdict or {}).get("case")
    yield "component", result.component
    if result.outcome is not None:
        yield from _outcome_properties(result.outcome)
        for event in ending_events(context, result):
            yield "event", event
    if result.verdict is not None:
        yield from _verdict_properties(context, result)


def _outcome_properties(outcome: Any) -> Iterator[tuple[str, Any]]:
    yield "episode_verdict", outcome["verdict"]
    yield "planned", outcome["planned"]
    yield "at_most", outcome["at_most"]
    yield "margin", outcome["margin"]
    yield "violated_at", outcome["time"]
    yield "detail", outcome["detail"]
    asserted = outcome["assertion"]
    yield "decided_by", "assertion" if asserted["alone"] else "check and assertion"
    yield "observed", ", ".join(asserted["observed"])
    for check in asserted["false"]:
        yield "false_check", check


def _verdict_properties(context: SessionContext, result: ItemResult) -> Iterator[tuple[str, Any]]:
    verdict = result.verdict
    assert verdict is not None
    yield "verdict", verdict["verdict"]
    yield "reason", verdict["reason"]
    yield "valid", verdict["episodes"]
    for name in _COUNTS:
        yield name, verdict[name]
    yield "open", len(verdict["open"])
    bound = verdict["bound"]
    yield "bound_upper", bound["upper"]
    yield "bound_confidence", bound["confidence"]
    yield "bound_method", bound["method"]
    yield "at_most", bound["at_most"]
    yield "margin", verdict["margin"]
    if verdict["counterexamples"]:
        episode = verdict["counterexamples"][0]["episode"]
        yield "counterexample", episode
        yield "counterexample_seed", seed_of(context, result, episode)
        for event in ending_events(context, result):
            yield "event", event
        yield "replay", replay_command(context, episode)


def ending_events(context: SessionContext, result: ItemResult) -> list[str]:
    """What ended the violating episode that stands for a result, in the terminal's words."""
    if result.status != "violated":
        return []
    episode: Episode | None = result.episode
    counterexamples = (result.verdict or {}).get("counterexamples")
    if episode is None and counterexamples and result.case is not None:
        run = int(counterexamples[0]["episode"].rpartition("#")[2])
        episode = context.runner.again(result.case, run)
    if episode is None:
        return []
    return [
        context.redact(event_text(event.to_json()))
        for event in episode.events
        if event.kind == "critical"
    ]


def seed_of(context: SessionContext, result: ItemResult, episode: str) -> int | None:
    """The seed of an episode of the result's case."""
    if result.case is None:
        return None
    return result.case.seed(int(episode.rpartition("#")[2]), context.options.seed)
