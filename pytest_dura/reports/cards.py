"""Cards: what went wrong, one for each cause, each search with a violation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter

from pytest_dura.core.measures import MeasureInfo
from pytest_dura.core.metrics import TracedFault
from pytest_dura.core.percepts import NOTHING
from pytest_dura.evidence.case_model import CaseEntry
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.gate import OBJECTIONABLE_OUTCOMES, outcome_status
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.evidence.text import counted, name, one_line, visible
from pytest_dura.reports.causes import (
    Cause,
    Finding,
    card_heading,
    causes_of,
    causes_of_verdicts,
)
from pytest_dura.reports.document import Card, Entry, Level, Place
from pytest_dura.reports.searches import (
    MOST_CHANGES,
    baseline_note,
    baselines_text,
    change_entries,
    counterexample_text,
    kept_text,
    ordered_outcomes,
    outcome_headline,
    shrinking_text,
    simulations_text,
)
from pytest_dura.reports.verdicts import (
    as_sentence,
    fault_free_violations_text,
    no_rate_reason,
    other_run_counts,
)
from pytest_dura.reports.wording import names_text
from pytest_dura.requirements.model import FAULTS, Requirement
from pytest_dura.requirements.searches import SearchOutcome

_MOST_REQUIREMENTS = 8
"""Requirements that a card states one by one; it names the others."""
_MOST_ALIKE = 20
"""Requirements that are undecided alike, by name."""
_MOST_RERUNS = 4


def cards_of(record: SessionRecord) -> list[Card]:
    """The cards of a session: causes and searches that do not pass, what is waived last."""
    causes = causes_of(record)
    shown = _shown_episodes(record, causes)
    cards: list[tuple[bool, int, Card]] = []
    for cause in causes:
        episode = shown.get((cause.episode or "", cause.component))
        cards.append((cause.waived, _rank(cause.status), cause_card(cause, episode)))
    units = record.head.units or {}
    for search, outcome in ordered_outcomes(record):
        status = outcome_status(search, outcome)
        if status in OBJECTIONABLE_OUTCOMES:
            card = search_card(search, outcome, units)
            cards.append((search.waiver is not None, _rank(status), card))
    return [card for _, _, card in sorted(cards, key=itemgetter(0, 1))]


_RANKS = ("violated", "worse", "falsified", "not repeatable", "incomplete", "baseline")


def _rank(status: str) -> int:
    return _RANKS.index(status) if status in _RANKS else len(_RANKS)


def _shown_episodes(
    record: SessionRecord, causes: list[Cause]
) -> Mapping[tuple[str, str], EpisodeEntry]:
    """The episodes that stand for causes, planned ones first; read in one pass."""
    named = {(cause.episode, cause.component) for cause in causes if cause.episode}
    episodes: dict[tuple[str, str], EpisodeEntry] = {}
    for episode in record.episodes() if named else ():
        key = episode.id, episode.component
        if key in named and (key not in episodes or episode.planned > episodes[key].planned):
            episodes[key] = episode
    return episodes


@dataclass(frozen=True)
class JudgedItem:
    """An item that has just ended; see :class:`~pytest_dura.reports.causes.Judged`."""

    verdicts: Sequence[ItemVerdict]
    requirements: Sequence[Requirement]
    measures: Sequence[MeasureInfo]
    units: Mapping[str, str]
    cases: Sequence[CaseEntry] = ()


def card_of_item(item: JudgedItem, episodes: Callable[[], Iterable[EpisodeEntry]]) -> Card | None:
    """Make the card of an item's verdict, of what is known when it ends; ``None`` if it passes.

    Args:
        item: With one verdict.
        episodes: Returns the episodes that the verdict rests on.
    """
    read: list[EpisodeEntry] = []

    def known() -> list[EpisodeEntry]:
        read.extend(episodes())
        return read

    for cause in causes_of_verdicts(item, known):
        return cause_card(cause, next((each for each in read if each.id == cause.episode), None))
    return None


def cause_card(cause: Cause, episode: EpisodeEntry | None = None) -> Card:
    """Make the card of a cause.

    Args:
        cause: The cause.
        episode: That stands for it, whose faults are followed; ``None`` where there is none.
    """
    title = card_heading(cause)
    return Card(
        title.partition(":")[0],
        title,
        cause.happened,
        tuple(_cause_entries(cause, episode)),
        place=Place(cause.case, cause.component, cause.episode or "", cause.time),
    )


def _cause_entries(cause: Cause, episode: EpisodeEntry | None) -> Iterator[Entry]:
    # One reason leaves many undecided: of those that no run violates the first speaks for all.
    alike = [
        each
        for each in cause.findings
        if each.verdict.verdict == "undecided" and not each.is_violated
    ][1:]
    single = [each for each in cause.findings if each not in alike]
    for finding in single[:_MOST_REQUIREMENTS]:
        yield _finding_entry(finding)
    if rest := single[_MOST_REQUIREMENTS:]:
        yield Entry("and", names_text([each.requirement.id for each in rest]))
    if alike:
        names = names_text([each.requirement.id for each in alike], _MOST_ALIKE)
        yield Entry("and", f"{names}: undecided for the same reason")
    if cause.episode is not None:
        # Those of other cases have the same numbers.
        case, _, _ = cause.episode.rpartition("#")
        own = [each.rpartition("#") for each in cause.more]
        runs = [f"{'' if other == case else other}#{run}" for other, _, run in own]
        more = f"; also {names_text(runs)}" if runs else ""
        without = "" if cause.valid else ", without effect of the fault"
        yield Entry("episode", f"{name(cause.episode)}{without}{more}", "code")
    for fault in episode.faults if episode is not None else ():
        yield Entry("fault", one_line(chain_line(fault), 1000), weight=Level.SUMMARY)
    events = episode.events if episode is not None else ()
    raised = next((event.traceback for event in events if event.traceback), "")
    if raised:
        yield Entry("traceback", visible(raised), "code", weight=Level.PAGE)
    for twin in cause.twins:
        yield Entry("twin", twin.sentence)
    if cause.episode is not None:
        yield Entry("replay", cause.episode, "replay")
    for item in _items(cause):
        yield Entry("rerun", item, "rerun", weight=Level.SUMMARY)
    if cause.waived:
        reasons = dict.fromkeys(each.waiver.reason for each in cause.verdicts if each.waiver)
        yield Entry("waived", names_text([reason or "no reason" for reason in reasons]))
    yield Entry("next", cause.next_step)


def _items(cause: Cause) -> list[str]:
    """The items that ask for its verdicts; the case alone where all of them are the case's own."""
    items = list(
        dict.fromkeys(item for verdict in cause.verdicts for item in verdict.item.split(", "))
    )
    if len(items) > 1 and all(item.startswith(f"{cause.case}::") for item in items):
        return [cause.case]
    return items[:_MOST_RERUNS]


