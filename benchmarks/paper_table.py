"""The paper's table beside ours, with and without attacks, with and without recovery.

Run: python benchmarks/paper_table.py [--generator rule_based] [--runs 200] [--jobs 2] [--seed 0]
    [--figure docs/screenshots/clearance.svg]

Pairs share their seed, and so traffic, timing and variation. The paper's questions are asked of
them by exact tests: do attacks raise flags, collisions and clearance time, each attack scenario
with and without its faults, recovery on; does switching recovery off raise collisions, each
scenario with the policies recover and log_only. Binary outcomes are compared by the exact McNemar
test, clearance times of pairs that cleared both times by the exact sign test. The paper gives rates
of 15 runs a scenario with another planner, simulator and traffic: Fisher's exact test says where
the two differ by more than chance, and no more than that. All p-values are two-sided and
uncorrected.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean, stdev

import numpy as np
from machine import machine, table
from scipy.stats import binomtest, fisher_exact

from pytest_dura.core import REACTIONS, Orchestrator, RoleSpec
from pytest_dura.domains import DOMAINS
from pytest_dura.driving.measures.comfort import uncomfortable
from pytest_dura.driving.paper import PAPER, PAPER_OVERALL, Published
from pytest_dura.library import Case, expand_cases, load_library
from pytest_dura.reports.svg import Scale, Svg, document, path_of, tag
from pytest_dura.requirements import mcnemar

Key = tuple[str, bool, str, int]
"""Scenario, with its own faults, policy, run."""
POLICIES = ("recover", "log_only")
PLANNERS = DOMAINS["driving"].short_names["generator"]
DEFAULTS = [name for name in ("rule_based", "reactive", "tactical") if name in PLANNERS]


@dataclass(frozen=True)
class Outcome:
    """What the tables need of an episode."""

    flagged: bool
    collided: bool
    struck: bool
    clearance: float | None
    rescued: bool
    uncomfortable: bool
    alerts: int
    valid: bool
    reactions: dict[str, int] = field(default_factory=dict)


def case_of(scenario: str, attacked: bool) -> Case:
    """The scenario with its own faults, or without any."""
    faults = None if attacked else ["none"]
    (case,) = expand_cases(load_library([]).scenarios, faults=faults, select=[f"{scenario}*"])
    return case


def run(job: tuple[Key, str | RoleSpec, int]) -> tuple[Key, Outcome]:
    """One episode of a planner, by its short name or as a role."""
    key, generator, base_seed = job
    scenario, attacked, policy, number = key
    role = RoleSpec(PLANNERS[generator]) if isinstance(generator, str) else generator
    roles = {"generator": role}
    case = case_of(scenario, attacked)
    spec = case.spec(number, base_seed, roles, policy=policy)
    episode = Orchestrator.build(spec).run(spec)
    if episode.failure is not None:
        raise RuntimeError(episode.failure)
    cleared = episode.signals["cleared"] > 0.5
    return key, Outcome(
        flagged=episode.flagged,
        collided=episode.collided,
        struck=episode.ever("struck"),
        clearance=float(episode.time[np.argmax(cleared)]) if cleared.any() else None,
        rescued=bool(episode.metrics.recoveries),
        uncomfortable=uncomfortable(episode) is True,
        alerts=episode.metrics.alerts,
        valid=episode.validity == "valid",
        reactions=dict(episode.metrics.reactions),
    )


def discordant(first: list[bool], second: list[bool]) -> tuple[int, int, float]:
    """Pairs that only the first has, pairs that only the second has, exact p-value."""
    only_first = sum(a and not b for a, b in zip(first, second, strict=True))
    only_second = sum(b and not a for a, b in zip(first, second, strict=True))
    return only_first, only_second, mcnemar(only_first, only_second)


class Arms:
    """The outcomes of all runs of a planner, by arm of the comparison."""

    def __init__(self, outcomes: dict[Key, Outcome], runs: int) -> None:
        self._outcomes, self._runs = outcomes, range(runs)

    def of(self, scenario: str, *, attacked: bool = True, policy: str = "recover") -> list[Outcome]:
        """One outcome per run, in the order of the runs."""
        return [self._outcomes[scenario, attacked, policy, number] for number in self._runs]


def paper_table(arms: Arms, scenarios: list[str], attacks: list[str]) -> str:
    """Ours and, in the rows that can be compared with it, the paper's."""
    rows = []
    for scenario in scenarios:
        for attacked in (True, False) if scenario in attacks else (False,):
            for policy in POLICIES:
                # Without faults, a scenario's own case is the one without an attack.
                own = attacked or scenario not in attacks
                outcomes = arms.of(scenario, attacked=own, policy=policy)
                shown = PAPER.get(scenario) if own and policy == "recover" else None
                rows.append(
                    [scenario, _yes(attacked), _yes(policy == "recover"), *_cells(outcomes, shown)]
                )
    together = [one for scenario in scenarios for one in arms.of(scenario)]
    rows.append(["overall", "as listed", "yes", *_cells(together, PAPER_OVERALL)])
    together = [one for scenario in scenarios for one in arms.of(scenario, policy="log_only")]
    rows.append(["overall", "as listed", "no", *_cells(together, None)])
    headers = ["scenario", "attack", "recovery", "flagged %", "paper", "collided %", "paper"]
    headers += ["clearance s (n)", "paper", "gridlock", "paper", "struck %", "rescued %"]
    return table([*headers, "comfort failed %", "reactions u/e/f/F", "alerts", "invalid"], rows)


