"""Cards of items that have just ended, for the formats of others."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.plugin.context import draws_reason, replay_command, rerun_command

if TYPE_CHECKING:
    from pytest_dura.core.episode import Episode
    from pytest_dura.evidence.episode_model import EpisodeEntry
    from pytest_dura.evidence.item_verdicts import ItemVerdict
    from pytest_dura.library.cases import Case
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.plugin.items.outcomes import ItemJudged, ItemResult
    from pytest_dura.reports.document import Card, Entry
    from pytest_dura.requirements.campaign_judge import CampaignJudge
    from pytest_dura.requirements.episode_verdicts import EpisodeVerdict
    from pytest_dura.requirements.model import Requirement


def card_of(context: SessionContext, event: ItemJudged, result: ItemResult) -> Card | None:
    """Make the card of a result that is not supported; ``None`` of any other.

    Args:
        context: The session's context.
        event: The item has ended.
        result: One of its results.
    """
    status: str | None = result.status
    if result.verdict is None and result.judged is not None:
        status = _judge_alone(result.requirement, result.judged).status
    own = None if status == "supported" else verdict_of(event, result)
    if own is None:
        return None
    from pytest_dura.reports.cards import JudgedItem, card_of_item

    episodes = list(_episodes_of(context, result, own))
    ids = {each.id for each in episodes}
    shown = tuple(each for each in own.counterexamples if each.episode in ids)
    known = JudgedItem(
        [replace(own, counterexamples=shown)],
        [result.requirement],
        episodes[0].described_measures if episodes else [],
        {} if result.case is None else result.case.scenario.units,
    )
    card = card_of_item(known, lambda: map(_entry_of, episodes))
    if card is None:
        return None
    redact = context.redact
    entries = (
        replace(each, text=redact(each.text), code=redact(each.code)) for each in card.entries
    )
    return replace(
        card, title=redact(card.title), headline=redact(card.headline), entries=tuple(entries)
    )


def verdict_of(event: ItemJudged, result: ItemResult) -> ItemVerdict | None:
    """Make the verdict of an item as the record has it, of what the item knows."""
    from pytest_dura.evidence.conclusions.verdicts import assertion_summary, item_verdict
    from pytest_dura.evidence.item_verdicts import Waiver
    from pytest_dura.plugin.session.evidence import waiver_of

    verdict, judged = result.verdict, result.judged
    if verdict is None and judged is not None:
        verdict = _judge_alone(result.requirement, judged).verdict()
    if verdict is None:
        return None
    waiver = waiver_of(event.report)
    return item_verdict(
        verdict,
        event.item.nodeid,
        waiver=None if waiver is None else Waiver(*waiver),
        assertion=assertion_summary([result.judgement]) if result.judgement else None,
    )


def _judge_alone(requirement: Requirement, judged: EpisodeVerdict) -> CampaignJudge:
    """Judge one run: a session has one verdict on all runs of a test, an item knows its own."""
    from pytest_dura.requirements.campaign_judge import CampaignJudge

    alone = replace(requirement, at_most=None, method=None, p0=None)
    case = judged.episode.rpartition("#")[0]
    judge = CampaignJudge(alone, case, planned=1, component=judged.component)
    judge.add(judged)
    return judge


def _episodes_of(
    context: SessionContext, result: ItemResult, verdict: ItemVerdict
) -> Iterator[Episode]:
    """Yield the run that stands for a verdict, and all of its runs if the component failed there.

    How often it failed by itself is stated of all runs.
    """
    if result.episode is not None:
        yield result.episode
        return
    uncounted = verdict.first_uncounted
    shown = [each.episode for each in verdict.counterexamples[:1]]
    shown += [] if uncounted is None else [uncounted.episode]
    if result.case is None or not verdict.run:
        return
    number = int(shown[0].rpartition("#")[2]) if shown else 0
    first = context.runner.fetch(result.case, number)
    yield first
    if any(event.kind == "component_failure" for event in first.events):
        for run in range(verdict.run):
            if run != number:
                yield context.runner.fetch(result.case, run)


def _entry_of(episode: Episode) -> EpisodeEntry:
    """Entry of an episode that is not in the record yet."""
    from pytest_dura.evidence.episode_model import EpisodeEntry
    from pytest_dura.evidence.episodes import episode_record

    return EpisodeEntry.from_data(episode_record(episode, planned=True))


def command_of(context: SessionContext) -> Callable[[Entry], str]:
    """Return what makes the command of a card's entry that is one."""

    def command(entry: Entry) -> str:
        return (replay_command if entry.kind == "replay" else rerun_command)(context, entry.text)

    return command


def draws_of(context: SessionContext, case: Case | None) -> str:
    """Say what declares that the runs of a case count as draws; empty if nothing does."""
    try:
        return draws_reason(context, case)
    except ConfigurationError:  # a part cannot be built, so that nothing ran
        return ""