def _finding_entry(finding: Finding) -> Entry:
    """What is required, how often it is missed, and by how much in the worst run."""
    verdict, requirement = finding.verdict, finding.requirement
    runs = counted(verdict.episodes, "run" if verdict.pairs is None else "pair")
    if verdict.pairs is not None:
        without, reference = verdict.pairs.without, verdict.pairs.reference
        if reference and not without:
            runs += f" with {name(reference)} in its place"
        else:
            runs += f" with and without {'the faults' if without == FAULTS else name(without)}"
    violate = "violates" if verdict.violations == 1 else "violate"
    also = fault_free_violations_text(verdict)
    parts = [f"{verdict.violations} of {runs} {violate} it{also}"]
    if verdict.verdict == "undecided":
        parts.insert(0, "undecided")
    parts += other_run_counts(verdict)
    text = ", ".join(parts) + no_rate_reason(verdict)
    if finding.amount:
        worst = "at worst " if verdict.violations > 1 and finding.amount[0] != "`" else ""
        text += f": {worst}{finding.amount}"
    assertion = verdict.assertion
    failed = assertion.failed[:1] if assertion is not None else ()
    text += "".join(one_line(f"; failed: {each.message}, in {each.episode}") for each in failed)
    sentences = [f"{text}.", as_sentence(requirement.text)]
    # Where the check held, what failed is an assertion of the test.
    judged = not failed or (assertion is not None and assertion.by_check)
    check = one_line(finding.check) if judged and finding.check != requirement.id else ""
    return Entry(name(requirement.id), " ".join(filter(None, sentences)), code=check)


