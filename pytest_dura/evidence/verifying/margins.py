"""Whether the margins of a verdict go together: the least, their distribution, those it lists."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import Any

from pytest_dura.evidence.plain import plain
from pytest_dura.requirements.verdicts.campaigns import Margins
from pytest_dura.requirements.verdicts.episodes import EpisodeVerdict

Data = Mapping[str, Any]


def is_judged(verdict: EpisodeVerdict) -> bool:
    """Whether an episode's margin is one of its campaign's: it is valid, and not open."""
    return verdict.valid and verdict.verdict != "open"


def distribution(margins: Iterable[float | None]) -> dict[str, Any] | None:
    """The record's distribution of those that there are."""
    found = Margins.of([margin for margin in margins if margin is not None])
    return None if found is None else asdict(found)


def margin_problems(verdict: Data, on_traces: Iterable[EpisodeVerdict]) -> Iterator[str]:
    """Everything in which the margins of a verdict contradict each other.

    Args:
        verdict: Of the record.
        on_traces: What traces say of its episodes.
    """
    margins = verdict["margins"]
    listed = [one["margin"] for one in verdict["counterexamples"] if one["valid"]]
    order = [
        (not one["valid"], one["margin"] or 0.0, one["episode"])
        for one in verdict["counterexamples"]
    ]
    if order != sorted(order):
        yield "its counterexamples are not in the order of their margins"
    if (margins is None) != (verdict["margin"] is None):
        yield f"the margin is {verdict['margin']}, and its distribution {margins}"
    elif margins is not None:
        yield from _distribution(verdict, [one for one in listed if one is not None], on_traces)


def _distribution(
    verdict: Data, listed: list[float], on_traces: Iterable[EpisodeVerdict]
) -> Iterator[str]:
    margins = verdict["margins"]
    points = [margins[name] for name in ("min", "q25", "median", "q75", "max")]
    if None in points or points != sorted(points):
        yield "the quartiles of its margins are not in order"
        return
    if margins["min"] != verdict["margin"]:
        yield f"its least margin is {verdict['margin']}, and its distribution has {margins['min']}"
    if not len(listed) <= margins["n"] <= verdict["episodes"]:
        yield f"{margins['n']} margins of {verdict['episodes']} episodes"
    traced = [one.margin for one in on_traces if is_judged(one) and one.margin is not None]
    for margin in (*listed, *traced):
        if not margins["min"] <= margin <= margins["max"]:
            yield f"its margins begin at {margins['min']}, and one is {margin}"
    # A test on single episodes tells the margins of violations alone.
    measured = verdict["paired"] is not None and verdict["paired"]["measure"]
    by_tests = not verdict["check"] and not measured
    whole = verdict["violations"] == verdict["episodes"] == len(listed) or by_tests
    if whole and margins != plain(distribution(listed)):
        yield "the distribution of its margins is not that of its counterexamples"
