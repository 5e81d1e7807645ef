"""Causal chains: each fault of an episode from its plan to what came of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pytest_dura.core.episode import (
    Divergence,
    Episode,
    OutcomeStatus,
    PropagationStatus,
    outcome_of,
)
from pytest_dura.core.metrics import FaultRecord
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.runs import declared_verdicts

TWINS_SUBJECT = "fault-free twins"
"""Subject of these runs in reports of progress."""


@dataclass(frozen=True)
class CausalChain:
    """One fault of one episode, from plan to outcome; times in s, ``None`` for what never was.

    Args:
        record: From plan to recovery, as the loop saw it.
        propagation: Whether the proposals left those of the fault-free twin; ``None`` if the fault
            never manifested or that was not measured.
        propagated_at: When they did.
        unknown: Why that cannot be said.
        outcome: See :func:`outcome_of`.
        violated: Requirements that were violated from its manifestation on.
        violated_without: Those among them that the fault-free twin violates, too; ``None`` if
            there is no twin to tell.
    """

    record: FaultRecord
    propagation: PropagationStatus | None
    propagated_at: float | None
    unknown: str
    outcome: OutcomeStatus
    violated: tuple[str, ...] = ()
    violated_without: tuple[str, ...] | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain data for the evidence record."""
        own = {key: value for key, value in vars(self).items() if key != "record"}
        return {
            **asdict(self.record),
            **{
                key: list(value) if isinstance(value, tuple) else value
                for key, value in own.items()
            },
        }


def causal_chains(
    episode: Episode,
    requirements: Sequence[Requirement],
    twin: Episode | None = None,
    divergence: Divergence | None = None,
) -> list[CausalChain]:
    """The chains of all faults of an episode.

    Args:
        episode: The episode.
        requirements: Those that apply to its case.
        twin: The run of the same seed without any fault, if there is one.
        divergence: Where the episode leaves it.
    """
    violated = _violations(episode, requirements)
    without = None
    if twin is not None and twin.failure is None:
        without = _violations(twin, requirements)
    return [_chain(fault, episode, violated, without, divergence) for fault in episode.faults]


def _chain(
    fault: FaultRecord,
    episode: Episode,
    violated: Mapping[str, float | None],
    without: Mapping[str, float | None] | None,
    divergence: Divergence | None,
) -> CausalChain:
    propagation = divergence.of_fault(fault) if divergence is not None else None
    since = fault.manifested_at
    reached = tuple(
        name
        for name, time in violated.items()
        if since is not None and (time is None or time >= since - 1e-9)
    )
    also = None if without is None else tuple(name for name in reached if name in without)
    status = propagation.status if propagation is not None else None
    return CausalChain(
        fault,
        status,
        propagation.at if propagation is not None else None,
        propagation.reason if propagation is not None else "",
        outcome_of(fault, status, reached, also, missing=episode.failure is not None),
        reached,
        also,
    )


def _violations(episode: Episode, requirements: Sequence[Requirement]) -> dict[str, float | None]:
    """Time of violation by requirement, of those that an episode violates by itself."""
    alone = {requirement.id for requirement in requirements if requirement.paired is None}
    return {
        name: verdict.time
        for name, verdict in declared_verdicts(episode, requirements).items()
        if name in alone and verdict.status == "violated"
    }
