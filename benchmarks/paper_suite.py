"""What the paper finds, and what ``example_suites/paper`` shows of it, beside other planners.

Run: python benchmarks/paper_suite.py [--runs 5] [--untrained-runs 2] [--select '*']

Each planner drives the six scenarios with the paper's roles, with and without attack and recovery
on equal seeds: the fine-tuned model and the same model as it was published, both from the suite's
cassettes, ``tactical`` and ``random``. Tests are exact: McNemar's on pairs of runs.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

from machine import machine, table

from pytest_dura.core import REACTIONS
from pytest_dura.evidence import open_record
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.requirements.pairs import mcnemar

SUITE = Path(__file__).parents[1] / "example_suites" / "paper"
UNTRAINED = "untrained.sqlite"
ATTACKS = ("intersection/ghost-obstacle", "intersection/trajectory-spoofing")
ROLES = """import pytest

@pytest.fixture(scope="session")
def recovery_planner():
    return "emergency_brake"
"""
"""Conftest of a planner that is no language model."""
Runs = dict[int, EpisodeEntry]


@dataclass(frozen=True)
class Planner:
    """A planner and its runs.

    Args:
        name: Heading.
        record: Of its session.
        arms: Its valid runs by case.
    """

    name: str
    record: SessionRecord
    arms: dict[str, Runs]

    @property
    def scenarios(self) -> list[str]:
        """The scenarios, each with its own faults and with recovery."""
        return [case for case in self.arms if "+" not in case and "~" not in case]


def session(name: str, options: Sequence[str], *, suite: bool) -> Planner:
    """Run a session, and read its record."""
    with tempfile.TemporaryDirectory() as folder:
        project = Path(folder, "project")
        if suite:
            shutil.copytree(SUITE, project, ignore=shutil.ignore_patterns("train", "dura-evidence"))
        else:
            project.mkdir()
            (project / "conftest.py").write_text(ROLES)
            (project / "pytest.ini").write_text("[pytest]\naddopts = --dura-scenarios\n")
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options]
        done = subprocess.run(command, cwd=project, capture_output=True, text=True, check=False)
        if done.returncode not in (0, 1):
            sys.exit(done.stdout + done.stderr)
        record = open_record(project / "dura-evidence" / "evidence.json")
        arms: dict[str, Runs] = {}
        for episode in record.episodes():
            if episode.validity == "valid":
                arms.setdefault(episode.case, {})[episode.spec.run] = episode
        return Planner(name, record, arms)


def collided(episode: EpisodeEntry) -> bool:
    """Whether a run ended in a collision."""
    return bool(episode.outcome.measures.get("collided"))


def pairs(planner: Planner, case: str, other: str) -> Iterator[tuple[EpisodeEntry, EpisodeEntry]]:
    """Runs of equal seeds of two arms."""
    first, second = planner.arms.get(case, {}), planner.arms.get(other, {})
    yield from ((first[run], second[run]) for run in first if run in second)


def discordant(shown: Sequence[tuple[bool, bool]]) -> str:
    """Pairs that show it in the first run alone, in the second alone, of all, and the p-value."""
    first = sum(a and not b for a, b in shown)
    second = sum(b and not a for a, b in shown)
    return f"{first} / {second} of {len(shown)} (p = {mcnemar(first, second):.2g})"


def findings(planner: Planner) -> Iterator[str]:
    """A cell for each finding of the paper's section V, in the order of :data:`FINDINGS`."""
    runs = [run for case in planner.scenarios for run in planner.arms[case].values()]
    flags = sum(run.outcome.flagged for run in runs)
    yield f"{100 * flags / len(runs):.1f} % of {len(runs)}"
    hits = sum(map(collided, runs))
    yield f"{100 * hits / len(runs):.1f} % of {len(runs)}"
    for attack in ATTACKS:
        both = list(pairs(planner, attack, f"{attack}+none"))
        yield discordant([(with_it.outcome.flagged, without.outcome.flagged)
                          for with_it, without in both])  # fmt: skip
        changes = [
            with_it.outcome.measures["clearance_time"] - without.outcome.measures["clearance_time"]
            for with_it, without in both
            if with_it.outcome.measures["clearance_time"] is not None
            and without.outcome.measures["clearance_time"] is not None
        ]
        yield f"{mean(changes):+.1f} s ({len(changes)})" if changes else "-"
        attacked = planner.arms[attack].values()
        stuck = sum(bool(run.outcome.measures["gridlock"]) for run in attacked)
        yield f"{stuck} of {len(attacked)}"
        reactions: Counter[str] = Counter()
        for run in attacked:
            reactions.update(run.metrics.reactions)
        yield " / ".join(str(reactions[kind]) for kind in REACTIONS)
    both = [
        (collided(without), collided(with_it))
        for case in planner.scenarios
        for with_it, without in pairs(planner, case, f"{case}~recovery_planner")
    ]
    yield discordant(both)


