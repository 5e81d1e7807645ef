"""A driving case and counterexamples of it, made by hand, to be shrunk without simulating."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pytest_dura.faults import default_fault
from pytest_dura.library import (
    Case,
    Scenario,
    SearchedCase,
    expand_cases,
    make_searched_case,
    replace_value,
)

WORLD = {
    "ego": {"distance": 50.0, "speed": 8.0},
    "vehicles": [
        {"id": "LEADER", "arm": "south", "distance": 20.0},
        {"id": "WEST", "arm": "west", "distance": 48.0},
    ],
}


def crossing(*, world: Mapping[str, Any] = WORLD, **more: Any) -> Case:
    """A case of 20 s without random traffic, unless told otherwise."""
    data = {
        "name": "crossing",
        "simulator": "driving",
        "duration": 20.0,
        "world": dict(world),
        "variation": {"world.ego.speed": {"min": 6.0, "max": 8.5}},
    }
    (case,) = expand_cases([Scenario.model_validate({**data, **more})])
    return case


def fault(kind: str, target: str, **changes: Any) -> dict[str, Any]:
    """The example of a type, with other values by path, such as ``activation__at``."""
    made: Any = default_fault(kind, {"number": target, "any": target}).plain()
    for path, value in changes.items():
        made = replace_value(made, path.replace("__", "."), value, create=True)
    return dict(made)


def found(
    case: Case, world: Mapping[str, Any] | None = None, faults: Sequence[Any] = (), seed: int = 0
) -> SearchedCase:
    """What a search made of a case: another world, other faults."""
    return make_searched_case(case, case.scenario.world if world is None else world, faults, seed)


def ids(searched: SearchedCase, kind: str = "vehicles") -> set[str]:
    """Ids of the vehicles or pedestrians of a searched case."""
    return {one["id"] for one in searched.scenario.world.get(kind, ())}
