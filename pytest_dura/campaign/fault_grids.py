"""Grids and random samples: one fault as data, and the values that are put into it.

Both are counted before anything is built of them: a grid is a product, and a few short lists can
stand for more cases than any machine could hold.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, Field, JsonValue, ValidationError

from pytest_dura.campaign import variation
from pytest_dura.campaign.planned_faults import FaultReader
from pytest_dura.campaign.scenario import Entry, Scenario, Variation, not_empty
from pytest_dura.campaign.validation import translate
from pytest_dura.campaign.yaml_source import MAX_DEPTH, Document
from pytest_dura.core.errors import ConfigurationError

MAX_CASES = 10_000
"""Cases that the fault campaigns of one scenario may make, all together."""

Values = Annotated[tuple[JsonValue, ...], Field(strict=False), AfterValidator(not_empty)]


class FaultGrid(Entry):
    """Every combination of values."""

    fault: dict[str, JsonValue]
    """The fault, without what the grid varies."""
    grid: dict[str, Values]
    """Keys of the fault, such as `parameters.offset`, to their values."""


class FaultSample(Entry):
    """Faults with random values."""

    fault: dict[str, JsonValue]
    """The fault, without what is drawn."""
    sample: dict[str, Variation]
    """Keys of the fault, such as `parameters.offset`, to a range or a choice."""
    count: int = Field(ge=1, le=MAX_CASES)
    """How many faults."""
    seed: int = Field(default=0, ge=0)
    """From which all draws follow."""


def grid(scenario: Scenario, data: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The faults of a :class:`FaultGrid` in plain data, the last key varying fastest.

    Raises:
        ConfigurationError: For too many of them, and for one that cannot be used.
    """
    given: FaultGrid = _model(FaultGrid, data)
    _check_keys("grid", given.grid)
    check_number(math.prod(map(len, given.grid.values())), "grid")
    yield from _combinations(given, FaultReader(scenario))


def sample(scenario: Scenario, data: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The faults of a :class:`FaultSample` in plain data; each value has a stream of its own.

    Raises:
        ConfigurationError: For one that cannot be used.
    """
    given: FaultSample = _model(FaultSample, data)
    _check_keys("sample", given.sample)
    reader = FaultReader(scenario)
    for number in range(given.count):
        values = {
            path: variation.draw(f"{number}:{path}", spread, given.seed)
            for path, spread in given.sample.items()
        }
        fault: Any = _named(given.fault)
        for path, value in values.items():
            fault = _with(fault, path.split("."), value)
        name = f"{fault['id']}-sample{given.seed}.{number}"
        yield reader.read({**fault, "id": name})


def check_number(cases: int, key: str) -> None:
    """Refuse more cases than could be looked at.

    Raises:
        ConfigurationError: With the key.
    """
    if cases > MAX_CASES:
        raise ConfigurationError(
            "these fault campaigns make too many cases",
            key=key,
            found=f"{cases:,} cases" if cases < 10**15 else "more than 10^15 cases",
            expected=f"at most {MAX_CASES:,} cases of one scenario",
            remedy="give fewer values, or draw some of the combinations with a `sample`",
        )


def _check_keys(word: str, keys: Iterable[str]) -> None:
    """Refuse keys of which one would overwrite what another one sets, and none at all."""
    paths = {key: key.split(".") for key in keys}
    if not paths:
        raise ConfigurationError(
            f"the {word} varies nothing",
            key=word,
            expected="keys of the fault with their values",
            remedy=f"for example {word}: {{parameters.offset: "
            + ("[1, 2]}" if word == "grid" else "{min: 1, max: 2}}"),
        )
    for key, path in paths.items():
        if len(path) > MAX_DEPTH:
            raise ConfigurationError(
                f"a key of the {word} is nested too deeply",
                key=word,
                found=f"{len(path)} parts",
                expected=f"at most {MAX_DEPTH} parts",
                remedy="name a key of the fault, such as parameters.offset",
            )
        within = [
            one for one, longer in paths.items() if one != key and longer[: len(path)] == path
        ]
        if within:
            raise ConfigurationError(
                f"the {word} sets {key!r}, and {within[0]!r} within it",
                key=f"{word}.{key}",
                found=key,
                expected="keys of which none is part of another",
                remedy="leave out one of them",
            )


def _combinations(given: FaultGrid, reader: FaultReader) -> Iterator[dict[str, Any]]:
    base = _named(given.fault)
    paths = [path.split(".") for path in given.grid]
    names = _short_names(list(given.grid))
    for values in itertools.product(*given.grid.values()):
        fault: Any = base
        for path, value in zip(paths, values, strict=True):
            fault = _with(fault, path, value)
        suffix = "".join(
            f"-{name}={_told(value)}" for name, value in zip(names, values, strict=True)
        )
        yield reader.read({**fault, "id": f"{base['id']}{suffix}"})


def _named(fault: Mapping[str, Any]) -> dict[str, Any]:
    return {"id": fault.get("id", fault.get("type", "")), **fault}


def _with(data: Any, path: Sequence[str], value: Any) -> Any:
    """A copy with the value at a path; mappings on the way are made."""
    if not path:
        return value
    inner = data if isinstance(data, Mapping) else {}
    return {**inner, path[0]: _with(inner.get(path[0]), path[1:], value)}


def _short_names(paths: Sequence[str]) -> list[str]:
    """The last part of each path; the whole of it where two end alike."""
    last = [path.rpartition(".")[2] for path in paths]
    return [path if last.count(name) > 1 else name for path, name in zip(paths, last, strict=True)]


def _told(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return "".join(one if one.isalnum() or one in "_.-" else "_" for one in text)


def _model(model: type[Any], data: Mapping[str, Any]) -> Any:
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise translate(error, model, Document()) from None
