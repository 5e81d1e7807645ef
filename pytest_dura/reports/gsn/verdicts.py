"""Elements about a verdict: its goal, its solution, its waiver, and what challenges it.

The wording is of propositions, never of praise.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pytest_dura.evidence.case_model import CaseEntry, ParameterEntry
from pytest_dura.evidence.episode_model import EpisodeEntry, TraceEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict, Waiver
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import name
from pytest_dura.reports.contents import folded_cases, requirement_anchor, verdict_anchor
from pytest_dura.reports.gsn.element import Element, derived_id
from pytest_dura.reports.verdicts import (
    as_sentence,
    challenge_text,
    evidence_text,
    part_text,
    verdict_proposition,
    waiver_text,
)
from pytest_dura.reports.wording import evidence_option, names_text, replay_command, replay_options
from pytest_dura.requirements.campaign_verdicts import Counterexample, violation_text


def scenario_text(scenario: str, parameters: list[ParameterEntry]) -> str:
    """A scenario of the operational domain, with its variation ranges."""
    if not parameters:
        return f"Scenario {name(scenario)}: no parameter varies."
    ranges = [f"{name(parameter.parameter)} {_range_text(parameter)}" for parameter in parameters]
    return f"Scenario {name(scenario)}: {'; '.join(ranges)}."


def _range_text(parameter: ParameterEntry) -> str:
    drawn, covered = parameter.drawn, part_text(parameter.covered)
    if parameter.choices is None:
        low, high = _figure_text(parameter.low), _figure_text(parameter.high)
        return f"in [{low}, {high}], {drawn} drawn, {covered} of its tenths reached"
    choices = names_text([str(choice.value) for choice in parameter.choices])
    return f"one of {choices}; {drawn} drawn, {covered} of the choices reached"


def _figure_text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, int | float) else name(str(value))


MAX_COUNTEREXAMPLES = 5
"""Counterexamples of one verdict that become elements; the largest violations come first."""
_MOST_NAMES = 8


@dataclass
class EpisodeFacts:
    """Facts of all episodes, in bounded memory.

    Args:
        policies: Recovery policies of the cases on which there is a verdict.
        recoveries: Import paths of their recovery planners.
        judged: How many runs they have.
        recovered: In how many of these recovery acted.
        simulators: Import paths of the simulators.
        seeds: How many episodes have a seed, and the least and the greatest one.
        counterexamples: Seed and trace of the episodes that the argument shows, by id and
            component.
    """

    policies: set[str] = field(default_factory=set)
    recoveries: set[str] = field(default_factory=set)
    judged: int = 0
    recovered: int = 0
    simulators: set[str] = field(default_factory=set)
    seeds: tuple[int, int, int] | None = None
    counterexamples: dict[tuple[str, str], tuple[int, TraceEntry | None]] = field(
        default_factory=dict
    )

    @classmethod
    def of(cls, record: SessionRecord) -> EpisodeFacts:
        """One pass over the record's episodes."""
        facts = cls()
        shown = {
            (counterexample.episode, verdict.component)
            for verdict in record.head.verdicts
            for counterexample in _shown_counterexamples(verdict)
        }
        judged = {verdict.case for verdict in record.head.verdicts}
        for episode in record.episodes():
            facts._take(episode, judged=episode.case in judged)
            key = (episode.id, episode.component)
            if key in shown:
                facts.counterexamples[key] = episode.seed, episode.trace
        return facts

    def _take(self, episode: EpisodeEntry, *, judged: bool) -> None:
        spec, seed = episode.spec, episode.seed
        if judged:
            self.judged += 1
            self.recovered += episode.metrics.recoveries > 0
            planner = spec.roles.get("recovery_planner")
            if len(self.policies) < _MOST_NAMES:
                self.policies.add(spec.policy)
            if planner is not None and len(self.recoveries) < _MOST_NAMES:
                self.recoveries.add(planner.path)
        if len(self.simulators) < _MOST_NAMES:
            self.simulators.add(spec.simulator.path)
        count, least, greatest = self.seeds or (0, seed, seed)
        self.seeds = (count + 1, min(least, seed), max(greatest, seed))