def _cells(outcomes: Sequence[Outcome], paper: Published | None) -> list[str]:
    """The cells of one arm; the paper's are empty where it has no such arm."""
    times = _times(outcomes)
    spread = f"{mean(times):.1f} +- {stdev(times):.1f}" if len(times) > 1 else "-"
    stuck = sum(o.clearance is None and not o.collided for o in outcomes)
    reactions: Counter[str] = Counter()
    for one in outcomes:
        reactions.update(one.reactions)
    theirs = ["", "", "", ""]
    if paper is not None:
        clearance = "" if paper.clearance is None else "{:.1f} +- {:.1f}".format(*paper.clearance)
        rates = [f"{100 * count / paper.runs:.1f}" for count in (paper.flagged, paper.collided)]
        stuck_there = "" if paper.gridlock is None else f"{paper.gridlock} of {paper.runs}"
        theirs = [*rates, clearance, stuck_there]
    return [
        percentage([o.flagged for o in outcomes]), theirs[0],
        percentage([o.collided for o in outcomes]), theirs[1],
        f"{spread} ({len(times)})", theirs[2],
        str(stuck), theirs[3],
        percentage([o.struck for o in outcomes]),
        percentage([o.rescued for o in outcomes]),
        percentage([o.uncomfortable for o in outcomes]),
        "/".join(str(reactions[kind]) for kind in REACTIONS),
        str(sum(o.alerts for o in outcomes)),
        str(sum(not o.valid for o in outcomes)),
    ]  # fmt: skip


def _times(outcomes: Sequence[Outcome]) -> list[float]:
    return [one.clearance for one in outcomes if one.clearance is not None]


def _yes(given: bool) -> str:
    return "yes" if given else "no"


def against_paper(arms: Arms, scenarios: list[str]) -> str:
    """How far ours lies from the paper's, attacks and recovery on."""
    rows = []
    groups = [(one, PAPER[one], arms.of(one)) for one in scenarios if one in PAPER]
    together = [outcome for _, _, outcomes in groups for outcome in outcomes]
    for name, paper, outcomes in [*groups, ("overall", PAPER_OVERALL, together)]:
        cells = []
        for counted in ("flagged", "collided"):
            theirs, ours = getattr(paper, counted), sum(getattr(o, counted) for o in outcomes)
            counts = [[ours, len(outcomes) - ours], [theirs, paper.runs - theirs]]
            difference = 100 * (ours / len(outcomes) - theirs / paper.runs)
            cells += [f"{difference:+.1f}", f"{fisher_exact(counts).pvalue:.2g}"]
        times = _times(outcomes)
        known = bool(times) and paper.clearance is not None
        change = f"{mean(times) - paper.clearance[0]:+.1f}" if known else "-"
        rows.append([name, *cells, change])
    headers = ["scenario", "flagged, points", "p (Fisher)", "collided, points", "p (Fisher)"]
    return table([*headers, "clearance, s"], rows)


