"""The elements about one verdict: its goal, its solution, its waiver, and what challenges it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pytest_dura.evidence.formats.gsn.element import Element, derived_id
from pytest_dura.evidence.formats.gsn.facts import Facts, shown
from pytest_dura.evidence.formats.gsn.wording import (
    evidence_text,
    place,
    sentence,
    short_evidence,
    verdict_text,
    waiver_text,
)
from pytest_dura.evidence.formats.report.anchors import requirement_anchor, verdict_anchor
from pytest_dura.evidence.formats.report.folding import folded_cases
from pytest_dura.evidence.formats.stated import also_without
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.evidence.text import name
from pytest_dura.evidence.views.replay_command import evidence_option, model_options, replay_command

Data = Mapping[str, Any]


@dataclass(frozen=True)
class Judged:
    """A verdict and the elements that it makes.

    Args:
        verdict: As the record has it.
        goal: Id of its goal.
        challenge: Id of the counter goal against that goal, empty where nothing challenges it.
        elements: All its elements, the goal first.
    """

    verdict: Data
    goal: str
    challenge: str
    elements: tuple[Element, ...]

    @property
    def refuted(self) -> bool:
        """Violated, and no waiver accepts that."""
        return self.verdict["verdict"] == "violated" and self.verdict["waiver"] is None


def judged(record: SessionRecord, facts: Facts, *, several: bool) -> Iterator[Judged]:
    """Each verdict of the record with its elements; ``several``: components are told apart."""
    seen: Counter[tuple[str, ...]] = Counter()
    folded = folded_cases(record)
    for index, verdict in enumerate(record["verdicts"]):
        # Its item tells apart two tests of one requirement and case; two of one item have no
        # other difference than their order.
        apart: tuple[str, ...] = (verdict["component"], str(verdict["item"]))
        key = (verdict["requirement"], verdict["case"], *apart)
        seen[key] += 1
        if seen[key] > 1:
            apart = (*apart, str(seen[key]))
        shown = (verdict["case"], verdict["component"]) not in folded
        yield _Maker(record, facts, index, verdict, apart, several, shown).judged()


@dataclass(frozen=True)
class _Maker:
    """Makes the elements of one verdict."""

    record: SessionRecord
    facts: Facts
    index: int
    verdict: Data
    apart: tuple[str, ...]
    several: bool
    shown: bool
    """Whether the report has a row for it."""

    @property
    def url(self) -> str:
        return f"evidence.json#/verdicts/{self.index}"

    @property
    def where(self) -> str:
        return place(self.verdict["case"], self.verdict["component"], several=self.several)

    @property
    def requirement(self) -> str:
        return name(self.verdict["requirement"])

    def identifier(self, prefix: str, *more: str) -> str:
        """The id of the verdict's element of a kind."""
        parts = (self.verdict["requirement"], self.verdict["case"], *more)
        return derived_id(prefix, *parts, apart=self.apart)

    def alias(self, what: str) -> str:
        twin = f" ({self.apart[2]})" if len(self.apart) > 2 else ""
        return f"{what}:{self.requirement}@{self.where}{twin}"

    def layers(self) -> dict[str, Any]:
        requirement = self.verdict["requirement"]
        anchor = requirement_anchor(requirement)
        if self.shown:
            anchor = verdict_anchor(requirement, self.verdict["case"])
        return {"report": f"report.html#{anchor}", "verdict": self.verdict["verdict"]}

    def judged(self) -> Judged:
        """The verdict with all its elements."""
        undecided = self.verdict["verdict"] == "undecided"
        waived = self.verdict["waiver"] is not None
        # Violations challenge a claim, also where its bound allows them or nothing is decided.
        contested = bool(self.verdict["counterexamples"]) or self.verdict["verdict"] == "violated"
        support = [] if undecided else [self._solution()]
        waiver = [self._waiver()] if waived else []
        challenge = list(self._challenge()) if contested else []
        goal = self._goal([one.id for one in support], [one.id for one in waiver])
        return Judged(
            self.verdict,
            goal.id,
            challenge[0].id if challenge else "",
            (goal, *support, *waiver, *challenge),
        )

    def _goal(self, support: list[str], waivers: list[str]) -> Element:
        word = self.verdict["verdict"]
        why = f" Undecided: {sentence(str(self.verdict['reason']))}" if word == "undecided" else ""
        return Element(
            self.identifier("G"),
            verdict_text(self.verdict, several=self.several) + why,
            supported_by=tuple(support),
            in_context_of=tuple(waivers),
            undeveloped=word == "undecided",
            defeated=word == "violated",
            url=self.url,
            alias=self.alias("verdict"),
            layers=self.layers(),
            brief=(self.where, word + (", waived" if waivers else "")),
        )

    def _solution(self) -> Element:
        return Element(
            self.identifier("Sn"),
            evidence_text(self.verdict),
            url=self.url,
            alias=self.alias("evidence"),
            layers=self.layers(),
            brief=tuple(short_evidence(self.verdict)),
        )

    def _waiver(self) -> Element:
        return Element(
            self.identifier("J", "waiver"),
            waiver_text(self.verdict),
            url=f"{self.url}/waiver",
            alias=self.alias("waiver"),
            brief=("waived",),
        )

    def _challenge(self) -> Iterator[Element]:
        """A counter goal, and the counterexamples or else the verdict's entry to support it."""
        found = shown(self.verdict)
        evidence = [self._counterexample(i, one) for i, one in enumerate(found)]
        if not evidence:
            text = evidence_text(self.verdict)
            short = tuple(short_evidence(self.verdict))
            evidence = [Element(self.identifier("CSn"), text, url=self.url, brief=short)]
        yield Element(
            self.identifier("CG"),
            self._challenge_text(len(found)),
            supported_by=tuple(one.id for one in evidence),
            challenges=self.identifier("G"),
            url=self.url,
            alias=self.alias("challenge"),
            brief=self._challenge_brief(),
        )
        yield from evidence

    def _challenge_brief(self) -> tuple[str, str]:
        verdict = self.verdict
        if verdict["without_effect"] and not verdict["violations"]:
            return f"{verdict['without_effect']} violate it", "without effect"
        return f"{verdict['violations']} of {verdict['episodes']}", "violate it"

    def _challenge_text(self, told: int) -> str:
        verdict = self.verdict
        how = {
            "violated": "",
            "supported": ", as many as the bound allows",
            "undecided": ", which decide nothing yet",
        }[verdict["verdict"]]
        what = "pairs" if verdict["pairs"] is not None else "episodes"
        rest = len(verdict["counterexamples"]) - told
        more = f" {rest} more stand in the record." if told and rest > 0 else ""
        if verdict["without_effect"] and not verdict["violations"]:
            return (
                f"{verdict['without_effect']} of {verdict['invalid']} invalid {what} violate "
                f"{self.requirement} in {self.where}, without effect of the fault.{more}"
            )
        return (
            f"{verdict['violations']} of {verdict['episodes']} valid {what} violate "
            f"{self.requirement} in {self.where}{how}{also_without(verdict)}.{more}"
        )

    def _counterexample(self, index: int, one: Data) -> Element:
        episode = one["episode"]
        when = "" if one["time"] is None else f" at {one['time']:.4g} s"
        margin = "" if one["margin"] is None else f", margin {one['margin']:.4g}"
        known = self.facts.counterexamples.get((episode, self.verdict["component"]), {})
        seed = f", seed {known['seed']}" if known else ""
        effect = "" if one["valid"] else ", without effect of the fault"
        trace = known.get("trace")
        given = evidence_option(self.record["command"])
        models = {key: name(one) for key, one in model_options(self.record["command"]).items()}
        command = replay_command(name(episode), None if given is None else name(given), models)
        layers = {"replay": command}
        if trace is not None:
            layers["trace"] = name(str(trace["file"]))
        return Element(
            self.identifier("CSn", str(index)),
            f"Episode {name(episode)} violates it{when}{margin}{seed}{effect}.",
            url=f"{self.url}/counterexamples/{index}",
            layers=layers,
            brief=("run " + name(episode).rpartition("#")[2][:10], when.strip()),
        )
