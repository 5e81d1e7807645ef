"""A case as the evidence holds it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pytest_dura.campaign.cases import Case


def case_record(
    case: Case, component: str, planned: int, runs_override: int | None, off: list[str]
) -> dict[str, Any]:
    """A case as the evidence holds it.

    Args:
        case: The case.
        component: Name of the component under test.
        planned: Its episodes.
        runs_override: What replaced the number that its scenario plans, if something did.
        off: Roles that are switched off.
    """
    return {
        "order": case.scenario.order,
        "id": case.id,
        "scenario": case.scenario.name,
        "faults": [dict(fault) for fault in case.faults],
        "component": component,
        "without": list(case.without),
        "off": off,
        "requirements": list(case.requirements),
        "variation": {
            path: _without_none(spread.model_dump(mode="json"))
            for path, spread in case.scenario.variation.items()
        },
        "planned": planned,
        "runs_override": runs_override,
    }


def _without_none(spread: dict[str, Any]) -> dict[str, Any]:
    """A range of single numbers says nothing of pieces."""
    return {key: value for key, value in spread.items() if value is not None}
