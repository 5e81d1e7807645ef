"""rtamt's own evaluation of a formula, the reference that ours is held against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl.language.checks import check_time_step, in_samples
from pytest_dura.requirements.stl.language.formula import Formula, unknown_signal
from pytest_dura.requirements.stl.language.grammar import rtamt_modules
from pytest_dura.requirements.stl.language.nodes import (
    Boolean,
    Comparison,
    Node,
    Not,
    Step,
    Temporal,
    Window,
)
from pytest_dura.requirements.stl.language.rendering import Renderer


def rtamt_robustness(
    formula: Formula, columns: Mapping[str, ArrayLike], time_step: float
) -> NDArray[np.float64]:
    """Robustness at each sample, by rtamt's offline evaluation in discrete time.

    ``iff`` is written out as two implications and ``xor`` as its negation: rtamt's own robustness
    of them, ``-|a - b|`` and ``|a - b|``, is never positive and never negative.

    Args:
        formula: The formula.
        columns: Samples of each signal by name, shape ``(n,)`` with ``n`` of at least 2.
        time_step: Seconds from one sample to the next.

    Returns:
        Robustness, shape ``(n,)``; infinite where a window has no sample.

    Raises:
        ConfigurationError: For a signal without a column, columns of several lengths or of fewer
            than two samples, samples that are not finite, a window between two samples, or an
            expression that rtamt cannot evaluate, such as a division by zero.
    """
    check_time_step(formula, time_step)
    samples = _samples(formula, columns)
    names = {name: f"signal_{number}" for number, name in enumerate(formula.signals)}

    def ticks(window: Window) -> str:
        first, last = in_samples(window, time_step)
        return f"[{first}:{last}]"

    # One sample per second, so that windows are whole numbers: a period of 0.1 s is no exact one.
    specification = rtamt_modules().rtamt.StlDiscreteTimeOfflineSpecification()
    specification.set_sampling_period(1, "s", 0.1)
    for name in names.values():
        specification.declare_var(name, "float")
    specification.spec = Renderer(names.__getitem__, ticks, "!==").text(_expanded(formula.root))
    specification.parse()
    size = len(next(iter(samples.values())))
    # Lists of our own: rtamt appends to its inputs.
    data = {names[name]: column.tolist() for name, column in samples.items()}
    try:
        found = specification.evaluate({"time": list(range(size)), **data})
    except (ArithmeticError, ValueError) as error:
        raise ConfigurationError(
            f"rtamt cannot evaluate `{formula}`: {error}",
            expected="expressions with a value at every sample",
            remedy="guard the division, root or power",
        ) from error
    return np.array([margin for _, margin in found], dtype=np.float64)


def _samples(formula: Formula, columns: Mapping[str, ArrayLike]) -> dict[str, NDArray[np.float64]]:
    samples: dict[str, NDArray[np.float64]] = {}
    for name in formula.signals:
        if name not in columns:
            raise unknown_signal(name, columns, str(formula), None)
        samples[name] = np.asarray(columns[name], dtype=np.float64)
    shapes = {column.shape for column in samples.values()}
    size = next(iter(shapes))
    if len(shapes) > 1 or len(size) != 1 or size[0] < 2:
        raise ConfigurationError(
            "rtamt cannot evaluate these columns",
            found=", ".join(f"{name}: shape {one.shape}" for name, one in samples.items()),
            expected="columns of one length, of at least 2 samples",
            remedy="evaluate shorter traces with pytest-dura's own evaluation",
        )
    for name, column in samples.items():
        bad = np.flatnonzero(~np.isfinite(column))
        if len(bad):
            raise ConfigurationError(
                f"the signal {name!r} is not finite at sample {bad[0]}",
                found=float(column[bad[0]]),
                expected="finite samples",
                remedy="let the simulator saturate the signal at a declared cap",
            )
    return samples


def _expanded(node: Node) -> Node:
    """The formula without ``iff`` and ``xor``."""
    if isinstance(node, Comparison):
        return node
    if isinstance(node, (Not, Temporal, Step)):
        return replace(node, operand=_expanded(node.operand))
    node = replace(node, left=_expanded(node.left), right=_expanded(node.right))
    if node.operator not in ("iff", "xor"):
        return node
    there = Boolean("implies", node.left, node.right)
    both = Boolean("and", there, Boolean("implies", node.right, node.left))
    return both if node.operator == "iff" else Not(both)
