"""Checks of a draft: our own parser, the domain's signals and units, and recorded runs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.loop_signals import TRUTH
from pytest_dura.domains import Domain
from pytest_dura.library.requirements import check_formula
from pytest_dura.library.scenario import Scenario
from pytest_dura.llm.drafts.asking import Draft
from pytest_dura.requirements.checks import is_function_path, read_formula
from pytest_dura.requirements.margins import Column, columns_of, margins_over_time, moment_of
from pytest_dura.requirements.stl.evaluation import Ending, Evaluation, evaluate
from pytest_dura.requirements.stl.formula import (
    Comparison,
    Constant,
    Expression,
    Formula,
    Function,
    Signal,
    walk,
)

ENDINGS: Mapping[str, Ending] = {
    "critical": "stopped",
    "halt": "stopped",
    "goal": "goal",
    "violation": "open",
    "decided": "open",
}
"""How a run ended, by its termination; otherwise at the time limit."""
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


@dataclass(frozen=True)
class RecordedRun:
    """A run that drafts are judged on.

    Args:
        name: Of the episode or the file.
        time: Seconds of each sample, shape ``(n,)``.
        signals: Columns of that shape, by name.
        decisions: What the loop decided.
        ending: How it ended.
        scenario: Of the episode; ``None`` for a trace.
        own: Whether the suite's own component drove it.
    """

    name: str
    time: Column
    signals: Mapping[str, Column]
    decisions: Mapping[str, np.ndarray]
    ending: Ending = "time"
    scenario: Scenario | None = None
    own: bool = True


def recorded_traces(places: Sequence[Path]) -> list[RecordedRun]:
    """Read traces of bundles: files, or all that lie below a folder.

    Raises:
        ConfigurationError: If one cannot be read, or there is none.
    """
    from pytest_dura.evidence.mcap import read_trace

    files = [
        file
        for place in places
        for file in (sorted(place.rglob("*.mcap")) if place.is_dir() else [place])
    ]
    if not files:
        raise ConfigurationError(
            "there is no trace to judge drafts on",
            key="--traces",
            found=", ".join(map(str, places)),
            expected="files *.mcap, or a folder with some",
            remedy="keep traces by --dura-traces=all, or leave --traces out",
        )
    runs = []
    for file in files:
        trace = read_trace(file)
        ending = ENDINGS.get(str(trace.about.get("termination")), "time")
        runs.append(RecordedRun(file.name, trace.time, trace.signals, trace.decisions, ending))
    return runs


def refusal_of_text(draft: Draft, domain: Domain, taken: Mapping[str, str]) -> str:
    """Why a draft cannot be a requirement of this domain, whatever runs show; empty if it can.

    Args:
        draft: The draft.
        domain: Whose signals it may read.
        taken: Where each id is in use already.
    """
    requirement = draft.requirement
    empty = [name for name in ("text", "reason", "check") if not getattr(requirement, name)]
    problem = ""
    if not _ID.fullmatch(requirement.id):
        problem = f"the id {requirement.id!r} is not made of letters, digits and hyphens"
    elif requirement.id in taken:
        problem = f"the id {requirement.id} is in use: {taken[requirement.id]}"
    elif empty:
        problem = f"the {empty[0]} is empty"
    elif is_function_path(requirement.check):
        problem = "the check is the path of a function, and a draft is a formula"
    if problem:
        return problem
    known = domain.units
    try:
        formula = read_formula(requirement.check, tuple(known))
    except ConfigurationError as error:
        return _plain(error)
    return "; ".join(_wrong_units(draft, formula, known))


def _plain(error: ConfigurationError) -> str:
    """What is wrong, and the remedy, on one line."""
    problem = error.problem.partition("\n")[0]  # without the mark below the formula
    return " ".join("; ".join(filter(None, (problem, error.remedy))).split())


def _compared(side: Expression) -> str:
    """Name of a signal that stands alone, or below ``abs``; empty for another expression."""
    if isinstance(side, Function) and side.name == "abs":
        side = side.operand
    return side.name if isinstance(side, Signal) else ""


def _wrong_units(draft: Draft, formula: Formula, units: Mapping[str, str]) -> Iterator[str]:
    """Yield what does not fit between stated bounds, the formula and the declared units."""
    found: set[tuple[str, float]] = set()
    for node in walk(formula.root):
        if not isinstance(node, Comparison):
            continue
        left, right = _compared(node.left), _compared(node.right)
        if left and right and units[left] != units[right]:
            yield f"{left} in {units[left]} is compared with {right} in {units[right]}"
        for name, other in ((left, node.right), (right, node.left)):
            if name and isinstance(other, Constant):
                found.add((name, other.value))
    constants = {node.value for node in walk(formula.root) if isinstance(node, Constant)}
    for bound in draft.bounds:
        if bound.signal not in formula.signals:
            yield f"a bound is stated of {bound.signal!r}, which the check does not read"
        elif (unit := units[bound.signal]) != bound.unit and unit != TRUTH:
            yield f"the bound of {bound.signal} is stated in {bound.unit!r}, and its unit is {unit}"
        elif bound.value not in constants:
            yield f"a bound of {bound.value:g} {bound.unit} is stated, and the check has none"
    stated = {(bound.signal, bound.value) for bound in draft.bounds}
    for name, value in sorted(found - stated):
        if units[name] != TRUTH and value != 0:
            yield f"the check compares {name} with {value:g}, and no bound states its unit"


@dataclass(frozen=True)
class Shown:
    """What recorded runs show of a draft.

    Args:
        refusal: Why it judges nothing there; empty if it does.
        scenarios: Names of the scenarios in which it is decided, and its condition holds, with the
            suite's own component; each with the least margin there, the least first.
        satisfied: Runs that satisfy it, and not only since its condition never held.
        violated: Runs that violate it.
        runs: All runs.
    """

    refusal: str
    scenarios: Mapping[str, float]
    satisfied: int = 0
    violated: int = 0
    runs: int = 0

    @property
    def supported(self) -> list[str]:
        """List the scenarios that the suite's own component satisfies it in, nearest first."""
        return [name for name, margin in self.scenarios.items() if margin > 0]


