"""Logs judged block by block, and what is recorded right now judged as it comes."""

from __future__ import annotations

import sys
from collections.abc import Generator, Mapping
from pathlib import Path

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.library import load_library
from pytest_dura.logs.live import NAME, LiveLines
from pytest_dura.logs.mapping import read_mapping
from pytest_dura.logs.streaming import LogStream, stream_of
from pytest_dura.requirements.checks import is_function_path, read_formula
from pytest_dura.requirements.stl.evaluation import Evaluation
from pytest_dura.requirements.stl.formula import (
    Formula,
    Temporal,
    conjuncts,
    node_text,
    past_only_or_refuse,
)
from pytest_dura.requirements.stl.parser import parse
from pytest_dura.requirements.stl.streaming import StreamedFormula


def judge_log(
    file: str | Path, mapping: object, checks: Mapping[str, str], *, time_step: float | None = None
) -> tuple[dict[str, Evaluation], LogStream]:
    """Judge a log block by block, in memory that does not grow with it.

    Args:
        file: The log.
        mapping: Path of a mapping file, or its data.
        checks: Formulas by name; each looks a bounded time ahead below ``always`` or
            ``eventually``.
        time_step: Seconds from sample to sample; default: as for :func:`~pytest_dura.read_log`.

    Returns:
        The evaluations by name, which are those of the whole log, and the log that was read.

    Raises:
        ConfigurationError: For a log that cannot be read so, a mapping that does not fit, and a
            formula that needs the whole log.
    """
    formulas = {name: read_formula(text) for name, text in checks.items()}
    names = sorted({name for formula in formulas.values() for name in formula.signals})
    log, blocks = stream_of(str(file), read_mapping(mapping), names, time_step)
    judges: dict[str, StreamedFormula] = {}
    for columns in blocks:
        if not judges:  # the step is known from the first block on
            judges = {name: StreamedFormula(each, log.step) for name, each in formulas.items()}
        for judge in judges.values():
            judge.take(columns)
    return {name: judge.finish() for name, judge in judges.items()}, log


def verdict_line(name: str, check: str, evaluation: Evaluation) -> str:
    """Say what was found in one line."""
    when = "" if evaluation.time is None else f" at {evaluation.time:g} s"
    vacuous = ", vacuously" if evaluation.vacuous else ""
    margin = f"margin {evaluation.margin:.4g}"
    if evaluation.status == "undecided":
        margin = f"robustness between {evaluation.lower:.4g} and {evaluation.upper:.4g}"
    known = evaluation.detail[evaluation.detail.rfind(" (") :]
    seen = known if known.endswith("of the samples)") else ""
    what = check if name == check else f"{name}: {check}"
    return f"{evaluation.status + vacuous}{when}: {what}: {margin}{seen}"


def checks_of(requirements: Path | None, formulas: list[str]) -> dict[str, str]:
    """Gather formulas of a file of requirements, by id, and those that were given.

    Raises:
        ConfigurationError: For a file that cannot be read, a check by a function, and none at all.
    """
    checks = {formula: formula for formula in formulas}
    if requirements is not None:
        for name, each in load_library([requirements], builtin=False).requirements.items():
            if not each.check or is_function_path(each.check):
                raise ConfigurationError(
                    f"the requirement {name} has no formula",
                    file=str(requirements),
                    found=each.check or "no check",
                    expected="a formula, which can be judged block by block",
                    remedy="judge the logs by `pytest --dura-log`",
                )
            checks[name] = each.check
    if not checks:
        raise ConfigurationError(
            "there is nothing to judge by",
            expected="--requirements FILE, or --check FORMULA",
            remedy="give one of them",
        )
    return checks


def judged_lines(
    file: str, mapping: Path | None, checks: Mapping[str, str], step: float | None
) -> Generator[str, None, int]:
    """Judge a log, and yield what was found; returns the exit code, 0 if all is satisfied."""
    found, log = judge_log(file, mapping, checks, time_step=step)
    yield (
        f"{file}: recorded, not run: {log.samples:,} samples of {len(log.names)} signals, "
        f"one every {log.step:g} s over {(log.made - 1) * log.step:g} s"
    )
    yield from log.notes()
    for name, evaluation in found.items():
        yield verdict_line(name, checks[name], evaluation)
    return int(any(each.status != "satisfied" for each in found.values()))


_WORDS = {1: "holds", 0: "is not known", -1: "is violated"}


def watched(text: str) -> Formula:
    """Read a formula that is to hold at each sample, and looks back alone.

    Raises:
        ConfigurationError: For one that looks ahead below ``always``.
    """
    formula = parse(text)
    for part in conjuncts(formula.root):
        if isinstance(part, Temporal) and part.operator == "always" and part.window is None:
            past_only_or_refuse(Formula(part.operand, text), "a monitor of a live stream")
        elif formula.past_only:
            root = Temporal("always", formula.root)
            return Formula(root, node_text(root))
        else:
            past_only_or_refuse(formula, "a monitor of a live stream")
    return formula


def watched_lines(
    mapping: Path | None, checks: Mapping[str, str], step: float | None, descriptor: int | None
) -> Generator[str, None, int]:
    """Judge the lines of standard input as they come, and yield each change of a verdict."""
    formulas = {name: watched(text) for name, text in checks.items()}
    names = sorted({name for formula in formulas.values() for name in formula.signals})
    read = read_mapping(mapping)
    source = LiveLines(sys.stdin.fileno() if descriptor is None else descriptor, read.time.column)
    log = LogStream(str(NAME), [source.topic], read, names, step, live=True)
    judges: dict[str, StreamedFormula] = {}
    late = 0
    for columns in log.blocks(source.blocks(log.wanted)):
        if not judges:
            judges = {
                name: StreamedFormula(each, log.step, at_once=True)
                for name, each in formulas.items()
            }
        for name, judge in judges.items():
            judge.take(columns)
            for index, status in judge.changes():
                yield f"{index * log.step:g} s: {name} {_WORDS[status]}"
        if log.late > late:
            yield f"{log.late - late} samples came late, and are left out"
            late = log.late
    found = {name: judge.finish() for name, judge in judges.items()}
    for name, judge in judges.items():
        for index, status in judge.changes():
            yield f"{index * log.step:g} s: {name} {_WORDS[status]}"
    for name, evaluation in found.items():
        yield verdict_line(name, checks[name], evaluation)
    return int(bool(late) or any(each.status != "satisfied" for each in found.values()))
