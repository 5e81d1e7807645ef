"""Propagation: what a fault reached and what came of it, by fault-free twins."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pytest_dura.core.episode import Episode
from pytest_dura.core.metrics import FaultRecord

PropagationWord = Literal["propagated", "contained", "unknown"]
OutcomeWord = Literal[
    "idle", "masked", "contained", "tolerated", "violated", "violated also without it", "missing"
]


@dataclass(frozen=True)
class Propagation:
    """What became of one manifested fault.

    Args:
        word: ``propagated`` if a proposal differs from that of the fault-free twin, ``contained``
            if none does, ``unknown`` if the twins cannot tell.
        at: Simulated seconds of the first proposal that differs.
        reason: Why it is unknown.
    """

    word: PropagationWord
    at: float | None = None
    reason: str = ""


@dataclass(frozen=True)
class Divergence:
    """Where an episode first leaves its fault-free twin.

    Args:
        at: Simulated seconds of the first differing proposal; ``None`` if there is none in the
            ticks that both have.
        doubt: Why this says nothing about the faults.
        until: Simulated seconds of the last proposal that both have, where one of them ended
            before the other; ``None`` where that does not matter.
    """

    at: float | None = None
    doubt: str = ""
    until: float | None = None

    @classmethod
    def of(
        cls, episode: Episode, twin: Episode, second: Callable[[], Episode] | None = None
    ) -> Divergence:
        """The first difference between the proposals of an episode and of its twin.

        A component whose proposals differ between two fault-free runs would seem to be reached by
        every fault; from the first such difference on, nothing is said.

        Args:
            episode: With faults.
            twin: Of the same seed, without any fault.
            second: Makes another run of the twin; asked for where the first one differs.
        """
        for one in (episode, twin):
            if one.failure is not None:
                return cls(doubt=f"{one.id} is missing")
        first = _first_difference(episode, twin)
        if first is None:
            for one in (episode, twin):
                if one.termination == "decided":
                    end = one.time[-1]
                    return cls(doubt=f"{one.id} ended at {end:.2f} s, once all was decided")
            return cls(until=_common_end(episode, twin))
        if second is not None:
            other = second()
            if other.failure is not None:
                return cls(doubt=f"{other.id} is missing")
            apart = _first_difference(twin, other)
            if apart is not None and apart <= first:
                time = twin.time[apart]
                return cls(doubt=f"two runs without faults differ from {time:.2f} s on")
        return cls(at=float(episode.time[first]))

    def of_fault(self, fault: FaultRecord) -> Propagation | None:
        """What it says of one fault; ``None`` if the fault never manifested.

        Several faults that had manifested by then are answerable together.
        """
        if fault.manifested_at is None:
            return None
        if self.doubt:
            return Propagation("unknown", reason=self.doubt)
        if self.at is None and self.until is not None and fault.manifested_at > self.until + 1e-9:
            reason = f"one of the runs has no proposal after {self.until:.2f} s to compare"
            return Propagation("unknown", reason=reason)
        if self.at is None:
            return Propagation("contained")
        if fault.manifested_at <= self.at + 1e-9:
            return Propagation("propagated", self.at)
        reason = f"proposals differed already from {self.at:.2f} s on, through another fault"
        return Propagation("unknown", reason=reason)


def outcome_of(
    fault: FaultRecord,
    propagation: str | None,
    violated: Collection[str],
    violated_without: Collection[str] | None,
    *,
    missing: bool,
) -> OutcomeWord:
    """What came of a fault in one episode.

    ``idle`` (never active), ``masked`` (active, never manifested), ``contained`` (it changed no
    proposal), ``tolerated`` (it may have, and nothing was violated), ``violated``, ``violated also
    without it`` (all that was violated is violated without any fault, too), or ``missing`` (the
    episode cannot tell).

    Args:
        fault: From plan to recovery.
        propagation: Whether the proposals left those of the fault-free twin, if that is known.
        violated: Requirements that were violated from its manifestation on.
        violated_without: Those among them that the fault-free twin violates, too; ``None`` without
            a twin: then no violation can be said to be there without the fault.
        missing: Whether an infrastructure error ended the episode.
    """
    if violated:
        own = set(violated).difference(violated_without or ())
        return "violated" if own else "violated also without it"
    if missing:
        return "missing"
    if fault.activated_at is None and fault.manifested_at is None:
        return "idle"
    if fault.manifested_at is None:
        return "masked"
    return "contained" if propagation == "contained" else "tolerated"


def _common_end(one: Episode, other: Episode) -> float | None:
    """The time of the last proposal that both have; ``None`` if both have equally many."""
    left, right = len(one.decisions["proposed"]), len(other.decisions["proposed"])
    ticks = min(left, right)
    if left == right:
        return None
    return float(one.time[ticks - 1]) if ticks else -math.inf


def _first_difference(one: Episode, other: Episode) -> int | None:
    """The first tick that both have at which their proposals differ."""
    left, right = one.decisions["proposed"], other.decisions["proposed"]
    ticks = min(len(left), len(right))
    differing = np.flatnonzero(left[:ticks] != right[:ticks])
    return int(differing[0]) if len(differing) else None