def effect_of_attacks(arms: Arms, attacks: list[str]) -> str:
    """Each attack against the same runs without it."""
    rows = []
    for scenario in attacks:
        attacked, free = arms.of(scenario), arms.of(scenario, attacked=False)
        cells = []
        for counted in ("flagged", "collided"):
            up, down, p = discordant(
                [getattr(o, counted) for o in attacked], [getattr(o, counted) for o in free]
            )
            cells += [f"{up} / {down}", f"{p:.2g}"]
        deltas = [
            a.clearance - b.clearance
            for a, b in zip(attacked, free, strict=True)
            if a.clearance is not None and b.clearance is not None
        ]
        longer, shorter = sum(d > 0 for d in deltas), sum(d < 0 for d in deltas)
        sign = binomtest(longer, longer + shorter).pvalue if longer + shorter else 1.0
        change = f"{mean(deltas):+.1f}" if deltas else "-"
        rows.append([scenario, *cells, change, f"{longer} / {shorter}", f"{sign:.2g}"])
    headers = ["scenario", "flagged only attacked / only free", "p"]
    headers += ["collided only attacked / only free", "p"]
    headers += ["mean change of clearance s", "longer / shorter", "p"]
    return table(headers, rows)


def effect_of_recovery(arms: Arms, scenarios: list[str]) -> str:
    """Each scenario with recovery against the same runs without it, and all together."""
    rows = []
    all_off: list[bool] = []
    all_on: list[bool] = []
    for scenario in scenarios:
        off = [o.collided for o in arms.of(scenario, policy="log_only")]
        on = [o.collided for o in arms.of(scenario)]
        all_off, all_on = all_off + off, all_on + on
        rows.append([scenario, *compared(off, on)])
    rows.append(["all", *compared(all_off, all_on)])
    headers = ["scenario", "collisions off", "collisions on", "prevented", "introduced"]
    return table([*headers, "in both", "p"], rows)


def compared(off: list[bool], on: list[bool]) -> list[str]:
    """The cells of two arms that are compared pair by pair."""
    prevented, introduced, p = discordant(off, on)
    futile = sum(a and b for a, b in zip(off, on, strict=True))
    counts = (sum(off), sum(on), prevented, introduced, futile)
    return [*map(str, counts), f"{p:.2g}"]


def percentage(hits: list[bool]) -> str:
    """The share of hits."""
    return f"{100 * sum(hits) / len(hits):.1f}"


COLOURS = ("#555555", "#1f77b4", "#d9730d", "#2a8a3e", "#9b3fb5")
"""Of the paper, then of the planners; each also has a marker of its own place in the row."""
_LEFT, _WIDTH, _ROW, _LINE, _TOP = 190, 720, 14, 16, 64


def clearance_figure(planners: dict[str, Arms], scenarios: list[str], runs: int) -> str:
    """The paper's figure 4 as SVG: mean and standard deviation of the clearance time.

    Args:
        planners: Their arms, by name; those with attacks and recovery are drawn.
        scenarios: In the paper's order.
        runs: A planner's runs of each scenario.
    """
    names = ["paper (n = 15)", *(f"{name} (n = {runs})" for name in planners)]
    groups = []
    for scenario in scenarios:
        published = PAPER.get(scenario)
        bars = [published.clearance if published is not None else None]
        for arms in planners.values():
            times = _times(arms.of(scenario))
            sd = stdev(times) if len(times) > 1 else 0.0
            bars.append((mean(times), sd) if times else None)
        groups.append((scenario.rpartition("/")[2], bars))
    ends = [middle + sd for _, bars in groups for middle, sd in filter(None, bars)]
    longest = 5.0 * (int(max(ends, default=5.0) / 5.0) + 1)
    height = _TOP + len(groups) * (len(names) * _ROW + _LINE) + 40
    x = Scale(0.0, longest, _LEFT, _WIDTH - 60)
    title = "Clearance time in s, mean and standard deviation over cleared runs"
    parts = [
        tag("title", f"{title}, by scenario"),
        tag("rect", width=_WIDTH, height=height, fill="white"),
        tag("text", title, x=10, y=20, font_size=14),
        *_key(names),
        *_axis(x, height),
    ]
    top = float(_TOP)
    for label, bars in groups:
        place = {"x": _LEFT - 10, "y": round(top + len(names) * _ROW / 2 + 4)}
        parts.append(tag("text", label, **place, text_anchor="end"))
        for number, bar in enumerate(bars):
            parts += _bar(bar, COLOURS[number % len(COLOURS)], top + number * _ROW, x)
        top += len(names) * _ROW + _LINE
    font = {"font_family": "sans-serif", "font_size": 12}
    return document(_WIDTH, height, *parts, **font, width=None, height=None) + "\n"


