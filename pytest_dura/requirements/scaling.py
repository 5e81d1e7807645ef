"""Scaling: a check whose margins are in declared units of importance, for searches.

A gap that is missed by 0.5 m and a jerk that is missed by 5 m/s3 may weigh the same. A scaled
formula divides both sides of each comparison by the unit of its signal. It guides a search and
decides nothing: verdicts, and margins in reports, are those of the check as it stands.
"""

from __future__ import annotations

from dataclasses import fields, replace
from functools import lru_cache
from typing import Any

from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.requirements.checks import is_function_path, read_formula
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.stl.formula import (
    Arithmetic,
    Comparison,
    Constant,
    Formula,
    Signal,
    walk,
)


def scaled_formula(requirement: Requirement) -> Formula | None:
    """Make the formula of a requirement with margins in its units of importance.

    Returns:
        ``None`` where it declares none.

    Raises:
        ConfigurationError: For a check that is no formula, a signal that it does not have, and a
            comparison of signals with different units.
    """
    if not requirement.scale:
        return None
    check = requirement.check
    if not check or is_function_path(check):
        raise ConfigurationError(
            f"`scale` of {requirement.id!r} scales nothing, since its check is no formula",
            key="scale",
            found=check or "no check",
            expected="a formula such as `always (gap > 0)`",
            remedy="let the function return a margin that is scaled already",
        )
    return _scaled(requirement.id, check, tuple(sorted(requirement.scale.items())))


@lru_cache(maxsize=256)
def _scaled(name: str, check: str, scale: tuple[tuple[str, float], ...]) -> Formula:
    formula, units = read_formula(check), dict(scale)
    unknown = sorted(units.keys() - set(formula.signals))
    if unknown:
        raise ConfigurationError(
            f"`scale` of {name!r} names a signal that its check does not read",
            key="scale",
            found=unknown[0],
            expected=" or ".join(formula.signals),
            remedy=did_you_mean(unknown[0], formula.signals),
        )

    def scaled(node: Any) -> Any:
        if not isinstance(node, Comparison):
            nodes = {
                field.name: scaled(child)
                for field in fields(node)
                if field.name in ("operand", "left", "right")
                and (child := getattr(node, field.name)) is not None
            }
            return replace(node, **nodes)
        amounts = {units.get(each.name) for each in walk(node) if isinstance(each, Signal)}
        if len(amounts) > 1:
            raise ConfigurationError(
                f"`scale` of {name!r} gives the sides of a comparison different units",
                key="scale",
                found=", ".join("none" if unit is None else f"{unit:g}" for unit in amounts),
                expected="one unit for all signals of a comparison",
                remedy="give both signals the same",
            )
        amount = amounts.pop() if amounts else None
        if amount is None:
            return node
        sides = (Arithmetic("/", side, Constant(amount)) for side in (node.left, node.right))
        return Comparison(node.operator, *sides)

    return Formula(scaled(formula.root), f"{check} (scaled)")
