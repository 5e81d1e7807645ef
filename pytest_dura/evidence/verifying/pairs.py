"""Whether the table of a verdict on pairs of runs adds up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

Data = Mapping[str, Any]
_WORDS = ("only_with", "only_without", "both", "neither")


def pair_problems(verdict: Data, recovered: int | None) -> Iterator[str]:
    """Everything in which the table contradicts itself, its verdict, and its runs.

    Args:
        verdict: Of the record, on pairs.
        recovered: Its runs in which recovery acted, if they are known.
    """
    pairs = verdict["pairs"]
    if "pairs" not in pairs:
        return  # of a measure, which has no table
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
