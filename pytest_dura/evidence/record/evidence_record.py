"""EvidenceRecord: gathers what the items of a session report and makes the record of it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from pytest_dura.evidence.record.attempts import (
    assertions,
    final_outcomes,
    judged_looks,
    question,
    test_of,
)
from pytest_dura.evidence.record.case_metrics import CaseMetrics, Pooled, in_order
from pytest_dura.evidence.record.components import Components
from pytest_dura.evidence.record.effectiveness import Courses, effectiveness
from pytest_dura.evidence.record.episodes import add_run, situations_of
from pytest_dura.evidence.record.faults import SharedViolations
from pytest_dura.evidence.record.item_report import unpacked
from pytest_dura.evidence.record.missing_runs import missing_runs, verdicts_on_cases
from pytest_dura.evidence.record.models import Models
from pytest_dura.evidence.record.repeats import REPEAT, worse
from pytest_dura.evidence.record.reuse import ALONE, Reuse
from pytest_dura.evidence.record.searches import Searches
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.evidence.record.spool import EpisodeSpool
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.verdicts.judging import judge_campaign
from pytest_dura.requirements.verdicts.situations import Situations

SCHEMA_VERSION = "2"
NO_QUESTION = {"check": "", "paired": None}
"""Of a verdict that no campaign was asked for."""
UNKNOWN = "unknown"
"""The name of a component that a conftest defines, until the first episode tells it."""

Status = Literal["running", "complete", "interrupted"]
Data = dict[str, Any]


@dataclass
class EvidenceRecord:
    """The record of a session while it grows. The same report may come twice.

    Args:
        header: ``created``, ``tool``, ``command``, ``base_seed``, ``environment``.
        directory: The bundle's, on whose disk the episodes are kept: in memory there are few.
            Without one they are in a temporary file of the system.

    Raises:
        ConfigurationError: If the directory cannot be made or written.
    """

    header: Data
    directory: Path | None = None
    searches: Searches = field(default_factory=Searches, init=False)
    objections: dict[str, None] = field(default_factory=dict, init=False)
    """What items say that stands against the session, whatever its verdicts say."""
    _components: Components = field(default_factory=Components)
    _requirements: dict[str, Data] = field(default_factory=dict)
    _cases: dict[tuple[str, str], Data] = field(default_factory=dict)
    _components_of: dict[str, list[str]] = field(default_factory=dict)
    """By the id of a case."""
    _spool: EpisodeSpool = field(init=False)
    _verdicts: dict[tuple[str, ...], Data] = field(default_factory=dict)
    _outcomes: dict[tuple[str, ...], dict[str, Data]] = field(default_factory=dict)
    _monitors: dict[tuple[str, ...], Data] = field(default_factory=dict)
    _expected: dict[tuple[str, str, str], Data] = field(default_factory=dict)
    _waivers: dict[str, Data] = field(default_factory=dict)
    _first_waived: dict[str, str] = field(default_factory=dict)
    """The first item of each test that was waived."""
    _clashes: dict[tuple[str, str], str] = field(default_factory=dict)
    _models: Models = field(default_factory=Models)
    _problems: set[str] = field(default_factory=set)
    _reuse: Reuse = field(default_factory=Reuse)
    _ran: set[str] = field(default_factory=set)
    """Cases with any episode."""
    _repeats: dict[tuple[str, str], Data] = field(default_factory=dict)
    _situations: dict[tuple[str, str], Situations] = field(default_factory=dict)
    """Of the planned episodes of each case with a component."""

    def __post_init__(self) -> None:
        """Make room for the episodes."""
        self._spool = EpisodeSpool(self.directory)

    def close(self) -> None:
        """Forget the episodes, also those of records that were made of them."""
        self._spool.close()

    def expect(self, item: str, requirement: Data, case: Data) -> None:
        """A campaign's item that will run; if it never reports, its verdict is undecided."""
        self._expected[item, requirement["id"], case["id"]] = case
        self._requirements.setdefault(requirement["id"], requirement)

    def add(self, report: Mapping[str, Any]) -> None:
        """What an item told, all that :class:`ItemReport` has.

        Raises:
            ConfigurationError: If its episodes cannot be kept.
        """
        for part in report["parts"]:
            self.add(unpacked(part))
        item = report["item"]
        for claim in report["claims"]:
            case, decides = claim["case"], test_of(item) if claim["each_run"] else item
            self._expected.setdefault((decides, claim["requirement"], case["id"]), case)
        for component in report["components"]:
            self._components.add(component)
        self._components.add_sources(report.get("sources", {}))
        for requirement in report["requirements"]:
            self._requirements.setdefault(requirement["id"], requirement)
        for case in report["cases"]:
            self._add_case(case)
        self._add_episodes(report)
        for repeat in report["repeats"]:
            about = repeat["case"], repeat["component"]
            told = {name: repeat[name] for name in REPEAT}
            self._repeats[about] = dict(worse(self._repeats.get(about), told) or told)
        self._models.add(report["models"])
        self._problems.update(report["problems"])
        self.objections.update(dict.fromkeys(report["objections"]))
        self._reuse.add(report)
        for verdict in report["verdicts"]:
            self._add_verdict(item, verdict)
        self.searches.add(item, report["searches"])
        for monitor in report["monitors"]:
            key = tuple(monitor[name] for name in ("case", "component", "target", "monitor"))
            self._monitors[key] = monitor
        for outcome in report["outcomes"]:
            # What two tests make of one episode are two answers, and no attempts at one.
            key = test_of(item), outcome["requirement"], outcome["case"], outcome["component"]
            told = outcome | {"item": item}
            self._outcomes.setdefault(key, {})[json.dumps(told, sort_keys=True)] = told

    def add_traces(self, traces: Iterable[Data]) -> None:
        """Where traces of episodes are: ``{id, component, digest, trace}``, in any order.

        Raises:
            ConfigurationError: If that cannot be kept.
        """
        for trace in traces:
            self._spool.add_trace(trace)

    def adopt(self, verdict: Data) -> None:
        """A verdict as another session came to it, with its item, its waiver and its attempts."""
        self._verdicts[question(verdict["item"], verdict)] = verdict

    def waive(self, item: str, kind: str, reason: str) -> None:
        """The item's failure was excused: ``xfail``, ``rerun`` or ``skip``."""
        self._waivers[item] = {"kind": kind, "reason": reason}
        self._first_waived.setdefault(test_of(item), item)

    @property
    def problems(self) -> list[str]:
        """What casts doubt on the whole session; each begins with ``infrastructure:``."""
        return sorted({*self._clashes.values(), *self._problems, *self._components.problems()})

    def record(self, status: Status) -> SessionRecord:
        """The record, with the keys of the design; its episodes are read as long as it is open.

        Raises:
            ConfigurationError: If the episodes cannot be read.
        """
        self._add_unheard_cases()
        verdicts = self.verdicts()
        shared = SharedViolations(verdicts)
        courses = Courses(verdicts)
        cases, overall = self._measured_cases(verdicts, shared, courses)
        monitors = [self._monitors[key] for key in sorted(self._monitors)]
        counts = zip(verdicts, shared.to_json(), strict=True)
        head = {
            "schema_version": SCHEMA_VERSION,
            "status": status,
            **self.header,
            "reuse": self._reuse.to_json(self.header.get("reuse", ALONE)),
            "component_under_test": self._components.to_json(),
            "models": self._models.to_json(),
            "requirements": [self._requirements[name] for name in sorted(self._requirements)],
            "cases": cases,
            "verdicts": [{**verdict, "also_without": count} for verdict, count in counts],
            "searches": self.searches.to_json(self._waivers),
            "monitors": monitors,
            "overall": overall,
            "effectiveness": effectiveness(verdicts, monitors, courses),
        }
        return SessionRecord(head, self.directory or Path(), self._spool.__iter__)

    def verdicts(self) -> list[Data]:
        """All verdicts, also of campaigns that never reported, sorted by case and requirement."""
        found = [dict(verdict) for verdict in self._verdicts.values()]
        found += [
            self._of_outcomes(key, list(told.values())) for key, told in self._outcomes.items()
        ]
        heard = {(one["item"], one["requirement"], one["case"]) for one in found}
        for claim, case in self._unsearched():
            if claim not in heard:
                found.append(self._not_run(*claim[:2], case))
        for verdict in found:
            self._qualify(verdict)
        return sorted(found, key=lambda one: (one["case"], one["requirement"], one["item"]))

    def _add_case(self, case: Data) -> None:
        key = case["id"], case["component"]
        if key not in self._cases:
            self._cases[key] = dict(case)
            self._components_of.setdefault(case["id"], []).append(case["component"])
        known = self._cases[key]
        known["planned"] = max(known["planned"], case["planned"])

    def _add_episodes(self, report: Mapping[str, Any]) -> None:
        """The episodes of a report, and what it tells of them beside."""
        for episode in report["episodes"]:
            self._ran.add(episode["case"])
            self._add_situation(episode)
            first = self._spool.add(episode)
            if first != episode["digest"]:
                self._clashes[episode["case"], episode["component"]] = (
                    f"infrastructure: nondeterministic: the episode {episode['id']} was run twice, "
                    f"with the digests {first[:12]} and {episode['digest'][:12]}"
                )
        for chain in report["chains"]:
            self._spool.add_chain(chain)
        self.add_traces(report["traces"])

    def _add_situation(self, episode: Data) -> None:
        key = episode["case"], episode["component"]
        if not episode["planned"] or key not in self._cases:
            return
        if key not in self._situations:
            self._situations[key] = situations_of(self._cases[key])
        add_run(self._situations[key], episode)

    def _add_verdict(self, item: str, verdict: Data) -> None:
        # The same item may ask several questions; what is asked again is another attempt.
        key = question(item, verdict)
        before = self._verdicts.get(key)
        new = {**verdict, "item": item, "waiver": None, "attempts": [], "assertion": None}
        if before is None:
            self._verdicts[key] = new
            return
        told = {name: value for name, value in before.items() if name in verdict}
        if told == verdict:
            return
        # Of several attempts a violation counts before anything else; all of them are kept.
        new["attempts"] = [*before["attempts"], told]
        if before["verdict"] == "violated":
            new = {**before, "attempts": [*before["attempts"], verdict]}
        self._verdicts[key] = new

    def _of_outcomes(self, key: tuple[str, ...], told: list[Data]) -> Data:
        """The verdict of a test that looks at one episode at a time."""
        test, requirement, case, component = key
        final = final_outcomes(told)
        known = self._situations.get((case, component))
        situation = None if known is None else known.situation
        verdict = judged_looks(self._requirement(requirement), case, component, told, situation)
        waiver = self._waiver_of(final, verdict)
        own: Data = {"item": test, "waiver": waiver, "attempts": [], "assertion": assertions(final)}
        return {**verdict, **NO_QUESTION, **own}

    def _waiver_of(self, final: list[Data], verdict: Data) -> Data | None:
        """What excuses the verdict: nothing, if there is more than what waived items told."""
        waivers = [self._waivers[one["item"]] for one in final if one["item"] in self._waivers]
        bad = {one["item"] for one in final if one["verdict"] != "satisfied"}
        excused = bad <= self._waivers.keys() and verdict["run"] >= verdict["planned"]
        return waivers[0] if waivers and excused else None

    def _add_unheard_cases(self) -> None:
        """Cases that are expected, and of which nothing was heard."""
        heard = set(self._components_of)
        for _, case in self._unsearched():
            if case["id"] not in heard:
                self._add_case(self._with_component(case))

    def _unsearched(self) -> list[tuple[tuple[str, str, str], Data]]:
        """What items are to decide, but for what they looked for violations of instead."""
        answered = self.searches.answered
        return [claim for claim in self._expected.items() if claim[0] not in answered]

    def _with_component(self, case: Data) -> Data:
        """An expected case with the component's name as far as the session has told it by now."""
        if case["component"] != UNKNOWN:
            return case
        names = self._components_of.get(case["id"]) or self._components.names
        return {**case, "component": names[0]} if len(names) == 1 else case

    def _not_run(self, item: str, requirement: str, case: Data) -> Data:
        case = self._with_component(case)
        verdict = judge_campaign(
            self._requirement(requirement),
            case["id"],
            [],
            planned=case["planned"],
            component=case["component"],
        ).to_json()
        if item != f"{case['id']}::{requirement}":
            # Its episodes may have run: what was not made is the verdict.
            verdict["reason"] = "the test ended without a verdict on it"
        elif case["id"] in self._ran:
            verdict["reason"] = "episodes of the case ran, and no verdict was made on them"
        waived = self._first_waived.get(item)
        waiver = None if waived is None else self._waivers[waived]
        own: Data = {"item": item, "waiver": waiver, "attempts": [], "assertion": None}
        return {**verdict, **NO_QUESTION, **own}

    def _requirement(self, name: str) -> Requirement:
        return Requirement.from_json(self._requirements.get(name, {"id": name}))

    def _qualify(self, verdict: Data) -> None:
        """Take waivers into account, and doubts about the case's episodes."""
        verdict["waiver"] = self._waivers.get(verdict["item"], verdict["waiver"])
        clash = self._clashes.get((verdict["case"], verdict["component"]))
        if clash is not None and verdict["verdict"] == "supported":
            verdict["verdict"], verdict["reason"] = "undecided", clash

    def _measured_cases(
        self, verdicts: list[Data], shared: SharedViolations, courses: Courses
    ) -> tuple[list[Data], list[Data]]:
        """The cases with what their planned episodes come to, and all of a component together.

        Cases come in the order that their scenarios give, then by name.
        """
        metrics = {key: CaseMetrics() for key in self._cases}
        pooled = Pooled(self._cases.values(), verdicts)
        heard: dict[tuple[str, str], set[int]] = {key: set() for key in self._cases}
        for episode in self._spool:
            key = episode["case"], episode["component"]
            if episode["planned"] and key in metrics:
                metrics[key].add(episode)
                pooled.add(episode)
                shared.add(episode)
                courses.add(episode)
                heard[key].add(episode["spec"]["run"])
        judged = verdicts_on_cases(verdicts)
        cases = [
            {
                **self._cases[key],
                "metrics": metrics[key].to_json(self._cases[key]["planned"]),
                "repeat": self._repeats.get(key),
                **missing_runs(self._cases[key], judged.get(key, []), heard[key]),
            }
            for key in sorted(self._cases, key=lambda key: in_order(self._cases[key]))
        ]
        return cases, pooled.to_json()
