"""What the player shows of an episode, as compact plain data."""

from __future__ import annotations

import json
import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from typing import Any

from pytest_dura.evidence.player.scene import scene_data
from pytest_dura.evidence.text import name, visible
from pytest_dura.evidence.traces.trace import Trace
from pytest_dura.evidence.views.margin import margin_over_time

_WHOLE = 1e15
_NEAR = 1e-6
"""Seconds within which a time of violation is that of a tick."""
MAX_MARGINS = 24
"""Curves of margins, those of violated requirements first."""


def player_data(trace: Trace, verdicts: Sequence[Mapping[str, Any]] = ()) -> dict[str, Any]:
    """An episode for the player; the trace keeps what is rounded here.

    Args:
        trace: The episode.
        verdicts: What was found of it, each with ``requirement``, ``verdict``, and if known
            ``time`` of the violation in s, ``margin`` and ``check``; with a ``note`` where there is
            more to say.

    Returns:
        JSON data. Columns of texts are ``{words, at}``, where ``at`` holds an index into
        ``words`` for each decision. Signals have six significant digits; ``None`` is NaN, and
        infinities are texts. ``margins`` are the checks' robustness over time, each with the
        ``formula`` that it is of and the ``requirements`` that it decides. For the scene see
        :func:`~pytest_dura.evidence.player.scene.scene_data`.
    """
    recording, decisions = trace.recording, trace.decisions
    return {
        "about": {key: _plain(value) for key, value in trace.about.items()},
        "time": [_number(one) for one in trace.time.tolist()],
        "signals": {
            _name(signal): [_number(one) for one in column.tolist()]
            for signal, column in trace.signals.items()
        },
        "verdicts": [_verdict(one, trace.time.tolist()) for one in verdicts],
        "margins": _margins(trace, verdicts),
        "decisions": {
            one: _words(decisions[one].tolist() if one in decisions else ())
            for one in ("proposed", "executed", "source")
        },
        "attempts": [_number(one) for one in decisions.get("attempts", ())],
        "explanations": _words(recording.explanations),
        "reasons": _words(recording.reasons),
        "recoveries": _words(recording.recoveries),
        "accounts": _words([_account(one) for one in recording.accounts]),
        "flags": {
            _name(monitor): [_number(one) for one in column.tolist()]
            for monitor, column in recording.flags.items()
        },
        "events": _events(trace),
        "faults": _faults(trace.events, len(trace.time)),
        "scene": None if recording.scene is None else scene_data(recording.scene, _name),
        "problem": None if recording.problem is None else _text(recording.problem),
    }


def _text(value: object) -> str:
    return visible(str(value))


def _name(value: object) -> str:
    return name(str(value))


def _plain(value: Any) -> Any:
    return value if value is None or isinstance(value, (bool, int)) else _text(value)


def _number(value: float) -> float | int | str | None:
    """Six significant digits, whole numbers without a point."""
    if math.isnan(value):
        return None
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    rounded = float(f"{value:.6g}")
    return int(rounded) if abs(rounded) < _WHOLE and rounded.is_integer() else rounded


def _words(texts: Sequence[object]) -> dict[str, list[Any]]:
    known: dict[str, int] = {}
    at = [known.setdefault(_text(one), len(known)) for one in texts]
    return {"words": list(known), "at": at}


def _account(account: Mapping[str, Any]) -> str:
    """One line for each key, values as JSON."""
    return "\n".join(
        f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in account.items()
    )


def _verdict(one: Mapping[str, Any], time: Sequence[float]) -> dict[str, Any]:
    """A verdict, with the tick of its violation if its time is known."""
    at, margin, check = one.get("time"), one.get("margin"), one.get("check")
    tick = None
    if at is not None and time and math.isfinite(at):
        tick = min(bisect_left(time, at - _NEAR), len(time) - 1)
    return {
        "requirement": _name(one["requirement"]),
        "verdict": _text(one["verdict"]),
        "time": None if at is None else _number(float(at)),
        "margin": None if margin is None else _number(float(margin)),
        "check": "" if check is None else _text(check),
        "note": _text(one.get("note") or ""),
        "tick": tick,
    }


def _margins(trace: Trace, verdicts: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The margin over time of each check that is a formula, once for those of the same one."""
    found: dict[str, dict[str, Any]] = {}
    for one in sorted(verdicts, key=lambda one: one["verdict"] != "violated"):
        check = one.get("check") or ""
        if check not in found:
            if len(found) == MAX_MARGINS:
                continue
            margin = margin_over_time(check, trace)
            if margin is None:
                continue
            formula, column = margin
            values = [_number(value) for value in column.tolist()]
            found[check] = {"formula": _text(formula), "requirements": [], "values": values}
            found[check]["violated"] = one["verdict"] == "violated"
        found[check]["requirements"].append(_name(one["requirement"]))
    return list(found.values())


def _events(trace: Trace) -> list[list[Any]]:
    """Rows of tick, kind, subject and detail, with the collision that a signal tells of."""
    last = max(len(trace.time) - 1, 0)
    rows = [
        [min(max(int(one["tick"]), 0), last), _name(one["kind"]),
         _name(one["subject"]), _text(one.get("detail", ""))]
        for one in trace.events
    ]  # fmt: skip
    collided = trace.signals.get("collided")
    told = any(row[1] == "collision" for row in rows)
    if not told and collided is not None and (collided > 0.5).any():
        first = int((collided > 0.5).argmax())
        rows.append([first, "collision", "collided", "the signal collided was raised"])
    return sorted(rows, key=lambda row: row[0])


def _faults(events: Sequence[Mapping[str, Any]], ticks: int) -> list[dict[str, Any]]:
    """When each fault was active, in ticks, and when it changed what the component read."""
    found: list[dict[str, Any]] = []
    active: dict[str, dict[str, Any]] = {}
    last = max(ticks - 1, 0)
    for event in events:
        subject, tick = event["subject"], min(max(int(event["tick"]), 0), last)
        if event["kind"] == "fault_activated":
            one = {"id": _name(subject), "from": tick, "to": last, "manifested": []}
            active[subject] = one
            found.append(one)
        elif event["kind"] == "fault_manifested" and subject in active:
            active[subject]["manifested"].append(tick)
        elif event["kind"] == "fault_deactivated" and subject in active:
            active.pop(subject)["to"] = tick
    return found
