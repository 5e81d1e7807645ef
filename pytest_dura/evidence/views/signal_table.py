"""The signals of an episode as CSV."""

from __future__ import annotations

import csv
import io
import math

from pytest_dura.evidence.text import one_line
from pytest_dura.evidence.traces.trace import Trace

CELLS = 60_000
"""Greatest number of values, which stay below 2 MB."""


def signals_csv(trace: Trace, cells: int = CELLS) -> str:
    """One row per tick with the time in s and each signal; of a long episode every n-th tick.

    Args:
        trace: The episode.
        cells: Greatest number of values.
    """
    names = sorted(trace.signals)
    every = max(1, math.ceil(len(trace.time) * (len(names) + 1) / cells))
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["time", *map(_header, names)])
    columns = [trace.time[::every], *(trace.signals[name][::every] for name in names)]
    writer.writerows(zip(*(column.tolist() for column in columns), strict=True))
    return stream.getvalue()


def _header(name: str) -> str:
    """A name that no spreadsheet takes for a formula."""
    shown = one_line(name, 200)
    return f"'{shown}" if shown[:1] in ("=", "+", "-", "@") else shown
