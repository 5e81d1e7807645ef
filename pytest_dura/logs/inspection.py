"""What a log holds: topics, fields, rates, gaps and clocks; and a first mapping of it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import yaml

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.logs.clock import clock_of
from pytest_dura.logs.mapping import TIME_NAMES
from pytest_dura.logs.reading import Topic, format_of, read_whole
from pytest_dura.logs.resampling import MISSING, usual_step

_MOST_SHOWN = 40


def inspected(file: str) -> Iterator[str]:
    """Yield lines on a log.

    Raises:
        ConfigurationError: If it cannot be read.
    """
    path = Path(file)
    form = format_of(path)
    topics = form.topics(path)
    for topic in topics:
        yield f"{topic.name or 'table'}: {topic.kind}"
        columns = read_whole(form, path, {topic.name: []})[topic.name] if topic.fields else None
        if columns is not None:
            for kind, stamps in columns.stamps.items():
                yield f"  {kind + ':':<9} {_clock_text(stamps, topic, file, columns.unit)}"
        shown = list(topic.fields.items())[:_MOST_SHOWN]
        for name, unit in shown:
            yield f"  {name}" + (f" [{unit}]" if unit else "")
        if len(topic.fields) > len(shown):
            yield f"  and {len(topic.fields) - len(shown)} more"
        for name, kind in list(topic.others.items())[:_MOST_SHOWN]:
            yield f"  {name}: {kind}, not a number"


def _clock_text(stamps: object, topic: Topic, file: str, unit: str) -> str:
    try:
        clock = clock_of(np.asarray(stamps), unit or "auto", topic.name, file)
    except ConfigurationError as error:
        return f"{error.problem}, {error.found}"
    time = np.sort(clock.seconds)
    usual = usual_step(time)
    if usual is None:
        return "a single sample"
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > MISSING * usual)
    parts = [
        f"{len(time):,} samples over {time[-1] - time[0]:.6g} s",
        f"one every {usual:.4g} s ({1 / usual:.4g} Hz), {steps.min():.4g} to {steps.max():.4g} s",
    ]
    if clock.is_date:
        date = datetime.fromtimestamp(clock.origin * 1e-9, timezone.utc)
        parts.append(f"from {date:%Y-%m-%d %H:%M:%S} UTC on")
    if len(gaps):
        longest = int(np.argmax(steps))
        parts.append(
            f"gaps: {len(gaps)}, the longest from {time[longest]:.6g} to {time[longest + 1]:.6g} s"
        )
    return "; ".join([*parts, *clock.notes])


def first_mapping(file: str) -> str:
    """Write a mapping of each field to a signal of its name, to be cut down.

    Raises:
        ConfigurationError: If the log cannot be read.
    """
    signals = {}
    path = Path(file)
    for topic in format_of(path).topics(path):
        for name, unit in topic.fields.items():
            if name.lower() in TIME_NAMES or re.search(r"(^|\.)(stamp|header)(\.|$)", name):
                continue
            signal = re.sub(r"\W+", "_", f"{topic.name}_{name}").strip("_").lower()
            signal = f"s_{signal}" if signal[:1].isdigit() else signal
            entry = {"topic": topic.name, "field": name, "unit": unit or "1", "method": "hold"}
            signals[signal] = {key: value for key, value in entry.items() if value}
    head = f"# A first mapping of {path.name}: keep what requirements read, and say its unit.\n"
    return head + yaml.safe_dump({"signals": signals}, sort_keys=False, allow_unicode=True)
