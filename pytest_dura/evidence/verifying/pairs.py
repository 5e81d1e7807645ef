"""Whether the table of a verdict on pairs of runs adds up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

Data = Mapping[str, Any]
_ROUNDING = 1e-6
_WORDS = ("only_with", "only_without", "both", "neither")


def pair_problems(verdict: Data, recovered: int | None) -> Iterator[str]:
    """Everything in which the table contradicts itself, its verdict, and its runs.

    Args:
        verdict: Of the record, on pairs.
        recovered: Its runs in which recovery acted, if they are known.
    """
    pairs = verdict["pairs"]
    if "change" in pairs:
        yield from _change_problems(verdict)
        return
    from pytest_dura.requirements.statistics import mcnemar

    open_pairs = pairs["incomplete"]
    complete = sum(pairs[word] for word in _WORDS)
    if not pairs["pairs"] == complete + open_pairs == verdict["run"]:
        yield f"the table of its pairs does not add up to {verdict['run']}"
    acted = sum(pairs[f"acted_{word}"] for word in _WORDS)
    if any(pairs[f"acted_{word}"] > pairs[word] for word in _WORDS):
        yield "recovery acted in more of its pairs than there are"
    if recovered is not None and not acted <= recovered <= acted + open_pairs:
        yield f"recovery acted in {acted} of its pairs, and in {recovered} of its runs"
    p_value = mcnemar(pairs["only_with"], pairs["only_without"])
    if pairs["p_value"] != p_value:
        yield f"p is {pairs['p_value']}, and its table gives {p_value}"
    tried = pairs["acted_only_without"] + pairs["acted_both"]
    rate = pairs["acted_only_without"] / tried if tried else None
    if pairs["success_rate"] != rate:
        yield f"the rate of success is {pairs['success_rate']}, and its table gives {rate}"
    for name in ("with", "without"):
        least, told = pairs["both"] + pairs[f"only_{name}"], pairs[f"violated_{name}"]
        if not least <= told <= least + open_pairs:
            yield f"{told} runs {name} it violated it, and its table says {least}"


def _change_problems(verdict: Data) -> Iterator[str]:
    """Everything in which the changes of a measure contradict their summary and the verdict."""
    from pytest_dura.requirements.pairs.changes import Change

    change = verdict["pairs"]["change"]
    if len(change["pairs"]) != len(change["values"]):
        yield f"its change has {len(change['values'])} values for {len(change['pairs'])} pairs"
        return
    if Change.from_json(change).to_json() != change:
        yield "the summary of its change is not that of its values"
    counted = change["n"] + sum(len(change[key]) for key in ("lost", "gained"))
    if not counted <= verdict["run"]:
        yield f"its change has {counted} pairs, of {verdict['run']}"
    bound = verdict["paired"]["change_at_most"]
    over = [value - bound for value in change["values"] if value is not None]
    # Values that equal the bound but for rounding violate nothing.
    slack = _ROUNDING * max(1.0, abs(bound))
    least, most = (sum(one > shift for one in over) for shift in (slack, -slack))
    lost = len(change["lost"])
    if not least + lost <= verdict["violations"] <= most + lost:
        yield f"{verdict['violations']} pairs violate it, and its changes give {least + lost}"
