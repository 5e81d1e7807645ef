"""RecordBuilder: collects the lines of a session, and makes the record of them."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Collection, Hashable, Iterable
from dataclasses import dataclass, field, fields, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal, TypeVar

from pytest_dura.core.episode import canonical
from pytest_dura.core.measures import MeasureInfo
from pytest_dura.evidence.case_model import CasePlan, RepeatEntry
from pytest_dura.evidence.conclude import conclude
from pytest_dura.evidence.conclusions.cases import CaseMetrics
from pytest_dura.evidence.conclusions.judgements import judgement_order
from pytest_dura.evidence.conclusions.verdicts import UNKNOWN_COMPONENT
from pytest_dura.evidence.entry import JsonObject
from pytest_dura.evidence.episodes import EpisodeSpool
from pytest_dura.evidence.gate import Gate, worse_repeat
from pytest_dura.evidence.item_verdicts import Waiver, WaiverKind
from pytest_dura.evidence.lines import (
    ClaimedCase,
    EpisodeLine,
    FaultTrace,
    KeptTrace,
    Line,
    Remark,
    RepeatedCase,
    SearchedRun,
    SignalUnit,
    UsedComponent,
)
from pytest_dura.evidence.model import COUNTED, Fact, RecordHead, SessionRecord
from pytest_dura.evidence.searches import (
    RecordedSearch,
    search_entries,
    searched_claims,
    searched_question,
)
from pytest_dura.evidence.sessions import resume_json
from pytest_dura.requirements.hazards import Hazard
from pytest_dura.requirements.judgements import Doubt, Judgement
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.monitoring.quality import MonitorQuality

_T = TypeVar("_T")


def _components_json(components: Iterable[UsedComponent]) -> JsonObject:
    """Convert to the first one by name, with all ``others`` and the ``sources`` of all."""
    ordered = sorted(components, key=lambda each: (each.description["name"], _described(each)))
    known = [each.description for each in ordered]
    first: JsonObject = (
        dict(known[0]) if known else dict.fromkeys(("name", "distribution", "version", "digest"))
    )
    if len(known) > 1:
        first["others"] = known[1:]
    sources = {each.description["digest"]: each.sources for each in ordered if each.sources}
    if sources:
        first["sources"] = dict(sorted(sources.items()))
    return first


def _described(component: UsedComponent) -> bytes:
    about = component.description
    return canonical([about.get("path"), about.get("params"), about])


def _most_planned(known: CasePlan, other: CasePlan) -> CasePlan:
    return known if known.planned >= other.planned else known.replace(planned=other.planned)


def _first(known: Line, _: Line) -> Line:
    return known


def _last(_: Line, other: Line) -> Line:
    return other


_about_monitor = attrgetter("case", "component", "target", "monitor")
_SAME: dict[type[Any], tuple[Callable[[Any], Hashable], Callable[[Any, Any], Any]]] = {
    CasePlan: (attrgetter("id", "component"), _most_planned),
    ClaimedCase: (attrgetter("id"), _first),
    Doubt: (attrgetter("case", "component"), _first),
    Fact: (attrgetter("table", "about", "process"), _last),
    Hazard: (attrgetter("id"), _first),
    MonitorQuality: (_about_monitor, _last),
    RecordedSearch: (searched_question, _first),
    RepeatedCase: (attrgetter("case", "component"), worse_repeat),
    Requirement: (attrgetter("id"), _first),
    SearchedRun: (attrgetter("run"), _first),
    UsedComponent: (_described, _first),
}
"""What two lines of a kind have in common that are about one thing, and which one stays; of other
kinds equal lines are one."""


SCHEMA_VERSION = "5"
_REPEAT_KEYS = {each.name for each in fields(RepeatEntry)}
_UNCONCLUDED: JsonObject = {
    "overall": [],
    "effectiveness": [],
    "baseline": None,
    "finished": None,
    "gate": Gate.running(warn_undecided=False),
    "inputs": [],
    "coverage": {"cells": [], "left_out": 0, "parameters": []},
    "conclusions": {},
    "timings": {"wall_seconds": 0, "evidence_seconds": 0, "simulated_seconds": 0,
                "processing_seconds": {}},
    "redacted": {},
    "totals": {"gate": "incomplete", **dict.fromkeys(COUNTED, 0)},
}  # fmt: skip
"""What follows from the rest of the record, until it is concluded and completed."""
_NO_EPISODES: JsonObject = {"taken_over": 0, "sessions": [], "outdated": []}


def claim(item: str, requirement: str, case: CasePlan) -> Judgement:
    """Make the judgement of what an item is to decide, before it does.

    Args:
        item: Node id of the item; of a test on single episodes without its parameters.
        requirement: Id of the requirement.
        case: The case.
    """
    return Judgement(
        "claim", requirement, case.id, case.component, case.planned, item=item, decides=item
    )


Status = Literal["running", "complete", "interrupted"]


@dataclass
class RecordBuilder:
    """Builds the record of a session from lines. The same line may come twice.

    Args:
        header: ``created``, ``tool``, ``command``, ``base_seed``, ``environment``.
        directory: The bundle's, where episodes are kept on disk. Without one they are in a
            temporary file of the system.

    Raises:
        ConfigurationError: If the directory cannot be made or written.
    """

    header: JsonObject
    directory: Path | None = None
    _spool: EpisodeSpool = field(init=False)
    _lines: dict[type[Any], dict[Hashable, Any]] = field(default_factory=dict, init=False)
    """All that is not in the spool, by kind and by what it is about."""
    _waivers: dict[str, Waiver] = field(default_factory=dict)
    _failed: set[str] = field(default_factory=set)
    """Items that failed in the end."""
    _stopped: dict[str, str] = field(default_factory=dict)
    """Why items failed, as far as that is known."""

    def __post_init__(self) -> None:
        """Open the spool for the episodes."""
        self._spool = EpisodeSpool(self.directory)

    def close(self) -> None:
        """Delete the episodes; records that were made of them can no longer be read."""
        self._spool.close()

    def add(self, lines: Iterable[Line]) -> None:
        """Add what items report, or are expected to.

        Raises:
            ConfigurationError: If episodes cannot be written.
        """
        for line in lines:
            if isinstance(line, EpisodeLine):
                episode, first = line.entry, self._spool.add(line.entry)
                if first != episode["digest"]:
                    reason = (
                        f"infrastructure: nondeterministic: the episode {episode['id']} was run "
                        f"twice, with the digests {first[:12]} and {episode['digest'][:12]}"
                    )
                    self._keep(Doubt(episode["case"], episode["component"], reason))
            elif isinstance(line, FaultTrace):
                self._spool.add_chain(line)
            elif isinstance(line, KeptTrace):
                self._spool.add_trace(line)
            elif isinstance(line, Remark) and line.kind == "retried":
                self.waive(line.text, "rerun", "the item was run again")
            else:
                self._keep(line)

    def _keep(self, line: Line) -> None:
        about, chosen = _SAME.get(type(line), (lambda same: same, _first))
        lines, key = self._lines.setdefault(type(line), {}), about(line)
        known = lines.setdefault(key, line)
        if known is not line:
            lines[key] = chosen(known, line)

    def _all(self, kind: type[_T]) -> Collection[_T]:
        """All lines of a kind that stayed, in the order in which they came."""
        return self._lines.get(kind, {}).values()

    def waive(self, item: str, kind: WaiverKind, reason: str) -> None:
        """Record that an item's failure is excused: ``xfail``, ``rerun`` or ``skip``.

        That an item was run again excuses nothing if it failed all the same; see :meth:`fail`.
        """
        if kind == "rerun" and item in self._failed:
            return
        self._waivers[item] = Waiver(kind, reason)

    def fail(self, item: str, why: str = "") -> None:
        """Record that an item failed in the end, however often it was run.

        Args:
            item: Its node id.
            why: What stopped it, kept where it judged no run; empty where that is not known.
        """
        self._failed.add(item)
        self._stopped |= {item: why} if why else {}
        if item in self._waivers and self._waivers[item].kind == "rerun":
            del self._waivers[item]

    def _remarks(self, kind: str) -> list[str]:
        return [remark.text for remark in self._all(Remark) if remark.kind == kind]

    @property
    def problems(self) -> list[str]:
        """Doubts about the whole session; each begins with ``infrastructure:``."""
        measures = self._measures()
        differing = (
            f"infrastructure: two simulators declare the measure {each.name!r} "
            f"differently: {measures[each.name].function} and {each.function}"
            for each in self._all(MeasureInfo)
            if measures[each.name] != each
        )
        doubts = {doubt.reason for doubt in self._all(Doubt)}
        paths_of: dict[str, set[str]] = defaultdict(set)
        for component in self._all(UsedComponent):
            about = component.description
            paths_of[about["name"]].add(str(about.get("path")))
        namesakes = (
            f"infrastructure: several components are called {name}, and verdicts go by that name: "
            f"{', '.join(sorted(paths))}; rename all but one, or test them in sessions of their own"
            for name, paths in paths_of.items()
            if len(paths) > 1
        )
        return sorted({*doubts, *self._remarks("problem"), *differing, *namesakes})

    @property
    def objections(self) -> list[str]:
        """Reasons of items why the session does not pass, in order."""
        return self._remarks("objection")

    def _measures(self) -> dict[str, MeasureInfo]:
        """The measures by name; of several the first one holds."""
        return {each.name: each for each in reversed([*self._all(MeasureInfo)])}

    def record(self, status: Status) -> SessionRecord:
        """Make the record; its episodes can be read until the builder is closed.

        Raises:
            ConfigurationError: If the episodes cannot be read.
        """
        lines = SessionRecord(self.head(status), self.directory or Path(), self._spool.__iter__)
        return conclude(lines)

    def head(self, status: Status) -> RecordHead:
        """Make the head of the record, apart from what follows from its episodes."""
        cases = self._cases()
        repeats = {(each.case, each.component): each for each in self._all(RepeatedCase)}
        failed: dict[str, Any] = {"failed_items": sorted(self._failed)} if self._failed else {}
        judged = {each.item for each in self._all(Judgement) if each.runs}
        if stopped := {item: self._stopped[item] for item in sorted(self._stopped.keys() - judged)}:
            failed["stopped_items"] = stopped
        hazards = sorted(self._all(Hazard), key=attrgetter("id"))
        facts = sorted(self._all(Fact), key=attrgetter("table", "order", "about", "process"))
        return RecordHead.from_data(
            {
                **_UNCONCLUDED,
                **self.header,
                "schema_version": SCHEMA_VERSION,
                "status": status,
                "resume": {
                    **_NO_EPISODES,
                    **resume_json(
                        self.header["resume"],
                        [each.origin for each in self._all(SearchedRun)],
                        self._remarks("note"),
                    ),
                },
                "component_under_test": _components_json(self._all(UsedComponent)),
                "measures": sorted(self._measures().values(), key=attrgetter("place", "name")),
                **({"units": units} if (units := self._units()) else {}),
                **({"hazards": hazards} if hazards else {}),
                **({"facts": facts} if facts else {}),
                "requirements": sorted(self._all(Requirement), key=attrgetter("id")),
                "cases": [
                    {
                        **case.to_json(),
                        # What `conclude` computes of a case, before it does.
                        "metrics": CaseMetrics().entry(case.planned),
                        "missing_runs": [],
                        "missing_runs_total": 0,
                        "repeat": repeats[key].to_json(include=_REPEAT_KEYS)
                        if key in repeats
                        else None,
                    }
                    for key, case in cases.items()
                ],
                "judgements": self._answerable_judgements(),
                **failed,
                "waivers": {item: self._waivers[item] for item in sorted(self._waivers)},
                "doubts": sorted(self._all(Doubt), key=attrgetter("case", "component")),
                "verdicts": [],
                "searches": search_entries(self._all(RecordedSearch), self._waivers),
                "monitors": sorted(self._all(MonitorQuality), key=_about_monitor),
            }
        )

    def _units(self) -> dict[str, str]:
        """Units of the signals that checks name; one that is declared differently has none."""
        declared: dict[str, set[str]] = defaultdict(set)
        for each in self._all(SignalUnit):
            declared[each.signal].add(each.unit)
        checks = [each.check for each in self._all(Requirement)]
        checks += [each.check for each in self._all(Judgement)]
        searched = (search.outcomes for search in self._all(RecordedSearch))
        checks += [each.check for outcomes in searched for each in outcomes]
        named = {word for check in checks for word in re.findall(r"[A-Za-z_][\w.]*", check)}
        return {
            signal: unit
            for signal in sorted(named)
            if len(declared[signal]) == 1
            for unit in declared[signal]
        }

    def _cases(self) -> dict[tuple[str, str], CasePlan]:
        """The cases by id and component, with those on which something is to be decided.

        What an item searched it does not decide.
        """
        cases = {(case.id, case.component): case for case in self._all(CasePlan)}
        reported = {case for case, _ in cases}
        searched = searched_claims(self._all(RecordedSearch))
        claimed, component_of = self._lines.get(ClaimedCase, {}), self._component_names()
        for judgement in self._all(Judgement):
            asked = judgement.item, judgement.requirement, judgement.case
            if judgement.kind == "claim" and asked[2] not in reported and asked not in searched:
                case: CasePlan = claimed[judgement.case]
                name = component_of(case.id, case.component)
                if name != case.component:
                    case = case.replace(component=name)
                cases.setdefault((case.id, name), case)
        return cases

    def _component_names(self) -> Callable[[str, str], str]:
        """Return what replaces the name of an expected case's component, if it is known by now."""
        of_case: dict[str, list[str]] = defaultdict(list)
        for case in self._all(CasePlan):
            of_case[case.id].append(case.component)
        names = [*{each.description["name"]: None for each in self._all(UsedComponent)}]

        def name(case: str, component: str) -> str:
            known = of_case.get(case) or names
            return known[0] if component == UNKNOWN_COMPONENT and len(known) == 1 else component

        return name

    def _answerable_judgements(self) -> list[Judgement]:
        """List all judgements, sorted; claims name their component as far as it is known."""
        claimed, component_of = self._lines.get(ClaimedCase, {}), self._component_names()
        judgements = [
            replace(each, component=component_of(each.case, claimed[each.case].component))
            if each.kind == "claim" and each.component == UNKNOWN_COMPONENT
            else each
            for each in self._all(Judgement)
        ]
        return sorted(judgements, key=judgement_order)
