"""Player: an episode in a browser, from above and over time, without a network.

A page takes both texts of :func:`player_assets` and calls, for each episode,
``DuraPlayer.mount(element, text, options)`` with the text of ``pack_data(player_data(trace))``, or
a function that returns it. The element then holds a button, and nothing is unpacked until it is
pressed, or at once with ``{open: true}``. It then stands 3 s before the first violation. ``label``
is the button's text; ``focus: true`` gives an opened player the focus, so that its keys work;
``page: true`` says that the page is this player's alone, whose keys then work wherever the focus
is; ``others()`` lists ``{label, packed}`` of episodes that may be shown beside it. ``mount``
returns ``{open(), play(), pause(), seek(tick), focus(), state}``; ``open()`` is a promise,
``state`` a copy.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import zlib
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from pytest_dura.core.measures import MeasureInfo
from pytest_dura.evidence.text import html, name, visible
from pytest_dura.evidence.traces import Trace, without_exchange
from pytest_dura.reports.episode_view import formula_of, margin_over_time
from pytest_dura.reports.html.panels import panel_assets, panel_data
from pytest_dura.reports.html.twins import Twin, twin_data
from pytest_dura.reports.incidents import KINDS
from pytest_dura.reports.scene import scene_data
from pytest_dura.requirements.stl.formula import Boolean, Node, Not, Temporal, TemporalPair

_MAX_WHOLE_NUMBER = 1e15
_TIME_TOLERANCE = 1e-6
"""Seconds within which a time of violation is that of a tick."""
MAX_MARGINS = 24
"""Curves of margins, those of violated requirements first."""


def player_data(
    trace: Trace,
    verdicts: Sequence[Mapping[str, Any]] = (),
    measures: Sequence[MeasureInfo] = (),
    twins: Sequence[Twin] = (),
) -> dict[str, Any]:
    """An episode for the player; the trace keeps what is rounded here.

    Args:
        trace: The episode.
        verdicts: The verdicts on it, each with ``requirement``, ``verdict``, and if known
            ``time`` of the violation in s, ``margin``, ``check`` and ``kind`` of the requirement;
            with a ``note`` where there is more to say.
        measures: As in the record; some name a signal whose rise is marked.
        twins: Runs of the same seed without something, whose ego is shown as a shadow.

    Returns:
        JSON data; ``verdicts`` have violations first, by kind and time. Columns of texts are
        ``{words, at}``, where ``at`` holds an index into ``words`` for each decision. Signals have
        six significant digits; ``None`` is NaN, and infinities are texts. ``margins`` are the
        checks' robustness over time, each with the ``formula`` that it is of, the ``requirements``
        that it decides, and ``open``: until which tick it was not lost yet, where something has to
        come about. ``twins`` have ``without``, ``label``, ``id``, ``problem``, ``ended`` in words,
        ``last`` (the tick at which it ended within this episode, or ``None``), ``runs`` of its ego
        at the episode's ticks, and ``difference`` and ``acted``: ``[tick, text]`` of the first
        difference, and of the first other action, or ``None``. For the scene see
        :func:`~pytest_dura.reports.scene.scene_data`, for ``panels``
        :func:`~pytest_dura.reports.html.panels.panel_data`.
    """
    recording, decisions = trace.recording, trace.decisions
    verdicts = sorted(verdicts, key=_worst_first)
    marks = {each.signal: each.event for each in measures if each.signal}
    return {
        "about": {key: _plain(value) for key, value in trace.about.items()},
        "time": _numbers(trace.time),
        "signals": {_name(signal): _numbers(column) for signal, column in trace.signals.items()},
        "verdicts": [_verdict(verdict, trace.time.tolist()) for verdict in verdicts],
        "margins": _margins(trace, verdicts),
        "decisions": {
            column: _indexed_texts(decisions[column].tolist() if column in decisions else ())
            for column in ("proposed", "executed", "source")
        },
        "attempts": [_number(attempt) for attempt in decisions.get("attempts", ())],
        "explanations": _indexed_texts(recording.explanations),
        "reasons": _indexed_texts(recording.reasons),
        "recoveries": _indexed_texts(recording.recoveries),
        "accounts": _indexed_texts(
            [_account(without_exchange(account)) for account in recording.accounts]
        ),
        "panels": panel_data(recording),
        "flags": {_name(monitor): _numbers(column) for monitor, column in recording.flags.items()},
        "events": _events(trace, marks),
        "marks": [[_name(signal), _name(event)] for signal, event in marks.items()],
        "faults": _faults(trace.events, len(trace.time)),
        "scene": None if recording.scene is None else scene_data(recording.scene, _name),
        "twins": [twin_data(trace, twin) for twin in twins],
        "problem": None if recording.problem is None else _text(recording.problem),
    }


def _text(value: object) -> str:
    return visible(str(value))


def _name(value: object) -> str:
    return name(str(value))


def _plain(value: Any) -> Any:
    return value if value is None or isinstance(value, (bool, int)) else _text(value)


def _numbers(column: NDArray[Any]) -> list[float | int | str | None]:
    return [_number(value) for value in column.tolist()]


def _number(value: float) -> float | int | str | None:
    """Six significant digits, whole numbers without a point."""
    if math.isnan(value):
        return None
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    rounded = float(f"{value:.6g}")
    return int(rounded) if abs(rounded) < _MAX_WHOLE_NUMBER and rounded.is_integer() else rounded


def _indexed_texts(texts: Sequence[object]) -> dict[str, list[Any]]:
    """The different texts, and the index of each entry's: most entries repeat another."""
    known: dict[str, int] = {}
    at = [known.setdefault(_text(text), len(known)) for text in texts]
    return {"words": list(known), "at": at}


