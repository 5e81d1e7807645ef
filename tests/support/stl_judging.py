"""Judging small traces by formulas given as text."""

from __future__ import annotations

from typing import Any

from pytest_dura.requirements import Ending, Evaluation, evaluate, parse


def judge(
    text: str,
    time: Any = None,
    *,
    ending: Ending = "time",
    step: float | None = None,
    **signals: Any,
) -> Evaluation:
    first = next(iter(signals.values()))
    time = range(len(first)) if time is None else time
    return evaluate(parse(text), list(time), signals, ending=ending, time_step=step)
