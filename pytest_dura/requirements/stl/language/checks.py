"""Checks of a formula before it judges anything: its windows, and what of a trace it reads."""

from __future__ import annotations

import math
import re

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.stl.language.formula import Formula, marked, node_text
from pytest_dura.requirements.stl.language.nodes import (
    Boolean,
    Comparison,
    Node,
    Not,
    Signal,
    Temporal,
    TemporalPair,
    Window,
    walk,
)

RANGING = ("always", "eventually", "until")
"""Operators that range over the samples from the one at hand on."""

TIME_TOLERANCE = 1e-6
"""Seconds by which a bound may miss a sample: time steps such as 1/15 s have no exact text."""


def check_time_step(formula: Formula, time_step: float) -> None:
    """Refuse a window with a bound between two samples of a trace sampled every ``time_step``.

    Raises:
        ConfigurationError: For such a window, or a time step that is no positive number.
    """
    for node in walk(formula.root):
        if isinstance(node, (Temporal, TemporalPair)) and node.window is not None:
            for bound in (node.window.start, node.window.end):
                if not _on_a_sample(bound, time_step):
                    raise _between_samples(formula, node.window, bound, time_step)


def in_samples(window: Window, time_step: float) -> tuple[int, int]:
    """The bounds of a window that :func:`check_time_step` let pass, as numbers of samples."""
    return round(window.start / time_step), round(window.end / time_step)


def past_only_or_refuse(formula: Formula, what: str) -> None:
    """Refuse a formula that looks ahead.

    Args:
        formula: The formula.
        what: Who cannot see ahead, such as ``the monitor 'gap'``.

    Raises:
        ConfigurationError: For an operator that looks ahead, with a mark under the first.
    """
    if formula.past_only:
        return
    name, position = formula.future_operators[0]
    # The text's own word, where there is one: `G` and `unless` have other names in the nodes.
    word = re.compile(r"[A-Za-z_]\w*", re.ASCII).match(formula.text, position)
    found = word.group() if word else name
    raise ConfigurationError(
        f"{what} cannot know the future: `{found}` looks ahead at column {position + 1}"
        f"{marked(formula.text, position)}",
        found=found,
        expected="operators that look back: once, historically, since, prev, rise, fall. Rewriting "
        "a formula into the past (pastification) is not done: it was measured to flip verdicts",
        remedy="say it with once, historically or since, as `historically[0:2] (gap > 1)`, or "
        "give the formula to a requirement, which judges the finished episode",
    )


def ranging_or_refuse(formula: Formula) -> None:
    """Refuse a formula of which a part reads the trace's beginning alone.

    An episode is judged at its first sample. What stands under no ``always``, ``eventually`` or
    ``until`` is never asked about the rest of it, and an operator that looks back from the first
    sample sees that sample only.

    Raises:
        ConfigurationError: Naming the first such part, with a mark under it.
    """
    bare = _bare(formula.root)
    if not bare:
        return
    text = node_text(bare[0])
    position = min(node.position for node in walk(bare[0]) if isinstance(node, Signal))
    raise ConfigurationError(
        f"`{text}` is judged at the beginning of the episode alone{marked(formula.text, position)}",
        found=text,
        expected="each part of the formula under always, eventually or until",
        remedy=f"write `always ({text})`, or `eventually ({text})`, as it is meant",
    )


def _bare(node: Node) -> list[Node]:
    """The greatest parts that stand under no operator of ``RANGING`` and have none below."""
    if isinstance(node, Comparison):
        return [node]
    if isinstance(node, (Temporal, TemporalPair)) and node.operator in RANGING:
        return []
    if isinstance(node, (Boolean, TemporalPair)):
        left, right = _bare(node.left), _bare(node.right)
        return [node] if (left, right) == ([node.left], [node.right]) else [*left, *right]
    below = _bare(node.operand)
    return [node] if below == [node.operand] or (below and not isinstance(node, Not)) else below


def _on_a_sample(bound: float, time_step: float) -> bool:
    if not (math.isfinite(time_step) and time_step > 0.0):
        raise ConfigurationError(
            "the time step is no positive number",
            found=time_step,
            expected="seconds from one sample to the next, such as 0.1",
        )
    tolerance = min(TIME_TOLERANCE, time_step / 1000.0)
    ratio = bound / time_step
    return math.isfinite(ratio) and abs(round(ratio) * time_step - bound) <= tolerance


def _between_samples(
    formula: Formula, window: Window, bound: float, time_step: float
) -> ConfigurationError:
    below = math.floor(bound / time_step) if math.isfinite(bound / time_step) else 0
    near = " or ".join(f"{tick * time_step:.12g}" for tick in (below, below + 1))
    return ConfigurationError(
        f"a bound of the window at column {window.position + 1} falls between two samples"
        f"{marked(formula.text, window.position)}",
        found=f"{bound:g} s with a sample every {time_step:g} s",
        expected="bounds that are multiples of the time step",
        remedy=f"write {near} for {bound:g}",
    )
