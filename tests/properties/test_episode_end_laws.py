"""Laws of how a trace ended: goal, stop, time limit or prefix, held against a small evaluator.

The evaluator reads the negation normal form of a formula in three values. It shares no code with
the arrays of the package: each rule of the ends stands here once more, in words of its own.
"""

from __future__ import annotations

from collections import Counter

import pytest
import stl_oracle
from formulas import formulas, traces
from hypothesis import given, settings

from pytest_dura.requirements import (
    Boolean,
    Comparison,
    Ending,
    Formula,
    Node,
    Not,
    Step,
    Temporal,
    TemporalPair,
    evaluate,
    parse,
)

STEP = 0.5
NAMES = ("a", "b")
Truth = bool | None
"""``None`` is not known: the trace ended before it."""

any_formula = formulas(NAMES, time_step=STEP)
STATUS = {True: "satisfied", False: "violated", None: "undecided"}


def negation(value: Truth) -> Truth:
    return None if value is None else not value


def every(values: list[Truth]) -> Truth:
    return False if False in values else (None if None in values else True)


def some(values: list[Truth]) -> Truth:
    return negation(every([negation(value) for value in values]))


class Reference:
    """A formula at a sample of a trace, in three values."""

    def __init__(self, trace: dict[str, list[float]], ending: Ending) -> None:
        self.trace, self.ending = trace, ending
        self.size = len(trace["a"])

    def beyond(self, *, eventual: bool, bounded: bool) -> list[Truth]:
        """What an operator sees behind the end, if anything.

        Args:
            eventual: Whether it asks for something that is to happen, in negation normal form.
            bounded: Whether it has a window; without one, it ends with a complete trace.
        """
        if self.ending == "goal" or (self.ending == "time" and not bounded):
            return []
        return [] if self.ending == "stopped" and eventual else [None]

    def of(self, node: Node, at: int, *, negated: bool = False) -> Truth:
        """The formula, or its negation, at a sample."""
        if isinstance(node, Comparison):
            held = self.compared(node, at)
            return not held if negated else held
        if isinstance(node, Not):
            return self.of(node.operand, at, negated=not negated)
        if isinstance(node, Boolean):
            return self.joined(node, at, negated)
        if isinstance(node, Temporal):
            return self.temporal(node, at, negated)
        if isinstance(node, TemporalPair):
            return self.pair(node, at, negated)
        return self.step(node, at, negated)

    def compared(self, node: Comparison, at: int) -> bool:
        left, right = (stl_oracle.value(side, self.trace, at) for side in (node.left, node.right))
        return {
            ">": left > right, ">=": left >= right, "<": left < right, "<=": left <= right,
            "==": left == right, "!=": left != right,
        }[node.operator]  # fmt: skip

    def joined(self, node: Boolean, at: int, negated: bool) -> Truth:
        def left(negative: bool) -> Truth:
            return self.of(node.left, at, negated=negative)

        def right(negative: bool) -> Truth:
            return self.of(node.right, at, negated=negative)

        if node.operator in ("and", "or"):
            join = every if (node.operator == "and") is not negated else some
            return join([left(negated), right(negated)])
        if node.operator == "implies":
            return (
                every([left(False), right(True)]) if negated else some([left(True), right(False)])
            )
        alike = (node.operator == "iff") is not negated
        if alike:
            return every([some([left(True), right(False)]), some([right(True), left(False)])])
        return some([every([left(False), right(True)]), every([right(False), left(True)])])

    def samples(self, node: Temporal | TemporalPair, at: int) -> tuple[range, bool]:
        """The samples of its window within the trace, and whether it leaves the trace ahead."""
        ahead = node.operator in ("always", "eventually", "until")
        if node.window is None:
            return (range(at, self.size), True) if ahead else (range(at + 1), False)
        first, last = round(node.window.start / STEP), round(node.window.end / STEP)
        if ahead:
            return range(min(at + first, self.size), min(at + last + 1, self.size)), (
                at + last >= self.size
            )
        return range(max(at - last, 0), at - first + 1), False

    def temporal(self, node: Temporal, at: int, negated: bool) -> Truth:
        eventual = (node.operator in ("eventually", "once")) is not negated
        samples, leaves = self.samples(node, at)
        values = [self.of(node.operand, sample, negated=negated) for sample in samples]
        if leaves:
            values += self.beyond(eventual=eventual, bounded=node.window is not None)
        return some(values) if eventual else every(values)

    def pair(self, node: TemporalPair, at: int, negated: bool) -> Truth:
        samples, leaves = self.samples(node, at)
        bounded = node.window is not None
        if node.operator == "since":
            join, joined = (every, some) if negated else (some, every)
            return join([
                joined([
                    self.of(node.right, sample, negated=negated),
                    *(
                        self.of(node.left, between, negated=negated)
                        for between in range(sample + 1, at + 1)
                    ),
                ])
                for sample in samples
            ])  # fmt: skip
        # Left holds before the sample at which right does, or throughout what was before the end.
        if not negated:
            ways = [
                every([
                    self.of(node.right, sample),
                    *(self.of(node.left, between) for between in range(at, sample)),
                ])
                for sample in samples
            ]  # fmt: skip
            if leaves:
                open_ = self.beyond(eventual=True, bounded=bounded)
                held = [self.of(node.left, between) for between in range(at, self.size)]
                ways += [every([*held, *open_])] if open_ else []
            return some(ways)
        ways = [
            some([
                self.of(node.right, sample, negated=True),
                *(self.of(node.left, between, negated=True) for between in range(at, sample)),
            ])
            for sample in samples
        ]  # fmt: skip
        if leaves:
            open_ = self.beyond(eventual=False, bounded=bounded)
            failed = [self.of(node.left, between, negated=True) for between in range(at, self.size)]
            ways += [some([*failed, *open_])] if open_ else []
        return every(ways)

    def step(self, node: Step, at: int, negated: bool) -> Truth:
        if node.operator in ("rise", "fall"):
            # It holds at this sample and did not before, or the other way round.
            holds = (node.operator == "rise") is not negated
            parts = [self.of(node.operand, at, negated=not holds)]
            if at > 0:
                parts.append(self.of(node.operand, at - 1, negated=holds))
            return some(parts) if negated else every(parts)
        neighbour = at + (1 if node.operator in ("next", "strong_next") else -1)
        if 0 <= neighbour < self.size:
            return self.of(node.operand, neighbour, negated=negated)
        strong = node.operator.startswith("strong") is not negated
        if neighbour < 0 or self.ending == "goal":
            return not strong
        if self.ending == "stopped" and strong:
            return False
        return None


