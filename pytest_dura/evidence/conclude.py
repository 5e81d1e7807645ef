"""Conclusions of a record: whatever follows from its cases, episodes and verdicts.

Coverage of requirements and parameters, effectiveness of recovery and monitors, missing
runs, timings, redactions and totals. All of it is computed in passes over the episodes,
by the session that writes the record and again by whoever verifies it.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

from pytest_dura.evidence.model import Counts, SessionRecord
from pytest_dura.evidence.redaction import count_redactions
from pytest_dura.evidence.sessions import origin_counts

Data = Mapping[str, Any]

_BINS = 10
"""Equal parts of a range."""


class ParameterCoverage:
    """Counts the values that valid episodes had, episode by episode.

    All cases of a scenario draw the same values from the same seed, so that each seed counts once.
    Memory grows with the seeds, by a number each.

    Args:
        cases: The record's cases; ``variation`` holds the ranges.
    """

    def __init__(self, cases: Iterable[Data]) -> None:
        self._scenarios: dict[str, dict[str, _Spread | _Choices]] = {}
        self._seen: set[tuple[str, str, int]] = set()
        for case in cases:
            spreads = self._scenarios.setdefault(case["scenario"], {})
            for path, given in case.get("variation", {}).items():
                spreads.setdefault(path, _Choices(given) if "choice" in given else _Spread(given))

    def add(self, episode: Data) -> None:
        """Take in a record of an episode, if it is a planned and valid one."""
        if not episode["planned"] or episode["validity"] != "valid":
            return
        spec = episode["spec"]
        scenario = spec["scenario"]["name"]
        for path, spread in self._scenarios.get(scenario, {}).items():
            key = scenario, path, spec["seed"]
            if key not in self._seen:
                value = _drawn_value(spec, path)
                if value is not _ABSENT and spread.takes(value):
                    self._seen.add(key)
                    spread.add(value)

    def to_json(self) -> list[dict[str, Any]]:
        """``{scenario, parameter, low, high, choices, drawn, least, greatest, bins, covered}``.

        ``bins`` counts the values in ten equal parts of a range, ``choices`` those of each choice;
        ``covered`` is the share of parts or choices with any.
        """
        return [
            {"scenario": scenario, "parameter": path, **spreads[path].to_json()}
            for scenario, spreads in sorted(self._scenarios.items())
            for path in sorted(spreads)
        ]


class _Spread:
    """An interval."""

    def __init__(self, given: Data) -> None:
        self.low, self.high = float(given["min"]), float(given["max"])
        self.least, self.greatest = math.inf, -math.inf
        self.bins = [0] * _BINS

    def takes(self, value: Any) -> bool:
        """Whether it is a number, or the numbers of an input over time."""
        return all(
            isinstance(path_piece, (int, float)) and not isinstance(path_piece, bool)
            for path_piece in _path_pieces(value)
        )

    def add(self, value: Any) -> None:
        for path_piece in _path_pieces(value):
            self._add(path_piece)

    def _add(self, value: float) -> None:
        share = (value - self.low) / (self.high - self.low) if self.high > self.low else 0.0
        self.bins[min(max(int(share * _BINS), 0), _BINS - 1)] += 1
        self.least, self.greatest = min(self.least, value), max(self.greatest, value)

    def to_json(self) -> dict[str, Any]:
        drawn = sum(self.bins)
        hit = sum(count > 0 for count in self.bins)
        # A range without width has but one part.
        parts = _BINS if self.high > self.low else 1
        return {
            "low": self.low,
            "high": self.high,
            "choices": None,
            "drawn": drawn,
            "least": self.least if drawn else None,
            "greatest": self.greatest if drawn else None,
            "bins": self.bins,
            "covered": hit / parts,
        }


class _Choices:
    """A list of values."""

    def __init__(self, given: Data) -> None:
        self.values: list[Any] = []
        for value in given["choice"]:
            if not any(_same_value(value, known) for known in self.values):
                self.values.append(value)
        self.counts = [0] * len(self.values)

    def takes(self, value: Any) -> bool:
        """Whether it is one of them."""
        return any(_same_value(known, value) for known in self.values)

    def add(self, value: Any) -> None:
        for i, known in enumerate(self.values):
            if _same_value(known, value):
                self.counts[i] += 1

    def to_json(self) -> dict[str, Any]:
        return {
            "low": None,
            "high": None,
            "choices": [
                {"value": value, "count": count}
                for value, count in zip(self.values, self.counts, strict=True)
            ],
            "drawn": sum(self.counts),
            "least": None,
            "greatest": None,
            "bins": [],
            "covered": sum(count > 0 for count in self.counts) / len(self.counts),
        }


_ABSENT = object()


def _drawn_value(spec: Data, path: str) -> Any:
    """What an episode's spec has at a path of a variation: ``world.x.y`` or ``faults.id.x``."""
    head, _, rest = path.partition(".")
    data: Any = spec["scenario"]["world"]
    if head == "faults":
        name, _, rest = rest.partition(".")
        data = next((fault for fault in spec["faults"] if fault["id"] == name), _ABSENT)
    for key in rest.split("."):
        if isinstance(data, Mapping):
            data = data.get(key, _ABSENT)
        elif isinstance(data, (list, tuple)) and key.isdecimal() and int(key) < len(data):
            data = data[int(key)]
        else:
            return _ABSENT
    return data


