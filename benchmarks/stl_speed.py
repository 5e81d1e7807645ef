"""Milliseconds per trace to evaluate formulas of signal temporal logic, rtamt beside ours.

Run: python benchmarks/stl_speed.py [--repeats 15 --traces 1000]

Traces have 200 samples at 0.1 s. rtamt evaluates offline in discrete time with its Python backend;
its formula is parsed once, outside of the measured time. Ours gives the same robustness at every
sample, which is checked first; the verdict adds the interval, the truth on the bound, the time of
a violation and whether it is vacuous. The batch is one call for all traces.

The second table has formulas that look back, updated sample by sample as a monitor does, in
microseconds per sample; rtamt by its online specification, without pastification.

The third table has milliseconds to read a text, rtamt's parser beside ours.
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

from pytest_dura.requirements import OnlineFormula, evaluate, parse, robustness, robustness_batch

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
PAST = {
    "`p`": "gap > 0.5",
    "`historically[0:0.5] p`": "historically[0:0.5] (gap > 0.5)",
    "`historically[0:10] p`": "historically[0:10] (gap > 0.5)",
    "`p implies once[0:2] q`": "(gap <= 10) implies (once[0:2] (speed <= 2))",
    "`p implies (r since[0:5] q)`": "(gap <= 10) implies ((speed <= 20) since[0:5] (gap > 9))",
}


def rtamt_specification(kind: str, text: str) -> Any:
    """A specification of rtamt, parsed and ready; ``kind`` is Offline or Online."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # antlr imports a deprecated name
        try:
            import rtamt
        except ImportError:
            raise SystemExit("this needs rtamt, which Python 3.13 cannot import") from None

    specification = getattr(rtamt, f"StlDiscreteTime{kind}Specification")()
    specification.set_sampling_period(100, "ms", 0.1)
    for name in ("gap", "speed"):
        specification.declare_var(name, "float")
    specification.spec = text
    specification.parse()
    return specification


def rtamt_evaluation(text: str) -> Callable[[dict[str, list[float]]], Any]:
    """rtamt's evaluation of a formula."""
    specification = rtamt_specification("Offline", text)

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


def online_row(name: str, text: str, trace: dict[str, np.ndarray], repeats: int) -> list[str]:
    """One formula's line of the second table."""
    formula = parse(text)
    ours, reference = OnlineFormula(formula, STEP), rtamt_specification("Online", text)
    samples = [
        dict(zip(trace, now, strict=True))
        for now in zip(*(column.tolist() for column in trace.values()), strict=True)
    ]

    def updated() -> list[float]:
        ours.reset()
        return [ours.update(now).robustness for now in samples]

    def updated_by_rtamt() -> list[float]:
        reference.reset()
        return [reference.update(at, list(now.items())) for at, now in enumerate(samples)]

    reference.update(0, list(samples[0].items()))  # before that its reset fails
    expected = robustness(formula, trace, STEP).tolist()
    if updated() != expected or updated_by_rtamt() != expected:
        raise SystemExit(f"online and offline differ on {text}")
    slow, fast = milliseconds([updated_by_rtamt, updated], repeats)
    cells = [f"{one * 1000 / SAMPLES:.2f}" for one in (slow, fast)]
    return [name, *cells, f"**{slow / fast:.0f}**"]


def parsing_row(name: str, text: str, repeats: int) -> list[str]:
    """One formula's line of the third table."""
    works = [partial(rtamt_specification, "Offline", text), partial(parse.__wrapped__, text)]
    slow, fast = milliseconds(works, repeats)
    return [name, f"{slow:.3f}", f"{fast:.3f}", f"**{slow / fast:.1f}**"]


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
    print(table(headers, rows), "\n")
    rows = [online_row(name, text, batch[0], options.repeats) for name, text in PAST.items()]
    print(table(["us per sample", "rtamt", "update", "times faster"], rows), "\n")
    texts = {**FORMULAS, **PAST}
    rows = [parsing_row(name, text, options.repeats) for name, text in texts.items()]
    print(table(["ms per text", "rtamt", "parse", "times faster"], rows))


if __name__ == "__main__":
    main()
