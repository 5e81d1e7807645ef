"""Variation: what differs between the runs of a case, drawn from one stream per path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.core.seeding import stream
from pytest_dura.library.scenario import Choice, Range


def draw_value(path: str, variation: Range | Choice, seed: int) -> Any:
    """The value of a path in the run with this seed; no other path shifts it."""
    numbers = stream(seed, f"variation:{path}")
    if isinstance(variation, Range):
        drawn = numbers.uniform(variation.min, variation.max, variation.pieces)
        return float(drawn) if variation.pieces is None else drawn.tolist()
    return variation.choice[int(numbers.integers(len(variation.choice)))]


def extreme_values(variation: Range | Choice) -> list[Any]:
    """The values at which a variation is tried out before anything runs."""
    if isinstance(variation, Range):
        ends = [variation.min, variation.max]
        return ends if variation.pieces is None else [[end] * variation.pieces for end in ends]
    return list(variation.choice)


def split_path(path: str) -> tuple[str, str]:
    """``world.x.y`` as ``("", "x.y")`` and ``faults.id.x.y`` as ``("id", "x.y")``.

    Raises:
        ConfigurationError: For any other path.
    """
    head, _, rest = path.partition(".")
    if head == "world" and rest:
        return "", rest
    fault, _, inner = rest.partition(".")
    if head == "faults" and fault and inner:
        return fault, inner
    raise ConfigurationError(
        f"{path!r} cannot be varied",
        key=f"variation.{path}",
        found=path,
        expected="a path such as world.traffic.headway or faults.<id>.activation.at",
        remedy=did_you_mean(head, ("world", "faults")),
    )


def replace_value(data: Any, path: str, value: Any, *, create: bool = False) -> Any:
    """A copy of plain data with the value at a dotted path replaced; lists are indexed from 0.

    Raises:
        ConfigurationError: If the path does not exist. ``create`` allows the last key to be new.
    """
    head, _, rest = path.partition(".")
    if isinstance(data, Mapping):
        if head not in data and not (create and not rest):
            raise _no_such(head, data)
        inner = replace_value(data[head], rest, value, create=create) if rest else value
        return {**data, head: inner}
    if isinstance(data, (list, tuple)):
        if not (head.isdecimal() and int(head) < len(data)):
            raise _no_such(head, map(str, range(len(data))))
        items = list(data)
        i = int(head)
        items[i] = replace_value(items[i], rest, value, create=create) if rest else value
        return items
    raise _no_such(head, ())


def _no_such(key: str, known: Any) -> ConfigurationError:
    names = sorted(map(str, known))
    return ConfigurationError(
        f"there is no {key!r} to vary",
        found=key,
        expected="one of " + ", ".join(names) if names else "nothing below a single value",
        remedy=did_you_mean(key, names),
    )