def _account(account: Mapping[str, Any]) -> str:
    """One line for each key, values as JSON."""
    return "\n".join(
        f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in account.items()
    )


def _worst_first(verdict: Mapping[str, Any]) -> tuple[bool, int, float]:
    """Order verdicts: violations by kind and time, then the others as they are."""
    if verdict["verdict"] != "violated":
        return True, 0, 0.0
    kind, time = verdict.get("kind"), verdict.get("time")
    rank = KINDS.index(kind) if kind in KINDS else len(KINDS)
    return False, rank, math.inf if time is None else float(time)


def _verdict(verdict: Mapping[str, Any], time: Sequence[float]) -> dict[str, Any]:
    """A verdict, with the tick of its violation if its time is known."""
    at, margin, check = verdict.get("time"), verdict.get("margin"), verdict.get("check")
    tick = None
    if at is not None and time and math.isfinite(at):
        tick = min(bisect_left(time, at - _TIME_TOLERANCE), len(time) - 1)
    return {
        "requirement": _name(verdict["requirement"]),
        "verdict": _text(verdict["verdict"]),
        "time": None if at is None else _number(float(at)),
        "margin": None if margin is None else _number(float(margin)),
        "check": "" if check is None else _text(check),
        "note": _text(verdict.get("note") or ""),
        "tick": tick,
    }


