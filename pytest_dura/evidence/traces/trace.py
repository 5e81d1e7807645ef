"""Trace: an episode tick by tick, as plain columns without the code that made it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.episode import Episode
from pytest_dura.core.recording import Recording
from pytest_dura.core.state import Event
from pytest_dura.evidence.plain import plain


@dataclass(frozen=True)
class Trace:
    """All columns of an episode, bit by bit.

    Args:
        about: ``id``, ``case``, ``component``, ``seed``, ``digest``, ``validity``,
            ``termination``, ``failure``.
        time: Simulated seconds, shape ``(ticks,)``.
        signals: By name, each of shape ``(ticks,)``; ``percept.name`` is as perceived.
        decisions: ``verdict``, ``source``, ``proposed``, ``executed``, ``attempts``; each of shape
            ``(ticks - 1,)``. See :class:`~pytest_dura.core.episode.Episode`.
        events: ``{tick, time, kind, subject, detail, data}`` in their order; with ``wall_clock``
            where that is true, of what depends on the machine's speed.
        recording: What was said at each decision, and the scene.
    """

    about: Mapping[str, Any]
    time: NDArray[np.float64]
    signals: Mapping[str, NDArray[np.float64]]
    decisions: Mapping[str, NDArray[Any]]
    events: Sequence[Mapping[str, Any]]
    recording: Recording

    @classmethod
    def of(cls, episode: Episode) -> Trace:
        """Of an episode, whose columns it shares."""
        about = {
            "id": episode.id,
            "case": episode.spec.case,
            "component": episode.spec.component,
            "seed": episode.spec.seed,
            "digest": episode.digest,
            "validity": episode.validity,
            "termination": episode.termination,
            "failure": episode.failure,
        }
        return cls(
            about,
            episode.time,
            episode.signals,
            episode.decisions,
            [_event(event) for event in episode.events],
            episode.recording or Recording(),
        )


def _event(event: Event) -> dict[str, Any]:
    told: dict[str, Any] = plain(event.to_json())
    return told | ({"wall_clock": True} if event.wall_clock else {})
