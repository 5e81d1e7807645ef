"""Measurements of vehicles in MDF 4, by ``asammdf``: each group of channels is a topic."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.logs.reading import RECEIPT, Columns, Topic, damaged, missing_library


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


def read(path: Path, wanted: Mapping[str, Collection[str]]) -> dict[str, Columns]:
    """Read channels by group."""
    columns = {}
    with _measurement(path) as measurement:
        for topic, fields in wanted.items():
            names = {
                channel.name: place
                for place, channel in enumerate(measurement.groups[int(topic)].channels)
            }
            signals = {
                name: measurement.get(group=int(topic), index=names[name]) for name in fields
            }
            stamps = next(iter(signals.values())).timestamps
            values = {name: signal.samples.astype(np.float64) for name, signal in signals.items()}
            columns[topic] = Columns({RECEIPT: stamps}, values)
    return columns


@contextmanager
def _measurement(path: Path) -> Iterator[Any]:
    try:
        from asammdf import MDF
    except ImportError:
        raise missing_library(path, "asammdf") from None
    try:
        with MDF(path) as measurement:
            yield measurement
    except ConfigurationError:
        raise
    except Exception as error:  # of the library, of many kinds
        raise damaged(path, f"{type(error).__name__}: {error}") from None
