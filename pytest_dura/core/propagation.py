"""Propagation of faults, by fault-free twins, and switching between component and recovery."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.episode import Episode
from pytest_dura.core.metrics import FaultRecord
from pytest_dura.core.roles import Assessed

PropagationStatus = Literal["propagated", "contained", "unknown"]
OutcomeStatus = Literal[
    "idle", "masked", "contained", "tolerated", "violated", "violated also without it", "missing"
]


@dataclass(frozen=True)
class Propagation:
    """Effect of one manifested fault on the proposals.

    Args:
        status: ``propagated`` if a proposal differs from that of the fault-free twin, ``contained``
            if none does, ``unknown`` if the twins cannot tell.
        at: Simulated seconds of the first proposal that differs.
        reason: Why it is unknown.
    """

    status: PropagationStatus
    at: float | None = None
    reason: str = ""


@dataclass(frozen=True)
class Divergence:
    """First difference between an episode and its fault-free twin.

    Args:
        at: Simulated seconds of the first differing proposal; ``None`` if there is none in the
            ticks that both have.
        doubt: Why the difference cannot be attributed to the faults; empty if it can.
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
        """Compare the proposals of an episode with those of its twin.

        A component whose proposals differ between two fault-free runs would seem to be reached by
        every fault; from the first such difference on, nothing is attributed.

        Args:
            episode: The episode with faults.
            twin: The episode of the same seed without any fault.
            second: Runs the twin once more; called if the proposals differ.
        """
        for run in (episode, twin):
            if run.failure is not None:
                return cls(doubt=f"{run.id} is missing")
        first = _first_difference(episode, twin)
        if first is None:
            for run in (episode, twin):
                if run.termination == "decided":
                    end = run.time[-1]
                    return cls(doubt=f"{run.id} ended at {end:.2f} s, once all was decided")
            return cls(until=_common_end(episode, twin))
        if second is not None:
            other = second()
            if other.failure is not None:
                return cls(doubt=f"{other.id} is missing")
            between_twins = _first_difference(twin, other)
            if between_twins is not None and between_twins <= first:
                time = twin.time[between_twins]
                return cls(doubt=f"two runs without faults differ from {time:.2f} s on")
        return cls(at=float(episode.time[first]))

    def of_fault(self, fault: FaultRecord) -> Propagation | None:
        """Propagation of one fault; ``None`` if the fault never manifested.

        A difference is attributed to all faults that had manifested by then.
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
) -> OutcomeStatus:
    """Outcome of a fault in one episode.

    ``idle`` (never active), ``masked`` (active, never manifested), ``contained`` (it changed no
    proposal), ``tolerated`` (it may have, and nothing was violated), ``violated``, ``violated also
    without it`` (all that was violated is violated without any fault, too), or ``missing`` (the
    episode cannot tell).

    Args:
        fault: Its record.
        propagation: Its propagation, if that is known.
        violated: Requirements that were violated from its manifestation on.
        violated_without: Those among them that the fault-free twin violates, too; ``None`` without
            a twin.
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


def _common_end(episode: Episode, other: Episode) -> float | None:
    """Time of the last proposal that both have; ``None`` if both have equally many."""
    left, right = len(episode.decisions["proposed"]), len(other.decisions["proposed"])
    ticks = min(left, right)
    if left == right:
        return None
    return float(episode.time[ticks - 1]) if ticks else -math.inf


def _first_difference(episode: Episode, other: Episode) -> int | None:
    """First tick at which the proposals of both differ."""
    left, right = episode.decisions["proposed"], other.decisions["proposed"]
    ticks = min(len(left), len(right))
    differing = np.flatnonzero(left[:ticks] != right[:ticks])
    return int(differing[0]) if len(differing) else None


@dataclass(frozen=True, slots=True)
class Switching:
    """Control of an episode, by the component or by recovery, tick by tick.

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
        """Plain data for the evidence record, the derived numbers included."""
        return {
            **asdict(self),
            "time_to_safe": list(self.time_to_safe),
            "share": self.share,
            "switches": self.switches,
            "censored": self.censored,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Switching:
        """Invert :meth:`to_json`."""
        own = {name: data[name] for name in cls.__dataclass_fields__}
        return cls(**{**own, "time_to_safe": tuple(data["time_to_safe"])})


def switching(episode: Episode) -> Switching:
    """Compute who was in control from an episode's decisions and times."""
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