def _margins(trace: Trace, verdicts: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The margin over time of each check that is a formula, once for those of the same one."""
    margins: dict[str, dict[str, Any]] = {}
    for verdict in sorted(verdicts, key=lambda verdict: verdict["verdict"] != "violated"):
        check = verdict.get("check") or ""
        if check not in margins:
            if len(margins) == MAX_MARGINS:
                continue
            margin = margin_over_time(check, trace)
            if margin is None:
                continue
            formula, column = margin
            values = _numbers(column)
            margins[check] = {"formula": _text(formula), "requirements": [], "values": values}
            margins[check]["violated"] = verdict["verdict"] == "violated"
            margins[check]["open"] = _open_until(check, verdict, trace.time.tolist())
        margins[check]["requirements"].append(_name(verdict["requirement"]))
    return list(margins.values())


def _open_until(check: str, verdict: Mapping[str, Any], time: Sequence[float]) -> int | None:
    """The tick until which the check was not lost yet; ``None`` of one that only has to stay true.

    What has to come about is below zero before it does, and lost only at its end.
    """
    formula = formula_of(check)
    if formula is None or not _awaits(formula.root):
        return None
    tick: int | None = _verdict(verdict, time)["tick"]
    return len(time) - 1 if tick is None else tick


def _awaits(node: Node, wanted: bool = True) -> bool:
    """Whether a formula holds only once something comes about."""
    if isinstance(node, Not):
        return _awaits(node.operand, not wanted)
    if isinstance(node, Boolean):
        turned = wanted if node.operator != "implies" else not wanted
        return _awaits(node.left, turned) or _awaits(node.right, wanted)
    if isinstance(node, Temporal):
        awaited = node.operator == ("eventually" if wanted else "always")
        return awaited or _awaits(node.operand, wanted)
    return isinstance(node, TemporalPair) and wanted


def _events(trace: Trace, marks: Mapping[str, str]) -> list[list[Any]]:
    """Rows of tick, kind, subject and detail, with what only a signal shows.

    Args:
        trace: The episode.
        marks: Signals whose rise is an event, and the kind of that event.
    """
    last = max(len(trace.time) - 1, 0)
    rows = [
        [min(max(int(event["tick"]), 0), last), _name(event["kind"]),
         _name(event["subject"]), _text(event.get("detail", ""))]
        for event in trace.events
    ]  # fmt: skip
    kinds = {row[1] for row in rows}
    for signal, event in marks.items():
        column = trace.signals.get(signal)
        if _name(event) not in kinds and column is not None and (column > 0.5).any():
            first, shown = int((column > 0.5).argmax()), _name(signal)
            rows.append([first, _name(event), shown, f"the signal {shown} was raised"])
    return sorted(rows, key=lambda row: row[0])


def _faults(events: Sequence[Mapping[str, Any]], ticks: int) -> list[dict[str, Any]]:
    """The ticks at which each fault was active, and those at which it changed what was read."""
    faults: list[dict[str, Any]] = []
    active: dict[str, dict[str, Any]] = {}
    last = max(ticks - 1, 0)
    for event in events:
        subject, tick = event["subject"], min(max(int(event["tick"]), 0), last)
        if event["kind"] == "fault_activated":
            fault = {"id": _name(subject), "from": tick, "to": last, "manifested": []}
            active[subject] = fault
            faults.append(fault)
        elif event["kind"] == "fault_manifested" and subject in active:
            active[subject]["manifested"].append(tick)
        elif event["kind"] == "fault_deactivated" and subject in active:
            active.pop(subject)["to"] = tick
    return faults


_ASSETS = Path(__file__).parent / "assets"
_PARTS = (
    "basics", "episode", "view", "lanes", "plots", "panels", "twins", "beside", "keys", "player",
)  # fmt: skip
_START = """
DuraPlayer.mount(document.getElementById("player"),
  document.getElementById("episode").textContent, {open: true, page: true});
"""
_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<style>{style}</style>
</head>
<body class="dura-page">
<main id="player"></main>
<noscript>This page plays an episode and needs JavaScript.</noscript>
<script type="application/octet-stream" id="episode">{data}</script>
<script>{script}</script>
</body>
</html>
"""


def pack_data(data: Mapping[str, Any]) -> str:
    """Data as zlib's deflate in base64, safe inside a script element or an attribute."""
    return packed_text(json.dumps(data, separators=(",", ":"), allow_nan=False), 9)


def packed_text(text: str, level: int = 6) -> str:
    """A text as zlib's deflate in base64."""
    return base64.b64encode(zlib.compress(text.encode(), level)).decode("ascii")


@cache
def player_assets(panels: frozenset[str] = frozenset()) -> tuple[str, str]:
    """The player's script, which defines ``DuraPlayer``, and its style; neither ends an element.

    Args:
        panels: Names of the panels that the data of its episodes have. The scripts of others are
            left out, so that a page depends on no other installed package.
    """
    parts = [(_ASSETS / f"{name}.js").read_text(encoding="utf-8") for name in _PARTS]
    scripts, styles = panel_assets(panels)
    parts += scripts
    script = '"use strict";\nconst DuraPlayer = (() => {\n' + "\n".join(parts)
    script += "\nreturn {mount};\n})();\n"
    style = (_ASSETS / "player.css").read_text(encoding="utf-8")
    return script, "\n".join([style, *styles])


def content_hash(text: str) -> str:
    """Name of an inline script or style in a content security policy, from its text."""
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"'sha256-{digest}'"


def player_page(
    trace: Trace,
    verdicts: Sequence[Mapping[str, Any]] = (),
    measures: Sequence[MeasureInfo] = (),
    twins: Sequence[Twin] = (),
) -> str:
    """A page of its own that plays an episode; it needs no network, and runs no other script.

    Args:
        trace: The episode.
        verdicts: As for :func:`~pytest_dura.reports.html.player.player_data`.
        measures: As for the same.
        twins: As for the same.
    """
    data = player_data(trace, verdicts, measures, twins)
    script, style = player_assets(frozenset(data["panels"]))
    script += _START
    policy = (
        f"default-src 'none'; script-src {content_hash(script)}; "
        f"style-src {content_hash(style)}; img-src data:; base-uri 'none'; form-action 'none'"
    )
    return _PAGE.format(
        policy=policy,
        title=html(f"{data['about'].get('id', 'episode')} - episode player"),
        style=style,
        data=pack_data(data),
        script=script,
    )
