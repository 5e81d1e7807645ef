"""Views of an episode: margins, signals as CSV and SVG, and the steps of a tick in words."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pytest_dura.core.episode import Episode
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.simulator import Recording
from pytest_dura.evidence.text import one_line
from pytest_dura.evidence.traces import Trace
from pytest_dura.reports.svg import Scale, Svg, document, path_of, tag
from pytest_dura.requirements.checks import is_function_path
from pytest_dura.requirements.episode_verdicts import judge_by_check
from pytest_dura.requirements.margins import Column, columns_of, margins_over_time, moment_of
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.stl.formula import Formula
from pytest_dura.requirements.stl.parser import parse

_TIME_DECIMALS = 9
"""Decimals of seconds; further ones come from adding up time steps."""


def formula_of(check: str) -> Formula | None:
    """The formula that a check is; ``None`` for a function, and where test code decides."""
    if not check or is_function_path(check):
        return None
    try:
        return parse(check)
    except ConfigurationError:  # the name of a function inside a test
        return None


def margin_over_time(check: str, episode: Episode | Trace) -> tuple[str, Column] | None:
    """The robustness at each tick, and the formula that it is of.

    An ``always`` over the whole episode at the root is left out, so that the curve shows the
    moment: its minimum is the margin. NaN where a signal is not finite, and after that.

    Returns:
        ``None`` for a check that is no formula over signals of this episode.
    """
    formula = formula_of(check)
    if formula is None:
        return None
    columns = columns_of(formula, episode.time, episode.signals, episode.decisions)
    if not columns or len(columns) < len(formula.signals):
        return None
    moment = moment_of(formula)
    try:
        margins = margins_over_time(moment, columns, _time_step(episode))
    except ConfigurationError:  # an expression that is not finite: the verdict tells where
        return None
    return None if np.isnan(margins).all() else (str(moment), margins)


def _time_step(episode: Episode | Trace) -> float:
    """Seconds from tick to tick; a trace tells them by its times alone."""
    if isinstance(episode, Episode):
        return episode.spec.time_step
    steps = len(episode.time) - 1
    return (
        round(float(episode.time[-1] - episode.time[0]) / steps, _TIME_DECIMALS) if steps else 1.0
    )


MAX_CELLS = 60_000
"""Greatest number of values, which stay below 2 MB."""


def signals_csv(trace: Trace, cells: int = MAX_CELLS) -> str:
    """One row per tick with the time in s and each signal; of a long episode every n-th tick.

    Args:
        trace: The episode.
        cells: Greatest number of values.
    """
    names = sorted(trace.signals)
    every = max(1, math.ceil(len(trace.time) * (len(names) + 1) / cells))
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["time", *map(_safe_header, names)])
    columns = [trace.time[::every], *(trace.signals[name][::every] for name in names)]
    writer.writerows(zip(*(column.tolist() for column in columns), strict=True))
    return stream.getvalue()


def _safe_header(name: str) -> str:
    """A name that no spreadsheet takes for a formula."""
    shown = one_line(name, 200)
    return f"'{shown}" if shown[:1] in ("=", "+", "-", "@") else shown


_STATUS_NAMES = {0: "safe", 1: "warning", 2: "unsafe"}
_FAULTS = ("fault_activated", "fault_manifested", "fault_deactivated")
_ASSESSED = ("unsafe", "alert", "reaction", "performance_fail")
_DECIDED = ("recovery",)


@dataclass(frozen=True)
class LoopStep:
    """One step of a tick.

    Args:
        name: Such as ``Propose: SLOWER``.
        details: What happened in it, by name.
    """

    name: str
    details: Mapping[str, str]


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
    recording, status = trace.recording, _STATUS_NAMES[int(trace.decisions["verdict"][tick])]
    recovery = _value_at(recording.recoveries, tick)
    action = _value_at(recording.recoveries, tick) or column["source"]
    return [
        LoopStep(
            f"Update: t = {trace.time[tick]:.2f} s",
            _signal_values(trace, tick, signals) | _events_of_tick(trace, tick, _FAULTS),
        ),
        LoopStep(
            one_line(f"Propose: {column['proposed'] or 'nothing'}", 200),
            _joined_parts(explanation=_value_at(recording.explanations, tick))
            | _events_of_tick(trace, tick, ("component_failure",)),
        ),
        LoopStep(
            f"Assess: {status}",
            _flag_text(recording, tick)
            | _joined_parts(reasons=_value_at(recording.reasons, tick))
            | _events_of_tick(trace, tick, _ASSESSED),
        ),
        LoopStep(
            one_line(f"Decide: {action}", 200),
            _joined_parts(source=column["source"], recovery=recovery)
            | ({"attempts": column["attempts"]} if column["attempts"] != "0" else {}),
        ),
        LoopStep(
            one_line(f"Act: {column['executed'] or 'nothing'}", 200),
            {
                f"{name} then": value
                for name, value in _truth_text(trace, tick + 1, signals).items()
            },
        ),
        LoopStep(
            f"Log: t = {trace.time[tick + 1]:.2f} s",
            _other_events(trace, tick) | _ending_text(trace, tick),
        ),
    ]


def _truth_text(trace: Trace, tick: int, signals: Sequence[str]) -> dict[str, str]:
    return {
        one_line(name, 100): f"{float(trace.signals[name][tick]):.6g}"
        for name in signals
        if name in trace.signals
    }


def _signal_values(trace: Trace, tick: int, signals: Sequence[str]) -> dict[str, str]:
    """Each signal as it is, and as it is perceived where there is such a column."""
    values: dict[str, str] = {}
    for name in signals:
        values |= _truth_text(trace, tick, [name, f"percept.{name}"])
    return values


def _flag_text(recording: Recording, tick: int) -> dict[str, str]:
    return {
        one_line(monitor, 100): _STATUS_NAMES.get(int(column[tick]), "not asked")
        for monitor, column in recording.flags.items()
    }


def _value_at(column: Sequence[str], tick: int) -> str:
    return column[tick] if tick < len(column) else ""


def _joined_parts(**texts: str) -> dict[str, str]:
    return {name: one_line(text) for name, text in texts.items() if text}


def _events_of_tick(trace: Trace, tick: int, kinds: Sequence[str]) -> dict[str, str]:
    """The tick's events of these kinds; several of one kind are joined."""
    details: dict[str, list[str]] = {}
    for event in trace.events:
        if event["tick"] == tick and event["kind"] in kinds:
            detail = f": {event['detail']}" if event["detail"] else ""
            details.setdefault(event["kind"], []).append(f"{event['subject']}{detail}")
    return {kind: one_line("; ".join(texts)) for kind, texts in details.items()}


