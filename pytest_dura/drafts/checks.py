"""Checks of a draft: our own parser, the domain's signals and units, and recorded runs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.text import LEAST_LIMIT, visible
from pytest_dura.domains import Domain
from pytest_dura.drafts.asking import Draft
from pytest_dura.drafts.units import wrong_units
from pytest_dura.library.requirements import check_formula
from pytest_dura.library.scenario import Scenario
from pytest_dura.requirements.checks import is_function_path, read_formula
from pytest_dura.requirements.margins import Column, columns_of, margins_over_time, moment_of
from pytest_dura.requirements.stl.evaluation import Ending, Evaluation, evaluate
from pytest_dura.requirements.stl.formula import Node, Not
from pytest_dura.requirements.stl.validity import holds_always

ENDINGS: Mapping[str, Ending] = {
    "critical": "stopped",
    "halt": "stopped",
    "goal": "goal",
    "violation": "open",
    "decided": "open",
}
"""How a run ended, by its termination; otherwise at the time limit."""
_NOISE = 1e-9
"""Spread of a robustness that only rounding moves."""
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


def refusal_of_text(
    draft: Draft, domain: Domain, taken: Mapping[str, str], stated: Mapping[Node, str] | None = None
) -> str:
    """Why a draft cannot be a requirement of this domain, whatever runs show; empty if it can.

    Args:
        draft: The draft.
        domain: Whose signals it may read.
        taken: Where each id is in use already.
        stated: Ids of the requirements that are there already, by their formulas.
    """
    requirement = draft.requirement
    own = {name: getattr(requirement, name) for name in ("id", "text", "reason", "check")}
    empty = [name for name, text in own.items() if not text]
    hidden = [name for name, text in own.items() if visible(text, len(text) + LEAST_LIMIT) != text]
    other = next((each for each in taken if each.casefold() == requirement.id.casefold()), None)
    problem = ""
    if not _ID.fullmatch(requirement.id):
        problem = f"the id {requirement.id!r} is not made of letters, digits and hyphens"
    elif other is not None:
        problem = f"the id {other} is in use: {taken[other]}"
    elif empty:
        problem = f"the {empty[0]} is empty"
    elif hidden:
        problem = f"the {hidden[0]} has characters that are not visible"
    elif is_function_path(requirement.check):
        problem = "the check is the path of a function, and a draft is a formula"
    if problem:
        return problem
    signals = domain.declared_signals
    try:
        formula = read_formula(requirement.check, tuple(signals))
    except ConfigurationError as error:
        return plain_error(error)
    if stated and formula.root in stated:
        return f"{stated[formula.root]} says the same"
    known = {name: signals[name].range for name in sorted(formula.signals)}
    ranges = tuple((name, *ends) for name, ends in known.items())
    if holds_always(formula.root, ranges):
        return f"it always holds: {_ends(known)}"
    if holds_always(Not(formula.root), ranges):
        return f"it never holds: {_ends(known)}"
    return "; ".join(wrong_units(draft, formula, domain.units))


def _ends(known: Mapping[str, tuple[float, float]]) -> str:
    """Say between which ends signals lie, where they have any."""
    ends = {name: each for name, each in known.items() if np.isfinite(each).any()}
    texts = [f"{name} has {low:g} to {high:g}" for name, (low, high) in ends.items()]
    return ", ".join(texts) or "whatever the signals are"


def plain_error(error: ConfigurationError) -> str:
    """What is wrong, and the remedy, on one line."""
    problem = error.problem.partition("\n")[0]  # without the mark below the formula
    return " ".join("; ".join(filter(None, (problem, error.remedy))).split())


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

    @property
    def text(self) -> str:
        """What the runs make of it, for the person who decides on it."""
        counts = (
            f"satisfied in {self.satisfied} and violated in {self.violated} of {self.runs} runs"
        )
        own = len(self.scenarios) - len(self.supported)
        if not own:
            return counts
        return f"{counts}, by the suite's own component in {own} of {len(self.scenarios)} scenarios"


def shown_on(draft: Draft, runs: Sequence[RecordedRun]) -> Shown:
    """Judge a draft on recorded runs: refused if it is vacuous, constant or decided in none."""
    formula = read_formula(draft.requirement.check)
    margins: dict[str, float] = {}
    found: list[tuple[RecordedRun, Evaluation]] = []
    problems: list[str] = []
    broken = ""
    seen: list[Column] = []
    for run in runs:
        columns = columns_of(formula, run.time, run.signals, run.decisions)
        missing = sorted(set(formula.signals) - set(columns))
        try:
            if run.scenario is not None:
                check_formula(run.scenario, draft.requirement.check)
        except ConfigurationError as error:
            missing, problem = [], plain_error(error)
        else:
            problem = f"it has no {missing[0]}" if missing else ""
        if problem:
            problems.append(f"{run.name}: {problem}")
            continue
        try:
            evaluation = evaluate(formula, run.time, columns, ending=run.ending)
            step = float(np.median(np.diff(run.time))) if len(run.time) > 1 else 0.0
            seen.append(margins_over_time(moment_of(formula), columns, step))
        except ConfigurationError as error:  # the gate of that run would end with it
            broken = broken or f"{run.name}: {plain_error(error)}"
            continue
        found.append((run, evaluation))
    decided = [(run, each) for run, each in found if each.status != "undecided"]
    judging = [(run, each) for run, each in decided if not each.vacuous]
    for run, each in judging:
        if run.own and run.scenario is not None:
            name = run.scenario.name
            margins[name] = min(each.margin, margins.get(name, np.inf))
    violated = sum(each.status == "violated" for _, each in judging)
    refusal = broken or _refusal(len(runs), problems, decided, judging, seen)
    return Shown(
        refusal,
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
    seen: Sequence[Column],
) -> str:
    if not decided:
        return problems[0] if problems else f"none of {runs} recorded runs decides it"
    if not judging:
        return f"vacuous: its condition holds in none of {runs} recorded runs"
    if not any(run.own for run, _ in judging):
        return (
            "vacuous: its condition holds in no run of the suite's own component, so that no "
            "scenario could support it"
        )
    values = np.concatenate(seen)
    if _is_constant(values):
        return f"constant: its robustness is {values[0]:g} throughout {runs} recorded runs"
    if all(each.status == "violated" for _, each in judging):
        return f"constant: all {len(judging)} runs that decide it violate it, whatever drives"
    return ""


def _is_constant(values: Column) -> bool:
    """Whether values are the same but for rounding; an infinite one is the same as itself."""
    if not np.isfinite(values).all():
        return bool((values == values[0]).all())
    return bool(np.ptp(values) <= _NOISE * max(1.0, np.abs(values).max()))