def _shown_counterexamples(verdict: ItemVerdict) -> Sequence[Counterexample]:
    """The counterexamples of a verdict that become elements."""
    return verdict.counterexamples[:MAX_COUNTEREXAMPLES]


@dataclass(frozen=True)
class VerdictElements:
    """A verdict and the elements that it makes.

    Args:
        verdict: As the record has it.
        goal: Id of its goal.
        challenge: Id of the counter goal against that goal, empty where nothing challenges it.
        elements: All its elements, the goal first.
    """

    verdict: ItemVerdict
    goal: str
    challenge: str
    elements: tuple[Element, ...]

    @property
    def refuted(self) -> bool:
        """Violated, and no waiver accepts that."""
        return self.verdict.verdict == "violated" and self.verdict.waiver is None


def verdict_elements(
    record: SessionRecord, facts: EpisodeFacts, *, several: bool
) -> Iterator[VerdictElements]:
    """Each verdict of the record with its elements; ``several``: components are named."""
    folded = folded_cases(record.head)
    texts = {requirement.id: requirement.text for requirement in record.head.requirements}
    places = {(case.id, case.component): _place_text(case) for case in record.head.cases}
    keys = [(verdict.requirement, verdict.case) for verdict in record.head.verdicts]
    times, seen = Counter(keys), Counter[tuple[str, ...]]()
    for index, (key, verdict) in enumerate(zip(keys, record.head.verdicts, strict=True)):
        apart: tuple[str, ...] = ()
        if times[key] > 1 or several:
            # Two tests of one requirement and case differ by their items; two verdicts of one
            # item have no other difference than their order.
            apart = (verdict.component, verdict.item)
            seen[key + apart] += 1
            if seen[key + apart] > 1:
                apart = (*apart, str(seen[key + apart]))
        case = (verdict.case, verdict.component)
        where = places.get(case) or name(verdict.case)
        yield _VerdictBuilder(
            record,
            facts,
            index,
            verdict,
            apart,
            where=f"{where} [{name(verdict.component)}]" if several else where,
            label=name(verdict.case) + (f" [{name(verdict.component)}]" if several else ""),
            about=as_sentence(texts[verdict.requirement]),
            shown=case not in folded,
        ).build()


def _place_text(case: CaseEntry) -> str:
    """The case by its scenario and its faults, in words."""
    faults = names_text([fault.id for fault in case.faults])
    return f"{name(case.scenario)} {f'under {faults}' if faults else 'without faults'}"


