"""Links: where an episode is shown in the report, if it is."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from pytest_dura.evidence.formats.report.anchors import episode_anchor, player_anchor
from pytest_dura.evidence.formats.report.folding import Key
from pytest_dura.evidence.formats.report.gathering import Gathered


@dataclass(frozen=True)
class Links:
    """Anchors of the episodes that are shown.

    Args:
        players: Of those with a player, by id and component.
        listed: Of those in the list, by id and component.
    """

    players: dict[Key, str]
    listed: dict[Key, str]

    @classmethod
    def of(cls, gathered: Gathered, players: Collection[Key]) -> Links:
        """Of what was gathered, and of the episodes with a player."""
        return cls(
            {key: player_anchor(*key) for key in players},
            {one.key: episode_anchor(*one.key) for one in gathered.listed},
        )

    def of_episode(self, episode: str, component: str) -> str | None:
        """The anchor of its player or else of its row; ``None`` where it has neither."""
        key = episode, component
        return self.players.get(key) or self.listed.get(key)
