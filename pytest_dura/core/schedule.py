"""Which roles fit into the loop, and the order in which they run within a tick."""

from __future__ import annotations

from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.roles import (
    STANDARD_ROLES,
    FaultInjector,
    Generator,
    RecoveryPlanner,
    Role,
)

UNSCHEDULED = ("generator", "recovery_planner")
"""Roles with a place of their own in the tick: before and after the assessment."""

_ONE_OF_A_KIND = (Generator, FaultInjector, RecoveryPlanner)


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


def check_kind(name: str, role: object) -> None:
    """Accept a role whose kind fits its name.

    Raises:
        ConfigurationError: If a standard name stands for something else, if a role of which there
            is one place in the loop has another name, or if it is no role at all.
    """
    kind = STANDARD_ROLES.get(name, Role)
    misplaced = next((b for b in _ONE_OF_A_KIND if isinstance(role, b) and name != b.name), None)
    if isinstance(role, kind) and misplaced is None:
        return
    if misplaced is not None:
        raise ConfigurationError(
            f"a {misplaced.__name__} cannot be the role {name!r}: the loop has one place for it",
            key=name,
            found=type(role).__name__,
            expected=f"the name {misplaced.name!r}",
            remedy=f"put it under {misplaced.name!r}, or derive it from another base",
        )
    raise ConfigurationError(
        f"the role {name!r} must be a {kind.__name__}",
        key=name,
        found="nothing" if role is None else type(role).__name__,
        expected=f"a subclass of pytest_dura.{kind.__name__}",
        remedy=f"derive it from pytest_dura.{kind.__name__}",
    )
