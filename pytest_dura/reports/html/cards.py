"""Cards as the page shows them: with a picture, a player, and links to verdicts and cases."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import name
from pytest_dura.reports.contents import (
    EpisodeLinks,
    ReportContents,
    case_anchor,
    requirement_anchor,
    verdict_anchor,
)
from pytest_dura.reports.document import Card, Document
from pytest_dura.reports.html.players import Traces
from pytest_dura.reports.scene import frame_svg
from pytest_dura.reports.svg import Svg

OPEN_CARDS = 6
MAX_CARDS = 200
"""Cards of the page; the tables have all verdicts."""


@dataclass(frozen=True)
class ShownCard:
    """A card as the page shows it.

    Args:
        card: The card.
        picture: The scene at its moment; empty without a trace that can be read, or a scene.
        player: Anchor of its episode's player.
        case: Anchor of its case.
        anchors: Anchors of the verdicts, by the labels of entries that are on one.
    """

    card: Card
    picture: Svg
    player: str | None
    case: str | None
    anchors: Mapping[str, str]


def shown_cards(
    record: SessionRecord,
    document: Document,
    contents: ReportContents,
    links: EpisodeLinks,
    traces: Traces,
) -> Iterator[ShownCard]:
    """Yield the cards of a document, the first ones with a picture."""
    requirements = {name(each.id): each.id for each in record.head.requirements}
    for number, card in enumerate(document.cards[:MAX_CARDS]):
        case = card.place.case
        anchors = {
            label: links.known(verdict_anchor(requirements[label], case))
            or requirement_anchor(requirements[label])
            for label in dict.fromkeys(entry.label for entry in card.entries)
            if label in requirements
        }
        yield ShownCard(
            card,
            _picture(card, contents, traces) if number < OPEN_CARDS else Svg(""),
            links.players.get((card.place.episode, card.place.component)),
            links.known(case_anchor(case)),
            anchors,
        )


def _picture(card: Card, contents: ReportContents, traces: Traces) -> Svg:
    place = card.place
    key = place.episode, place.component
    listed = next((each for each in contents.candidates if each.key == key), None)
    if listed is None or listed.episode.trace is None or place.time is None:
        return Svg("")
    try:
        trace = traces.read(listed.episode.trace)
    except Exception:  # what is wrong with it stands in its player's place
        return Svg("")
    twin = next((each.trace for each in traces.twins_of(listed.episode) if each.trace), None)
    label = f"At {place.time:.2f} s: {card.headline}"
    return frame_svg(trace, place.time, twin=twin, label=label)