def _path_pieces(value: Any) -> list[Any]:
    return list(value) if isinstance(value, (list, tuple)) else [value]


def _same_value(item: Any, other: Any) -> bool:
    # To Python, True is 1; as values of a world they are two.
    return isinstance(item, bool) == isinstance(other, bool) and bool(item == other)


Place: TypeAlias = "tuple[str, str, str, str]"
"""Scenario, faults, requirement and component."""

MAX_CELLS = 20_000
"""Untested cells up to which all are listed; a grid of faults may cross with anything."""
NO_FAULTS = "none"
WORST_FIRST = ("violated", "undecided", "supported")


def coverage(
    cases: Sequence[Data], verdicts: Iterable[Data], episodes: Iterable[Data]
) -> dict[str, Any]:
    """The record's key ``coverage``.

    ``cells`` are requirement x scenario x faults, for each component: each scenario of the session
    with each set of faults that occurs anywhere in the session, and with none. A requirement has a
    cell where it applies: where the scenario lists it, or a test claims it there. ``verdict`` is
    the worst on that cell and ``None`` where there is none: untested. ``case`` is the id of the
    case that tests it. Cases without a role, the second runs of pairs, are no cells: nothing is
    claimed of them. Of untested cells that are too many one is listed for each requirement and
    scenario, so that none of these reads as tested throughout; ``left_out`` counts the others.

    Args:
        cases: The record's cases.
        verdicts: The record's verdicts.
        episodes: The record's episodes.
    """
    grid = _Grid(cases, verdicts)
    untested = grid.untested_count()
    shown = list(grid.untested() if untested <= MAX_CELLS else grid.first_untested())
    parameters = ParameterCoverage(cases)
    for episode in episodes:
        parameters.add(episode)
    names = ("scenario", "faults", "requirement", "component")
    return {
        "cells": sorted(
            map(grid.cell, (*grid.words, *shown)), key=lambda cell: [cell[name] for name in names]
        ),
        "left_out": untested - len(shown),
        "parameters": parameters.to_json(),
    }


class _Grid:
    """Requirements, scenarios and sets of faults of a session, and what was tried of them.

    Args:
        cases: The record's cases.
        verdicts: The record's verdicts.
    """

    def __init__(self, cases: Sequence[Data], verdicts: Iterable[Data]) -> None:
        whole = [case for case in cases if not case["without"]]
        self.components = sorted({case["component"] for case in whole})
        self.faults = sorted({"", *map(faults_of, whole)})
        self.ids: dict[tuple[str, str], str] = {}
        """Of the cases, by scenario and faults."""
        self.applies: dict[tuple[str, str], str] = {}
        """By scenario and requirement."""
        by_id: dict[str, Data] = {}
        for case in whole:
            scenario, by_id[case["id"]] = case["scenario"], case
            self.ids[scenario, faults_of(case)] = case["id"]
            for requirement in case["requirements"]:
                self.applies[scenario, requirement] = "scenario"
        self.words: dict[Place, str] = {}
        """The verdicts."""
        for verdict in verdicts:
            if verdict["case"] not in by_id:
                continue
            case = by_id[verdict["case"]]
            place = case["scenario"], faults_of(case)
            self.applies.setdefault((place[0], verdict["requirement"]), "test")
            key = *place, verdict["requirement"], verdict["component"]
            words = self.words.get(key, verdict["verdict"]), verdict["verdict"]
            self.words[key] = min(words, key=WORST_FIRST.index)

    def untested_count(self) -> int:
        """How many :meth:`untested` has, without going through what may be millions."""
        known = set(self.components)
        judged = sum(component in known for *_, component in self.words)
        return len(self.applies) * len(self.faults) * len(known) - judged

    def untested(self) -> Iterator[Place]:
        """Where a requirement applies and has no verdict."""
        for scenario, requirement in self.applies:
            for faults in self.faults:
                for component in self.components:
                    place = scenario, faults, requirement, component
                    if place not in self.words:
                        yield place

    def first_untested(self) -> Iterator[Place]:
        """The first of them for each scenario and requirement that has any."""
        for scenario, requirement in self.applies:
            places = (
                (scenario, faults, requirement, component)
                for faults in self.faults
                for component in self.components
            )
            found = next((place for place in places if place not in self.words), None)
            if found is not None:
                yield found

    def cell(self, place: Place) -> dict[str, Any]:
        """The cell of a place."""
        scenario, faults, requirement, component = place
        return {
            "requirement": requirement,
            "scenario": scenario,
            "faults": faults,
            "component": component,
            "case": self._case(scenario, faults),
            "applies": self.applies[scenario, requirement],
            "verdict": self.words.get(place),
        }

    def _case(self, scenario: str, faults: str) -> str:
        """The id of the case, also of one that was not run."""
        return self.ids.get((scenario, faults), f"{scenario}+{faults or NO_FAULTS}")


