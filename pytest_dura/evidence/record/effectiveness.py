"""What the runs show of recovery and monitors by themselves, also that they cannot show it."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

Data = Mapping[str, Any]
Key = tuple[str, str, int]
"""Case, component and run."""

RECOVERY = "recovery_planner"
_SUMS = ("only_with", "only_without", "both", "neither", "acted_only_with", "acted_only_without",
         "acted_both", "acted_neither")  # fmt: skip


class Courses:
    """How the runs went in which recovery acted, and their twins without it.

    Equal are runs whose performance values have the same least, greatest and last value, and which
    took the same time. What decided at a tick is left out: it differs wherever recovery acts.
    """

    def __init__(self, verdicts: Iterable[Data]) -> None:
        pairs = (
            (one["pairs"]["case"], one["case"], one["component"])
            for one in verdicts
            if one["pairs"] and one["pairs"]["without"] == RECOVERY
        )
        self._twins = {(twin, who): (own, who) for twin, own, who in pairs}
        self._own = set(self._twins.values())
        self._acted: dict[Key, int] = {}
        self._without: dict[Key, int] = {}

    def add(self, episode: Data) -> None:
        """Take in a planned episode of the record."""
        key = episode["case"], episode["component"]
        if episode["validity"] != "valid" or not episode["metrics"]["performance"]:
            return
        run = episode["spec"]["run"]
        if key in self._own and episode["outcome"]["switching"]["takeovers"]:
            self._acted[key[0], key[1], run] = _course(episode)
        elif (own := self._twins.get(key)) is not None:
            self._without[own[0], own[1], run] = _course(episode)

    def compared(self, component: str, cases: set[str]) -> tuple[int, int]:
        """Runs in which recovery acted and that have a twin, and those that went as their twin."""
        found = [
            (course, self._without[key])
            for key, course in self._acted.items()
            if key[0] in cases and key[1] == component and key in self._without
        ]
        return len(found), sum(own == twin for own, twin in found)


def _course(episode: Data) -> int:
    """A number that is equal for equal courses."""
    values = {
        name: tuple(sorted(spread.items()))
        for name, spread in episode["metrics"]["performance"].items()
        if name != "response_time"
    }
    return hash((episode["timings"]["simulated_seconds"], tuple(sorted(values.items()))))


def effectiveness(
    verdicts: Sequence[Data], monitors: Sequence[Data], courses: Courses
) -> list[dict[str, Any]]:
    """What the record says under ``effectiveness``: recovery first, then each monitor, by name."""
    return [*_recovery(verdicts, courses), *_monitors(monitors)]


def _recovery(verdicts: Sequence[Data], courses: Courses) -> Iterator[dict[str, Any]]:
    sums: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    cases: dict[tuple[str, str], set[str]] = defaultdict(set)
    for one in verdicts:
        pairs = one["pairs"]
        if pairs and pairs["without"] == RECOVERY and "only_with" in pairs:
            key = one["component"], one["requirement"]
            if one["case"] not in cases[key]:  # several tests may ask the same of a case
                cases[key].add(one["case"])
                sums[key].update({name: pairs[name] for name in _SUMS})
    for (component, requirement), counts in sorted(sums.items()):
        runs = courses.compared(component, cases[component, requirement])
        finding, detail = _of_recovery(requirement, counts, runs)
        yield _entry(RECOVERY, component, requirement, finding, detail)


def _of_recovery(
    requirement: str, counts: Mapping[str, int], courses: tuple[int, int]
) -> tuple[str, str]:
    acted_runs, unchanged = courses
    pairs = sum(counts[name] for name in ("only_with", "only_without", "both", "neither"))
    violated = counts["only_without"] + counts["both"]
    prevented, introduced = counts["only_without"], counts["only_with"]
    what = f"of {violated} violations of {requirement} without it in {pairs} pairs"
    if acted_runs and unchanged == acted_runs:
        also = "" if violated else f"; nothing violated {requirement} without it either"
        told = f"changed nothing: the runs in which it acted ({acted_runs}) went as their twins"
        return "changed nothing", told + also
    if introduced and not prevented:
        return "introduced", f"introduced {introduced} violations and prevented none {what}"
    if not violated:
        detail = (
            f"cannot be told here: none of {pairs} runs without it violated {requirement}, so that "
            "there was nothing to prevent"
        )
        return "cannot be told", detail
    if prevented:
        more = f", introduced {introduced}" if introduced else ", introduced none"
        return "prevented", f"prevented {prevented} {what}{more}"
    if counts["acted_both"]:
        return "prevented none", f"prevented none {what}, and acted in {counts['acted_both']}"
    return "never acted", f"acted in none {what}"


def _monitors(monitors: Sequence[Data]) -> Iterator[dict[str, Any]]:
    by_target: dict[tuple[str, str], dict[str, Counter[str]]] = defaultdict(dict)
    for one in monitors:
        targets = by_target[one["component"], one["monitor"]]
        sums = targets.setdefault(one["target"], Counter())
        names = ("true_positives", "false_negatives", "false_positives", "true_negatives")
        sums.update({name: one[name] for name in names})
    for (component, monitor), targets in sorted(by_target.items()):
        finding, detail = _of_monitor(targets)
        # An assessor speaks by alerts, which are judged as a monitor of their own.
        if monitor == "security_assessor" and finding in ("silent", "cannot be told"):
            continue
        yield _entry(monitor, component, None, finding, detail)


def _of_monitor(targets: Mapping[str, Counter[str]]) -> tuple[str, str]:
    seen = {
        name: (one["true_positives"], one["true_positives"] + one["false_negatives"])
        for name, one in sorted(targets.items())
    }
    happened = {name: counts for name, counts in seen.items() if counts[1]}
    if not happened:
        detail = (
            "cannot be told here: nothing that it is to warn of happened in runs without recovery "
            f"({', '.join(seen)})"
        )
        return "cannot be told", detail
    in_words = ", ".join(f"{name} {hits} of {of}" for name, (hits, of) in happened.items())
    if any(hits for hits, _ in happened.values()):
        return "warned", f"warned in time of {in_words}"
    if any(one["false_positives"] for one in targets.values()):
        return "warned of none", f"flagged other runs, and warned of none: {in_words}"
    return "silent", f"was silent in time: {in_words}"


def _entry(
    role: str, component: str, requirement: str | None, finding: str, detail: str
) -> dict[str, Any]:
    return {
        "role": role, "component": component, "requirement": requirement, "finding": finding,
        "detail": detail,
    }  # fmt: skip
