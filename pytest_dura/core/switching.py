"""Switching: how control went back and forth between the component and its recovery."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.episode import Episode
from pytest_dura.core.roles import Assessed


@dataclass(frozen=True, slots=True)
class Switching:
    """Who was in control of an episode, tick by tick.

    Recovery is in control at a tick whose decision came from it; at every other decided tick the
    component is, the simulator's fallback for a missing proposal included. A decision holds from
    its tick until the next one; the last tick of an episode has none.

    Args:
        decisions: Ticks at which something was decided.
        recovered: Those at which recovery was in control.
        recovery_time: Simulated seconds for which it was.
        takeovers: Decisions of recovery that do not follow another one of recovery. Recovery that
            decides at the first tick has taken over there.
        returns: Decisions of the component that follow one of recovery.
        time_to_safe: For each takeover, in order, the seconds until the first later decided tick
            whose final proposal was not unsafe, whoever was in control there. ``None`` where the
            episode ended before such a tick: that time is censored, not zero.
    """

    decisions: int
    recovered: int
    recovery_time: float
    takeovers: int
    returns: int
    time_to_safe: tuple[float | None, ...]

    @property
    def share(self) -> float | None:
        """Share of the decisions that recovery made; ``None`` where nothing was decided."""
        return self.recovered / self.decisions if self.decisions else None

    @property
    def switches(self) -> int:
        """Changes of control in both directions."""
        return self.takeovers + self.returns

    @property
    def censored(self) -> int:
        """Takeovers after which the episode ended before a proposal was acceptable again."""
        return self.time_to_safe.count(None)

    def to_json(self) -> dict[str, Any]:
        """Plain data for the evidence record, with what follows from it."""
        return {
            **asdict(self),
            "time_to_safe": list(self.time_to_safe),
            "share": self.share,
            "switches": self.switches,
            "censored": self.censored,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Switching:
        """The inverse of :meth:`to_json`."""
        own = {name: data[name] for name in cls.__dataclass_fields__}
        return cls(**{**own, "time_to_safe": tuple(data["time_to_safe"])})


def switching(episode: Episode) -> Switching:
    """Who was in control of an episode, from its decisions and its time alone."""
    recovering = episode.decisions["source"] == "recovery"
    acceptable = episode.decisions["verdict"] < int(Assessed.UNSAFE)
    before = np.concatenate([[False], recovering[:-1]])
    takeovers = np.flatnonzero(recovering & ~before)
    return Switching(
        decisions=len(recovering),
        recovered=int(recovering.sum()),
        recovery_time=float(np.diff(episode.time)[recovering].sum()),
        takeovers=len(takeovers),
        returns=int((before & ~recovering).sum()),
        time_to_safe=tuple(_time_to_safe(episode, acceptable, int(i)) for i in takeovers),
    )


def _time_to_safe(episode: Episode, acceptable: NDArray[np.bool_], takeover: int) -> float | None:
    later = np.flatnonzero(acceptable[takeover + 1 :])
    if not len(later):
        return None
    return float(episode.time[takeover + 1 + later[0]] - episode.time[takeover])