@pytest.mark.parametrize("ending", ["time", "goal", "stopped", "open"])
def test_each_end_decides_what_its_rule_says(ending: Ending) -> None:
    seen: Counter[str] = Counter()

    @settings(max_examples=300, derandomize=True, deadline=None)
    @given(any_formula, traces(NAMES, min_size=1))
    def law(formula: Formula, trace: dict[str, list[float]]) -> None:
        time = [STEP * index for index in range(len(trace["a"]))]
        found = evaluate(formula, time, trace, ending=ending, time_step=STEP)
        expected = STATUS[Reference(trace, ending).of(formula.root, 0)]
        seen[expected] += 1
        assert found.status == expected

    law()
    words = ("satisfied", "violated") + (("undecided",) if ending in ("stopped", "open") else ())
    assert min(seen[word] for word in words) > 10, seen


@pytest.mark.parametrize(
    "check, ending, status",
    [
        # A crash at 0.5 s: what had to hold later is not known, what had to happen did not.
        ("always[1:1.5] (a < 5)", "stopped", "undecided"),
        ("always (a < 5)", "stopped", "undecided"),
        ("eventually[0:40] (a > 5)", "stopped", "violated"),
        ("eventually (a > 5)", "stopped", "violated"),
        ("(a < 5) until (a > 5)", "stopped", "violated"),
        ("not always[0:40] (a < 5)", "stopped", "violated"),
        ("not eventually[0:40] (a > 5)", "stopped", "undecided"),
        ("always ((a > 0) implies eventually[0:2] (a > 5))", "stopped", "violated"),
        ("eventually[0:40] (a > 0)", "stopped", "satisfied"),
        # The goal: the trace as it stands.
        ("always[0:40] (a < 5)", "goal", "satisfied"),
        ("always (a < 5)", "goal", "satisfied"),
        ("eventually[0:40] (a > 5)", "goal", "violated"),
        # The time limit: a window that leaves the trace is not known.
        ("always[0:40] (a < 5)", "time", "undecided"),
        ("always (a < 5)", "time", "satisfied"),
    ],
)
def test_the_rules_one_by_one(check: str, ending: Ending, status: str) -> None:
    found = evaluate(parse(check), [0.0, 0.5], {"a": [1.0, 1.0]}, ending=ending, time_step=STEP)
    assert found.status == status


def test_a_goal_before_any_window_began_is_a_vacuous_pass() -> None:
    found = evaluate(
        parse("always[1:1.5] (a < 5)"), [0.0, 0.5], {"a": [1.0, 9.0]}, ending="goal", time_step=STEP
    )
    assert (found.status, found.vacuous) == ("satisfied", True)
