"""Hazard: what must not come about, as plain data; requirements name those that they mitigate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from pytest_dura.core.codec import Share

Severity = Literal["S0", "S1", "S2", "S3"]
SEVERITIES: tuple[str, ...] = get_args(Severity)


@dataclass(frozen=True, slots=True)
class Hazard:
    """A state of the system that leads to a loss under worst-case conditions.

    Nothing is derived of it: it says which requirements are evidence on what.

    Args:
        id: Unique name, such as ``H-1``.
        text: The state of the system, in words.
        loss: The loss that it may lead to.
        severity: Class of severity as its author declares it, by the names of ISO 26262-3;
            ``None`` where none is declared.
        operating_condition: Under which conditions of operation it leads to the loss.
        triggering_condition: Which conditions of a scene, or attacks, may bring it about.
        source: Which analysis it comes from.
        acceptance_criterion: Which residual risk its author accepts, in words.
        at_most: Greatest rate of runs that its author accepts to violate a requirement on it, in
            each case; ``None`` where none is declared.
    """

    id: str
    text: str
    loss: str
    severity: Severity | None = None
    operating_condition: str = ""
    triggering_condition: str = ""
    source: str = ""
    acceptance_criterion: str = ""
    at_most: Share | None = None
