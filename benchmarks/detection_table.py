"""Which faults each detector of driving detects, alone and beside the plausibility checks.

Run: python benchmarks/detection_table.py [--scenario NAME] [--generator rule_based] [--runs 5]
     [--free-runs 20] [--jobs 2] [--seed 0] [--arms cusum stl ...]

Each fault of the catalogue acts by itself, as it is by default. Recovery is switched off: what it
does after an alarm or without one would change what there is left to detect, whereas like this all
arms see the very same episodes. A fault is detected by the first alert from its activation until
one second after its end. What the component does not read cannot manifest, and is told as such.
False alarms are alerts in episodes without faults, by default of all built-in scenarios.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from statistics import median

from machine import machine, table
from reads import can_reach, channels_read
from scipy.stats import chi2

from pytest_dura import Runner
from pytest_dura.core import FaultRecord, RoleSpec
from pytest_dura.domains import DOMAINS
from pytest_dura.library import expand_cases, load_library

Roles = dict[str, RoleSpec | None]
DRIVING = DOMAINS["driving"]
BOTH = "plausibility + "
MONITORS = {name: RoleSpec(path) for name, path in DRIVING.short_names["residual_monitor"].items()}
MONITORS["stl"] = RoleSpec("stl_alarms:StlAlarms")
ARMS: dict[str, Roles] = {
    "plausibility": {},
    **{
        name: {"security_assessor": None, "residual_monitor": monitor}
        for name, monitor in MONITORS.items()
    },
    **{f"{BOTH}{name}": {"residual_monitor": monitor} for name, monitor in MONITORS.items()},
}
DETECTORS = ("security_assessor", "residual_monitor")


@dataclass(frozen=True)
class Job:
    """The runs of one case in one arm."""

    scenario: str
    fault: str
    arm: str
    generator: str
    runs: int
    seed: int


@dataclass(frozen=True)
class Outcome:
    """What came of them: the fault's records, the alerts, simulated seconds, and what it cost."""

    records: list[FaultRecord]
    alerts: Counter[str]
    seconds: float
    nanoseconds: int
    ticks: int


def roles_of(generator: str, arm: str) -> Roles:
    """The roles of an arm, without recovery."""
    component = RoleSpec(DRIVING.short_names["generator"][generator])
    return {"generator": component, "recovery_planner": None, **ARMS[arm]}


def run(job: Job) -> Outcome:
    """All episodes of a job."""
    library = load_library([])
    bench = Runner(
        lambda: library, base_seed=job.seed, roles=roles_of(job.generator, job.arm), twins=False
    )
    case = bench.case(job.scenario, job.fault)
    records: list[FaultRecord] = []
    alerts: Counter[str] = Counter()
    seconds, nanoseconds, ticks = 0.0, 0, 0
    for number in range(job.runs):
        episode = bench.episode(case, number)
        if episode.failure is not None:
            raise RuntimeError(episode.failure)
        records += episode.faults
        seconds += float(episode.time[-1])
        ticks += episode.ticks - 1
        for role in DETECTORS:
            _, spent = episode.metrics.processing_ns.get(role, ((), ()))
            nanoseconds += sum(spent)
        alerts.update(
            event.detail.partition(": ")[0] for event in episode.events if event.kind == "alert"
        )
    return Outcome(records, alerts, seconds, nanoseconds, ticks)


def why_not(records: Sequence[FaultRecord], read: set[str]) -> str:
    """Why a fault manifested in no run."""
    if not can_reach(records[0].target, read):
        return "not read"
    if not any(record.activated_at is not None for record in records):
        return "never active"
    return "changed nothing"


def seen_by(records: Sequence[FaultRecord]) -> str:
    """How many of a fault's runs were detected, and the median latency in s."""
    latencies = [one.detection_latency for one in records if one.detection_latency is not None]
    return f"{len(latencies)} ({median(latencies):.1f})" if latencies else "0"


