"""One tick of the assurance loop in its six steps, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pytest_dura.core.recording import Recording
from pytest_dura.evidence.text import one_line
from pytest_dura.evidence.traces.trace import Trace

WORDS = {0: "safe", 1: "warning", 2: "unsafe"}
_FAULTS = ("fault_activated", "fault_manifested", "fault_deactivated")
_ASSESSED = ("unsafe", "alert", "reaction", "performance_fail")
_DECIDED = ("recovery",)


@dataclass(frozen=True)
class LoopStep:
    """One step of a tick.

    Args:
        name: Such as ``Propose: SLOWER``.
        told: What happened in it, by name.
    """

    name: str
    told: Mapping[str, str]


def decision_at(trace: Trace, time: float | None) -> int | None:
    """The tick with a decision that a time belongs to, the last one at most; ``None`` of none.

    Without a time it is the first tick at which something was unsafe, or else the first one.
    """
    verdicts = trace.decisions["verdict"]
    if not len(verdicts):
        return None
    if time is None or not np.isfinite(time):
        return int(np.argmax(np.asarray(verdicts) == 2))
    return min(int(np.searchsorted(trace.time, time - 1e-6)), len(verdicts) - 1)


def loop_steps(trace: Trace, tick: int, signals: Sequence[str]) -> list[LoopStep]:
    """Update, Propose, Assess, Decide, Act and Log of a tick.

    Args:
        trace: The episode.
        tick: A tick at which something was decided.
        signals: Names of the signals to tell of.
    """
    column = {name: str(values[tick]) for name, values in trace.decisions.items()}
    said, word = trace.recording, WORDS[int(trace.decisions["verdict"][tick])]
    recovery = _at(said.recoveries, tick)
    action = _at(said.recoveries, tick) or column["source"]
    return [
        LoopStep(
            f"Update: t = {trace.time[tick]:.2f} s",
            _values(trace, tick, signals) | _events(trace, tick, _FAULTS),
        ),
        LoopStep(
            one_line(f"Propose: {column['proposed'] or 'nothing'}", 200),
            _given(explanation=_at(said.explanations, tick))
            | _events(trace, tick, ("component_failure",)),
        ),
        LoopStep(
            f"Assess: {word}",
            _flags(said, tick)
            | _given(reasons=_at(said.reasons, tick))
            | _events(trace, tick, _ASSESSED),
        ),
        LoopStep(
            one_line(f"Decide: {action}", 200),
            _given(source=column["source"], recovery=recovery)
            | ({"attempts": column["attempts"]} if column["attempts"] != "0" else {}),
        ),
        LoopStep(
            one_line(f"Act: {column['executed'] or 'nothing'}", 200),
            {f"{name} then": value for name, value in _truth(trace, tick + 1, signals).items()},
        ),
        LoopStep(
            f"Log: t = {trace.time[tick + 1]:.2f} s",
            _after(trace, tick) | _ending(trace, tick),
        ),
    ]


def _truth(trace: Trace, tick: int, signals: Sequence[str]) -> dict[str, str]:
    return {
        one_line(name, 100): f"{float(trace.signals[name][tick]):.6g}"
        for name in signals
        if name in trace.signals
    }


def _values(trace: Trace, tick: int, signals: Sequence[str]) -> dict[str, str]:
    """Each signal as it is, and as it is perceived where there is such a column."""
    found: dict[str, str] = {}
    for name in signals:
        found |= _truth(trace, tick, [name, f"percept.{name}"])
    return found


def _flags(said: Recording, tick: int) -> dict[str, str]:
    return {
        one_line(monitor, 100): WORDS.get(int(column[tick]), "not asked")
        for monitor, column in said.flags.items()
    }


def _at(column: Sequence[str], tick: int) -> str:
    return column[tick] if tick < len(column) else ""


def _given(**texts: str) -> dict[str, str]:
    return {name: one_line(text) for name, text in texts.items() if text}


def _events(trace: Trace, tick: int, kinds: Sequence[str]) -> dict[str, str]:
    """The tick's events of these kinds; several of one kind are joined."""
    found: dict[str, list[str]] = {}
    for event in trace.events:
        if event["tick"] == tick and event["kind"] in kinds:
            detail = f": {event['detail']}" if event["detail"] else ""
            found.setdefault(event["kind"], []).append(f"{event['subject']}{detail}")
    return {kind: one_line("; ".join(texts)) for kind, texts in found.items()}


def _after(trace: Trace, tick: int) -> dict[str, str]:
    """What else was logged in this tick, of whatever kind."""
    told = (*_FAULTS, *_ASSESSED, *_DECIDED, "component_failure")
    others = dict.fromkeys(one["kind"] for one in trace.events if one["kind"] not in told)
    return _events(trace, tick, list(others))


def _ending(trace: Trace, tick: int) -> dict[str, str]:
    if tick + 2 < len(trace.time):
        return {}
    about = {name: str(trace.about[name] or "") for name in ("termination", "failure")}
    return _given(**about)
