"""The episodes of this process, so that each one is simulated once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pytest_dura.campaign.components import local_object
from pytest_dura.core.episode import EpisodeSpec
from pytest_dura.requirements.verdicts import JudgedEpisode

Simulate = Callable[[EpisodeSpec], JudgedEpisode]


class EpisodeStore:
    """Episodes by what determines them.

    A bare instance, or a class that only this process can reach, is told apart from others of the
    same name by its identity; the store keeps a reference to it, so that no other object can
    take over its identity.
    """

    def __init__(self) -> None:
        self._episodes: dict[tuple[str, tuple[int, ...]], JudgedEpisode] = {}
        self._kept: list[Any] = []

    def __len__(self) -> int:
        return len(self._episodes)

    def get(self, spec: EpisodeSpec, simulate: Simulate) -> JudgedEpisode:
        """The episode of a spec, simulated at the first call."""
        parts = [spec.simulator, *(role for _, role in sorted(spec.roles.items()))]
        local = [one for one in map(local_object, parts) if one is not None]
        key = spec.key, tuple(map(id, local))
        if key not in self._episodes:
            self._episodes[key] = simulate(spec)
            self._kept += local
        return self._episodes[key]
