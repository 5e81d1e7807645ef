"""Shortfalls: by how much an episode misses a check, in units, and why a verdict is not supported.

A margin alone says little: ``-0.0627`` of ``always (gap >= 0.5)`` is a gap of 0.437 m where at
least 0.5 m is required. Where the formula does not give the value, or its signals have no common
unit, the text says less, and never more than the margin shows.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from functools import lru_cache
from typing import NamedTuple

from pytest_dura.core.errors import DuraError
from pytest_dura.core.loop_signals import LOOP_UNITS, TRUTH
from pytest_dura.core.percepts import NOTHING
from pytest_dura.requirements.campaign_verdicts import CampaignVerdict
from pytest_dura.requirements.checks import is_function_path
from pytest_dura.requirements.model import FAULTS, Paired, Requirement
from pytest_dura.requirements.stl.formula import (
    Boolean,
    Comparison,
    Constant,
    Node,
    Not,
    Signal,
    Temporal,
    Window,
    exact,
    node_text,
    walk,
)
from pytest_dura.requirements.stl.parser import parse

_AT_LEAST = {">=": "at least", ">": "more than"}
_AT_MOST = {"<=": "at most", "<": "less than"}
_MOST_DIGITS = 12
_CLAUSES = ("raised ", "overran ", "returned ", "ended ", "answered ")
"""What begins a clause of which the component is the subject."""


def shortfall(
    check: str,
    margin: float | None,
    time: float | None = None,
    units: Mapping[str, str] = NOTHING,
) -> str:
    """Say by how much a check is missed: ``gap is 0.44 m where at least 0.5 m is required``.

    Args:
        check: A formula, or the import path of a function.
        margin: Of the episode, negative or 0; ``None`` where there is none.
        time: Seconds at which it was violated first; ``None`` where that is not known.
        units: Of the signals, by name.

    Returns:
        A clause with the time; empty where it is unknown.
    """
    root = _read(check)
    eventual, window, inner = (False, None, None) if root is None else _unwrapped(root)
    if eventual:
        # It is violated once its window has passed.
        end = "" if time is None else f" until the end at t = {time:.2f} s"
        when = f" within {exact(window.end)} s" if window is not None else end
    else:
        when = "" if time is None else f"first at t = {time:.2f} s"
    amount = _amount_of(root, inner, margin, {**LOOP_UNITS, **units}, eventual=eventual)
    if eventual:
        return amount and f"{amount}{when}"
    return ", ".join(filter(None, [amount, when]))


def _amount_of(
    root: Node | None,
    inner: Node | None,
    margin: float | None,
    units: Mapping[str, str],
    *,
    eventual: bool,
) -> str:
    if isinstance(inner, Comparison):
        return _of_comparison(inner, margin, units, eventual=eventual)
    if margin is None or margin >= 0 or not math.isfinite(margin):
        return ""
    if isinstance(inner, Boolean) and inner.operator == "implies" and not eventual:
        return _of_condition(inner, margin, units)
    if root is None:
        return f"the margin is {margin:.3g}"
    unit = _common_unit(root, units)
    return "" if unit is None else f"it is missed by {_amount(-margin, unit)}"


def pair_shortfall(paired: Paired, margin: float | None, unit: str = "") -> str:
    """Say by how much a pair misses a bound on a measure's growth.

    Such as ``clearance time grows by 11.6 s with the faults where 10 s is allowed``; empty where
    it is unknown.

    Args:
        paired: With a measure.
        margin: Of the pair.
        unit: Of the measure.
    """
    allowed = paired.change_at_most
    if margin is None or allowed is None or not math.isfinite(margin):
        return ""
    grown, bound = _apart(allowed - margin, allowed)
    measure = paired.measure.rpartition(":")[2].replace("_", " ")
    added = "the faults" if paired.without == FAULTS else paired.without
    beside = f"from that of {paired.reference}" if paired.reference else f"with {added}"
    grows = f"{measure} grows by {_with(grown, unit)} {beside}"
    return f"{grows} where {_with(bound, unit)} is allowed"


def own_failure_clause(component: str, detail: str) -> str:
    """What a component did: ``Planner raised ValueError: no plan (planner.py:12 in propose)``."""
    return f"{component} {'' if detail.startswith(_CLAUSES) else 'failed: '}{detail}"


def explain_verdict(
    verdict: CampaignVerdict,
    requirement: Requirement,
    component_failures: str,
    units: Mapping[str, str] = NOTHING,
    *,
    failed: Collection[str] = (),
) -> list[str]:
    """Say in a few lines why a verdict is not "supported": in which run, by how much and when.

    The first line is that of a missing episode, if there is one, and begins with
    ``infrastructure:`` or with :data:`TEST_FAILED`; the next one is the verdict. What the component
    raised in the worst run stands before what followed from it.

    Args:
        verdict: On the requirement.
        requirement: As it was judged.
        component_failures: The first failure of the component itself; empty without any.
        units: Of signals by name, and of measures by their import path.
        failed: Ids of the episodes in which the component itself failed.
    """
    what = f"{verdict.verdict}: {verdict.requirement} on {verdict.case} ({verdict.component})"
    lines, entries = [f"{what}: {verdict.reason}"], []
    if verdict.counterexamples:
        worst, paired = verdict.counterexamples[0], requirement.paired
        amount = shortfall(requirement.check, worst.margin, worst.time, units)
        if paired is not None and paired.measure:
            amount = pair_shortfall(paired, worst.margin, units.get(paired.measure, ""))
        without = "" if worst.valid else "without effect of the fault"
        text = ", ".join(filter(None, [amount, without]))
        entries.append(("worst", ": ".join(filter(None, [worst.episode, text]))))
    uncounted = verdict.first_uncounted
    if uncounted is not None and verdict.verdict == "undecided":
        if uncounted.verdict == "missing":
            lines.insert(0, f"{uncounted.detail} (in {uncounted.episode})")
        else:
            entries.append((uncounted.verdict, f"{uncounted.episode}: {uncounted.detail}"))
    if requirement.paired is not None:
        entries.append(("pairs", requirement.paired.sides))
    check = f" [{requirement.check}]" if requirement.check not in ("", verdict.requirement) else ""
    named = [each.episode for each in verdict.counterexamples[:1]]
    first = all(each in failed for each in named)
    entries.insert(0 if first else len(entries), ("component", component_failures))
    entries.append(("required", f"{requirement.text}{check}"))
    lines += [f"{label + ':':<9} {text}" for label, text in entries if text]
    # Lines of a component's own message must not look like lines of this report.
    return [line.replace("\n", "\n    ") for line in lines]


@lru_cache(maxsize=256)
def _read(check: str) -> Node | None:
    """The root of a formula; ``None`` of anything else."""
    if not check or is_function_path(check):
        return None
    try:
        return parse(check, None).root
    except DuraError:
        return None  # a name of what a test decides, such as "assertions"


def _unwrapped(root: Node) -> tuple[bool, Window | None, Node]:
    """Whether something is to happen once rather than always, in which window, and what."""
    node, eventual, window = root, False, None
    while isinstance(node, Temporal) and node.operator in ("always", "eventually"):
        if node is not root and (node.operator == "eventually") != eventual:
            return eventual, window, root  # `always eventually` has no single value
        eventual = node.operator == "eventually"
        window = window or node.window
        node = node.operand
    return eventual, window, node


def _of_comparison(
    node: Comparison, margin: float | None, units: Mapping[str, str], *, eventual: bool
) -> str:
    unit = _common_unit(node, units)
    if unit == TRUTH:
        return f"`{_truth_text(node)}` does not hold"
    if margin is None or margin > 0 or not math.isfinite(margin):
        return f"`{node_text(node)}` is not reached" if eventual else ""
    limit = _Limit.of(node)
    if limit is not None:
        shown, bound = _apart(limit.value + (margin if limit.least else -margin), limit.value)
        best = (" at most" if limit.least else " at least") if eventual else ""
        words = {**_AT_LEAST, **_AT_MOST}[limit.operator]
        return (
            f"{limit.signal} is {_with(shown, unit)}{best} where {words} {_with(bound, unit)} is "
            f"{'required' if limit.least else 'allowed'}"
        )
    return "" if unit is None or not margin else f"it is missed by {_amount(-margin, unit)}"


def _of_condition(node: Boolean, margin: float, units: Mapping[str, str]) -> str:
    """Say both sides of ``gap < 5 implies speed <= 6``: the margin is the greater of both.

    So the condition holds by at least as much, and what it implies is missed by at least as much.
    """
    condition, bound = _Limit.of(node.left), _Limit.of(node.right)
    if condition is None or bound is None:
        return ""
    if units.get(bound.signal) == TRUTH:
        missed = f"`{_truth_text(node.right)}` does not hold"
    else:
        unit, least = units.get(bound.signal), bound.least
        words = {**_AT_LEAST, **_AT_MOST}[bound.operator]
        shown, asked = _apart(bound.value + (margin if least else -margin), bound.value)
        beyond, what = ("less", "required") if least else ("more", "allowed")
        missed = (
            f"{bound.signal} is {_with(shown, unit)} or {beyond} where {words} "
            f"{_with(asked, unit)} is {what}"
        )
    if units.get(condition.signal) == TRUTH:
        return f"{missed}, while `{_truth_text(node.left)}` holds"
    held = condition.value - (margin if condition.least else -margin)
    amount = _amount(held, units.get(condition.signal))
    return (
        f"{missed}, while {condition.signal} is {amount} or {'more' if condition.least else 'less'}"
    )


class _Limit(NamedTuple):
    """A comparison of a signal with a number, on one side of it."""

    signal: str
    operator: str
    value: float

    @classmethod
    def of(cls, node: Node) -> _Limit | None:
        """Take it from a node; ``None`` of any other one."""
        if not isinstance(node, Comparison) or node.operator not in (*_AT_LEAST, *_AT_MOST):
            return None
        left, right = node.left, node.right
        if not isinstance(left, Signal) or not isinstance(right, Constant):
            return None
        return cls(left.name, node.operator, right.value)

    @property
    def least(self) -> bool:
        """Whether the signal is to be above the number."""
        return self.operator in _AT_LEAST


def _truth_text(node: Node) -> str:
    """A signal that is 0 or 1 by its name alone where a comparison asks for 1."""
    limit = _Limit.of(node)
    asks = limit is not None and limit.least and 0 < limit.value <= 1
    return limit.signal if limit is not None and asks else node_text(node)


def _common_unit(node: Node, units: Mapping[str, str]) -> str | None:
    """The unit that all signals share, and so the margin has; ``None`` where they do not."""
    comparisons = [each for each in walk(node) if isinstance(each, Comparison)]
    if any(isinstance(each, Not) for each in walk(node)) or not all(
        isinstance(side, (Signal, Constant))
        or (getattr(side, "operator", "") in ("+", "-"))
        or getattr(side, "name", "") == "abs"
        for each in comparisons
        for side in (each.left, each.right)
    ):
        return None
    shared = {units.get(each.name) or None for each in walk(node) if isinstance(each, Signal)}
    return shared.pop() if len(shared) == 1 else None


def _apart(value: float, bound: float) -> tuple[str, str]:
    """Both numbers, the first with as many digits as keep it from reading like the second."""
    text = f"{bound:.{_MOST_DIGITS}g}"
    if value == bound:
        return text, text
    for digits in range(3, _MOST_DIGITS + 1):
        shown = f"{value:.{digits}g}"
        if float(shown) != bound:
            break
    return shown, text


def _amount(value: float, unit: str | None) -> str:
    return _with(f"{value:.3g}", unit)


def _with(number: str, unit: str | None) -> str:
    return number if unit in (None, "", "1") else f"{number} {unit}"
