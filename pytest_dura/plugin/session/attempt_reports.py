"""Attempts at an item as JUnit properties, since a JUnit file shows the last one alone.

An item that is run again has a property for each attempt, ``attempt_1`` and so on, whose value is
JSON: what pytest made of it, seconds, the beginning of its failure, and the verdicts by then.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.evidence.text import one_line
from pytest_dura.plugin.items.outcomes import ItemJudged

if TYPE_CHECKING:
    from pytest_dura.campaign.events import EventStream

_MAX_MESSAGE = 200
_ATTEMPTS = pytest.StashKey[list[dict[str, Any]]]()


def subscribe(events: EventStream) -> None:
    """Report attempts from now on, after what else items report.

    Args:
        events: On which the plugin emits :class:`ItemJudged`.
    """
    events.subscribe(ItemJudged, _add_attempts)


def _add_attempts(event: ItemJudged) -> None:
    item, report = event.item, event.report
    attempts = item.stash.setdefault(_ATTEMPTS, [])
    crash = getattr(report.longrepr, "reprcrash", None)
    attempts.append(
        {
            "outcome": report.outcome,
            "seconds": round(report.duration, 3),
            "message": one_line(str(crash.message), _MAX_MESSAGE) if crash else "",
            "verdicts": {result.requirement.id: result.status for result in event.results},
        }
    )
    if len(attempts) == 1:
        return
    ours: list[tuple[str, object]] = [
        (f"attempt_{i}", json.dumps(each)) for i, each in enumerate(attempts, 1)
    ]
    item.user_properties[:] = [entry for entry in item.user_properties if entry not in ours] + ours
    report.user_properties = list(item.user_properties)