def shown_on(draft: Draft, runs: Sequence[RecordedRun]) -> Shown:
    """Judge a draft on recorded runs: refused if it is vacuous, constant or decided in none."""
    formula = read_formula(draft.requirement.check)
    margins: dict[str, float] = {}
    found: list[tuple[RecordedRun, Evaluation]] = []
    problems: list[str] = []
    seen: set[float] = set()
    for run in runs:
        try:
            if run.scenario is not None:
                check_formula(run.scenario, draft.requirement.check)
            columns = columns_of(formula, run.time, run.signals, run.decisions)
            evaluation = evaluate(formula, run.time, columns, ending=run.ending)
        except ConfigurationError as error:
            problems.append(f"{run.name}: {_plain(error)}")
            continue
        step = float(np.median(np.diff(run.time))) if len(run.time) > 1 else 0.0
        seen.update(np.unique(margins_over_time(moment_of(formula), columns, step)))
        found.append((run, evaluation))
    decided = [(run, each) for run, each in found if each.status != "undecided"]
    judging = [(run, each) for run, each in decided if not each.vacuous]
    for run, each in judging:
        if run.own and run.scenario is not None:
            name = run.scenario.name
            margins[name] = min(each.margin, margins.get(name, np.inf))
    violated = sum(each.status == "violated" for _, each in judging)
    return Shown(
        _refusal(len(runs), problems, decided, judging, seen),
        dict(sorted(margins.items(), key=lambda item: item[1])),
        len(judging) - violated,
        violated,
        len(runs),
    )


def _refusal(
    runs: int,
    problems: Sequence[str],
    decided: Sequence[tuple[RecordedRun, Evaluation]],
    judging: Sequence[tuple[RecordedRun, Evaluation]],
    seen: set[float],
) -> str:
    if not decided:
        return problems[0] if problems else f"none of {runs} recorded runs decides it"
    if not judging:
        return f"vacuous: its condition holds in none of {runs} recorded runs"
    if len(seen) == 1:
        return f"constant: its robustness is {seen.pop():g} throughout {runs} recorded runs"
    if all(each.status == "violated" for _, each in judging):
        return f"constant: all {len(judging)} runs that decide it violate it, whatever drives"
    return ""
