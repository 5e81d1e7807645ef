"""What a program computes on a trace, kept while the trace is judged."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from pytest_dura.requirements.stl.offline.columns import Frame
from pytest_dura.requirements.stl.offline.program import Program
from pytest_dura.requirements.stl.offline.windows import Array


class Values:
    """The values of a program on one frame, each computed when asked for.

    The caller ignores floating-point warnings: results that are not finite are refused.
    """

    def __init__(self, program: Program, frame: Frame, known: dict[int, Any] | None = None) -> None:
        self.frame = frame
        self._program = program
        self._known: dict[int, Any] = known or {}

    def __getitem__(self, slot: int) -> Array:
        known = self._known
        if slot not in known:
            frame = self.frame
            for one, (kernel, inputs, options) in self._program.order(slot):
                if one not in known:
                    known[one] = kernel(frame, *[known[i] for i in inputs], *options)
        found: Array = known[slot]
        return found

    def prefixes(self) -> Callable[[int], Values]:
        """Gives the values on the first so many samples, with what is known of them already."""
        program, frame = self._program, self.frame
        known = [
            (slot, values)
            for slot, values in self._known.items()
            if np.ndim(values) and program.is_causal(slot)
        ]

        def prefix(size: int) -> Values:
            columns = {name: column[..., :size] for name, column in frame.columns.items()}
            shape = (*frame.shape[:-1], size)
            shorter = Frame(columns, shape, frame.time_step, frame.times)
            cut = {slot: values[..., :size] for slot, values in known}
            return Values(program, shorter, cut)

        return prefix
