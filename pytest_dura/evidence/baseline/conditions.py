"""Conditions: under what episodes ran, so that only like campaigns are compared."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

JUDGED_UNDER = ("simulator", "scenario", "faults", "termination", "time_step", "time_budget")
"""Of an episode's spec. Roles and policy are left out: they may be what is compared."""


@dataclass(frozen=True)
class Conditions:
    """Under what an episode ran, the component under test and the other roles apart.

    Args:
        seed: The episode's seed.
        values: Simulator, world, faults, duration, time step and budget, by dotted path.
    """

    seed: int
    values: Mapping[str, Any]

    @classmethod
    def of(cls, spec: Mapping[str, Any]) -> Conditions:
        """Those of an episode's spec, as plain data.

        Raises:
            AttributeError: For a damaged spec, as those below.
            KeyError: See above.
            TypeError: See above.
        """
        kept = {key: spec[key] for key in JUDGED_UNDER}
        # The role that puts the faults into effect belongs to the faults.
        kept["fault_injector"] = spec["roles"].get("fault_injector")
        seed = spec["seed"]
        if isinstance(seed, bool) or not isinstance(seed, int):
            raise TypeError(f"{seed!r} is no seed")
        return cls(seed, dict(_leaves("", kept)))


def changed_conditions(
    mine: Mapping[int, Conditions], others: Mapping[int, Conditions]
) -> list[str]:
    """Dotted paths of what is not the same for two campaigns on one case.

    Runs of equal seeds must have equal conditions. Without such runs, a value that is the same in
    all runs of each campaign must be the same in both; one that varies between runs cannot be
    compared, since a record holds the drawn values and not the range that they come from.

    Args:
        mine: By the run's number.
        others: By the run's number.
    """
    shared = [run for run in mine if run in others and mine[run].seed == others[run].seed]
    if shared:
        pairs = ((mine[run].values, others[run].values) for run in shared)
        return sorted(set().union(*(_different(*pair) for pair in pairs)))
    if not (mine and others):
        return []
    first, other = (next(iter(runs.values())).values for runs in (mine, others))
    varying = _varying(mine.values()) | _varying(others.values())
    return sorted(_different(first, other) - varying)


def _leaves(path: str, value: Any) -> list[tuple[str, Any]]:
    if isinstance(value, Mapping):
        inner = list(value.items())
    elif isinstance(value, (list, tuple)):
        inner = [(str(i), one) for i, one in enumerate(value)]
    else:
        return [(path, value)]
    prefix = f"{path}." if path else ""
    leaves = [leaf for key, one in inner for leaf in _leaves(f"{prefix}{key}", one)]
    return leaves or [(path, ())]


_ABSENT = object()


def _different(mine: Mapping[str, Any], others: Mapping[str, Any]) -> set[str]:
    paths = {*mine, *others}
    return {path for path in paths if mine.get(path, _ABSENT) != others.get(path, _ABSENT)}


def _varying(runs: Collection[Conditions]) -> set[str]:
    first = next(iter(runs)).values
    return {path for one in runs for path in _different(first, one.values)}