def detection(found: dict[str, Outcome], read: set[str]) -> list[str]:
    """The row of one fault."""
    records = next(iter(found.values())).records
    first = records[0]
    reached = sum(record.success for record in records)
    if not reached:
        return [first.id, first.target, why_not(records, read), *["-"] * len(found)]
    cells = [seen_by(outcome.records) for outcome in found.values()]
    return [first.id, first.target, f"{reached} of {len(records)}", *cells]


def summary(found: list[dict[str, Outcome]]) -> list[str]:
    """The row of all faults together."""
    cells, told = [], ""
    for arm in found[0]:
        records = [record for arms in found for record in arms[arm].records]
        reached = sum(record.success for record in records)
        told = f"{reached} of {len(records)}"
        detected = sum(record.detection_latency is not None for record in records)
        cells.append(f"{detected} = {detected / max(reached, 1):.0%}")
    return ["all", "", told, *cells]


def false_alarms(found: list[tuple[str, Outcome]], arms: Sequence[str]) -> list[list[str]]:
    """Alerts without faults per simulated hour, with the exact upper bound of a Poisson rate."""
    rows = []
    for arm in arms:
        own = [one for name, one in found if name == arm]
        hours = sum(one.seconds for one in own) / 3600.0
        alerts = sum((one.alerts for one in own), Counter[str]())
        cost = sum(one.nanoseconds for one in own) / sum(one.ticks for one in own) / 1e3
        count = alerts.total()
        upper = float(chi2.ppf(0.95, 2 * count + 2)) / 2.0
        told = ", ".join(f"{name} {number}" for name, number in alerts.most_common())
        cells = [f"{hours:.2f}", str(count), f"{count / hours:.2f}", f"{upper / hours:.2f}"]
        rows.append([arm, *cells, told or "-", f"{cost:.0f}"])
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", default="intersection/nominal")
    parser.add_argument(
        "--generator", default="rule_based", choices=DRIVING.short_names["generator"]
    )
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--free-runs", type=int, default=20, help="per scenario, without faults")
    parser.add_argument("--free-scenarios", nargs="+", help="those without faults; default: all")
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS), metavar="ARM")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--faults", nargs="+", default=["catalogue"])
    options = parser.parse_args()
    scenarios = load_library([]).scenarios
    cases = expand_cases([scenarios[options.scenario]], options.faults)
    faults = [fault.id for case in cases for fault in case.faults]
    tail = options.generator, options.runs, options.seed
    planned = [Job(options.scenario, fault, arm, *tail) for fault in faults for arm in options.arms]
    tail = options.generator, options.free_runs, options.seed
    free = [
        Job(name, "none", arm, *tail)
        for name in options.free_scenarios or scenarios
        for arm in options.arms
    ]
    with ProcessPoolExecutor(options.jobs) as pool:
        found = dict(zip([*planned, *free], pool.map(run, [*planned, *free]), strict=True))
    component = RoleSpec(DRIVING.short_names["generator"][options.generator])
    read = channels_read(options.scenario, component, options.seed)
    by_fault = [{job.arm: found[job] for job in planned if job.fault == fault} for fault in faults]
    rows = [*(detection(arms, read) for arms in by_fault), summary(by_fault)]
    print(f"""{machine()}

{options.scenario}, {options.generator} without recovery, {options.runs} runs a fault, base seed \
{options.seed}; it reads {", ".join(sorted(read))}

Runs with the fault that were detected, and (median seconds from activation to the first alert):
""")
    print(table(["fault", "target", "manifested", *options.arms], rows))
    print("\nWithout faults:\n")
    headers = [
        "arm",
        "hours",
        "false alarms",
        "per hour",
        "95 % upper bound",
        "patterns",
        "us/tick",
    ]
    print(table(headers, false_alarms([(job.arm, found[job]) for job in free], options.arms)))


if __name__ == "__main__":
    main()
