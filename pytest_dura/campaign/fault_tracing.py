"""Causal chains: each fault of an episode from its plan to what came of it."""

from __future__ import annotations

from collections.abc import Sequence

from pytest_dura.core.episode import Divergence, Episode, outcome_of
from pytest_dura.core.metrics import TracedFault
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.runs import declared_verdicts

TWINS_SUBJECT = "fault-free twins"
"""Subject of these runs in reports of progress."""


def causal_chains(
    episode: Episode,
    requirements: Sequence[Requirement],
    twin: Episode | None = None,
    divergence: Divergence | None = None,
) -> list[TracedFault]:
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
    chains = []
    for fault in episode.faults:
        propagation = divergence.of_fault(fault) if divergence is not None else None
        status = propagation.status if propagation is not None else None
        since = fault.manifested_at
        reached = tuple(
            name
            for name, time in violated.items()
            if since is not None and (time is None or time >= since - 1e-9)
        )
        also = None if without is None else tuple(name for name in reached if name in without)
        chains.append(
            fault.traced(
                propagation=status,
                propagated_at=propagation.at if propagation is not None else None,
                unknown=propagation.reason if propagation is not None else "",
                outcome=outcome_of(
                    fault, status, reached, also, missing=episode.failure is not None
                ),
                violated=reached,
                violated_without=also,
            )
        )
    return chains


def _violations(episode: Episode, requirements: Sequence[Requirement]) -> dict[str, float | None]:
    """Time of violation by requirement, of those that an episode violates by itself."""
    alone = {requirement.id for requirement in requirements if requirement.paired is None}
    return {
        name: verdict.time
        for name, verdict in declared_verdicts(episode, requirements).items()
        if name in alone and verdict.status == "violated"
    }
