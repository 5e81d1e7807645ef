"""Trace: an episode tick by tick, as plain columns without the code that made it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.accounts import NULL, SECONDS
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
        recording: What was said at each decision, and the scene. Accounts are without what does
            not belong to the trace: the null component's, and wall-clock times.
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
        recording = episode.recording or Recording()
        accounts = tuple(map(_account, recording.accounts))
        return cls(
            about,
            episode.time,
            episode.signals,
            episode.decisions,
            [_event(event) for event in episode.events],
            replace(recording, accounts=accounts),
        )

    def without_secrets(self, redact: Callable[[Any], Any]) -> Trace:
        """The same trace with what takes secrets out of plain data applied to all of its texts."""
        decisions = dict(self.decisions)
        for name, column in decisions.items():
            if column.dtype.kind == "U":
                found, places = np.unique(column, return_inverse=True)
                texts = found.tolist()
                told = redact(texts)
                if told is not texts:
                    decisions[name] = np.array(told, dtype=np.str_)[places]
        said = self.recording
        return replace(
            self,
            about=redact(self.about),
            decisions=decisions,
            events=redact(self.events),
            recording=replace(
                said,
                explanations=_redacted(said.explanations, redact),
                reasons=_redacted(said.reasons, redact),
                recoveries=_redacted(said.recoveries, redact),
                accounts=_redacted_accounts(said.accounts, redact),
                problem=None if said.problem is None else redact(said.problem),
            ),
        )


def _redacted(texts: tuple[str, ...], redact: Callable[[Any], Any]) -> tuple[str, ...]:
    """Texts that are the same for many ticks are looked at once."""
    distinct = list(dict.fromkeys(texts))
    told = redact(distinct)
    if told is distinct:
        return texts
    found = dict(zip(distinct, told, strict=True))
    return tuple(found[text] for text in texts)


def _account(account: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in account.items() if key not in (NULL, SECONDS)}


def _redacted_accounts(
    accounts: tuple[Mapping[str, Any], ...], redact: Callable[[Any], Any]
) -> tuple[Mapping[str, Any], ...]:
    """Those that nothing is taken out of stay what they are."""
    return tuple(redact(account) for account in accounts)


def _event(event: Event) -> dict[str, Any]:
    told: dict[str, Any] = plain(event.to_json())
    return told | ({"wall_clock": True} if event.wall_clock else {})