def faults_of(case: Data) -> str:
    """The ids of a case's faults, joined as in case ids; empty without any."""
    return "+".join(str(fault["id"]) for fault in case["faults"])


Key = tuple[str, str, int]
"""Case, component and run."""

RECOVERY_ROLE = "recovery_planner"
_SUMS = ("only_with", "only_without", "both", "neither", "acted_only_with", "acted_only_without",
         "acted_both", "acted_neither")  # fmt: skip


class PairedCourses:
    """How the runs went in which recovery acted, and their twins without it.

    Equal are runs whose performance values have the same least, greatest and last value, and which
    took the same time. What decided at a tick is left out: it differs wherever recovery acts.
    """

    def __init__(self, verdicts: Iterable[Data]) -> None:
        pairs = (
            (verdict["pairs"]["case"], verdict["case"], verdict["component"])
            for verdict in verdicts
            if verdict["pairs"] and verdict["pairs"]["without"] == RECOVERY_ROLE
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
    verdicts: Sequence[Data], monitors: Sequence[Data], courses: PairedCourses
) -> list[dict[str, Any]]:
    """What the record says under ``effectiveness``: recovery first, then each monitor, by name."""
    return [*_recovery_effects(verdicts, courses), *_monitor_effects(monitors)]


def _recovery_effects(verdicts: Sequence[Data], courses: PairedCourses) -> Iterator[dict[str, Any]]:
    sums: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    cases: dict[tuple[str, str], set[str]] = defaultdict(set)
    for verdict in verdicts:
        pairs = verdict["pairs"]
        if pairs and pairs["without"] == RECOVERY_ROLE and "only_with" in pairs:
            key = verdict["component"], verdict["requirement"]
            if verdict["case"] not in cases[key]:  # several tests may ask the same of a case
                cases[key].add(verdict["case"])
                sums[key].update({name: pairs[name] for name in _SUMS})
    for (component, requirement), counts in sorted(sums.items()):
        runs = courses.compared(component, cases[component, requirement])
        finding, detail = _recovery_finding(requirement, counts, runs)
        yield _entry(RECOVERY_ROLE, component, requirement, finding, detail)


def _recovery_finding(
    requirement: str, counts: Mapping[str, int], courses: tuple[int, int]
) -> tuple[str, str]:
    acted_runs, unchanged = courses
    pairs = sum(counts[name] for name in ("only_with", "only_without", "both", "neither"))
    violated = counts["only_without"] + counts["both"]
    prevented, introduced = counts["only_without"], counts["only_with"]
    what = f"of {violated} violations of {requirement} without it in {pairs} pairs"
    if acted_runs and unchanged == acted_runs:
        also = "" if violated else f"; nothing violated {requirement} without it either"
        text = f"changed nothing: the runs in which it acted ({acted_runs}) went as their twins"
        return "changed nothing", text + also
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


def _monitor_effects(monitors: Sequence[Data]) -> Iterator[dict[str, Any]]:
    by_target: dict[tuple[str, str], dict[str, Counter[str]]] = defaultdict(dict)
    for item in monitors:
        targets = by_target[item["component"], item["monitor"]]
        sums = targets.setdefault(item["target"], Counter())
        names = ("true_positives", "false_negatives", "false_positives", "true_negatives")
        sums.update({name: item[name] for name in names})
    for (component, monitor), targets in sorted(by_target.items()):
        finding, detail = _monitor_finding(targets)
        # An assessor speaks by alerts, which are judged as a monitor of their own.
        if monitor == "security_assessor" and finding in ("silent", "cannot be told"):
            continue
        yield _entry(monitor, component, None, finding, detail)