FINDINGS = (
    ("runs with an unsafe proposal", "38.9 % of 90"),
    ("runs with a collision", "8.9 % of 90"),
    ("ghost: flagged only with the attack / only without", "attacks set off the monitor"),
    ("ghost: change of clearance time", "longer"),
    ("ghost: gridlock", "-"),
    ("ghost: unaffected / erratic / frozen / follows the fake", "it follows the ghost"),
    ("spoofing: flagged only with the attack / only without", "attacks set off the monitor"),
    ("spoofing: change of clearance time", "longer"),
    ("spoofing: gridlock", "3 of 15"),
    ("spoofing: unaffected / erratic / frozen / follows the fake", "it waits"),
    ("collisions that recovery prevented / introduced", "it prevented some (by inspection)"),
)
"""What is compared, and what the paper says of it."""


def failure_modes(planners: Sequence[Planner]) -> list[list[str]]:
    """Rows of the failure modes that a decision of any of the models could have shown."""
    counts: dict[str, list[Counter[str]]] = {}
    for number, planner in enumerate(planners):
        for case in planner.scenarios:
            for run in planner.arms[case].values():
                for name, tally in run.metrics.tallies.items():
                    sums = counts.setdefault(name, [Counter() for _ in planners])[number]
                    sums.update(hits=tally.hits, of=tally.of, null=tally.null_hits,
                                null_of=tally.null_of)  # fmt: skip
    return [
        [
            f"`{name}`",
            *(f"{each['hits']} of {each['of']}" for each in sums),
            f"{sums[0]['null']} of {sums[0]['null_of']}",
        ]
        for name, sums in counts.items()
        if any(each["of"] for each in sums)
    ]


def main() -> None:
    """Run the sessions, and print three tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--runs", type=int, default=5, help="of the fine-tuned model and the others"
    )
    parser.add_argument("--untrained-runs", type=int, default=2, help="of the model as published")
    parser.add_argument("--select", default="*", help="scenarios, with those of both attacks")
    given = parser.parse_args()
    chosen = f"--dura-select={given.select}"
    runs = f"--dura-runs={given.runs}"
    untrained = (
        chosen,
        f"--dura-runs={given.untrained_runs}",
        f"--dura-cassette={UNTRAINED}",
        "--dura-time-budget=600",  # it was recorded beside other work: up to 99 s an answer
    )
    models = [session("fine-tuned", [chosen, runs], suite=True)]
    if (SUITE / UNTRAINED).is_file():
        models.append(session("as published", untrained, suite=True))
    others = [
        session(name, [chosen, runs, f"--dura-generator={name}"], suite=False)
        for name in ("tactical", "random")
    ]
    print(f"{machine()}\n")
    shown = models[0].record.head.conclusions["paper"]
    headers = [f"{column.name} {column.unit}".strip() for column in shown.columns]
    print(table(headers, [[str(cell) for cell in row] for row in shown.rows]) + "\n")
    planners = [*models, *others]
    columns = [list(findings(planner)) for planner in planners]
    rows = [
        [what, paper, *(column[number] for column in columns)]
        for number, (what, paper) in enumerate(FINDINGS)
    ]
    print(table(["finding", "paper", *(each.name for each in planners)], rows) + "\n")
    names = [each.name for each in models]
    print(table(["failure mode", *names, "null component"], failure_modes(models)))


if __name__ == "__main__":
    main()