def search_card(
    search: RecordedSearch, outcome: SearchOutcome, units: Mapping[str, str] = NOTHING
) -> Card:
    """Make the card of a search with a violation, or without an answer.

    Args:
        search: Of the record.
        outcome: One of its outcomes.
        units: Of signals, by name.
    """
    status = outcome_status(search, outcome)
    waiver = f" [{search.waiver.kind}]" if search.waiver else ""
    title = (
        f"{outcome.status}: {name(outcome.requirement)} on {name(search.case)} "
        f"({name(search.component)}){waiver}"
    )
    return Card(
        status,
        title,
        _search_headline(search, outcome, units),
        tuple(_search_entries(search, outcome)),
        place=Place(search.case, search.component),
    )


def _search_headline(
    search: RecordedSearch, outcome: SearchOutcome, units: Mapping[str, str]
) -> str:
    example = outcome.counterexample
    rests_on = outcome_headline(search, outcome).removeprefix(f"{outcome.status}: ")
    if example is None:
        return f"{baseline_note(search, outcome) or rests_on}."
    happened = counterexample_text(example, outcome.check, units)
    return f"{one_line(': '.join(filter(None, [rests_on, happened])), 800)}."


def _search_entries(search: RecordedSearch, outcome: SearchOutcome) -> Iterator[Entry]:
    example = outcome.counterexample
    if outcome.check not in ("", outcome.requirement):
        yield Entry("check", one_line(outcome.check), "code")
    if note := baseline_note(search, outcome) if example is not None else "":
        yield Entry("note", note)
    if example is not None:
        if example.shrinking is not None:
            yield Entry("simpler", shrinking_text(example))
        for label, text in change_entries(example, MOST_CHANGES, ", in evidence.json"):
            yield Entry("inputs" if label else "", text)
    yield Entry("searched", f"{simulations_text(search)}; seed {search.seed}")
    if search.baselines:
        yield Entry("trivial", one_line(baselines_text(search, outcome.requirement), 500))
    kept = kept_text(outcome)
    if kept:
        yield Entry("kept", f"{kept}, which --dura-scenarios runs from now on")
    again = example.name if kept and example is not None and example.name else search.item
    yield Entry("rerun", again, "rerun")
    if search.waiver is not None:
        yield Entry("waived", one_line(search.waiver.reason or "no reason"))
    yield Entry("next", _search_step(search, outcome))


def _search_step(search: RecordedSearch, outcome: SearchOutcome) -> str:
    component = name(search.component)
    if outcome.status == "falsified":
        return f"Run it again, and see what {component} does there; what is kept stays a test."
    if outcome.status == "not repeatable":
        return "Look for what is not drawn from the episode's seed, before the violation itself."
    if outcome.status == "undecided":
        return "Repair what failed in the simulations without an answer, and search again."
    return "Search again with a larger budget: a trivial searcher came across a violation."


def chain_line(fault: TracedFault) -> str:
    """Write the causal chain of one fault, with times in s."""
    readers = f" (read by {', '.join(fault.read_by)})" if fault.read_by else ""
    steps = [
        ("planned", fault.planned_at, ""),
        ("activated", fault.activated_at, ""),
        ("manifested", fault.manifested_at, readers),
        ("propagated", fault.propagated_at, ""),
        ("detected", fault.detected_at, _by(fault.detected_by, fault.pattern)),
        ("recovery", fault.recovery_at, _by(fault.recovery)),
        ("recovered", fault.recovered_at, ""),
    ]
    parts = [f"{step} {time:.2f} s{by}" for step, time, by in steps if time is not None]
    if fault.outcome is not None:
        parts.append(fault.outcome)
    return f"{fault.id}: {', '.join(parts) or 'never active'}"


def _by(*names: str | None) -> str:
    known = ": ".join(filter(None, names))
    return f" ({known})" if known else ""
