"""The order in which roles run within a tick, from what each declares in ``after``."""

from __future__ import annotations

from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.roles import STANDARD_ROLES, Role

UNSCHEDULED = ("generator", "recovery_planner")
"""Roles with a place of their own in the tick: before and after the assessment."""


def schedule(roles: Mapping[str, Role]) -> list[str]:
    """Names of the assessing roles in running order; the same for the same declarations.

    A standard role that is switched off may still be named in ``after``. The Generator runs
    before all of them, so naming it is allowed and changes nothing.

    Raises:
        ConfigurationError: For a name that nobody has, and for a cycle.
    """
    names = [name for name in roles if name not in UNSCHEDULED]
    graph: dict[str, list[str]] = {}
    for name in sorted(names, key=_standard_first):
        after = roles[name].after
        if isinstance(after, str):
            after = (after,)
        for other in after:
            if other not in roles and other not in STANDARD_ROLES:
                raise ConfigurationError(
                    f"role {name!r} runs after {other!r}, which is not a role here",
                    key=f"{name}.after",
                    found=other,
                    expected="one of " + ", ".join(sorted({*roles, *STANDARD_ROLES})),
                    remedy="correct the name, or add that role",
                )
            if other == "recovery_planner":
                raise ConfigurationError(
                    f"role {name!r} runs after 'recovery_planner', which acts on the assessment",
                    key=f"{name}.after",
                    remedy="assessing roles run before recovery; drop it from `after`",
                )
        graph[name] = [other for other in after if other in names]
    try:
        return list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        raise ConfigurationError(
            "the roles wait for each other in a circle",
            key="after",
            found=" -> ".join(error.args[1]),
            remedy="remove one of these `after` declarations",
        ) from None


def _standard_first(name: str) -> tuple[int, str]:
    order = list(STANDARD_ROLES)
    return (order.index(name) if name in order else len(order), name)