def _key(names: Sequence[str]) -> Iterator[Svg]:
    for number, label in enumerate(names):
        x, colour = 10 + number * 165, COLOURS[number % len(COLOURS)]
        yield tag("rect", x=x, y=32, width=12, height=12, fill=colour)
        yield tag("text", label, x=x + 18, y=42)


def _axis(scale: Scale, height: int) -> Iterator[Svg]:
    for seconds in np.arange(0.0, scale.high + 0.1, 5.0).tolist():
        x = scale(seconds)
        yield tag("line", x1=x, y1=_TOP - 6, x2=x, y2=height - 34, stroke="#dddddd")
        yield tag("text", f"{seconds:.0f}", x=x, y=height - 18, text_anchor="middle")


def _bar(bar: tuple[float, float] | None, colour: str, top: float, x: Scale) -> Iterator[Svg]:
    y = top + _ROW / 2
    if bar is None:
        yield tag("text", "nobody cleared", x=_LEFT + 4, y=y + 4, fill=colour)
        return
    middle, sd = bar
    left, right = x(max(middle - sd, 0.0)), x(middle + sd)
    width = x(middle) - _LEFT
    yield tag("rect", x=_LEFT, y=top + 2, width=width, height=_ROW - 4, fill=colour)
    ends = [path_of([(at, y - 3), (at, y + 3)]) for at in (left, right)]
    line = path_of([(left, y), (right, y)])
    yield tag("path", d="".join([line, *ends]), stroke="black", fill="none")
    yield tag("text", f"{middle:.1f}", x=right + 5, y=y + 4, font_size=10)


def places() -> tuple[list[str], list[str]]:
    """The scenarios in the paper's order, and those with attacks."""
    by_place = sorted(
        expand_cases(load_library([]).scenarios),
        key=lambda case: (case.scenario.order or len(PAPER) + 1, case.id),
    )
    return [case.id for case in by_place], [case.id for case in by_place if case.faults]


def keys_of(scenarios: list[str], attacks: list[str], runs: int) -> list[Key]:
    """All runs of a planner: each scenario with and without recovery, and without its attack."""
    keys: list[Key] = [(s, True, p, n) for s in scenarios for p in POLICIES for n in range(runs)]
    return keys + [(s, False, p, n) for s in attacks for p in POLICIES for n in range(runs)]


def print_tables(name: str, arms: Arms, scenarios: list[str], attacks: list[str]) -> None:
    """The tables of a planner, below a heading."""
    print(f"### {name}\n")
    print(paper_table(arms, scenarios, attacks))
    print("\nHow far does it lie from the paper's, attacks and recovery on?\n")
    print(against_paper(arms, scenarios))
    print("\nDo attacks raise flags, collisions and clearance time? (recovery on)\n")
    print(effect_of_attacks(arms, attacks))
    print("\nDoes switching recovery off raise collisions? (log_only against recover)\n")
    print(effect_of_recovery(arms, scenarios), end="\n\n", flush=True)


def main() -> None:
    """Run, compare, print, draw."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument(
        "--generator", action="append", choices=sorted(PLANNERS), metavar="NAME",
        help="short name of a planner; may be repeated",
    )  # fmt: skip
    arguments.add_argument("--runs", type=int, default=200)
    arguments.add_argument("--jobs", type=int, default=2)
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--figure", type=Path, help="write the clearance times there, as SVG")
    options = arguments.parse_args()
    scenarios, attacks = places()
    keys = keys_of(scenarios, attacks, options.runs)
    print(f"{machine()}\n")
    planners = {}
    with ProcessPoolExecutor(options.jobs) as pool:
        for generator in dict.fromkeys(options.generator or DEFAULTS):
            jobs = [(key, generator, options.seed) for key in keys]
            arms = Arms(dict(pool.map(run, jobs, chunksize=20)), options.runs)
            planners[generator] = arms
            seeds = f"{options.runs} paired seeds a scenario, base seed {options.seed}"
            print_tables(f"{generator}, {seeds}", arms, scenarios, attacks)
    if options.figure is not None:
        drawn = clearance_figure(planners, scenarios, options.runs)
        options.figure.write_text(drawn, encoding="utf-8")
        print(f"clearance times: {options.figure}")


if __name__ == "__main__":
    main()
