"""Models of what the record says of roles, and of earlier verdicts on rates."""

from __future__ import annotations

from typing import Literal

from pytest_dura.core.codec import Count
from pytest_dura.evidence.entry import Entry


class EffectivenessEntry(Entry):
    """What the runs show of one role."""

    role: str
    """`recovery_planner`, or the name of a monitor."""
    component: str
    """Name of the component under test."""
    requirement: str | None
    """The requirement on pairs that it was held against; null for a monitor, which is held against
    all that it was measured on."""
    finding: Literal[
        "prevented",
        "introduced",
        "prevented none",
        "never acted",
        "changed nothing",
        "warned",
        "warned of none",
        "silent",
        "cannot be told",
    ]
    """What they show: recovery `prevented` violations, `introduced` some and prevented none,
    `prevented none` although it acted, `never acted` where it was needed, or `changed nothing`
    although it acted; a monitor `warned`, `warned of none` although it flagged, or was `silent`; or
    it `cannot be told`, since nothing was violated."""
    detail: str
    """The same in words, with its figures."""


class LookEntry(Entry):
    """An earlier verdict on a rate."""

    created: str
    """When its session began, in ISO 8601."""
    base_seed: Count
    """Base seed of its session."""
    requirement: str
    """Id of the requirement."""
    case: str
    """Id of the case."""
    component: str
    """Name of the component under test."""
    check: str
    """What was judged."""
    identity: str
    """SHA-256 of the component's digest and parameters."""
    planned: Count
    """Episodes that were planned."""
    episodes: Count
    """Valid episodes."""
    violations: Count
    """Valid episodes that violated it."""
