"""What a program computes on a trace, kept while the trace is judged."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pytest_dura.requirements.stl.columns import Frame
from pytest_dura.requirements.stl.program import Program
from pytest_dura.requirements.stl.windows import Array


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

    def prefix(self, size: int) -> Values:
        """The values on the first ``size`` samples, with what is known of them already."""
        frame = self.frame
        columns = {name: column[..., :size] for name, column in frame.columns.items()}
        shorter = replace(frame, columns=columns, shape=(*frame.shape[:-1], size))
        causal = self._program.is_causal
        known = {
            slot: values[..., :size]
            for slot, values in self._known.items()
            if np.ndim(values) and causal(slot)
        }
        return Values(self._program, shorter, known)