@dataclass(frozen=True)
class _VerdictBuilder:
    """Makes the elements of one verdict.

    Args:
        record: Of the session.
        facts: Of its episodes.
        index: Place of the verdict in the record.
        verdict: The verdict.
        apart: What tells it from others on its requirement and case.
        where: Scenario and faults.
        label: The case's id, with the component where there are several.
        about: Text of the requirement.
        shown: Whether the report has a row for it.
    """

    record: SessionRecord
    facts: EpisodeFacts
    index: int
    verdict: ItemVerdict
    apart: tuple[str, ...]
    where: str
    label: str
    about: str
    shown: bool

    @property
    def url(self) -> str:
        return f"evidence.json#/verdicts/{self.index}"

    @property
    def requirement(self) -> str:
        return name(self.verdict.requirement)

    def identifier(self, prefix: str, *more: str, what: str = "") -> str:
        """The id of the verdict's element of a kind."""
        parts = (self.verdict.requirement, self.verdict.case, *more)
        return derived_id(prefix, *parts, what=what, apart=self.apart)

    def alias(self, what: str) -> str:
        twin = f" ({self.apart[2]})" if len(self.apart) > 2 else ""
        return f"{what}:{self.requirement}@{self.label}{twin}"

    def layers(self) -> dict[str, Any]:
        requirement = self.verdict.requirement
        anchor = requirement_anchor(requirement)
        if self.shown:
            anchor = verdict_anchor(requirement, self.verdict.case)
        return {"report": f"report.html#{anchor}", "verdict": self.verdict.verdict}

    def build(self) -> VerdictElements:
        """The verdict with all its elements."""
        undecided = self.verdict.verdict == "undecided"
        # Violations challenge a claim, also where its bound allows them or nothing is decided.
        contested = bool(self.verdict.counterexamples) or self.verdict.verdict == "violated"
        support = [] if undecided else [self._solution()]
        given = self.verdict.waiver
        waiver = [] if given is None else [self._waiver(given)]
        challenge = list(self._challenge()) if contested else []
        goal = self._goal([element.id for element in support], [element.id for element in waiver])
        return VerdictElements(
            self.verdict,
            goal.id,
            challenge[0].id if challenge else "",
            (goal, *support, *waiver, *challenge),
        )

    def _goal(self, support: list[str], waivers: list[str]) -> Element:
        verdict = self.verdict.verdict
        claim = verdict_proposition(self.verdict)
        why = f"Undecided: {as_sentence(self.verdict.reason)}" if verdict == "undecided" else ""
        return Element(
            self.identifier("G"),
            " ".join(
                part
                for part in (f"{self.requirement} in {self.where}:", self.about, claim, why)
                if part
            ),
            supported_by=tuple(support),
            in_context_of=tuple(waivers),
            undeveloped=verdict == "undecided",
            defeated=verdict == "violated",
            url=self.url,
            alias=self.alias("verdict"),
            layers=self.layers(),
            brief=(claim, why) if why else (claim,),
        )

    def _solution(self) -> Element:
        counts = f"n = {self.verdict.episodes}", f"{self.verdict.violations} violated"
        return Element(
            self.identifier("Sn"),
            f"Verdict {self.index} in evidence.json: {evidence_text(self.verdict)}",
            url=self.url,
            alias=self.alias("evidence"),
            layers=self.layers(),
            brief=(f"verdict {self.index}", *counts),
        )

    def _waiver(self, waiver: Waiver) -> Element:
        return Element(
            self.identifier("J", what="waiver"),
            waiver_text(waiver, self.verdict.verdict),
            url=f"{self.url}/waiver",
            alias=self.alias("waiver"),
        )

    def _challenge(self) -> Iterator[Element]:
        """A counter goal, and the counterexamples or else the verdict's entry to support it."""
        status = {"verdict": self.verdict.verdict}
        counterexamples = _shown_counterexamples(self.verdict)
        evidence = [
            self._counterexample(i, counterexample)
            for i, counterexample in enumerate(counterexamples)
        ]
        if not evidence:
            solution = self._solution()
            evidence = [replace(solution, id=self.identifier("CSn"), alias="", layers=status)]
        yield Element(
            self.identifier("CG"),
            challenge_text(self.verdict, self.where, len(counterexamples)),
            supported_by=tuple(element.id for element in evidence),
            challenges=self.identifier("G"),
            url=self.url,
            alias=self.alias("challenge"),
            layers=status,
        )
        yield from evidence

    def _counterexample(self, index: int, counterexample: Counterexample) -> Element:
        episode = counterexample.episode
        when = violation_text(
            counterexample.time, counterexample.margin, valid=counterexample.valid
        )
        brief = violation_text(counterexample.time, None).strip().removeprefix("at ")
        seed, trace = self.facts.counterexamples.get(
            (episode, self.verdict.component), (None, None)
        )
        command = self.record.head.command
        evidence = evidence_option(command)
        models = {key: name(option) for key, option in replay_options(command).items()}
        layers = {
            "replay": replay_command(
                name(episode), None if evidence is None else name(evidence), models
            ),
            "verdict": self.verdict.verdict,
        }
        if trace is not None:
            layers["trace"] = name(trace.file)
        return Element(
            self.identifier("CSn", str(index)),
            f"Episode {name(episode)} in evidence.json violates it{when}"
            + ("." if seed is None else f", seed {seed}."),
            url=f"{self.url}/counterexamples/{index}",
            layers=layers,
            brief=("run " + name(episode).rpartition("#")[2][:9], brief),
        )