def _other_events(trace: Trace, tick: int) -> dict[str, str]:
    """The tick's events of all other kinds."""
    shown = (*_FAULTS, *_ASSESSED, *_DECIDED, "component_failure")
    others = dict.fromkeys(event["kind"] for event in trace.events if event["kind"] not in shown)
    return _events_of_tick(trace, tick, list(others))


def _ending_text(trace: Trace, tick: int) -> dict[str, str]:
    if tick + 2 < len(trace.time):
        return {}
    about = {name: str(trace.about[name] or "") for name in ("termination", "failure")}
    return _joined_parts(**about)


WIDTH, LEFT, RIGHT = 720, 64, 16
HEIGHT, GAP, TOP, BOTTOM = 96, 30, 34, 44
POINTS = 500
"""Points of a curve at most; a longer one is drawn by the least and greatest value of each part."""

LARGEST = 1e300

STYLE = """
text{font:12px system-ui,sans-serif;fill:#1f2328}.small{font-size:10px;fill:#57606a}
.back{fill:#fff}.frame{fill:none;stroke:#d0d7de}.bound{stroke:#57606a;stroke-dasharray:2 3}
.line{fill:none;stroke-width:1.6}.c0{stroke:#0550ae}.c1{stroke:#bc4c00;stroke-dasharray:5 3}
.mark{stroke:#cf222e;stroke-width:1.4}.told{fill:#cf222e}
@media(prefers-color-scheme:dark){text{fill:#e6edf3}.small{fill:#9198a1}.back{fill:#0d1117}
.frame{stroke:#3d444d}.bound{stroke:#9198a1}.c0{stroke:#6cb6ff}.c1{stroke:#f0883e}
.mark{stroke:#ff7b72}.told{fill:#ff7b72}}
"""


