"""Measurements of vehicles in MDF 4, by ``asammdf``: each group of channels is a topic."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.logs.reading import RECEIPT, ROWS, Columns, Topic, damaged, missing_library

_HEAD = 64
"""Bytes of the block with which each measurement begins."""


def fits(path: Path) -> bool:
    """Whether a file is MDF 4."""
    return path.suffix.lower() in (".mf4", ".mdf") and path.is_file()


def topics(path: Path) -> list[Topic]:
    """Describe each group of channels, which are called 0, 1 and so on."""
    seen = []
    with _measurement(path) as measurement:
        for number, group in enumerate(measurement.groups):
            fields, others = {}, {}
            for place, channel in enumerate(group.channels):
                if place == measurement.masters_db.get(number):
                    continue
                signal = measurement.get(group=number, index=place, record_count=1)
                if signal.samples.dtype.kind in "biuf" and signal.samples.ndim == 1:
                    fields[channel.name] = signal.unit or ""
                else:
                    others[channel.name] = str(signal.samples.dtype)
            kind = group.channel_group.acq_name or "group of channels"
            seen.append(Topic(str(number), kind, fields, others))
    return seen


def blocks(path: Path, wanted: Mapping[str, Collection[str]]) -> Iterator[dict[str, Columns]]:
    """Read channels by group, some records at a time: next of the group that is behind."""
    with _measurement(path) as measurement:
        counts = {topic: measurement.groups[int(topic)].channel_group.cycles_nr for topic in wanted}
        read = dict.fromkeys(wanted, 0)
        reached = dict.fromkeys(wanted, -np.inf)
        while waiting := [topic for topic in wanted if read[topic] < counts[topic]]:
            topic = min(waiting, key=reached.__getitem__)
            columns = _records(measurement, int(topic), wanted[topic], read[topic])
            read[topic] += ROWS
            reached[topic] = float(columns.stamps[RECEIPT][-1])
            yield {topic: columns}


def _records(measurement: Any, group: int, fields: Collection[str], first: int) -> Columns:
    """Read channels of a group from a record on."""
    how = {"record_offset": first, "record_count": ROWS}
    places = {each.name: place for place, each in enumerate(measurement.groups[group].channels)}
    signals = {name: measurement.get(group=group, index=places[name], **how) for name in fields}
    stamps = measurement.get_master(group, **how)
    values = {name: signal.samples.astype(np.float64) for name, signal in signals.items()}
    return Columns({RECEIPT: stamps}, values, "s")


@contextmanager
def _measurement(path: Path) -> Iterator[Any]:
    try:
        from asammdf import MDF
    except ImportError:
        raise missing_library(path, "asammdf") from None
    with path.open("rb") as stream:
        if not stream.read(_HEAD).startswith(b"MDF     4"):
            raise damaged(path, "it does not begin as MDF 4 does", "convert it by `asammdf`")
    try:
        with MDF(path) as measurement:
            yield measurement
    except ConfigurationError:
        raise
    except Exception as error:  # of the library, of many kinds
        raise damaged(path, f"{type(error).__name__}: {error}") from None
