"""Milliseconds per trace to evaluate formulas of signal temporal logic, rtamt beside ours.

Run: python benchmarks/stl_speed.py [--repeats 15 --traces 1000]

Traces have 200 samples at 0.1 s. rtamt evaluates offline in discrete time with its Python backend;
its formula is parsed once, outside of the measured time. Ours gives the same robustness at every
sample, which is checked first; the verdict adds the interval, the truth on the bound, the time of
a violation and whether it is vacuous. The batch is one call for all traces.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from machine import machine, table

from pytest_dura.requirements.stl.evaluation import evaluate
from pytest_dura.requirements.stl.parsing import parse
from pytest_dura.requirements.stl.robustness import robustness, robustness_batch

STEP = 0.1
SAMPLES = 200
FORMULAS = {
    "`always (p)`": "always (gap > 0.5)",
    "`always (p implies eventually[0:2] q)`": (
        "always ((gap <= 10) implies (eventually[0:2] (speed <= 2)))"
    ),
    "`always (p implies (r until[0:5] q))`": (
        "always ((gap <= 10) implies ((speed <= 20) until[0:5] (gap > 9)))"
    ),
    "nested, windows of 5 s": (
        "always ((gap <= 10) implies (eventually[0:5] (always[0:5] (speed <= 9))))"
    ),
}


def rtamt_evaluation(text: str) -> Callable[[dict[str, list[float]]], Any]:
    """rtamt's evaluation of a formula, parsed and ready."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # antlr imports a deprecated name
        import rtamt

    specification = rtamt.StlDiscreteTimeOfflineSpecification()
    specification.set_sampling_period(100, "ms", 0.1)
    for name in ("gap", "speed"):
        specification.declare_var(name, "float")
    specification.spec = text
    specification.parse()

    def evaluation(columns: dict[str, list[float]]) -> Any:
        return specification.evaluate(columns)

    return evaluation


def milliseconds(works: Sequence[Callable[[], Any]], repeats: int) -> list[float]:
    """The best of some rounds for each, which take turns; the machine only ever adds to it."""
    counts, best = [], [float("inf")] * len(works)
    for work in works:
        start = perf_counter()
        work()
        counts.append(1 + int(0.01 / (perf_counter() - start)))
    for _ in range(repeats):
        for number, (work, count) in enumerate(zip(works, counts, strict=True)):
            start = perf_counter()
            for _ in range(count):
                work()
            best[number] = min(best[number], (perf_counter() - start) / count)
    return [seconds * 1000 for seconds in best]


def traces(count: int) -> list[dict[str, np.ndarray]]:
    """Random walks of a gap and a speed."""
    generator = np.random.default_rng(0)
    steps = generator.normal(size=(count, 2, SAMPLES))
    walks = np.abs(np.cumsum(steps, axis=-1) + 9)
    return [{"gap": gap, "speed": speed} for gap, speed in walks]


def row(name: str, text: str, batch: list[dict[str, np.ndarray]], repeats: int) -> list[str]:
    """One formula's line of the table."""
    formula, trace = parse(text), batch[0]
    time = np.arange(SAMPLES) * STEP
    lists = {"time": time.tolist(), **{key: column.tolist() for key, column in trace.items()}}
    reference = rtamt_evaluation(text)
    theirs = [margin for _, margin in reference(lists)]
    if robustness(formula, trace, STEP).tolist() != theirs:
        raise SystemExit(f"rtamt and we differ on {text}")
    works = [
        partial(reference, lists),
        partial(robustness, formula, trace, STEP),
        partial(evaluate, formula, time, trace),
        partial(robustness_batch, formula, batch, STEP),
    ]
    slow, fast, verdict, many = milliseconds(works, repeats)
    many /= len(batch)
    cells = [f"{one:.4f}" for one in (slow, fast, verdict, many)]
    ratios = [f"{slow / fast:.0f}", f"{slow / verdict:.0f}", f"{slow / many:.0f}"]
    return [name, *cells, f"**{ratios[0]}**", *ratios[1:]]


def main() -> None:
    """Measure and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--repeats", type=int, default=15)
    arguments.add_argument("--traces", type=int, default=1000)
    options = arguments.parse_args()
    batch = traces(options.traces)
    rows = [row(name, text, batch, options.repeats) for name, text in FORMULAS.items()]
    print(machine(), "\n")
    headers = [
        "ms per trace", "rtamt", "robustness", "verdict", f"batch of {options.traces}",
        "times faster", "with verdict", "in the batch",
    ]  # fmt: skip
    print(table(headers, rows))


if __name__ == "__main__":
    main()