@dataclass(frozen=True)
class Panel:
    """One plot of several below each other.

    Args:
        name: What it shows.
        curves: Up to two columns of shape ``(ticks,)`` by name; the second one is dashed.
        bound: A value to draw a line at.
    """

    name: str
    curves: Mapping[str, Column]
    bound: float | None = None


def signal_plot(
    title: str,
    description: str,
    time: Column,
    panels: Sequence[Panel],
    mark: tuple[float, str] | None = None,
) -> Svg:
    """An SVG of panels over one axis of time.

    Args:
        title: Its title, which screen readers read first.
        description: What is to be seen, in words.
        time: Seconds, shape ``(ticks,)``.
        panels: What is drawn, from top to bottom.
        mark: A time and what happened there, drawn through all panels.
    """
    height = TOP + len(panels) * (HEIGHT + GAP) - GAP + BOTTOM
    start, end = (float(time[0]), float(time[-1])) if len(time) else (0.0, 0.0)
    span = (end - start) or 1.0
    x = Scale(start, start + span, LEFT, WIDTH - RIGHT)
    base = height - BOTTOM
    parts = [
        tag("title", one_line(title, 200), id="title"),
        tag("desc", one_line(description, 200), id="desc"),
        tag("style", Svg(STYLE)),
        tag("rect", class_="back", width="100%", height="100%"),
        tag("text", one_line(title, 200), x=LEFT, y=18),
    ]
    for index, panel in enumerate(panels):
        parts += _panel_svg(panel, TOP + index * (HEIGHT + GAP), time, x)
    parts += [
        tag(
            "text",
            f"{at:.3g} s" if abs(at) < 1000.0 else f"{at:.0f} s",
            class_="small",
            x=x(at),
            y=base + 16,
            text_anchor=anchor,
        )
        for at, anchor in ((start, "start"), (start + span / 2, "middle"), (end, "end"))
    ]
    if mark is not None and math.isfinite(mark[0]):
        at, words = x(min(max(mark[0], start), end)), one_line(mark[1], 200)
        anchor = "end" if at > WIDTH / 2 else "start"
        parts.append(tag("line", class_="mark", x1=at, x2=at, y1=TOP, y2=base))
        parts.append(tag("text", words, class_="told", x=at, y=base + 34, text_anchor=anchor))
    return Svg(document(WIDTH, height, *parts, role="img", aria_labelledby="title desc") + "\n")


def _panel_svg(panel: Panel, top: int, time: Column, x: Scale) -> list[Svg]:
    least, greatest = _value_range(panel)
    room = (greatest - least) * 0.05 or max(abs(greatest) * 0.05, 0.5)
    y = Scale(least - room, greatest + room, top + HEIGHT, top)
    right = WIDTH - RIGHT
    frame = {"x": LEFT, "y": top, "width": right - LEFT, "height": HEIGHT}
    end = {"class_": "small", "text_anchor": "end"}
    parts = [
        tag("rect", class_="frame", **frame),
        tag("text", _legend(panel), x=right, y=top - 5, **end),
        *(
            tag("text", f"{value:.4g}", x=LEFT - 6, y=y(value) + 3, **end)
            for value in sorted({least, greatest})
        ),
    ]
    if panel.bound is not None:
        level = y(panel.bound)
        parts.append(tag("line", class_="bound", x1=LEFT, x2=right, y1=level, y2=level))
    for index, column in enumerate(panel.curves.values()):
        path = _line_path(*_thinned(time, column), x, y)
        if path:
            parts.append(tag("path", class_=f"line c{min(index, 1)}", d=path))
    return parts


def _legend(panel: Panel) -> str:
    others = [f"dashed: {name}" for name in list(panel.curves)[1:]]
    return one_line(", ".join([panel.name, *others]), 200)


def _value_range(panel: Panel) -> tuple[float, float]:
    """The least and greatest finite value, that of the bound included."""
    columns = [column[np.isfinite(column)] for column in panel.curves.values()]
    values = np.concatenate([*columns, [] if panel.bound is None else [panel.bound]])
    if not len(values):
        return 0.0, 1.0
    # Of values near the greatest float no number is left for their difference.
    low, high = np.clip([values.min(), values.max()], -LARGEST, LARGEST)
    return float(low), float(high)