def _monitor_finding(targets: Mapping[str, Counter[str]]) -> tuple[str, str]:
    seen = {
        name: (item["true_positives"], item["true_positives"] + item["false_negatives"])
        for name, item in sorted(targets.items())
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
    if any(target["false_positives"] for target in targets.values()):
        return "warned of none", f"flagged other runs, and warned of none: {in_words}"
    return "silent", f"was silent in time: {in_words}"


def _entry(
    role: str, component: str, requirement: str | None, finding: str, detail: str
) -> dict[str, Any]:
    return {
        "role": role, "component": component, "requirement": requirement, "finding": finding,
        "detail": detail,
    }  # fmt: skip


_MAX_LISTED_RUNS = 100
"""Numbers of runs that are listed of a case at most."""


def verdicts_on_cases(verdicts: Iterable[Data]) -> Mapping[tuple[str, str], list[Data]]:
    """The verdicts that rest on each case and component; a comparison rests on two cases."""
    found: dict[tuple[str, str], list[Data]] = defaultdict(list)
    for verdict in verdicts:
        for case in dict.fromkeys(
            [verdict["case"], (verdict["pairs"] or {}).get("case", verdict["case"])]
        ):
            found[case, verdict["component"]].append(verdict)
    return found


def missing_runs(case: Data, verdicts: Iterable[Data], heard: Collection[int]) -> dict[str, Any]:
    """How many planned runs of a case never reported, and the numbers of the first of them.

    A run that a campaign was decided without is not missing.

    Args:
        case: Its record.
        verdicts: Those that rest on it, of :func:`verdicts_on_cases`.
        heard: Numbers of the planned runs that reported, whatever they came to.
    """
    needed = planned = 0
    for verdict in verdicts:
        needed = max(needed, verdict["planned"] - verdict["saved"])
        planned = max(planned, verdict["planned"])
    if case["planned"] > planned:
        needed = case["planned"]  # more than any verdict asked for, and so for something else
    left = [run for run in range(needed) if run not in heard]
    return {"missing_runs": left[:_MAX_LISTED_RUNS], "missing_runs_total": len(left)}


def timings(
    episodes: Iterable[Mapping[str, Any]], *, wall_seconds: float, evidence_seconds: float
) -> dict[str, Any]:
    """Sums over the recorded episodes, fault-free twins apart, which no verdict rests on.

    Args:
        episodes: Of the record.
        wall_seconds: From the start of the session until the record was complete.
        evidence_seconds: Those of them that the controller spent on gathering the evidence; traces
            are written where the episodes run, and rendering follows.
    """
    simulated, processing = 0.0, Counter[str]()
    for episode in episodes:
        simulated += episode["timings"]["simulated_seconds"]
        processing.update(episode["timings"]["processing_seconds"])
    return {
        "wall_seconds": wall_seconds,
        "evidence_seconds": evidence_seconds,
        "simulated_seconds": simulated,
        "processing_seconds": {role: processing[role] for role in sorted(processing)},
    }


def conclude_record(
    record: SessionRecord,
    *,
    finished: str | None,
    gate: Mapping[str, Any],
    inputs: Sequence[Mapping[str, Any]],
    wall_seconds: float,
    evidence_seconds: float,
    redact: Callable[[Any], Any],
) -> SessionRecord:
    """The record with gate, inputs, reuse, coverage, timings, redactions and totals.

    Args:
        record: Of :meth:`EvidenceRecord.record`.
        finished: When the session ended, in ISO 8601; ``None`` as long as it runs.
        gate: Whether the session passed.
        inputs: Every input file, with its digest.
        wall_seconds: From the session's start until now.
        evidence_seconds: Those of them that were spent on gathering the evidence.
        redact: Takes secrets out of plain data; episodes have lost theirs where they were run.
    """
    head = {
        **record.head,
        "finished": finished,
        "gate": dict(gate),
        "inputs": list(inputs),
        "reuse": {**record["reuse"], **origin_counts(record.episodes())},
        "coverage": coverage(record["cases"], record["verdicts"], record.episodes()),
        "timings": timings(
            record.episodes(), wall_seconds=wall_seconds, evidence_seconds=evidence_seconds
        ),
    }
    head = redact(head)
    hidden = count_redactions(head)
    for episode in record.episodes():
        hidden += count_redactions(episode)
    head["redacted"] = dict(sorted(Counter(hidden).items()))
    text = replace(record, head=head)
    return replace(text, head={**head, "totals": Counts.of(text).to_json()})
