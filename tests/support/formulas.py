"""Hypothesis strategies for formulas, and for traces to judge by them."""

from __future__ import annotations

from collections.abc import Sequence

from hypothesis import strategies as st

from pytest_dura import ConfigurationError
from pytest_dura.requirements import (
    Arithmetic,
    Boolean,
    Comparison,
    Constant,
    Expression,
    Formula,
    Node,
    Not,
    Signal,
    Step,
    Temporal,
    TemporalPair,
    Window,
    node_text,
    read_formula,
)
from pytest_dura.requirements.stl.formula import Function

# Few distinct values, so that samples often lie on the bound.
VALUES = st.integers(-3, 3).map(float)
FINITE = st.floats(allow_nan=False, allow_infinity=False)

_PAST = ("historically", "once")
_FUTURE = ("always", "eventually")
_PAST_STEPS = ("prev", "strong_prev", "rise", "fall")
_FUTURE_STEPS = ("next", "strong_next")


def formulas(
    signals: Sequence[str],
    *,
    time_step: float = 1.0,
    max_leaves: int = 5,
    past: bool = True,
    future: bool = True,
    max_window: int = 6,
    numbers: st.SearchStrategy[float] = VALUES,
) -> st.SearchStrategy[Formula]:
    """Formulas over the signals; windows are up to ``max_window`` samples of ``time_step``."""
    found = nodes(
        signals,
        time_step=time_step,
        max_leaves=max_leaves,
        past=past,
        future=future,
        max_window=max_window,
        numbers=numbers,
    )
    return found.map(lambda root: Formula(root, node_text(root)))


def nodes(
    signals: Sequence[str],
    *,
    time_step: float = 1.0,
    max_leaves: int = 5,
    past: bool = True,
    future: bool = True,
    max_window: int = 6,
    numbers: st.SearchStrategy[float] = VALUES,
) -> st.SearchStrategy[Node]:
    """The roots of :func:`formulas`."""
    window = st.none() | windows(time_step, max_window)
    unary = (_PAST if past else ()) + (_FUTURE if future else ())
    pairs = (("since",) if past else ()) + (("until",) if future else ())
    steps = (_PAST_STEPS if past else ()) + (_FUTURE_STEPS if future else ())

    def extend(inner: st.SearchStrategy[Node]) -> st.SearchStrategy[Node]:
        options: list[st.SearchStrategy[Node]] = [
            st.builds(Not, inner),
            st.builds(
                Boolean, st.sampled_from(["and", "or", "implies", "iff", "xor"]), inner, inner
            ),
        ]
        if unary:
            options += [
                st.builds(Temporal, st.sampled_from(unary), inner, window),
                st.builds(TemporalPair, st.sampled_from(pairs), inner, inner, window),
                st.builds(Step, st.sampled_from(steps), inner),
            ]
        return st.one_of(options)

    return st.recursive(comparisons(signals, numbers), extend, max_leaves=max_leaves)


def can_fail(text: str) -> bool:
    """Whether a formula is taken as a check: one that holds whatever the signals are is not."""
    try:
        return bool(read_formula(text))
    except ConfigurationError:
        return False


def windows(time_step: float, max_window: int) -> st.SearchStrategy[Window]:
    """Windows on whole steps; the bounds are rounded as a text of twelve digits would be."""
    ticks = st.lists(st.integers(0, max_window), min_size=2, max_size=2).map(sorted)
    return ticks.map(
        lambda two: Window(round(two[0] * time_step, 12), round(two[1] * time_step, 12))
    )


def comparisons(
    signals: Sequence[str], numbers: st.SearchStrategy[float] = VALUES
) -> st.SearchStrategy[Node]:
    """Comparisons of an expression that reads a signal with any other."""
    operators = st.sampled_from([">", ">=", "<", "<=", "==", "!="])
    reading = expressions(signals, numbers)
    constant = st.builds(Constant, numbers)
    return st.one_of(
        st.builds(Comparison, operators, reading, constant),
        st.builds(Comparison, operators, constant, reading),
        st.builds(Comparison, operators, reading, reading),
    )


def expressions(
    signals: Sequence[str], numbers: st.SearchStrategy[float] = VALUES
) -> st.SearchStrategy[Expression]:
    """Small expressions that read a signal and have a value everywhere, without overflow.

    Division is by a constant that is not zero and roots are of absolute values.
    """
    signal: st.SearchStrategy[Expression] = st.builds(Signal, st.sampled_from(list(signals)))
    constant = st.builds(Constant, numbers)
    divisor = st.sampled_from([Constant(2.0), Constant(-4.0)])
    root = st.builds(lambda x: Function("sqrt", Function("abs", x)), signal)
    square = st.builds(lambda x: Arithmetic("pow", x, Constant(2.0)), signal)
    simple = signal | signal | st.builds(Function, st.just("abs"), signal) | root | square
    joined = st.sampled_from(["+", "-", "*"])
    return st.one_of(
        signal,
        simple,
        st.builds(Arithmetic, joined, simple, simple | constant),
        st.builds(Arithmetic, joined, constant, simple),
        st.builds(Arithmetic, st.just("/"), simple, divisor),
    )


@st.composite
def traces(
    draw: st.DrawFn,
    signals: Sequence[str],
    min_size: int = 2,
    max_size: int = 12,
    values: st.SearchStrategy[float] = VALUES,
) -> dict[str, list[float]]:
    """Columns of one length by name."""
    size = draw(st.integers(min_size, max_size))
    column = st.lists(values, min_size=size, max_size=size)
    return {name: draw(column) for name in signals}