def _thinned(time: Column, column: Column) -> tuple[Column, Column]:
    """At most :data:`POINTS` samples that keep every part's extremes."""
    if len(column) <= POINTS:
        return time, column
    chosen = {0, len(column) - 1}
    for part in np.array_split(np.arange(len(column)), POINTS // 3):
        values = column[part]
        gaps = part[~np.isfinite(values)]
        chosen.update(gaps[:1].tolist())
        if np.isfinite(values).any():
            chosen.add(int(part[np.nanargmin(np.where(np.isfinite(values), values, np.nan))]))
            chosen.add(int(part[np.nanargmax(np.where(np.isfinite(values), values, np.nan))]))
    kept = np.array(sorted(chosen))
    return time[kept], column[kept]


def _line_path(time: Column, column: Column, x: Scale, y: Scale) -> str:
    """Straight lines from sample to sample, broken where a sample is not finite."""
    low, high = -LARGEST, LARGEST
    return path_of(
        (x(seconds), y(min(max(value, low), high)) if math.isfinite(value) else math.nan)
        for seconds, value in zip(time.tolist(), column.tolist(), strict=True)
    )


_MOST_SIGNALS = 5
"""Signals of a plot, beside the margin."""


def plot_episode(episode: Episode, check: Requirement | str, file: Path | str | None = None) -> Svg:
    """Draw the margin of a requirement over time, and the signals that it reads.

    Args:
        episode: The episode.
        check: A requirement with a check, or a formula.
        file: Where the picture is written, as SVG; ``None`` for nowhere.

    Returns:
        The picture, which a notebook shows.

    Raises:
        ConfigurationError: For a requirement without a check, a check that cannot be read, and one
            that names an unknown signal; for a file that is no SVG, or cannot be written.
    """
    named = check.id if isinstance(check, Requirement) else ""
    text = check.check if isinstance(check, Requirement) else check
    if not text:
        raise ConfigurationError(
            f"the requirement {named!r} has no check, so that there is no margin to draw",
            key="check",
            expected="a requirement with a formula, or a formula",
            remedy="give the formula itself",
        )
    judged = judge_by_check(text, episode)
    picture = verdict_plot(episode, text, f"{named} {judged.status}".strip(), judged.time)
    if file is not None:
        _write_picture(Path(file), picture)
    return picture


def _write_picture(file: Path, picture: Svg) -> None:
    problem = "" if file.suffix.lower() == ".svg" else "it is made as SVG alone"
    try:
        if not problem:
            file.write_text(picture, "utf-8")
    except OSError as error:
        problem = error.strerror or str(error)
    if problem:
        raise ConfigurationError(
            f"the picture cannot be written: {problem}",
            file=str(file),
            expected="a file that ends in .svg, in a folder that is there",
            remedy="name one, or convert the picture by a tool for images",
        )


def verdict_plot(
    episode: Episode,
    check: str,
    verdict: str = "",
    violated_at: float | None = None,
    signals: Sequence[str] = (),
) -> Svg:
    """Draw what a check reads over time, its margin first.

    Args:
        episode: The episode.
        check: A formula; of anything else there is no margin.
        verdict: What it came to, in words.
        violated_at: Simulated seconds, if it is violated.
        signals: Names of signals to draw; by default those of the formula.
    """
    panels = []
    margin, formula = margin_over_time(check, episode), formula_of(check)
    if margin is not None:
        panels.append(Panel(f"margin of {margin[0]}", {"margin": margin[1]}, bound=0.0))
    known = columns_of(formula, episode.time, episode.signals, episode.decisions) if formula else {}
    for signal in list(signals or known)[:_MOST_SIGNALS]:
        columns = {signal: known[signal] if signal in known else episode.signals[signal]}
        if f"percept.{signal}" in episode.signals:
            columns["percept"] = episode.signals[f"percept.{signal}"]
        panels.append(Panel(signal, columns))
    mark = None if violated_at is None else (violated_at, f"{verdict} at {violated_at:.2f} s")
    names = ", ".join(panel.name for panel in panels)
    return signal_plot(
        f"{episode.id} {verdict}", f"Over time: {names}. {mark[1] if mark else ''}",
        episode.time, panels, mark,
    )  # fmt: skip
